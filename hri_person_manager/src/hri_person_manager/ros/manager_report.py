"""What the person manager says of itself on /diagnostics."""

from __future__ import annotations

from typing import Mapping

import rospy

from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_guard import MatchGuard
from hri_person_manager.core.person_state import Snapshot
from hri_person_manager.ros.reference import ReferenceFrame
from hri_person_manager.ros.tf_intake import TfIntake
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.ros.tf_publisher import TfPublisher


class ManagerReport:
    """Reads the parts of the node; the caller holds its lock."""

    def __init__(self, manager: PersonManager, guard: MatchGuard, reference: ReferenceFrame, intake: TfIntake,
                 feeds: Mapping[str, FeatureFeed], transforms: TfPublisher) -> None:
        self._manager, self._guard, self._reference = manager, guard, reference
        self._intake, self._feeds, self._transforms = intake, feeds, transforms
        self._diagnostics = NodeDiagnostics(rospy.get_name())

    def update(self, snapshot: Snapshot, jumps: int, store_problem: str) -> None:
        """Publish the state; jumps: how often time has gone back; store_problem: empty when what is known is kept."""
        self._persons(snapshot, jumps)
        self._diagnostics.set("store", ERROR if store_problem else OK, store_problem or "nothing waits to be written")
        self._matches()
        self._location()
        for plural, feed in self._feeds.items():
            level, text, values = feed.status()
            # A stack without a microphone or without a body tracker is a legal one.
            self._diagnostics.set(plural, OK if text.startswith("no publisher") else level, text, values)

    def close(self) -> None:
        """Take the topic back. Idempotent."""
        self._diagnostics.close()

    def _persons(self, snapshot: Snapshot, jumps: int) -> None:
        values = {"tracked": len(snapshot.tracked), "known": len(snapshot.known), "time jumps": jumps,
                  "frames not sent twice": self._transforms.dropped,
                  "ids refused in tracked lists": self._manager.refused_ids}
        if self._manager.exact:
            self._diagnostics.set("persons", OK, "%d tracked" % len(snapshot.tracked), values)
        else:
            self._diagnostics.set("persons", WARN, "many ids match each other; association is approximate", values)

    def _matches(self) -> None:
        refused = self._guard.refused
        counts = {"accepted": self._guard.accepted, "of persons just forgotten": self._guard.late, **{"refused, " + why: refused[why] for why in sorted(refused)}}
        self._diagnostics.set("candidate matches", WARN if refused else OK,
                              "%d refused" % sum(refused.values()) if refused else "all accepted", counts)

    def _location(self) -> None:
        unconnected = sorted(self._reference.unconnected)
        self._diagnostics.set(
            "location", WARN if unconnected else OK,
            "no transform from %s to %s, see /humans/reference_frame" % (", ".join(unconnected), self._reference.frame)
            if unconnected else "persons are placed in %s" % self._reference.frame, self._intake.status())
