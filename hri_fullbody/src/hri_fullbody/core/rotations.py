"""Rotations and vectors in batches, made for arrays of a few bodies: as few numpy calls as possible."""

from __future__ import annotations

import numpy as np

CROSS = np.zeros((3, 3, 3))
"""(3, 3, 3) with `v @ CROSS` being the matrix of the cross product with v: (v @ CROSS) u = v x u."""
CROSS[0, 1, 2] = CROSS[1, 2, 0] = CROSS[2, 0, 1] = -1.0
CROSS[0, 2, 1] = CROSS[1, 0, 2] = CROSS[2, 1, 0] = 1.0
_CROSS_FLAT = CROSS.reshape(3, 9)
_IDENTITY = np.eye(3)


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    return (vectors @ _CROSS_FLAT).reshape(vectors.shape + (3,))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b of vectors (..., 3) and (..., 3); several times as fast as np.cross on small arrays."""
    return (cross_matrix(a) @ b[..., None])[..., 0]


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (..., 1) of vectors (..., 3)."""
    return np.einsum("...i,...i->...", a, b)[..., None]


def columns(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Three arrays (...,) side by side on a new last axis: vectors (..., 3) of numbers, matrices (..., 3, 3) of
    vectors. A quarter of np.stack's time."""
    out = np.empty(x.shape + (3,))
    out[..., 0] = x
    out[..., 1] = y
    out[..., 2] = z
    return out


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) scaled to length 1; those shorter than 1e-9 keep their direction, shorter."""
    return vectors / np.maximum(np.sqrt(dot(vectors, vectors)), 1e-9)


def perpendicular(vectors: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """What remains of vectors (..., 3) after taking away their part along the unit axes (..., 3)."""
    return vectors - dot(vectors, axes) * axes


def about_axes(axes: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) by angles (...,) rad about unit axes (..., 3); Rodrigues' formula."""
    skew = cross_matrix(axes)
    return about_fixed_axes(skew, skew @ skew, angles)


def about_fixed_axes(skew: np.ndarray, squared: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) by angles (...,) rad about axes whose `cross_matrix` and its square are known."""
    angles = angles[..., None, None]
    rotation = np.sin(angles) * skew
    rotation += (1.0 - np.cos(angles)) * squared
    rotation += _IDENTITY
    return rotation


def wrap(angles: np.ndarray) -> np.ndarray:
    """Angles (rad) in -pi to pi."""
    return angles - 2.0 * np.pi * np.rint(angles * (0.5 / np.pi))


def smooth_step(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, linear between."""
    return np.minimum(np.maximum((values - low) / (high - low), 0.0), 1.0)
