"""Joint angles of limbs and head from directions, in closed form.

Limbs are in the order of `BRANCHES` without the head: left arm, right arm, left leg, right leg. Directions are in the
axes of what the limb hangs on: the torso for arms, the body for legs. A segment's frame has z against the segment and
x to where the middle joint bends the distal segment (knees: away from it). Angles are worked out in plain numbers, one
limb after another: for the few bodies in a picture that is quicker than some fifty operations on small arrays.
"""

from __future__ import annotations

import math
from typing import Sequence, Tuple

import numpy as np

from hri_fullbody.core.human.human_model import LEFT_LEG, REP155, Layout, branch_slot
from hri_fullbody.core.joints.rotations import columns, cross, dot, perpendicular, smooth_step, unit, wrap

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


def bend_directions(proximal: np.ndarray, distal: np.ndarray, remembered: np.ndarray) -> np.ndarray:
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
        carried = np.where(weak, perpendicular(_resting_bend(proximal), proximal), carried)
        length = np.sqrt(dot(carried, carried))
    share = smooth_step(sine, _STRAIGHT, _BENT)
    blend = aside * (share / np.maximum(sine, 1e-9)) + carried * ((1.0 - share) / np.maximum(length, 1e-9))
    length = np.sqrt(dot(blend, blend))
    cancelled = length < 0.1  # opposite directions, half way: what is seen wins
    if cancelled.any():
        return unit(np.where(cancelled, aside, blend))
    return blend / length


def _resting_bend(proximal: np.ndarray) -> np.ndarray:
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


def proximal_frames(proximal: np.ndarray, bends: np.ndarray) -> np.ndarray:
    """Rotations (N, 4, 3, 3) of the proximal segments."""
    z_axis = -proximal
    return columns(bends, cross(z_axis, bends), z_axis)


def middle_angles(proximal: np.ndarray, distal: np.ndarray, bends: np.ndarray) -> np.ndarray:
    """Elbow and knee angles (N, 4) rad: elbows bend to positive, knees to negative values."""
    return np.arctan2(dot(distal, bends), dot(distal, proximal))[..., 0]


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
    return np.array([_head(matrix) for matrix in rotation.tolist()])


def _head(matrix: Sequence[Sequence[float]]) -> Sequence[float]:
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
