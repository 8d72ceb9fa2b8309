"""Transforms on /tf and /tf_static: where the tracked features are, in the frame of their sensor and in the reference
frame. And who else publishes persons."""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from typing import Callable, Deque, Dict, List, Optional, Sequence, Set, Tuple

import genpy
import rospy

from hri_msgs.msg import IdsList
from hri_person_manager.core.features import FeaturePose, FeatureTf, Kind, PlaceSource
from hri_person_manager.core.location import Place
from hri_pipeline.core.frames import is_optical
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.rospy_compat import release, sender_of
from hri_pipeline.ros.tf import Frames, RobotTf, TfSubscriber

_LOG_PERIOD_S = 10.0
_OTHERS_S = 5.0     # a list comes once a second
LAG_S = 0.25        # for which places wait for the transforms of a camera that moves
GRACE_S = 2.0       # wall time in which the transforms may still be on their way when everything starts
_REMEMBERED_SENSORS = 50
_LATE_S = 0.2       # by which transforms may be behind: beyond it nothing is foreseen
_MISSED_S = 10.0    # wall time after which a sensor that nothing comes of is no longer told
ALONG = 0.7         # cosine of an angle up to which a head points along an axis
AS_SENSOR = 0.94    # the same between axes of a sensor and of the reference frame: fewer robots look up so steeply
LEAST_VOTES, MOST_VOTES = 5, 20     # faces and bodies that tell that the reference frame is a camera's
CAMERA_IS_REFERENCE = (
    "the reference frame {} has the axes of a camera: people's heads point along its -y, and z is where the camera "
    "looks. Distances on the floor are taken so here, but other programs take z for up: {}set /humans/reference_frame "
    "to a level frame, for example map, odom or base_link")
_TURN = (
    "publish the turn to the camera's optical frame with the transform to {}, as a static_transform_publisher does "
    "with X Y Z -1.5708 0 -1.5708; or ")
_PERSONS = "/humans/persons/tracked"
_PLAYER = re.compile(r"/play_[0-9]{9,}")     # the name that rosbag gives itself


def double_persons(others: Sequence[str]) -> str:
    """Return what to say of other nodes that publish persons: of a recording or of another robot."""
    mend = "start one of the stacks with persons:=false, or give each robot a ROS master of its own"
    if all(_PLAYER.fullmatch(name) for name in others):
        mend = "the recording holds people: roslaunch ros4hri bag.launch, or rosbag play --topics IMAGE CAMERA_INFO"
    return "{}: {} publishes persons, too, so that people are there more than once; {}".format(
        _PERSONS, ", ".join(others), mend)


class OtherManagers:
    """Listens for other nodes that publish the list of persons, as the stack of a second robot on the same master does.
    """

    def __init__(self) -> None:
        self._heard: Dict[str, float] = {}
        self._name = rospy.get_name()
        self._subscriber = rospy.Subscriber(_PERSONS, IdsList, self._on_list, queue_size=10)

    def problem(self) -> str:
        """Return who publishes persons, too, and what to do; empty when nobody does."""
        now = time.monotonic()
        others = sorted(name for name, at in tuple(self._heard.items()) if now - at < _OTHERS_S)
        return double_persons(others) if others else ""

    def close(self) -> None:
        """Stop listening. Idempotent."""
        release(self._subscriber)

    def _on_list(self, message: IdsList) -> None:
        name = sender_of(message)
        if name != self._name:
            now = time.monotonic()
            self._heard = {**{other: at for other, at in self._heard.items() if now - at < _OTHERS_S}, name: now}


class TfInput:
    """Reports where tracked features are, in their sensor's frame, and looks sensors up in the reference frame.

    `on_poses` is called in rospy's thread, once per message that places a feature. A transform that
    cannot be used is counted and left out. Where the camera moves, and its transforms come later than those of people,
    these wait for them, LAG_S at most. Nothing is kept of a human who is gone. Of the links of a skeleton only
    those that lead to the head are read; of the others the name is looked at.
    """

    def __init__(self, reference_frame: str, source_timeout: float,
                 on_poses: Callable[[List[FeaturePose]], None]) -> None:
        self._on_poses = on_poses
        self._lock, self._in_order = threading.Lock(), threading.Lock()
        self._waiting: Deque[Tuple[float, List[FeaturePose]]] = deque()
        self._humans = FeatureTf(source_timeout)
        self._robot = RobotTf(reference_frame)
        self._subscriber = TfSubscriber(self._on_frames)

    def set_tracked(self, kind: Kind, ids: Sequence[str]) -> None:
        """Follow the frames of these features; those of others of the kind are freed."""
        with self._lock:
            found = self._humans.set_tracked(kind, ids)
        if found:
            # Of fixed frames, which are true at all times.
            now = rospy.Time.now()
            self._on_poses([pose._replace(secs=now.secs, nsecs=now.nsecs) for pose in found])

    def lookup(self, sensor: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a sensor frame in the reference frame at `stamp`, else the latest; None without any."""
        return self._robot.lookup(sensor, stamp)

    def moves_until(self, sensor: str) -> Optional[float]:
        """Return until when (s) the transforms of a sensor that moves have come, None for one that stands."""
        return self._robot.moves_until(sensor)

    def between(self, target: str, frame: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a frame of the robot in another one, as lookup() does."""
        return self._robot.between(target, frame, stamp)

    def reset(self) -> None:
        """Forget all moving transforms, as after a time jump."""
        with self._lock:
            self._humans.clear_moving()
            self._waiting.clear()
        self._robot.reset()

    def status(self) -> dict:
        """Return how much is kept, for diagnostics."""
        with self._lock:
            return {"human frames": len(self._humans), "robot frames": self._robot.known,
                    "frames with history": len(self._robot.relevant), "transforms refused": self._humans.refused,
                    "messages refused": self._subscriber.refused}

    def close(self) -> None:
        """Let go of both topics. Idempotent."""
        self._subscriber.close()

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        with self._lock:
            refused = self._humans.refused
            found = self._humans.take(data, frames, fixed, rospy.get_time())
            if self._humans.refused > refused:
                rospy.logwarn_throttle(_LOG_PERIOD_S, "/tf: a transform of somebody has numbers that are no pose")
            for child, offset in frames:
                child = child.lstrip(b"/")
                other = None if self._humans.wants(child) else self._humans.take_other(child, data, offset, fixed)
                if other is not None:
                    self._robot.put(other, fixed)
            if found:
                self._waiting.append((rospy.get_time(), found))
        if self._waiting:
            self.pass_on()

    def pass_on(self) -> None:
        """Report the places that need not wait any longer, those of each sensor in the order in which they came."""
        with self._in_order:
            while True:
                with self._lock:
                    poses = self._next()
                if poses is None:
                    return
                self._on_poses(poses)

    def _next(self) -> Optional[List[FeaturePose]]:
        """Take out the first places that need not wait, of sensors none of whose earlier ones do."""
        held: Set[str] = set()
        for row, (since, poses) in enumerate(self._waiting):
            sensors = {pose.sensor for pose in poses}
            if not sensors & held and not self._waits(since, poses):
                del self._waiting[row]
                return poses
            held |= sensors
        return None

    def _waits(self, since: float, poses: List[FeaturePose]) -> bool:
        return 0.0 <= rospy.get_time() - since < LAG_S and any(
            self._robot.lags(sensor, genpy.Time(secs, nsecs))
            for sensor, secs, nsecs in {(pose.sensor, pose.secs, pose.nsecs) for pose in poses})


class ReferenceFrame:
    """Transforms poses; warns once for each sensor that is not connected, by name of the parameter."""

    def __init__(self, frame: str, tf_input: TfInput) -> None:
        """Place everything in `frame`, with the transforms that `tf_input` keeps."""
        self._frame = frame
        self._tf_input = tf_input
        self._missing: Dict[str, Tuple[float, float]] = {}      # sensor: since when, and when it was missed last
        self._warned: Set[str] = set()
        self._late: Dict[str, Tuple[float, float]] = {}         # the same of sensors whose transforms come late
        self._moved_until: Dict[str, Optional[float]] = {}      # by their transforms (s), at the last look
        self._camera_votes, self._is_camera, self._camera_told, self._camera = 0, False, False, ""
        self._last: Tuple[str, genpy.Time, float, Optional[Pose]] = ("", genpy.Time(), 0.0, None)

    @property
    def unconnected(self) -> Set[str]:
        """Return the sensor frames in use from which nothing leads to the reference frame."""
        now = time.monotonic()
        return {sensor for sensor, (_, last) in list(self._missing.items()) if now - last < _MISSED_S}

    @property
    def late(self) -> Set[str]:
        """Return the sensors that move and whose transforms come too late to tell where people are."""
        now = time.monotonic()
        return {sensor for sensor, (since, last) in list(self._late.items())
                if now - last < _MISSED_S and last - since > GRACE_S}

    @property
    def frame(self) -> str:
        """Return the name of the reference frame."""
        return self._frame

    def place(self, pose: FeaturePose) -> Place:
        """Return the place of a feature in the reference frame, else in the frame of its sensor."""
        last, stamp, seconds, sensor = self._last
        if last != pose.sensor or (stamp.secs, stamp.nsecs) != (pose.secs, pose.nsecs):
            # All features of one image have its stamp: one look-up for all of them.
            stamp = genpy.Time(pose.secs, pose.nsecs)
            seconds = stamp.to_sec()
            sensor = self._tf_input.lookup(pose.sensor, stamp)
            self._last = pose.sensor, stamp, seconds, sensor
            if sensor is None:
                self._miss(pose.sensor)
            else:
                self._missing.pop(pose.sensor, None)
                self._compare_times(pose.sensor, seconds)
        if sensor is None:
            # Faces and bodies come in the optical frame of their camera, whatever it is called.
            return Place(pose.sensor, pose.pose, seconds, stamp, of_camera=pose.source != PlaceSource.VOICE)
        found = sensor.compose(pose.pose)
        if pose.source != PlaceSource.VOICE:
            self._see_axes(pose.sensor, sensor, found)
        return Place(self._frame, found, seconds, stamp, sensor.translation, camera=sensor,
                     of_camera=self._is_camera)

    def _compare_times(self, sensor: str, stamp: float) -> None:
        """Note where the transforms of a sensor that moves go on, but are so far behind `stamp` (s) that its pose is a
        guess; those that have ended, as some do while the sensor stands, are not late."""
        until, before = self._tf_input.moves_until(sensor), self._moved_until.get(sensor)
        if sensor in self._moved_until or len(self._moved_until) < _REMEMBERED_SENSORS:
            self._moved_until[sensor] = until
        if until is not None and before is not None and before < until < stamp - _LATE_S:
            _note(self._late, sensor)

    @property
    def problem(self) -> str:
        """What is wrong with the reference frame itself, and what to do; empty where nothing is."""
        if not self._is_camera:
            return ""
        return CAMERA_IS_REFERENCE.format(self._frame, "" if self._camera == self._frame else _TURN.format(
            self._camera))

    def _see_axes(self, name: str, sensor: Pose, human: Pose) -> None:
        """Notice a reference frame that has the axes of a camera although its name does not say so: heads point along
        -y, and z points to where the camera looks."""
        if is_optical(self._frame):
            return
        if human.rotation[2, 2] > ALONG:
            self._camera_votes = max(-MOST_VOTES, self._camera_votes - 1)
        elif -human.rotation[1, 2] > ALONG and min(sensor.rotation[1, 1], sensor.rotation[2, 2]) > AS_SENSOR:
            self._camera_votes, self._camera = min(MOST_VOTES, self._camera_votes + 1), name
        self._is_camera = self._camera_votes >= (1 if self._is_camera else LEAST_VOTES)
        if self._is_camera and not self._camera_told:
            self._camera_told = True
            rospy.logwarn("%s", self.problem)

    def _miss(self, sensor: str) -> None:
        _note(self._missing, sensor)
        since, last = self._missing.get(sensor, (0.0, 0.0))
        if sensor not in self._warned and last - since > GRACE_S:
            self._warned.add(sensor)
            rospy.logwarn(
                "no transform leads from %s to the reference frame %s: persons are placed relative to %s and "
                "move with it. Start what publishes the position of the robot (localisation, or "
                "static_transform_publisher from %s), or set the parameter /humans/reference_frame to a frame "
                "that exists, for example odom or base_link.", sensor, self._frame, sensor, self._frame)


def _note(times: Dict[str, Tuple[float, float]], sensor: str) -> None:
    """Note that something is so of a sensor now: since when (wall time), and when it was last."""
    now = time.monotonic()
    if sensor in times or len(times) < _REMEMBERED_SENSORS:
        since, last = times.get(sensor, (now, now))
        times[sensor] = since if now - last < _MISSED_S else now, now
