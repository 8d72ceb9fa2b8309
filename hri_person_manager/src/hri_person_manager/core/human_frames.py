"""Frames of the humans that are tracked now: the latest transform of each, freed when the human is gone.

tf2 keeps every frame that it ever saw. The frames of humans come and go by the thousand, so they are kept
here, and only while their identifier is tracked.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Dict, Iterable, NamedTuple, Optional, Set, Tuple

from hri_person_manager.core.association import Kind
from hri_person_manager.core.location import Source
from hri_pipeline.core.geometry import Pose

_PREFIX = {Kind.FACE: ("face",), Kind.VOICE: ("voice",)}
MAX_UNCLAIMED_STATICS = 500
MAX_LINKS = 64


class Link(NamedTuple):
    """Transform of one frame: `pose` maps its coordinates to `parent` (m), at `stamp` (s)."""

    parent: str
    pose: Pose
    stamp: float


class Sighting(NamedTuple):
    """A feature placed in the frame of its sensor: `pose` maps its coordinates to `sensor` (m)."""

    source: Source
    id: str
    sensor: str
    pose: Pose
    stamp: float


class HumanFrames:
    """Latest links of the frames face_ID, voice_ID and, for bodies, of every link *_ID."""

    def __init__(self, source_timeout: float) -> None:
        """A head frame older than the body frame by more than `source_timeout` s is not used."""
        self._source_timeout = source_timeout
        self._tracked: Dict[Kind, Set[str]] = {Kind.FACE: set(), Kind.BODY: set(), Kind.VOICE: set()}
        self._links: Dict[Tuple[Kind, str], Dict[str, Link]] = {}
        self._statics: "OrderedDict[str, Link]" = OrderedDict()

    def __len__(self) -> int:
        """Return the number of frames kept."""
        return len(self._statics) + sum(len(links) for links in self._links.values())

    def set_tracked(self, kind: Kind, ids: Iterable[str]) -> None:
        """Follow these identifiers of one kind; what was kept of the others is freed."""
        ids = set(ids)
        for gone in self._tracked[kind] - ids:
            self._links.pop((kind, gone), None)
        self._tracked[kind] = ids
        for frame in list(self._statics):
            owner = self.owner(frame)
            if owner is not None:
                self._links.setdefault(owner, {})[frame] = self._statics.pop(frame)

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
        """Keep a link of a tracked feature; returns where that places the feature, None if it does not."""
        links = self._links.setdefault(owner, {})
        if frame not in links and len(links) >= MAX_LINKS:
            return None
        links[frame] = link
        kind, identity = owner
        if kind == Kind.FACE:
            return Sighting(Source.FACE, identity, link.parent, link.pose, link.stamp)
        if kind == Kind.VOICE:
            return Sighting(Source.VOICE, identity, link.parent, link.pose, link.stamp)
        if frame != "body_" + identity:
            return None
        return self._place_body(identity, links, link)

    def keep_static(self, frame: str, link: Link) -> None:
        """Keep a fixed link that may belong to a body of which the tracked list tells later."""
        self._statics[frame] = link
        self._statics.move_to_end(frame)
        while len(self._statics) > MAX_UNCLAIMED_STATICS:
            self._statics.popitem(last=False)

    def clear(self) -> None:
        """Forget all links, not who is tracked."""
        self._links.clear()

    def _place_body(self, identity: str, links: Dict[str, Link], root: Link) -> Sighting:
        """Place a body by its head when the chain of links from there to the body frame is complete."""
        head = links.get("head_" + identity)
        if head is not None and head.stamp >= root.stamp - self._source_timeout:
            pose, parent = head.pose, head.parent
            for _ in range(len(links)):
                if parent == "body_" + identity:
                    return Sighting(Source.HEAD, identity, root.parent, root.pose.compose(pose), root.stamp)
                if parent == root.parent:
                    return Sighting(Source.HEAD, identity, root.parent, pose, root.stamp)
                above = links.get(parent)
                if above is None:
                    break
                pose, parent = above.pose.compose(pose), above.parent
        return Sighting(Source.BODY, identity, root.parent, root.pose, root.stamp)
