"""Frames of the humans that are tracked now: the latest transform of each, freed when the human is gone.

tf2 keeps every frame that it ever saw. The frames of humans come and go by the thousand, so they are kept
here, and only while their identifier is tracked.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Dict, Iterable, NamedTuple, Optional, Set, Tuple

from hri_person_manager.core.association import Kind
from hri_person_manager.core.location import Source
from hri_pipeline.core.geometry import Pose

_PREFIX = {Kind.FACE: ("face",), Kind.VOICE: ("voice",)}
MAX_UNCLAIMED_STATICS = 500
MAX_LINKS = 64
MAX_WANTED = 10000


Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]
Motion = Tuple[Vector, Quaternion]


class Link(NamedTuple):
    """Transform of one frame that maps its coordinates to `parent`, at `stamp` (s; infinite for a fixed one).

    translation: m. rotation: x, y, z, w.
    """

    parent: str
    translation: Vector
    rotation: Quaternion
    stamp: float

    @property
    def pose(self) -> Pose:
        """The transform; ValueError when its numbers are none."""
        if not math.isfinite(sum(self.translation)):
            raise ValueError("a translation holds numbers that are not finite")
        return Pose.from_quaternion(self.rotation, self.translation)


class Sighting(NamedTuple):
    """A feature placed in the frame of its sensor: `pose` maps its coordinates to `sensor` (m)."""

    source: Source
    id: str
    sensor: str
    pose: Pose
    stamp: float


class HumanFrames:
    """Latest links of the frames face_ID, voice_ID and, for bodies, body_ID and all between it and head_ID."""

    def __init__(self, source_timeout: float) -> None:
        """A head frame older than the body frame by more than `source_timeout` s is not used."""
        self._source_timeout = source_timeout
        self._tracked: Dict[Kind, Set[str]] = {Kind.FACE: set(), Kind.BODY: set(), Kind.VOICE: set()}
        self._links: Dict[Tuple[Kind, str], Dict[str, Link]] = {}
        self._statics: "OrderedDict[str, Link]" = OrderedDict()
        self._wanted: Dict[str, Tuple[Kind, str]] = {}

    def __len__(self) -> int:
        """Return the number of frames kept."""
        return len(self._statics) + sum(len(links) for links in self._links.values())

    def set_tracked(self, kind: Kind, ids: Iterable[str]) -> None:
        """Follow these identifiers of one kind; what was kept of the others is freed."""
        ids = set(ids)
        gone = self._tracked[kind] - ids
        for identity in gone:
            self._links.pop((kind, identity), None)
        if gone:
            self._wanted = {frame: owner for frame, owner in self._wanted.items()
                            if owner[0] != kind or owner[1] not in gone}
        self._tracked[kind] = ids
        for identity in ids:
            names = ("body", "head") if kind == Kind.BODY else _PREFIX[kind]
            self._wanted.update(("{}_{}".format(name, identity), (kind, identity)) for name in names)
        for frame in list(self._statics):
            owner = self.owner(frame)
            if owner is not None:
                self.put(owner, frame, self._statics.pop(frame))

    @property
    def wanted_frames(self) -> int:
        """Number of the frames that place somebody."""
        return len(self._wanted)

    def wanted(self, frame: str) -> Optional[Tuple[Kind, str]]:
        """Return kind and id of the tracked feature that is placed by this frame, None for any other frame."""
        return self._wanted.get(frame)

    def owner(self, frame: str) -> Optional[Tuple[Kind, str]]:
        """Return kind and id of the tracked feature whose frame this is, None if it is nobody's."""
        start = frame.find("_")
        while start > 0:
            prefix, identity = frame[:start], frame[start + 1:]
            for kind, prefixes in _PREFIX.items():
                if prefix in prefixes and identity in self._tracked[kind]:
                    return kind, identity
            if identity in self._tracked[Kind.BODY] and prefix not in ("face", "voice", "gaze", "person"):
                return Kind.BODY, identity
            start = frame.find("_", start + 1)
        return None

    def put(self, owner: Tuple[Kind, str], frame: str, link: Link) -> Optional[Sighting]:
        """Keep a link of a tracked feature; returns where that places the feature, None if it does not.

        Raises ValueError for numbers that are none.
        """
        links = self._links.setdefault(owner, {})
        if frame not in links and len(links) >= MAX_LINKS:
            return None
        kind, identity = owner
        if kind != Kind.BODY:
            sighting = Sighting(Source.FACE if kind == Kind.FACE else Source.VOICE, identity, link.parent, link.pose,
                                link.stamp)
            links[frame] = link
            return sighting
        if not _is_legal(link):
            raise ValueError("a transform holds numbers that are not finite, or a quaternion of zeros")
        before = links.get(frame)
        links[frame] = link
        if frame == "body_" + identity:
            return self._place_body(identity, links, link)
        if before is None or before.parent != link.parent:
            self._want_chain(identity, links)
        return None

    def keep_static(self, frame: str, link: Link) -> None:
        """Keep a fixed link that may belong to a body of which the tracked list tells later."""
        self._statics[frame] = link
        self._statics.move_to_end(frame)
        while len(self._statics) > MAX_UNCLAIMED_STATICS:
            self._statics.popitem(last=False)

    def clear(self) -> None:
        """Forget all moving links, not who is tracked: a fixed one never comes again."""
        for owner, links in self._links.items():
            self._links[owner] = {frame: link for frame, link in links.items() if math.isinf(link.stamp)}

    def _want_chain(self, identity: str, links: Dict[str, Link]) -> None:
        """Want the frames above the head, as far as they are known."""
        frame = "head_" + identity
        for _ in range(len(links)):
            if frame not in links:
                return
            frame = links[frame].parent
            if self.owner(frame) == (Kind.BODY, identity) and len(self._wanted) < MAX_WANTED:
                self._wanted[frame] = (Kind.BODY, identity)

    def _place_body(self, identity: str, links: Dict[str, Link], root: Link) -> Sighting:
        """Place a body by its head when the chain of links from there to the body frame is complete and new enough."""
        oldest = root.stamp - self._source_timeout
        frame, motion = "head_" + identity, _STILL
        for _ in range(len(links)):
            link = links.get(frame)
            if link is None or link.stamp < oldest:
                break
            frame, motion = link.parent, _after((link.translation, link.rotation), motion)
            if frame == "body_" + identity:
                return Sighting(Source.HEAD, identity, root.parent,
                                _to_pose(_after((root.translation, root.rotation), motion)), root.stamp)
            if frame == root.parent:
                return Sighting(Source.HEAD, identity, root.parent, _to_pose(motion), root.stamp)
        return Sighting(Source.BODY, identity, root.parent, root.pose, root.stamp)


_STILL: Motion = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def _is_legal(link: Link) -> bool:
    # A sum is finite when all of its numbers are.
    x, y, z, w = link.rotation
    return math.isfinite(sum(link.translation)) and 1e-18 < x * x + y * y + z * z + w * w < math.inf


def _after(first: Motion, second: Motion) -> Motion:
    """Return first * second: the second transform, then the first."""
    (x, y, z), (a, b, c, d) = first
    (u, v, w), (e, f, g, h) = second
    # Rotate (u, v, w) by the quaternion (a, b, c; d): t = 2 q x v; v + d t + q x t.
    scale = 2.0 / (a * a + b * b + c * c + d * d)
    i, j, k = scale * (b * w - c * v), scale * (c * u - a * w), scale * (a * v - b * u)
    return ((x + u + d * i + b * k - c * j, y + v + d * j + c * i - a * k, z + w + d * k + a * j - b * i),
            (d * e + a * h + b * g - c * f, d * f - a * g + b * h + c * e,
             d * g + a * f - b * e + c * h, d * h - a * e - b * f - c * g))


def _to_pose(motion: Motion) -> Pose:
    return Pose.from_quaternion(motion[1], motion[0])
