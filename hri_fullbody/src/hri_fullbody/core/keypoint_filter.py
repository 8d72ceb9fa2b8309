"""Gate against outliers, then a low pass, for the key points in space of all bodies at once.

The low pass is a 1 euro filter (Casiez, Roussel, Vogel, CHI 2012) with one cutoff for the three coordinates of a
point, and two changes that were measured on motion capture (less lag at the same calm): the cutoff grows with the
square of the speed, and the more the less noise there is. The noise of a body is told by the second difference
of its points over time, of which motion makes little at 15 Hz and more. The gate compares a point with where it was expected: what the whole body moved since the last image
is no news, so that a body whose distance is corrected keeps all its points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Dict, List, Sequence

import numpy as np

POINTS = 18
_RANGE_M = 1000.0
_VELOCITY_CUTOFF_HZ = 4.0
_PREDICTION_S = 0.07
_GATE_GROWS_S = 0.1
# Noise per axis at which `beta` holds, and how much it may grow at less.
_NOISE_M = 0.030
_MOST_GAIN = 10.0
# Of the square of the speed that noise alone would show, so much is taken off.
_NOISE_SPEED = 2.0
# The gate is never closer than so many standard deviations of the noise.
_GATE_SIGMAS = 5.0
# The noise is the mean over so many images.
_NOISE_SAMPLES = 20.0
# Median of the square of a normal variable of unit variance (chi-square, 1 degree of freedom), times the variance of
# a second difference (1 + 4 + 1).
_SECOND_DIFFERENCE = 0.455 * 6.0
# Of the points of a body, so many must be known for its common motion to be told.
_COMMON_POINTS = 5
# Wrists and ankles are fast, elbows and knees half as much, trunk and head hardly move against the body.
_AGILITY = np.array([.5, .4, .4, .7, 1., .4, .7, 1., .4, .7, 1., .4, .7, 1., .5, .5, .5, .5])


@dataclass(frozen=True)
class FilterSettings:
    """Units m, s, Hz.

    min_cutoff, beta, d_cutoff: of the 1 euro filter; the cutoff is min_cutoff + beta (1 m/s) (speed / 1 m/s)^2 at a
    noise of 30 mm per axis, and beta is larger in proportion at less noise, at most ten times. gate: how far a point may be from where it is
    expected; gate_speed: how much the fastest points' gate grows with the time since they were seen, m/s.
    gate_recovery: a point that stays for so long at another place is believed. memory: a point not seen for so
    long, or a body, starts anew. Raises ValueError naming the setting and its legal range.
    """

    min_cutoff: float = 1.5
    beta: float = 7.0
    d_cutoff: float = 1.5
    gate: float = 0.10
    gate_speed: float = 3.0
    gate_recovery: float = 0.15
    memory: float = 0.4

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and name not in ("beta", "gate_recovery")):
                raise ValueError("filter setting {} is {}, it must be above 0".format(name, value))


@dataclass(frozen=True)
class FilteredPoints:
    """Points (N, 18, 3) m: gated are the measured ones without outliers, smooth the filtered ones; NaN where a
    point is missing or was refused. noise: (N, 3) m, standard deviation of the measured points along each axis,
    that part of it which changes from image to image."""

    gated: np.ndarray
    smooth: np.ndarray
    noise: np.ndarray

    def only(self, number: int) -> FilteredPoints:
        """Return those of one body."""
        one = slice(number, number + 1)
        return FilteredPoints(self.gated[one], self.smooth[one], self.noise[one])


class KeypointFilter:
    """Filters of all bodies. A body is known by its id; its rows of the state arrays are kept till `keep`."""

    def __init__(self, settings: FilterSettings = FilterSettings()) -> None:  # noqa: B008 (frozen)
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._rows: Dict[str, int] = {}
        self._allocate(0)

    def _allocate(self, rows: int) -> None:
        self._stamp = np.full(rows, np.nan)
        self._last = np.full((rows, POINTS, 3), np.nan)
        self._gated = np.full((rows, POINTS, 3), np.nan)
        self._smooth = np.full((rows, POINTS, 3), np.nan)
        self._slow_velocity = np.zeros((rows, POINTS, 3))
        self._velocity = np.zeros((rows, POINTS, 3))
        self._raw = np.full((rows, 2, POINTS, 3), np.nan)
        self._variance = np.full((rows, 3), _NOISE_M ** 2)
        self._noise_samples = np.zeros(rows)
        self._seen = np.full((rows, POINTS), -np.inf)
        self._elsewhere = np.full((rows, POINTS, 3), np.nan)
        self._elsewhere_since = np.full((rows, POINTS), np.inf)

    def _arrays(self) -> List[str]:
        return [name for name, value in vars(self).items() if isinstance(value, np.ndarray)]

    def keep(self, ids: Sequence[str]) -> None:
        """Forget all bodies but these."""
        wanted = set(ids)
        if all(name in wanted for name in self._rows):
            return
        kept = [name for name in self._rows if name in wanted]
        rows = [self._rows[name] for name in kept]
        for array in self._arrays():
            setattr(self, array, getattr(self, array)[rows])
        self._rows = {name: row for row, name in enumerate(kept)}

    def _rows_of(self, ids: Sequence[str]) -> np.ndarray:
        new = [name for name in ids if name not in self._rows]
        if new:
            old = {name: getattr(self, name) for name in self._arrays()}
            self._allocate(len(self._rows) + len(new))
            for name, value in old.items():
                getattr(self, name)[:len(value)] = value
            for name in new:
                self._rows[name] = len(self._rows)
        return np.array([self._rows[name] for name in ids], dtype=int)

    def update(self, ids: Sequence[str], points: np.ndarray, stamp: float) -> FilteredPoints:
        """Filter the points (N, 18, 3) m, NaN missing, of the bodies `ids` (N different ones), seen at `stamp` (s).

        A stamp that goes back starts the body anew; the same stamp again returns the last result.
        Raises ValueError for a wrong shape or a stamp that is not finite.
        """
        points = np.array(points, dtype=np.float64)
        if points.shape != (len(ids), POINTS, 3) or not math.isfinite(stamp):
            raise ValueError("{} bodies need points of shape ({}, 18, 3) and a finite time, not {} and {}".format(
                len(ids), len(ids), points.shape, stamp))
        if not len(ids):
            return FilteredPoints(points, points.copy(), np.zeros((0, 3)))
        points[~(np.abs(points).max(axis=-1) < _RANGE_M)] = np.nan
        rows = self._rows_of(ids)
        step = stamp - self._stamp[rows]
        same = step == 0.0
        if same.any():
            if same.all():
                return self._result(rows)
            new = np.flatnonzero(~same)
            self._step(rows[new], points[new], step[new], stamp)
        else:
            self._step(rows, points, step, stamp)
        return self._result(rows)

    def _result(self, rows: np.ndarray) -> FilteredPoints:
        return FilteredPoints(self._gated[rows], self._smooth[rows], np.sqrt(self._variance[rows]))

    def _step(self, rows: np.ndarray, points: np.ndarray, step: np.ndarray, stamp: float) -> None:
        settings = self._settings
        anew = ~((step > 0.0) & (step <= settings.memory))
        if anew.any():
            fresh = rows[anew]
            self._last[fresh] = self._elsewhere[fresh] = np.nan
            self._seen[fresh], self._elsewhere_since[fresh] = -np.inf, np.inf
            self._slow_velocity[fresh] = self._velocity[fresh] = 0.0
            self._raw[fresh] = np.nan
            step = np.where(anew, 1.0, step)
        points, restart = self._gate(rows, points, step, stamp)
        self._gated[rows], self._stamp[rows] = points, stamp
        self._measure_noise(rows, points)
        self._low_pass(rows, points, restart, step[:, None, None])
        self._seen[rows] = np.where(np.isnan(points[..., 0]), self._seen[rows], stamp)

    def _gate(self, rows: np.ndarray, points: np.ndarray, step: np.ndarray, stamp: float) -> tuple:
        """Return the points with NaN for outliers, and which of them start anew (N, 18)."""
        settings = self._settings
        since = (stamp - self._seen[rows])[..., None]
        last = self._last[rows]
        news = points - last
        ahead = self._velocity[rows] * np.minimum(since, _PREDICTION_S)
        common = _common(news - ahead)
        known = since[..., 0] <= settings.memory
        gate = np.maximum(settings.gate, _GATE_SIGMAS * np.sqrt(self._variance[rows].mean(axis=1)))[:, None]
        speed = settings.gate_speed * _AGILITY
        limit = gate + speed * np.minimum(since[..., 0], _GATE_GROWS_S)
        # A point that turns back at once is as likely as one that goes on.
        distance = np.minimum(_length(news - common), _length(news - ahead - common))
        outlier = known & (distance > limit)
        # What is believed only because it was away for a while starts anew: no sliding from the old place.
        anew = ~known | (distance > gate + speed * step[:, None])
        if not outlier.any():
            self._elsewhere_since[rows] = np.inf
            return points, anew
        stayed = _length(points - self._elsewhere[rows]) <= limit
        begin = np.where(outlier & stayed, np.minimum(self._elsewhere_since[rows], stamp), stamp)
        believed = outlier & (stamp - begin >= settings.gate_recovery)
        wait = outlier & ~believed
        self._elsewhere[rows] = np.where(wait[..., None], points, np.nan)
        self._elsewhere_since[rows] = np.where(wait, begin, np.inf)
        return np.where(wait[..., None], np.nan, points), anew

    def _measure_noise(self, rows: np.ndarray, points: np.ndarray) -> None:
        """Follow the variance of the noise (m^2) of each body and axis: by the median over its points, so that
        limbs in motion do not count."""
        before = self._raw[rows]
        change = points - 2.0 * before[:, 1] + before[:, 0]
        squares = np.sort(change * change, axis=1)
        count = (~np.isnan(squares[..., 0])).sum(axis=1)
        middle = squares[np.arange(len(rows)), np.maximum(count - 1, 0) // 2] / _SECOND_DIFFERENCE
        enough = count >= _COMMON_POINTS
        self._noise_samples[rows] += enough
        weight = np.where(enough, 1.0 / np.clip(self._noise_samples[rows], 1.0, _NOISE_SAMPLES), 0.0)[:, None]
        old = self._variance[rows]
        self._variance[rows] = old + weight * (np.where(enough[:, None], middle, 0.0) - old)
        self._raw[rows, 0], self._raw[rows, 1] = before[:, 1], points

    def _low_pass(self, rows: np.ndarray, points: np.ndarray, restart: np.ndarray, step: np.ndarray) -> None:
        settings = self._settings
        seen = ~np.isnan(points)
        restart = restart[..., None] & seen
        last = np.where(restart, points, self._last[rows])
        difference = np.where(seen, points - last, 0.0)
        slow, fast = self._slow_velocity[rows], self._velocity[rows]
        slow = np.where(restart, 0.0, slow + _weight(settings.d_cutoff, step) * (difference / step - slow))
        fast = np.where(restart, 0.0, fast + _weight(_VELOCITY_CUTOFF_HZ, step) * (difference / step - fast))
        variance = np.maximum(self._variance[rows], 1e-12)
        # Noise looks like speed: as much of it as the filter of the speed lets through is taken off.
        through = _weight(settings.d_cutoff, step)[..., 0]
        noise = _NOISE_SPEED * variance.sum(axis=1)[:, None] * through / (2.0 - through) / step[..., 0] ** 2
        speed = np.maximum(np.einsum("nki,nki->nk", slow, slow) - noise, 0.0)[..., None]
        gain = np.minimum(_NOISE_M / np.sqrt(variance), _MOST_GAIN)
        cutoff = settings.min_cutoff + settings.beta * gain[:, None] * speed
        smooth = last + _weight(cutoff, step) * difference
        self._slow_velocity[rows], self._velocity[rows], self._last[rows] = slow, fast, smooth
        self._smooth[rows] = np.where(seen, smooth, np.nan)


def _common(news: np.ndarray) -> np.ndarray:
    """What the bodies moved as a whole (N, 1, 3) m: the median over the points, 0 where few are known."""
    known = ~np.isnan(news[..., 0])
    count = known.sum(axis=1)
    ordered = np.sort(news, axis=1)
    index = np.arange(len(news))
    middle = (ordered[index, np.maximum(count - 1, 0) // 2] + ordered[index, np.minimum(count // 2, POINTS - 1)]) / 2.0
    return np.where((count >= _COMMON_POINTS)[:, None], middle, 0.0)[:, None]


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def _weight(cutoff: object, step: np.ndarray) -> np.ndarray:
    """Weight of the new value, 0 to 1, of a first-order low pass with this cutoff (Hz) after `step` (s)."""
    ratio = 2.0 * math.pi * step * cutoff
    return ratio / (ratio + 1.0)
