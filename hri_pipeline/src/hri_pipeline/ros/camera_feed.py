"""The camera model out of the latest camera_info, or out of a field of view without one."""

from __future__ import annotations

import math
import threading
import time
from typing import Dict, Optional, Tuple

import rospy
from sensor_msgs.msg import CameraInfo

from hri_pipeline.core.camera import Calibration, CameraError, CameraModel
from hri_pipeline.ros.conversions import camera_from_info
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.topic_release import release

_LOG_PERIOD_S = 30.0
# Aspect ratios that differ by more are not the same view.
_ASPECT_TOLERANCE = 0.02


class CameraFeed:
    """Subscribes to `camera_info`; there is always a model, and `problem` says what is wrong with it.

    fallback_hfov: horizontal field of view, rad, used when camera_info is missing, all zero or impossible;
    fov_parameter: name of the parameter that holds it.
    """

    def __init__(self, fallback_hfov: float, fov_parameter: str) -> None:
        if not 0.0 < fallback_hfov < math.pi:
            raise ValueError("{} is {} rad, legal range 0 to pi".format(fov_parameter, fallback_hfov))
        self._hfov = fallback_hfov
        self._mend = "using the field of view {} = {:.3f} rad; distances are only as good as that".format(
            rospy.resolve_name(fov_parameter), fallback_hfov)
        self._lock = threading.Lock()
        self._info: Optional[CameraInfo] = None
        self._key: Optional[tuple] = None
        self._model: Optional[CameraModel] = None
        self._say_at = 0.0
        self._heard = threading.Event()
        self._closed = False
        self.problem: Tuple[int, str] = (OK, "")
        self.topic = rospy.resolve_name("camera_info")
        self._subscriber = rospy.Subscriber("camera_info", CameraInfo, self._store, queue_size=1)

    def wait(self, timeout: float) -> bool:
        """Wait until the first camera_info has come, timeout s at most; tell whether it has."""
        return self._heard.wait(max(0.0, timeout))

    def model(self, width: int, height: int) -> CameraModel:
        """Return the model for an image of width x height px; a change of the calibration is followed."""
        with self._lock:
            info = self._info
        key = (width, height) + (_key(info) if info is not None else ())
        if key != self._key or self._model is None:
            self._model, text = self._build(info, width, height)
            if text != self.problem[1]:
                self._say_at = 0.0
            self.problem = (WARN, text) if text else (OK, "")
            self._key = key
        if self.problem[1] and time.monotonic() >= self._say_at:
            self._say_at = time.monotonic() + _LOG_PERIOD_S
            rospy.logwarn("%s", self.problem[1])
        return self._model

    def values(self) -> Dict[str, object]:
        """Return what diagnostics tell about the camera."""
        if self._model is None:
            return {"camera_info": self.topic, "calibration": "unknown"}
        return {"camera_info": self.topic, "calibration": self._model.calibration.value,
                "size": "{}x{}".format(self._model.width, self._model.height),
                "focal_px": float(self._model.matrix[0, 0])}

    def close(self) -> None:
        """Stop listening. Idempotent."""
        if not self._closed:
            self._closed = True
            self._heard.set()
            release(self._subscriber)

    def _store(self, info: CameraInfo) -> None:
        with self._lock:
            self._info = info
        self._heard.set()

    def _build(self, info: Optional[CameraInfo], width: int, height: int) -> Tuple[CameraModel, str]:
        """Return a model of this image size and what is wrong with camera_info, empty when nothing is."""
        if info is None:
            return (CameraModel.from_fov(width, height, self._hfov, Calibration.MISSING),
                    "no camera_info on {}: remap `camera_info` to the camera's; {}".format(self.topic, self._mend))
        fallback = CameraModel.from_fov(width, height, self._hfov, Calibration.UNCALIBRATED)
        try:
            camera = camera_from_info(info, self._hfov, width, height)
        except CameraError as error:
            return fallback, "{}: {}; {}".format(self.topic, error, self._mend)
        if camera.calibration is not Calibration.CALIBRATED:
            return fallback, "{}: K is all zero, the camera is not calibrated; {}".format(self.topic, self._mend)
        if (camera.width, camera.height) == (width, height):
            return camera, ""
        ratio = (camera.width / camera.height) / (width / height)
        sizes = "{}: it is for {}x{} px, but images are {}x{}".format(
            self.topic, camera.width, camera.height, width, height)
        if abs(ratio - 1.0) > _ASPECT_TOLERANCE:
            return fallback, "{}, another shape; calibrate this resolution; {}".format(sizes, self._mend)
        return camera.resized(width, height), sizes + "; the calibration is scaled"


def _key(info: CameraInfo) -> tuple:
    """Everything in the message that the model depends on. NaN is unlike itself, hence the text."""
    roi = info.roi
    return (info.width, info.height, str(info.K), str(info.D), info.distortion_model, info.binning_x,
            info.binning_y, roi.x_offset, roi.y_offset, roi.width, roi.height)
