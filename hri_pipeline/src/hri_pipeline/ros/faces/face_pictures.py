"""The topics `cropped` and `aligned` of faces: made only while someone listens."""

from __future__ import annotations

import time
from typing import Tuple

import rospy
from std_msgs.msg import Header

from hri_pipeline.core.faces.face_crops import MAX_SIZE, aligned_crop, box_crop
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.ros.conversions import bgr_to_image
from hri_pipeline.ros.image_intake import Frame
from hri_pipeline.ros.topic_lease import TopicLeases

CROPPED, ALIGNED = "cropped", "aligned"
PARAMETERS = ("/humans/faces/width", "/humans/faces/height")
DEFAULT_SIZE = 128
MARGIN = 1.3
_REFRESH_S = 5.0
_LOG_PERIOD_S = 30.0


class FacePictures:
    """Publishes the crops of a face that somebody listens to.

    Their size is on the parameter server (/humans/faces/width and /humans/faces/height), looked up again every few
    seconds while there are listeners; a value that is not legal is told and replaced by 128.
    """

    def __init__(self, leases: TopicLeases) -> None:
        self._leases = leases
        self._size = (DEFAULT_SIZE, DEFAULT_SIZE)
        self._read_at = float("-inf")

    def publish(self, face: FaceObservation, frame: Frame) -> None:
        """Publish what is listened to of one face."""
        wanted = [name for name in (CROPPED, ALIGNED) if self._leases.has_subscribers(face.id, name)]
        if not wanted:
            return
        width, height = self._current_size()
        for name in wanted:
            if name == CROPPED:
                picture = box_crop(frame.bgr, face.box, width, height, MARGIN)
            else:
                side = max(width, height)
                square = aligned_crop(frame.bgr, face.mesh, side, MARGIN)
                top, left = (side - height) // 2, (side - width) // 2
                picture = square[top:top + height, left:left + width]
            header = Header(stamp=frame.header.stamp, frame_id=frame.header.frame_id)
            self._leases.publish(face.id, name, bgr_to_image(picture, header))

    def _current_size(self) -> Tuple[int, int]:
        if time.monotonic() - self._read_at > _REFRESH_S:
            self._read_at = time.monotonic()
            self._size = (self._read(PARAMETERS[0]), self._read(PARAMETERS[1]))
        return self._size

    @staticmethod
    def _read(name: str) -> int:
        try:
            value = rospy.get_param(name, DEFAULT_SIZE)
        except Exception as error:  # the master may be away: rospy raises socket errors then
            rospy.logwarn_throttle(_LOG_PERIOD_S, "parameter %s could not be read (%s)", name, error)
            return DEFAULT_SIZE
        # type() and not isinstance(): a bool is an int in Python.
        if type(value) is not int or not 16 <= value <= MAX_SIZE:
            rospy.logwarn_throttle(_LOG_PERIOD_S, "parameter %s is %r; legal: int, 16 to %d; %d is used instead",
                                   name, value, MAX_SIZE, DEFAULT_SIZE)
            return DEFAULT_SIZE
        return value
