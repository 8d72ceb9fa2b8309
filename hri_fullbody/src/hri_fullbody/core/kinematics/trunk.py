"""Body frame and waist from shoulders and hips, with whatever of them is seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from hri_fullbody.core.kinematics.forward import about_axes, columns, cross, dot, perpendicular, smooth_step, unit
from hri_fullbody.core.kinematics.warm_start import WarmStart
from hri_fullbody.core.model.human import LEFT_ARM, RIGHT_LEG, WAIST_SLOT, BodyDimensions, Layout

_OPTICAL_UP = np.array([0.0, -1.0, 0.0])
_Y = np.array([0.0, 1.0, 0.0])
_WEAKEST_LINE = 0.2  # of a sum of unit vectors: shoulders and hips that contradict each other are not believed
_WEAKEST_ANGLE = 0.15  # sine between spine and shoulder line
_HIP_EXTENSION = 0.35  # rad that a hip bends backwards at most while the waist bends forwards


@dataclass(frozen=True)
class Observation:
    """Key points of N bodies as targets of the model, see `forward_kinematics`.

    targets: (N, 18, 3) m in the sensor's frame, 0 where not known. known: (N, 18). neck: (N, 3) m, neck_known: (N,).
    head_rotation: (N, 3, 3) of the head frame, head_known: (N,).
    """

    targets: np.ndarray
    known: np.ndarray
    neck: np.ndarray
    neck_known: np.ndarray
    head_rotation: np.ndarray
    head_known: np.ndarray


@dataclass(frozen=True)
class TrunkPose:
    """rotation (N, 3, 3), position (N, 3) m of the body frame; torso (N, 3, 3); waist (N,) rad; solved (N,)."""

    rotation: np.ndarray
    position: np.ndarray
    torso: np.ndarray
    waist: np.ndarray
    solved: np.ndarray


def trunk_pose(seen: Observation, dims: BodyDimensions, previous: WarmStart, layout: Layout,
               up: Optional[np.ndarray]) -> TrunkPose:
    """Place the trunk. up: (3,) unit vector against gravity in the sensor's frame, None where it is not known.

    Solved needs two of shoulders, hips and neck, or one and a previous solution.
    """
    known = seen.known[:, :4]
    lateral, sure = _lateral(seen, previous)
    middles, have = _middles(seen, lateral, dims)
    shoulders, hips = middles[:, 0], middles[:, 1]
    both = have[:, :1] & have[:, 1:]
    spine = unit(shoulders - hips)
    if not both.all():
        fallback = np.where(previous.known[:, None], previous.rotation[:, :, 2], _OPTICAL_UP if up is None else up)
        spine = np.where(both, spine, fallback)
        missing = spine * dims.trunk
        shoulders, hips = (np.where(have[:, :1], shoulders, hips + missing),
                           np.where(have[:, 1:], hips, shoulders - missing))
    if not sure.all():
        lateral = np.where(sure, lateral, _facing_sensor(spine, hips))
    across = perpendicular(spine, lateral)
    sine = np.sqrt(dot(across, across))
    upright = sine[:, 0] > _WEAKEST_ANGLE
    z_axis = across / np.maximum(sine, 1e-9)
    torso = columns(cross(lateral, z_axis), lateral, z_axis)
    if up is None:
        waist = np.zeros(len(torso))
        rotation = torso
    else:
        waist = _waist(seen, torso, layout, up)
        rotation = torso @ about_axes(_Y, -waist)
    # half of what the trunk's length is wrong by goes to each end
    position = hips + 0.5 * both * (shoulders - hips - z_axis * dims.trunk)
    points = np.add.reduce(known, axis=1) + seen.neck_known
    solved = upright & (points > np.where(previous.known, 0, 1))
    return TrunkPose(rotation, position, torso, waist, solved)


def _lateral(seen: Observation, previous: WarmStart) -> Tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) from right to left, and whether they were seen or remembered (N, 1).

    Half shoulders, half hips; else that of the previous frame, else that of the head.
    """
    lines = seen.targets[:, 0:4:2] - seen.targets[:, 1:4:2]
    pairs = seen.known[:, 0:4:2] & seen.known[:, 1:4:2]
    total = np.add.reduce(unit(lines) * pairs[..., None], axis=1)
    length = np.sqrt(dot(total, total))
    strong = length > _WEAKEST_LINE
    if strong.all():
        return total / length, strong
    instead = np.where(previous.known[:, None], previous.rotation[:, :, 1], seen.head_rotation[:, :, 1])
    sure = strong[:, 0] | previous.known | seen.head_known
    return unit(np.where(strong, total, instead)), sure[:, None]


def _middles(seen: Observation, lateral: np.ndarray, dims: BodyDimensions) -> Tuple[np.ndarray, np.ndarray]:
    """Middle of the shoulders and of the hips (N, 2, 3) m, and whether they are known (N, 2).

    One of a pair gives the middle by the model's width.
    """
    left, right = seen.known[:, 0:4:2, None], seen.known[:, 1:4:2, None]
    if seen.known[:, :4].all():
        return 0.5 * (seen.targets[:, 0:4:2] + seen.targets[:, 1:4:2]), left[..., 0]
    half = dims.pivots[:, LEFT_ARM:RIGHT_LEG:2, 1, None] * lateral[:, None]
    total = (seen.targets[:, 0:4:2] - half) * left + (seen.targets[:, 1:4:2] + half) * right
    middles = total / np.maximum(left.astype(np.float64) + right, 1.0)
    have = (left | right)[..., 0]
    by_neck = ~have[:, 0] & seen.neck_known
    if by_neck.any():
        middles[by_neck, 0] = seen.neck[by_neck]
        have[by_neck, 0] = True
    return middles, have


def _facing_sensor(spine: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Lateral axis (N, 3) of a body that faces the sensor: the guess when nothing tells."""
    return unit(cross(unit(place), spine))


def _waist(seen: Observation, torso: np.ndarray, layout: Layout, up: np.ndarray) -> np.ndarray:
    """Waist angles (N,) rad: the pitch of the trunk against gravity, while that makes sense.

    It fades to 0 for people who lie or hang upside down, and never bends the hips backwards: whoever lies on the
    belly has a straight waist.
    """
    lateral = torso[:, :, 1]
    tilt = np.abs(lateral @ up)
    pitch = np.arctan2(torso[:, :, 0] @ up, torso[:, :, 2] @ up)
    waist = -pitch
    lower, upper = layout.slot_lower[WAIST_SLOT], layout.slot_upper[WAIST_SLOT]
    fade = (1.0 - smooth_step(tilt, 0.5, 0.8)) * (1.0 - smooth_step(waist, upper + 0.1, upper + 0.8))
    fade *= 1.0 - smooth_step(-waist, -lower, -lower + 0.6)
    thighs = (seen.targets[:, 6:8] - seen.targets[:, 2:4]) * (seen.known[:, 6:8] & seen.known[:, 2:4])[..., None]
    total = np.add.reduce(thighs, axis=1)
    flexion = np.arctan2(dot(total, torso[:, :, 0]), -dot(total, torso[:, :, 2]))[:, 0]
    most = np.where(dot(total, total)[:, 0] > 0.0, np.maximum(flexion, 0.0) + _HIP_EXTENSION, upper)
    return np.minimum(np.minimum(np.maximum(waist, lower), upper) * fade, most)
