"""Frames of /tf: reading serialised messages, the frames of humans, and which frames lead from the sensors to a
reference frame.

Ten skeletons are some 3000 transforms per second; to make message objects of all of them costs more than 10 % of a core
in each Python process that listens, to look at the names alone about 1 % (measured).
"""

from __future__ import annotations

import math
import struct
from collections import OrderedDict
from functools import lru_cache
from typing import Dict, Generic, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple, TypeVar

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


class RawTransform(NamedTuple):
    """A transform; names without a leading slash. translation: x, y, z m. rotation: quaternion x, y, z, w."""

    parent: str
    child: str
    secs: int
    nsecs: int
    translation: Tuple[float, float, float]
    rotation: Tuple[float, float, float, float]

    @property
    def stamp(self) -> float:
        """Stamp in s."""
        return self.secs + 1e-9 * self.nsecs

    @property
    def is_pose(self) -> bool:
        """Whether all numbers are finite and the quaternion is one."""
        # A sum is finite when all of its numbers are.
        x, y, z, w = self.rotation
        return math.isfinite(sum(self.translation)) and 1e-9 < x * x + y * y + z * z + w * w < math.inf


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


def _names(data: bytes) -> Tuple[str, str]:
    """Return parent and child out of their lengths and texts."""
    middle = 4 + _LENGTH.unpack_from(data)[0]
    parent, child = data[4:middle], data[middle + 4:]
    return parent.decode("utf-8", "replace").lstrip("/"), child.decode("utf-8", "replace").lstrip("/")


_known_names = lru_cache(maxsize=_REMEMBERED)(_names)


T = TypeVar("T")

# Frames of humans come and go by the thousand, and no way of the robot leads over one. Not body_ and head_: robots have
# links of such names (head_1_link, head_pan_link, body_link) on the way to their cameras.
_OF_HUMANS = (b"face_", b"gaze_", b"voice_", b"person_")
MAX_FRAMES = 1000       # frames whose latest transform is remembered, in case they become relevant; 1 kB each
MAX_RELEVANT = 500


def is_of_human(child: bytes, fixed: bool) -> bool:
    """Tell whether a frame of that name is a human's.

    A fixed one (/tf_static) never is: a robot may have a face_plate_link.
    """
    return not fixed and child.lstrip(b"/").startswith(_OF_HUMANS)


def is_optical(frame: str) -> bool:
    """Tell by its name whether z of a frame points where it looks and y down (REP-103); else z points up."""
    return "optical" in frame


class FrameTree(Generic[T]):
    """Remembers the latest transform of every frame (bounded) and knows which are relevant.

    `T` is the transform as the caller keeps it. When there are too many, moving ones that nobody needs go first: a
    fixed one never comes again.
    """

    def __init__(self, max_frames: int = MAX_FRAMES, max_relevant: int = MAX_RELEVANT) -> None:
        """Remember at most `max_frames` frames and follow at most `max_relevant`."""
        self._max_frames = max_frames
        self._max_relevant = max_relevant
        self._moving: "OrderedDict[str, Tuple[str, T]]" = OrderedDict()
        self._fixed: "OrderedDict[str, Tuple[str, T]]" = OrderedDict()
        self._relevant: Set[str] = set()

    def __len__(self) -> int:
        """Return the number of frames remembered."""
        return len(self._moving) + len(self._fixed)

    @property
    def relevant(self) -> Set[str]:
        """Return the frames that are followed."""
        return set(self._relevant)

    def latest(self, frame: str) -> Optional[T]:
        """Return the latest transform of a frame, None if it is unknown."""
        known = self._find(frame)
        return None if known is None else known[1]

    def put(self, child: str, parent: str, transform: T, fixed: bool) -> List[T]:
        """Take a transform; return those that have to be kept now (itself, and older ones above it)."""
        kept, other = (self._fixed, self._moving) if fixed else (self._moving, self._fixed)
        other.pop(child, None)
        kept[child] = (parent, transform)
        kept.move_to_end(child)
        if len(self) > self._max_frames:
            self._drop_oldest()
        if child not in self._relevant:
            return []
        return [transform] + self.follow(parent)

    def follow(self, frame: str) -> List[T]:
        """Make a frame and all above it relevant; return the transforms known of the new ones."""
        found: List[T] = []
        while frame not in self._relevant and len(self._relevant) < self._max_relevant:
            self._relevant.add(frame)
            known = self._find(frame)
            if known is None:
                break
            frame, transform = known
            found.append(transform)
        return found

    def forget_moving(self) -> List[T]:
        """Forget the moving frames, as after a time jump; return the fixed ones that are relevant."""
        self._moving.clear()
        return [transform for child, (_, transform) in self._fixed.items() if child in self._relevant]

    def _find(self, frame: str) -> Optional[Tuple[str, T]]:
        return self._moving.get(frame) or self._fixed.get(frame)

    def _drop_oldest(self) -> None:
        """Drop the oldest frame nobody needs, a moving one if there is one; else the oldest of all."""
        for frames in (self._moving, self._fixed):
            oldest = next((child for child in frames if child not in self._relevant), None)
            if oldest is not None:
                del frames[oldest]
                return
        (self._moving or self._fixed).popitem(last=False)


MAX_LINKS = 64
"""Most links between a frame of a human and the frame of the sensor: a loop ends there."""
MAX_UNCLAIMED = 2000
_MAX_LIMBS = 5000

Vector = Tuple[float, float, float]
Quaternion = Tuple[float, float, float, float]


class Timed(NamedTuple):
    """A transform; a fixed one is as new as the newest (stamp infinite)."""

    transform: RawTransform
    stamp: float


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
        self._ids.update((kind, list(names)) for kind, names in ids.items())
        wanted = {"{}_{}".format(kind, identity): identity for kind, names in self._ids.items() for identity in names}
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

    def put(self, transform: RawTransform, fixed: bool) -> Optional[str]:
        """Keep a transform; return the id of its human.

        None for one that is not wanted, whose numbers are not finite, or that has a quaternion of zeros.
        """
        identity = self._wanted.get(transform.child.encode())
        if identity is None:
            return None
        if not transform.is_pose:
            self.refused += 1
            return None
        parent, child, secs, nsecs, _, _ = transform
        self._frames[child] = Timed(transform, math.inf if fixed else secs + 1e-9 * nsecs)
        if parent.endswith(identity) and parent.encode() not in self._wanted:
            self._want_above(child, identity)
        return identity

    def put_unread(self, child: bytes, data: bytes, offset: int) -> None:
        """Keep a moving transform as it is in a message; it is read when it is asked for, and most never are."""
        self._unread[child] = (data, offset)

    def put_message(self, data: bytes, frames: Sequence[Tuple[bytes, int]], fixed: bool) -> List[Tuple[str, str]]:
        """Keep the wanted transforms of a message, see scan(); return frame and id of each.

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
                identity = self.put(transform, fixed)
                if identity is not None:
                    put.append((transform.child, identity))
        return put

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
            if timed is None or not timed.transform.parent.endswith("_" + identity):
                return
            frame = timed.transform.parent
            self._wanted[frame.encode()] = identity
            self._limbs.discard(frame.encode())
            self._claim(frame)


def axis(quaternion: Quaternion, along_z: bool) -> Vector:
    """Return the x axis, or the z axis, that a quaternion x, y, z, w turns to; it need not be of unit length."""
    x, y, z, w = quaternion
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    if along_z:
        return scale * (x * z + y * w), scale * (y * z - x * w), 1.0 - scale * (x * x + y * y)
    return 1.0 - scale * (y * y + z * z), scale * (x * y + z * w), scale * (x * z - y * w)


def turned(quaternion: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by a quaternion x, y, z, w, which need not be of unit length.

    v + w t + q x t with t = 2 / |q|^2 (q x v).
    """
    (x, y, z, w), (u, v, n) = quaternion, vector
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    i, j, k = scale * (y * n - z * v), scale * (z * u - x * n), scale * (x * v - y * u)
    return u + w * i + y * k - z * j, v + w * j + z * i - x * k, n + w * k + x * j - y * i
