"""Directions followed over time: which peak belongs to which source, when a source is born and when it is forgotten.

A source has a direction, an angular velocity and a variance (a Kalman filter with constant gain for the velocity, in
the plane tangent to the sphere; angles are small enough for that). Peaks are assigned to sources at the least total
distance, so each of two speakers who pass each other goes on along its own motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import List, Optional, Sequence

import numpy as np

from hri_pipeline.core.assignment import assign
from hri_pipeline.core.sound.sound_direction import Peak

GATE, WIDEST_GATE = math.radians(22.0), math.radians(35.0)
"""Largest angle between a source just heard and its peak, and for a source whose direction has become uncertain."""
GATE_SDS = 3.0
WANDER = math.radians(4.0)
"""A source may change its direction by this (rad) in one second without anybody having expected it."""
PEAK_SD = math.radians(5.0)
USUAL_STRENGTH = 0.1
"""Standard deviation of a peak of the usual strength; that of weaker ones is larger in proportion."""
BIAS_SD = math.radians(2.5)
"""What echoes and the height of the speaker put wrong for as long as nobody moves; it does not average out."""
VELOCITY_GAIN, VELOCITY_TIME = 0.01, 0.7
"""Largest gain of the velocity, and time (s) in which it fades while the source is not heard."""
SURPRISE = math.radians(12.0)
"""A peak so far away counts 0.61 times: it may be that of two speakers together."""
MAX_SPEED = math.radians(120.0)
HEARD_STRENGTH = 0.05
"""A peak of this strength says that the source sounds; weaker ones may be chance, and only continue a source."""
CHANCE_STRENGTH = 0.04
BIRTH_SCORE, CROWDED_SCORE, CROWDED = 0.15, 0.3, math.radians(40.0)
"""Sum of what the strengths of a candidate's peaks are above chance, from which on it is a source, and the same within
CROWDED of another source: between two speakers there is a peak now and then that is neither."""
CANDIDATE_TIME = 0.3
"""A candidate that has no peak for so long (s) is dropped."""
ACTIVE_TIME = 0.1


@dataclass(frozen=True)
class Source:
    """A followed source. key: of this source only; direction: (3,) unit; sd: rad; active: heard within the last 0.1 s;
    heard_at: s."""

    key: int
    direction: np.ndarray
    sd: float
    active: bool
    heard_at: float


class _Track:
    """State of one source or candidate."""

    def __init__(self, peak: Peak, stamp: float) -> None:
        self.key: Optional[int] = None
        self.direction = peak.direction
        self.velocity = np.zeros(3)
        self.variance = _variance(peak)
        self.born, self.seen, self.heard = stamp, stamp, stamp
        self.score = 0.0
        self._raise(peak)

    def _raise(self, peak: Peak) -> None:
        if peak.sure:
            self.score = min(1.0, self.score + peak.strength - CHANCE_STRENGTH)

    def predict(self, step: float, stamp: float) -> None:
        self.direction = _unit(self.direction + step * self.velocity)
        # Along the sphere: what points out of it now was a turn.
        self.velocity = self.velocity - float(self.velocity @ self.direction) * self.direction
        if stamp - self.seen > ACTIVE_TIME:
            self.velocity = math.exp(-step / VELOCITY_TIME) * self.velocity
        self.variance += step * WANDER ** 2

    @property
    def gate(self) -> float:
        return min(WIDEST_GATE, max(GATE, GATE_SDS * math.sqrt(self.variance)))

    def take(self, peak: Peak, stamp: float, step: float) -> None:
        away = peak.direction - float(peak.direction @ self.direction) * self.direction
        surprise = math.exp(-0.5 * float(away @ away) / SURPRISE ** 2)
        gain = surprise * self.variance / (self.variance + _variance(peak))
        self.direction = _unit(self.direction + gain * away)
        if step > 0.0:
            velocity = self.velocity + min(VELOCITY_GAIN, gain * gain / (2.0 - gain)) / step * away
            self.velocity = velocity * min(1.0, MAX_SPEED / max(1e-9, math.sqrt(float(velocity @ velocity))))
        self.variance *= 1.0 - gain
        self.seen = stamp
        if peak.strength >= HEARD_STRENGTH:
            self.heard = stamp
        self._raise(peak)


class DirectionTracker:
    """Turns the peaks of each moment into sources with keys that stay."""

    def __init__(self, birth_time: float, memory: float, max_sources: int) -> None:
        """birth_time: s over which a source must be heard before it is one; memory: s after which one that is not heard is
        forgotten. Raises ValueError for a negative time or no source.
        """
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
        """Forget all sources. Their keys are not given again."""
        self._tracks = []
        self._stamp = None

    def update(self, peaks: Sequence[Peak], stamp: float) -> List[Source]:
        """Take the peaks at `stamp` (s) in; returns all sources that are remembered, oldest first."""
        step = 0.0 if self._stamp is None else max(0.0, stamp - self._stamp)
        self._stamp = stamp
        self._tracks = [track for track in self._tracks if not self._forgotten(track, stamp)]
        for track in self._tracks:
            track.predict(step, stamp)
        # Sources first: a candidate beside a source must not take its peak.
        rest = list(peaks)
        for confirmed in (True, False):
            rest = self._assign([t for t in self._tracks if (t.key is not None) == confirmed], rest, stamp, step)
        self._tracks += [_Track(peak, stamp) for peak in rest if peak.strength > CHANCE_STRENGTH]
        self._confirm(stamp)
        return [Source(track.key, track.direction, math.sqrt(track.variance + BIAS_SD ** 2),
                       stamp - track.heard <= ACTIVE_TIME, track.heard)
                for track in self._tracks if track.key is not None]

    def _forgotten(self, track: _Track, stamp: float) -> bool:
        if track.key is None:
            return stamp - track.seen > CANDIDATE_TIME
        return stamp - track.heard > self._memory

    def _assign(self, tracks: List[_Track], peaks: List[Peak], stamp: float, step: float) -> List[Peak]:
        """Continue tracks; returns the peaks that belong to none."""
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
        """Make sources of the candidates that have been heard long and clearly enough."""
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
        """See to it that one more source may be there: the one that was silent longest goes. False when all sound."""
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
    """Angles (N, M) rad between unit vectors (N, 3) and (M, 3)."""
    return np.arccos(np.clip(a @ b.T, -1.0, 1.0))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / math.sqrt(float(vector @ vector))
