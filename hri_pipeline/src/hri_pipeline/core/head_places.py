"""Where faces and the heads of skeletons are, out of the transforms of the graph: only those of who is tracked are kept."""

from __future__ import annotations

import math
from typing import Dict, Iterable, List, NamedTuple, Optional, Tuple

from hri_pipeline.core.tf_scan import RawTransform

MAX_LINKS = 12             # between the head and the camera; the neck has three joints
MAX_APART_S = 0.15         # of the stamps along the way
Vector = Tuple[float, float, float]


class HeadPlace(NamedTuple):
    """Position (m) of a face or of a skeleton's head in the frame of its camera, at `stamp` (s)."""

    kind: str
    id: str
    frame: str
    position: Vector
    stamp: float


class HeadPlaces:
    """Follows face_ID, and the way from head_ID up to the camera."""

    def __init__(self) -> None:
        self._tracked: Dict[str, List[str]] = {"faces": [], "bodies": []}
        self._wanted: Dict[bytes, Tuple[str, str]] = {}
        self._links: Dict[str, Tuple[RawTransform, bool]] = {}

    def set_tracked(self, kind: str, ids: Iterable[str]) -> None:
        """Follow these "faces" or "bodies"; the frames of others are let go."""
        self._tracked[kind] = list(ids)
        self._wanted = {"face_{}".format(id).encode(): ("faces", id) for id in self._tracked["faces"]}
        for id in self._tracked["bodies"]:
            self._wanted["head_{}".format(id).encode()] = ("bodies", id)
        kept = {}
        for child, (kind_of, id) in list(self._wanted.items()):
            for frame in self._way(child.decode()):
                if frame in self._links:
                    kept[frame] = self._links[frame]
                self._wanted[frame.encode()] = (kind_of, id)
        self._links = kept

    @property
    def wanted(self) -> int:
        """Number of the frames that are followed; it grows when the next link of a way becomes known."""
        return len(self._wanted)

    def wants(self, child: bytes) -> bool:
        """Tell whether the transform of a frame is to be put(); one asks again after each put()."""
        return child.lstrip(b"/") in self._wanted

    def put(self, transform: RawTransform, fixed: bool) -> Optional[HeadPlace]:
        """Take a transform; returns the place that follows from it, None when there is none yet."""
        owner = self._wanted.get(transform.child.encode())
        if owner is None:
            return None
        self._links[transform.child] = (transform, fixed)
        kind, id = owner
        above = transform.parent.encode()
        if kind == "bodies" and transform.parent.endswith("_" + id) and above not in self._wanted:
            self._wanted[above] = owner
        return self._place(kind, id)

    def _way(self, frame: str) -> List[str]:
        way = [frame]
        while way[-1] in self._links and len(way) <= MAX_LINKS:
            parent = self._links[way[-1]][0].parent
            if not parent.endswith(frame[frame.index("_"):]):
                break
            way.append(parent)
        return way

    def _place(self, kind: str, id: str) -> Optional[HeadPlace]:
        way = self._way(("face_" if kind == "faces" else "head_") + id)
        if way[-1] not in self._links:
            return None
        position: Vector = (0.0, 0.0, 0.0)
        stamps = []
        for frame in way:
            transform, fixed = self._links[frame]
            position = _moved(position, transform)
            if not fixed:
                stamps.append(transform.stamp)
        if not stamps or max(stamps) - min(stamps) > MAX_APART_S or not all(math.isfinite(value) for value in position):
            return None
        return HeadPlace(kind, id, self._links[way[-1]][0].parent, position, min(stamps))


def _moved(point: Vector, transform: RawTransform) -> Vector:
    """Coordinates of a point of the child frame in the parent frame, m."""
    x, y, z = point
    a, b, c, d = transform.rotation
    square = a * a + b * b + c * c + d * d
    if not square > 1e-18:
        return math.nan, math.nan, math.nan
    # v + d t + q x t with t = 2 q x v.
    s = 2.0 / square
    t, u, v = s * (b * z - c * y), s * (c * x - a * z), s * (a * y - b * x)
    p, q, r = transform.translation
    return p + x + d * t + b * v - c * u, q + y + d * u + c * t - a * v, r + z + d * v + a * u - b * t
