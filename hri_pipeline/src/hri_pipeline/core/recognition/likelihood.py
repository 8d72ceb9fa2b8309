"""From distances between face templates to likelihoods that they are of the same person.

Open-set identification: whoever is seen is one of the N known persons, or somebody unknown. An unknown person is a
stranger, of whom N + 4 are expected for each known one, or looks like somebody known (kin, a child, a chance likeness),
which is taken to be as likely beforehand as that it is the known person. Against each of the two the logarithm of the
odds falls linearly with the distance (logistic calibration of a comparison score; Brummer and du Preez 2006,
"Application-independent evaluation of speaker detection"):

    odds = 1 / (exp(-(kin_midpoint - d) / kin_scale) + (N + 4) exp(-(fair_midpoint - d) / scale))

So the larger the gallery, the closer a match must be, and two alike persons share the likelihood, which is the margin
to the second best. Several views of a face narrow the first scale, as far as they are independent.

People whom the network knows little, and small or blurred faces, lie near the mean of all templates, and so near each
other whoever they are. Where the mean is known, a distance counts the more, the nearer to it one of the two is (a local
scale; Zelnik-Manor and Perona 2004, "Self-tuning spectral clustering").

How alike the people of a place are (a family, a class), those tell who are known there: a distance counts the more, the
nearer other people are to either of the two (symmetric adaptive score normalisation with the gallery as the cohort;
Matejka et al. 2017, "Analysis of score normalization in multilingual speaker recognition").

A likelihood ratio tells its false match rate: somebody else exceeds the ratio t with a probability of 1 / t at most
(Markov's inequality; Good 1950, "Probability and the Weighing of Evidence").

Somebody who has got two ids (seen from the side first, or by two cameras at once) would share the likelihood with
himself: `merge_duplicates` gives it to one of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Callable, List, Optional, Sequence, Tuple, Union

import numpy as np

STRANGERS = 4
"""How many strangers are expected besides one for each known person."""
MAX_LIKELIHOOD = 0.99
"""Upper limit of the likelihood from comparing two pictures."""
UNIT_TOLERANCE = 1e-3
"""How far the length of a template may be from 1."""
MOST_STRETCHED = 1.6
"""How many times as far as measured two templates count at most, near the mean of all."""
COHORT, COHORT_SHARE, CROWD_SHARE = 3, 0.02, 1.5
"""How many of the nearest other people tell how alike people are here: at least, and as a part of them all (of many,
some are near by chance); and by how many times what they are nearer than usual a distance counts more."""
_MAX_EXPONENT = 40.0
_LEAST_LIKELIHOOD = 0.05
"""Candidates below it are not compared with each other."""
_SCALES_BELOW = 7.0
"""Logarithm of odds of a thousand to one."""
_VIEW_SHARE = 0.4
"""Part of the scale against alike persons that is due to the single view; N independent views leave 1/N of it."""
_KIN_BELOW, _KIN_WIDER = 3.0, 1.2
"""Where nothing was measured of alike people: their midpoint is so many scales below the other, their scale so many
times the other."""


def template_distances(products: np.ndarray) -> np.ndarray:
    """Return the distances of templates, which are unit vectors, of their products, of any shape."""
    return np.sqrt(np.maximum(0.0, 2.0 - 2.0 * np.asarray(products, dtype=np.float64)))


@dataclass(frozen=True)
class TemplateCalibration:
    """Odds of "same : different" of templates at a distance d. All distances are those of unit vectors (0 to 2).

    Parameters
    ----------
    midpoint : distance at which same and stranger are equally likely, with a margin for caution.
    fair_midpoint : the same without a margin.
    scale : distance over which the odds against a stranger change by a factor e.
    near : distance below which a new template of a person adds nothing.
    kin_midpoint : distance at which same and alike person are equally likely; by default below `midpoint`.
    kin_scale : distance over which the odds against an alike person change by a factor e, for a single view.
    spread : typical distance of two views of one person that are independent of each other; `midpoint` / 2 by default.
    one_human : distance below which two persons, or two faces, are one human for certain; by default where the odds
        against a stranger are a thousand to one.
    centre : mean of the templates of many people, a unit vector (D,); empty where it was not measured.
    radius : distance from `centre` of templates whose distances are those meant above.
    crowd : distance of other people from a template below which people are alike here; 0 where it was not measured.

    Raises
    ------
    ValueError
        They are not in the order 0 < near < kin_midpoint <= midpoint <= fair_midpoint < 2, or a scale is not positive.
    """

    midpoint: float
    fair_midpoint: float
    scale: float
    near: float
    kin_midpoint: float = math.nan
    kin_scale: float = math.nan
    spread: float = math.nan
    one_human: float = math.nan
    centre: Tuple[float, ...] = ()
    radius: float = math.nan
    crowd: float = 0.0

    def __post_init__(self) -> None:
        defaults = {"kin_midpoint": self.midpoint - _KIN_BELOW * self.scale, "kin_scale": _KIN_WIDER * self.scale,
                    "spread": 0.5 * self.midpoint, "one_human": self.midpoint - _SCALES_BELOW * self.scale}
        for name, value in defaults.items():
            if math.isnan(getattr(self, name)):
                object.__setattr__(self, name, value)
        ordered = 0.0 < self.near < self.kin_midpoint <= self.midpoint <= self.fair_midpoint < 2.0
        if not (ordered and min(self.scale, self.kin_scale, self.spread) > 0.0):
            raise ValueError("calibration needs 0 < near < kin_midpoint <= midpoint <= fair_midpoint < 2 and positive"
                             " scales, got {}".format(self))

    @property
    def contradiction(self) -> float:
        """Distance from which on a view is hardly of the same person, and rather of somebody alike."""
        return self.kin_midpoint + self.kin_scale

    def compared(self, distance: float, first: np.ndarray, second: np.ndarray) -> float:
        """Return the distance of two templates (D,) as it counts: larger where one of them is nearer to the mean of all
        than `radius`, by as much as it is nearer."""
        return distance * float(self._stretch(np.stack((first, second))).max())

    def apart(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return the distances (N, M) of the templates (N, D) from those of (M, D), as they count."""
        return template_distances(first @ second.T) * np.maximum(self._stretch(first)[:, None], self._stretch(second))

    def _stretch(self, templates: np.ndarray) -> np.ndarray:
        """Return how many times as far (N,) as measured the templates (N, D) are from others, at least."""
        if not self.centre:
            return np.ones(len(templates))
        nearness = np.maximum(np.linalg.norm(templates - self._centre, axis=1), 1e-6)
        return np.clip(self.radius / nearness, 1.0, MOST_STRETCHED)

    def crowding(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return by how much (0 or more) the distance of two templates counts more, for the distances of other people
        from the one (N,) and from the other (M,)."""
        nearer = 0.0
        for others in (first, second):
            count = max(COHORT, int(COHORT_SHARE * len(others)))
            nearest = np.partition(others, count)[:count] if len(others) > count else others
            nearer += float(np.maximum(0.0, self.crowd - nearest).sum()) / count
        return CROWD_SHARE * nearer / 2.0

    @cached_property
    def _centre(self) -> np.ndarray:
        return np.array(self.centre, np.float32)

    def likelihoods(self, distances: np.ndarray, population: int, views: float = 1.0) -> np.ndarray:
        """Likelihood (..., N) that it is this person, for the distances (..., N) to N of `population` known ones.

        views : how many independent views the distances are of (1 or more).
        """
        odds = np.exp(self.log_odds(distances, population, views))
        return np.minimum(odds / (1.0 + odds.sum(axis=-1, keepdims=True)), MAX_LIKELIHOOD)

    def log_odds(self, distances: np.ndarray, population: int, views: float = 1.0) -> np.ndarray:
        """Logarithm (...,) of the odds "this person : anybody else who is not known", for distances (...,)."""
        against = self._exponential((np.asarray(distances, dtype=np.float64) - self.kin_midpoint)
                                    / self._kin_scale(views))
        against += (population + STRANGERS) * self._exponential(
            (np.asarray(distances, dtype=np.float64) - self.fair_midpoint) / self.scale)
        return -np.log(against)

    def alike_log_odds(self, distances: np.ndarray) -> np.ndarray:
        """Logarithm (...,) of the odds "this person : somebody alike", of a single view at the distances (...,)."""
        return (self.kin_midpoint - np.asarray(distances, dtype=np.float64)) / self.kin_scale

    def known(self, distances: np.ndarray, population: int) -> np.ndarray:
        """Likelihood (...,), without caution, that it is any of the persons at the distances (..., N)."""
        ratios = self._exponential((self.fair_midpoint - np.asarray(distances, dtype=np.float64)) / self.scale)
        odds = ratios.sum(axis=-1) / (population + STRANGERS)
        return odds / (1.0 + odds)

    def limit(self, likelihood: float, population: int, views: float = 1.0) -> float:
        """Return the largest distance at which somebody, the only candidate, has this likelihood (0 to 1)."""
        low, high = 0.0, 2.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            is_enough = float(self.likelihoods(np.array([middle]), population, views)[0]) >= likelihood
            low, high = (middle, high) if is_enough else (low, middle)
        return low

    def false_match_rates(self, distance: float, population: int, views: float = 1.0) -> Tuple[float, float]:
        """Return upper bounds of the probabilities that a stranger is as near as this to anybody of `population`, and
        that somebody alike is as near to the one who is like him."""
        stranger = population * float(self._exponential((distance - self.fair_midpoint) / self.scale))
        return min(1.0, stranger), min(1.0, float(self._exponential(
            (distance - self.kin_midpoint) / self._kin_scale(views))))

    def _kin_scale(self, views: float) -> float:
        return self.kin_scale * (1.0 - _VIEW_SHARE + _VIEW_SHARE / max(1.0, views))

    @staticmethod
    def _exponential(exponent: Union[float, np.ndarray]) -> np.ndarray:
        return np.exp(np.clip(exponent, -_MAX_EXPONENT, _MAX_EXPONENT))


@dataclass(frozen=True)
class PersonCandidate:
    """Somebody that a face may be: distance from the templates of that person (MemoryGallery.match), calibrated
    likelihood, and by the person's first template alone the logarithm of the odds against somebody alike."""

    person_id: str
    distance: float
    likelihood: float
    first: float = 0.0


@dataclass(frozen=True)
class MatchResult:
    """Who one template may be of, likeliest first, out of `population` persons; `same`: pairs (kept id, other id) of
    persons who are the same human by their templates.
    """

    candidates: Sequence[PersonCandidate]
    population: int
    same: Sequence[Tuple[str, str]] = ()


def merge_duplicates(result: MatchResult, distance: Callable[[str, str], Optional[float]], order: Callable[[str], int],
               calibration: TemplateCalibration) -> MatchResult:
    """Give the likelihoods of persons who are the same human to the one known for longest; the others get none.

    Without this, two ids of one human would share the likelihood, and neither would be recognised. distance: between
    the nearest templates of two persons, None when they must not be joined; order: smaller for who is known longer.
    """
    likely = sorted((one for one in result.candidates if one.likelihood >= _LEAST_LIKELIHOOD),
                    key=lambda one: order(one.person_id))
    kept: List[PersonCandidate] = []
    same: List[Tuple[str, str]] = []
    limit = calibration.one_human
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
