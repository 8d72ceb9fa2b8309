"""All transforms of a cycle in one message."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Sequence

import genpy
import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from hri_pipeline.ros.topic_release import release

_REMEMBERED = 1000


class TfPublisher:
    """Publishes transforms on /tf, one message per call, never a frame twice with the same stamp.

    tf2 drops a repeated stamp and prints a warning for each, in every process that listens.
    """

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("/tf", TFMessage, queue_size=100)
        self._last: "OrderedDict[str, genpy.Time]" = OrderedDict()
        self.dropped = 0
        self._closed = False

    def send(self, transforms: Sequence[TransformStamped]) -> None:
        """Publish the transforms; a repeated (child, stamp) and numbers that are not finite are left out."""
        fresh = [transform for transform in transforms if self._is_fresh(transform)]
        self.dropped += len(transforms) - len(fresh)
        if fresh and not self._closed:
            self._publisher.publish(TFMessage(transforms=fresh))

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        if not self._closed:
            self._closed = True
            release(self._publisher)

    def _is_fresh(self, transform: TransformStamped) -> bool:
        child, stamp = transform.child_frame_id, transform.header.stamp
        if self._last.get(child) == stamp or not _is_finite(transform):
            return False
        self._last[child] = stamp
        self._last.move_to_end(child)
        # Frames of people who have gone are forgotten, oldest first.
        while len(self._last) > _REMEMBERED:
            self._last.popitem(last=False)
        return True


def _is_finite(transform: TransformStamped) -> bool:
    position, turn = transform.transform.translation, transform.transform.rotation
    return all(math.isfinite(value) for value in (
        position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w))
