"""Where sound comes from: peaks of the steered response power (`DirectionFinder`), followed over time
(`DirectionTracker`).

The response is SRP-PHAT, made robust against overlapping speech and echoes.
Phase transform: C. Knapp and G. Carter, "The generalized correlation method for estimation of time delay", IEEE
Transactions on Acoustics, Speech and Signal Processing 24 (1976). Steering it: J. DiBiase, "A high-accuracy,
low-latency technique for talker localization in reverberant environments", PhD thesis, Brown University (2000).
Each bin of each frame mostly belongs to one speaker, so its response is sharpened before bins are added
(C. Blandin, A. Ozerov and E. Vincent, Signal Processing 92, 2012, find this best for several speakers), and bins
are weighted by how far they exceed the noise and the echoes of earlier frames.

A followed source has a direction, an angular velocity and a variance (a Kalman filter with constant gain for the
velocity, in the plane tangent to the sphere; the angles are small enough for that). Peaks are assigned to sources at
the least total distance, so that two speakers who pass each other keep their own motions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Sequence

import numpy as np

from hri_pipeline.core.audio.array import SPEED_OF_SOUND, MicrophoneArray
from hri_pipeline.core.audio.spectra import FREQUENCIES, HOP, RATE
from hri_pipeline.core.tracks import assign

LOWEST, HIGHEST = 200.0, 6000.0
"""Band (Hz) that is used: below it the phases on a robot's head hardly differ, above it there is little speech."""
SHARPNESS = 30.0
"""Exponent on the response (0..1, below its maximum) of a bin."""
MAX_BINS = 72
"""Number of bins used per frame: those with the largest weights."""
MEMORY_TIME = 0.15
"""Time constant (s) of the sum of responses over frames."""
MIN_SEPARATION = np.radians(25.0)
"""Smallest angle between two peaks: an array of the size of a head does not resolve closer ones."""
NEAR = np.radians(10.0)
"""Within this angle the height of the response belongs to a source."""
MIN_STRENGTH = 0.03
"""Smallest height of a peak. In rooms with a reverberation time of 0.3 s the direct sound of one or two speakers mostly
reaches 0.09 to 0.2, an echo or a random peak 0.04 to 0.06; without echoes a single speaker reaches 0.5."""
LEAST_SHARE = 0.15
"""A peak has at least this share of the height of the strongest: the side lobes of a small array reach 0.1."""
LOW_BAND = 1500.0
"""Bins below the spatial aliasing frequency of the closest microphones have no side lobes: they distinguish a direction
from its ghost. Arrays of distant microphones have no such bins; for them this is the limit (Hz)."""
LEAST_LOW_SHARE = 0.1
"""Smallest share of the height of a true peak that comes from the low band. A hissing consonant has no low band; it has
a ghost at the mirrored azimuth that is two thirds as strong as itself."""
MIN_BINS = 6.0
"""A frame with less total weight is silence: white noise reaches this."""


@dataclass(frozen=True)
class Peak:
    """A direction from which sound comes.

    Attributes
    ----------
    direction : np.ndarray
        (3,) unit vector, in the microphone frame.
    strength : float
        0 to 1, by how much more of the sound points there than into an average direction.
    confirmed : bool
        Whether low frequencies, which have no side lobes, show the peak as well.
    """

    direction: np.ndarray
    strength: float
    confirmed: bool = True


class DirectionFinder:
    """Steered response power over the grid of an array: `add` takes frames, `peaks` returns the directions that stand
    out.

    Parameters
    ----------
    array : MicrophoneArray
    max_peaks : int
    """

    def __init__(self, array: MicrophoneArray, max_peaks: int = 4) -> None:
        self._array = array
        self._max_peaks = max_peaks
        self._band = np.flatnonzero((FREQUENCIES >= LOWEST) & (FREQUENCIES <= HIGHEST))
        steering = array.steering(array.directions, FREQUENCIES[self._band])
        # (bins, D, C): one small matrix for each bin.
        self._steering = np.ascontiguousarray(steering.conj() / array.channels)
        apart = np.linalg.norm(array.positions[:, None] - array.positions[None], axis=2)
        lowest_lobe = SPEED_OF_SOUND / (2.0 * float(apart[apart > 0.0].min()))
        self._is_low = (FREQUENCIES[self._band] < max(LOW_BAND, lowest_lobe)).astype(np.float32)
        self._near = array.directions @ array.directions.T > np.cos(MIN_SEPARATION)
        self._keep = float(np.exp(-HOP / RATE / MEMORY_TIME))
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        # Sums of all bins, and of those of the low band.
        self._maps = np.zeros((2, len(self._array.directions)), dtype=np.float32)
        self._weight = 0.0

    @property
    def weight(self) -> float:
        """Total weight of the bins per frame, over the last frames."""
        return self._weight * (1.0 - self._keep)

    def add(self, spectrum: np.ndarray, bin_weights: np.ndarray) -> None:
        """Add a frame.

        Parameters
        ----------
        spectrum : np.ndarray
            (C, BINS) complex.
        bin_weights : np.ndarray
            (BINS,) weight of each bin, 0 to 1, see NoiseSpectrum.update.
        """
        self._maps *= self._keep
        self._weight *= self._keep
        weights = bin_weights[self._band]
        chosen = np.flatnonzero(weights > 0.05)
        if len(chosen) > MAX_BINS:
            chosen = chosen[np.argpartition(weights[chosen], -MAX_BINS)[-MAX_BINS:]]
        if float(weights.sum()) < MIN_BINS:
            return
        sound = spectrum[:, self._band[chosen]].T
        phases = sound / np.maximum(np.abs(sound), 1e-12)
        steered = (self._steering[chosen] @ phases[:, :, None])[:, :, 0]
        power = steered.real ** 2 + steered.imag ** 2
        power -= power.max(axis=1, keepdims=True)
        votes = np.exp(SHARPNESS * power, out=power)
        # Bins whose phases hardly differ between directions vote for all of them: subtract the mean.
        weights = weights[chosen]
        both = np.stack([weights, weights * self._is_low[chosen]]) @ votes
        self._maps += both - both.mean(axis=1, keepdims=True)
        self._weight += float(weights.sum())

    def height(self, direction: np.ndarray) -> float:
        """Return the height of the response near a direction ((3,) unit): above 0 when more of the sound than on
        average comes from there, a peak or not."""
        near = self._array.directions @ direction > np.cos(NEAR)
        return float(self._heights()[near].max()) if near.any() else 0.0

    def _heights(self) -> np.ndarray:
        # A frame with few bins must not count as much as one with many: add the weight of 4 bins.
        heights: np.ndarray = self._maps[0] / (self._weight + 4.0 / (1.0 - self._keep))
        return heights

    def peaks(self) -> List[Peak]:
        """Return the directions that stand out, strongest first."""
        heights = self._heights()
        left = heights.copy()
        found: List[Peak] = []
        while len(found) < self._max_peaks:
            index = int(left.argmax())
            if not left[index] >= (max(MIN_STRENGTH, LEAST_SHARE * found[0].strength) if found else MIN_STRENGTH):
                break
            direction = self._between(heights, index)
            # Where a peak was removed, its shoulder is highest at the border: that is not a peak.
            if not any(direction @ peak.direction > np.cos(MIN_SEPARATION) for peak in found) \
                    and heights[index] >= heights[self._neighbours(index)].max():
                confirmed = bool(self._maps[1, index] >= LEAST_LOW_SHARE * self._maps[0, index])
                found.append(Peak(direction, min(1.0, float(heights[index])), confirmed))
            left[self._near[index]] = -1.0
        return found

    def _neighbours(self, index: int) -> List[int]:
        rows, columns = self._array.grid_shape
        row, column = divmod(index, columns)
        places = [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
        return [r * columns + c % columns for r,
                c in places if 0 <= r < rows and (self._array.wraps or 0 <= c < columns)]

    def _between(self, heights: np.ndarray, index: int) -> np.ndarray:
        """Return the direction (3,) of the top of the parabolas through a point of the grid and its neighbours."""
        grid = heights.reshape(self._array.grid_shape)
        row, column = divmod(index, grid.shape[1])
        return self._array.direction_between(row + _top(grid[:, column], row, False),
                                             column + _top(grid[row], column, self._array.wraps))


def _top(values: np.ndarray, index: int, wraps: bool) -> float:
    """Return the maximum of the parabola through values[index] and its neighbours, -0.5 to 0.5 from the index."""
    before, after = (index - 1) % len(values), (index + 1) % len(values)
    if not wraps and (index == 0 or index == len(values) - 1):
        return 0.0
    left, middle, right = float(values[before]), float(values[index]), float(values[after])
    bend = left - 2.0 * middle + right
    return 0.0 if bend >= 0.0 else float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))


GATE, WIDEST_GATE = math.radians(22.0), math.radians(35.0)
"""Largest angle between a source and its peak: for one that was just heard, and for one whose direction has become
uncertain."""
GATE_SDS = 3.0
DIRECTION_NOISE = math.radians(4.0)
"""Process noise: standard deviation (rad) of the direction after one second without measurements."""
PEAK_SD = math.radians(5.0)
USUAL_STRENGTH = 0.1
"""Standard deviation (rad) of a peak of the usual strength; that of weaker ones is larger in proportion."""
BIAS_SD = math.radians(2.5)
"""Error (rad) by echoes and the height of the speaker.

It is constant while nobody moves, so it does not average out.
"""
VELOCITY_GAIN, VELOCITY_TIME = 0.01, 0.7
"""Largest gain of the velocity, and time constant (s) of its decay while the source is not heard."""
OUTLIER_ANGLE = math.radians(12.0)
"""A peak at this distance has the weight 0.61: it may be a mixture of two speakers."""
MAX_SPEED = math.radians(120.0)
HEARD_STRENGTH = 0.03
"""A peak of this strength shows that the source is active; weaker ones may be random, and only continue a source. In
rooms with a reverberation time of 0.5 s half of the peaks of one of three speakers are below 0.08."""
CHANCE_STRENGTH = 0.04
BIRTH_SCORE, CROWDED_SCORE, CROWDED = 0.15, 0.3, math.radians(40.0)
"""Score from which a candidate is a source: the sum of its peaks' strengths above CHANCE_STRENGTH. The larger score
holds within the angle CROWDED (rad) of another source: between two speakers there are sometimes false peaks."""
CANDIDATE_TIME = 0.3
"""A candidate without a peak for this time (s) is dropped."""
ACTIVE_TIME, OVERLAP_TIME = 0.1, 1.1
"""A source is active for so long (s) after its last peak: alone, and while somebody else is heard as well. Who talks at
the same time covers a peak for 0.3 to 0.5 s; where one speaker takes over from another, only one of them has peaks."""
TOGETHER_TIME = 0.3
"""Two sources that were both heard within this time (s) are heard at the same time."""


@dataclass(frozen=True)
class TrackedSource:
    """A followed source.

    Attributes
    ----------
    key : int
        Unique; never given to another source.
    direction : np.ndarray
        (3,) unit vector, in the microphone frame.
    sd : float
        rad, standard deviation of the direction.
    active : bool
        Whether it was heard within the last ACTIVE_TIME, or OVERLAP_TIME while several are heard.
    together : bool
        Whether several sources are heard at the same time.
    heard_at : float
        s, when it was last heard.
    heard_since : float
        s, when it was first heard after a pause of CANDIDATE_TIME.
    """

    key: int
    direction: np.ndarray
    sd: float
    active: bool
    together: bool
    heard_at: float
    heard_since: float


class _Track:
    """State of one source or candidate."""

    def __init__(self, peak: Peak, stamp: float) -> None:
        self.key: Optional[int] = None
        self.direction = peak.direction
        self.velocity = np.zeros(3)
        self.variance = _variance(peak)
        self.born, self.since, self.seen, self.heard = stamp, stamp, stamp, stamp
        self.score = 0.0
        self._raise_score(peak)

    def _raise_score(self, peak: Peak) -> None:
        if peak.confirmed:
            self.score = min(1.0, self.score + peak.strength - CHANCE_STRENGTH)

    def predict(self, step: float, stamp: float) -> None:
        self.direction = _unit(self.direction + step * self.velocity)
        # Keep the velocity tangent to the sphere.
        self.velocity = self.velocity - float(self.velocity @ self.direction) * self.direction
        if stamp - self.seen > ACTIVE_TIME:
            self.velocity = math.exp(-step / VELOCITY_TIME) * self.velocity
        self.variance += step * DIRECTION_NOISE ** 2

    @property
    def gate(self) -> float:
        return min(WIDEST_GATE, max(GATE, GATE_SDS * math.sqrt(self.variance)))

    def take(self, peak: Peak, stamp: float, step: float) -> None:
        away = peak.direction - float(peak.direction @ self.direction) * self.direction
        weight = math.exp(-0.5 * float(away @ away) / OUTLIER_ANGLE ** 2)
        gain = weight * self.variance / (self.variance + _variance(peak))
        self.direction = _unit(self.direction + gain * away)
        if step > 0.0:
            velocity = self.velocity + min(VELOCITY_GAIN, gain * gain / (2.0 - gain)) / step * away
            self.velocity = velocity * min(1.0, MAX_SPEED / max(1e-9, math.sqrt(float(velocity @ velocity))))
        self.variance *= 1.0 - gain
        self.since = stamp if stamp - self.seen > CANDIDATE_TIME else self.since
        self.seen = stamp
        if peak.strength >= HEARD_STRENGTH:
            self.heard = stamp
        self._raise_score(peak)


class DirectionTracker:
    """Follows sources through the peaks of successive frames and gives each a constant key.

    Parameters
    ----------
    birth_time : float
        s, for how long a candidate must be heard before it is a source.
    memory : float
        s, after which a silent source is forgotten.
    max_sources : int

    Raises
    ------
    ValueError
        For a negative time, or less than one source.
    """

    def __init__(self, birth_time: float, memory: float, max_sources: int) -> None:
        if not (birth_time >= 0.0 and memory > 0.0 and math.isfinite(birth_time + memory)):
            raise ValueError("birth_time must be 0 s or more and memory above 0 s, got {!r} and {!r}".format(
                birth_time, memory))
        if max_sources < 1:
            raise ValueError("max_sources must be at least 1, got {!r}".format(max_sources))
        self._birth_time, self._memory, self._max_sources = birth_time, memory, max_sources
        self._tracks: List[_Track] = []
        self._next_key = 1
        self._stamp: Optional[float] = None

    def reset(self) -> None:
        """Forget all sources. Their keys are not used again."""
        self._tracks = []
        self._stamp = None

    def update(self, peaks: Sequence[Peak], stamp: float) -> List[TrackedSource]:
        """Add the peaks at `stamp` (s) and return all remembered sources, oldest first."""
        step = 0.0 if self._stamp is None else max(0.0, stamp - self._stamp)
        self._stamp = stamp
        self._tracks = [track for track in self._tracks if not self._forgotten(track, stamp)]
        for track in self._tracks:
            track.predict(step, stamp)
        # Sources first: a candidate must not take the peak of a source near it.
        rest = list(peaks)
        for confirmed in (True, False):
            rest = self._assign([t for t in self._tracks if (t.key is not None) == confirmed], rest, stamp, step)
        self._tracks += [_Track(peak, stamp) for peak in rest if peak.strength > CHANCE_STRENGTH]
        self._confirm(stamp)
        sources = [track for track in self._tracks if track.key is not None]
        together = sum(stamp - track.heard < TOGETHER_TIME for track in sources) >= 2
        lasting = OVERLAP_TIME if together else ACTIVE_TIME
        return [TrackedSource(track.key, track.direction, math.sqrt(track.variance + BIAS_SD ** 2),
                              stamp - track.heard <= lasting, together, track.heard, track.since)
                for track in sources if track.key is not None]

    def _forgotten(self, track: _Track, stamp: float) -> bool:
        if track.key is None:
            return stamp - track.seen > CANDIDATE_TIME
        return stamp - track.heard > self._memory

    def _assign(self, tracks: List[_Track], peaks: List[Peak], stamp: float, step: float) -> List[Peak]:
        """Update the tracks with their nearest peaks; return the peaks that belong to none."""
        if not tracks or not peaks:
            return peaks
        angles = _angles(np.array([track.direction for track in tracks]), np.array([peak.direction for peak in peaks]))
        gates = np.array([track.gate for track in tracks])
        cost = np.where(angles <= gates[:, None], angles, np.inf)
        pairs = assign(cost, WIDEST_GATE)
        for row, column in pairs:
            tracks[row].take(peaks[column], stamp, step)
        taken = {column for _, column in pairs}
        return [peak for column, peak in enumerate(peaks) if column not in taken]

    def _confirm(self, stamp: float) -> None:
        """Give keys to the candidates that have been heard long and clearly enough."""
        for track in self._tracks:
            if track.key is not None or stamp - track.born < self._birth_time - 1e-9:
                continue
            crowded = any(track.direction @ other.direction > math.cos(CROWDED)
                          for other in self._tracks if other.key is not None)
            if track.score < (CROWDED_SCORE if crowded else BIRTH_SCORE):
                continue
            if not self._make_room(stamp):
                return
            track.key = self._next_key
            self._next_key += 1

    def _make_room(self, stamp: float) -> bool:
        """Remove the source that has been silent longest if there are too many. Return False when all are active."""
        sources = [track for track in self._tracks if track.key is not None]
        if len(sources) < self._max_sources:
            return True
        quiet = min(sources, key=lambda track: track.heard)
        if stamp - quiet.heard <= 1.0:
            return False
        self._tracks = [track for track in self._tracks if track is not quiet]
        return True


def _variance(peak: Peak) -> float:
    return (PEAK_SD * max(1.0, USUAL_STRENGTH / max(1e-3, peak.strength))) ** 2


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles (N, M), rad, between unit vectors (N, 3) and (M, 3)."""
    return np.arccos(np.clip(a @ b.T, -1.0, 1.0))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / math.sqrt(float(vector @ vector))
