"""State of a node on /diagnostics, once a second."""

from __future__ import annotations

import threading
from typing import Dict, Mapping, Optional

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from hri_pipeline.ros.topic_release import release

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR

_PERIOD_S = 1.0


class NodeDiagnostics:
    """Keeps one status per task and publishes all of them every second of wall time.

    A status is called `node: task`; its hardware_id is the resolved name of the node.
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
            level=level, name="{}: {}".format(self._name, task), message=message,
            hardware_id=rospy.get_name(),
            values=[KeyValue(key=str(key), value=_text(value)) for key, value in (values or {}).items()])
        with self._lock:
            worse = level > (self._tasks[task].level if task in self._tasks else OK)
            self._tasks[task] = status
        if worse:
            self._publish()

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._thread.join()
        release(self._publisher)

    def _repeat(self, period: float) -> None:
        while not self._closed.wait(period):
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


def _text(value: object) -> str:
    return "{:.4g}".format(value) if isinstance(value, float) else str(value)
