"""Perspective-n-point for many faces at once: robust Gauss-Newton on rays, all faces in one set of arrays.

The start is the scaled orthographic pose of DeMenthon and Davis ("Model-based object pose in 25 lines of code",
IJCV 1995), so no other solver is needed; a pose of the last image may be given instead. The residuals are weighted
by Huber's function, so that a few wrong points (a hand before the mouth, the guessed far cheek) bend little.
"""

from __future__ import annotations

from typing import Tuple

import numpy as np

ITERATIONS = 5
_HUBER = 1.5
"""Residuals above this many robust standard deviations count less (Huber 1964: 95 % efficiency at 1.345)."""
_DAMPING = 1e-6
_LEAST_DEPTH = 1e-3
_IDENTITY = np.eye(3)
_GENERATORS = np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], float)
"""Row k, as a matrix, is the cross product with axis k."""


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
