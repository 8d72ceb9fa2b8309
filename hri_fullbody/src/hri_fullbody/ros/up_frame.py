"""Which way is up for the camera, and how high it stands."""

from __future__ import annotations

import time
from typing import Optional, Tuple

import genpy
import numpy as np
import rospy

from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.tf import RobotTfListener

_GRACE_S = 3.0
_LOWEST_M, _HIGHEST_M = 0.05, 10.0


class UpFrame:
    """Pose of the camera in a frame whose z axis points up and whose z = 0 is the floor.

    name: that frame; empty: there is none, and `lookup` tells nothing.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._frames: Optional[RobotTfListener] = RobotTfListener(name) if name else None
        self._missing_since: Optional[float] = None
        self._told = False

    def lookup(self, camera: str, stamp: genpy.Time) -> Tuple[Optional[np.ndarray], Optional[float]]:
        """Return up (3,) in the frame `camera`, and its height above the floor, m; None while they are not known."""
        pose = self._frames.lookup(camera, stamp) if self._frames is not None and camera else None
        if pose is None:
            self._miss(camera)
            return None, None
        self._missing_since = None
        return up_and_height(pose)

    def status(self) -> Tuple[int, str]:
        """Return level and message for diagnostics; the message is empty when all is well."""
        if self._missing_since is None or time.monotonic() - self._missing_since < _GRACE_S:
            return OK, ""
        return WARN, self._problem("the camera")

    def close(self) -> None:
        """Stop listening. Idempotent."""
        if self._frames is not None:
            self._frames.close()

    def _miss(self, camera: str) -> None:
        if self._frames is None:
            return
        if self._missing_since is None:
            self._missing_since = time.monotonic()
        elif not self._told and time.monotonic() - self._missing_since > _GRACE_S:
            self._told = True
            rospy.logwarn("%s", self._problem(camera))

    def _problem(self, camera: str) -> str:
        return (
            "no transform leads from {} to ~up_frame {}; the tilt is guessed from the people. Mend: start what publishes "
            "it, or set ~up_frame to a frame that exists or to nothing".format(camera, self._name)
        )


def up_and_height(camera: Pose) -> Tuple[np.ndarray, Optional[float]]:
    """Return up (3,) in the camera's frame and its height (m) of the camera's pose in a frame whose z is up.

    A height that no camera has (below 5 cm, above 10 m) is None: z = 0 is not the floor there.
    """
    height = float(camera.translation[2])
    return camera.rotation[2].copy(), height if _LOWEST_M <= height <= _HIGHEST_M else None
