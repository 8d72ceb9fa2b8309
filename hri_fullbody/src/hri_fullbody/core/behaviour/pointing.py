"""Pointing: the ray from the eyes through the hand of an arm that is stretched out and held still, and what it meets.

People aim with the eye over the hand rather than along the arm (K. Nickel, R. Stiefelhagen, "Visual Recognition of
Pointing Gestures for Human-Robot Interaction", Image and Vision Computing 25, 2007). Lengths are in statures.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Deque, List, Mapping, Optional, Tuple

import numpy as np

from hri_fullbody.core import keypoints as kp
from hri_fullbody.core.behaviour.arms import dot, length, minus
from hri_pipeline.core.image_rotation import ImageRotation

_ARMS = ((kp.LEFT_SHOULDER, kp.LEFT_ELBOW, kp.LEFT_WRIST), (kp.RIGHT_SHOULDER, kp.RIGHT_ELBOW, kp.RIGHT_WRIST))
_STRAIGHT = math.cos(math.radians(35.0))    # between upper arm and forearm
_FROM_TRUNK = math.cos(math.radians(45.0))  # between arm and straight down: an arm that hangs points at nothing
_STEEPEST = math.cos(math.radians(40.0))    # between arm and straight up: one that is raised neither
_HAND = 0.108       # Drillis and Contini 1966
# The ray has not turned by more than this, rad, between the halves of this time, s.
_STILL, _HOLD_S = math.radians(6.0), 0.5
_LEAST_SAMPLES, _LEAST_SHARE = 4, 0.8
# Time that so many samples of a slow camera may take, by the least time between two of them: what was seen before a gap
# of a fast one is no part of it.
_LONGEST_HOLD_S, _HOLD_STEPS = 1.0, 4.5
_WIDEST = math.radians(9.0)     # between the ray and a person who is meant
# Standard deviation of that, and how likely it is that nobody is meant, against somebody right on the ray.
_RAY_SD, _NOBODY = math.radians(5.0), 0.2
_FARTHEST_M = 10.0
_FLATTEST = math.sin(math.radians(6.0))     # of a ray to the floor: a flatter one meets it anywhere


@dataclass(frozen=True)
class Pointing:
    """One body points.

    origin: (3,) m, between the eyes; direction: (3,) unit, both in the optical frame. confidence: 0 to 1.
    receiver: id of the body that is pointed at, empty for none. place: (3,) m where the ray ends, on the body or the
    floor; None when it meets neither.
    """

    origin: np.ndarray
    direction: np.ndarray
    confidence: float
    receiver: str = ""
    place: Optional[np.ndarray] = None


def turned_pointing(pointing: Pointing, rotation: ImageRotation) -> Pointing:
    """Return the same in the turned optical frame."""
    return replace(pointing, origin=rotation.vectors(pointing.origin), direction=rotation.vectors(pointing.direction),
                   place=None if pointing.place is None else rotation.vectors(pointing.place))


class PointingEstimator:
    """The pointing of one body over time."""

    def __init__(self) -> None:
        self._rays: Tuple[Deque[Tuple[float, Optional[np.ndarray]]], ...] = (deque(), deque())

    def update(self, points: np.ndarray, stature: float, stamp: float, up: np.ndarray) -> Optional[Pointing]:
        """Take one image; return the ray of the stiller stretched arm, None when there is none.

        points: (18, 3) m in the optical frame, NaN unknown. stature: m. stamp: s, rising. up: (3,) unit vector against
        gravity.
        """
        best: Optional[Pointing] = None
        for rays, arm in zip(self._rays, _ARMS):
            ray = _ray(points, arm, stature, up)
            while rays and not 0.0 <= stamp - rays[0][0] <= self._longest([at for at, _ in rays], stamp) + 1e-6:
                rays.popleft()
            rays.append((stamp, None if ray is None else ray[1]))
            if ray is None:
                continue
            found = self._held(ray[0], rays)
            if found is not None and (best is None or found.confidence > best.confidence):
                best = found
        return best

    @staticmethod
    def _longest(stamps: List[float], stamp: float) -> float:
        """Return for how long (s) rays of these stamps count at a later one."""
        if len(stamps) >= _LEAST_SAMPLES:
            return _HOLD_S
        step = min(after - before for before, after in zip(stamps, [*stamps[1:], stamp]))
        return min(max(_HOLD_S, _HOLD_STEPS * step), _LONGEST_HOLD_S)

    @staticmethod
    def _held(origin: np.ndarray, rays: Deque[Tuple[float, Optional[np.ndarray]]]) -> Optional[Pointing]:
        if len(rays) < _LEAST_SAMPLES or rays[-1][0] - rays[0][0] < 0.8 * _HOLD_S:
            return None
        directions = np.array([direction for _, direction in rays if direction is not None])
        if len(directions) < _LEAST_SHARE * len(rays):
            return None
        half = len(directions) // 2
        turned = _angle(directions[:half].mean(axis=0), directions[half:].mean(axis=0))
        if turned > _STILL:
            return None
        mean = directions.mean(axis=0)
        return Pointing(origin, mean / np.linalg.norm(mean), 1.0 - 0.5 * turned / _STILL)


def aim(pointing: Pointing, others: Mapping[str, np.ndarray], up: np.ndarray,
        camera_height: Optional[float]) -> Pointing:
    """Tell what the ray meets: the body nearest to it, else the floor.

    others: key points (18, 3) m of the other bodies by id. up: (3,) unit vector against gravity. camera_height: m
    above the floor, None unknown.
    Result: its confidence that a body is meant is the share of that one's likelihood in those of all and of nobody.
    """
    best, angle, likely = None, _WIDEST, _NOBODY
    for body_id, points in others.items():
        nearest = math.inf
        for place in _trunk_and_head(points):
            apart = _angle(place - pointing.origin, pointing.direction)
            nearest = min(nearest, apart)
            if apart < angle:
                best, angle = (body_id, place), apart
        likely += _likelihood(nearest)
    if best is not None:
        far = float(np.linalg.norm(best[1] - pointing.origin))
        return Pointing(pointing.origin, pointing.direction, _likelihood(angle) / likely,
                        best[0], pointing.origin + far * pointing.direction)
    slope = -float(pointing.direction @ up)
    if camera_height is None or slope < _FLATTEST:
        return pointing
    far = (camera_height + float(pointing.origin @ up)) / slope
    if not 0.0 < far < _FARTHEST_M:
        return pointing
    return Pointing(pointing.origin, pointing.direction, pointing.confidence,
                    place=pointing.origin + far * pointing.direction)


def _likelihood(angle: float) -> float:
    """Likelihood of an angle (rad) between the ray and whom it means, 1 for none."""
    return math.exp(-0.5 * (angle / _RAY_SD) ** 2)


def _ray(points: np.ndarray, arm: Tuple[int, int, int], stature: float,
         up: np.ndarray) -> Optional[Tuple[np.ndarray, np.ndarray]]:
    """Eyes (3,) m and direction (3,) of a stretched arm that neither hangs nor is raised; None for any other."""
    shoulder, elbow, wrist = (points[index].tolist() for index in arm)
    upper, lower, whole = minus(elbow, shoulder), minus(wrist, elbow), minus(wrist, shoulder)
    lengths = [length(part) for part in (upper, lower, whole)]
    if not min(lengths) > 0.05 * stature:
        return None
    down = -dot(whole, up.tolist()) / lengths[2]
    if dot(upper, lower) < _STRAIGHT * lengths[0] * lengths[1] or not -_STEEPEST < down < _FROM_TRUNK:
        return None
    eyes = 0.5 * (points[kp.LEFT_EYE] + points[kp.RIGHT_EYE])
    if not math.isfinite(eyes[0]):
        eyes = points[kp.NOSE]
    if not math.isfinite(eyes[0]):
        return None
    direction = points[arm[2]] + _HAND * stature / lengths[1] * np.array(lower) - eyes
    return eyes, direction / float(direction @ direction) ** 0.5


def _trunk_and_head(points: np.ndarray) -> np.ndarray:
    """Some places (N, 3) m of a body that are meant when somebody points at it."""
    hips = 0.5 * (points[kp.LEFT_HIP] + points[kp.RIGHT_HIP])
    places = np.array([points[kp.NOSE], points[kp.NECK], 0.5 * (points[kp.NECK] + hips), hips])
    return places[np.isfinite(places[:, 0])]


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    lengths = float(np.linalg.norm(a) * np.linalg.norm(b))
    return math.acos(max(-1.0, min(1.0, float(a @ b) / lengths))) if lengths > 1e-9 else math.pi
