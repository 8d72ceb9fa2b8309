"""Inverse kinematics of all bodies in one batch: joint angles from key points.

Closed form first; then ikpy for limbs beyond their limits or without a visible middle joint; then Gauss-Newton steps
over the whole chain. Which of them run is the parameter `ik_solver`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, List, Optional, Sequence, Tuple
from weakref import WeakKeyDictionary

import numpy as np

from hri_fullbody.core.keypoints import NECK
from hri_fullbody.core.kinematics.closed_form import ClosedFormSolution, Observation, head_angles, solve_closed_form
from hri_fullbody.core.kinematics.forward import (
    HEAD_TARGETS,
    SELLION_TARGET,
    TARGET_POINTS,
    TARGETS,
    Frames,
    about_axes,
    compute_frames,
)
from hri_fullbody.core.kinematics.gauss_newton import WeightedTargets, refine
from hri_fullbody.core.kinematics.warm_start import WarmStart
from hri_fullbody.core.model.human import HEAD, PAPER, WAIST_SLOT, BodyDimensions, Dimensions, Layout, stack_dimensions
from hri_fullbody.core.model.urdf import make_urdf
from hri_pipeline.core.geometry import Pose

if TYPE_CHECKING:  # with ikpy comes sympy, which takes the processor half a second to load
    from hri_fullbody.core.kinematics.ikpy_backend import LimbChains

METHODS = ("gauss_newton", "closed_form", "ikpy")
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

    def __init__(self, layout: Layout = PAPER, method: str = "gauss_newton", steps: int = 2,
                 ikpy_limbs: int = 1) -> None:
        """method: one of `METHODS`. steps: Gauss-Newton steps. ikpy_limbs: most limbs per call that ikpy solves again
        (some milliseconds each) unless it is the method; the others are cut at their limits.

        Raises ValueError with the legal values.
        """
        if method not in METHODS:
            raise ValueError("ik_solver is {!r}; legal: {}".format(method, ", ".join(METHODS)))
        if steps < 1 or ikpy_limbs < 0:
            raise ValueError("steps is {}, ikpy_limbs {}; legal: 1 and more, 0 and more".format(steps, ikpy_limbs))
        self.layout = layout
        self._method = method
        self._steps = steps
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
            rotation, position, slots = refine(rotation, position, slots, weighted, dims, self.layout, self._steps)
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
