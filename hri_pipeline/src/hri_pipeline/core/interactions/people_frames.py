"""The frames of tracked people, the latest transform of each, freed when the person is gone."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Dict, Iterable, List, NamedTuple, Optional, Set, Tuple

from hri_pipeline.core.tf_scan import RawTransform, read

MAX_WAY = 12            # links between the head of a skeleton and the camera; the neck has three joints
MAX_UNCLAIMED = 500
_MAX_LIMBS = 5000
_MAX_SENSORS = 100
_FACE, _GAZE = "face_", "gaze_"
_ENDS = ("body_", "person_")
"""Frames right below that of a sensor or of the world."""


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
        self._unread: Dict[bytes, Tuple[bytes, int]] = {}
        self._faces_since: Dict[str, float] = {}
        self._gazers: "OrderedDict[str, None]" = OrderedDict()
        self.refused = 0

    def __len__(self) -> int:
        """Return the number of transforms kept."""
        unread = sum(name.decode("utf-8", "replace") not in self._frames for name in self._unread)
        return len(self._frames) + unread + len(self._unclaimed)

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

    def put_unread(self, child: bytes, data: bytes, offset: int) -> None:
        """Keep a moving transform as it is in a message; it is read when it is asked for, and most never are."""
        self._unread[child] = (data, offset)

    def unseen_since(self, face: RawTransform) -> float:
        """Stamp (s) from which a face without a gaze frame might have had one.

        Infinite where its sensor has not told the gaze of any face: it does not measure it.
        """
        return self._faces_since.get(face.child, math.inf) if face.parent in self._gazers else math.inf

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
        if not transform.is_pose:
            self.refused += 1
            return False
        name = transform.child
        timed = Timed(transform, math.inf if fixed else transform.stamp)
        self._frames[name] = timed
        if name.startswith(_FACE):
            self._faces_since.setdefault(name, timed.stamp)
        elif name.startswith(_GAZE):
            self._note_gaze(name)
        elif not name.startswith(_ENDS):
            self._note_link(transform)
        return True

    def keep_fixed(self, transform: RawTransform) -> None:
        """Keep a fixed transform that may turn out to belong to somebody: it never comes again."""
        if transform.is_pose:
            self._unclaimed[transform.child] = Timed(transform, math.inf)
            self._unclaimed.move_to_end(transform.child)
            while len(self._unclaimed) > MAX_UNCLAIMED:
                self._unclaimed.popitem(last=False)

    def get(self, frame: str, oldest: float = -math.inf) -> Optional[Timed]:
        """Return the latest transform of a frame unless it is older than the stamp `oldest` (s)."""
        unread = self._unread.pop(frame.encode(), None)
        if unread is not None:
            self.put(read(*unread), fixed=False)
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
        self._unread.clear()
        self._faces_since.clear()

    def _note_link(self, transform: RawTransform) -> None:
        """Want the frame above a wanted one, where it belongs to the same skeleton."""
        above, name = transform.parent.encode(), transform.child.encode()
        if above not in self._wanted and name in self._wanted and above.endswith(self._suffixes or (b"\0",)):
            self._want_above(transform.child)

    def _note_gaze(self, gaze: str) -> None:
        """Remember the sensor whose faces have gazes."""
        face = self._frames.get(_FACE + gaze[len(_GAZE):])
        if face is not None and face.transform.parent not in self._gazers:
            self._gazers[face.transform.parent] = None
            while len(self._gazers) > _MAX_SENSORS:
                self._gazers.popitem(last=False)

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
        self._unread = {name: where for name, where in self._unread.items() if name in self._wanted}
        self._faces_since = {name: since for name, since in self._faces_since.items() if name in wanted}
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
