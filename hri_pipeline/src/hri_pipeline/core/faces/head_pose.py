"""Head pose from the face mesh: perspective-n-point on the upper vertices of the canonical face.

The brow, the eyes, the nose and the temples hold still when the mouth moves; the jaw does not. The far side of a
turned head is guessed by the network: its points count less, and outliers do (`face_pnp`).

A mean face on a person with a longer nose or a flatter brow looks like a nod: on 30 faces in frontal portraits the pitch
has a standard deviation of 7.5 degrees, which is the shapes' and that of how the heads are held. The depths that the
network gives were tried against it: they made it smaller on one half of the faces and larger on the other.
"""

from __future__ import annotations

import math
from typing import List, Optional, Sequence, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces import face_pnp
from hri_pipeline.core.faces.canonical_face import CanonicalFace
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.one_euro import OneEuro

MIN_DEPTH, MAX_DEPTH = 0.05, 20.0
"""Legal range (m) of the distance of a face along the optical axis."""
MAX_RESIDUAL = 0.12
"""Largest legal root-mean-square re-projection error over the width of the points."""
MAX_TURN = np.deg2rad(110.0)
"""Largest legal angle (rad) between the direction of the face and the direction to the camera."""
_EVERY = 3
_WARM_ITERATIONS = 2
_FAR_SIDE = 0.15
"""Least weight of a point on the far side."""


class HeadPoseEstimator:
    """Poses of face frames in the optical frame, all faces of an image at once; holds no state between calls."""

    def __init__(self, face: CanonicalFace) -> None:
        upper = np.flatnonzero(face.vertices[:, 1] < 0.0)[::_EVERY]
        rigid = face.rigid[face.vertices[face.rigid, 1] < 0.0]
        self._indices = np.unique(np.concatenate([upper, rigid]))
        self._points = np.ascontiguousarray(face.vertices[self._indices])
        self._point_normals = face.outward_normals(self._indices)
        self._frame = face.face_frame()
        self._from_frame = self._frame.inverse()
        self._normals = self._from_frame.rotation @ face.landmark_normals().T

    def estimate(self, mesh: np.ndarray, camera: CameraModel) -> Optional[Pose]:
        """Return the pose of one face, see `estimate_all`."""
        return self.estimate_all([mesh], camera)[0]

    def estimate_all(self, meshes: Sequence[np.ndarray], camera: CameraModel,
                     starts: Sequence[Optional[Pose]] = ()) -> List[Optional[Pose]]:
        """Return face frames (origin sellion, x out of the face, z to the scalp) in the optical frame, m.

        meshes: (478, 2 or more) px of the camera's image each, distorted as the camera sees it. None for points that fit
        no plausible head: not finite, behind the camera, out of range, large residual. The size is that of the canonical face (`head_scale` knows more).
        starts: poses found in the last image, or None; with one for every face the search is three times as quick.
        """
        if not len(meshes):
            return []
        stack = np.stack([np.asarray(mesh, dtype=np.float64)[self._indices, :2] for mesh in meshes])
        rays = camera.normalise(stack.reshape(-1, 2)).reshape(stack.shape)
        good = np.isfinite(rays).all(axis=(1, 2)) & (np.ptp(rays, axis=1).max(axis=1) > 1e-5)
        result: List[Optional[Pose]] = [None] * len(stack)
        if not good.any():
            return result
        known = [self._model(starts[index]) for index in np.flatnonzero(good)] if len(starts) == len(stack) else [None]
        rotation, translation = self._solve(rays[good], known)
        misfit = face_pnp.residuals(self._points, rays[good], rotation, translation)
        for row, index in enumerate(np.flatnonzero(good)):
            model = Pose(rotation[row], translation[row])
            if not self._plausible(model, rays[index], misfit[row]):
                continue
            result[index] = model.compose(self._frame)
        return result

    def visibility(self, pose: Optional[Pose]) -> np.ndarray:
        """How much each of the 70 landmarks is turned to the camera: (70,) 0.1 (hidden) .. 1; 1 without pose."""
        if pose is None:
            return np.ones(self._normals.shape[1])
        to_camera = -pose.translation / math.sqrt(float(pose.translation @ pose.translation))
        facing = (to_camera @ pose.rotation) @ self._normals
        return np.minimum(np.maximum(0.5 + 2.0 * facing, 0.1), 1.0)

    def _model(self, start: Optional[Pose]) -> Optional[Pose]:
        """Pose of the model for that of the face frame."""
        return None if start is None else start.compose(self._from_frame)

    def _solve(self, rays: np.ndarray, starts: Sequence[Optional[Pose]]) -> Tuple[np.ndarray, np.ndarray]:
        known = [start for start in starts if start is not None]
        if len(known) == len(rays):
            rotation = np.stack([start.rotation for start in known])
            translation = np.stack([start.translation for start in known])
            return self._polish(rays, rotation, translation, _WARM_ITERATIONS)
        weights = np.ones(rays.shape[:2])
        rotation, translation = face_pnp.scaled_orthographic(self._points, rays, weights)
        rotation, translation = face_pnp.refine(self._points, rays, weights, rotation, translation, 2)
        return self._polish(rays, rotation, translation, face_pnp.ITERATIONS)

    def _polish(self, rays: np.ndarray, rotation: np.ndarray, translation: np.ndarray,
                iterations: int) -> Tuple[np.ndarray, np.ndarray]:
        line = translation / np.maximum(np.linalg.norm(translation, axis=1, keepdims=True), 1e-9)
        facing = -(self._point_normals @ rotation.transpose(0, 2, 1) @ line[..., None])[..., 0]
        weights = np.clip(0.4 + 1.5 * facing, _FAR_SIDE, 1.0)
        return face_pnp.refine(self._points, rays, weights, rotation, translation, iterations)

    def _plausible(self, model: Pose, rays: np.ndarray, misfit: np.ndarray) -> bool:
        if not (np.isfinite(model.rotation).all() and np.isfinite(model.translation).all()):
            return False
        points = model.apply(self._points)
        if points[:, 2].min() <= 0.0 or not MIN_DEPTH <= model.translation[2] <= MAX_DEPTH:
            return False
        if math.sqrt(float(misfit @ misfit) / len(misfit)) > MAX_RESIDUAL * np.ptp(rays, axis=0).max():
            return False
        pose = model.compose(self._frame)
        distance = math.sqrt(float(pose.translation @ pose.translation))
        return bool(-float(pose.rotation[:, 0] @ pose.translation) >= math.cos(MAX_TURN) * distance)


class PoseSmoother:
    """One-euro filter on a pose: steady at rest, without visible lag in motion."""

    def __init__(self, min_cutoff: float = 3.0, beta: float = 20.0) -> None:
        """min_cutoff: Hz at rest; beta: Hz per (m/s) and per (unit quaternion/s)."""
        self._translation = OneEuro(min_cutoff, beta)
        self._rotation = OneEuro(min_cutoff, beta)
        self._last: Optional[np.ndarray] = None

    def __call__(self, pose: Pose, stamp: float) -> Pose:
        """The filtered pose at this stamp (s)."""
        quaternion = np.array(pose.quaternion)
        if self._last is not None and quaternion @ self._last < 0.0:
            quaternion = -quaternion
        quaternion = self._rotation(quaternion, stamp)
        self._last = quaternion
        rotation = Rotation.from_quat(quaternion / np.linalg.norm(quaternion)).as_matrix()
        return Pose(rotation, self._translation(pose.translation, stamp))

    def reset(self) -> None:
        """Forget the past."""
        self._translation.reset()
        self._rotation.reset()
        self._last = None


def yaw_pitch_roll(pose: Pose) -> np.ndarray:
    """Angles (3,) rad of a face frame seen in the optical frame, all 0 for a face that looks along -z, upright.

    yaw > 0: turned to its own left (to the right of the image); pitch > 0: looks up; roll > 0: head
    tilted clockwise in the image.
    """
    forward, left = pose.rotation[:, 0], pose.rotation[:, 1]
    yaw = np.arctan2(forward[0], -forward[2])
    pitch = np.arctan2(-forward[1], np.hypot(forward[0], forward[2]))
    return np.array([yaw, pitch, np.arctan2(left[1], left[0])])
