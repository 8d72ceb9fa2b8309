"""How large a person's head is, over the canonical one: prior, iris, depth image and stature put together.

A pose from points alone fixes the direction of a head and the ratio of its size to its distance, not the distance. Each
source says what the size is, with an error that stays with the person however often it is measured, and a noise that
averages out. All is Gaussian in the logarithm of the size.
"""

from __future__ import annotations

import math
from typing import Dict, NamedTuple, Optional, Tuple

import numpy as np

from hri_pipeline.core.faces.eyes import IRIS_DIAMETER, EyeGeometry
from hri_pipeline.core.geometry import Pose

PRIOR_SD = 0.055
"""Relative standard deviation of the size of adults' heads (pupils apart: 62 and 64 mm, 5.5 %, ANSUR II 2012)."""
IRIS_BIAS = 0.91
"""Distance from the iris over that from the head, median of 36 open-eyed faces in portraits: the network's rim of the
iris lies outside the visible one."""
LEAST_IRIS = 8.0
"""Diameter (px) of the iris from which it tells the size."""
MAX_IRIS_TURN = math.radians(40.0)
SOURCES = ("iris", "depth", "stature")
_LEAST, _MOST = 0.75, 1.25
_WINDOW = 60.0
"""Weight (measurements) at which old ones begin to be forgotten."""
_SETTLING_TIME = 1.0
"""Time constant (s) with which a changed size is taken over: a head does not jump."""


class _Error(NamedTuple):
    """Relative standard deviations: what stays with the person, and what averages out."""

    lasting: float
    noise: float


_ERRORS = {
    # Iris: 0.5 of 11.7 mm between people, and the network's rim; together with the prior they make the 6 % seen.
    "iris": _Error(0.05, 0.05),
    # Depth camera: 1 to 2 % of the distance, and the difference between the surface and the model's.
    "depth": _Error(0.015, 0.03),
    # Stature explains little of the size of adults' heads, more of children's.
    "stature": _Error(0.045, 0.0),
}


class HeadScale:
    """Size of one head over the canonical one, slowly following what is measured."""

    def __init__(self) -> None:
        self._sums: Dict[str, Tuple[float, float]] = {}
        self._value: Optional[float] = None
        self._stamp = -math.inf

    def add(self, source: str, scale: float) -> None:
        """Take a measured size over the canonical one; one that is not finite or not of a head is ignored.

        source: one of SOURCES; raises KeyError for another.
        """
        _ERRORS[source]
        if not (math.isfinite(scale) and _LEAST <= scale <= _MOST):
            return
        weight, total = self._sums.get(source, (0.0, 0.0))
        keep = min(1.0, (_WINDOW - 1.0) / weight) if weight > 0.0 else 1.0
        self._sums[source] = (keep * weight + 1.0, keep * total + math.log(scale))

    def estimate(self, stamp: float) -> Tuple[float, float]:
        """Return the size and its standard deviation at `stamp` (s)."""
        information, moment = PRIOR_SD ** -2, 0.0
        for source, (weight, total) in self._sums.items():
            error = _ERRORS[source]
            certain = 1.0 / (error.lasting ** 2 + error.noise ** 2 / weight)
            information += certain
            moment += certain * total / weight
        target = moment / information
        if self._value is None or stamp < self._stamp:
            self._value = target
        else:
            self._value += (1.0 - math.exp(-(stamp - self._stamp) / _SETTLING_TIME)) * (target - self._value)
        self._stamp = stamp
        scale = math.exp(self._value)
        return scale, scale * information ** -0.5


def scale_from_iris(diameters: np.ndarray, pose: Pose, eyes: EyeGeometry, focal: float,
                    from_eyes: float) -> Optional[float]:
    """Return the size of a head by its irises, None where they are too small, closed or turned away.

    diameters: (2,) px; pose: face frame at the canonical size; focal: of the camera, px; from_eyes: that of the gaze,
    0 while the eyes are closed.
    """
    to_camera = -pose.translation / np.linalg.norm(pose.translation)
    if diameters.min() < LEAST_IRIS or from_eyes <= 0.0 or pose.rotation[:, 0] @ to_camera < math.cos(MAX_IRIS_TURN):
        return None
    distance = focal * IRIS_DIAMETER / float(diameters.mean())
    return distance / eyes.depth(pose) / IRIS_BIAS


def scale_from_depth(mesh: np.ndarray, canonical_depths: np.ndarray, indices: np.ndarray,
                     depth: np.ndarray) -> Optional[float]:
    """Return the size of a head by a registered depth image (H, W) m, None where too few pixels know their depth.

    canonical_depths: (N,) m, of the vertices `indices` of the posed canonical face; the median ratio is robust
    against hair and background.
    """
    height, width = depth.shape[:2]
    pixels = np.floor(mesh[indices, :2]).astype(int)
    inside = ((pixels >= 0) & (pixels < (width, height))).all(axis=1)
    if inside.sum() < 8:
        return None
    seen = depth[pixels[inside, 1], pixels[inside, 0]].astype(np.float64)
    known = np.isfinite(seen) & (seen > 0.05)
    if known.sum() < 8:
        return None
    ratios = seen[known] / canonical_depths[inside][known]
    return float(np.median(ratios))


def scale_from_stature(stature: float) -> float:
    """Return the mean size of a head over the canonical one for a stature (m).

    Heads grow little after early childhood: the breadth of a head of 1.1 m (5 years) is 0.93 of that of 1.70 m
    (Farkas 1994), a power of 0.17.
    """
    return (stature / 1.70) ** 0.17
