"""Faces, bodies and voices that are tracked now: those in the tracked lists, and those that a match names before its
list does.

A feature is tracked when the latest list of its kind contains its id. A feature that only candidate matches name is
*inferred*: it counts as tracked until its list arrives, or until no match has named it for 10 s.
"""

from __future__ import annotations

from collections import OrderedDict
from enum import IntEnum
from typing import Dict, FrozenSet, Iterable, List, NamedTuple, Set

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
