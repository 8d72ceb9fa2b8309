"""Where frames were in the last seconds: as tf2's buffer, but freed when nobody uses it any more.

tf2 never forgets the name of a frame, nor a fixed one, and the memory of a buffer is never given back.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import OrderedDict
from typing import Dict, List, NamedTuple, Optional, Tuple

from hri_pipeline.core.frames import RawTransform
from hri_pipeline.core.geometry import Pose

Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]
_LONGEST_WAY = 200      # links from a frame to its root; a loop has more


class _Link(NamedTuple):
    """Where a frame was in its parent: stamp s, quaternion x, y, z, w of length 1, position m."""

    stamp: float
    parent: str
    rotation: Quaternion
    translation: Vector


class _Step(NamedTuple):
    """Pose of the first frame of a way in an ancestor."""

    frame: str
    rotation: Quaternion
    translation: Vector


_HERE: Tuple[Quaternion, Vector] = ((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


class FrameHistory:
    """The transforms of the last `span` s, and the fixed ones. Not thread-safe."""

    def __init__(self, span: float) -> None:
        self._span = span
        self._moving: Dict[str, List[_Link]] = {}
        self._fixed: Dict[str, _Link] = {}

    def put(self, transform: RawTransform, fixed: bool) -> None:
        """Take a transform; one of a stamp that is known takes the place of that one."""
        length = math.sqrt(sum(value * value for value in transform.rotation))
        x, y, z, w = (value / length for value in transform.rotation)
        link = _Link(transform.stamp, transform.parent, (x, y, z, w), transform.translation)
        if fixed:
            self._moving.pop(transform.child, None)
            self._fixed[transform.child] = link
            return
        self._fixed.pop(transform.child, None)
        links = self._moving.setdefault(transform.child, [])
        if not links or link.stamp > links[-1].stamp:
            links.append(link)
        else:
            place = bisect_left(links, (link.stamp,))
            links[place:place + (links[place].stamp == link.stamp)] = [link]
        while links[0].stamp < links[-1].stamp - self._span:
            del links[0]

    def clear(self) -> None:
        """Forget all transforms."""
        self._moving.clear()
        self._fixed.clear()

    def between(self, target: str, frame: str, stamp: Optional[float]) -> Optional[Pose]:
        """Return the pose of a frame in another one at a time (s), interpolated.

        stamp None: the latest time that all links on the way know. None where no way leads from one to the other at
        that time.
        """
        if stamp is None:
            stamp = self._latest_common(target, frame)
            if stamp is None:
                return None
        rising = OrderedDict((step.frame, step) for step in self._way(frame, stamp))
        for step in self._way(target, stamp):
            if step.frame in rising:
                below = rising[step.frame]
                x, y, z, w = step.rotation
                back = (-x, -y, -z, w)
                offset = tuple(a - b for a, b in zip(below.translation, step.translation))
                return Pose.from_quaternion(_product(back, below.rotation),
                                            _turned(back, offset))  # type: ignore[arg-type]
        return None

    def _latest_common(self, target: str, frame: str) -> Optional[float]:
        """Latest time (s) at which all moving links of the way are known; infinity where it has none, None without a
        way."""
        times: Dict[str, float] = {}
        latest = math.inf
        current: Optional[str] = frame
        while current is not None and current not in times and len(times) < _LONGEST_WAY:
            times[current] = latest
            link = self._newest(current)
            if link is not None and current in self._moving:
                latest = min(latest, link.stamp)
            current = link.parent if link is not None else None
        latest, current, passed = math.inf, target, 0
        while current is not None and passed < _LONGEST_WAY:
            if current in times:
                return min(latest, times[current])
            link = self._newest(current)
            if link is not None and current in self._moving:
                latest = min(latest, link.stamp)
            current, passed = (link.parent if link is not None else None), passed + 1
        return None

    def _newest(self, frame: str) -> Optional[_Link]:
        links = self._moving.get(frame)
        return links[-1] if links else self._fixed.get(frame)

    def _way(self, frame: str, stamp: float) -> List[_Step]:
        """The frame and its ancestors, as far as the links are known at `stamp`, with the pose of the frame in each."""
        steps = [_Step(frame, *_HERE)]
        while len(steps) < _LONGEST_WAY:
            last = steps[-1]
            link = self._at(last.frame, stamp)
            if link is None:
                break
            position = _turned(link.rotation, last.translation)
            steps.append(_Step(link.parent, _product(link.rotation, last.rotation),
                               (position[0] + link.translation[0], position[1] + link.translation[1],
                                position[2] + link.translation[2])))
        return steps

    def _at(self, frame: str, stamp: float) -> Optional[_Link]:
        """The link of a frame at a time, None outside what is known."""
        links = self._moving.get(frame)
        if not links:
            return self._fixed.get(frame)
        place = bisect_left(links, (stamp,))
        if place < len(links) and links[place].stamp == stamp:
            return links[place]
        if place in (0, len(links)):
            return None
        return _interpolated(links[place - 1], links[place], stamp)


def _interpolated(before: _Link, after: _Link, stamp: float) -> _Link:
    """Between two links of one parent; where the parent has changed, the earlier one."""
    if before.parent != after.parent:
        return before
    part = (stamp - before.stamp) / (after.stamp - before.stamp)
    x, y, z = (a + part * (b - a) for a, b in zip(before.translation, after.translation))
    return _Link(stamp, before.parent, _slerp(before.rotation, after.rotation, part), (x, y, z))


def _slerp(first: Quaternion, second: Quaternion, part: float) -> Quaternion:
    """Rotation between two, along the shorter arc (Shoemake 1985)."""
    cosine = sum(a * b for a, b in zip(first, second))
    sign = 1.0 if cosine >= 0.0 else -1.0
    angle = math.acos(min(1.0, abs(cosine)))
    if angle < 1e-6:
        weights = 1.0 - part, sign * part
    else:
        weights = math.sin((1.0 - part) * angle) / math.sin(angle), sign * math.sin(part * angle) / math.sin(angle)
    x, y, z, w = (weights[0] * a + weights[1] * b for a, b in zip(first, second))
    return x, y, z, w


def _product(first: Quaternion, second: Quaternion) -> Quaternion:
    """Rotation by `second`, then by `first`."""
    (ax, ay, az, aw), (bx, by, bz, bw) = first, second
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def _turned(rotation: Quaternion, vector: Vector) -> Vector:
    """A vector after a rotation."""
    (x, y, z, w), (a, b, c) = rotation, vector
    tx, ty, tz = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx
