"""The interactions node: people's frames in; gazes, groups and engagement out."""

from __future__ import annotations

import math
import threading
import time
import traceback
from types import SimpleNamespace
from typing import Dict, List, Optional, Sequence

import genpy
import rospy
from visualization_msgs.msg import MarkerArray

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.crowd import Crowd
from hri_pipeline.core.interactions.engagement import EngagementEstimator, Level, check_levels
from hri_pipeline.core.interactions.gaze_targets import ROBOT, GazeTarget, GazeTargets
from hri_pipeline.core.interactions.group_tracker import Group, GroupTracker, Stander, fuse_directions
from hri_pipeline.core.memory import share_arenas
from hri_pipeline.core.parameters import ParameterError, take_over
from hri_pipeline.core.timing import StageTimes
from hri_pipeline.ros.conversions import make_header
from hri_pipeline.ros.interactions.interaction_frame import LEVEL, InteractionFrame, RobotPose
from hri_pipeline.ros.interactions.interaction_markers import InteractionMarkers
from hri_pipeline.ros.interactions.interaction_report import InteractionReport
from hri_pipeline.ros.interactions.interaction_topics import InteractionTopics
from hri_pipeline.ros.people_feed import PeopleFeed
from hri_pipeline.ros.robot_frames import RobotFrames
from hri_pipeline.ros.topic_release import release

IDLE_S = 0.25
GATHER_S = 0.01         # faces, bodies and persons of one image come one after the other
JUMP_BACK_S = 0.5
_EARLY = 0.9            # part of the period after which the next image is not too early
_LOG_PERIOD_S = 10.0
_SLACK_S = 1e-3
_NEVER = genpy.Time()


class InteractionsNode:
    """Publishes who looks at whom, who stands together and who is engaged, once per image, with its stamp.

    Callbacks only store; the caller of spin() does everything else.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        """settings: the values of INTERACTION_PARAMETERS. Raises ParameterError for values that contradict each other."""
        self._settings = settings
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._gazes = GazeTargets(settings)
        self._groups = GroupTracker(settings)
        try:
            self._engagement = EngagementEstimator(settings)
        except ValueError as error:
            raise ParameterError("{}: {}".format(rospy.get_name(), error)) from error
        self._last, self._last_at, self._last_now, self._jumps = _NEVER, time.monotonic(), rospy.get_time(), 0
        self._is_empty = True
        self._frame_name = ""
        self._grouped_at = -math.inf
        self._latest_groups: List[Group] = []
        self._told_groups: Optional[Sequence[Group]] = None
        self._times = StageTimes()
        self._markers = InteractionMarkers()
        self._marker_topic = rospy.Publisher("visualization/interactions", MarkerArray, queue_size=1)
        self._topics = InteractionTopics(settings.interface)
        robot = RobotFrames(settings.reference_frame)
        self._frame = InteractionFrame(settings, robot)
        self._feed = PeopleFeed(settings, robot)
        self._report = InteractionReport(self._feed, self._frame, self._times)
        rospy.on_shutdown(self._end)
        share_arenas()

    def spin(self) -> None:
        """Work until ROS shuts down."""
        while not self._stop.is_set():
            if self._feed.news.wait(IDLE_S):
                self._stop.wait(GATHER_S)
            self._feed.news.clear()
            try:
                with self._lock:
                    self._cycle()
            except Exception:  # what one image does never ends the node
                self._report.errors += 1
                rospy.logerr_throttle(_LOG_PERIOD_S, "an image gave no interactions:\n%s", traceback.format_exc())
            self._report.update()

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters between two images. ValueError for levels in the wrong order."""
        check_levels(settings)
        with self._lock:
            take_over(self._settings, settings)

    def close(self) -> None:
        """Take everything back. Idempotent."""
        self._end()
        self._feed.close()
        self._topics.close()
        self._report.close()
        release(self._marker_topic)

    def _end(self) -> None:
        self._stop.set()
        self._feed.news.set()

    def _cycle(self) -> None:
        self._watch_clock()
        self._topics.keep(self._feed.ids)
        stamp = self._feed.stamp
        passed = (stamp - self._last).to_sec()
        if stamp == _NEVER or passed <= 0.0:
            self._rest()
        elif passed >= _EARLY / self._settings.rate:
            self._last, self._last_at = stamp, time.monotonic()
            self._work()

    def _work(self) -> None:
        """One result, at the newest stamp."""
        with self._times("gather"):
            self._frame.begin(self._last)
            moment = self._feed.take(self._frame.places)
        if self._frame.name != self._frame_name:
            self._frame_name = self._frame.name
            self._forget()
        people, robot = moment.people, self._frame.robot
        place = robot.position if robot is not None else None
        seconds = moment.stamp.to_sec()
        with self._times("gaze"):
            gazes = self._gazes.update(people, place, seconds)
        with self._times("groups"):
            groups = self._group(people, robot, seconds)
        heading = robot.heading if robot is not None else None
        levels = self._engagement.update(people, gazes, place, seconds, heading, moment.unplaced)
        with self._times("publish"):
            self._say(moment.stamp, people, gazes, groups, levels)

    def _rest(self) -> None:
        """Say once that nobody interacts when nobody is left, or when no image comes any more."""
        silent = time.monotonic() - self._last_at
        listed = self._feed.ids
        if self._last == _NEVER or (listed and silent < self._settings.frame_timeout):
            return
        if not self._is_empty:
            self._gazes.reset()
            self._groups.reset()
            self._grouped_at = -math.inf
            self._say(self._last, Crowd.empty(), [], [], {})
        # Nobody is seen: it is only time that passes.
        levels = self._engagement.update((), [], None, self._last.to_sec() + silent, unplaced=listed)
        self._topics.publish_engagement(levels, self._last)

    def _say(self, stamp: genpy.Time, people: Crowd, gazes: Sequence[GazeTarget], groups: Sequence[Group],
             levels: Dict[str, Level]) -> None:
        header = make_header(stamp, self._frame.name)
        self._topics.publish_gazes(gazes, header)
        if groups is not self._told_groups:
            self._told_groups = groups
            self._topics.publish_groups(groups, header)
        self._topics.publish_engagement(levels, stamp)
        self._is_empty = not gazes and not groups
        self._report.count(len(people), gazes, groups, levels)
        if self._marker_topic.get_num_connections():
            robot = self._frame.robot
            markers = self._markers.make(people.onlookers(), gazes, groups, header, robot.position if robot is not None else None)
            self._marker_topic.publish(turned(markers, LEVEL.inverse()) if self._frame.is_level else markers)

    def _group(self, people: Crowd, robot: Optional[RobotPose], seconds: float) -> List[Group]:
        """Return the groups, which are looked at once in group_period: nobody need make what is not looked at."""
        if not 0.0 <= seconds - self._grouped_at < self._settings.group_period - _SLACK_S:
            self._grouped_at = seconds
            self._latest_groups = self._groups.update(self._standers(people, robot), seconds)
        return self._latest_groups

    def _standers(self, people: Crowd, robot: Optional[RobotPose]) -> List[Stander]:
        found = []
        for identity, place, trunk, face, (place_sd, face_sd, _, trunk_sd) in zip(
                people.ids, people.heads[:, :2], people.trunks.tolist(), people.faces.tolist(), people.deviations.tolist()):
            direction, sd = fuse_directions(_bearing(trunk), trunk_sd, _bearing(face), face_sd, self._settings.group_head_sd)
            found.append(Stander(identity, place, direction, place_sd, sd))
        if robot is not None and self._settings.groups_with_robot:
            found.append(Stander(ROBOT, robot.position[:2], _bearing(robot.heading), 0.05, 0.1))
        return found

    def _watch_clock(self) -> None:
        """Begin anew when time has gone back: the clock (a bag that loops), or the stamps alone."""
        now, jumps = rospy.get_time(), self._feed.jumps
        back = now < self._last_now - JUMP_BACK_S
        self._last_now = now
        if back:
            self._feed.reset()
        if back or jumps != self._jumps:
            self._jumps = jumps
            rospy.logwarn("time went back: gazes, groups and engagement start anew")
            self._last = _NEVER
            self._forget()

    def _forget(self) -> None:
        self._gazes.reset()
        self._groups.reset()
        self._grouped_at, self._latest_groups = -math.inf, []
        self._engagement.reset()


def turned(markers: MarkerArray, pose: Pose) -> MarkerArray:
    """Return the same markers, moved by a pose; their points are relative to their own poses."""
    for marker in markers.markers:
        place, turn = marker.pose.position, marker.pose.orientation
        before = (turn.x, turn.y, turn.z, turn.w)
        own = Pose.from_quaternion(before if any(before) else (0.0, 0.0, 0.0, 1.0), (place.x, place.y, place.z))
        after = pose.compose(own)
        place.x, place.y, place.z = after.translation.tolist()
        turn.x, turn.y, turn.z, turn.w = after.quaternion
    return markers


def _bearing(direction: Sequence[float]) -> Optional[float]:
    """Bearing (rad) of a direction (3,) in the horizontal plane; None where it has none, or is not known (NaN)."""
    x, y = direction[0], direction[1]
    return math.atan2(y, x) if math.hypot(x, y) >= 0.2 else None
