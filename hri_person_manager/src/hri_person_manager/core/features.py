"""Faces, bodies and voices that are tracked now, those in the tracked lists and those that a match names before its
list does; and where they are, by their frames.

A feature is tracked when the latest list of its kind contains its id. A feature that only candidate matches name is
*inferred*: it counts as tracked until its list arrives, or until no match has named it for 10 s.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from enum import IntEnum
from typing import Container, Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

from hri_pipeline.core.frames import HumanTf, Timed, composed
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import is_valid_id

MAX_FEATURES = 200            # per kind; a longer list is cut, and that is reported
# s; lists come once a second, so that a feature that only matches have named for so long has left
INFERRED_S = 10.0
_MAX_GONE = 2000              # features that have left are remembered, so that a late match does not bring them back


class Kind(IntEnum):
    """Kind of an identifier; the values are those of the constants in hri_msgs/IdsMatch."""

    PERSON = 1
    FACE = 2
    BODY = 3
    VOICE = 4


FEATURES = (Kind.FACE, Kind.BODY, Kind.VOICE)


class MatchNode(NamedTuple):
    """A node of the match graph: one id of one kind."""

    kind: Kind
    id: str


class ListChange(NamedTuple):
    """What a tracked list has changed. `inferred`: those of `gone` that no list has ever contained."""

    gone: List[MatchNode]
    new: List[MatchNode]
    inferred: FrozenSet[MatchNode]


class TrackedFeatures:
    """The ids of all features that are tracked now, kind by kind."""

    def __init__(self) -> None:
        self._tracked: Dict[Kind, Set[str]] = {kind: set() for kind in FEATURES}
        self._inferred: Dict[MatchNode, float] = {}
        self._gone: "OrderedDict[MatchNode, None]" = OrderedDict()
        self.refused = 0

    def __contains__(self, node: MatchNode) -> bool:
        """Tell whether a feature is tracked."""
        return node.id in self._tracked[node.kind]

    def features(self) -> List[MatchNode]:
        """All features that are tracked, sorted."""
        return [MatchNode(kind, id) for kind in FEATURES for id in sorted(self._tracked[kind])]

    def update(self, kind: Kind, ids: Iterable[str]) -> ListChange:
        """Take the tracked list of one kind: all ids in it are tracked, and no others. Malformed ids are left out and
        counted."""
        ids = list(ids)
        valid = [id for id in ids if is_valid_id(id)]
        self.refused += len(ids) - len(valid) + max(0, len(valid) - MAX_FEATURES)
        listed = set(valid[:MAX_FEATURES])
        gone = [MatchNode(kind, id) for id in sorted(self._tracked[kind] - listed)]
        new = [MatchNode(kind, id) for id in sorted(listed - self._tracked[kind])]
        inferred = frozenset(node for node in gone if node in self._inferred)
        self._inferred = {node: since for node, since in self._inferred.items() if node.kind != kind}
        self._tracked[kind] = listed
        for node in gone:
            if node not in inferred:
                self._gone[node] = None
        while len(self._gone) > _MAX_GONE:
            self._gone.popitem(last=False)
        return ListChange(gone, new, inferred)

    def infer(self, node: MatchNode, now: float) -> bool:
        """Count a feature as tracked until its list arrives; False when it is tracked already, or has just left.

        now: s; an inferred feature expires 10 s after the last call.
        """
        tracked_ids = self._tracked[node.kind]
        if node in self._inferred:
            self._inferred[node] = now
        if node.id in tracked_ids or node in self._gone or len(tracked_ids) >= MAX_FEATURES:
            return False
        tracked_ids.add(node.id)
        self._inferred[node] = now
        return True

    def rewind(self, now: float) -> None:
        """Let the time of all inferred features start at `now` (s), as time has jumped back."""
        self._inferred = dict.fromkeys(self._inferred, now)

    def expired(self, now: float) -> List[MatchNode]:
        """The inferred features that neither a match nor a list has named for 10 s."""
        return sorted(node for node, since in self._inferred.items() if now - since > INFERRED_S)

    def is_inferred(self, node: MatchNode) -> bool:
        """Tell whether only matches name a feature, and no list so far."""
        return node in self._inferred

    def drop(self, node: MatchNode) -> None:
        """Drop an inferred feature that no match names any more."""
        self._inferred.pop(node, None)
        self._tracked[node.kind].discard(node.id)


class PlaceSource(IntEnum):
    """Frames that can place a person, the best one first."""

    FACE = 0
    HEAD = 1
    BODY = 2
    VOICE = 3


class FeaturePose(NamedTuple):
    """A feature placed in the frame of its sensor: `pose` maps its coordinates to `sensor` (m).

    secs, nsecs: the stamp, as exact as in the message.
    """

    source: PlaceSource
    id: str
    sensor: str
    pose: Pose
    secs: int
    nsecs: int


_FRAMES = {Kind.FACE: ("face",), Kind.BODY: ("body", "head"), Kind.VOICE: ("voice",)}


class FeatureTf(HumanTf):
    """Where the tracked features are: by the frames face_ID, voice_ID and, for bodies, all from head_ID to body_ID or a
    sensor."""

    def __init__(self, source_timeout: float) -> None:
        """A head that is by more than `source_timeout` s older, and came so much earlier, than its body is not used."""
        super().__init__()
        self._source_timeout = source_timeout
        self._tops: Dict[str, str] = {}

    def set_tracked(self, kind: Kind, ids: Sequence[str]) -> List[FeaturePose]:
        """Follow these identifiers of one kind; what was kept of the others is freed.

        Returns where fixed frames that came before their feature was listed place it.
        """
        names = _FRAMES[kind]
        before = set(self.followed.get(names[0], ()))
        if before != set(ids):
            self.follow(**dict.fromkeys(names, ids))
            if kind == Kind.BODY:
                self._tops = {identity: top for identity, top in self._tops.items() if identity in ids}
        return self._placed([(name + "_" + identity, identity) for identity in ids if identity not in before
                             for name in names])

    def take(self, data: bytes, frames: Sequence[Tuple[bytes, int]], fixed: bool, now: float) -> List[FeaturePose]:
        """Keep the wanted transforms of a message that arrives at `now` (s), as put_message(); return where they place
        features."""
        return self._placed(self.put_message(data, frames, fixed, now))

    def clear_moving(self) -> None:
        """Forget what moves, as after a time jump."""
        super().clear_moving()
        self._tops.clear()

    def _placed(self, moved: Iterable[Tuple[str, str]]) -> List[FeaturePose]:
        """Where the frames that have moved, each with its id, place their features."""
        found: List[Optional[FeaturePose]] = []
        bodies: Dict[str, List[str]] = {}
        for frame, identity in moved:
            if frame in ("face_" + identity, "voice_" + identity):
                source = PlaceSource.FACE if frame.startswith("f") else PlaceSource.VOICE
                found.append(self._pose(source, identity, frame))
            else:
                bodies.setdefault(identity, []).append(frame)
        for identity, names in bodies.items():
            pose = self._by_head(identity, names)
            if pose is None and "body_" + identity in names:
                pose = self._pose(PlaceSource.BODY, identity, "body_" + identity)
            found.append(pose)
        return [pose for pose in found if pose is not None]

    def _pose(self, source: PlaceSource, identity: str, frame: str) -> Optional[FeaturePose]:
        timed = self.get(frame)
        return None if timed is None else _feature_pose(source, identity, [timed], timed)

    def _by_head(self, identity: str, moved: Container[str]) -> Optional[FeaturePose]:
        """Place a body by its head when the highest frame that moves has done so, once per image.

        None while the way to a sensor is not known, or when one of its links is old.
        """
        chain = self.chain("head_" + identity)
        if not chain:
            self._tops.pop(identity, None)
            return None
        newest = next((timed for timed in reversed(chain) if not math.isinf(timed.stamp)), chain[0])
        top = newest.transform.child
        if top not in moved and self._tops.get(identity) == top:
            return None
        self._tops[identity] = top
        if any(newest.stamp - timed.stamp > self._source_timeout and not (
                newest.arrived - timed.arrived <= self._source_timeout) for timed in chain):
            return None
        return _feature_pose(PlaceSource.HEAD, identity, chain, newest)


def _feature_pose(source: PlaceSource, identity: str, chain: Sequence[Timed], newest: Timed) -> FeaturePose:
    _, _, secs, nsecs, _, _ = newest.transform
    return FeaturePose(source, identity, chain[-1].transform.parent, composed(chain), secs, nsecs)
