"""Damped Gauss-Newton steps that bring the whole kinematic chain close to all targets at once.

A limb by itself hangs on one noisy joint; the whole body shares the noise among all points. Unknowns: position and
rotation of the body, and its joints without the waist, which cannot be told apart from the body's and the hips' pitch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Optional, Tuple

import numpy as np
from scipy.linalg.lapack import dposv

from hri_fullbody.core.kinematics.forward import (
    HEAD_TARGETS,
    MIDDLES,
    TARGETS,
    Frames,
    about_vector,
    compute_frames,
    cross_matrix,
    smooth_step,
)
from hri_fullbody.core.model.human import (
    HEAD,
    JOINTS_PER_BRANCH,
    LEFT_ARM,
    RIGHT_ARM,
    WAIST_SLOT,
    BodyDimensions,
    Layout,
    branch_slot,
)

_IDENTITY = np.eye(3)
_DAMPING = 1e-3
_SHOULDER_DAMPING = 4e-3  # yaw and roll: with the arm hanging only their difference is seen
# Yaw of an arm that hangs or points straight up, roll of a straight arm: they would follow nothing but noise.
_TWIST_DAMPING = np.array([0.1, 0.03, 0.1, 0.03])
_BRANCH_JOINTS = 20
_TWISTS = np.array([branch_slot(arm, level) for arm in (LEFT_ARM, RIGHT_ARM) for level in (0, 2)])
_TWIST_ROWS = 5 + _TWISTS
_MAX_TURN = 0.5  # rad per step
_MAX_JOINT_STEP = 0.6  # rad per step


@dataclass(frozen=True)
class WeightedTargets:
    """Where the targets of N bodies should be.

    targets: (N, 18, 3) m, finite. weights: (N, 18), 0 for targets that are not known. robust_precision: (N, 18) or
    anything that broadcasts, 1/m^2: inverse square of the distance at which a target's weight is halved (Cauchy): an
    outlier does not bend the whole body. axis_weights: (N, 3) by how much less the coordinates along each axis count,
    None: all alike.
    """

    targets: np.ndarray
    weights: np.ndarray
    robust_precision: np.ndarray
    axis_weights: Optional[np.ndarray] = None


@dataclass(frozen=True)
class _Structure:
    """What a layout fixes. mask: (23, 1, 18) which targets the 3 rotations of the body and the 20 branch joints move,
    0 for slots that are no joint; damping: (26, 26) diagonal; lower, upper: (20,) rad; axes: (5, 4, 3, 1)."""

    mask: np.ndarray
    damping: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    axes: np.ndarray


@lru_cache(maxsize=8)
def _structure(layout: Layout) -> _Structure:
    mask = np.zeros((3 + _BRANCH_JOINTS, 1, TARGETS))
    mask[:3] = 1.0
    for slot in layout.slots[layout.slots != WAIST_SLOT]:
        branch, level = divmod(int(slot) - 1, JOINTS_PER_BRANCH)
        row = 2 + slot
        if branch == HEAD:
            mask[row, 0, HEAD_TARGETS] = 1.0
        else:
            mask[row, 0, 7 + branch] = 1.0  # the limb's end
            mask[row, 0, 3 + branch] = float(level < 3)  # its middle, unless it turns only the distal segment
    damping = np.full(6 + _BRANCH_JOINTS, _DAMPING)
    damping[_TWIST_ROWS] = _SHOULDER_DAMPING
    return _Structure(mask, np.diag(damping), layout.slot_lower[1:], layout.slot_upper[1:],
                      layout.slot_axes[1:].reshape(5, JOINTS_PER_BRANCH, 3, 1))


def _jacobian(frames: Frames, position: np.ndarray, structure: _Structure) -> np.ndarray:
    """Derivative (N, 26, 3, 18) of the targets by translation, rotation about the body's origin, and joints."""
    count = len(position)
    turning = np.empty((count, 3 + _BRANCH_JOINTS, 3))
    turning[:, :3] = _IDENTITY
    turning[:, 3:] = (frames.chain @ structure.axes).reshape(count, _BRANCH_JOINTS, 3)
    centres = np.empty((count, 5, JOINTS_PER_BRANCH, 3))
    centres[:] = frames.pivots[:, :, None]
    centres[:, 1:, 3] = frames.targets[:, MIDDLES]
    origin = np.empty((count, 3 + _BRANCH_JOINTS, 3))
    origin[:, :3] = position[:, None]
    origin[:, 3:] = centres.reshape(count, _BRANCH_JOINTS, 3)
    # axis x (target - centre), for all axes and targets: one product with the matrices of the axes
    skew = cross_matrix(turning)
    moved = skew.reshape(count, -1, 3) @ frames.targets.transpose(0, 2, 1)
    moved -= (skew @ origin[..., None]).reshape(count, -1, 1)
    jacobian = np.empty((count, 6 + _BRANCH_JOINTS, 3, TARGETS))
    jacobian[:, :3] = _IDENTITY[:, :, None]
    np.multiply(moved.reshape(count, -1, 3, TARGETS), structure.mask, out=jacobian[:, 3:])
    return jacobian


def _step(frames: Frames, position: np.ndarray, weighted: WeightedTargets, damping: np.ndarray,
          structure: _Structure) -> np.ndarray:
    """Step (N, 26) of the unknowns. damping: (N, 26, 26) diagonal."""
    count = len(position)
    residual = (weighted.targets - frames.targets).transpose(0, 2, 1)
    if weighted.axis_weights is not None:
        residual = residual * weighted.axis_weights[:, :, None]
    squared = np.add.reduce(residual * residual, axis=1)
    root_weight = np.sqrt(weighted.weights / (1.0 + squared * weighted.robust_precision))[:, None]
    jacobian = _jacobian(frames, position, structure)
    jacobian *= (root_weight if weighted.axis_weights is None
                 else root_weight * weighted.axis_weights[:, :, None])[:, None]
    jacobian = jacobian.reshape(count, -1, 3 * TARGETS)
    residual = (residual * root_weight).reshape(count, -1, 1)
    normal = jacobian @ jacobian.transpose(0, 2, 1)
    normal += damping
    return _solve(normal, jacobian @ residual)


def _solve(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions (N, U) of symmetric positive definite systems (N, U, U), (N, U, 1), which are overwritten.

    Cholesky: for one body faster than numpy's general solver, for ten the same.
    """
    for system, side in zip(normal, right):
        _, _, failed = dposv(system.T, side, overwrite_a=1, overwrite_b=1)
        if failed:
            side[:] = 0.0
    return right[..., 0]


def refine(rotation: np.ndarray, position: np.ndarray, slots: np.ndarray, weighted: WeightedTargets,
           dims: BodyDimensions,
           layout: Layout, steps: int = 2) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move N bodies towards their targets; joints stay within the limits.

    rotation (N, 3, 3), position (N, 3) m, slots (N, 21) rad: where to start. Returns the same.
    """
    structure = _structure(layout)
    slots = slots.copy()
    joints = slots[:, 1:]
    # the joint below a twist gives it its lever: pitch for yaw, elbow for roll
    lever = smooth_step(np.abs(np.sin(slots[:, _TWISTS + 1])), 0.1, 0.3)
    damping = np.empty((len(slots),) + structure.damping.shape)
    damping[:] = structure.damping
    damping[:, _TWIST_ROWS, _TWIST_ROWS] += _TWIST_DAMPING * (1.0 - lever)
    for _ in range(steps):
        frames = compute_frames(rotation, position, slots, dims, layout)
        step = _step(frames, position, weighted, damping, structure)
        position = position + step[:, :3]
        rotation = _turn(step[:, 3:6]) @ rotation
        joints += np.minimum(np.maximum(step[:, 6:], -_MAX_JOINT_STEP), _MAX_JOINT_STEP)
        np.maximum(joints, structure.lower, out=joints)
        np.minimum(joints, structure.upper, out=joints)
    return rotation, position, slots


def _turn(vectors: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) of rotation vectors (N, 3) rad, cut at `_MAX_TURN`."""
    return np.array([about_vector(x, y, z, _MAX_TURN) for x, y, z in vectors.tolist()])
