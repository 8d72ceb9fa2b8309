"""State of a node on /diagnostics, once a second."""

from __future__ import annotations

import threading
from typing import Dict, Mapping, Optional, Tuple

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from hri_pipeline.core.error_log import elide_middle
from hri_pipeline.core.resources import descriptors_status
from hri_pipeline.ros.rospy_compat import release

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR
Status = Tuple[int, str, Dict[str, object]]
"""Level, message and values of a task."""

_PERIOD_S = 1.0
_DESCRIPTORS = "file descriptors"
MAX_TEXT = 500
"""Most characters of a text: names of frames and topics come from outside, and may have any length."""
_TAIL = 150


class NodeDiagnostics:
    """Keeps one status per task and publishes all of them every second of wall time.

    A status is called `node: task`; its hardware_id is the resolved name of the node. The task `file descriptors`
    is there once they have been short. Keys of values name a figure and hold no id: those who plot them expect the same
    keys all the time. Texts longer than MAX_TEXT lose their middle.
    """

    def __init__(self, node_name: str, period: float = _PERIOD_S) -> None:
        self._name = node_name.strip("/")
        self._publisher = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        self._tasks: Dict[str, DiagnosticStatus] = {}
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._repeat, args=(period,), name="diagnostics", daemon=True)
        self._thread.start()

    def set(self, task: str, level: int, message: str, values: Optional[Mapping[str, object]] = None) -> None:
        """Set the state of a task; it goes out with the next message, a worse level at once."""
        status = DiagnosticStatus(
            level=level, name="{}: {}".format(self._name, task), message=_shortened(message),
            hardware_id=rospy.get_name(),
            values=[KeyValue(key=_shortened(key), value=_text(value)) for key, value in (values or {}).items()])
        with self._lock:
            worse = level > (self._tasks[task].level if task in self._tasks else OK)
            self._tasks[task] = status
        if worse:
            self._publish()

    def close(self) -> None:
        """Stop publishing, and unregister the topic. Idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._thread.join()
        release(self._publisher)

    def _repeat(self, period: float) -> None:
        while not self._closed.wait(period):
            short, message, values = descriptors_status()
            if short or _DESCRIPTORS in self._tasks:
                self.set(_DESCRIPTORS, WARN if short else OK, message, values)
            self._publish()

    def _publish(self) -> None:
        with self._lock:
            if not self._tasks or self._closed.is_set():
                return
            message = DiagnosticArray(status=list(self._tasks.values()))
        message.header.stamp = rospy.Time.now()
        try:
            self._publisher.publish(message)
        except rospy.ROSException:
            self._closed.set()


def _shortened(text: object) -> str:
    return elide_middle(str(text), MAX_TEXT, _TAIL, " [...] ")


def _text(value: object) -> str:
    return "{:.4g}".format(value) if isinstance(value, float) else _shortened(value)
