"""The frames of tracked people, the latest transform of each, freed when the person is gone."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Dict, Iterable, List, NamedTuple, Optional, Set, Tuple

from hri_pipeline.core.tf_scan import RawTransform

MAX_WAY = 12            # links between the head of a skeleton and the camera; the neck has three joints
MAX_UNCLAIMED = 500
_MAX_LIMBS = 5000


class Features(NamedTuple):
    """Face and body of a person: empty when there is none, None while nobody has said."""

    face: Optional[str] = None
    body: Optional[str] = None


class Timed(NamedTuple):
    """A transform; a fixed one is as new as the newest (stamp infinite)."""

    transform: RawTransform
    stamp: float


class PeopleFrames:
    """Keeps face_ID, gaze_ID, body_ID, the way from head_ID to the camera, and person_ID of those who are tracked.

    Names of frames are bytes as in the messages where they are asked for often.
    """

    def __init__(self) -> None:
        self._features: Dict[str, Features] = {}
        self._early: "OrderedDict[str, Features]" = OrderedDict()
        self._wanted: Set[bytes] = set()
        self._frames: Dict[str, Timed] = {}
        self._unclaimed: "OrderedDict[str, Timed]" = OrderedDict()
        self._limbs: Set[bytes] = set()
        self._suffixes: Tuple[bytes, ...] = ()
        self.refused = 0

    def __len__(self) -> int:
        """Return the number of transforms kept."""
        return len(self._frames) + len(self._unclaimed)

    @property
    def people(self) -> Dict[str, Features]:
        """Who is tracked, in order, with their features."""
        return self._features

    def set_people(self, ids: Iterable[str]) -> None:
        """Follow these persons; the frames of the others are let go."""
        self._features = {identity: self._features.get(identity) or self._early.pop(identity, Features()) for identity in ids}
        self._rebuild()

    def set_feature(self, person: str, kind: str, value: str) -> None:
        """Say which "face" or "body" (an id, or empty) a person has; it may be said before the person is tracked."""
        features = self._features.get(person)
        if features is None:
            self._early[person] = self._early.get(person, Features())._replace(**{kind: value})
            while len(self._early) > MAX_UNCLAIMED:
                self._early.popitem(last=False)
        elif getattr(features, kind) != value:
            self._features[person] = features._replace(**{kind: value})
            self._rebuild()

    def wants(self, child: bytes) -> bool:
        """Tell whether put() is to be called for a frame."""
        return child in self._wanted

    def is_limb(self, child: bytes) -> bool:
        """Tell whether a frame that is not wanted belongs to the skeleton of somebody who is tracked."""
        if child in self._limbs:
            return True
        if not self._suffixes or not child.endswith(self._suffixes):
            return False
        if len(self._limbs) < _MAX_LIMBS:
            self._limbs.add(child)
        return True

    def put(self, transform: RawTransform, fixed: bool) -> bool:
        """Keep a transform; False for one whose numbers are not finite or that turns by nothing."""
        if not _is_legal(transform):
            self.refused += 1
            return False
        name = transform.child
        timed = Timed(transform, math.inf if fixed else transform.stamp)
        self._frames[name] = timed
        above = transform.parent.encode()
        if above not in self._wanted and name.encode() in self._wanted and above.endswith(self._suffixes or (b"\0",)):
            self._want_above(name)
        return True

    def keep_fixed(self, transform: RawTransform) -> None:
        """Keep a fixed transform that may turn out to belong to somebody: it never comes again."""
        if _is_legal(transform):
            self._unclaimed[transform.child] = Timed(transform, math.inf)
            self._unclaimed.move_to_end(transform.child)
            while len(self._unclaimed) > MAX_UNCLAIMED:
                self._unclaimed.popitem(last=False)

    def get(self, frame: str, oldest: float = -math.inf) -> Optional[Timed]:
        """Return the latest transform of a frame unless it is older than the stamp `oldest` (s)."""
        timed = self._frames.get(frame)
        return timed if timed is not None and timed.stamp >= oldest else None

    def way(self, body: str, oldest: float) -> List[RawTransform]:
        """Return the transforms from head_ID up to the frame of the sensor; none where a link is missing or too old."""
        frame, found = "head_" + body, []
        suffix = "_" + body
        for _ in range(MAX_WAY):
            timed = self.get(frame, oldest)
            if timed is None:
                return []
            found.append(timed.transform)
            frame = timed.transform.parent
            if not frame.endswith(suffix):
                return found
        return []

    def clear_moving(self) -> None:
        """Forget what moves, as after a time jump."""
        self._frames = {name: timed for name, timed in self._frames.items() if math.isinf(timed.stamp)}

    def _rebuild(self) -> None:
        wanted: Set[str] = set()
        bodies: List[str] = []
        for person, features in self._features.items():
            wanted.add("person_" + person)
            if features.face:
                wanted.update(("face_" + features.face, "gaze_" + features.face))
            if features.body:
                wanted.update(("body_" + features.body, "head_" + features.body))
                bodies.append(features.body)
        self._wanted = {name.encode() for name in wanted}
        self._suffixes = tuple(("_" + body).encode() for body in bodies)
        self._limbs.clear()
        before = self._frames
        for name in wanted:
            if name not in before and name in self._unclaimed:
                before[name] = self._unclaimed.pop(name)
        for body in bodies:
            self._want_above("head_" + body)
        self._frames = {name: timed for name, timed in before.items() if name.encode() in self._wanted}

    def _want_above(self, frame: str) -> None:
        """Want the links above one of a skeleton, as far as they are known."""
        for _ in range(MAX_WAY):
            timed = self._frames.get(frame)
            if timed is None:
                return
            frame = timed.transform.parent
            if not frame.encode().endswith(self._suffixes or (b"\0",)):
                return
            self._wanted.add(frame.encode())
            self._limbs.discard(frame.encode())
            if frame not in self._frames and frame in self._unclaimed:
                self._frames[frame] = self._unclaimed.pop(frame)


def _is_legal(transform: RawTransform) -> bool:
    # A sum is finite when all of its numbers are.
    x, y, z, w = transform.rotation
    return math.isfinite(sum(transform.translation)) and 1e-9 < x * x + y * y + z * z + w * w < math.inf
