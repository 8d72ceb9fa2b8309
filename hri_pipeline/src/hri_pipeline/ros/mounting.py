"""How a camera is mounted: its pose in the frame in which up is known, and by how much its images are turned."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Dict, Optional, Tuple

import genpy
import numpy as np
import rospy

from hri_pipeline.core.faces.parameters import CameraSettings
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import RotationChooser
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.image_input import Frame
from hri_pipeline.ros.tf import RobotTfListener

UP = "up"
"""Key of the context: up, height and pose of the camera, see UpFrame.lookup(), of the image as it came."""

_GRACE_S = 3.0
_LOWEST_M, _HIGHEST_M = 0.05, 10.0


class CameraMounting:
    """Tells the processors how the camera is mounted, and by how much its images are turned: once for all of them.

    settings: `up_frame` and `image_rotation`. for_rotation_only: no processor needs to know where up is, so that a
    fixed rotation needs no transform.
    """

    def __init__(self, settings: CameraSettings, for_rotation_only: bool = False) -> None:
        self._rotation = RotationChooser(settings.image_rotation)
        self._up = UpFrame("" if for_rotation_only and not self._rotation.auto else settings.up_frame)
        self._by_frame = self._rotation.auto and bool(settings.up_frame)

    def orient(self, frame: Frame, context: dict) -> Frame:
        """Return the frame with the turn of its image, and leave in context[UP] what is known of the camera."""
        context[UP] = self._up.lookup(frame.header.frame_id, frame.header.stamp)
        before = self._rotation.quarters
        quarters = self._rotation.update(context[UP][0])
        if quarters != before:
            rospy.loginfo("by the camera's roll, images are turned by %d degrees clockwise from now on", 90 * quarters)
        return replace(frame, quarters=quarters, by_gravity=self._by_frame)

    def values(self) -> Dict[str, object]:
        """Return values for diagnostics."""
        by = "up_frame" if self._by_frame else "auto, without up_frame" if self._rotation.auto else "parameter"
        return {"image_rotation_deg": 90 * self._rotation.quarters, "image_rotation_by": by}

    def status(self) -> Tuple[int, str]:
        """Return level and message for diagnostics; the message is empty when all is well."""
        return self._up.status()

    def close(self) -> None:
        """Stop listening. Idempotent."""
        self._up.close()


class UpFrame:
    """Pose of the camera in a frame whose z axis points up and whose z = 0 is the floor.

    name: that frame; empty: there is none, and `lookup` tells nothing.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._frames: Optional[RobotTfListener] = RobotTfListener(name) if name else None
        self._missing_since: Optional[float] = None
        self._told = False

    def lookup(self, camera: str, stamp: genpy.Time) -> Tuple[Optional[np.ndarray], Optional[float], Optional[Pose]]:
        """Return up (3,) in the frame `camera`, its height above the floor, m, and its pose; None while not known."""
        pose = self._frames.lookup(camera, stamp) if self._frames is not None and camera else None
        if pose is None:
            self._miss(camera)
            return None, None, None
        self._missing_since = None
        return (*up_and_height(pose), pose)

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
            "no transform leads from {} to ~up_frame {}; images are not turned anew, and the tilt is guessed from the "
            "people. Mend: start what publishes it, or set ~up_frame to a frame that exists or to nothing".format(
                camera, self._name)
        )


def up_and_height(camera: Pose) -> Tuple[np.ndarray, Optional[float]]:
    """Return up (3,) in the camera's frame and its height (m) of the camera's pose in a frame whose z is up.

    A height that no camera has (below 5 cm, above 10 m) is None: z = 0 is not the floor there.
    """
    height = float(camera.translation[2])
    return camera.rotation[2].copy(), height if _LOWEST_M <= height <= _HIGHEST_M else None
