"""What the stages see of one person in one image: the value types at the boundary to ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

from hri_pipeline.core.geometry import Pose


@dataclass(frozen=True)
class FaceObservation:
    """One tracked face in one image.

    box: (4,) x0, y0, x1, y1 px. score: 0 to 1.
    landmarks: (70, 3) x px, y px, confidence 0 to 1, in the order of hri_msgs/FacialLandmarks.
    mesh: (478, 3) px; z grows away from the camera and has the scale of x.
    pose: face frame in the optical frame, m; None when it is not known.
    """

    id: str
    box: np.ndarray
    score: float
    landmarks: np.ndarray
    mesh: np.ndarray
    pose: Optional[Pose] = None


@dataclass(frozen=True)
class BodyObservation:
    """One tracked body in one image.

    box: (4,) x0, y0, x1, y1 px. score: 0 to 1.
    keypoints: (18, 3) x px, y px, confidence 0 to 1, in the order of hri_msgs/Skeleton2D.
    keypoints_3d: (18, 3) m in the optical frame, NaN where unknown.
    pose: body frame in the optical frame, m; None when it is not known.
    """

    id: str
    box: np.ndarray
    score: float
    keypoints: np.ndarray
    keypoints_3d: np.ndarray
    pose: Optional[Pose] = None
