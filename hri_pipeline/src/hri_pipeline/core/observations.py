"""What is measured of one person in one image: the value types at the boundary to ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Optional

import numpy as np

from hri_pipeline.core.geometry import Pose


@dataclass(frozen=True)
class GazeEstimate:
    """Where a face looks.

    direction: (3,) unit vector in the optical frame, None while the eyes are closed or nothing is known.
    confidence: 0 to 1, of the direction. eyes_closed: 0 (open) to 1 (closed). from_eyes: 0 when the direction is that
    of the head alone, 1 when the irises decide. lids: core.faces.gaze.Lids, what the image says of the eyelids; None
    when that is not known.
    """

    direction: Optional[np.ndarray]
    confidence: float
    eyes_closed: float
    from_eyes: float = 0.0
    lids: Optional[Any] = None


@dataclass(frozen=True)
class SoftBiometrics:
    """Apparent age (years) and gender of a face, fused over time. p_male: 0 to 1. Confidences: 0 to 1."""

    age: float
    age_confidence: float
    p_male: float
    gender_confidence: float


@dataclass(frozen=True)
class FaceObservation:
    """One tracked face in one image.

    box: (4,) x0, y0, x1, y1 px. score: 0 to 1.
    landmarks: (70, 3) x px, y px, confidence 0 to 1, in the order of hri_msgs/FacialLandmarks.
    mesh: (478, 3) px; z grows away from the camera and has the scale of x.
    pose: face frame in the optical frame, m; None when it is not known.
    gaze: None when it was not estimated. action_units: core.faces.action_units.ActionUnits; expression:
    core.faces.expression.ExpressionEstimate; soft_biometrics: SoftBiometrics; each None when not estimated in this
    image. head_scale: size of this head over the canonical one, and its standard deviation; None without a pose.
    measured: False when the face was predicted and not measured in this image, because there were too many faces.
    """

    id: str
    box: np.ndarray
    score: float
    landmarks: np.ndarray
    mesh: np.ndarray
    pose: Optional[Pose] = None
    gaze: Optional[GazeEstimate] = None
    action_units: Optional[Any] = None
    expression: Optional[Any] = None
    soft_biometrics: Optional[SoftBiometrics] = None
    head_scale: Optional[float] = None
    head_scale_sd: Optional[float] = None
    measured: bool = True


@dataclass(frozen=True)
class BodyObservation:
    """One tracked body in one image.

    box: (4,) x0, y0, x1, y1 px. score: 0 to 1.
    keypoints: (18, 3) x px, y px, confidence 0 to 1, in the order of hri_msgs/Skeleton2D.
    keypoints_3d: (18, 3) m in the optical frame, NaN where unknown.
    pose: body frame in the optical frame, m; None when it is not known.
    head: face frame in the optical frame, m, of the tracked face that is this body's; None without one.
    velocity: (3,) m/s of the body in the optical frame; None while it is not known.
    measured: False when the body was predicted by its motion and not measured in this image.
    by_depth: True when a depth image gave its distance and its joints, not the size of an average person.
    hands: (2, 3) m from the wrist to the knuckles of the left and the right hand, NaN unknown; None without any.
    """

    id: str
    box: np.ndarray
    score: float
    keypoints: np.ndarray
    keypoints_3d: np.ndarray
    pose: Optional[Pose] = None
    head: Optional[Pose] = None
    velocity: Optional[np.ndarray] = None
    measured: bool = True
    by_depth: bool = False
    hands: Optional[np.ndarray] = None
