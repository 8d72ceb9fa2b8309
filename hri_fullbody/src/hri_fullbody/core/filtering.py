"""Key points of all bodies in space: a gate against outliers, then a low pass.

The low pass uses interacting multiple models (Blom, Bar-Shalom, IEEE Transactions on Automatic Control 33(8), 1988):
one model for a point without a velocity of its own, three for points whose velocity changes slowly, quickly, and very
quickly. Each model is a Kalman filter with its steady-state gains, which depend on one number, the tracking index
(Kalata, IEEE Transactions on Aerospace and Electronic Systems 20(2), 1984): acceleration times the square of the time
step over the noise. So there is next to no lag in fast motion and little noise at rest.

The noise of a body comes from the second difference of its points over time, to which motion adds little at 15 Hz and
more. The gate compares a point with its predicted place, after the common motion of the whole body is taken off: a
body whose distance is corrected keeps all its points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Dict, List, Sequence, Tuple

import numpy as np

from hri_fullbody.core import keypoints as kp
from hri_pipeline.core.image_rotation import ImageRotation

# Acceleration (m/s^2) that a model expects, and the time (s) in which its velocity fades to 1/e.
_ACCELERATIONS = np.array([1.0, 1.0, 4.0, 14.0])
_FADING = np.array([1e-3, 1.1, 1.1, 0.65])
MODES = len(_FADING)
_STAY_S = 0.45  # mean time for which a point keeps to one model
_USUAL_STEP = 1.0 / 30.0  # s: the table's; at other steps velocities fade by a little more or less than it supposes
_LOWEST, _HIGHEST, _PER_E = -7.0, 9.0, 10.0  # logarithm of the tracking index, entries for each e
_RUNS = 400
_LEAST_SHARE = 1e-9
# Evidence for a model counts less than that of independent errors would; the points of a limb move alike: what a
# neighbour shows counts too.
_OWN, _NEIGHBOUR = 0.6, 0.24
_LIMBS = ((2, 3, 4), (5, 6, 7), (8, 9, 10), (11, 12, 13), (1, 2, 5, 8, 11),
          (kp.NOSE, kp.NECK, kp.LEFT_EYE, kp.RIGHT_EYE, kp.LEFT_EAR, kp.RIGHT_EAR))


def _neighbours() -> np.ndarray:
    """Weights (18, 18) of the points' evidence for each other's model."""
    weights = np.zeros((18, 18))
    for limb in _LIMBS:
        for point in limb:
            weights[point, list(limb)] = _NEIGHBOUR
    np.fill_diagonal(weights, _OWN)
    return weights


_EVIDENCE = _neighbours()


@lru_cache(maxsize=1)
def _table() -> np.ndarray:
    """What each model's filter settles to (modes, entries, 4), step and noise being 1: gain of the place, gain of the
    velocity, half the inverse of the innovation's variance, half its logarithm."""
    entries = int((_HIGHEST - _LOWEST) * _PER_E) + 1
    force = np.exp(2.0 * (_LOWEST + np.arange(entries) / _PER_E))[None]
    keep = np.exp(-_USUAL_STEP / _FADING)[:, None]
    place, both, speed = np.ones((3, MODES, entries))
    for _ in range(_RUNS):
        place, both, speed = (place + 2.0 * both + speed + 0.25 * force, keep * (both + speed) + 0.5 * force,
                              keep * keep * speed + force)
        total = place + 1.0
        gain, turn = place / total, both / total
        place, both, speed = gain, both - turn * place, speed - turn * both
    return np.stack([gain, turn, 0.5 / total, 0.5 * np.log(total)], axis=-1)


def begin(places: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (N, M, 18, 3), velocities (N, M, 18, 3) and shares (N, M, 18) of points (N, 18, 3) m at rest."""
    shape = (len(places), MODES) + places.shape[1:]
    return np.broadcast_to(places[:, None], shape).copy(), np.zeros(shape), np.full(shape[:3], 1.0 / MODES)


def advance(places: np.ndarray, speeds: np.ndarray, shares: np.ndarray, points: np.ndarray, since: np.ndarray,
            noise: np.ndarray, process_noise_scale: float) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Take in measured points (N, 18, 3) m, NaN where missing; places, speeds and shares as `begin` gives them.

    since: (N, 18) s since the point was last measured. noise: (N, 3) m, standard deviation along the axes, above 0.
    process_noise_scale: factor of the accelerations that are expected. Returns the new places, speeds and shares; those
    of a missing point are as they were.
    """
    stay = np.exp(-since / _STAY_S)[:, None]
    move = (1.0 - stay) / MODES
    mixed = move + stay * shares
    # the models begin with what the others found, as far as a point may have changed from one model to another
    own, common = (stay * shares / mixed)[..., None], (move / mixed)[..., None]
    weights = shares[..., None]
    before = own * places + common * np.add.reduce(weights * places, axis=1, keepdims=True)
    pace = own * speeds + common * np.add.reduce(weights * speeds, axis=1, keepdims=True)
    step = since[:, None, :, None]
    expected = before + pace * step
    pace *= np.exp(-step / _FADING[:, None, None])
    index = np.log((process_noise_scale * _ACCELERATIONS)[:, None, None] * (step * step / noise[:, None, None]))
    entry = np.minimum(np.maximum((index - _LOWEST) * _PER_E + 0.5, 0.0), (_HIGHEST - _LOWEST) * _PER_E)
    settled = _table()[np.arange(MODES)[:, None, None], entry.astype(np.intp)]
    news = points[:, None] - expected
    missed = settled[..., 2] * (news / noise[:, None, None]) ** 2 + settled[..., 3]
    missed = np.add.reduce(missed, axis=-1)
    known = ~np.isnan(missed[:, :1])
    missed = np.where(known, missed, 0.0) @ _EVIDENCE
    likely = mixed * np.exp(np.minimum.reduce(missed, axis=1, keepdims=True) - missed) + _LEAST_SHARE
    likely /= np.add.reduce(likely, axis=1, keepdims=True)
    seen = known[..., None]
    return (np.where(seen, expected + settled[..., 0] * news, places),
            np.where(seen, pace + settled[..., 1] / step * news, speeds), np.where(known, likely, shares))


POINTS = 18
_RANGE_M = 1000.0
_PREDICTION_S = 0.07
_GATE_GROWS_S = 0.1
# Noise per axis that is supposed before it was measured, and the least that there is.
_NOISE_M, _LEAST_NOISE_M = 0.030, 1e-4
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
_RELATIVE_SPEED = np.array([.5, .4, .4, .7, 1., .4, .7, 1., .4, .7, 1., .4, .7, 1., .5, .5, .5, .5])


@dataclass(frozen=True)
class FilterSettings:
    """Units m, s.

    process_noise_scale: factor of the accelerations that are expected of the points. gate: how far a point may be from
    where it is expected; gate_speed: how much the fastest points' gate grows with the time since they were seen, m/s.
    gate_recovery: a point that stays for so long at another place is believed. memory: a point not seen for so long, or
    a body, starts anew. Raises ValueError naming the setting and its legal range.
    """

    process_noise_scale: float = 1.0
    gate: float = 0.10
    gate_speed: float = 3.0
    gate_recovery: float = 0.15
    memory: float = 0.4

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not math.isfinite(value) or value < 0.0 or (value == 0.0 and name != "gate_recovery"):
                raise ValueError("filter setting {} is {}, it must be above 0".format(name, value))


@dataclass(frozen=True)
class FilteredPoints:
    """Points (N, 18, 3) m: gated are the measured ones without outliers, smooth the filtered ones; NaN where a
    point is missing or was refused. noise: (N, 3) m, standard deviation of the measured points along each axis,
    that part of it which changes from image to image."""

    gated: np.ndarray
    smooth: np.ndarray
    noise: np.ndarray

    def of(self, rows: Sequence[int]) -> FilteredPoints:
        """Return those of some of the bodies, in this order."""
        return FilteredPoints(self.gated[rows], self.smooth[rows], self.noise[rows])


class KeypointFilter:
    """Filters of all bodies. A body is known by its id; its rows of the state arrays are kept till `retain`.

    settings: may be replaced between two updates.
    """

    def __init__(self, settings: FilterSettings = FilterSettings()) -> None:  # noqa: B008 (frozen)
        self.settings = settings
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
        self._places, self._speeds, self._shares = begin(self._smooth)
        self._velocity = np.zeros((rows, POINTS, 3))
        self._raw = np.full((rows, 2, POINTS, 3), np.nan)
        self._variance = np.full((rows, 3), _NOISE_M ** 2)
        self._noise_samples = np.zeros(rows)
        self._seen = np.full((rows, POINTS), -np.inf)
        self._elsewhere = np.full((rows, POINTS, 3), np.nan)
        self._elsewhere_since = np.full((rows, POINTS), np.inf)

    def _arrays(self) -> List[str]:
        return [name for name, value in vars(self).items() if isinstance(value, np.ndarray)]

    def turn(self, rotation: ImageRotation) -> None:
        """Turn all bodies with the sensor's frame."""
        for name in ("_last", "_gated", "_smooth", "_places", "_speeds", "_velocity", "_raw", "_elsewhere"):
            setattr(self, name, rotation.vectors(getattr(self, name)))
        self._variance = self._variance @ np.abs(rotation.matrix.T)

    def forget_places(self) -> None:
        """Let all bodies begin anew where they are seen next; what is known of their noise stays."""
        self._stamp[:] = np.nan

    def retain(self, ids: Sequence[str]) -> None:
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
        settings = self.settings
        anew = ~((step > 0.0) & (step <= settings.memory))
        if anew.any():
            fresh = rows[anew]
            self._seen[fresh], self._raw[fresh] = -np.inf, np.nan
            step = np.where(anew, 1.0, step)
        points, restart = self._gate(rows, points, step, stamp)
        self._gated[rows], self._stamp[rows] = points, stamp
        self._measure_noise(rows, points)
        since = np.where(restart, step[:, None], stamp - self._seen[rows])
        self._low_pass(rows, points, restart, since)
        self._seen[rows] = np.where(np.isnan(points[..., 0]), self._seen[rows], stamp)

    def _gate(self, rows: np.ndarray, points: np.ndarray, step: np.ndarray, stamp: float) -> tuple:
        """Return the points with NaN for outliers, and which of them start anew (N, 18)."""
        settings = self.settings
        since = (stamp - self._seen[rows])[..., None]
        last = self._last[rows]
        news = points - last
        ahead = self._velocity[rows] * np.minimum(since, _PREDICTION_S)
        known = since[..., 0] <= settings.memory
        # What was hidden, as the half of somebody behind a counter, is seen again far from where it was.
        common = _common(np.where(known[..., None], news - ahead, np.nan))
        gate = np.maximum(settings.gate, _GATE_SIGMAS * np.sqrt(self._variance[rows].mean(axis=1)))[:, None]
        speed = settings.gate_speed * _RELATIVE_SPEED
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

    def _low_pass(self, rows: np.ndarray, points: np.ndarray, restart: np.ndarray, since: np.ndarray) -> None:
        """since: (N, 18) s since the points were last seen."""
        seen = ~np.isnan(points[..., 0])
        restart = (restart & seen)[:, None]
        places, speeds, shares = self._places[rows], self._speeds[rows], self._shares[rows]
        if restart.any():
            at, still, alike = begin(points)
            places = np.where(restart[..., None], at, places)
            speeds = np.where(restart[..., None], still, speeds)
            shares = np.where(restart, alike, shares)
            points = np.where(restart[:, 0, :, None], np.nan, points)
        noise = np.maximum(np.sqrt(self._variance[rows]), _LEAST_NOISE_M)
        places, speeds, shares = advance(places, speeds, shares, points, since, noise,
                                         self.settings.process_noise_scale)
        self._places[rows], self._speeds[rows], self._shares[rows] = places, speeds, shares
        last = np.einsum("nmk,nmki->nki", shares, places)
        self._last[rows], self._velocity[rows] = last, np.einsum("nmk,nmki->nki", shares, speeds)
        self._smooth[rows] = np.where(seen[..., None], last, np.nan)


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
