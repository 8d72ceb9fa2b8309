"""What StatePublishers knows about the process of one body, and about one that shall end."""

from __future__ import annotations

import signal
import threading
import time
from dataclasses import dataclass, field
from typing import Dict, Optional

import rospy

from hri_fullbody.core.processes.child_process import ChildProcess
from hri_pipeline.core.restart_policy import RestartPolicy

# A process that ends with an error this soon did so because of what it was given.
_START_S = 5.0
# How long a problem keeps the status at WARN; the counts stay.
_REMEMBERED_S = 30.0
# The second failure in a row counts: the parameter may have been deleted in the moment of the first.
_STRIKES = 2


@dataclass
class Slot:
    """One body: its URDF, its process, and when that is to be started (monotonic s)."""

    id: str
    urdf: str = ""
    revision: int = 0
    child: Optional[ChildProcess] = None
    due: float = 0.0
    policy: RestartPolicy = field(default_factory=RestartPolicy)
    strikes: int = 0

    def describe(self, urdf: str, revision: int, now: float) -> None:
        """Take another URDF, to be used from now on."""
        self.urdf, self.revision = urdf, revision
        self.child, self.due, self.strikes = None, now, 0
        self.policy = RestartPolicy()

    def failed_start(self, uptime: float) -> bool:
        """Note that the process ended with an error after `uptime` s; tells whether the URDF is to blame."""
        self.strikes = self.strikes + 1 if uptime < _START_S else 0
        return self.strikes >= _STRIKES


class Ending:
    """A process that shall end: it is interrupted at a time, and killed when that does not help.

    SIGTERM would leave roscpp nodes registered at the master; SIGINT does not.
    """

    PATIENCE_S = 2.0

    def __init__(self, body_id: str, child: ChildProcess, when: float) -> None:
        self.id = body_id
        self.child = child
        self.next_press = when
        self._interrupted = False

    def press(self, now: float) -> None:
        """Do what is due at `now` (monotonic s)."""
        if now < self.next_press:
            return
        self.child.send(signal.SIGKILL if self._interrupted else signal.SIGINT)
        self._interrupted = True
        self.next_press = now + self.PATIENCE_S


class Tally:
    """Counts what happens to the processes, and remembers the last problem. Safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts = dict.fromkeys(("started", "restarted", "replaced", "urdf_refused", "descriptions_restored",
                                      "beyond_limit", "left_by_dead_nodes"), 0)
        self._problem, self._problem_at = "", float("-inf")

    @property
    def counts(self) -> Dict[str, int]:
        """All counts by name."""
        with self._lock:
            return dict(self._counts)

    @property
    def problem(self) -> str:
        """The last problem, empty half a minute after it."""
        with self._lock:
            return self._problem if time.monotonic() - self._problem_at < _REMEMBERED_S else ""

    def count(self, name: str, number: int = 1) -> None:
        """Count one more of what has a name."""
        with self._lock:
            self._counts[name] += number

    def note(self, text: str) -> None:
        """Log a problem and remember it."""
        with self._lock:
            self._problem, self._problem_at = text, time.monotonic()
        rospy.logwarn("%s", text)
