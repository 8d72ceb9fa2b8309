"""The ground plane of a camera whose mounting is not known: which way is up, and how high it stands, from the people.

A person who stands is an almost vertical line, an upright trunk and a face are roughly vertical, and the feet of people
who stand are at one height. These give pitch and roll of the camera as the weighted least squares of small angles, with
weights that fall for outliers (P. J. Huber, "Robust Estimation of a Location Parameter", 1964). The height follows from
the average person: with the people at one place it is known better than the size of each of them, so that neighbours
show how tall somebody is (A. Criminisi, I. Reid, A. Zisserman, "Single View Metrology", IJCV 2000).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, Optional, Tuple

import numpy as np

from hri_fullbody.core import keypoints as kp
from hri_pipeline.core.geometry import Pose

# Pitch and roll (rad) of a camera that is set up for the image to look upright, with standard deviations; those of the
# line of a person who stands, of the trunk of one who does not, of a face's own up.
_MOUNTING, _MOUNTING_SD = np.radians([8.0, 0.0]), np.radians([15.0, 4.0])
_AXIS_SD = {"standing": math.radians(6.0), "trunk": math.radians(11.0), "face": math.radians(14.0)}
_FADING = math.radians(0.5)     # 1/s: how fast what was seen of a person ages; the camera may turn
_OLDEST_S = 30.0
_LEARN_S = 1.0
_STRAIGHT = math.cos(math.radians(28.0))        # between trunk, thigh and shank of somebody who stands
_BENT = math.cos(math.radians(40.0))            # between thigh and shank of somebody who sits
_SHANK_WEIGHT = 0.35    # trunks differ by some 11 degrees from the vertical, shanks of who sits by some 15
# From the image's own up; a body, farther from it than from that of a steep camera, lies with the feet to it.
_UPRIGHT, _UPRIGHT_BODY = math.cos(math.radians(60.0)), math.cos(math.radians(50.0))
_HUBER = 1.5
_ROUNDS = 4
_ANKLE_HEIGHT_M = 0.07
_SIZE_SD = 0.065            # of the logarithm of statures, and of the network's error
_HEIGHT_NOISE = 0.04
_HEIGHT_RANGE_M = (0.3, 4.0)
_MOST_PEOPLE = 30
_Rows = Tuple[np.ndarray, np.ndarray, np.ndarray]
"""Equations of pitch and roll: gradients (R, 2), values (R,) and their standard deviations (R,)."""


@dataclass
class _Person:
    """What was seen of one person: up directions by kind, with stamps, and the ankles (m, optical frame, average
    size)."""

    stamp: float
    axes: Dict[str, Tuple[np.ndarray, float]] = field(default_factory=dict)
    foot: Optional[np.ndarray] = None


class GroundPlane:
    """Up direction and height of one camera, learnt from the bodies; call `add` for each body, then `solve`."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all people."""
        self._people: Dict[str, _Person] = {}
        self._heights: Dict[str, Tuple[float, float]] = {}
        self.up = up_of(*_MOUNTING)
        """(3,) unit vector against gravity in the optical frame."""
        self.up_sd = float(_MOUNTING_SD[0])
        """Standard deviation of the pitch of `up`, rad."""

    def add(self, body_id: str, points: np.ndarray, confidence: np.ndarray, stamp: float,
            face: Optional[Pose] = None) -> None:
        """Take a body of average size.

        Parameters
        ----------
        points : (18, 3) m in the optical frame, at the average person's size, NaN unknown.
        confidence : (18,) 0 to 1; guessed legs (below 0.5) say nothing.
        stamp : s. face : pose of the own face in the optical frame, x out of the face, z to the scalp.
        """
        person = self._people.setdefault(body_id, _Person(stamp))
        weight = 1.0 - math.exp(-max(stamp - person.stamp, 0.0) / _LEARN_S)
        person.stamp = stamp
        line, foot = _standing(points, confidence)
        if line is not None and -line[1] <= _UPRIGHT_BODY:
            line = foot = None      # stretched out on the ground
        seen = {"standing": line, "trunk": _seated(points, confidence) if line is None else None,
                "face": None if face is None else face.rotation[:, 2]}
        for kind, axis in seen.items():
            if axis is not None and -axis[1] > (_UPRIGHT if kind == "face" else _UPRIGHT_BODY):
                old = person.axes.get(kind, (axis, stamp))[0]
                person.axes[kind] = old + weight * (axis - old), stamp
        if foot is not None:
            person.foot = foot if person.foot is None else person.foot + weight * (foot - person.foot)

    def solve(self, stamp: float) -> None:
        """Estimate `up` and the camera's height at `stamp` (s)."""
        self._people = {name: person for name, person in self._people.items() if stamp - person.stamp < _OLDEST_S}
        state, prior = _MOUNTING, _MOUNTING_SD ** -2.0
        (axes, sds), feet = self._axis_angles(stamp), self._feet()
        for _ in range(_ROUNDS):
            # The angles that an axis tells are pitch and roll themselves.
            weights = _huber(axes - state, sds)
            (a, d), (u, v) = (prior + weights.sum(axis=0)).tolist(), (
                prior * _MOUNTING + (weights * axes).sum(axis=0)).tolist()
            b = 0.0
            if len(feet) > 1:
                gradients, values, floor_sds = _floor_rows(feet, state)
                weighted = gradients.T * _huber(values - gradients @ state, floor_sds)
                (aa, b), (_, dd) = (weighted @ gradients).tolist()
                uu, vv = (weighted @ values).tolist()
                a, d, u, v = a + aa, d + dd, u + uu, v + vv
            determinant = a * d - b * b
            state = np.array([d * u - b * v, a * v - b * u]) / determinant
        self.up = up_of(*state.tolist())
        self.up_sd = math.sqrt(d / determinant)
        self._measure_heights()

    def camera_height(self, body_id: str) -> Optional[Tuple[float, float]]:
        """Height (m) of the camera above the floor by everybody else, and the sd of its logarithm; None: nobody."""
        others = [(logarithm, sd ** -2.0) for name, (logarithm, sd) in self._heights.items() if name != body_id]
        if not others:
            return None
        total = sum(weight for _, weight in others)
        return math.exp(sum(weight * value for value, weight in others) / total), math.sqrt(1.0 / total)

    def _axis_angles(self, stamp: float) -> Tuple[np.ndarray, np.ndarray]:
        """Pitch and roll (N, 2) rad that the people's up directions tell, and their sd (N, 1) rad."""
        axes, sds = [], []
        for person in self._people.values():
            for kind, (axis, seen) in person.axes.items():
                # Who was seen to stand tells it better than the same person's trunk.
                if kind != "trunk" or "standing" not in person.axes:
                    axes.append(axis)
                    sds.append(math.hypot(_AXIS_SD[kind], _FADING * (stamp - seen)))
        directions = np.array(axes).reshape(-1, 3)
        x, y, z = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T
        angles = np.stack([np.arctan2(-z, -y), np.arcsin(np.minimum(np.maximum(x, -1.0), 1.0))], axis=1)
        return angles, np.array(sds).reshape(-1, 1)

    def _feet(self) -> np.ndarray:
        """The people's feet (N, 3) m."""
        return np.array([person.foot for person in self._people.values() if person.foot is not None]).reshape(-1, 3)

    def _measure_heights(self) -> None:
        for name, person in self._people.items():
            if person.foot is None:
                continue
            height = _ANKLE_HEIGHT_M - float(person.foot @ self.up)
            if _HEIGHT_RANGE_M[0] < height < _HEIGHT_RANGE_M[1]:
                far = math.hypot(*person.foot.tolist()) * self.up_sd / height
                self._heights.pop(name, None)
                self._heights[name] = math.log(height), math.sqrt(_SIZE_SD ** 2 + _HEIGHT_NOISE ** 2 + far ** 2)
        while len(self._heights) > _MOST_PEOPLE:
            del self._heights[next(iter(self._heights))]


def _huber(errors: np.ndarray, sds: np.ndarray) -> np.ndarray:
    """Weights of rows with these errors and standard deviations: those of outliers fall."""
    return np.minimum(1.0, _HUBER / np.maximum(np.abs(errors) / sds, 1e-9)) / sds ** 2


def _floor_rows(feet: np.ndarray, state: np.ndarray) -> _Rows:
    """Rows of the feet (N, 3) m, which are at one height, about pitch and roll (2,): one for each but the last."""
    pitch, roll = state.tolist()
    up = up_of(pitch, roll)
    by_pitch = np.array([0.0, math.cos(roll) * math.sin(pitch), -math.cos(roll) * math.cos(pitch)])
    by_roll = np.array([math.cos(roll), math.sin(roll) * math.cos(pitch), math.sin(roll) * math.sin(pitch)])
    offsets = (feet - feet.sum(axis=0) / len(feet))[:-1]
    gradients = offsets @ np.stack([by_pitch, by_roll], axis=1)
    sds = np.hypot(_SIZE_SD * np.abs(feet[:-1] @ up), 0.05)
    # Linear about the state: the residual that would be 0 at the right angles.
    return gradients, gradients @ state - offsets @ up, sds


def up_of(pitch: float, roll: float) -> np.ndarray:
    """Up (3,) in the optical frame of a camera that looks down by `pitch` and is turned by `roll`, rad."""
    return np.array([math.sin(roll), -math.cos(roll) * math.cos(pitch), -math.cos(roll) * math.sin(pitch)])


def _trunk(points: np.ndarray) -> Optional[np.ndarray]:
    """Direction (3,) from the middle of the hips to the neck, None while it is not known."""
    return _unit(points[kp.NECK] - 0.5 * (points[kp.LEFT_HIP] + points[kp.RIGHT_HIP]))


def _seated(points: np.ndarray, confidence: np.ndarray) -> Optional[np.ndarray]:
    """Up (3,) of a body that does not stand: its trunk, with both knees bent between trunk and shanks.

    Who sits leans back with the feet before the seat, or leans forward with the feet below it: the two make up for each
    other.
    """
    trunk = _trunk(points)
    thighs = [_unit(points[hip] - points[hip + 1]) for hip in (kp.LEFT_HIP, kp.RIGHT_HIP)]
    shanks = [_unit(points[hip + 1] - points[hip + 2]) for hip in (kp.LEFT_HIP, kp.RIGHT_HIP)]
    legs = [hip + joint for hip in (kp.LEFT_HIP, kp.RIGHT_HIP) for joint in (1, 2)]
    if trunk is None or confidence[legs].min() < 0.5 or any(
            thigh is None or shank is None or not float(thigh @ shank) < _BENT for thigh, shank in zip(thighs, shanks)):
        return trunk
    shank = _unit(np.sum([shank for shank in shanks if shank is not None], axis=0))
    return trunk if shank is None or shank[1] > 0.0 else _unit((1.0 - _SHANK_WEIGHT) * trunk + _SHANK_WEIGHT * shank)


def _standing(points: np.ndarray, confidence: np.ndarray) -> Tuple[Optional[np.ndarray], Optional[np.ndarray]]:
    """Up (3,) of a body whose trunk and legs are in one line, from ankles to neck, and the middle of its ankles."""
    trunk = _trunk(points)
    if trunk is None:
        return None, None
    ankles = []
    for hip in (kp.LEFT_HIP, kp.RIGHT_HIP):
        if confidence[hip + 1:hip + 3].min() < 0.5:
            continue
        thigh, shank = _unit(points[hip] - points[hip + 1]), _unit(points[hip + 1] - points[hip + 2])
        if thigh is None or shank is None:
            continue
        if min(float(thigh @ trunk), float(shank @ thigh)) < _STRAIGHT:
            return None, None
        ankles.append(points[hip + 2])
    if len(ankles) < 2:
        return None, None
    foot = np.mean(ankles, axis=0)
    return _unit(points[kp.NECK] - foot), foot


def _unit(vector: np.ndarray) -> Optional[np.ndarray]:
    length = float(vector @ vector) ** 0.5
    return vector / length if length > 1e-6 else None
