"""Heads of known pose, as a camera would see them: the canonical face projected with noise."""

from __future__ import annotations

from typing import List, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.canonical_face import VERTICES, CanonicalFace
from hri_pipeline.core.geometry import Pose

YAW, PITCH, ROLL = 60.0, 30.0, 45.0
"""Largest angles, degrees."""
NEAREST, FARTHEST = 0.5, 2.0
"""Distance, m."""
_UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
"""Axes of a face frame that looks into the camera, in the optical frame."""


def head_poses(count: int, random: np.random.RandomState) -> List[Pose]:
    """Return face frames in the optical frame, evenly spread over the angles and distances above."""
    poses = []
    for _ in range(count):
        yaw, pitch, roll = (random.uniform(-limit, limit) for limit in (YAW, PITCH, ROLL))
        turn = Rotation.from_euler("zyx", [roll, -yaw, -pitch], degrees=True).as_matrix()
        distance = random.uniform(NEAREST, FARTHEST)
        place = distance * np.array([random.uniform(-0.35, 0.35), random.uniform(-0.15, 0.15), 1.0])
        poses.append(Pose(turn @ _UPRIGHT, place))
    return poses


def meshes_of(face: CanonicalFace, poses: Sequence[Pose], camera: CameraModel, noise_px: float,
              random: np.random.RandomState) -> List[np.ndarray]:
    """Return meshes (478, 3) px of heads of these poses with normal noise on x and y; irises and depths are 0."""
    to_model = face.face_frame().inverse()
    meshes = []
    for pose in poses:
        mesh = np.zeros((478, 3))
        mesh[:VERTICES, :2] = camera.project(pose.compose(to_model).apply(face.vertices))
        mesh[:VERTICES, :2] += random.normal(0.0, noise_px, (VERTICES, 2))
        meshes.append(mesh)
    return meshes
