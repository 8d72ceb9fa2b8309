"""From distances between face templates to likelihoods that they are of the same person.

One comparison: the logarithm of the odds "same : different" falls linearly with the distance (logistic
calibration of a comparison score; Brummer and du Preez 2006, "Application-independent evaluation of speaker
detection"). Many comparisons: whoever is seen is unknown, or one of the N known persons, each with the odds 1 : N + 4
beforehand (open-set identification). So the larger the gallery, the closer a match must be, and two alike persons share
the likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STRANGERS = 4
"""So many more persons than are known might come: where few are known, most are strangers."""
MAX_LIKELIHOOD = 0.99
"""No comparison of two pictures is surer than this."""
_MAX_EXPONENT = 40.0


@dataclass(frozen=True)
class Calibration:
    """Odds of "same : different" of two templates at a distance d: exp((midpoint - d) / scale).

    midpoint: distance at which both are as likely; fair_midpoint: the same without caution, used where the question
    is whether somebody is certainly new; scale: distance for a factor e; near: distance below which a new template of
    a person tells nothing new. All in distances of unit vectors (0 to 2). Raises ValueError for a wrong order.
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
