"""Forward kinematics of several bodies at once: key points, frames, and what the Jacobian needs.

All branches of all bodies are multiplied through together, see `model.human`. Inside, points are the 18 *targets*:
left and right shoulder, left and right hip; left and right elbow, left and right knee; left and right wrist, left and
right ankle; sellion, nose, left and right eye, left and right ear. The neck is no target: it is the middle of the
shoulders and holds nothing of its own. Rotations and vectors come first: they are made for arrays of a few bodies, with
as few numpy calls as possible.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import List, Sequence, Tuple, Union

import numpy as np

from hri_fullbody.core import keypoints as kp
from hri_fullbody.core.model.human import PAPER, SLOTS, BodyDimensions, Dimensions, Layout, stack_dimensions

CROSS = np.zeros((3, 3, 3))
"""(3, 3, 3) with `v @ CROSS` being the matrix of the cross product with v: (v @ CROSS) u = v x u."""
CROSS[0, 1, 2] = CROSS[1, 2, 0] = CROSS[2, 0, 1] = -1.0
CROSS[0, 2, 1] = CROSS[1, 0, 2] = CROSS[2, 1, 0] = 1.0
_CROSS_FLAT = CROSS.reshape(3, 9)
_IDENTITY = np.eye(3)
_NEXT = np.array([1, 2, 0])
_SUM = np.ones((3, 1))


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    return (vectors @ _CROSS_FLAT).reshape(vectors.shape + (3,))


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b of vectors (..., 3) and (..., 3) of the same shape; several times as fast as np.cross on small arrays."""
    product = a * b.take(_NEXT, -1)
    product -= a.take(_NEXT, -1) * b
    return product.take(_NEXT, -1)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (..., 1) of vectors (..., 3)."""
    return (a * b) @ _SUM  # a third of einsum's time


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


def about_vector(x: float, y: float, z: float, most: float) -> List[List[float]]:
    """Rows of the rotation by the rotation vector (x, y, z) rad, cut at the angle `most`.

    In plain numbers: for a few bodies quicker than in arrays.
    """
    length = math.sqrt(x * x + y * y + z * z)
    angle = min(length, most)
    scale = 1.0 / max(length, 1e-12)
    x, y, z = x * scale, y * scale, z * scale
    sin, rest = math.sin(angle), 1.0 - math.cos(angle)
    xy, yz, zx = rest * x * y, rest * y * z, rest * z * x
    xx, yy, zz = x * x, y * y, z * z
    return [[1.0 - rest * (yy + zz), xy - sin * z, zx + sin * y],
            [xy + sin * z, 1.0 - rest * (zz + xx), yz - sin * x],
            [zx - sin * y, yz + sin * x, 1.0 - rest * (xx + yy)]]


def wrap(angle: float) -> float:
    """An angle (rad) in -pi to pi."""
    return math.remainder(angle, 2.0 * math.pi)


def smooth_step(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below `low`, 1 above `high`, linear between."""
    return np.minimum(np.maximum((values - low) / (high - low), 0.0), 1.0)


TARGETS = 18
ORIGINS, MIDDLES, ENDS, HEAD_TARGETS = slice(0, 4), slice(4, 8), slice(8, 12), slice(12, 18)
SELLION_TARGET = 12
TARGET_POINTS = np.array([
    kp.LEFT_SHOULDER, kp.RIGHT_SHOULDER, kp.LEFT_HIP, kp.RIGHT_HIP,
    kp.LEFT_ELBOW, kp.RIGHT_ELBOW, kp.LEFT_KNEE, kp.RIGHT_KNEE,
    kp.LEFT_WRIST, kp.RIGHT_WRIST, kp.LEFT_ANKLE, kp.RIGHT_ANKLE,
    kp.NECK,  # stands where the sellion is: the key points have none
    kp.NOSE, kp.LEFT_EYE, kp.RIGHT_EYE, kp.LEFT_EAR, kp.RIGHT_EAR])
"""(18,) key point of each target."""
_POINT_TARGETS = np.argsort(TARGET_POINTS)


@dataclass(frozen=True)
class Frames:
    """Where everything of N bodies is, in the sensor's frame.

    torso: (N, 3, 3). chain: (N, 5, 4, 3, 3) axes after each joint of each branch. pivots: (N, 5, 3) m origins of the
    branches. neck: (N, 3) m middle of the shoulders. targets: (N, 18, 3) m.
    """

    torso: np.ndarray
    chain: np.ndarray
    pivots: np.ndarray
    neck: np.ndarray
    targets: np.ndarray

    @property
    def head_rotation(self) -> np.ndarray:
        """(N, 3, 3) axes of the head frame."""
        return self.chain[:, 0, 2]

    @property
    def head_position(self) -> np.ndarray:
        """(N, 3) m origin of the head frame, the sellion."""
        return self.targets[:, SELLION_TARGET]

    def keypoints(self) -> np.ndarray:
        """(N, 18, 3) m in the order of hri_msgs/Skeleton2D."""
        points = self.targets[:, _POINT_TARGETS]
        points[:, kp.NECK] = self.neck
        return points


@lru_cache(maxsize=8)
def _axis_matrices(layout: Layout) -> Tuple[np.ndarray, np.ndarray]:
    """Cross-product matrices (21, 3, 3) of the slots' axes, and their squares; zero where a slot is no joint."""
    skew = cross_matrix(layout.slot_axes)
    skew[np.setdiff1d(np.arange(SLOTS), layout.slots)] = 0.0
    return skew, skew @ skew


def compute_frames(rotation: np.ndarray, position: np.ndarray, slots: np.ndarray, dims: BodyDimensions,
                   layout: Layout) -> Frames:
    """Frames of bodies with body frame rotation (N, 3, 3), position (N, 3) m and joints in slots (N, 21) rad."""
    count = len(slots)
    local = about_fixed_axes(*_axis_matrices(layout), slots)
    torso = rotation @ local[:, 0]
    bases = np.empty((count, 5, 3, 3))
    bases[:, :3] = torso[:, None]
    bases[:, 3:] = rotation[:, None]
    local = local[:, 1:].reshape(count, 5, 4, 3, 3)
    chain = np.empty((count, 5, 4, 3, 3))
    np.matmul(bases, local[:, :, 0], out=chain[:, :, 0])
    for level in range(1, 4):
        np.matmul(chain[:, :, level - 1], local[:, :, level], out=chain[:, :, level])
    neck = position + torso[:, :, 2] * dims.trunk
    pivots = (bases @ dims.pivots[..., None])[..., 0]
    pivots[:, :3] += neck[:, None]
    pivots[:, 3:] += position[:, None]
    targets = np.empty((count, TARGETS, 3))
    targets[:, ORIGINS] = pivots[:, 1:]
    np.subtract(pivots[:, 1:], chain[:, 1:, 2, :, 2] * dims.proximal, out=targets[:, MIDDLES])
    np.subtract(targets[:, MIDDLES], chain[:, 1:, 3, :, 2] * dims.distal, out=targets[:, ENDS])
    np.add(dims.head @ chain[:, 0, 2].transpose(0, 2, 1), pivots[:, :1], out=targets[:, HEAD_TARGETS])
    return Frames(torso, chain, pivots, neck, targets)


def forward(rotation: np.ndarray, position: np.ndarray, q: np.ndarray,
            dims: Union[Sequence[Dimensions], BodyDimensions],
            layout: Layout = PAPER) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Key points and head frames of N bodies.

    rotation (N, 3, 3), position (N, 3) m: body frames in the sensor's frame. q (N, J) rad in the layout's order.
    Returns keypoints (N, 18, 3) m in the order of hri_msgs/Skeleton2D, head rotation (N, 3, 3), head position (N, 3) m.
    """
    rotation, position = np.asarray(rotation, dtype=np.float64), np.asarray(position, dtype=np.float64)
    frames = compute_frames(rotation, position, layout.to_slots(np.asarray(q)), stack_dimensions(dims), layout)
    return frames.keypoints(), frames.head_rotation, frames.head_position
