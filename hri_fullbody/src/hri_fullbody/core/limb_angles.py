"""Joint angles of limbs and head from directions, in closed form.

Limbs are in the order of `BRANCHES` without the head: left arm, right arm, left leg, right leg. Directions are in the
axes of what the limb hangs on: the torso for arms, the body for legs. A segment's frame has z against the segment and
x to where the middle joint bends the distal segment (knees: away from it).
"""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from hri_fullbody.core.human_model import LEFT_LEG, REP155, Layout, branch_slot
from hri_fullbody.core.rotations import columns, cross, dot, perpendicular, smooth_step, unit, wrap

_BEND_SIGN = np.array([1.0, 1.0, -1.0, -1.0])[:, None]
_MIRROR = np.array([1.0, -1.0])
_ZERO = np.zeros(2)
_RESTING_POLES = np.array([[-0.5, 0.2, -1.0], [-0.5, -0.2, -1.0], [1.0, 0.0, 0.1], [1.0, 0.0, 0.1]])
_STRAIGHT, _BENT = 0.10, 0.30
"""Sine of a middle joint below which the plane of the limb is the remembered one, above which it is the seen one."""
_HANGING, _RAISED = 0.10, 0.25
"""Sine of the shoulder's pitch below which its yaw is the remembered one, above which it is the seen one."""
_SWING = np.cos(0.8)
"""Cosine of the shoulder's pitch up to which it may be negative."""
_NATURAL_YAW = 0.7  # rad: to the side and to the front
_NATURALNESS = 0.3  # what a radian from there weighs against one from the yaw before
_YAW_DRIFT = 2.0  # s
_YAW_LOWER, _YAW_UPPER = (limits[branch_slot(LEFT_LEG, 0)] for limits in (REP155.slot_lower, REP155.slot_upper))
_FACE_WEIGHTS = np.array([1.0, 0.8, 0.8, 1.2, 1.2])


def _arcsin(sines: np.ndarray) -> np.ndarray:
    """Angles (rad) of sines that rounding may have put beyond 1."""
    return np.arcsin(np.minimum(np.maximum(sines, -1.0), 1.0))


def bend_directions(proximal: np.ndarray, distal: np.ndarray, remembered: np.ndarray) -> np.ndarray:
    """x axes (N, 4, 3) of the proximal segments.

    proximal, distal: (N, 4, 3) unit directions. remembered: (N, 4, 3) previous result, 0 where there is none. The plane
    of a straight limb cannot be seen, and that of a nearly straight one trembles: there it is carried on.
    """
    aside = perpendicular(distal, proximal) * _BEND_SIGN
    sine = np.sqrt(dot(aside, aside))
    carried = perpendicular(remembered, proximal)
    weak = dot(carried, carried) < 0.04
    if weak.any():
        carried = np.where(weak, perpendicular(_resting_bend(proximal), proximal), carried)
    share = smooth_step(sine, _STRAIGHT, _BENT)
    blend = share * aside / np.maximum(sine, 1e-9) + (1.0 - share) * unit(carried)
    cancelled = dot(blend, blend) < 0.01  # opposite directions, half way: what is seen wins
    if cancelled.any():
        blend = np.where(cancelled, aside, blend)
    return unit(blend)


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
    yaw_before = yaw_before + (1.0 - math.exp(-dt / _YAW_DRIFT)) * wrap(_NATURAL_YAW - yaw_before)
    sine = np.hypot(frames[..., 0, 2], frames[..., 1, 2])
    seen = -_MIRROR * np.arctan2(_MIRROR * frames[..., 0, 2], -_MIRROR * frames[..., 1, 2])
    turn = wrap(seen - yaw_before)
    # The same arm has an opposite yaw with negative pitch. Taken is what is nearer to the yaw before, and to the middle
    # of its natural range: an arm that swings past the body keeps its yaw.
    far = np.abs(turn) + _NATURALNESS * np.abs(wrap(seen - _NATURAL_YAW)) > 0.5 * np.pi * (1.0 + _NATURALNESS)
    turn -= (far & (frames[..., 2, 2] > _SWING)) * np.copysign(np.pi, turn)
    yaw = wrap(yaw_before + smooth_step(sine, _HANGING, _RAISED) * turn)
    # Rz(g yaw) frames = Rx(g pitch) Rz(g roll), as far as the yaw allows
    sin, cos = np.sin(_MIRROR * yaw), np.cos(_MIRROR * yaw)
    first = cos[..., None] * frames[..., 0, :] - sin[..., None] * frames[..., 1, :]
    tilt = sin * frames[..., 0, 2] + cos * frames[..., 1, 2]
    pitch = _MIRROR * np.arctan2(-tilt, frames[..., 2, 2])
    pitch = np.where(pitch < -2.0, pitch + 2.0 * np.pi, pitch)
    roll = _MIRROR * np.arctan2(-first[..., 1], first[..., 0])
    return columns(yaw, pitch, roll)


def hip_angles(proximal: np.ndarray, frames: np.ndarray, layout: Layout) -> Tuple[np.ndarray, np.ndarray]:
    """Hip angles (N, 2, 3) rad in slots, and the x axes (N, 2, 3) of the thighs with them.

    proximal: (N, 2, 3) unit directions of the thighs, frames: (N, 2, 3, 3) wanted rotations of the thighs. The paper's
    two joints cannot twist the thigh: its x axis follows from its direction.
    """
    if layout is REP155:
        return _hip_angles_of_three(frames), frames[..., 0]
    flexion = np.arctan2(proximal[..., 0], -proximal[..., 2])
    abduction = _MIRROR * _arcsin(proximal[..., 1])
    axes = columns(np.cos(flexion), _ZERO, np.sin(flexion))
    return columns(flexion, abduction, _ZERO), axes


def _hip_angles_of_three(frames: np.ndarray) -> np.ndarray:
    """Yaw, abduction, flexion (N, 2, 3) rad with frames = Rz(-yaw) Rx(g abduction) Ry(-flexion).

    A yaw beyond its limit is cut first, so that the thigh's direction stays right and only its twist is lost.
    """
    yaw = np.arctan2(frames[..., 0, 1], frames[..., 1, 1])
    yaw = np.minimum(np.maximum(yaw, _YAW_LOWER), _YAW_UPPER)
    sin, cos = np.sin(yaw), np.cos(yaw)
    # Rz(yaw) frames = Rx(g abduction) Ry(-flexion), as far as the yaw allows
    second = sin[..., None] * frames[..., 0, :] + cos[..., None] * frames[..., 1, :]
    tilt = np.arctan2(frames[..., 2, 1], second[..., 1])
    ahead = cos * frames[..., 0, 2] - sin * frames[..., 1, 2]
    upwards = np.cos(tilt) * frames[..., 2, 2] - np.sin(tilt) * second[..., 2]
    return columns(yaw, _MIRROR * tilt, np.arctan2(-ahead, upwards))


def head_angles(rotation: np.ndarray) -> np.ndarray:
    """Roll, yaw, pitch (N, 3) rad of the head with rotation (N, 3, 3) = Rx(roll) Rz(yaw) Ry(-pitch) in the torso."""
    yaw = -_arcsin(rotation[:, 0, 1])
    roll = np.arctan2(rotation[:, 2, 1], rotation[:, 1, 1])
    pitch = -np.arctan2(rotation[:, 0, 2], rotation[:, 0, 0])
    angles = columns(roll, yaw, pitch)
    # a roll beyond 90 degrees is a head turned backwards: the other triple of angles says so
    backwards = np.abs(roll) > 0.5 * np.pi
    if backwards.any():
        other = wrap(np.array([np.pi, np.pi, np.pi]) + angles * np.array([1.0, -1.0, 1.0]))
        angles[backwards] = other[backwards]
    return angles


def head_rotation(points: np.ndarray, known: np.ndarray, template: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) that turn the template's face points (N, 5, 3) to those seen, weighted least squares.

    points: (N, 5, 3) m, 0 where not known (N, 5). Kabsch's solution by singular values; meaningless with fewer than
    three points.
    """
    weights = (known * _FACE_WEIGHTS)[..., None]
    total = np.maximum(np.add.reduce(weights, axis=1, keepdims=True), 1e-9)
    weights = weights / total
    seen = points - np.add.reduce(weights * points, axis=1, keepdims=True)
    model = template - np.add.reduce(weights * template, axis=1, keepdims=True)
    left, _, right = np.linalg.svd((weights * model).transpose(0, 2, 1) @ seen)
    rotation = right.transpose(0, 2, 1) @ left.transpose(0, 2, 1)
    mirrored = np.linalg.det(rotation) < 0.0
    if mirrored.any():
        right[mirrored, 2] *= -1.0
        rotation = right.transpose(0, 2, 1) @ left.transpose(0, 2, 1)
    return rotation
