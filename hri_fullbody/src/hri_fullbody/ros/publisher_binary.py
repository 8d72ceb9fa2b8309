"""Finds the stock robot_state_publisher."""

from __future__ import annotations

import time
from typing import Optional

import roslib.packages
import rospkg
import rospy

PACKAGE = "robot_state_publisher"
MISSING = ("robot_state_publisher is not installed, so bodies have joint states but no skeleton frames; install it: "
           "`apt install ros-robot-state-publisher` on Debian, `apt install ros-noetic-robot-state-publisher` on Ubuntu")
_RETRY_S = 30.0


class PublisherBinary:
    """Path of the binary, looked for once, and again every half minute while it is missing.

    package: where its node of the same name is looked for.
    """

    def __init__(self, package: str = PACKAGE, retry: float = _RETRY_S) -> None:
        self._package = package
        self._path: Optional[str] = None
        self._retry = retry
        self._tried = float("-inf")
        self.problem = ""

    @property
    def next_try(self) -> float:
        """Monotonic time, s, from which looking again is worth it; the past when the binary has been found."""
        return float("-inf") if self._path else self._tried + self._retry

    def get(self) -> Optional[str]:
        """Return the path, None while there is none; the first failure is logged."""
        if self._path is None and time.monotonic() >= self.next_try:
            self._tried = time.monotonic()
            try:
                found = roslib.packages.find_node(self._package, self._package)
            except rospkg.ResourceNotFound:
                found = []
            self._path = found[0] if found else None
            if self._path is None and not self.problem:
                rospy.logerr("%s", MISSING)
            self.problem = "" if self._path else MISSING
        return self._path

    def forget(self) -> None:
        """Look again later: the file that was found cannot be run."""
        self._path, self._tried = None, time.monotonic()
