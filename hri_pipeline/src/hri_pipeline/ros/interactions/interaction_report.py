"""What the interactions node says of itself on /diagnostics."""

from __future__ import annotations

import time
from typing import Dict, Sequence

import rospy

from hri_pipeline.core.interactions.engagement import Level
from hri_pipeline.core.interactions.gaze_people import ROBOT, GazeTarget
from hri_pipeline.core.interactions.group_tracker import Group
from hri_pipeline.core.timing import StageTimes
from hri_pipeline.ros.diagnostics import OK, WARN, NodeDiagnostics
from hri_pipeline.ros.interactions.interaction_frame import InteractionFrame
from hri_pipeline.ros.people_feed import PeopleFeed

_PERIOD_S = 1.0


class InteractionReport:
    """Counts results and publishes the state once a second."""

    def __init__(self, feed: PeopleFeed, frame: InteractionFrame, times: StageTimes) -> None:
        self._feed, self._frame, self._times = feed, frame, times
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._since = time.monotonic()
        self._results = 0
        self._said: Dict[str, object] = {}
        self.errors = 0

    def count(self, people: int, gazes: Sequence[GazeTarget], groups: Sequence[Group], levels: Dict[str, Level]) -> None:
        """Take one result."""
        self._results += 1
        self._said = {"people with a place": people, "gazes": len(gazes), "at the robot": sum(gaze.receiver == ROBOT for gaze in gazes),
                      "groups": len(groups), "engaged": sum(level == Level.ENGAGED for level in levels.values())}

    def update(self) -> None:
        """Publish once a second."""
        passed = time.monotonic() - self._since
        if passed < _PERIOD_S:
            return
        values = dict(self._said, **{"results per second": self._results / passed, "errors": self.errors})
        values.update(self._times.values())
        self._since, self._results = time.monotonic(), 0
        text = "%d gazes, %d groups" % (values.get("gazes", 0), values.get("groups", 0))
        self._diagnostics.set("interactions", WARN if self.errors else OK, text, values)
        unconnected, values = sorted(self._frame.unconnected), self._feed.status()
        values["robot is at"] = self._frame.robot_source
        self._diagnostics.set(
            "location", WARN if unconnected else OK,
            "no transform from %s to the reference frame, see /humans/reference_frame" % ", ".join(unconnected)
            if unconnected else "people are compared in %s" % self._frame.name, values)
        for kind, feed in self._feed.feeds.items():
            self._diagnostics.set(kind, *feed.status())

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        self._diagnostics.close()
