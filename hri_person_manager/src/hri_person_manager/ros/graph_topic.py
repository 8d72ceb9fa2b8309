"""The topic /humans/graph: the association as text for GraphViz."""

from __future__ import annotations

import time
from typing import Callable

import rospy
from std_msgs.msg import String

from hri_pipeline.ros.topic_release import release

PERIOD_S = 0.2


class GraphTopic:
    """Publishes the text when it has changed, five times a second at most, and only while somebody listens."""

    def __init__(self) -> None:
        self._publisher = rospy.Publisher("/humans/graph", String, queue_size=1, latch=True)
        self._last = ""
        self._next = 0.0

    def update(self, text: Callable[[], str]) -> None:
        """Publish what `text` returns, if it is new."""
        now = time.monotonic()
        if now < self._next or not self._publisher.get_num_connections():
            return
        self._next = now + PERIOD_S
        found = text()
        if found != self._last:
            self._last = found
            self._publisher.publish(String(found))

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        release(self._publisher)
