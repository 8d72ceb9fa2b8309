"""Places of people by rays: how uncertain a place is that one camera tells, and what several places tell together.

A camera knows the direction of a person well and the distance badly: without depth or floor, 12 % of the distance along
the ray and 2 % across were measured on four synchronised cameras. So a place is a Gaussian that is long along its ray;
two are compared by their Mahalanobis distance, and fused by their inverse covariances (the best linear estimate; R.
Kalman, Journal of Basic Engineering 82, 1960). Where rays cross, that is the triangulation of the person. A voice tells
a direction only; a place of which nothing new is heard becomes less certain with time.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass
from typing import Dict, List, Mapping, NamedTuple, Optional, Tuple, Union

import numpy as np

ALONG = 0.12               # standard deviation along the ray, share of the distance,
ACROSS = 0.02              # and across
OF_PERSON = 0.44           # share of the variance along the ray that is the person's size, wrong for all cameras
WINDOW_S = 0.8             # of places that tell a velocity,
MOMENT_S = 0.15            # and, before and after, of those that tell a position
REST_S = 2.0               # of those that tell where somebody stands
WALK_S = 2.5               # of places that tell how somebody walks
WALK_DRIFT = 0.6           # change of the error of a place within the time of a walk, share of the error
SHORTEST_S = 0.3           # of the places that tell a velocity
FASTEST_MPS = 3.0          # a person who runs
SETTLING_S = 0.2           # by which a new view may begin before the last one has ended
FRESH_S = 0.5              # who was seen so long ago is seen now
VOICE_RAD = 0.14           # error of the direction of a voice (standard deviation)
FARTHEST_VOICE_M = 1e6     # told farther away, its variances to the sides would be lost beside that along the ray
VOICE_M, VOICE_SPREAD_M = 2.0, 1.0     # mean distance of who talks, and its standard deviation: 0.5 to 4 m
AWAY_MPS, AWAY_S = 0.5, 1.0     # speed of who is out of sight, per axis, and for how long it goes one way
HEIGHT_CHANGED_M = 0.25    # of who is out of sight: one in three sits down or gets up, by 0.45 m
CHANGE_MPS = 0.2           # deviation of how a velocity changes out of sight
CHANGED = 1.5              # log-likelihood that a change of pace before the loss costs
HEIGHT_M = 0.03            # deviation of the height of a head that walks
# Deviations of where, and how fast, somebody else comes up instead: place, height and velocity.
OTHER_M, OTHER_HEIGHT_M, OTHER_MPS = 1.2, 0.25, 0.6
LEAST_SQUARE = 1e-6        # m^2; a place nearer to the optical centre than 1 mm has no ray
CHI_SQUARE_95 = 5.991      # of two degrees of freedom: the square of the Mahalanobis distance that 95 % keep
_EYE = np.eye(3)
_CAPACITY = 128            # places for which there is room at first
STANDING_MPS = 0.15        # who goes slower stands
RESTING_M = 0.12           # nearer to the mean of the last seconds somebody stands rather than walks
LEARNT_VARIANCE = 0.1 ** 2     # a scale is used from then on
FIXED_VARIANCE = 0.08 ** 2     # of a scale that was learnt, as far as it changes with the moment
SAME_CAMERA = 0.3          # correlation of the errors of a face and a body's head in one view: of its camera's pose


class Estimate(NamedTuple):
    """position (3,) m, velocity (3,) m/s, covariance (3, 3) m^2 of the position; all in the reference frame."""

    position: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray


class Walk(NamedTuple):
    """A straight line through the places of some seconds.

    stamp: s, of `position` (3,) m, at one of its ends; covariance (3, 3) m^2 of that. velocity: (3,) m/s,
    velocity_covariance: (3, 3) (m/s)^2. shared: (3,) m, the part of the error of the position that another camera
    would have along its own ray.
    """

    stamp: float
    position: np.ndarray
    covariance: np.ndarray
    velocity: np.ndarray
    velocity_covariance: np.ndarray
    shared: np.ndarray


def ray_covariance(position: np.ndarray, origin: np.ndarray, along: float = ALONG,
                   exactness: float = 0.0) -> np.ndarray:
    """Return the covariance (3, 3) m^2 of a place that a camera tells.

    Parameters
    ----------
    position, origin : numpy.ndarray, shape (3,)
        The place and the optical centre, m, in one frame.
    along : float
        Standard deviation along the ray, as a share of the distance; ACROSS is that to the sides.
    exactness : float
        Standard deviation of the camera's own pose, m, in all directions.
    """
    # In plain numbers: hundreds a second, and for so few numpy takes five times as long.
    x, y, z = (position - origin).tolist()
    side = ACROSS * ACROSS * (x * x + y * y + z * z) + exactness * exactness
    stretch = along * along - ACROSS * ACROSS
    i, j, k = stretch * x, stretch * y, stretch * z
    return np.array((i * x + side, i * y, i * z, j * x, j * y + side, j * z, k * x, k * y, k * z + side)).reshape(3, 3)


def shares(informations: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return the weights (N, 3, 3), which sum to one, of independent measurements of a point with inverse covariances
    (N, 3, 3), and the covariance (3, 3) of their mean."""
    covariance = np.linalg.inv(np.add.reduce(informations))
    return covariance @ informations, covariance


def weighted(weights: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the means (3, K) of measurements (N, 3, K) by weights (N, 3, 3)."""
    mean: np.ndarray = np.add.reduce(weights @ values)
    return mean


def voice_covariance(position: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Return the covariance (3, 3) m^2 of a place in the direction of a voice, of which the distance is not known.

    The second moments of a speaker VOICE_M +- VOICE_SPREAD_M away about the place that is told.

    Parameters
    ----------
    position, origin : numpy.ndarray, shape (3,)
        The place that is told, and the microphones, m, in one frame.
    """
    ray = position - origin
    length = float(np.linalg.norm(ray))
    unit = ray / max(length, 1e-6)
    length = min(length, FARTHEST_VOICE_M)
    side = VOICE_RAD ** 2 * (VOICE_M ** 2 + VOICE_SPREAD_M ** 2)
    along = VOICE_SPREAD_M ** 2 + (VOICE_M - length) ** 2
    return side * np.eye(3) + (along - side) * np.outer(unit, unit)


def aged(covariance: np.ndarray, elapsed: Union[float, np.ndarray]) -> np.ndarray:
    """Return the covariances (..., 3, 3) m^2 of places that were told `elapsed` s (...) ago: their human may have
    walked away.

    A velocity that is forgotten after AWAY_S (L. Ornstein and G. Uhlenbeck, Physical Review 36, 1930).
    """
    times = np.maximum(elapsed, 0.0) / AWAY_S
    spread = 2.0 * (AWAY_MPS * AWAY_S) ** 2 * (times - 1.0 + np.exp(-times))
    return covariance + np.asarray(spread)[..., None, None] * _EYE


def aged_in(covariance: np.ndarray, elapsed: float, optical: bool) -> np.ndarray:
    """Return the same of one place (3, 3): in a frame whose z points up people walk away to the sides only. optical:
    the frame is a camera's, which may be tilted by any angle, so that none of its axes is the vertical."""
    grown = aged(covariance, elapsed)
    if not optical:
        grown[2, 2] = min(grown[2, 2], covariance[2, 2] + HEIGHT_CHANGED_M ** 2)
    return grown


def ellipse(covariance: np.ndarray) -> Tuple[float, float, float]:
    """Return half axes (m, the longer one first) and turn (rad) of the ellipse that holds 95 % of a covariance (2, 2)
    m^2."""
    values, vectors = np.linalg.eigh(covariance)
    minor, major = np.sqrt(CHI_SQUARE_95 * np.maximum(values, 0.0)).tolist()
    return major, minor, math.atan2(float(vectors[1, 1]), float(vectors[0, 1]))


def squared_distances(positions: np.ndarray, covariances: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return the squared Mahalanobis distances (M,) of pairs (M, 2), as rows, of places (N, 3), covariances
    (N, 3, 3)."""
    apart = positions[pairs[:, 0]] - positions[pairs[:, 1]]
    return _squares(apart, covariances[pairs[:, 0]] + covariances[pairs[:, 1]])


def crossing_distances(positions: np.ndarray, covariances: np.ndarray, origins: np.ndarray,
                       pairs: np.ndarray) -> np.ndarray:
    """Return the same with the errors along the rays that places have when both of a pair are one human's: these grow
    with the true distance, not with that which an error has shortened.

    origins: (N, 3) m, of the rays; NaN where a place is not told by one ray.
    """
    first, second = pairs.T
    informations = np.linalg.inv(covariances)
    told = (informations @ positions[:, :, None])[..., 0]
    middles = np.linalg.solve(informations[first] + informations[second],
                              (told[first] + told[second])[..., None])[..., 0]
    rays = positions - origins
    squares = np.maximum((rays * rays).sum(axis=1), LEAST_SQUARE)
    along = np.einsum("ni,nij,nj->n", rays, covariances, rays) / squares ** 2
    both = covariances[first] + covariances[second]
    for of in (first, second):
        longer = ((middles - origins[of]) ** 2).sum(axis=1) / squares[of]
        added = (np.clip(longer, 0.3, 3.0) - 1.0) * along[of]
        both += np.nan_to_num(added[:, None, None] * rays[of, :, None] * rays[of, None])
    return _squares(positions[first] - positions[second], both)


def _squares(offsets: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Squared lengths (M,) of offsets (M, 3) in deviations of covariances (M, 3, 3)."""
    squares: np.ndarray = (offsets * np.linalg.solve(covariances, offsets[..., None])[..., 0]).sum(axis=1)
    return squares


def walk_evidence(old: Walk, new: Walk, place: Optional[Estimate] = None) -> float:
    """Return the logarithm of the likelihood ratio of a walk that goes on from another one, against somebody else's who
    comes up near there; place: where several sensors saw the end of the old one."""
    away = new.stamp - old.stamp
    position, covariance, shared = old.position, old.covariance, old.shared
    if place is not None:
        position, covariance, shared = place.position, place.covariance, np.zeros(3)
    spread = (CHANGE_MPS * away) ** 2
    both = np.outer(shared, new.shared)
    of_place = covariance + away ** 2 * old.velocity_covariance + new.covariance - both - both.T + np.diag(
        [spread, spread, HEIGHT_M ** 2])
    of_change = (old.velocity_covariance + new.velocity_covariance)[:2, :2] + CHANGE_MPS ** 2 * np.eye(2)
    other = of_place + np.diag([OTHER_M ** 2, OTHER_M ** 2, OTHER_HEIGHT_M ** 2])
    offset, changed = new.position - position - away * old.velocity, (new.velocity - old.velocity)[:2]
    return (_log_normal(offset, of_place) + _log_normal(changed, of_change) - _log_normal(offset, other)
            - _log_normal(changed, of_change + OTHER_MPS ** 2 * np.eye(2)))


def _log_normal(offset: np.ndarray, covariance: np.ndarray) -> float:
    """Logarithm of the density of a normal distribution, but for a constant."""
    return -0.5 * float(offset @ np.linalg.solve(covariance, offset) + np.linalg.slogdet(covariance)[1])


class SensorTrack:
    """Places of one feature as one sensor tells them; stamps in s, places in m in the reference frame.

    began, ended: stamps of the first and the last place of the present stretch, which has no gap. appearance: (5, B),
    the colours of the clothes, see `view_groups.clothes_evidence`; None where they are not known.
    """

    def __init__(self, sensor: str) -> None:
        self.sensor = sensor
        self.appearance: Optional[np.ndarray] = None
        self._reset()

    def _reset(self) -> None:
        self.began = self.ended = -math.inf
        self.source = 0
        self._stamps: Dict[int, float] = {}
        self.covariance = _EYE
        self.origin: Optional[np.ndarray] = None
        self._times: List[float] = []
        self._places = np.empty((_CAPACITY, 3))
        self._first = 0                         # of the rows that are used
        self._forget_derived()

    def _forget_derived(self) -> None:
        self._velocity: Optional[np.ndarray] = None
        self._resting: Optional[np.ndarray] = None
        self._information: Optional[np.ndarray] = None
        self._moments: Dict[Tuple[int, int], Tuple[float, Estimate]] = {}

    @property
    def length(self) -> float:
        """Length of the present stretch, s."""
        return self.ended - self.began

    def add(self, source: int, position: np.ndarray, covariance: np.ndarray, origin: Optional[np.ndarray],
            stamp: float) -> None:
        """Take a place; one not newer than the last is left out. A lower `source` is a better one, and goes before
        others.

        position: (3,) m, covariance: (3, 3) m^2, origin: (3,) m, of the sensor; None where it is not known.
        """
        if stamp < self._stamps.get(source, -math.inf) - WINDOW_S:
            self._reset()           # time has jumped back
        self._stamps[source] = stamp
        fresh = stamp - self.ended <= FRESH_S
        if fresh and source > self.source or stamp <= self.ended:
            return
        if not fresh:
            self.began = stamp
        if not fresh or source != self.source:
            self._times, self._first = [], 0
        self.source, self.ended, self.covariance, self.origin = source, stamp, covariance, origin
        self._append(stamp, position)
        self._forget_derived()

    def _append(self, stamp: float, position: np.ndarray) -> None:
        if len(self._times) == len(self._places):
            first = bisect_left(self._times, stamp - WALK_S)
            kept = self._places[first:]
            self._places = np.concatenate([kept, np.empty((max(_CAPACITY, 2 * len(kept)), 3))])
            self._times, self._first = self._times[first:], 0
        self._places[len(self._times)] = position
        self._times.append(stamp)

    def near(self, stamp: float) -> Tuple[float, Estimate]:
        """Return the mean place of the moment around `stamp` (s), or of the last one before, and its time (s)."""
        times, end = self._times, len(self._times)
        start = bisect_left(times, self.ended - WINDOW_S, self._first)
        middle = bisect_left(times, stamp, start)
        if middle == end or middle > start and stamp - times[middle - 1] <= times[middle] - stamp:
            middle -= 1
        first = bisect_left(times, times[middle] - MOMENT_S, start)
        last = bisect_left(times, times[middle] + MOMENT_S + 1e-9, start)
        found = self._moments.get((first, last))
        if found is None:
            found = self._moments[first, last] = (
                sum(times[first:last]) / (last - first),
                Estimate(np.add.reduce(self._places[first:last]) / (last - first), self.velocity, self.covariance))
        return found

    @property
    def information(self) -> np.ndarray:
        """Inverse (3, 3) of the covariance, 1/m^2."""
        if self._information is None:
            self._information = np.linalg.inv(self.covariance)
        return self._information

    @property
    def resting_place(self) -> np.ndarray:
        """Mean of the last places, (3,) m: more exact than that of a moment for who stands."""
        if self._resting is None:
            _, places = self._since(REST_S)
            self._resting = np.add.reduce(places) / len(places)
        return self._resting

    def at(self, stamp: float) -> Estimate:
        """Where the person is at a time (s) near or after the last place, walking on as it went."""
        time, place = self.near(stamp)
        return place._replace(position=place.position + place.velocity * (stamp - time))

    def walk(self, begins: bool, seconds: float = WALK_S) -> Walk:
        """How the person walks, by the places of the last `seconds`, and where at the first of these (begins) or the
        last.

        The error of a place changes slowly, so that many places tell a velocity little better than two.
        """
        times, places = self._since(seconds)
        at_end = times <= times[0] + 2.0 * MOMENT_S if begins else times >= times[-1] - 2.0 * MOMENT_S
        offset, span = times - times.mean(), max(float(times[-1] - times[0]), SHORTEST_S)
        velocity = offset @ places / max(float(offset @ offset), 1e-6)
        position = places[at_end].mean(axis=0)
        return Walk(float(times[at_end].mean()), position, self.covariance, velocity,
                    (WALK_DRIFT / span) ** 2 * self.covariance, self.shared_error(position))

    def shared_error(self, position: np.ndarray) -> np.ndarray:
        """The part of the error of a place (3,) m that other cameras have, too, each along its ray, (3,) m."""
        if self.origin is None:
            return np.zeros(3)
        ray = position - self.origin
        unit = ray / max(math.sqrt(ray @ ray), 1e-6)
        shared: np.ndarray = math.sqrt(OF_PERSON * max(unit @ self.covariance @ unit, 0.0)) * unit
        return shared

    @property
    def velocity(self) -> np.ndarray:
        """Slope of a straight line through the places of the last moments, (3,) m/s."""
        if self._velocity is not None:
            return self._velocity
        times, places = self._since(WINDOW_S)
        velocity = np.zeros(3)
        if times[-1] - times[0] >= SHORTEST_S:
            offset = times - np.add.reduce(times) / len(times)
            velocity = offset @ places / float(offset @ offset)
            velocity = velocity * min(1.0, FASTEST_MPS / max(math.sqrt(velocity @ velocity), 1e-9))
        self._velocity = velocity
        return velocity

    def _since(self, seconds: float) -> Tuple[np.ndarray, np.ndarray]:
        """Times (N,) s and places (N, 3) m of the last `seconds`."""
        first = bisect_left(self._times, self.ended - seconds, self._first)
        return np.array(self._times[first:]), self._places[first:len(self._times)]


@dataclass
class Scale:
    """How much farther away somebody is than one feature tells at one sensor, with its variance: learnt where rays
    cross."""

    value: float = 1.0
    variance: float = math.inf

    def learn(self, value: float, variance: float) -> None:
        """Take a measurement; those of one second are no better than one."""
        if not math.isfinite(self.variance):
            self.value, self.variance = value, variance
            return
        gain = max(0.02, self.variance / (self.variance + 10.0 * variance))
        self.value += gain * (value - self.value)
        self.variance = max(0.03 ** 2, (1.0 - gain) * self.variance)


def place_by_track(track: SensorTrack, stamp: float, scales: Mapping[Tuple[str, int], Scale]) -> Estimate:
    """Where a human is at `stamp` (s) by one track; scales: what was learnt of this human, by sensor and source."""
    time, found = track.near(stamp)
    found = _learnt(track, found, scales) or found
    return found._replace(position=found.position + found.velocity * (stamp - time))


def _learnt(track: SensorTrack, found: Estimate, scales: Mapping[Tuple[str, int], Scale]) -> Optional[Estimate]:
    """What a track tells by the scale that was learnt of it; None where that is not known, or no better."""
    scale = scales.get((track.sensor, track.source))
    if scale is None or track.origin is None or scale.variance > LEARNT_VARIANCE:
        return None
    ray = found.position - track.origin
    square = max(float(ray @ ray), 1e-6)
    less = float(ray @ found.covariance @ ray) / square - (scale.variance + FIXED_VARIANCE) * square
    if less <= 0.0:
        return None
    return Estimate(track.origin + scale.value * ray, scale.value * found.velocity,
                    found.covariance - less / square * (ray[:, None] * ray))


def fuse_tracks(tracks: List[SensorTrack], stamp: float, scales: Mapping[Tuple[str, int], Scale]) -> Estimate:
    """Where a human is at `stamp` (s) by several tracks, of the heads only, where there are some."""
    heads = [track for track in tracks if track.source < 2] or tracks
    if len(heads) == 1:
        return place_by_track(heads[0], stamp, scales)
    by_sensor = Counter(track.sensor for track in heads)
    informations, values, ahead = [], [], []
    for track in heads:
        time, found = track.near(stamp)
        learnt, resting = _learnt(track, found, scales), track.resting_place
        information = track.information
        if learnt is not None:
            resting, found, information = resting + learnt.position - found.position, learnt, np.linalg.inv(
                learnt.covariance)
        informations.append(information / (1.0 + (by_sensor[track.sensor] - 1) * SAME_CAMERA))
        values.append((found.position, found.velocity, resting))
        ahead.append(stamp - time)
    # One view tells the velocity along its ray badly, all together well.
    weights, covariance = shares(np.array(informations))
    place, velocity, resting = weighted(weights, np.array(values).swapaxes(1, 2)).T
    if float(velocity @ velocity) < STANDING_MPS ** 2:
        velocity = np.zeros(3)
    else:
        place = place + np.add.reduce(np.array(ahead)[:, None, None] * weights) @ velocity
    away = resting - place
    return Estimate(place + away / (1.0 + (float(away @ away) / RESTING_M ** 2) ** 2), velocity, covariance)
