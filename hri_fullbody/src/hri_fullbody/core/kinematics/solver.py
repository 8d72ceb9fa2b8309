"""Inverse kinematics of all bodies in one batch: joint angles from key points.

Closed form first; then ikpy for limbs beyond their limits or without a visible middle joint; then Gauss-Newton steps
over the whole chain. Which of them run is the parameter `ik_solver`.

The Gauss-Newton steps are damped, and bring the chain close to all targets at once: a limb by itself hangs on one noisy
joint; the whole body shares the noise among all points. Unknowns: position and rotation of the body, and its joints
without the waist, which cannot be told apart from the body's and the hips' pitch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, List, Optional, Sequence, Tuple
from weakref import WeakKeyDictionary

import numpy as np
from scipy.linalg.lapack import dposv

from hri_fullbody.core.keypoints import NECK
from hri_fullbody.core.kinematics.closed_form import ClosedFormSolution, Observation, head_angles, solve_closed_form
from hri_fullbody.core.kinematics.forward import (
    HEAD_TARGETS,
    MIDDLES,
    SELLION_TARGET,
    TARGET_POINTS,
    TARGETS,
    Frames,
    about_axes,
    about_vector,
    compute_frames,
    cross_matrix,
    smooth_step,
)
from hri_fullbody.core.kinematics.warm_start import WarmStart
from hri_fullbody.core.model.human import (
    HEAD,
    JOINTS_PER_BRANCH,
    LEFT_ARM,
    PAPER,
    RIGHT_ARM,
    WAIST_SLOT,
    BodyDimensions,
    Dimensions,
    Layout,
    branch_slot,
    stack_dimensions,
)
from hri_fullbody.core.model.urdf import make_urdf
from hri_pipeline.core.geometry import Pose

if TYPE_CHECKING:  # most bodies never need it
    from hri_fullbody.core.kinematics.ikpy_backend import LimbChains

METHODS = ("gauss_newton", "closed_form", "ikpy")
GAUSS_NEWTON_STEPS = 2
FARTHEST = 100.0
"""A key point farther (m) than this on any axis is taken for a mistake, and for not seen."""
_OUT_OF_LIMITS = 0.3  # rad beyond a limit from which a limb is solved again; less is noise, and is cut
_PARTIAL_OUT_OF_LIMITS = 0.01  # rad, the same for a limb whose middle joint is only guessed
_LEAST_NOISE, _LEAST_AXIS_WEIGHT = 1e-3, 0.4  # m; the slow part of a depth's error is not seen in its noise
_Y = np.array([0.0, 1.0, 0.0])
_IDENTITY = np.eye(3)
# Face points weigh less than joints; those of a face's own pose more: head and face are one thing. A key point is
# doubted from 11 cm, a face's pose from 30 cm: then it is another's.
_WEIGHTS = np.ones(TARGETS)
_WEIGHTS[HEAD_TARGETS] = 0.15  # of five face points; they are a template on a neck that bends in one place only
_POSE_WEIGHT = 15.0
_HEAD_TO_SHOULDER = 0.8  # m: a third of it is the distance; the rest is left to errors of depth
_ROBUST_PRECISION = np.full(TARGETS, 0.11 ** -2)
_ROBUST_PRECISION_WITH_POSE = _ROBUST_PRECISION.copy()
_ROBUST_PRECISION_WITH_POSE[HEAD_TARGETS] = 0.3 ** -2
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
class JointSolution:
    """Solved bodies, in the order they were given.

    rotation (N, 3, 3), position (N, 3) m: body frame in the sensor's frame. q: (N, J) rad within the limits.
    solved: (N,); where False, the values are those of before, NaN if the body was never solved.
    keypoints: (N, 18, 3) m of the model; head_rotation (N, 3, 3), head_position (N, 3) m: head frame.
    states: one per body, to be handed back next time.
    """

    rotation: np.ndarray
    position: np.ndarray
    q: np.ndarray
    solved: np.ndarray
    keypoints: np.ndarray
    head_rotation: np.ndarray
    head_position: np.ndarray
    states: List[np.ndarray]


class JointSolver:
    """Solves bodies of one layout. Holds nothing about them but what their dimensions lead to."""

    def __init__(self, layout: Layout = PAPER, method: str = "gauss_newton", ikpy_limbs: int = 1) -> None:
        """method: one of `METHODS`. ikpy_limbs: most limbs per call that ikpy solves again (some milliseconds each)
        unless it is the method; the others are cut at their limits.

        Raises ValueError with the legal values.
        """
        if method not in METHODS:
            raise ValueError("ik_solver is {!r}; legal: {}".format(method, ", ".join(METHODS)))
        self.layout = layout
        self._method = method
        self._ikpy_limbs = ikpy_limbs
        self._chains: "WeakKeyDictionary[Dimensions, LimbChains]" = WeakKeyDictionary()
        self._stacked: Tuple[Tuple[Dimensions, ...], BodyDimensions] = ((), stack_dimensions(()))

    def solve(self, points: np.ndarray, dimensions: Sequence[Dimensions], states: Sequence[Optional[np.ndarray]],
              dt: float = 0.0, up: Optional[np.ndarray] = None,
              heads: Optional[Sequence[Optional[Pose]]] = None, noise: Optional[np.ndarray] = None) -> JointSolution:
        """Solve N bodies.

        points: (N, 18, 3) m in the sensor's frame, not finite where not seen. states: of the previous solution, None
        for a new body. dt: s since then. up: (3,) against gravity in the sensor's frame, None where it is not known.
        heads: the face's pose in the sensor's frame, None where there is none. noise: (N, 3) m, standard deviation of
        the points along the frame's axes, if known: a coarse depth then counts less than the directions.
        Raises ValueError when the numbers of bodies differ.
        """
        points = np.asarray(points, dtype=np.float64)
        count = len(dimensions)
        if points.shape != (count, 18, 3) or len(states) != count or (heads is not None and len(heads) != count):
            raise ValueError("{} points, {} dimensions, {} states, {} heads: expected (N, 18, 3), N, N, N".format(
                points.shape, count, len(states), count if heads is None else len(heads)))
        if count == 0:
            return _nobody(len(self.layout))
        dims = self._stack(dimensions)
        seen, weighted = _observe(points, dims, heads)
        previous = WarmStart.of(states)
        start = solve_closed_form(seen, dims, previous, self.layout, _unit_or_none(up), max(0.0, float(dt)))
        solved = start.trunk.solved
        rotation, position = start.trunk.rotation, start.trunk.position
        if not solved.all():
            rotation = np.where(solved[:, None, None], rotation, _IDENTITY)
            position = np.where(solved[:, None], position, 0.0)
        slots = self._within_limits(seen, start, rotation, position, dims, dimensions)
        if self._method == "gauss_newton":
            if noise is not None:
                weighted = replace(weighted, axis_weights=_axis_weights(np.asarray(noise, dtype=np.float64)))
            rotation, position, slots = refine(rotation, position, slots, weighted, dims, self.layout)
        if heads is not None:
            self._turn_heads(seen, rotation, slots)
        frames = compute_frames(rotation, position, slots, dims, self.layout)
        return self._solution(solved, rotation, position, slots, frames, start, previous, dt, dims)

    def _stack(self, dimensions: Sequence[Dimensions]) -> BodyDimensions:
        """Arrays of the dimensions; those of the last call if they are the same objects."""
        known, stacked = self._stacked
        if len(known) != len(dimensions) or any(a is not b for a, b in zip(known, dimensions)):
            stacked = stack_dimensions(dimensions)
            self._stacked = (tuple(dimensions), stacked)
        return stacked

    def _within_limits(self, seen: Observation, start: ClosedFormSolution, rotation: np.ndarray, position: np.ndarray,
                       dims: BodyDimensions, dimensions: Sequence[Dimensions]) -> np.ndarray:
        """Slots (N, 21) rad within the limits; limbs that were not are solved again by ikpy.

        So are those that lack their middle joint, unless the guess of the closed form is within the limits.
        """
        slots = np.minimum(np.maximum(start.slots, self.layout.slot_lower), self.layout.slot_upper)
        count = len(slots)
        if self._method == "ikpy":
            again = start.seen[:, 1:] & seen.known[:, 8:12]
        else:
            beyond = np.abs(slots - start.slots)[:, 1:].reshape(count, 5, 4)[:, 1:].max(axis=-1)
            again = beyond > np.where(start.partial, _PARTIAL_OUT_OF_LIMITS, _OUT_OF_LIMITS)
            again &= start.seen[:, 1:] & seen.known[:, 8:12]
        again &= start.trunk.solved[:, None]
        if not again.any():
            return slots
        wanted = compute_frames(rotation, position, start.slots, dims, self.layout)
        chosen = np.argwhere(again)
        if self._method != "ikpy":
            chosen = chosen[:self._ikpy_limbs]
        for body, limb in chosen:
            base = wanted.torso[body] if limb < 2 else rotation[body]
            origin = wanted.neck[body] if limb < 2 else position[body]
            end = base.T @ (seen.targets[body, 8 + limb] - origin)
            turned = None if start.partial[body, limb] else base.T @ wanted.chain[body, 1 + limb, 3]
            first = 1 + 4 * (limb + 1)
            slots[body, first:first + 4] = self._limb_chains(dimensions[body]).solve(
                int(limb) + 1, slots[body, first:first + 4], end, turned)
        return slots

    def _limb_chains(self, dimensions: Dimensions) -> LimbChains:
        chains = self._chains.get(dimensions)
        if chains is None:
            from hri_fullbody.core.kinematics.ikpy_backend import LimbChains
            chains = LimbChains(make_urdf(dimensions, "body", self.layout, visuals=False), "body", self.layout)
            self._chains[dimensions] = chains
        return chains

    def _turn_heads(self, seen: Observation, rotation: np.ndarray, slots: np.ndarray) -> None:
        """Give heads whose pose is known exactly its orientation, as far as the limits let them."""
        torso = rotation @ about_axes(_Y, slots[:, WAIST_SLOT])
        angles = head_angles(torso.transpose(0, 2, 1) @ seen.head_rotation)
        first = 1 + 4 * HEAD
        lower, upper = self.layout.slot_lower[first:first + 3], self.layout.slot_upper[first:first + 3]
        slots[:, first:first + 3] = np.where(seen.head_known[:, None], np.minimum(np.maximum(angles, lower), upper),
                                             slots[:, first:first + 3])

    def _solution(self, solved: np.ndarray, rotation: np.ndarray, position: np.ndarray, slots: np.ndarray,
                  frames: Frames, start: ClosedFormSolution, previous: WarmStart, dt: float,
                  dims: BodyDimensions) -> JointSolution:
        """Put the result together; a body that was not solved stays as it was."""
        unseen = np.where(start.seen, 0.0, previous.unseen + dt)
        swivels = start.swivels
        if not solved.all():
            keep = ~solved
            rotation, position = rotation.copy(), position.copy()
            rotation[keep], position[keep] = previous.rotation[keep], previous.position[keep]
            slots[keep] = previous.slots[keep]
            swivels = np.where(keep[:, None, None], previous.swivels, swivels)
            unseen[keep] = previous.unseen[keep] + dt
            frames = compute_frames(rotation, position, slots, dims, self.layout)
        q = self.layout.from_slots(slots)
        if not solved.all():
            q[np.isnan(position[:, 0])] = np.nan
        states = WarmStart(solved, rotation, position, slots, swivels, unseen).split()
        return JointSolution(rotation, position, q, solved, frames.keypoints(), frames.head_rotation.copy(),
                             frames.head_position.copy(), states)


def _observe(points: np.ndarray, dims: BodyDimensions,
             heads: Optional[Sequence[Optional[Pose]]]) -> Tuple[Observation, WeightedTargets]:
    """Key points as targets, and what they weigh."""
    count = len(points)
    finite = np.logical_and.reduce(np.abs(points) < FARTHEST, axis=2)  # also False for NaN
    if not finite.all():
        points = np.where(finite[..., None], points, 0.0)
    targets, known = points[:, TARGET_POINTS], finite[:, TARGET_POINTS]
    known[:, SELLION_TARGET] = False  # none of the key points
    head_rotation = np.empty((count, 3, 3))
    head_rotation[:] = _IDENTITY
    head_known = np.zeros(count, dtype=bool)
    weights, robust_precision = known * _WEIGHTS, _ROBUST_PRECISION
    for n, pose in enumerate(heads or ()):
        if pose is None or not _may_be_head(pose, targets[n], known[n]):
            continue
        head_known[n], head_rotation[n] = True, pose.rotation
        targets[n, HEAD_TARGETS] = pose.apply(dims.head[n] - dims.head[n, 0])
        known[n, HEAD_TARGETS] = True
        weights[n, HEAD_TARGETS] = _POSE_WEIGHT
    if head_known.any():
        robust_precision = np.where(head_known[:, None], _ROBUST_PRECISION_WITH_POSE, _ROBUST_PRECISION)
    seen = Observation(targets, known, points[:, NECK], finite[:, NECK], head_rotation, head_known)
    return seen, WeightedTargets(targets, weights, robust_precision)


def _may_be_head(pose: Pose, targets: np.ndarray, known: np.ndarray) -> bool:
    """Tell whether a face's pose is one, and near enough to the shoulders that are seen to belong to them."""
    if not np.isfinite(pose.rotation).all() or not np.all(np.abs(pose.translation) < FARTHEST):
        return False
    shoulders = targets[:2][known[:2]]
    return len(shoulders) == 0 or bool(
        np.linalg.norm(shoulders - pose.translation, axis=1).min() < _HEAD_TO_SHOULDER)


def _nobody(joints: int) -> JointSolution:
    """The solution of no bodies."""
    return JointSolution(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, joints)), np.zeros(0, dtype=bool),
                         np.zeros((0, 18, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), [])


def _axis_weights(noise: np.ndarray) -> np.ndarray:
    """Weights (N, 3) of the axes' residuals: 1 for the axis with the least noise (N, 3) m, less for the others."""
    noise = np.maximum(noise, _LEAST_NOISE)
    return np.maximum(noise.min(axis=1, keepdims=True) / noise, _LEAST_AXIS_WEIGHT)


def _unit_or_none(up: Optional[np.ndarray]) -> Optional[np.ndarray]:
    """`up` with length 1; None when it is no direction."""
    if up is None:
        return None
    up = np.asarray(up, dtype=np.float64).reshape(3)
    length = float(np.linalg.norm(up))
    return up / length if np.isfinite(length) and length > 1e-6 else None


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
           dims: BodyDimensions, layout: Layout) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move N bodies towards their targets in GAUSS_NEWTON_STEPS; joints stay within the limits.

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
    for _ in range(GAUSS_NEWTON_STEPS):
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
