"""What somebody's face measures at rest, learnt while it is looked at."""

from __future__ import annotations

from typing import Optional

import numpy as np

SAMPLE_PERIOD = 0.2
"""Time (s) between two values that are kept."""
CAPACITY = 150
"""Values kept: half a minute of quiet time."""
TRUST_TIME = 2.0
"""Quiet time (s) after which the person's own values count as much as those of the population."""
MAX_DEVIATION = 2.0
"""Largest distance of a neutral from the population's mean, in standard deviations of the population."""


class RunningNeutral:
    """Quantiles of K measures over the quiet moments of the last half minute or more of quiet time.

    It starts with the population's mean and moves to the person's own quantile q as
    mean + w (q - mean), w = t / (t + TRUST_TIME) for t seconds of quiet time, never further than
    MAX_DEVIATION standard deviations: who is smiling from the first image on does not become "neutral" by it.
    """

    def __init__(self, mean: np.ndarray, deviation: np.ndarray, quantile: np.ndarray) -> None:
        """mean, deviation, quantile: (K,); quantile 0 to 1."""
        self._mean = np.asarray(mean, dtype=np.float64)
        self._limit = MAX_DEVIATION * np.asarray(deviation, dtype=np.float64)
        self._quantile = np.asarray(quantile, dtype=np.float64)
        self._values = np.empty((CAPACITY, len(self._mean)))
        self.reset()

    @property
    def value(self) -> np.ndarray:
        """(K,) the neutral as known now."""
        return self._neutral

    @property
    def known(self) -> float:
        """How much of the neutral is the person's own: 0 (nothing seen yet) to nearly 1."""
        quiet = self._count * SAMPLE_PERIOD
        return quiet / (quiet + TRUST_TIME)

    def add(self, values: np.ndarray, stamp: float) -> None:
        """Take note of the measures (K,) of a quiet moment at a time (s). Values that are not finite are left out."""
        if self._last is not None and stamp - self._last < 0.99 * SAMPLE_PERIOD:
            return
        if not np.isfinite(values).all():
            return
        self._last = stamp
        self._values[self._count % CAPACITY] = values
        self._count += 1
        if self._count <= 10 or self._count % 5 == 0:
            self._estimate()

    def reset(self) -> None:
        """Forget the person."""
        self._count = 0
        self._last: Optional[float] = None
        self._neutral = self._mean.copy()

    def _estimate(self) -> None:
        kept = np.sort(self._values[:min(self._count, CAPACITY)], axis=0)
        place = np.rint(self._quantile * (len(kept) - 1)).astype(int)
        own = kept[place, np.arange(kept.shape[1])]
        self._neutral = self._mean + np.clip(self.known * (own - self._mean), -self._limit, self._limit)
