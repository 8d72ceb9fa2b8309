"""Landmarks of a face as they are received by whoever wants them as one array."""

from __future__ import annotations

import struct

import genpy
import numpy as np
from std_msgs.msg import Header

from hri_msgs.msg import FacialLandmarks

_STAMP_AND_LENGTH = struct.Struct("<3II")
_SIZE = struct.Struct("<II")
_LANDMARKS = 70
_POINTS_BYTES = _LANDMARKS * 3 * 4


class LandmarkArray(FacialLandmarks):
    """A FacialLandmarks, the type to subscribe with, whose `landmarks` is an array (70, 3) of x, y, c.

    Ten faces send hundreds of these a second to each of several nodes, and 70 objects for each take ten times as long to read.
    It is only received: it cannot be published.
    """

    def __init__(self) -> None:
        # Not the generated one, which makes 70 points first.
        self.header, self.landmarks = Header(), np.zeros((_LANDMARKS, 3))
        self.height = self.width = 0

    def deserialize(self, data: bytes) -> LandmarkArray:
        """Read a serialised message; raises genpy.DeserializationError for one that is cut off."""
        try:
            seq, secs, nsecs, length = _STAMP_AND_LENGTH.unpack_from(data)
            end = _STAMP_AND_LENGTH.size + length
            frame = data[_STAMP_AND_LENGTH.size:end].decode("utf-8", "replace")
            self.height, self.width = _SIZE.unpack_from(data, end + _POINTS_BYTES)
            points = np.frombuffer(data, "<f4", 3 * _LANDMARKS, end)
        except (struct.error, ValueError) as error:
            raise genpy.DeserializationError(str(error)) from error
        self.header.seq, self.header.frame_id = seq, frame
        self.header.stamp.secs, self.header.stamp.nsecs = secs, nsecs
        self.landmarks = points.reshape(_LANDMARKS, 3).astype(np.float64)
        return self
