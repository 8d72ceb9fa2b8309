"""Trunk and joint angles from key points in closed form: exact for key points that the model can reach.

The body frame and the waist come from shoulders and hips, with whatever of them is seen; then the limbs.
Limbs are in the order of `BRANCHES` without the head: left arm, right arm, left leg, right leg. Directions are in the
axes of the parent link: the torso for arms, the body for legs. A segment's frame has z against the segment and x to
where the middle joint bends the distal segment (knees: away from it). Angles are worked out in plain numbers, one limb
after another: for the few bodies in a picture that is quicker than some fifty operations on small arrays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.kinematics.forward import (
    ENDS,
    MIDDLES,
    ORIGINS,
    about_axes,
    columns,
    cross,
    dot,
    perpendicular,
    smooth_step,
    unit,
    wrap,
)
from hri_fullbody.core.kinematics.warm_start import RELAX_TIME, WarmStart
from hri_fullbody.core.model.human import (
    HEAD,
    LEFT_ARM,
    LEFT_LEG,
    REP155,
    RIGHT_LEG,
    SLOTS,
    WAIST_SLOT,
    BodyDimensions,
    Layout,
    branch_slot,
)

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


_BEND_SIGN = np.array([1.0, 1.0, -1.0, -1.0])[:, None]
_MIRROR = (1.0, -1.0)
_RESTING_POLES = np.array([[-0.5, 0.2, -1.0], [-0.5, -0.2, -1.0], [1.0, 0.0, 0.1], [1.0, 0.0, 0.1]])
_STRAIGHT, _BENT = 0.10, 0.30
"""Sine of a middle joint below which the plane of the limb is the remembered one, above which it is the seen one."""
_HANGING, _RAISED = 0.10, 0.25
"""Sine of the shoulder's pitch below which its yaw is the remembered one, above which it is the seen one."""
_SWING = math.cos(0.8)
"""Cosine of the shoulder's pitch up to which it may be negative."""
_NATURAL_YAW = 0.7  # rad: to the side and to the front
_NATURALNESS = 0.3  # what a radian from there weighs against one from the yaw before
_YAW_DRIFT = 2.0  # s
_YAW_LOWER, _YAW_UPPER = (float(limits[branch_slot(LEFT_LEG, 0)]) for limits in (REP155.slot_lower, REP155.slot_upper))
_FACE_WEIGHTS = np.array([1.0, 0.8, 0.8, 1.2, 1.2])


def _arcsin(sine: float) -> float:
    """Angle (rad) of a sine that rounding may have put beyond 1."""
    return math.asin(min(max(sine, -1.0), 1.0))


def swivel_directions(proximal: np.ndarray, distal: np.ndarray, remembered: np.ndarray) -> np.ndarray:
    """x axes (N, 4, 3) of the proximal segments.

    proximal, distal: (N, 4, 3) unit directions. remembered: (N, 4, 3) previous result, 0 where there is none. The plane
    of a straight limb cannot be seen, and that of a nearly straight one trembles: there it is carried on.
    """
    aside = perpendicular(distal, proximal) * _BEND_SIGN
    sine = np.sqrt(dot(aside, aside))
    carried = perpendicular(remembered, proximal)
    length = np.sqrt(dot(carried, carried))
    weak = length < 0.2
    if weak.any():
        carried = np.where(weak, perpendicular(_resting_swivel(proximal), proximal), carried)
        length = np.sqrt(dot(carried, carried))
    share = smooth_step(sine, _STRAIGHT, _BENT)
    blend = aside * (share / np.maximum(sine, 1e-9)) + carried * ((1.0 - share) / np.maximum(length, 1e-9))
    length = np.sqrt(dot(blend, blend))
    cancelled = length < 0.1  # opposite directions, half way: what is seen wins
    if cancelled.any():
        return unit(np.where(cancelled, aside, blend))
    return blend / length


def _resting_swivel(proximal: np.ndarray) -> np.ndarray:
    """x axes (N, 4, 3) of limbs swung from hanging by the shortest way: forwards when down, up when forwards."""
    share = proximal[..., 0:1] / np.maximum(1.0 - proximal[..., 2:3], 0.1)
    axes = -share * proximal
    axes[..., 0] += 1.0
    axes[..., 2] += share[..., 0]
    return axes


def middle_joints(ends: np.ndarray, upper: np.ndarray, lower: np.ndarray, remembered: np.ndarray) -> np.ndarray:
    """Places (N, 4, 3) m of middle joints that are not seen, from the limb's origin, by the cosine rule.

    ends: (N, 4, 3) m from the limb's origin. upper, lower: (N, 4, 1) m lengths. remembered: (N, 4, 3) bend directions
    of before, 0 where there are none: then elbows point down and back, knees forwards.
    """
    along = unit(ends)
    reach = np.minimum(np.maximum(np.sqrt(dot(ends, ends)), np.abs(upper - lower) + 1e-3), upper + lower)
    share = (upper * upper - lower * lower + reach * reach) / (2.0 * reach)
    aside = np.sqrt(np.maximum(upper * upper - share * share, 0.0))
    poles = perpendicular(-_BEND_SIGN * remembered, along)
    poles = np.where(dot(poles, poles) > 0.04, poles, perpendicular(_RESTING_POLES, along))
    return along * share + unit(poles) * aside


def proximal_frames(proximal: np.ndarray, swivels: np.ndarray) -> np.ndarray:
    """Rotations (N, 4, 3, 3) of the proximal segments."""
    z_axis = -proximal
    return columns(swivels, cross(z_axis, swivels), z_axis)


def middle_angles(proximal: np.ndarray, distal: np.ndarray, swivels: np.ndarray) -> np.ndarray:
    """Elbow and knee angles (N, 4) rad: elbows bend to positive, knees to negative values."""
    return np.arctan2(dot(distal, swivels), dot(distal, proximal))[..., 0]


def shoulder_angles(frames: np.ndarray, yaw_before: np.ndarray, dt: float) -> np.ndarray:
    """Yaw, pitch, roll (N, 2, 3) rad of both shoulders with frames = Rz(-g yaw) Rx(g pitch) Rz(g roll), g = 1 left, -1
    right.

    frames: (N, 2, 3, 3). yaw_before: (N, 2) rad, dt (s) ago. With the arm hanging or straight up only yaw - roll is
    seen: the yaw is carried on, drifts to the middle of its range, and the roll follows.
    """
    drift = 1.0 - math.exp(-dt / _YAW_DRIFT)
    return np.array([[_shoulder(frame, yaw, drift, mirror) for frame, yaw, mirror in zip(arms, yaws, _MIRROR)]
                     for arms, yaws in zip(frames.tolist(), yaw_before.tolist())])


def _shoulder(frame: Sequence[Sequence[float]], yaw_before: float, drift: float, mirror: float) -> Sequence[float]:
    """Yaw, pitch, roll (rad) of one shoulder; drift: share of the way to the natural yaw."""
    (xx, xy, xz), (yx, yy, yz), (_, _, zz) = frame
    yaw_before += drift * wrap(_NATURAL_YAW - yaw_before)
    seen = -mirror * math.atan2(mirror * xz, -mirror * yz)
    turn = wrap(seen - yaw_before)
    # The same arm has an opposite yaw with negative pitch. Taken is what is nearer to the yaw before, and to the middle
    # of its natural range: an arm that swings past the body keeps its yaw.
    far = abs(turn) + _NATURALNESS * abs(wrap(seen - _NATURAL_YAW)) > 0.5 * math.pi * (1.0 + _NATURALNESS)
    if far and zz > _SWING:
        turn -= math.copysign(math.pi, turn)
    share = (math.hypot(xz, yz) - _HANGING) / (_RAISED - _HANGING)
    yaw = wrap(yaw_before + min(max(share, 0.0), 1.0) * turn)
    # Rz(g yaw) frame = Rx(g pitch) Rz(g roll), as far as the yaw allows
    sin, cos = math.sin(mirror * yaw), math.cos(mirror * yaw)
    pitch = mirror * math.atan2(-sin * xz - cos * yz, zz)
    roll = mirror * math.atan2(sin * yy - cos * xy, cos * xx - sin * yx)
    return yaw, pitch + 2.0 * math.pi if pitch < -2.0 else pitch, roll


def hip_angles(proximal: np.ndarray, frames: np.ndarray, layout: Layout) -> Tuple[np.ndarray, np.ndarray]:
    """Hip angles (N, 2, 3) rad in slots, and the x axes (N, 2, 3) of the thighs with them.

    proximal: (N, 2, 3) unit directions of the thighs, frames: (N, 2, 3, 3) wanted rotations of the thighs. The paper's
    two joints cannot twist the thigh: its x axis follows from its direction.
    """
    if layout is REP155:
        return np.array([[_hip_of_three(frame, mirror) for frame, mirror in zip(legs, _MIRROR)]
                         for legs in frames.tolist()]), frames[..., 0]
    hips = np.array([[_hip_of_two(direction, mirror) for direction, mirror in zip(legs, _MIRROR)]
                     for legs in proximal.tolist()])
    return hips[:, :, 0], hips[:, :, 1]


def _hip_of_two(direction: Sequence[float], mirror: float) -> Sequence[Sequence[float]]:
    """Flexion, abduction, 0 (rad) and x axis of a thigh with a direction (3,)."""
    x, y, z = direction
    flexion = math.atan2(x, -z)
    return (flexion, mirror * _arcsin(y), 0.0), (math.cos(flexion), 0.0, math.sin(flexion))


def _hip_of_three(frame: Sequence[Sequence[float]], mirror: float) -> Sequence[float]:
    """Yaw, abduction, flexion (rad) with frame = Rz(-yaw) Rx(g abduction) Ry(-flexion).

    A yaw beyond its limit is cut first, so that the thigh's direction stays right and only its twist is lost.
    """
    (_, xy, xz), (_, yy, yz), (_, zy, zz) = frame
    yaw = min(max(math.atan2(xy, yy), _YAW_LOWER), _YAW_UPPER)
    sin, cos = math.sin(yaw), math.cos(yaw)
    # Rz(yaw) frame = Rx(g abduction) Ry(-flexion), as far as the yaw allows
    tilt = math.atan2(zy, sin * xy + cos * yy)
    upwards = math.cos(tilt) * zz - math.sin(tilt) * (sin * xz + cos * yz)
    return yaw, mirror * tilt, math.atan2(sin * yz - cos * xz, upwards)


def head_angles(rotation: np.ndarray) -> np.ndarray:
    """Roll, yaw, pitch (N, 3) rad of the head with rotation (N, 3, 3) = Rx(roll) Rz(yaw) Ry(-pitch) in the torso."""
    return np.array([_head_angles(matrix) for matrix in rotation.tolist()])


def _head_angles(matrix: Sequence[Sequence[float]]) -> Sequence[float]:
    """Roll, yaw, pitch (rad) of one head."""
    (xx, xy, xz), (_, yy, _), (_, zy, _) = matrix
    roll, yaw, pitch = math.atan2(zy, yy), -_arcsin(xy), -math.atan2(xz, xx)
    if abs(roll) > 0.5 * math.pi:
        # a roll beyond 90 degrees is a head turned backwards: the other triple of angles says so
        return wrap(math.pi + roll), wrap(math.pi - yaw), wrap(math.pi + pitch)
    return roll, yaw, pitch


def head_rotation(points: np.ndarray, known: np.ndarray, template: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) that turn the template's face points (N, 5, 3) to those seen, weighted least squares.

    points: (N, 5, 3) m, 0 where not known (N, 5). Kabsch's solution by singular values; meaningless with fewer than
    three points.
    """
    weights = (known * _FACE_WEIGHTS)[:, None]
    model = template - weights @ template / np.maximum(np.add.reduce(weights, axis=2, keepdims=True), 1e-9)
    # the points need no centre: the weighted template's is 0
    left, _, right = np.linalg.svd((model.transpose(0, 2, 1) * weights) @ points)
    rotation = (left @ right).transpose(0, 2, 1)
    mirrored = np.linalg.det(rotation) < 0.0
    if mirrored.any():
        right[mirrored, 2] *= -1.0
        rotation = (left @ right).transpose(0, 2, 1)
    return rotation


_FEWEST_FACE_POINTS = 3


@dataclass(frozen=True)
class ClosedFormSolution:
    """Bodies solved in closed form.

    trunk: places of the trunks. slots: (N, 21) rad, not yet within the limits. swivels: (N, 4, 3), see WarmStart.
    seen: (N, 5) branches whose joints were seen; partial: (N, 4) limbs of which the end is known without the middle.
    """

    trunk: TrunkPose
    slots: np.ndarray
    swivels: np.ndarray
    seen: np.ndarray
    partial: np.ndarray


def solve_closed_form(seen: Observation, dims: BodyDimensions, previous: WarmStart, layout: Layout,
                      up: Optional[np.ndarray], dt: float) -> ClosedFormSolution:
    """Solve N bodies. up: (3,) unit vector against gravity in the sensor's frame; dt: s since the previous solution.

    What is not seen is held, then relaxes, see `WarmStart.relaxed`. Below a knee that is seen the shank comes to hang:
    who sits at a table does not stretch the legs out.
    """
    trunk = trunk_pose(seen, dims, previous, layout, up)
    count = len(trunk.waist)
    slots = previous.relaxed(dt)
    branches = slots[:, 1:].reshape(count, 5, 4)
    branch_seen = np.empty((count, 5), dtype=bool)
    head, branch_seen[:, HEAD] = _head(seen, dims, trunk)
    middle_seen, end_seen = seen.known[:, MIDDLES], seen.known[:, ENDS]
    angles, swivels = _limbs(seen, dims, previous, layout, trunk, branches, dt, up)
    np.copyto(branches[:, HEAD, :3], head, where=branch_seen[:, :1])
    branch_seen[:, 1:] = middle_seen | end_seen
    np.copyto(branches[:, 1:, :3], angles[..., :3], where=branch_seen[:, 1:, None])
    np.copyto(branches[:, 1:, 3], angles[..., 3], where=end_seen)
    loose = middle_seen[:, 2:] & ~end_seen[:, 2:]
    if up is not None and loose.any():
        knees = branches[:, LEFT_LEG:, 3]
        share = np.where(previous.known, 1.0 - math.exp(-dt / RELAX_TIME), 1.0)[:, None]
        knees += np.where(loose, share * (np.minimum(angles[:, 2:, 3], 0.0) - knees), 0.0)
    out = np.empty((count, SLOTS))
    out[:, WAIST_SLOT] = trunk.waist
    out[:, 1:] = branches.reshape(count, -1)
    return ClosedFormSolution(trunk, out, swivels, branch_seen, end_seen & ~middle_seen)


def _head(seen: Observation, dims: BodyDimensions, trunk: TrunkPose) -> Tuple[np.ndarray, np.ndarray]:
    """Head angles (N, 3) rad and whether they are known (N,): of the face's pose, else of the face's points."""
    known = seen.known[:, 13:18]
    by_points = (np.add.reduce(known, axis=1) >= _FEWEST_FACE_POINTS) & ~seen.head_known
    rotation = seen.head_rotation
    if by_points.any():
        fitted = head_rotation(seen.targets[:, 13:18], known, dims.head[:, 1:])
        rotation = fitted if by_points.all() else np.where(by_points[:, None, None], fitted, rotation)
    return head_angles(trunk.torso.transpose(0, 2, 1) @ rotation), by_points | seen.head_known


def _limbs(seen: Observation, dims: BodyDimensions, previous: WarmStart, layout: Layout, trunk: TrunkPose,
           branches: np.ndarray, dt: float, up: Optional[np.ndarray]) -> Tuple[np.ndarray, np.ndarray]:
    """Angles (N, 4, 4) rad and swivel directions (N, 4, 3) of the limbs, meaningless for those of which nothing is
    seen. A shank that is not seen hangs."""
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
        middles = np.where(partial[..., None], middle_joints(ends, dims.proximal, dims.distal, previous.swivels),
                           middles)
    proximal, distal = unit(middles), unit(ends - middles)
    if not complete:
        unseen = proximal.copy()
        if up is not None:
            unseen[:, 2:] = -(up @ trunk.rotation)[:, None]
        distal = np.where(end_known[..., None], distal, unseen)
    swivels = swivel_directions(proximal, distal, previous.swivels)
    frames = proximal_frames(proximal, swivels)
    angles = np.empty((count, 4, 4))
    angles[:, :2, :3] = shoulder_angles(frames[:, :2], branches[:, 1:3, 0], dt)
    angles[:, 2:, :3], swivels[:, 2:] = hip_angles(proximal[:, 2:], frames[:, 2:], layout)
    angles[..., 3] = middle_angles(proximal, distal, swivels)
    return angles, swivels if complete else np.where(middle_known[..., None], swivels, previous.swivels)


def _origins(seen: Observation, dims: BodyDimensions, trunk: TrunkPose, bases: np.ndarray) -> np.ndarray:
    """Origins (N, 4, 3) m of the limbs: where they are seen, else where the trunk, with axes bases, has them."""
    known = seen.known[:, ORIGINS]
    if known.all():
        return seen.targets[:, ORIGINS]
    origins = (bases @ dims.pivots[:, 1:, :, None])[..., 0]
    origins[:, :2] += (trunk.position + trunk.torso[:, :, 2] * dims.trunk)[:, None]
    origins[:, 2:] += trunk.position[:, None]
    return np.where(known[..., None], seen.targets[:, ORIGINS], origins)
