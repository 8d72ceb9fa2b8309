"""How large a body is and how far away: the network's landmarks are those of a person of average height."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Optional, Tuple

import numpy as np

from hri_fullbody.core.skeleton import BLAZE_INNER_EYES, BLAZE_LEFT_ANKLE, BLAZE_RIGHT_ANKLE
from hri_pipeline.core.geometry import Pose

FLOOR_RANGE = (0.75, 1.3)
"""Ratios of a body's size to the average for which a foot is believed to stand on the floor."""
_FACE_RANGE = (0.7, 1.3)
_DEPTH_RANGE = (0.55, 1.35)
# Beyond their range a face and a depth image still tell where the body is, but the landmarks are too wrong for a scale.
_PLACE_RANGE = (0.4, 2.5)
_STATURE_CV = 0.065         # of adults and of the network's own error, the two together
_DRIFT = 0.01               # per root second: how fast the scale may change
_FACE_SD, _FLOOR_SD, _DEPTH_SD = 0.04, 0.05, 0.03
# The distance of a face is wrong by as much as its size differs from the average one's (about 6 % with the error of the
# landmarks), as long as one looks: as far as statures differ. So half of what a face says is taken for the body's size.
_FACE_TRUST = 0.5
_OUTLIER = 3.0              # standard deviations: what differs by more counts as this much
_ANKLE_HEIGHT = 0.07        # m, centre of the ankle above the floor
_LEAST_SLOPE = 0.05         # of the ray to the ankle: a flatter one meets the floor anywhere
_FLOOR_SIGHTS = 45


@dataclass(frozen=True)
class Cue:
    """A measurement of how many times farther away (and larger) a body is than its landmarks say.

    sd: standard deviation of its logarithm, inf when it says nothing about the size. reference: the point (3,) m of
    the landmarks that was measured; it is the one that must lie on its ray. trust: part of
    the ratio's logarithm that is due to the size of the body, the rest to a lasting error of the measurement.

    exact: the body is to be at this distance now, not only to be scaled by it in the long run.
    """

    ratio: float
    sd: float
    exact: bool
    reference: np.ndarray
    trust: float = 1.0


def face_cue(points: np.ndarray, face: Optional[Pose]) -> Optional[Cue]:
    """Cue of the tracked face's pose: the sellion of `points` (33, 3) m must be at the depth of the face's origin."""
    if face is None or not np.all(np.isfinite(face.translation)):
        return None
    sellion = points[list(BLAZE_INNER_EYES)].mean(axis=0)
    return _cue(float(face.translation[2]) / max(float(sellion[2]), 1e-3), _FACE_SD, _FACE_RANGE, sellion,
                _FACE_TRUST)


def depth_cue(ratio: Optional[float], trunk: np.ndarray) -> Optional[Cue]:
    """Cue of a depth image, see body_depth.trunk_ratio. trunk: its middle (3,) m."""
    return None if ratio is None else _cue(ratio, _DEPTH_SD, _DEPTH_RANGE, trunk)


def floor_ratio(points: np.ndarray, rays: np.ndarray, confidence: np.ndarray, up: np.ndarray,
                camera_height: float) -> Optional[float]:
    """Ratio of the depth at which the standing foot meets the floor to that of `points` (33, 3) m.

    rays: (33, 2). up: (3,) unit, away from the floor, in the optical frame. camera_height: m above the floor.
    Of two ankles the one whose ray meets the floor nearer is on it; a lifted one seems to be farther away.
    """
    best = None
    for ankle in (BLAZE_LEFT_ANKLE, BLAZE_RIGHT_ANKLE):
        slope = -float(np.array([rays[ankle, 0], rays[ankle, 1], 1.0]) @ up)
        if confidence[ankle] > 0.5 and slope > _LEAST_SLOPE and points[ankle, 2] > 0.1:
            depth = (camera_height - _ANKLE_HEIGHT) / slope
            best = min(best or (np.inf, 0.0), (depth, depth / points[ankle, 2]))
    if best is None or not FLOOR_RANGE[0] < best[1] < FLOOR_RANGE[1]:
        return None
    return best[1]


class BodyScale:
    """Scale of one body: a slowly changing number learnt from its cues, kept while there are none."""

    def __init__(self) -> None:
        self._log, self._variance = 0.0, _STATURE_CV ** 2
        self._stamp: Optional[float] = None
        self._floor: Deque[float] = deque(maxlen=_FLOOR_SIGHTS)

    @property
    def value(self) -> float:
        """Size of the body, that of the network's average person being 1."""
        return math.exp(self._log)

    def floor_cue(self, ratio: Optional[float]) -> Optional[Cue]:
        """Cue of the floor: the median of what was seen of it, with `ratio` when it is not None."""
        if ratio is None:
            return None
        self._floor.append(ratio)
        return Cue(float(np.median(self._floor)), _FLOOR_SD, False, np.zeros(3))

    def update(self, cue: Optional[Cue], stamp: float) -> None:
        """Learn from a cue at `stamp` (s)."""
        if cue is None:
            return
        step = 0.0 if self._stamp is None else max(0.0, stamp - self._stamp)
        self._stamp = stamp
        variance = min(self._variance + _DRIFT ** 2 * step, _STATURE_CV ** 2)
        gain = variance / (variance + cue.sd ** 2)
        limit = _OUTLIER * math.sqrt(variance + min(cue.sd, 1.0) ** 2)
        self._log += gain * min(max(cue.trust * math.log(cue.ratio) - self._log, -limit), limit)
        self._variance = (1.0 - gain) * variance


def _cue(ratio: float, sd: float, limits: Tuple[float, float], reference: np.ndarray,
         trust: float = 1.0) -> Optional[Cue]:
    if limits[0] < ratio < limits[1]:
        return Cue(ratio, sd, True, reference, trust)
    return Cue(ratio, math.inf, True, reference) if _PLACE_RANGE[0] < ratio < _PLACE_RANGE[1] else None
