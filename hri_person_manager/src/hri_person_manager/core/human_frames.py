"""Frames of the humans that are tracked now: the latest transform of each, freed when the human is gone.

tf2 keeps every frame that it ever saw. The frames of humans come and go by the thousand, so they are kept
here, and only while their identifier is tracked.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Dict, Iterable, List, NamedTuple, Optional, Set, Tuple

from hri_person_manager.core.features import Kind
from hri_person_manager.core.location import PlaceSource
from hri_pipeline.core.geometry import Pose

_PREFIX = {Kind.FACE: ("face",), Kind.VOICE: ("voice",)}
MAX_PENDING_STATICS = 500
MAX_LINKS = 64
MAX_WANTED = 10000


Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]
Transform = Tuple[Vector, Quaternion]
_STILL: Transform = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


class FrameLink(NamedTuple):
    """Transform of one frame that maps its coordinates to `parent`, at `stamp` (s; infinite for a fixed one).

    translation: m. rotation: x, y, z, w. arrived: s; NaN where that is not known.
    """

    parent: str
    translation: Vector
    rotation: Quaternion
    stamp: float
    arrived: float = math.nan

    @property
    def pose(self) -> Pose:
        """The transform; ValueError when its numbers are none."""
        if not math.isfinite(sum(self.translation)):
            raise ValueError("a translation holds numbers that are not finite")
        return Pose.from_quaternion(self.rotation, self.translation)


class FeaturePose(NamedTuple):
    """A feature placed in the frame of its sensor: `pose` maps its coordinates to `sensor` (m)."""

    source: PlaceSource
    id: str
    sensor: str
    pose: Pose
    stamp: float


class HumanFrames:
    """Latest links of the frames face_ID, voice_ID and, for bodies, all from head_ID to body_ID, or to a sensor."""

    def __init__(self, source_timeout: float) -> None:
        """A head that is by more than `source_timeout` s older, and came so much earlier, than its body is not used."""
        self._source_timeout = source_timeout
        self._tracked: Dict[Kind, Set[str]] = {Kind.FACE: set(), Kind.BODY: set(), Kind.VOICE: set()}
        self._links: Dict[Tuple[Kind, str], Dict[str, FrameLink]] = {}
        self._statics: "OrderedDict[str, FrameLink]" = OrderedDict()
        self._wanted: Dict[str, Tuple[Kind, str]] = {}
        self._tops: Dict[str, str] = {}

    def __len__(self) -> int:
        """Return the number of frames kept."""
        return len(self._statics) + sum(len(links) for links in self._links.values())

    def set_tracked(self, kind: Kind, ids: Iterable[str]) -> List[FeaturePose]:
        """Follow these identifiers of one kind; what was kept of the others is freed.

        Returns where fixed links that came before their feature was listed place it.
        """
        ids = set(ids)
        gone = self._tracked[kind] - ids
        for identity in gone:
            self._links.pop((kind, identity), None)
            if kind == Kind.BODY:
                self._tops.pop(identity, None)
        if gone:
            self._wanted = {frame: owner for frame, owner in self._wanted.items()
                            if owner[0] != kind or owner[1] not in gone}
        self._tracked[kind] = ids
        for identity in ids:
            names = ("body", "head") if kind == Kind.BODY else _PREFIX[kind]
            self._wanted.update(("{}_{}".format(name, identity), (kind, identity)) for name in names)
        return self._use_pending_statics()

    def _use_pending_statics(self) -> List[FeaturePose]:
        found: List[Optional[FeaturePose]] = []
        for frame in list(self._statics):
            owner = self.owner(frame)
            if owner is None:
                continue
            try:
                found.append(self.put(owner, frame, self._statics.pop(frame)))
            except ValueError:
                continue
        return [feature_pose for feature_pose in found if feature_pose is not None]

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

    def put(self, owner: Tuple[Kind, str], frame: str, link: FrameLink) -> Optional[FeaturePose]:
        """Keep a link of a tracked feature; returns where that places the feature, None if it does not.

        Raises ValueError for numbers that are none.
        """
        links = self._links.setdefault(owner, {})
        if frame not in links and len(links) >= MAX_LINKS:
            return None
        kind, identity = owner
        if kind != Kind.BODY:
            source = PlaceSource.FACE if kind == Kind.FACE else PlaceSource.VOICE
            direct = FeaturePose(source, identity, link.parent, link.pose, link.stamp)
            links[frame] = link
            return direct
        if not _is_legal(link):
            raise ValueError("a transform holds numbers that are not finite, or a quaternion of zeros")
        before = links.get(frame)
        links[frame] = link
        changed = before is None or before.parent != link.parent or math.isinf(before.stamp) != math.isinf(link.stamp)
        if changed:
            self._tops[identity] = self._follow_head(identity, links)
        top = self._tops.get(identity, "")
        feature_pose = self._place_by_head(identity, links, top) if top and (changed or frame == top) else None
        if feature_pose is None and frame == "body_" + identity:
            return FeaturePose(PlaceSource.BODY, identity, link.parent, link.pose, link.stamp)
        return feature_pose

    def keep_static(self, frame: str, link: FrameLink) -> None:
        """Keep a fixed link that may belong to a body of which the tracked list tells later."""
        self._statics[frame] = link
        self._statics.move_to_end(frame)
        while len(self._statics) > MAX_PENDING_STATICS:
            self._statics.popitem(last=False)

    def clear(self) -> None:
        """Forget all moving links, not who is tracked: a fixed one never comes again."""
        self._tops.clear()
        for owner, links in self._links.items():
            self._links[owner] = {frame: link for frame, link in links.items() if math.isinf(link.stamp)}

    def _follow_head(self, identity: str, links: Dict[str, FrameLink]) -> str:
        """Want the frames above the head; return the highest that moves, empty while the way to a sensor is not known.

        By body_ID, where that is one of them; else the head alone places the body.
        """
        frame, top = "head_" + identity, ""
        for _ in range(len(links)):
            if frame not in links:
                return "" if self.owner(frame) == (Kind.BODY, identity) else top
            if not top or not math.isinf(links[frame].stamp):
                top = frame
            frame = links[frame].parent
            if self.owner(frame) == (Kind.BODY, identity) and len(self._wanted) < MAX_WANTED:
                self._wanted[frame] = (Kind.BODY, identity)
        return "" if frame in links or self.owner(frame) == (Kind.BODY, identity) else top

    def _place_by_head(self, identity: str, links: Dict[str, FrameLink], top: str) -> Optional[FeaturePose]:
        """Place a body by the links from its head to the sensor; None when one of them is old."""
        newest = links[top]
        frame, motion = "head_" + identity, _STILL
        while frame in links:
            link = links[frame]
            if newest.stamp - link.stamp > self._source_timeout and not (
                    newest.arrived - link.arrived <= self._source_timeout):
                return None
            frame, motion = link.parent, _after((link.translation, link.rotation), motion)
        return FeaturePose(PlaceSource.HEAD, identity, frame, _to_pose(motion), newest.stamp)


def _is_legal(link: FrameLink) -> bool:
    # A sum is finite when all of its numbers are.
    x, y, z, w = link.rotation
    return math.isfinite(sum(link.translation)) and 1e-18 < x * x + y * y + z * z + w * w < math.inf


def _after(first: Transform, second: Transform) -> Transform:
    """Return first * second: the second transform, then the first."""
    (x, y, z), (a, b, c, d) = first
    (u, v, w), (e, f, g, h) = second
    # Rotate (u, v, w) by the quaternion (a, b, c; d): t = 2 q x v; v + d t + q x t.
    scale = 2.0 / (a * a + b * b + c * c + d * d)
    i, j, k = scale * (b * w - c * v), scale * (c * u - a * w), scale * (a * v - b * u)
    return ((x + u + d * i + b * k - c * j, y + v + d * j + c * i - a * k, z + w + d * k + a * j - b * i),
            (d * e + a * h + b * g - c * f, d * f - a * g + b * h + c * e,
             d * g + a * f - b * e + c * h, d * h - a * e - b * f - c * g))


def _to_pose(motion: Transform) -> Pose:
    return Pose.from_quaternion(motion[1], motion[0])
