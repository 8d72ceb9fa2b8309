"""Dimensions of one tracked person: estimated continuously, fixed early, changed rarely."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from hri_fullbody.core.model.anthropometry import SEGMENTS, SegmentTable, StatureEstimate, StatureEstimator
from hri_fullbody.core.model.human import Dimensions

# Between two estimates, s: before the dimensions are settled, and after.
_EAGER_S = 0.1
_CALM_S = 0.5
# Dimensions are settled with so many lengths seen, or after so long with what the table says.
_ENOUGH_LENGTHS = 4
_ENOUGH_SAMPLES = 3
_PATIENCE_S = 1.0
# They are changed when so many estimates in a row, each of so many images, want it by more than so many sd.
_AGREEING = 3
_SURE_SAMPLES = 15
_SURE_S = 0.5
_SIGNIFICANT = 2.0
# A limb may be wrong by as much as the tolerance makes of a thigh, which is so large a part of the stature.
_THIGH_RATIO = 0.24
# Least time between two changes: it doubles from one to the next.
_FIRST_WAIT_S = 1.0
_LAST_WAIT_S = 60.0


@dataclass(frozen=True)
class DimensionSettings:
    """tolerance: relative change of the stature that is worth new dimensions; of a limb, what that makes of a thigh.
    limb_lengths: estimate every segment, else only the stature with the table's mean proportions.
    delay: s, least time of watching before dimensions are settled. window: s over which lengths are kept.
    scale_sd: relative spread of size. Raises ValueError naming the setting and its legal range."""

    tolerance: float = 0.03
    limb_lengths: bool = True
    delay: float = 0.2
    window: float = 5.0
    scale_sd: float = 0.10

    def __post_init__(self) -> None:
        for name, low, high in (("tolerance", 0.001, 1.0), ("delay", 0.0, 10.0), ("window", 0.5, 120.0),
                                ("scale_sd", 0.01, 1.0)):
            value = getattr(self, name)
            if not math.isfinite(value) or not low <= value <= high:
                raise ValueError("dimension setting {} is {}, legal: {:g} to {:g}".format(name, value, low, high))


class PersonDimensions:
    """Dimensions of one person and their revision: 0 while they are not settled, then 1, 2, ... ."""

    def __init__(self, table: SegmentTable, settings: DimensionSettings) -> None:
        self._table, self._settings = table, settings
        self._estimator = StatureEstimator(table, settings.window, settings.scale_sd)
        self.estimate: StatureEstimate = self._estimator.estimate()
        """The newest estimate; it may differ from the settled dimensions by less than the tolerance."""
        self.dimensions = self._made_of(self.estimate)
        """What the person is to be modelled with: the settled ones, before that the newest."""
        self.revision = 0
        self._settled: Optional[StatureEstimate] = None
        self._due, self._allowed, self._wait, self._agreeing = -math.inf, -math.inf, _FIRST_WAIT_S, 0

    def restart(self) -> None:
        """Forget the measurements, as when time goes back; settled dimensions stay."""
        self._estimator.reset()
        self._due, self._agreeing = -math.inf, 0
        self._allowed = -math.inf if self._settled is None else math.inf

    def update(self, points: np.ndarray, stamp: float, systematic: float = 0.0,
               size: Optional[Tuple[float, float]] = None) -> None:
        """Take the key points (18, 3) m, without outliers and unfiltered, NaN missing, at `stamp` (s).

        systematic: relative error of their source's lengths, see StatureEstimator.add. size: see its `estimate`."""
        self._estimator.add(points, stamp, systematic)
        if stamp < self._due:
            return
        if self._allowed == math.inf:
            self._allowed = stamp + self._wait
        self.estimate = self._estimator.estimate(size)
        duration = self._estimator.duration
        if self._settled is None:
            self._due = stamp + _EAGER_S
            self.dimensions = self._made_of(self.estimate)
            if self._is_enough(duration):
                self._settle(stamp)
            return
        self._due = stamp + _CALM_S
        sure = self.estimate.samples >= _SURE_SAMPLES and duration >= _SURE_S
        self._agreeing = self._agreeing + 1 if sure and self._differs() else 0
        if self._agreeing >= _AGREEING and stamp >= self._allowed:
            self.dimensions = self._made_of(self.estimate)
            self._wait = min(2.0 * self._wait, _LAST_WAIT_S)
            self._settle(stamp)

    def _is_enough(self, duration: float) -> bool:
        estimate = self.estimate
        if estimate.samples < _ENOUGH_SAMPLES or duration < self._settings.delay:
            return False
        return estimate.seen >= _ENOUGH_LENGTHS or duration >= _PATIENCE_S

    def _settle(self, stamp: float) -> None:
        self._settled, self._agreeing = self.estimate, 0
        self._allowed = stamp + self._wait
        self.revision += 1

    def _differs(self) -> bool:
        """Tell whether stature or a limb is away from the settled one by more than tolerance and uncertainty."""
        new, old, tolerance = self.estimate, self._settled, self._settings.tolerance
        assert old is not None
        allowed = tolerance * old.stature
        if _differ(new.stature, old.stature, new.stature_sd, allowed):
            return True
        return self._settings.limb_lengths and any(
            _differ(new.lengths[name], old.lengths[name], new.lengths_sd[name], _THIGH_RATIO * allowed)
            for name in SEGMENTS)

    def _made_of(self, estimate: StatureEstimate) -> Dimensions:
        lengths = estimate.lengths if self._settings.limb_lengths else {}
        return Dimensions.from_segments(estimate.stature, lengths, self._table)


def _differ(new: float, old: float, spread: float, allowed: float) -> bool:
    return abs(new - old) > max(allowed, _SIGNIFICANT * spread)
