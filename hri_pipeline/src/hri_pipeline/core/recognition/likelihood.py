"""From distances between face templates to likelihoods that they are of the same person.

One comparison: the logarithm of the odds "same : different" falls linearly with the distance (logistic
calibration of a comparison score; Brummer and du Preez 2006, "Application-independent evaluation of speaker
detection"). Many comparisons: whoever is seen is unknown, or one of the N known persons, each with the odds 1 : N + 4
beforehand (open-set identification). So the larger the gallery, the closer a match must be, and two alike persons share
the likelihood. Somebody who has got two ids (seen from the side first, or by two cameras at once) would share it with
himself: `join_alike` gives it to one of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np

STRANGERS = 4
"""How many unknown persons are expected besides the known ones: where few are known, most are unknown."""
MAX_LIKELIHOOD = 0.99
"""Upper limit of the likelihood from comparing two pictures."""
UNIT_TOLERANCE = 1e-3
"""How far the length of a template may be from 1."""
_MAX_EXPONENT = 40.0
_LEAST_LIKELIHOOD = 0.05
"""Candidates below it are not compared with each other."""
_SCALES_BELOW = 7.0
"""Two persons are one when their templates are nearer than the midpoint by this many scales: odds of a thousand to
one."""


@dataclass(frozen=True)
class TemplateCalibration:
    """Odds of "same : different" of two templates at a distance d: exp((midpoint - d) / scale).

    All distances are those of unit vectors (0 to 2).

    Parameters
    ----------
    midpoint : distance at which both are equally likely, with a margin for caution.
    fair_midpoint : the same without a margin, for the question whether somebody is certainly new.
    scale : distance over which the odds change by a factor e.
    near : distance below which a new template of a person adds nothing.

    Raises
    ------
    ValueError
        They are not in the order 0 < near < midpoint <= fair_midpoint < 2, or the scale is not positive.
    """

    midpoint: float
    fair_midpoint: float
    scale: float
    near: float

    def __post_init__(self) -> None:
        if not 0.0 < self.near < self.midpoint <= self.fair_midpoint < 2.0 or not self.scale > 0.0:
            raise ValueError("calibration needs 0 < near < midpoint <= fair_midpoint < 2 and scale > 0, got {}".format(
                self))

    def likelihoods(self, distances: np.ndarray, population: int) -> np.ndarray:
        """Likelihood (..., N) that it is this person, for the distances (..., N) to N of `population` known ones."""
        odds = self._odds(distances, self.midpoint, population)
        return np.minimum(odds / (1.0 + odds.sum(axis=-1, keepdims=True)), MAX_LIKELIHOOD)

    def known(self, distances: np.ndarray, population: int) -> np.ndarray:
        """Likelihood (...,), without caution, that it is any of the persons at the distances (..., N)."""
        odds = self._odds(distances, self.fair_midpoint, population).sum(axis=-1)
        return odds / (1.0 + odds)

    def _odds(self, distances: np.ndarray, midpoint: float, population: int) -> np.ndarray:
        exponent = (midpoint - np.asarray(distances, dtype=np.float64)) / self.scale
        return np.exp(np.clip(exponent, -_MAX_EXPONENT, _MAX_EXPONENT)) / (population + STRANGERS)


@dataclass(frozen=True)
class PersonCandidate:
    """Somebody that a template may be of: distance of the nearest template of that person, calibrated likelihood."""

    person_id: str
    distance: float
    likelihood: float


@dataclass(frozen=True)
class MatchResult:
    """Who one template may be of, likeliest first, out of `population` persons; `same`: pairs (kept id, other id) of
    persons who are the same human by their templates.
    """

    candidates: Sequence[PersonCandidate]
    population: int
    same: Sequence[Tuple[str, str]] = ()


def join_alike(result: MatchResult, distance: Callable[[str, str], Optional[float]], order: Callable[[str], int],
               calibration: TemplateCalibration) -> MatchResult:
    """Give the likelihoods of persons who are the same human to the one known for longest; the others get none.

    Without this, two ids of one human would share the likelihood, and neither would be recognised. distance: between
    the nearest templates of two persons, None when they must not be joined; order: smaller for who is known longer.
    """
    likely = sorted((one for one in result.candidates if one.likelihood >= _LEAST_LIKELIHOOD),
                    key=lambda one: order(one.person_id))
    kept: List[PersonCandidate] = []
    same: List[Tuple[str, str]] = []
    limit = calibration.midpoint - _SCALES_BELOW * calibration.scale
    for one in likely:
        for index, other in enumerate(kept):
            between = distance(other.person_id, one.person_id)
            if between is not None and between < limit:
                kept[index] = replace(other, distance=min(one.distance, other.distance),
                                      likelihood=min(one.likelihood + other.likelihood, MAX_LIKELIHOOD))
                same.append((other.person_id, one.person_id))
                break
        else:
            kept.append(one)
    if not same:
        return result
    gone = {other for _, other in same}
    rest = [one for one in result.candidates if one.likelihood < _LEAST_LIKELIHOOD and one.person_id not in gone]
    return replace(result, candidates=tuple(sorted(kept, key=lambda one: -one.likelihood) + rest), same=tuple(same))
