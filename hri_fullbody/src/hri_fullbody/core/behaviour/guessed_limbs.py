"""Limbs that a pose network guesses: it places those that it does not see, too, as they mostly are."""

from __future__ import annotations

import math
from typing import List, Optional, Sequence

import numpy as np

from hri_fullbody.core.behaviour.arms import Vector
from hri_fullbody.core.keypoints import LEFT_ANKLE, LEFT_KNEE, LEFT_WRIST, RIGHT_ANKLE, RIGHT_KNEE, RIGHT_WRIST

_HANDS_AND_FEET = (LEFT_WRIST, RIGHT_WRIST, LEFT_ANKLE, RIGHT_ANKLE)
_LIMBS = (*_HANDS_AND_FEET, LEFT_KNEE, RIGHT_KNEE)
GUESSED = 0.5       # confidence of the pose network below which a joint is not seen
# Two knees that are seen in turn are evidence together: least low-passed confidence of either and of both.
_KNEE_S, _EITHER_KNEE, _BOTH_KNEES = 0.6, 0.35, 0.9
# A pose network that invents legs drags the hips down with them, and is less sure that there is a body. Length (m) of
# the trunk, see trunk_in_image, and score beyond which legs are guessed, low-passed: 1.9 % of 160 pictures of 22 people
# who sit are beyond, and 70 % of 118 of standing ones with hidden legs that look as if they sat (44 % of strangers).
_LONG_TRUNK, _LOW_SCORE, _TRUNK_S = 0.465, 0.9, 1.0
_STANDING_TRUNK = 0.45      # m: the trunk of who sits looks shorter


class KneeSigns:
    """Which knees of a body count as seen: one that is, or both that are guessed often enough.

    On people who sit, the confidences of both knees go up and down by .2 from image to image; each alone is below
    GUESSED half of the time.
    """

    def __init__(self) -> None:
        self._mean: Optional[List[float]] = None

    def update(self, confidence: Sequence[float], elapsed: float) -> List[bool]:
        """Take the confidences of both `elapsed` s after the last call; return whether each knee counts."""
        now = [value if value == value else 0.0 for value in confidence]
        share = 1.0 - math.exp(-elapsed / _KNEE_S)
        mean = self._mean = [before + share * (value - before) for before, value in zip(self._mean or now, now)]
        together = sum(mean) >= _BOTH_KNEES and min(mean) > _EITHER_KNEE
        return [value >= GUESSED or together for value in now]


class GuessedLegs:
    """Whether the pose network invents the legs of a body: then its trunk is too long, or its score is low."""

    def __init__(self) -> None:
        self._trunk = self._score = math.nan

    def update(self, trunk: float, score: float, elapsed: float) -> bool:
        """Take the length (m) of the trunk, see trunk_in_image, and the score, 0 to 1, `elapsed` s after the last call.

        NaN unknown.
        """
        share = 1.0 - math.exp(-elapsed / _TRUNK_S)
        self._trunk, self._score = _towards(self._trunk, trunk, share), _towards(self._score, score, share)
        return self._trunk > _LONG_TRUNK or self._score < _LOW_SCORE

    @property
    def stand(self) -> bool:
        """Whether trunk and score are those of somebody who stands; False while they are unknown."""
        return self._trunk > _STANDING_TRUNK and self._score >= _LOW_SCORE


def _towards(before: float, value: float, share: float) -> float:
    """What lies `share` of the way from `before` to `value`; the one that is known when the other is NaN."""
    if value != value:
        return before
    return value if before != before else before + share * (value - before)


def without_guessed_limbs(points: np.ndarray, keypoints: np.ndarray, width: float, height: float) -> np.ndarray:
    """Return key points (18, 3) m without wrists, knees and ankles that an image of width x height px does not show.

    keypoints: (18, 2) px, or (18, 3) with the confidence. A pose network places what lies below the image or behind a
    table, too, mostly hanging down: that is its habit and no detection of a leg; a guessed hand is often put before the
    face. Knees in the image stay, see KneeSigns.
    """
    seen = np.array(points, dtype=np.float64)
    rows = keypoints.tolist()
    for limb in _LIMBS:
        guessed = keypoints.shape[1] > 2 and limb in _HANDS_AND_FEET and not rows[limb][2] >= GUESSED
        if guessed or not _is_inside(rows[limb], width, height):
            seen[limb] = np.nan
    return seen


def without_feet_outside(keypoints: np.ndarray, width: float, height: float) -> np.ndarray:
    """Return the confidences (18,) of key points (18, 3) px, NaN for ankles outside an image of width x height px: that
    they are not seen is no sign that something hides them."""
    confidence = keypoints[:, 2].copy()
    for ankle in (LEFT_ANKLE, RIGHT_ANKLE):
        if not _is_inside(keypoints[ankle].tolist(), width, height):
            confidence[ankle] = np.nan
    return confidence


def _is_inside(point: Vector, width: float, height: float) -> bool:
    return 0.0 <= point[0] < width and 0.0 <= point[1] < height
