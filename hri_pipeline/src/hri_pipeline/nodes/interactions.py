"""The interactions node: people's frames in; gazes, groups and engagement out."""

from __future__ import annotations

import math
import threading
import time
import traceback
from typing import Dict, Iterable, List, Mapping, Optional, Sequence

import genpy
import rospy
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from hri_msgs.msg import EngagementLevel, Gaze, GazesStamped
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.engagement import EngagementEstimator, Level
from hri_pipeline.core.interactions.gaze import GazeTargets
from hri_pipeline.core.interactions.groups import (
    Group,
    GroupTracker,
    Individual,
    bearing,
    group_numbers,
    individuals_of,
)
from hri_pipeline.core.interactions.parameters import InteractionSettings
from hri_pipeline.core.interactions.people import ROBOT, GazeTarget, PeopleSnapshot
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.privacy import DataUse
from hri_pipeline.core.process import share_arenas
from hri_pipeline.core.timing import JUMP_BACK_S, StageTimes, clock_went_back
from hri_pipeline.ros.conversions import (
    engagement_to_msg,
    gaze_to_msg,
    gazes_to_msg,
    groups_messages,
    groups_type,
    has_gazing,
    make_header,
)
from hri_pipeline.ros.diagnostics import OK, WARN, NodeDiagnostics
from hri_pipeline.ros.markers import ShownMarkers, interaction_markers, without_stamp
from hri_pipeline.ros.people_input import LEVEL, InteractionFrame, PeopleInput, RobotPose
from hri_pipeline.ros.privacy import PrivacyTopic
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.tf import RobotTf

IDLE_S = 0.25
GATHER_S = 0.01         # faces, bodies and persons of one image come one after the other
_EARLY = 0.9            # part of the period after which the next image is not too early
_LOG_PERIOD_S = 10.0
_SLACK_S = 1e-3
_NEVER = genpy.Time()
_QUEUE = 10             # of markers, too: who misses one misses what is deleted


class InteractionsNode:
    """Publishes who looks at whom, who stands together and who is engaged, once per image, with its stamp.

    Callbacks only store; the caller of spin() does everything else.
    """

    def __init__(self, settings: InteractionSettings) -> None:
        """settings: the values of INTERACTION_PARAMETERS.

        Raises ParameterError for values that contradict each other.
        """
        self._settings = settings
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._gazes = GazeTargets(settings)
        self._groups = GroupTracker(settings)
        try:
            self._engagement = EngagementEstimator(settings)
        except ValueError as error:
            raise ParameterError("{}: {}".format(rospy.get_name(), error)) from error
        self._last, self._last_at, self._last_now, self._jumps = _NEVER, rospy.get_time(), rospy.get_time(), 0
        self._is_empty = True
        self._frame_name = ""
        self._grouped_at = -math.inf
        self._tracked: List[str] = []
        self._latest_groups: List[Group] = []
        self._latest_gazes: List[GazeTarget] = []
        self._published_groups: Optional[Sequence[Group]] = None
        self._times = StageTimes()
        self._markers = ShownMarkers()
        self._marker_topic = rospy.Publisher("visualization/interactions", MarkerArray, queue_size=_QUEUE)
        self._topics = InteractionTopics(settings.interface, settings.engagement)
        self._privacy = PrivacyTopic(DataUse(("who looks at whom", "groups",
                                              *(("engagement",) if settings.engagement else ()))))
        robot = RobotTf(settings.reference_frame)
        self._frame = InteractionFrame(settings, robot)
        self._people = PeopleInput(settings, robot)
        self._report = InteractionReport(self._people, self._frame, self._times)
        rospy.on_shutdown(self._end)
        share_arenas()

    def spin(self) -> None:
        """Work until ROS shuts down."""
        while not self._stop.is_set():
            if self._people.changed.wait(IDLE_S):
                self._stop.wait(GATHER_S)
            self._people.changed.clear()
            try:
                with self._lock:
                    self._cycle()
            except Exception:  # one bad image does not end the node
                self._report.errors += 1
                rospy.logerr_throttle(_LOG_PERIOD_S, "an image gave no interactions:\n%s", traceback.format_exc())
            self._report.update()

    def reconfigure(self, settings: InteractionSettings) -> None:
        """Take up the values of the live parameters between two images. ValueError for levels in the wrong order."""
        with self._lock:
            self._engagement.reconfigure(settings)
            self._settings = settings
            for owner in (self._gazes, self._groups, self._people):
                owner.reconfigure(settings)

    def close(self) -> None:
        """Close all topics. Idempotent."""
        self._end()
        self._people.close()
        self._topics.close()
        self._report.close()
        self._privacy.close()
        release(self._marker_topic)

    def _end(self) -> None:
        self._stop.set()
        self._people.changed.set()

    def _cycle(self) -> None:
        self._watch_clock()
        self._topics.keep(self._people.ids)
        stamp = self._people.stamp
        passed = (stamp - self._last).to_sec()
        if stamp == _NEVER or passed <= 0.0:
            self._rest()
        elif passed >= _EARLY / self._settings.rate:
            self._last, self._last_at = stamp, rospy.get_time()
            self._work()

    def _work(self) -> None:
        """One result, at the newest stamp."""
        with self._times("gather"):
            self._frame.begin(self._last)
            found = self._people.take(self._frame.places, self._frame.pose_at)
        self._last = found.stamp        # a newer one, where an image has come meanwhile: it has one result, too
        if self._frame.name != self._frame_name:
            self._frame_name = self._frame.name
            self._forget()
        people, robot = found.people, self._frame.robot
        place = robot.position if robot is not None else None
        seconds = found.stamp.to_sec()
        with self._times("groups"):
            groups = self._group(people, robot, seconds)
        with self._times("gaze"):
            people.groups = group_numbers(people.ids, groups)
            gazes = self._latest_gazes = self._gazes.update(people, place, seconds)
        heading = robot.heading if robot is not None else None
        levels = self._engagement.update(people, gazes, place, seconds, heading, found.unplaced)
        with self._times("publish"):
            self._publish(found.stamp, people, gazes, groups, levels)

    def _rest(self) -> None:
        """Publish once that nobody interacts when nobody is left, or when no image comes any more.

        In ROS time: while a bag is paused, people go on with what they do.
        """
        silent = max(0.0, rospy.get_time() - self._last_at)
        listed = self._people.ids
        if self._last == _NEVER or (listed and silent < self._settings.frame_timeout):
            return
        if not self._is_empty:
            self._gazes.reset()
            self._groups.reset()
            self._grouped_at = -math.inf
            self._publish(self._last, PeopleSnapshot.empty(), [], [], {})
        # Nobody is seen: only time passes.
        levels = self._engagement.update((), [], None, self._last.to_sec() + silent, unplaced=listed)
        self._topics.publish_engagement(levels, self._last)

    def _publish(self, stamp: genpy.Time, people: PeopleSnapshot, gazes: Sequence[GazeTarget], groups: Sequence[Group],
                 levels: Dict[str, Level]) -> None:
        header = make_header(stamp, self._frame.name)
        self._topics.publish_gazes(gazes, header)
        if groups is not self._published_groups:
            self._published_groups = groups
            self._topics.publish_groups(groups, header)
        self._topics.publish_engagement(levels, stamp)
        self._is_empty = not gazes and not groups
        self._report.count(len(people), gazes, groups, levels)
        if self._marker_topic.get_num_connections():
            robot = self._frame.robot
            markers = self._markers.update(interaction_markers(
                people.observers(), gazes, groups, header, robot.position if robot is not None else None),
                without_stamp(header))
            self._marker_topic.publish(moved_markers(markers, LEVEL.inverse()) if self._frame.is_level else markers)

    def _group(self, people: PeopleSnapshot, robot: Optional[RobotPose], seconds: float) -> List[Group]:
        """Return the groups; the tracker uses its input once in group_period only, but who leaves does so at once."""
        tracked = self._people.ids
        if tracked != self._tracked:
            self._tracked, self._latest_groups = tracked, self._groups.retain(tracked)
        if not 0.0 <= seconds - self._grouped_at < self._settings.group_period - _SLACK_S:
            self._grouped_at = seconds
            individuals = individuals_of(people, self._settings.group_head_sd, self._latest_gazes)
            if robot is not None and self._settings.groups_with_robot:
                individuals.append(Individual(ROBOT, robot.position[:2], bearing(robot.heading), 0.05, 0.1))
            self._latest_groups = self._groups.update(individuals, seconds)
        return self._latest_groups

    def _watch_clock(self) -> None:
        """Begin anew when time has gone back: the clock (a bag that loops), or the stamps alone."""
        now, jumps = rospy.get_time(), self._people.jumps
        seconds = self._last_now - now
        back = seconds > JUMP_BACK_S
        self._last_now = now
        if back:
            self._people.reset(seconds)
        if back or jumps != self._jumps:
            self._jumps = jumps
            rospy.logwarn_throttle(_LOG_PERIOD_S, "%s: gazes, groups and engagement start anew",
                                   clock_went_back(seconds, not rospy.rostime.is_wallclock()) if back
                                   else "the stamps of people went back")
            self._last = _NEVER
            self._forget()

    def _forget(self) -> None:
        self._gazes.reset()
        self._groups.reset()
        self._grouped_at, self._latest_groups, self._latest_gazes = -math.inf, [], []
        self._engagement.reset()


def moved_markers(markers: MarkerArray, pose: Pose) -> MarkerArray:
    """Return the same markers, moved by a pose; their points are relative to their own poses."""
    for marker in markers.markers:
        place, turn = marker.pose.position, marker.pose.orientation
        before = (turn.x, turn.y, turn.z, turn.w)
        own = Pose.from_quaternion(before if any(before) else (0.0, 0.0, 0.0, 1.0), (place.x, place.y, place.z))
        after = pose.compose(own)
        place.x, place.y, place.z = after.translation.tolist()
        turn.x, turn.y, turn.z, turn.w = after.quaternion
    return markers


NAMESPACE = "/humans/interactions"
ENGAGEMENT = "engagement_status"
_MOST_GROUPS = 50
_RETRY_S = 1.0      # after topics could not be opened


class InteractionTopics:
    """Publishes gazes and groups, and of each person the engagement when it changes, latched.

    To open and close topics takes the master many milliseconds: a thread does that, so that gazes need not wait.
    """

    def __init__(self, interface: str, engagement: bool = True) -> None:
        """interface: PAPER or REP155 of ros/conversions.py. engagement: publish it."""
        self._interface, self._engagement = interface, engagement
        self._gaze = rospy.Publisher(NAMESPACE + "/gaze", GazesStamped, queue_size=_QUEUE)
        self._groups = rospy.Publisher(NAMESPACE + "/groups", groups_type(interface), queue_size=_MOST_GROUPS)
        self._gazing: Optional[rospy.Publisher] = (
            rospy.Publisher(NAMESPACE + "/gazing", Gaze, queue_size=_MOST_GROUPS) if has_gazing(interface) else None)
        self._publishers = IdPublishers("/humans/persons", {ENGAGEMENT: TopicSpec(EngagementLevel, True, 10)})
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
                self._publishers.publish(person, ENGAGEMENT, self._levels[person])

    def keep(self, ids: Iterable[str]) -> None:
        """Keep a topic of the engagement for each of these persons, and close the others."""
        wanted = list(ids) if self._engagement else []
        with self._lock:
            if wanted == self._wanted:
                return
            self._wanted = wanted
            self._levels = {person: level for person, level in self._levels.items() if person in wanted}
        self._changed.set()

    def close(self) -> None:
        """Close all topics. Idempotent."""
        self._closed = True
        self._changed.set()
        self._worker.join()
        self._publishers.close_all()
        for publisher in (self._gaze, self._groups, self._gazing):
            if publisher is not None:
                release(publisher)

    def _open_and_close(self) -> None:
        retry: Optional[float] = None
        while True:
            self._changed.wait(retry)
            if self._closed:
                return
            self._changed.clear()
            with self._lock:
                wanted = list(self._wanted)
            try:
                self._follow(wanted)
                retry = None
            except Exception as error:  # the topics of one person never cost those of the others
                retry = _RETRY_S
                if not rospy.is_shutdown():
                    rospy.logerr_throttle(_LOG_PERIOD_S, "topics %s of persons: %s: %s; trying again", ENGAGEMENT,
                                          type(error).__name__, error)

    def _follow(self, wanted: List[str]) -> None:
        before = set(self._publishers.ids)
        try:
            self._publishers.keep(wanted)
        finally:
            with self._lock:
                # What was published before the topics were open.
                for person in set(self._publishers.ids) - before:
                    if person in self._levels:
                        self._publishers.publish(person, ENGAGEMENT, self._levels[person])


_PERIOD_S = 1.0


class InteractionReport:
    """Counts results and publishes the state once a second."""

    def __init__(self, people: PeopleInput, frame: InteractionFrame, times: StageTimes) -> None:
        self._people, self._frame, self._times = people, frame, times
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._since = time.monotonic()
        self._results = 0
        self._latest: Dict[str, object] = {}
        self.errors = 0

    def count(self, people: int, gazes: Sequence[GazeTarget], groups: Sequence[Group],
              levels: Dict[str, Level]) -> None:
        """Take one result."""
        self._results += 1
        self._latest = {"people with a place": people, "gazes": len(gazes),
                        "at the robot": sum(gaze.receiver == ROBOT for gaze in gazes),
                        "groups": len(groups), "engaged": sum(level == Level.ENGAGED for level in levels.values())}

    def update(self) -> None:
        """Publish once a second."""
        passed = time.monotonic() - self._since
        if passed < _PERIOD_S:
            return
        values = dict(self._latest, **{"results per second": self._results / passed, "errors": self.errors})
        values.update(self._times.values())
        self._since, self._results = time.monotonic(), 0
        text = "%d gazes, %d groups" % (values.get("gazes", 0), values.get("groups", 0))
        self._diagnostics.set("interactions", WARN if self.errors else OK, text, values)
        unconnected, values = sorted(self._frame.unconnected), self._people.status()
        values["robot is at"] = self._frame.robot_source
        self._diagnostics.set(
            "location", WARN if unconnected else OK,
            "no transform from %s to the reference frame, see /humans/reference_frame" % ", ".join(unconnected)
            if unconnected else "people are compared in %s" % self._frame.name, values)
        for kind, feed in self._people.feeds.items():
            self._diagnostics.set(kind, *feed.status(optional=kind != "persons"))

    def close(self) -> None:
        """Close the topic. Idempotent."""
        self._diagnostics.close()
