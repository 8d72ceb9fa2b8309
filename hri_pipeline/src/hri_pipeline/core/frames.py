"""Frames of /tf: reading serialised messages, where the frames of the robot were in the last seconds, and the frames
of humans.

Ten skeletons are some 3000 transforms per second; to make message objects of all of them costs more than 10 % of a core
in each Python process that listens, to look at the names alone about 1 % (measured).
"""

from __future__ import annotations

import math
import struct
from bisect import bisect_left
from collections import OrderedDict
from functools import lru_cache
from typing import Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple

from hri_pipeline.core.geometry import Pose, Quaternion, Vector, quaternion_product, rotate, slerp, unit_quaternion

# geometry_msgs/TransformStamped as roscpp and rospy serialise it: seq, secs, nsecs, parent, child, 7 numbers.
_LENGTH = struct.Struct("<I")
_TIMES = struct.Struct("<II")
_HEAD = struct.Struct("<4I")
_NUMBERS = struct.Struct("<7d")
_PARENT_AT = 12
_REMEMBERED = 2048
_LONGEST = 256          # bytes of two names that are remembered
# durations are 32 bits with a sign: tf2 ends the process that reckons with such a stamp
_FIRST_BAD_SECOND = 2 ** 31 - 1
_NSECS = 10 ** 9
FARTHEST_M = 1e9
"""Of the origin of a frame from its parent: beyond the Earth, and its square can be reckoned with."""


class RawTransform(NamedTuple):
    """A transform; names without a leading slash. translation: x, y, z m. rotation: quaternion x, y, z, w."""

    parent: str
    child: str
    secs: int
    nsecs: int
    translation: Vector
    rotation: Quaternion

    @property
    def stamp(self) -> float:
        """Stamp in s."""
        return self.secs + 1e-9 * self.nsecs

    @property
    def is_pose(self) -> bool:
        """Whether all numbers are finite, the quaternion is one, and the place is not beyond FARTHEST_M."""
        (a, b, c), (x, y, z, w) = self.translation, self.rotation
        return abs(a) + abs(b) + abs(c) <= FARTHEST_M and 1e-9 < x * x + y * y + z * z + w * w < math.inf


def scan(data: bytes) -> List[Tuple[bytes, int]]:
    """Return child frame, as it is in the message, and offset of each transform of a serialised TFMessage.

    Raises ValueError for bytes that are no such message.
    """
    length = _LENGTH.unpack_from
    found: List[Tuple[bytes, int]] = []
    try:
        count, offset = length(data, 0)[0], 4
        for _ in range(count):
            child_at = offset + _PARENT_AT + 4 + length(data, offset + _PARENT_AT)[0]
            end = child_at + 4 + length(data, child_at)[0]
            found.append((data[child_at + 4:end], offset))
            offset = end + _NUMBERS.size
    except struct.error as error:
        raise ValueError("a TFMessage is cut off: {}".format(error)) from error
    if offset != len(data):
        raise ValueError("a TFMessage of {} bytes says that it has {}".format(len(data), offset))
    return found


def is_stamp(secs: int, nsecs: int) -> bool:
    """Tell whether ROS can reckon with a stamp."""
    return 0 <= secs < _FIRST_BAD_SECOND and 0 <= nsecs < _NSECS


def check_stamp(secs: int, nsecs: int) -> None:
    """Raise ValueError for a stamp with which ROS cannot reckon."""
    if not is_stamp(secs, nsecs):
        raise ValueError("the stamp {} s {} ns is no time".format(secs, nsecs))


def read(data: bytes, offset: int) -> RawTransform:
    """Return the transform at an offset that scan() has given.

    Raises ValueError if its stamp is none (check_stamp()).
    """
    _, secs, nsecs, length = _HEAD.unpack_from(data, offset)
    check_stamp(secs, nsecs)
    offset += _PARENT_AT
    end = offset + 8 + length
    end += _LENGTH.unpack_from(data, end - 4)[0]
    names = data[offset:end]
    # The same few frames come all the time.
    parent, child = _known_names(names) if len(names) <= _LONGEST else _names(names)
    numbers = _NUMBERS.unpack_from(data, end)
    return RawTransform(parent, child, secs, nsecs, numbers[:3], numbers[3:])


def read_stamp(data: bytes, offset: int) -> Tuple[int, int]:
    """Return seconds and nanoseconds of the stamp of the transform at an offset that scan() has given.

    Raises ValueError if it is none.
    """
    secs, nsecs = _TIMES.unpack_from(data, offset + 4)
    check_stamp(secs, nsecs)
    return secs, nsecs


def read_parent(data: bytes, offset: int) -> bytes:
    """Return the parent, as it is in the message, of the transform at an offset that scan() has given."""
    begin = offset + _PARENT_AT + 4
    return data[begin:begin + _LENGTH.unpack_from(data, begin - 4)[0]]


def _names(data: bytes) -> Tuple[str, str]:
    """Return parent and child out of their lengths and texts."""
    middle = 4 + _LENGTH.unpack_from(data)[0]
    parent, child = data[4:middle], data[middle + 4:]
    return parent.decode("utf-8", "replace").lstrip("/"), child.decode("utf-8", "replace").lstrip("/")


_known_names = lru_cache(maxsize=_REMEMBERED)(_names)


# Frames of humans come and go by the thousand, and no way of the robot leads over one. Not body_ and head_: robots have
# links of such names (head_1_link, head_pan_link, body_link) on the way to their cameras.
_OF_HUMANS = (b"face_", b"gaze_", b"voice_", b"person_")
MAX_FRAMES = 1000       # frames whose latest transform is remembered, in case they become relevant; 1 kB each
MAX_FOLLOWED = 500
_LONGEST_WAY = 200      # links from a frame to its root; a loop has more
# A frame whose transforms come at least so often (s) is waited for, and goes on as it moved for so long (s).
_LONGEST_PERIOD_S, AHEAD_S = 0.15, 0.2
# Times (s) over which a motion is measured, and what is one (m, rad): two, as a swing may be back at the same place.
_SPANS_S = (0.06, 0.13)
_PAUSES_S = (*_SPANS_S, 0.5, 1.0, 2.0)   # a camera that stood for so long may start again
_MOVED_M, _MOVED_RAD = 0.003, math.radians(0.15)
_STEADY = 0.5           # largest change of a speed that goes on, as a part of it


def is_of_human(child: bytes, fixed: bool) -> bool:
    """Tell whether a frame of that name is a human's.

    A fixed one (/tf_static) never is: a robot may have a face_plate_link.
    """
    return not fixed and child.lstrip(b"/").startswith(_OF_HUMANS)


def is_optical(frame: str) -> bool:
    """Tell by its name whether z of a frame points where it looks and y down (REP-103); else z points up."""
    return "optical" in frame


class _Link(NamedTuple):
    """Where a frame was in its parent: stamp s, quaternion x, y, z, w, position m."""

    stamp: float
    parent: str
    rotation: Quaternion
    translation: Vector


class FrameHistory:
    """Where the frames of the robot were in the last seconds: as tf2's buffer, but bounded. Not thread-safe.

    Of a frame that nobody follows only the latest transform is kept, in case it becomes relevant; when there are
    too many of these, moving ones go first: a fixed one never comes again. tf2 never forgets the name of a frame, nor a
    fixed one, and the memory of a buffer is never given back.
    """

    def __init__(self, span: float, max_frames: int = MAX_FRAMES) -> None:
        """Remember at most `max_frames` frames, and the transforms of the last `span` s of those that are followed."""
        self._span = span
        self._max_frames = max_frames
        self._moving: "OrderedDict[str, List[_Link]]" = OrderedDict()
        self._fixed: "OrderedDict[str, _Link]" = OrderedDict()
        self._followed: Set[str] = set()

    def __len__(self) -> int:
        """Return the number of frames remembered."""
        return len(self._moving) + len(self._fixed)

    @property
    def followed(self) -> Set[str]:
        """Return the frames whose history is kept."""
        return set(self._followed)

    def newest_stamp(self, frame: str) -> Optional[float]:
        """Return the stamp (s) of the latest transform of a frame, None if it is unknown."""
        link = self._newest(frame)
        return None if link is None else link.stamp

    def put(self, transform: RawTransform, fixed: bool) -> None:
        """Take a transform; one of a stamp that is known takes the place of that one."""
        parent, child, _, _, translation, rotation = transform
        link = _Link(transform.stamp, parent, rotation, translation)
        if fixed:
            self._moving.pop(child, None)
            self._fixed[child] = link
            self._fixed.move_to_end(child)
        else:
            self._fixed.pop(child, None)
            links = self._moving.setdefault(child, [])
            self._moving.move_to_end(child)
            if child in self._followed:
                place = bisect_left(links, (link.stamp,))
                links[place:place + (place < len(links) and links[place].stamp == link.stamp)] = [link]
                while links[0].stamp < links[-1].stamp - self._span:
                    del links[0]
            else:
                links[:] = [link]
        if len(self) > self._max_frames:
            self._drop_oldest()
        if child in self._followed:
            self.follow(parent)

    def follow(self, frame: str) -> None:
        """Keep the history of a frame and of all above it from now on."""
        while frame not in self._followed and len(self._followed) < MAX_FOLLOWED:
            self._followed.add(frame)
            link = self._newest(frame)
            if link is None:
                return
            frame = link.parent

    def forget_moving(self) -> None:
        """Forget the moving frames, as after a time jump."""
        self._moving.clear()

    def between(self, target: str, frame: str, stamp: Optional[float]) -> Optional[Pose]:
        """Return the pose of a frame in another one at a time (s), interpolated.

        stamp None: the latest time that all links on the way know. None where no way leads from one to the other at
        that time.
        """
        if stamp is None:
            stamp = self._latest_common(target, frame)
            if stamp is None:
                return None
        return self._pose(self._way(frame, stamp), self._way(target, stamp))

    @staticmethod
    def _pose(below: Dict[str, Tuple[Quaternion, Vector]], above: Dict[str, Tuple[Quaternion, Vector]]
              ) -> Optional[Pose]:
        """The pose of the frame of one way in that of another one; None where they do not meet."""
        common = next((ancestor for ancestor in above if ancestor in below), None)
        if common is None:
            return None
        (rotation, (a, b, c)), ((x, y, z, w), (d, e, f)) = below[common], above[common]
        back = (-x, -y, -z, w)
        return Pose.from_quaternion(quaternion_product(back, rotation), rotate(back, (a - d, b - e, c - f)))

    def ahead(self, target: str, frame: str, stamp: float) -> Optional[Pose]:
        """Return the same for a time (s) that not all links know yet: those that lag stay, or go on as they moved.

        None where no way leads from one to the other.
        """
        return self._pose(self._way(frame, stamp, True), self._way(target, stamp, True))

    def lags(self, target: str, frame: str, stamp: float) -> bool:
        """Tell whether a link that moves is not known yet at a time (s), but soon will be."""
        return any(links[-1].stamp < stamp <= links[-1].stamp + AHEAD_S + _LONGEST_PERIOD_S and self._moves(link, links)
                   for link, links in self._between_frames(target, frame))

    def moves_until(self, target: str, frame: str) -> Optional[float]:
        """Return until when (s) all links that move and come often are known; None where none is."""
        return min((links[-1].stamp for link, links in self._between_frames(target, frame) if self._moves(link, links)),
                   default=None)

    def _between_frames(self, target: str, frame: str) -> Iterator[Tuple[str, List[_Link]]]:
        """Yield what is known of each frame on the way that was heard of twice at least; none without a way."""
        below, above = list(self._known_until(frame)), list(self._known_until(target))
        common = [ancestor for ancestor in above if ancestor in below][:1]
        for way in (below, above):
            yield from ((link, self._moving[link]) for ancestor in common for link in way[:way.index(ancestor)]
                        if len(self._moving.get(link, ())) > 1)

    def _moves(self, frame: str, links: List[_Link]) -> bool:
        """Tell whether a link comes often, and has moved a moment ago."""
        before = (self._at(frame, links[-1].stamp - span) for span in _PAUSES_S)
        return links[-1].stamp - links[-2].stamp <= _LONGEST_PERIOD_S and any(
            link is not None and _has_moved(link, links[-1]) for link in before)

    def _latest_common(self, target: str, frame: str) -> Optional[float]:
        """Latest time (s) at which all moving links of the way are known; infinity without any, None without a way."""
        below, above = self._known_until(frame), self._known_until(target)
        return next((min(latest, below[ancestor]) for ancestor, latest in above.items() if ancestor in below), None)

    def _known_until(self, frame: str) -> Dict[str, float]:
        """The frame and its ancestors, with the latest time (s) at which all moving links up to each are known."""
        times: Dict[str, float] = {}
        latest = math.inf
        while frame not in times and len(times) < _LONGEST_WAY:
            times[frame] = latest
            link = self._newest(frame)
            if link is None:
                break
            if frame in self._moving:
                latest = min(latest, link.stamp)
            frame = link.parent
        return times

    def _newest(self, frame: str) -> Optional[_Link]:
        links = self._moving.get(frame)
        return links[-1] if links else self._fixed.get(frame)

    def _way(self, frame: str, stamp: float, ahead: bool = False) -> Dict[str, Tuple[Quaternion, Vector]]:
        """The frame and its ancestors, as far as the links are known at `stamp`, or `ahead` of what is known: the pose
        of the frame in each."""
        rotation, position = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
        poses: Dict[str, Tuple[Quaternion, Vector]] = {}
        while frame not in poses and len(poses) < _LONGEST_WAY:
            poses[frame] = rotation, position
            link = self._at(frame, stamp)
            if link is None and ahead:
                link = self._beyond(frame, stamp)
            if link is None:
                break
            own, (a, b, c) = unit_quaternion(link.rotation), link.translation
            x, y, z = rotate(own, position)
            frame, rotation, position = link.parent, quaternion_product(own, rotation), (a + x, b + y, c + z)
        return poses

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

    def _beyond(self, frame: str, stamp: float) -> Optional[_Link]:
        """The link of a frame at a time after what is known: as it moved where that was steady, else the newest."""
        links = self._moving.get(frame)
        if not links or stamp < links[0].stamp:
            return None
        newest = links[-1]
        before, earlier = (self._at(frame, newest.stamp - span) for span in _SPANS_S)
        if before is None or earlier is None or not _is_steady(earlier, before, newest):
            return newest
        time = min(stamp, newest.stamp + AHEAD_S)
        return _interpolated(before, newest, time)._replace(stamp=stamp)

    def _drop_oldest(self) -> None:
        """Drop the oldest frame nobody follows, a moving one if there is one; else the oldest of all."""
        for frames in (self._moving, self._fixed):
            oldest = next((child for child in frames if child not in self._followed), None)
            if oldest is not None:
                del frames[oldest]
                return
        (self._moving or self._fixed).popitem(last=False)


def _interpolated(before: _Link, after: _Link, stamp: float) -> _Link:
    """Between two links of one parent; where the parent has changed, the earlier one."""
    if before.parent != after.parent:
        return before
    part = (stamp - before.stamp) / (after.stamp - before.stamp)
    x, y, z = (a + part * (b - a) for a, b in zip(before.translation, after.translation))
    return _Link(stamp, before.parent, slerp(before.rotation, after.rotation, part), (x, y, z))


def _has_moved(one: _Link, other: _Link) -> bool:
    way, turn = _between(one, other)
    return math.hypot(*way) > _MOVED_M or math.hypot(*turn) > _MOVED_RAD


def _between(one: _Link, other: _Link) -> Tuple[Vector, Vector]:
    """Way (m) and turn (rad, as a vector) from one link of a frame to another, later one."""
    (a, b, c), (d, e, f) = one.translation, other.translation
    (x, y, z, w), last = unit_quaternion(one.rotation), unit_quaternion(other.rotation)
    i, j, k, real = quaternion_product(last, (-x, -y, -z, w))
    scale = 2.0 if real >= 0.0 else -2.0
    return (d - a, e - b, f - c), (scale * i, scale * j, scale * k)


def _is_steady(earlier: _Link, before: _Link, newest: _Link) -> bool:
    """Tell whether a frame moves, and did so before: a jump, or a start, does not go on."""
    if not _has_moved(before, newest) or not earlier.parent == before.parent == newest.parent:
        return False
    since, until = newest.stamp - before.stamp, before.stamp - earlier.stamp
    for now, then, least in zip(_between(before, newest), _between(earlier, before), (_MOVED_M, _MOVED_RAD)):
        speed, last = [value / since for value in now], [value / until for value in then]
        change = math.sqrt(sum((one - other) ** 2 for one, other in zip(speed, last)))
        if change > max(least / since, _STEADY * max(math.hypot(*speed), math.hypot(*last))):
            return False
    return True


MAX_LINKS = 64
"""Most links between a frame of a human and the frame of the sensor: a loop ends there."""
MAX_UNCLAIMED = 2000
MAX_WANTED = 10000
_MAX_LIMBS = 5000


class Timed(NamedTuple):
    """A transform; a fixed one is as new as the newest (stamp infinite). arrived: s; NaN where that is not known."""

    transform: RawTransform
    stamp: float
    arrived: float = math.nan


def composed(chain: Sequence[Timed]) -> Pose:
    """Return the pose of the lowest frame of a chain of transforms, one at least, in the one above all of them."""
    link = chain[0].transform
    rotation, position = link.rotation, link.translation
    for timed in chain[1:]:
        link = timed.transform
        (x, y, z), (i, j, k) = link.translation, rotate(link.rotation, position)
        rotation, position = quaternion_product(link.rotation, rotation), (x + i, y + j, z + k)
    return Pose.from_quaternion(rotation, position)


class HumanTf:
    """Latest transforms of the frames of humans that are followed, and of the links above them up to the frame of the
    sensor.

    A frame is <kind>_<id>, for example face_f1, and the next one above it belongs to the same human when its name ends
    with the same id. What is kept is freed when the human is not followed any more: tf2's own buffer keeps ten seconds
    of every frame and never forgets a name. Names are bytes without a leading slash, as in the messages, where they are
    asked for often.
    """

    def __init__(self) -> None:
        self._ids: Dict[str, List[str]] = {}
        self._wanted: Dict[bytes, str] = {}
        self._frames: Dict[str, Timed] = {}
        self._unread: Dict[bytes, Tuple[bytes, int]] = {}
        self._unclaimed: "OrderedDict[str, Timed]" = OrderedDict()
        self._limbs: Set[bytes] = set()
        self._limb_suffixes: Tuple[bytes, ...] = ()
        self.refused = 0

    def __len__(self) -> int:
        """Return the number of transforms kept."""
        unread = sum(name.decode("utf-8", "replace") not in self._frames for name in self._unread)
        return len(self._frames) + unread + len(self._unclaimed)

    @property
    def followed(self) -> Dict[str, List[str]]:
        """Return the ids that are followed, by kind."""
        return self._ids

    def follow(self, **ids: Iterable[str]) -> None:
        """Follow the frames <kind>_<id> of these ids, by kind; those of other ids of the same kinds are freed."""
        before = set(self._wanted.values())
        self._ids.update((kind, list(names)) for kind, names in ids.items())
        wanted = {"{}_{}".format(kind, identity): identity for kind, names in self._ids.items() for identity in names}
        gone = tuple("_" + identity for identity in before.difference(wanted.values()))
        if gone and self._unclaimed:
            self._unclaimed = OrderedDict(item for item in self._unclaimed.items() if not item[0].endswith(gone))
        self._wanted = {frame.encode(): identity for frame, identity in wanted.items()}
        self._limb_suffixes = tuple(("_" + identity).encode() for identity in self._ids.get("head", ()))
        self._limbs.clear()
        for frame, identity in wanted.items():
            self._claim(frame)
            self._want_above(frame, identity)
        self._frames = {name: timed for name, timed in self._frames.items() if name.encode() in self._wanted}
        self._unread = {name: where for name, where in self._unread.items() if name in self._wanted}

    def wants(self, child: bytes) -> bool:
        """Tell whether put() is to be called for a frame; one asks again after each put()."""
        return child in self._wanted

    def is_limb(self, child: bytes) -> bool:
        """Tell whether a frame that is not wanted belongs to a skeleton whose head is followed."""
        if child in self._limbs:
            return True
        if not self._limb_suffixes or not child.endswith(self._limb_suffixes):
            return False
        if len(self._limbs) < _MAX_LIMBS:
            self._limbs.add(child)
        return True

    def put(self, transform: RawTransform, fixed: bool, now: float = math.nan) -> Optional[str]:
        """Keep a transform that arrives at `now` (s); return the id of its human.

        None for one that is not wanted, that leads to itself or to nothing, whose numbers are not finite, or that has a
        quaternion of zeros.
        """
        identity = self._wanted.get(transform.child.encode())
        if identity is None:
            return None
        parent, child, secs, nsecs, _, _ = transform
        if not transform.is_pose or not parent or parent == child:
            self.refused += 1
            return None
        self._frames[child] = Timed(transform, math.inf if fixed else secs + 1e-9 * nsecs, now)
        if parent.endswith(identity) and parent.encode() not in self._wanted:
            self._want_above(child, identity)
        return identity

    def put_unread(self, child: bytes, data: bytes, offset: int) -> None:
        """Keep a moving transform as it is in a message; it is read when it is asked for, and most never are."""
        self._unread[child] = (data, offset)

    def put_message(self, data: bytes, frames: Sequence[Tuple[bytes, int]], fixed: bool,
                    now: float = math.nan) -> List[Tuple[str, str]]:
        """Keep the wanted transforms of a message, see scan(), that arrives at `now` (s); return frame and id of each.

        A link makes the one above it wanted, too, which may stand earlier in the same message. Raises ValueError for a
        stamp that is none.
        """
        put: List[Tuple[str, str]] = []
        seen: Set[int] = set()
        known = -1
        while known != len(self._wanted):
            known = len(self._wanted)
            for child, offset in frames:
                if offset in seen or child.lstrip(b"/") not in self._wanted:
                    continue
                seen.add(offset)
                transform = read(data, offset)
                identity = self.put(transform, fixed, now)
                if identity is not None:
                    put.append((transform.child, identity))
        return put

    def take_other(self, child: bytes, data: bytes, offset: int, fixed: bool) -> Optional[RawTransform]:
        """Look at a transform of a message that is not wanted; return it where it may be one of the robot's.

        A fixed one is kept, as it may turn out to belong to somebody. Of moving ones of humans only the name is looked
        at. Raises ValueError for a stamp that is none.
        """
        is_limb = self.is_limb(child)
        if not fixed and (is_limb or is_of_human(child, fixed)):
            return None
        transform = read(data, offset)
        if fixed:
            self.keep_fixed(transform)
        return None if is_limb else transform

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

    def fresh(self, kind: str, now: float, within: float) -> Dict[str, RawTransform]:
        """Return the transforms of a kind, by id, whose stamps are at most `within` s from `now` (s)."""
        found = ((identity, self.get("{}_{}".format(kind, identity))) for identity in self._ids.get(kind, ()))
        return {identity: timed.transform for identity,
                timed in found if timed is not None and abs(now - timed.stamp) <= within}

    def chain(self, frame: str, oldest: float = -math.inf) -> List[Timed]:
        """Return the transforms from a frame up to that of the sensor; none where a link is missing or older than
        `oldest` (s)."""
        found: List[Timed] = []
        suffix = "_" + self._wanted.get(frame.encode(), "\0")
        while len(found) < MAX_LINKS:
            timed = self.get(frame, oldest)
            if timed is None:
                return []
            found.append(timed)
            frame = timed.transform.parent
            if not frame.endswith(suffix):
                return found
        return []

    def clear_moving(self) -> None:
        """Forget what moves, as after a time jump."""
        self._frames = {name: timed for name, timed in self._frames.items() if math.isinf(timed.stamp)}
        self._unread.clear()

    def _claim(self, frame: str) -> None:
        """Take a fixed transform that came before its frame was wanted."""
        if frame not in self._frames and frame in self._unclaimed:
            self._frames[frame] = self._unclaimed.pop(frame)

    def _want_above(self, frame: str, identity: str) -> None:
        """Want the links above a frame that belong to the same human, as far as they are known."""
        for _ in range(MAX_LINKS):
            timed = self._frames.get(frame)
            if timed is None or not timed.transform.parent.endswith("_" + identity) or len(self._wanted) >= MAX_WANTED:
                return
            frame = timed.transform.parent
            self._wanted[frame.encode()] = identity
            self._limbs.discard(frame.encode())
            self._claim(frame)
