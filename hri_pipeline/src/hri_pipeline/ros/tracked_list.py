"""The latched list of the ids that are tracked now."""

from __future__ import annotations

import threading
from typing import List, Sequence, Union

import genpy
import rospy

from hri_msgs.msg import IdsList
from hri_pipeline.core.ids import ID_PATTERN, is_valid_id
from hri_pipeline.ros.conversions import ids_list_to_msg, to_time
from hri_pipeline.ros.topic_release import release

# What a subscriber needs to read the last list before its connection is closed.
_FAREWELL_S = 0.1


class TrackedList:
    """Publishes an IdsList on every change and every `period` seconds; the empty list at the end.

    The period is wall time: the list stays alive while the simulated clock stands still.
    """

    def __init__(self, topic: str, period: float = 1.0) -> None:
        if not period > 0.0:
            raise ValueError("period of {} is {} s, legal range more than 0".format(topic, period))
        self._publisher = rospy.Publisher(topic, IdsList, latch=True, queue_size=10)
        self._topic = topic
        self._ids: List[str] = []
        self._stamp = genpy.Time()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._publish()
        self._thread = threading.Thread(target=self._repeat, args=(period,), name="tracked list", daemon=True)
        self._thread.start()

    def set(self, ids: Sequence[str], stamp: Union[genpy.Time, float]) -> None:
        """Set the ids, in this order, seen in the image of `stamp`; publishes when they have changed.

        Raises ValueError for what is not an id; nothing is published then.
        """
        refused = [identity for identity in ids if not is_valid_id(identity)]
        if refused:
            raise ValueError("{} refuses {!r}: not an id ({})".format(self._topic, refused[0], ID_PATTERN))
        with self._lock:
            changed = list(ids) != self._ids
            self._ids = list(ids)
            self._stamp = to_time(stamp)
            if changed and not self._closed.is_set():
                self._publish()

    def close(self) -> None:
        """Publish the empty list and take the topic back. Idempotent."""
        with self._lock:
            if self._closed.is_set():
                return
            self._closed.set()
            self._ids = []
            self._publish()
        self._thread.join()
        if self._publisher.get_num_connections():
            threading.Event().wait(_FAREWELL_S)
        release(self._publisher)

    def _repeat(self, period: float) -> None:
        while not self._closed.wait(period):
            with self._lock:
                if not self._closed.is_set():
                    self._publish()

    def _publish(self) -> None:
        try:
            self._publisher.publish(ids_list_to_msg(self._ids, self._stamp))
        except rospy.ROSException:
            # rospy has shut down before us: nobody is left to be told.
            self._closed.set()
