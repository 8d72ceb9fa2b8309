"""The frame in which people are compared, and where the robot is in it."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Counter, Dict, NamedTuple, Optional, Set

import genpy
import numpy as np
import rospy

from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.people_feed import is_optical
from hri_pipeline.ros.robot_frames import RobotFrames

GRACE_S = 2.0       # wall time in which the transforms may still be on their way when everything starts
LEVEL = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
"""An upright camera's optical frame seen from a frame at the same place with x forward and z up (REP-103)."""


class RobotPose(NamedTuple):
    """Where the robot is (3,) m, and where it looks (3,)."""

    position: np.ndarray
    heading: np.ndarray


class InteractionFrame:
    """Chooses the frame of each cycle: the reference frame, else that of the sensor that sees most people.

    Warns once when nothing leads to the reference frame, and once when the frame of the robot is not known.
    """

    def __init__(self, settings: SimpleNamespace, frames: RobotFrames) -> None:
        self._reference, self._robot_frame = settings.reference_frame, settings.robot_frame
        self._frames = frames
        self._stamp = genpy.Time()
        self._poses: Dict[str, Optional[Pose]] = {}
        self._missing_since: Dict[str, float] = {}
        self._warned: Set[str] = set()
        self._began = time.monotonic()
        self.name = self._reference
        self.sensor = ""
        self.robot: Optional[RobotPose] = None
        self.robot_source = "unknown"

    @property
    def is_level(self) -> bool:
        """Tell whether people are compared in LEVEL of the optical frame `name`, for want of the reference frame."""
        return self.name != self._reference

    @property
    def unconnected(self) -> Set[str]:
        """Return the sensor frames from which nothing leads to the reference frame."""
        return set(self._missing_since)

    def begin(self, stamp: genpy.Time) -> None:
        """Begin a cycle at `stamp`."""
        self._stamp = stamp
        self._poses = {}

    def places(self, sensors: Counter[str]) -> Dict[str, Pose]:
        """Return the poses of these sensors, with the number of their people, in the frame of this cycle."""
        poses = {sensor: self._lookup(sensor) for sensor in sensors}
        found = {sensor: pose for sensor, pose in poses.items() if pose is not None}
        self._note([sensor for sensor, pose in poses.items() if pose is None])
        self._choose(Counter({sensor: count for sensor, count in sensors.items() if sensor != self._reference}))
        if found or not sensors:
            self.name = self._reference
        else:
            self.name = self.sensor
            found = {self.sensor: LEVEL}
        self._find_robot(found)
        return found

    def _lookup(self, frame: str) -> Optional[Pose]:
        """Look a frame up, once in a cycle: the robot often looks from where its camera is."""
        if frame not in self._poses:
            self._poses[frame] = self._frames.lookup(frame, self._stamp)
        return self._poses[frame]

    def _choose(self, sensors: Counter[str]) -> None:
        """Choose the camera that stands for the robot; it stays while it sees anybody."""
        if sensors and not sensors.get(self.sensor):
            self.sensor = sensors.most_common(1)[0][0]

    def _find_robot(self, poses: Dict[str, Pose]) -> None:
        pose, source = None, self._robot_frame
        if source and not self.is_level:
            pose = self._lookup(source)
        if pose is None:
            self._warn_of_robot()
            source = self.sensor
            pose = poses.get(source) or (self._lookup(source) if source and not self.is_level else None)
        if pose is None:
            self.robot, self.robot_source = None, "unknown"
            return
        # Frames of sensors without `optical` in their name are taken for optical ones in LEVEL only.
        axis = 2 if is_optical(source) or (self.is_level and source == self.sensor) else 0
        self.robot = RobotPose(pose.translation, pose.rotation[:, axis])
        self.robot_source = source

    def _note(self, missing: list) -> None:
        for sensor in missing:
            self._missing_since.setdefault(sensor, time.monotonic())
        for sensor in [sensor for sensor in self._missing_since if sensor not in missing]:
            del self._missing_since[sensor]
        late = [sensor for sensor in missing if time.monotonic() - self._missing_since[sensor] > GRACE_S]
        if late and "reference" not in self._warned:
            self._warned.add("reference")
            rospy.logwarn(
                "no transform leads from %s to the reference frame %s: people are compared in %s, which is taken for level, and only "
                "those of one such sensor. Start what publishes the position of the robot (localisation, or "
                "static_transform_publisher from %s), or set the parameter /humans/reference_frame to a frame that exists, for "
                "example odom or base_link.", late[0], self._reference, late[0], self._reference)

    def _warn_of_robot(self) -> None:
        if "robot" in self._warned or time.monotonic() - self._began < GRACE_S or not self.sensor:
            return
        self._warned.add("robot")
        if self._robot_frame:
            rospy.logwarn("no transform leads from the robot_frame %s to %s: the robot is taken to be where its camera %s is, and to "
                          "look where that looks.", self._robot_frame, self._reference, self.sensor)
        else:
            rospy.logwarn("robot_frame is not set: the robot is taken to be where its camera %s is, and to look where that looks. Set "
                          "~robot_frame, or /humans/robot_reference_frame, to the frame of the robot's head.", self.sensor)
