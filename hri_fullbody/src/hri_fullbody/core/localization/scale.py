"""How large a body is against the average, by what is measured of it: face, depth image, floor.

A body that is larger than its landmarks say is farther away by the same ratio.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Dict, Optional, Tuple

import numpy as np

from hri_fullbody.core.keypoints import (
    BLAZE_INNER_EYES,
    BLAZE_LEFT_ANKLE,
    BLAZE_LEFT_HIP,
    BLAZE_LEFT_SHOULDER,
    BLAZE_RIGHT_ANKLE,
    BLAZE_RIGHT_HIP,
    BLAZE_RIGHT_SHOULDER,
)
from hri_pipeline.core.geometry import Pose, median_of_few
from hri_pipeline.core.images import sample_depth

TRUNK = np.array([BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER, BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP])
"""Landmarks of the trunk."""
# Each trunk joint is sampled a part of the way to the middle of the trunk: at the rim the background shows through.
_INSET = 0.2
_TRUNK_BEHIND = 0.10
_LEAST_TRUNK = 2
_LARGEST_SPREAD = 0.25
FLOOR_RANGE = (0.75, 1.3)
"""Ratios of a body's size to the average for which a foot is believed to stand on the floor."""
_FACE_RANGE = (0.7, 1.3)
_DEPTH_RANGE = (0.55, 1.35)
# Beyond their range a face and a depth image still tell where the body is, but the landmarks are too wrong for a scale.
_PLACE_RANGE = (0.4, 2.5)
_STATURE_CV = 0.065         # of adults and of the network's own error, the two together
# What a cue says of the size: standard deviation of one measurement, and of the error that stays. The distance of a
# face is wrong by as much as its size differs from the average one's (about 6 % with the error of the landmarks): as
# much as statures differ. So half of what a face says is taken for the body's size.
_FACE_SD, _FLOOR_SD, _DEPTH_SD = (0.04, 0.065), (0.05, 0.025), (0.03, 0.01)
_MOST_IMAGES, _CORRELATED = 150, 5.0
_OUTLIER = 3.0              # standard deviations: what differs by more counts as this much
_ANKLE_HEIGHT = 0.07        # m, centre of the ankle above the floor
_LEAST_SLOPE = 0.05         # of the ray to the ankle: a flatter one meets the floor anywhere
_FLOOR_SIGHTS = 45


@dataclass(frozen=True)
class ScaleCue:
    """A measurement of how many times farther away (and larger) a body is than its landmarks say.

    sd: standard deviation of its logarithm in one image, inf when it says nothing about the size. lasting_sd: of the
    error that all images share. reference: the point (3,) m of the landmarks that was measured; it is the one that must
    lie on its ray.
    """

    source: str
    ratio: float
    sd: float
    lasting_sd: float
    reference: np.ndarray


def face_cue(points: np.ndarray, face: Optional[Pose]) -> Optional[ScaleCue]:
    """Cue of the tracked face's pose: the sellion of `points` (33, 3) m must be at the depth of the face's origin."""
    if face is None or not np.all(np.isfinite(face.translation)):
        return None
    left, right = BLAZE_INNER_EYES
    sellion = 0.5 * (points[left] + points[right])
    return _cue("face", float(face.translation[2]) / max(float(sellion[2]), 1e-3), _FACE_SD, _FACE_RANGE, sellion)


def depth_cue(ratio: Optional[float], trunk: np.ndarray) -> Optional[ScaleCue]:
    """Cue of a depth image, see trunk_ratio. trunk: its middle (3,) m."""
    return None if ratio is None else _cue("depth", ratio, _DEPTH_SD, _DEPTH_RANGE, trunk)


def floor_ratio(points: np.ndarray, rays: np.ndarray, confidence: np.ndarray, up: np.ndarray,
                camera_height: float) -> Optional[float]:
    """Ratio of the depth at which the standing foot meets the floor to that of `points` (33, 3) m.

    rays: (33, 2). up: (3,) unit, away from the floor, in the optical frame. camera_height: m above the floor.
    Of two ankles the one whose ray meets the floor nearer is on it; a lifted one seems to be farther away.
    """
    best = None
    for ankle in (BLAZE_LEFT_ANKLE, BLAZE_RIGHT_ANKLE):
        slope = -(rays[ankle, 0] * up[0] + rays[ankle, 1] * up[1] + up[2])
        if confidence[ankle] > 0.5 and slope > _LEAST_SLOPE and points[ankle, 2] > 0.1:
            depth = (camera_height - _ANKLE_HEIGHT) / slope
            best = min(best or (np.inf, 0.0), (depth, depth / points[ankle, 2]))
    if best is None or not FLOOR_RANGE[0] < best[1] < FLOOR_RANGE[1]:
        return None
    return float(best[1])


def trunk_ratio(depth: np.ndarray, pixels: np.ndarray, points: np.ndarray, confidence: np.ndarray,
                size: Tuple[int, int]) -> Optional[float]:
    """How many times farther away the trunk is than `points` (33, 3) m say; None when the depth does not tell.

    depth: (h, w) m. pixels: (33, 2) px in the image of `size` (width, height). confidence: (33,) 0 to 1.
    The median of those of shoulders and hips that are seen and lie at one depth.
    """
    middle = pixels[TRUNK].mean(axis=0)
    seen = confidence[TRUNK] > 0.3
    surface = sample_depth(depth, pixels[TRUNK] + _INSET * (middle - pixels[TRUNK]), *size)
    centre = points[TRUNK].mean(axis=0)
    modelled = (points[TRUNK] + _INSET * (centre - points[TRUNK]))[:, 2]
    known = seen & np.isfinite(surface) & (modelled > 0.1)
    if known.sum() < _LEAST_TRUNK:
        return None
    behind = surface[known] + _TRUNK_BEHIND - (modelled[known] - centre[2])
    near = behind[np.abs(behind - np.median(behind)) < _LARGEST_SPREAD]
    return None if len(near) < _LEAST_TRUNK else float(np.median(near) / centre[2])


class BodyScale:
    """Size of one body against the average: the mean of each source's cues, kept while there are none.

    The sources are combined with the spread of statures by their variances, of which that of the lasting error does not
    fall with the number of images.
    """

    def __init__(self) -> None:
        self._sources: Dict[str, Tuple[float, int, float, float]] = {}     # mean, images, sd, lasting sd
        self._floor: Deque[float] = deque(maxlen=_FLOOR_SIGHTS)

    @property
    def value(self) -> float:
        """Size of the body, that of the network's average person being 1."""
        weight, total = self._combined()
        return math.exp(total / (weight + _STATURE_CV ** -2.0))

    @property
    def measured(self) -> Optional[Tuple[float, float]]:
        """Size by the cues alone, without the average, and the sd of its logarithm; None without any cue."""
        weight, total = self._combined()
        return (math.exp(total / weight), weight ** -0.5) if weight > 0.0 else None

    def floor_cue(self, ratio: Optional[float], lasting_sd: float = 0.0) -> Optional[ScaleCue]:
        """Cue of the floor: the median of what was seen of it, with `ratio` when it is not None.

        lasting_sd: of the logarithm of the camera's height.
        """
        if ratio is None:
            return None
        self._floor.append(ratio)
        return ScaleCue("floor", median_of_few(np.array(self._floor)), _FLOOR_SD[0],
                        math.hypot(_FLOOR_SD[1], lasting_sd), np.zeros(3))

    def update(self, cue: Optional[ScaleCue]) -> None:
        """Learn from a cue."""
        if cue is None or not math.isfinite(cue.sd):
            return
        mean, count, _, _ = self._sources.get(cue.source, (0.0, 0, 0.0, 0.0))
        count = min(count + 1, _MOST_IMAGES)
        limit = _OUTLIER * math.hypot(cue.sd, _STATURE_CV if count == 1 else 0.0)
        mean += min(max(math.log(cue.ratio) - mean, -limit), limit) / count
        self._sources[cue.source] = mean, count, cue.sd, cue.lasting_sd

    def _combined(self) -> Tuple[float, float]:
        """Sum of the weights of the sources, and of their weighted logarithms."""
        weight = total = 0.0
        for mean, count, sd, lasting in self._sources.values():
            own = 1.0 / (sd ** 2 / max(count / _CORRELATED, 1.0) + lasting ** 2)
            weight, total = weight + own, total + own * mean
        return weight, total


def _cue(source: str, ratio: float, sd: Tuple[float, float], limits: Tuple[float, float],
         reference: np.ndarray) -> Optional[ScaleCue]:
    if limits[0] < ratio < limits[1]:
        return ScaleCue(source, ratio, *sd, reference)
    return (ScaleCue(source, ratio, math.inf, math.inf, reference)
            if _PLACE_RANGE[0] < ratio < _PLACE_RANGE[1] else None)
