"""Reads the frames out of a serialised tf2_msgs/TFMessage, and the numbers only of those that matter.

Ten skeletons are some 3000 transforms per second; to make message objects of all of them costs more than 10 % of a core in
each Python process that listens, to look at the names alone about 1 % (measured).
"""

from __future__ import annotations

import math
import struct
from functools import lru_cache
from typing import List, NamedTuple, Tuple

# geometry_msgs/TransformStamped as roscpp and rospy serialise it: seq, secs, nsecs, parent, child, 7 numbers.
_LENGTH = struct.Struct("<I")
_TIMES = struct.Struct("<II")
_HEAD = struct.Struct("<4I")
_NUMBERS = struct.Struct("<7d")
_PARENT_AT = 12
_REMEMBERED = 2048
_LONGEST = 256          # bytes of two names that are remembered
_FIRST_BAD_SECOND = 2 ** 31 - 1     # durations are 32 bits with a sign: tf2 ends the process that reckons with such a stamp
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
    """Return the transform at an offset that scan() has given. Raises ValueError if its stamp is none (check_stamp())."""
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
