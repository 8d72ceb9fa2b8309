"""Places of features in the reference frame, or in the sensor's own frame where nothing leads there."""

from __future__ import annotations

import time
from typing import Dict, Optional, Set, Tuple

import genpy
import rospy

from hri_person_manager.core.location import Place
from hri_person_manager.ros.tf_intake import StampedSighting, TfIntake
from hri_pipeline.core.geometry import Pose

GRACE_S = 2.0       # wall time in which the transforms may still be on their way when everything starts
_REMEMBERED_SENSORS = 50


class ReferenceFrame:
    """Transforms sightings; warns once, by name of the parameter, when a sensor is not connected."""

    def __init__(self, frame: str, intake: TfIntake) -> None:
        """Place everything in `frame`, with the transforms that `intake` keeps."""
        self._frame = frame
        self._intake = intake
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

    def place(self, stamped: StampedSighting) -> Place:
        """Return the place of a sighting in the reference frame, else in the frame of its sensor."""
        sighting = stamped.sighting
        if self._last[0] != sighting.sensor or self._last[1] != stamped.stamp:
            # All features of one image have its stamp: one look-up for all of them.
            self._last = (sighting.sensor, stamped.stamp, self._intake.lookup(sighting.sensor, stamped.stamp))
            if self._last[2] is None:
                self._miss(sighting.sensor)
            else:
                self._missing_since.pop(sighting.sensor, None)
        sensor = self._last[2]
        if sensor is None:
            return Place(sighting.sensor, sighting.pose, sighting.stamp)
        return Place(self._frame, sensor.compose(sighting.pose), sighting.stamp)

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
