"""Joints from key points in closed form: exact for key points that the model can reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from hri_fullbody.core.human.human_model import HEAD, SLOTS, WAIST_SLOT, BodyDimensions, Layout
from hri_fullbody.core.joints.body_memory import BodyMemory
from hri_fullbody.core.joints.forward_kinematics import ENDS, MIDDLES, ORIGINS
from hri_fullbody.core.joints.limb_angles import (
    bend_directions,
    head_angles,
    head_rotation,
    hip_angles,
    middle_angles,
    middle_joints,
    proximal_frames,
    shoulder_angles,
)
from hri_fullbody.core.joints.rotations import unit
from hri_fullbody.core.joints.trunk_pose import Observation, TrunkPose, trunk_pose

_FEWEST_FACE_POINTS = 3


@dataclass(frozen=True)
class Posture:
    """Bodies solved in closed form.

    trunk: places of the trunks. slots: (N, 21) rad, not yet within the limits. bends: (N, 4, 3), see BodyMemory.
    seen: (N, 5) branches whose joints were seen; partial: (N, 4) limbs of which the end is known without the middle.
    """

    trunk: TrunkPose
    slots: np.ndarray
    bends: np.ndarray
    seen: np.ndarray
    partial: np.ndarray


def solve_closed_form(seen: Observation, dims: BodyDimensions, memory: BodyMemory, layout: Layout,
                      up: Optional[np.ndarray], dt: float) -> Posture:
    """Solve N bodies. up: (3,) unit vector against gravity in the sensor's frame; dt: s since the memory was made.

    What is not seen is held, then relaxes, see `BodyMemory.relaxed`.
    """
    trunk = trunk_pose(seen, dims, memory, layout, up)
    count = len(trunk.waist)
    slots = memory.relaxed(dt)
    branches = slots[:, 1:].reshape(count, 5, 4)
    branch_seen = np.empty((count, 5), dtype=bool)
    head, branch_seen[:, HEAD] = _head(seen, dims, trunk)
    middle_seen, end_seen = seen.known[:, MIDDLES], seen.known[:, ENDS]
    angles, bends = _limbs(seen, dims, memory, layout, trunk, branches, dt)
    np.copyto(branches[:, HEAD, :3], head, where=branch_seen[:, :1])
    branch_seen[:, 1:] = middle_seen | end_seen
    np.copyto(branches[:, 1:, :3], angles[..., :3], where=branch_seen[:, 1:, None])
    np.copyto(branches[:, 1:, 3], angles[..., 3], where=end_seen)
    out = np.empty((count, SLOTS))
    out[:, WAIST_SLOT] = trunk.waist
    out[:, 1:] = branches.reshape(count, -1)
    return Posture(trunk, out, bends, branch_seen, end_seen & ~middle_seen)


def _head(seen: Observation, dims: BodyDimensions, trunk: TrunkPose) -> Tuple[np.ndarray, np.ndarray]:
    """Head angles (N, 3) rad and whether they are known (N,): of the face's pose, else of the face's points."""
    known = seen.known[:, 13:18]
    by_points = (np.add.reduce(known, axis=1) >= _FEWEST_FACE_POINTS) & ~seen.head_known
    rotation = seen.head_rotation
    if by_points.any():
        fitted = head_rotation(seen.targets[:, 13:18], known, dims.head[:, 1:])
        rotation = fitted if by_points.all() else np.where(by_points[:, None, None], fitted, rotation)
    return head_angles(trunk.torso.transpose(0, 2, 1) @ rotation), by_points | seen.head_known


def _limbs(seen: Observation, dims: BodyDimensions, memory: BodyMemory, layout: Layout, trunk: TrunkPose,
           branches: np.ndarray, dt: float) -> Tuple[np.ndarray, np.ndarray]:
    """Angles (N, 4, 4) rad and bends (N, 4, 3) of the limbs, meaningless for those of which nothing is seen."""
    count = len(branches)
    bases = np.empty((count, 4, 3, 3))
    bases[:, :2] = trunk.torso[:, None]
    bases[:, 2:] = trunk.rotation[:, None]
    origins = _origins(seen, dims, trunk, bases)
    middle_known, end_known = seen.known[:, MIDDLES], seen.known[:, ENDS]
    complete = bool(seen.known[:, MIDDLES.start:ENDS.stop].all())
    # rows times a matrix: the inverse rotation
    middles = ((seen.targets[:, MIDDLES] - origins)[:, :, None] @ bases)[:, :, 0]
    ends = ((seen.targets[:, ENDS] - origins)[:, :, None] @ bases)[:, :, 0]
    partial = end_known & ~middle_known
    if not complete and partial.any():
        middles = np.where(partial[..., None], middle_joints(ends, dims.proximal, dims.distal, memory.bends), middles)
    proximal, distal = unit(middles), unit(ends - middles)
    if not complete:
        distal = np.where(end_known[..., None], distal, proximal)
    bends = bend_directions(proximal, distal, memory.bends)
    frames = proximal_frames(proximal, bends)
    angles = np.empty((count, 4, 4))
    angles[:, :2, :3] = shoulder_angles(frames[:, :2], branches[:, 1:3, 0], dt)
    angles[:, 2:, :3], bends[:, 2:] = hip_angles(proximal[:, 2:], frames[:, 2:], layout)
    angles[..., 3] = middle_angles(proximal, distal, bends)
    return angles, bends if complete else np.where(middle_known[..., None], bends, memory.bends)


def _origins(seen: Observation, dims: BodyDimensions, trunk: TrunkPose, bases: np.ndarray) -> np.ndarray:
    """Origins (N, 4, 3) m of the limbs: where they are seen, else where the trunk, with axes bases, has them."""
    known = seen.known[:, ORIGINS]
    if known.all():
        return seen.targets[:, ORIGINS]
    origins = (bases @ dims.pivots[:, 1:, :, None])[..., 0]
    origins[:, :2] += (trunk.position + trunk.torso[:, :, 2] * dims.trunk)[:, None]
    origins[:, 2:] += trunk.position[:, None]
    return np.where(known[..., None], seen.targets[:, ORIGINS], origins)
