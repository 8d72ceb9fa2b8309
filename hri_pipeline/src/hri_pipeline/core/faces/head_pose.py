"""Head pose and head size: perspective-n-point on the canonical face, and the scale from iris and depth.

Points: the upper vertices of the canonical face. Brow, eyes, nose and temples hold still when the mouth moves; the jaw
does not. The far side of a turned head is guessed by the network: its points have less weight, and so have outliers. A
mean face on a person with a longer nose or a flatter brow looks like a nod: on 30 faces in frontal portraits the pitch
has a standard deviation of 7.5 degrees, which is due to the shapes and to how the heads are held. The depths that the
network gives were tried against it: they made it smaller on one half of the faces and larger on the other.

Solver: robust Gauss-Newton on rays, all faces in one set of arrays. It starts from the scaled orthographic pose of
DeMenthon and Davis ("Model-based object pose in 25 lines of code", IJCV 1995), so no other solver is needed, or from
the pose in the last image. The residuals are weighted by Huber's function, so that a few wrong points (a hand in front
of the mouth, the guessed far cheek) have little influence.

Size: a pose from points alone fixes the direction of a head and the ratio of its size to its distance, not the
distance. Each source (prior, iris, depth image) gives a size over the canonical one, with an error that stays
with the person however often it is measured, and a noise that averages out. All errors are Gaussian in the logarithm of
the size.
"""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from scipy.spatial.transform import Rotation

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.gaze import IRIS_DIAMETER, EyeGeometry
from hri_pipeline.core.faces.mesh import CanonicalFace
from hri_pipeline.core.geometry import Pose, turn_ahead
from hri_pipeline.core.one_euro import OneEuro

MIN_DEPTH, MAX_DEPTH = 0.05, 20.0
"""Legal range (m) of the distance of a face along the optical axis."""
MAX_RESIDUAL = 0.12
"""Largest legal root-mean-square re-projection error over the width of the points."""
MAX_TURN = np.deg2rad(110.0)
"""Largest legal angle (rad) between the direction of the face and the direction to the camera."""
MAX_RAY = 1e3
"""Largest legal x/z or y/z of a ray: beyond, the lens model has left its range."""
_EVERY = 3
_WARM_ITERATIONS = 2
_FAR_SIDE = 0.15
"""Least weight of a point on the far side."""
ITERATIONS = 5
_HUBER = 1.5
"""Residuals above this many robust standard deviations count less (Huber 1964: 95 % efficiency at 1.345)."""
_DAMPING = 1e-6
_LEAST_DEPTH = 1e-3
_IDENTITY = np.eye(3)
_GENERATORS = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]],
                       float)
"""Row k, as a matrix, is the cross product with axis k."""
PRIOR_SD = 0.055
"""Relative standard deviation of the size of adults' heads (pupils apart: 62 and 64 mm, 5.5 %, ANSUR II 2012)."""
IRIS_BIAS = 0.91
"""Distance from the iris over that from the head, median of 36 open-eyed faces in portraits: the network's rim of the
iris lies outside the visible one."""
LEAST_IRIS = 8.0
"""Diameter (px) of the iris from which it is used for the size."""
MAX_IRIS_TURN = math.radians(40.0)
_LEAST, _MOST = 0.75, 1.25
_WINDOW = 60.0
"""Number of measurements after which old ones lose weight."""
_SETTLING_TIME = 1.0
"""Time constant (s) of the size: a head must not jump."""


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

        The size is that of the canonical face (see `HeadScale`).

        Parameters
        ----------
        meshes
            (478, 2 or more) px of the camera's image each, distorted as the camera sees it.
        camera
            Camera model of the image's size.
        starts
            Poses found in the last image, or None; with one for every face the search is three times as quick.

        Returns
        -------
        List[Optional[Pose]]
            In the order of the meshes. None for points that fit no plausible head: not finite, behind the camera, out
            of range, large residual.
        """
        if not len(meshes):
            return []
        stack = np.stack([np.asarray(mesh, dtype=np.float64)[self._indices, :2] for mesh in meshes])
        rays = camera.normalise(stack.reshape(-1, 2)).reshape(stack.shape)
        good = (np.abs(rays) < MAX_RAY).all(axis=(1, 2)) & (np.ptp(rays, axis=1).max(axis=1) > 1e-5)
        result: List[Optional[Pose]] = [None] * len(stack)
        if not good.any():
            return result
        rays = rays[good]
        turns = turns_ahead(rays) if camera.is_calibrated else np.broadcast_to(_IDENTITY, (len(rays), 3, 3))
        rays = turned_rays(rays, turns) if camera.is_calibrated else rays
        known: List[Optional[Pose]] = [None]
        if len(starts) == len(stack):
            known = [self._model(starts[index], turn) for index, turn in zip(np.flatnonzero(good), turns)]
        rotation, translation = self._solve(rays, known)
        misfit = residuals(self._points, rays, rotation, translation)
        for row, index in enumerate(np.flatnonzero(good)):
            model = Pose(rotation[row], translation[row])
            if self._plausible(model, rays[row], misfit[row]):
                result[index] = Pose(turns[row].T @ model.rotation, turns[row].T @ model.translation).compose(
                    self._frame)
        return result

    def visibility(self, pose: Optional[Pose]) -> np.ndarray:
        """How much each of the 70 landmarks is turned to the camera: (70,) 0.1 (hidden) .. 1; 1 without pose."""
        if pose is None:
            return np.ones(self._normals.shape[1])
        to_camera = -pose.translation / math.sqrt(float(pose.translation @ pose.translation))
        facing = (to_camera @ pose.rotation) @ self._normals
        return np.minimum(np.maximum(0.5 + 2.0 * facing, 0.1), 1.0)

    def _model(self, start: Optional[Pose], turn: np.ndarray) -> Optional[Pose]:
        """Pose of the model, turned (3, 3), for that of the face frame."""
        if start is None:
            return None
        model = start.compose(self._from_frame)
        return Pose(turn @ model.rotation, turn @ model.translation)

    def _solve(self, rays: np.ndarray, starts: Sequence[Optional[Pose]]) -> Tuple[np.ndarray, np.ndarray]:
        known = [start for start in starts if start is not None]
        if len(known) == len(rays):
            rotation = np.stack([start.rotation for start in known])
            translation = np.stack([start.translation for start in known])
            return self._refine_weighted(rays, rotation, translation, _WARM_ITERATIONS)
        weights = np.ones(rays.shape[:2])
        rotation, translation = scaled_orthographic(self._points, rays, weights)
        rotation, translation = refine(self._points, rays, weights, rotation, translation, 2)
        return self._refine_weighted(rays, rotation, translation, ITERATIONS)

    def _refine_weighted(self, rays: np.ndarray, rotation: np.ndarray, translation: np.ndarray,
                         iterations: int) -> Tuple[np.ndarray, np.ndarray]:
        line = translation / np.maximum(np.linalg.norm(translation, axis=1, keepdims=True), 1e-9)
        facing = -(self._point_normals @ rotation.transpose(0, 2, 1) @ line[..., None])[..., 0]
        weights = np.clip(0.4 + 1.5 * facing, _FAR_SIDE, 1.0)
        return refine(self._points, rays, weights, rotation, translation, iterations)

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

    def __init__(self) -> None:
        # Hz at rest, Hz per (m/s) and per (unit quaternion/s).
        self._translation, self._rotation = OneEuro(3.0, 20.0), OneEuro(3.0, 20.0)
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


def scaled_orthographic(points: np.ndarray, rays: np.ndarray, weights: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return rotations (F, 3, 3) and translations (F, 3) of a model far away compared with its depth.

    points: (N, 3) m; rays: (F, N, 2) x/z, y/z; weights: (F, N) 0 or more. A face whose rays have no extent gets a
    rotation that is a rotation, and a huge distance.
    """
    total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    share = weights / total
    model_mean = share @ points
    ray_mean = (share[:, None] @ rays)[:, 0]
    centred = points[None] - model_mean[:, None]
    weighted = (centred * share[..., None]).transpose(0, 2, 1)
    moment = weighted @ centred + 1e-10 * np.eye(3)
    cross = weighted @ (rays - ray_mean[:, None])
    axes = np.linalg.solve(moment, cross).transpose(0, 2, 1)
    scale = np.maximum(np.linalg.norm(axes, axis=2).mean(axis=1), 1e-9)
    third = np.cross(axes[:, 0], axes[:, 1])
    full = np.concatenate([axes / scale[:, None, None], (third / scale[:, None] ** 2)[:, None]], axis=1)
    left, _, right = np.linalg.svd(full)
    sign = np.linalg.det(left @ right)
    left[:, :, 2] *= sign[:, None]
    rotation = left @ right
    depth = 1.0 / scale
    middle = np.concatenate([ray_mean, np.ones((len(rays), 1))], axis=1) * depth[:, None]
    return rotation, middle - (rotation @ model_mean[..., None])[..., 0]


def refine(points: np.ndarray, rays: np.ndarray, weights: np.ndarray, rotation: np.ndarray, translation: np.ndarray,
           iterations: int = ITERATIONS) -> Tuple[np.ndarray, np.ndarray]:
    """Return the poses that minimise the weighted robust distance between rays and the projected model.

    points: (N, 3); rays: (F, N, 2); weights: (F, N); rotation: (F, 3, 3); translation: (F, 3). A face that runs
    behind the camera comes back with numbers that are no pose of a head: check them.
    """
    rotation, translation = rotation.copy(), translation.copy()
    for _ in range(iterations):
        turned = points @ rotation.transpose(0, 2, 1)
        error, jacobian = _linearise(turned, translation, rays)
        factor = np.repeat(weights * _huber(error), 2, axis=1)[..., None]
        jacobian, error = jacobian.reshape(len(rays), -1, 6), error.reshape(len(rays), -1, 1)
        weighted = (jacobian * factor).transpose(0, 2, 1)
        normal, gradient = weighted @ jacobian, (weighted @ error)[..., 0]
        normal += (_DAMPING * np.trace(normal, axis1=1, axis2=2) + 1e-15)[:, None, None] * np.eye(6)
        step = -np.linalg.solve(normal, gradient[..., None])[..., 0]
        angle = step[:, :3]
        angle *= np.minimum(1.0, 0.5 / np.maximum(np.linalg.norm(angle, axis=1, keepdims=True), 1e-12))
        rotation = _small_turns(angle) @ rotation
        translation = translation + step[:, 3:]
    return rotation, translation


def turns_ahead(rays: np.ndarray) -> np.ndarray:
    """Return the smallest turns (F, 3, 3) that take the middles of rays (F, N, 2) to the optical axis.

    Aside of it the same error of an angle is a larger one of a ray, most of all in the direction away from the axis.
    """
    lengths = np.sqrt(1.0 + (rays * rays).sum(axis=2, keepdims=True))
    middle = np.concatenate([(rays / lengths).sum(axis=1), (1.0 / lengths).sum(axis=1)], axis=1)
    x, y, z = (middle / np.sqrt((middle * middle).sum(axis=1, keepdims=True))).T
    return np.ascontiguousarray(np.moveaxis(turn_ahead(x, y, z), 2, 0))


def turned_rays(rays: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return rays (F, N, 2) through turns (F, 3, 3)."""
    ahead = rays @ turns[:, :, :2].transpose(0, 2, 1) + turns[:, None, :, 2]
    return ahead[..., :2] / np.maximum(ahead[..., 2:], _LEAST_DEPTH)


def residuals(points: np.ndarray, rays: np.ndarray, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Return the distances (F, N) between rays and projected model, in units of rays."""
    placed = points @ rotation.transpose(0, 2, 1) + translation[:, None]
    depth = np.where(placed[..., 2:] > _LEAST_DEPTH, placed[..., 2:], np.inf)
    return np.linalg.norm(placed[..., :2] / depth - rays, axis=2)


def _linearise(turned: np.ndarray, translation: np.ndarray, rays: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Errors (F, N, 2) and their derivatives (F, N, 2, 6) by a small rotation (rad, before the shift) and the shift."""
    placed = turned + translation[:, None]
    inverse = 1.0 / np.maximum(placed[..., 2], _LEAST_DEPTH)
    projected = placed[..., :2] * inverse[..., None]
    jacobian = np.zeros(turned.shape[:2] + (2, 6))
    x, y, z = turned[..., 0], turned[..., 1], turned[..., 2]
    u, v = projected[..., 0], projected[..., 1]
    jacobian[..., 0, 0], jacobian[..., 0, 1], jacobian[..., 0, 2] = -u * y, z + u * x, -y
    jacobian[..., 1, 0], jacobian[..., 1, 1], jacobian[..., 1, 2] = -z - v * y, v * x, x
    jacobian[..., 0, 3], jacobian[..., 1, 4] = 1.0, 1.0
    jacobian[..., 0, 5], jacobian[..., 1, 5] = -u, -v
    jacobian *= inverse[..., None, None]
    return projected - rays, jacobian


def _huber(error: np.ndarray) -> np.ndarray:
    """Weights (F, N) of errors (F, N, 2)."""
    size = np.sqrt(error[..., 0] ** 2 + error[..., 1] ** 2)
    # Rayleigh distribution: the median of the length of a normal error in two dimensions is 1.1774 sigma.
    middle = np.partition(size, size.shape[1] // 2, axis=1)[:, size.shape[1] // 2, None]
    limit = _HUBER * np.maximum(middle / 1.1774, 1e-9) * np.sqrt(2.0)
    return np.minimum(1.0, limit / np.maximum(size, 1e-12))


def _small_turns(vectors: np.ndarray) -> np.ndarray:
    """Rotation matrices (F, 3, 3) near those of rotation vectors (F, 3): Cayley's formula, exactly orthonormal."""
    half = (0.5 * vectors @ _GENERATORS).reshape(-1, 3, 3)
    return np.linalg.solve(_IDENTITY - half, _IDENTITY + half)


class _Error(NamedTuple):
    """Relative standard deviations of the error that stays with the person, and of the noise that averages out."""

    lasting: float
    noise: float


_ERRORS = {
    # Iris: 0.5 of 11.7 mm between people, and the network's rim; together with the prior they make the 6 % seen.
    "iris": _Error(0.05, 0.05),
    # Depth camera: 1 to 2 % of the distance, and the difference between the surface and the model's.
    "depth": _Error(0.015, 0.03),
}


class HeadScale:
    """Size of one head over the canonical one, filtered over time."""

    def __init__(self) -> None:
        self._sums: Dict[str, Tuple[float, float]] = {}
        self._value: Optional[float] = None
        self._stamp = -math.inf

    def add(self, source: str, scale: float) -> None:
        """Add a measured size over the canonical one; one that is not finite or impossible for a head is ignored.

        source: "iris" or "depth"; raises KeyError for another.
        """
        _ERRORS[source]
        if not (math.isfinite(scale) and _LEAST <= scale <= _MOST):
            return
        weight, total = self._sums.get(source, (0.0, 0.0))
        keep = min(1.0, (_WINDOW - 1.0) / weight) if weight > 0.0 else 1.0
        self._sums[source] = (keep * weight + 1.0, keep * total + math.log(scale))

    def estimate(self, stamp: float) -> Tuple[float, float]:
        """Return the size and its standard deviation at `stamp` (s)."""
        information, moment = PRIOR_SD ** -2, 0.0
        for source, (weight, total) in self._sums.items():
            error = _ERRORS[source]
            certain = 1.0 / (error.lasting ** 2 + error.noise ** 2 / weight)
            information += certain
            moment += certain * total / weight
        target = moment / information
        if self._value is None or stamp < self._stamp:
            self._value = target
        else:
            self._value += (1.0 - math.exp(-(stamp - self._stamp) / _SETTLING_TIME)) * (target - self._value)
        self._stamp = stamp
        scale = math.exp(self._value)
        return scale, scale * information ** -0.5


def scale_from_iris(diameters: np.ndarray, angles: np.ndarray, pose: Pose, eyes: EyeGeometry,
                    from_eyes: float) -> Optional[float]:
    """Return the size of a head by its irises, None where they are too small, closed or turned away.

    Who looks at the camera turns round irises to it, wherever in the image: the angle that they fill tells their
    distance, through any lens.

    diameters: (2,) px; angles: (2,) the same, rad; pose: face frame at the canonical size; from_eyes: that of the gaze,
    0 while the eyes are closed.
    """
    to_camera = -pose.translation / np.linalg.norm(pose.translation)
    if diameters.min() < LEAST_IRIS or from_eyes <= 0.0 or pose.rotation[:, 0] @ to_camera < math.cos(MAX_IRIS_TURN):
        return None
    return IRIS_DIAMETER / float(angles.mean()) / eyes.distance(pose) / IRIS_BIAS


def scale_from_depth(mesh: np.ndarray, canonical_depths: np.ndarray, indices: np.ndarray,
                     depth: np.ndarray, size: Tuple[int, int]) -> Optional[float]:
    """Return the size of a head by a registered depth image (h, w) m, None where too few pixels know their depth.

    canonical_depths: (N,) m, of the vertices `indices` of the posed canonical face; the median ratio is robust
    against hair and background. size: (width, height) px of the image of `mesh`; that of the depth may be another.
    """
    height, width = depth.shape[:2]
    pixels = np.floor(mesh[indices, :2] * np.divide((width, height), size)).astype(int)
    inside = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
    if inside.sum() < 8:
        return None
    seen = depth[pixels[inside, 1], pixels[inside, 0]].astype(np.float64)
    known = np.isfinite(seen) & (seen > 0.05)
    if known.sum() < 8:
        return None
    ratios = seen[known] / canonical_depths[inside][known]
    return float(np.median(ratios))
