"""Transforms on /tf and /tf_static: where the tracked features are, in the frame of their sensor and in the reference
frame."""

from __future__ import annotations

import threading
import time
from typing import Callable, Dict, Iterable, List, NamedTuple, Optional, Set, Tuple

import genpy
import rospy

from hri_person_manager.core.features import Kind
from hri_person_manager.core.human_frames import FeaturePose, FrameLink, HumanFrames
from hri_person_manager.core.location import Place
from hri_pipeline.core.frames import RawTransform, is_of_human, read
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.tf import Frames, RobotTf, TfSubscriber

_LOG_PERIOD_S = 10.0
_MAX_LIMBS = 5000
GRACE_S = 2.0       # wall time in which the transforms may still be on their way when everything starts
_REMEMBERED_SENSORS = 50


class StampedFeaturePose(NamedTuple):
    """A feature pose with the exact stamp of its transform (seconds in a float lose the nanoseconds)."""

    feature_pose: FeaturePose
    stamp: genpy.Time


class TfInput:
    """Reports where tracked features are, in their sensor's frame, and looks sensors up in the reference frame.

    `on_poses` is called in rospy's thread, once per message that places a feature. A transform that
    cannot be used is counted and left out. Nothing is kept of a human who is gone. Of the links of a skeleton only
    those that lead to the head are read; of the others the name is looked at.
    """

    def __init__(self, reference_frame: str, source_timeout: float,
                 on_poses: Callable[[List[StampedFeaturePose]], None]) -> None:
        self._on_poses = on_poses
        self._lock = threading.Lock()
        self._humans = HumanFrames(source_timeout)
        self._robot = RobotTf(reference_frame)
        self._limbs: Set[str] = set()
        self._stamp = genpy.Time()
        self._now = 0.0
        self.refused = 0
        self._subscriber = TfSubscriber(self._on_frames)

    def set_tracked(self, kind: Kind, ids: Iterable[str]) -> None:
        """Follow the frames of these features; those of others of the kind are freed."""
        with self._lock:
            found = self._humans.set_tracked(kind, ids)
            self._limbs.clear()
        if found:
            # Of fixed frames, which are true at all times.
            now = rospy.Time.now()
            self._on_poses([StampedFeaturePose(feature_pose._replace(stamp=now.to_sec()), now)
                            for feature_pose in found])

    def lookup(self, sensor: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a sensor frame in the reference frame at `stamp`, else the latest; None without any."""
        return self._robot.lookup(sensor, stamp)

    def between(self, target: str, frame: str, stamp: genpy.Time) -> Optional[Pose]:
        """Return the pose of a frame of the robot in another one, as lookup() does."""
        return self._robot.between(target, frame, stamp)

    def reset(self) -> None:
        """Forget all moving transforms, as after a time jump."""
        with self._lock:
            self._humans.clear()
        self._robot.reset()

    def status(self) -> dict:
        """Return how much is kept, for diagnostics."""
        with self._lock:
            return {"human frames": len(self._humans), "robot frames": self._robot.known,
                    "frames with history": len(self._robot.relevant), "transforms refused": self.refused,
                    "messages refused": self._subscriber.refused}

    def close(self) -> None:
        """Let go of both topics. Idempotent."""
        self._subscriber.close()

    def _on_frames(self, data: bytes, frames: Frames, fixed: bool) -> None:
        found: List[StampedFeaturePose] = []
        with self._lock:
            self._now = rospy.get_time()
            # A link of a head tells which link above it is wanted too; that may stand earlier in the same message.
            wanted = -1
            while frames and wanted != self._humans.wanted_frames:
                wanted = self._humans.wanted_frames
                frames = [entry for entry in frames if not self._take(data, entry, fixed, found)]
        if found:
            self._on_poses(found)

    def _take(self, data: bytes, entry: Tuple[bytes, int], fixed: bool, found: List[StampedFeaturePose]) -> bool:
        """Take one transform of a message; False for one of a human that places nobody: only its name has been read."""
        child, offset = entry
        name = child.decode("utf-8", "replace").lstrip("/")
        owner = self._humans.wanted(name)
        if owner is None and (is_of_human(child, fixed) or not fixed and self._is_limb(name)):
            return False        # a limb, or of somebody who is not tracked (any more)
        try:
            transform = read(data, offset)
            feature_pose = self._use(name, owner, transform, fixed)
        except ValueError as error:
            self.refused += 1
            rospy.logwarn_throttle(_LOG_PERIOD_S, "/tf: frame %r not used: %s", name[:80], error)
            return True
        if feature_pose is not None:
            found.append(StampedFeaturePose(feature_pose, self._time(transform)))
        return True

    def _time(self, transform: RawTransform) -> genpy.Time:
        """Return the stamp; all frames of one image have the same, and to make one takes genpy long."""
        if (transform.secs, transform.nsecs) != (self._stamp.secs, self._stamp.nsecs):
            self._stamp = genpy.Time(transform.secs, transform.nsecs)
        return self._stamp

    def _is_limb(self, name: str) -> bool:
        if name in self._limbs:
            return True
        if self._humans.owner(name) is None:
            return False
        if len(self._limbs) < _MAX_LIMBS:
            self._limbs.add(name)
        return True

    def _use(self, name: str, owner: Optional[Tuple[Kind, str]], transform: RawTransform,
             fixed: bool) -> Optional[FeaturePose]:
        if not name or not transform.parent or name == transform.parent:
            raise ValueError("a transform needs two different frames")
        link = FrameLink(transform.parent, transform.translation, transform.rotation,
                    float("inf") if fixed else transform.stamp, self._now)
        # A fixed link comes only once, so that all of them are kept.
        owner = self._humans.owner(name) if owner is None and fixed else owner
        if owner is not None:
            feature_pose = self._humans.put(owner, name, link)
            return feature_pose._replace(stamp=transform.stamp) if feature_pose is not None and fixed else feature_pose
        if fixed:
            self._humans.keep_static(name, link)
        self._robot.put(transform, fixed)
        return None


class ReferenceFrame:
    """Transforms poses; warns once, by name of the parameter, when a sensor is not connected."""

    def __init__(self, frame: str, tf_input: TfInput) -> None:
        """Place everything in `frame`, with the transforms that `tf_input` keeps."""
        self._frame = frame
        self._tf_input = tf_input
        self._missing_since: Dict[str, float] = {}
        self._warned = False
        self._last: Tuple[str, genpy.Time, Optional[Pose]] = ("", genpy.Time(), None)

    @property
    def unconnected(self) -> Set[str]:
        """Return the sensor frames from which nothing leads to the reference frame."""
        return set(self._missing_since)

    @property
    def frame(self) -> str:
        """Return the name of the reference frame."""
        return self._frame

    def place(self, stamped: StampedFeaturePose) -> Place:
        """Return the place of a feature pose in the reference frame, else in the frame of its sensor."""
        feature_pose = stamped.feature_pose
        if self._last[0] != feature_pose.sensor or self._last[1] != stamped.stamp:
            # All features of one image have its stamp: one look-up for all of them.
            self._last = (feature_pose.sensor, stamped.stamp, self._tf_input.lookup(feature_pose.sensor, stamped.stamp))
            if self._last[2] is None:
                self._miss(feature_pose.sensor)
            else:
                self._missing_since.pop(feature_pose.sensor, None)
        sensor = self._last[2]
        if sensor is None:
            return Place(feature_pose.sensor, feature_pose.pose, feature_pose.stamp, stamped.stamp)
        return Place(self._frame, sensor.compose(feature_pose.pose), feature_pose.stamp, stamped.stamp,
                     sensor.translation)

    def _miss(self, sensor: str) -> None:
        if sensor not in self._missing_since:
            if len(self._missing_since) >= _REMEMBERED_SENSORS:
                return
            self._missing_since[sensor] = time.monotonic()
        if not self._warned and time.monotonic() - self._missing_since[sensor] > GRACE_S:
            self._warned = True
            rospy.logwarn(
                "no transform leads from %s to the reference frame %s: persons are placed relative to %s and "
                "move with it. Start what publishes the position of the robot (localisation, or "
                "static_transform_publisher from %s), or set the parameter /humans/reference_frame to a frame "
                "that exists, for example odom or base_link.", sensor, self._frame, sensor, self._frame)
