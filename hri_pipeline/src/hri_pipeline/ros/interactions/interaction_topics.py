"""Topics of the interactions: gazes, groups, and the engagement of each person."""

from __future__ import annotations

import threading
from typing import Dict, Iterable, List, Mapping, Optional, Sequence

import genpy
import rospy
from std_msgs.msg import Header

from hri_msgs.msg import EngagementLevel, Gaze, GazesStamped
from hri_pipeline.core.interactions.engagement import Level
from hri_pipeline.core.interactions.gaze_people import GazeTarget
from hri_pipeline.core.interactions.group_tracker import Group
from hri_pipeline.ros.conversions import engagement_to_msg, gaze_to_msg, gazes_to_msg
from hri_pipeline.ros.interface import groups_messages, groups_type, has_gazing
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec
from hri_pipeline.ros.topic_release import release

NAMESPACE = "/humans/interactions"
ENGAGEMENT = "engagement_status"
_QUEUE = 10
_MOST_GROUPS = 50


class InteractionTopics:
    """Publishes gazes and groups, and of each person the engagement when it changes, latched.

    To open and close topics takes the master many milliseconds: a thread does that, so that gazes need not wait.
    """

    def __init__(self, interface: str) -> None:
        """interface: see ros/interface.py."""
        self._interface = interface
        self._gaze = rospy.Publisher(NAMESPACE + "/gaze", GazesStamped, queue_size=_QUEUE)
        self._groups = rospy.Publisher(NAMESPACE + "/groups", groups_type(interface), queue_size=_MOST_GROUPS)
        self._gazing: Optional[rospy.Publisher] = (
            rospy.Publisher(NAMESPACE + "/gazing", Gaze, queue_size=_MOST_GROUPS) if has_gazing(interface) else None)
        self._leases = TopicLeases("/humans/persons", {ENGAGEMENT: TopicSpec(EngagementLevel, True, 10)})
        self._lock = threading.Lock()
        self._levels: Dict[str, EngagementLevel] = {}
        self._wanted: List[str] = []
        self._changed = threading.Event()
        self._closed = False
        self._worker = threading.Thread(target=self._open_and_close, name="engagement topics", daemon=True)
        self._worker.start()

    def publish_groups(self, groups: Sequence[Group], header: Header) -> None:
        """Publish the groups of one time."""
        for message in groups_messages(groups, header, self._interface):
            self._groups.publish(message)

    def publish_gazes(self, gazes: Sequence[GazeTarget], header: Header) -> None:
        """Publish the gazes of one time."""
        self._gaze.publish(gazes_to_msg(gazes, header))
        if self._gazing is not None:
            for gaze in gazes:
                self._gazing.publish(gaze_to_msg(gaze, header))

    def publish_engagement(self, levels: Mapping[str, Level], stamp: genpy.Time) -> None:
        """Publish the levels that have changed."""
        for person, level in levels.items():
            with self._lock:
                before = self._levels.get(person)
                if person not in self._wanted or (before is not None and before.level == int(level)):
                    continue
                self._levels[person] = engagement_to_msg(level, Header(stamp=stamp))
                self._leases.publish(person, ENGAGEMENT, self._levels[person])

    def keep(self, ids: Iterable[str]) -> None:
        """Have a topic for each of these persons."""
        wanted = list(ids)
        with self._lock:
            if wanted == self._wanted:
                return
            self._wanted = wanted
            self._levels = {person: level for person, level in self._levels.items() if person in wanted}
        self._changed.set()

    def close(self) -> None:
        """Take all topics back. Idempotent."""
        self._closed = True
        self._changed.set()
        self._worker.join()
        self._leases.close_all()
        for publisher in (self._gaze, self._groups, self._gazing):
            if publisher is not None:
                release(publisher)

    def _open_and_close(self) -> None:
        while self._changed.wait() and not self._closed:
            self._changed.clear()
            with self._lock:
                wanted = list(self._wanted)
            try:
                self._follow(wanted)
            except Exception as error:  # the topics of one person never cost those of the others
                if not rospy.is_shutdown():
                    rospy.logerr("topics %s of persons: %s: %s", ENGAGEMENT, type(error).__name__, error)

    def _follow(self, wanted: List[str]) -> None:
        for person in wanted:
            if person not in self._leases.ids:
                self._leases.open(person)
                with self._lock:
                    # What was said while the topic was on its way.
                    if person in self._levels:
                        self._leases.publish(person, ENGAGEMENT, self._levels[person])
        self._leases.keep(wanted)
