"""Measures of both arms in the axes of the trunk, from the 18 key points of a body; lengths in statures.

Statures make one set of thresholds fit children and adults. NaN stands for what is not known, and stays NaN.
The arithmetic is that of plain floats: for two arms it takes a fifth of the time that numpy takes.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.keypoints import (
    LEFT_EAR,
    LEFT_ELBOW,
    LEFT_EYE,
    LEFT_HIP,
    LEFT_SHOULDER,
    LEFT_WRIST,
    NECK,
    NOSE,
    RIGHT_EAR,
    RIGHT_ELBOW,
    RIGHT_EYE,
    RIGHT_HIP,
    RIGHT_SHOULDER,
    RIGHT_WRIST,
)

Pair = Tuple[float, float]
Vector = Sequence[float]

# Shoulder, elbow, wrist, the other elbow, and the sign of outward along the trunk's left axis: left, right.
_ARMS = ((LEFT_SHOULDER, LEFT_ELBOW, LEFT_WRIST, RIGHT_ELBOW, 1.0),
         (RIGHT_SHOULDER, RIGHT_ELBOW, RIGHT_WRIST, LEFT_ELBOW, -1.0))
_FRONT, _EARS = (NOSE, LEFT_EYE, RIGHT_EYE), (LEFT_EAR, RIGHT_EAR)
# From each of them to the middle of the places that hands touch, between chin and forehead a little under the skin of
# the nose, along the trunk's axes (forward, left, up), in statures: of the head template of the human model.
_TO_FACE_MIDDLE = {
    NOSE: (-0.009, 0.0, -0.010), LEFT_EYE: (0.007, -0.0185, -0.036), RIGHT_EYE: (0.007, 0.0185, -0.036),
    LEFT_EAR: (0.060, -0.0426, -0.026), RIGHT_EAR: (0.060, 0.0426, -0.026)}
# The fingers' middle joints are half a hand (0.108 statures: Drillis and Contini 1966) beyond the wrist; a little more
# is taken, as hands reach out when they touch.
_HAND_LENGTH = 0.075
_SEEN_HAND_LENGTH = 0.095       # where the direction of the hand is seen, the fingers count
# Hands that touch the face are guessed up to .17 statures nearer to one camera than it, others are .13 and more beside
# it: of a distance along the view, half counts where depth is guessed.
GUESSED_DEPTH = 0.5
# A hand on a shoulder, at the collar or at the strap of a bag has its fingers or its wrist as near to the face as one
# under the chin, but not all of it: of the distance, this part is that of the middle of the hand, the rest the least.
# And it is below and beside the face at once: this part of both together is a distance, too, as faces are egg-shaped.
_WHOLE_HAND, _BELOW_AND_BESIDE = 0.5, 0.75
_MIN_LENGTH_M = 1e-6
_NAN3 = (math.nan, math.nan, math.nan)


class ArmFeatures(NamedTuple):
    """Measures of the arms, each for the left and the right one.

    rise: wrist above its shoulder along gravity, statures. rise_trunk: the same along the trunk.
    above_elbow: wrist above its elbow along gravity, statures.
    to_face: distance from the hand to the middle of the face, statures: of the hand's nearest place and of its middle.
    forward: wrist in front of the shoulder line along the trunk's forward axis, statures.
    outward: wrist left (left arm) or right (right arm) of the mid-plane of the trunk, statures; negative beyond it.
    level: wrist above the shoulder line along the trunk, statures.
    elbow: angle between upper arm and forearm, rad; pi for a straight arm.
    to_other_elbow: wrist to the elbow of the other arm, statures.
    lateral, ahead: wrist from its elbow along the trunk's left and forward axes, statures.
    """

    rise: Pair
    rise_trunk: Pair
    above_elbow: Pair
    to_face: Pair
    forward: Pair
    outward: Pair
    level: Pair
    elbow: Pair
    to_other_elbow: Pair
    lateral: Pair
    ahead: Pair


def trunk_axes(points: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Return the axes of the trunk as rows (forward, left, to the head), (3, 3); NaN when they are not known.

    points: (18, 3) m. up: unit vector against gravity, which stands for the spine while a hip is not known.
    The hips give the left axis while a shoulder is not known.
    """
    left = points[LEFT_SHOULDER] - points[RIGHT_SHOULDER]
    spine = points[NECK] - 0.5 * (points[LEFT_HIP] + points[RIGHT_HIP])
    if not np.isfinite(left[0]):
        left = points[LEFT_HIP] - points[RIGHT_HIP]
    else:
        spine = 0.5 * (points[LEFT_SHOULDER] + points[RIGHT_SHOULDER]) - 0.5 * (points[LEFT_HIP] + points[RIGHT_HIP])
    if not np.isfinite(spine[0]):
        spine = up
    left = _unit(left)
    spine = _unit(spine - (spine @ left) * left)
    return np.array([_cross(left, spine), left, spine])


def face_middle(rows: Sequence[Vector], axes: Sequence[Vector], stature: float) -> Vector:
    """Return the middle of the face (3) m from nose and eyes, else from the ears; NaN when all are missing.

    rows: 18 points of 3 coordinates, m, NaN unknown. axes: trunk_axes of them as lists. stature: m.
    """
    for group in (_FRONT, _EARS):
        known = [index for index in group if rows[index][0] == rows[index][0]]
        if known:
            break
    else:
        return _NAN3
    ahead, left, high = (sum(_TO_FACE_MIDDLE[index][axis] for index in known) * stature for axis in range(3))
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = axes
    return ((sum(rows[index][0] for index in known) + ahead * ax + left * bx + high * cx) / len(known),
            (sum(rows[index][1] for index in known) + ahead * ay + left * by + high * cy) / len(known),
            (sum(rows[index][2] for index in known) + ahead * az + left * bz + high * cz) / len(known))


def arm_features(points: np.ndarray, stature: float, up: np.ndarray, axes: Optional[np.ndarray] = None,
                 hands: Optional[np.ndarray] = None, depth_counts: float = 1.0) -> ArmFeatures:
    """Measure the arms of a body.

    points: (18, 3) m in the sensor's frame, NaN unknown. stature: m, positive. up: (3,) unit vector against gravity in
    the same frame. axes: trunk_axes of the points, when they are known already.
    hands: (2, 3) m from the wrist to the knuckles, left and right, NaN unknown; None: none is.
    depth_counts: part of the distance from hand to face along the view that counts, see GUESSED_DEPTH.
    """
    rows: List[List[float]] = points.tolist()
    trunk = (trunk_axes(points, up) if axes is None else axes).tolist()
    vertical = up.tolist()
    middle = [0.5 * (a + b) for a, b in zip(rows[LEFT_SHOULDER], rows[RIGHT_SHOULDER])]
    if middle[0] != middle[0]:
        middle = rows[NECK]
    face = face_middle(rows, trunk, stature)
    knuckles = [_NAN3, _NAN3] if hands is None else hands.tolist()
    away = length(face)
    lost = math.sqrt(1.0 - depth_counts) / away if away > 0.0 else 0.0
    left, right = (_one_arm([*(rows[index] for index in arm[:4]), hand], arm[4], middle,
                            (face, [lost * value for value in face]), trunk, vertical, stature)
                   for arm, hand in zip(_ARMS, knuckles))
    return ArmFeatures(*zip(left, right))


def _one_arm(places: Sequence[Vector], sign: float, middle: Vector, face: Tuple[Vector, Vector],
             trunk: Sequence[Vector], up: Vector, stature: float) -> Tuple[float, ...]:
    """The values of ArmFeatures, in its order, of one arm: shoulder, elbow, wrist, other elbow, wrist to
    knuckles.

    face: its middle, and the direction of which a vector's part is taken off by its squared length.
    """
    shoulder, elbow, wrist, other_elbow, knuckles = places
    reach, forearm, from_middle = minus(wrist, shoulder), minus(wrist, elbow), minus(wrist, middle)
    forward, left, high = trunk
    along, hand = (forearm, _HAND_LENGTH) if knuckles[0] != knuckles[0] else (knuckles, _SEEN_HAND_LENGTH)
    return (
        dot(reach, up) / stature, dot(reach, high) / stature, dot(forearm, up) / stature,
        _hand_to_face(_flat(minus(face[0], wrist), face[1]), _flat(along, face[1]), hand * stature, trunk) / stature,
        dot(from_middle, forward) / stature, sign * dot(from_middle, left) / stature,
        dot(from_middle, high) / stature, _angle(minus(shoulder, elbow), forearm),
        length(minus(wrist, other_elbow)) / stature, dot(forearm, left) / stature, dot(forearm, forward) / stature)


def _flat(vector: Vector, lost: Vector) -> Vector:
    part = dot(vector, lost)
    return [value - part * axis for value, axis in zip(vector, lost)]


def _hand_to_face(to_face: Vector, along_hand: Vector, hand: float, trunk: Sequence[Vector]) -> float:
    """Distance (m) of the middle of the face to a hand: partly the least to the line from the wrist to the fingers,
    partly that to the middle of this line, see _WHOLE_HAND.

    to_face: from the wrist. along_hand: direction of the hand: that of its knuckles, else of the forearm; with neither
    the wrist alone counts. hand: its length, m. trunk: its axes.
    """
    reach = length(along_hand)
    least = middle = to_face
    if reach > _MIN_LENGTH_M:
        along = dot(to_face, along_hand) / reach
        nearest = 0.0 if along < 0.0 else min(along, hand)
        least, middle = (minus(to_face, [place / reach * value for value in along_hand])
                         for place in (nearest, 0.5 * hand))
    below_and_beside = max(0.0, dot(middle, trunk[2])) + abs(dot(middle, trunk[1]))
    return max((1.0 - _WHOLE_HAND) * length(least) + _WHOLE_HAND * length(middle),
               _BELOW_AND_BESIDE * below_and_beside)


def _unit(vector: np.ndarray) -> np.ndarray:
    length = float(vector @ vector) ** 0.5
    return vector / length if length > _MIN_LENGTH_M else np.full(3, np.nan)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product; much faster than numpy's for two single vectors."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b of two vectors (3)."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product of two vectors (3)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(vector: Vector) -> float:
    """Return the length of a vector (3), NaN for NaN."""
    return math.sqrt(dot(vector, vector))


def _angle(a: Vector, b: Vector) -> float:
    lengths = length(a) * length(b)
    if not lengths > _MIN_LENGTH_M ** 2:
        return math.nan
    return math.acos(min(1.0, max(-1.0, dot(a, b) / lengths)))
