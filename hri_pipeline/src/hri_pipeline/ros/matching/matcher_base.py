"""What the matchers have in common: callbacks that hand over to one loop, and the topic on which matches are said."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import rospy

from hri_msgs.msg import IdsMatch
from hri_pipeline.core.memory import share_arenas
from hri_pipeline.core.parameters import take_over
from hri_pipeline.ros.diagnostics import NodeDiagnostics
from hri_pipeline.ros.topic_release import release


class MatcherBase:
    """Publishes on /humans/candidate_matches. What comes in is stored under `_lock`, and `_news` wakes the loop until `_stop`."""

    def __init__(self, settings: SimpleNamespace) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._news = threading.Event()
        self._stop = threading.Event()
        self._publisher = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=100)
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        share_arenas()
        rospy.on_shutdown(self._end)

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters between two comparisons."""
        with self._lock:
            take_over(self._settings, settings)
        self._news.set()

    def close(self) -> None:
        """Withdraw all matches and take everything back. Idempotent."""
        self._end()
        self._close_inputs()
        with self._lock:
            self._withdraw_all()
        self._diagnostics.close()
        release(self._publisher)

    def _close_inputs(self) -> None:
        raise NotImplementedError

    def _withdraw_all(self) -> None:
        raise NotImplementedError

    def _end(self) -> None:
        self._stop.set()
        self._news.set()
