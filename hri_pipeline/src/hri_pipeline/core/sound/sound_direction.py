"""Where sound comes from: steered response power with phase transform (SRP-PHAT), made robust against overlap and echoes.

Phase transform: C. Knapp and G. Carter, "The generalized correlation method for estimation of time delay", IEEE
Transactions on Acoustics, Speech and Signal Processing 24 (1976). Steering it: J. DiBiase, "A high-accuracy,
low-latency technique for talker localization in reverberant environments", PhD thesis, Brown University (2000).
Each bin of each frame is mostly of one speaker only, so its response is sharpened before bins are added
(C. Blandin, A. Ozerov and E. Vincent, Signal Processing 92, 2012, find this best for several speakers), and bins
count by how much they stand out of the noise and of what the room still returns of the frames before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

import numpy as np

from hri_pipeline.core.sound.microphone_array import SPEED_OF_SOUND, MicrophoneArray
from hri_pipeline.core.sound.sound_spectra import FREQUENCIES, HOP, RATE

LOWEST, HIGHEST = 200.0, 6000.0
"""Band (Hz) that is looked at: lower has no differences in phase on a robot's head, higher little speech."""
SHARPNESS = 30.0
"""Exponent on the response (0..1, below its maximum) of a bin."""
MAX_BINS = 72
"""Bins looked at in one frame: those that stand out most."""
MEMORY_TIME = 0.15
"""Time constant (s) over which the responses of frames are added up."""
MIN_SEPARATION = np.radians(25.0)
"""Least angle between two peaks: closer ones are one peak of an array of the size of a head."""
MIN_STRENGTH = 0.03
"""A peak is one from this height on. In rooms with a reverberation time of 0.3 s the direct sound of one or two speakers
mostly reaches 0.09 to 0.2, an echo or a chance 0.04 to 0.06, without echoes a lone speaker 0.5."""
LEAST_SHARE = 0.15
"""A peak has at least this share of the strongest: the side lobes of a small array reach 0.1."""
LOW_BAND = 1500.0
"""Bins below this (Hz), and below the frequency from which on a wave fits between two neighbouring microphones in more than
one way, have no side lobes: they tell a direction from its ghost. Microphones far apart have none such; they have this band."""
LEAST_LOW_SHARE = 0.1
"""Part of the height of a peak that comes from the low band, if somebody is there. A hissing consonant has none, and a ghost at
the mirrored azimuth that is two thirds as strong as itself."""
MIN_BINS = 6.0
"""A frame in which fewer bins stand out is silence: white noise does as much."""


@dataclass(frozen=True)
class Peak:
    """A direction from which sound comes. direction: (3,) unit vector; strength: 0..1, by how much more of the sound
    points there than into an average direction; sure: low frequencies say so as well, which have no side lobes."""

    direction: np.ndarray
    strength: float
    sure: bool = True


class DirectionFinder:
    """Adds up what each frame tells about directions; `peaks` finds the directions that stand out."""

    def __init__(self, array: MicrophoneArray, max_peaks: int = 4) -> None:
        self._array = array
        self._max_peaks = max_peaks
        self._band = np.flatnonzero((FREQUENCIES >= LOWEST) & (FREQUENCIES <= HIGHEST))
        steering = array.steering(array.directions, FREQUENCIES[self._band])
        # (bins, D, C): one small matrix per bin.
        self._steering = np.ascontiguousarray(steering.conj() / array.channels)
        apart = np.linalg.norm(array.positions[:, None] - array.positions[None], axis=2)
        lowest_lobe = SPEED_OF_SOUND / (2.0 * float(apart[apart > 0.0].min()))
        self._is_low = (FREQUENCIES[self._band] < max(LOW_BAND, lowest_lobe)).astype(np.float32)
        self._near = array.directions @ array.directions.T > np.cos(MIN_SEPARATION)
        self._keep = float(np.exp(-HOP / RATE / MEMORY_TIME))
        self.reset()

    def reset(self) -> None:
        """Forget all frames."""
        # Of all bins, and of those of the low band.
        self._maps = np.zeros((2, len(self._array.directions)), dtype=np.float32)
        self._weight = 0.0

    @property
    def weight(self) -> float:
        """Number of bins per frame, lately, that stood out of noise and echoes."""
        return self._weight * (1.0 - self._keep)

    def add(self, spectrum: np.ndarray, sure: np.ndarray) -> None:
        """Take a frame in. spectrum: (C, BINS); sure: (BINS,) how much each bin counts, 0..1."""
        self._maps *= self._keep
        self._weight *= self._keep
        weights = sure[self._band]
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
        # Bins whose phases hardly differ between directions vote for all alike: take the mean out.
        weights = weights[chosen]
        both = np.stack([weights, weights * self._is_low[chosen]]) @ votes
        self._maps += both - both.mean(axis=1, keepdims=True)
        self._weight += float(weights.sum())

    def peaks(self) -> List[Peak]:
        """Return the directions that stand out, strongest first."""
        # A frame with few bins must not count as much as one with many: 4 bins of nothing in the denominator.
        heights = self._maps[0] / (self._weight + 4.0 / (1.0 - self._keep))
        left = heights.copy()
        found: List[Peak] = []
        while len(found) < self._max_peaks:
            index = int(left.argmax())
            if not left[index] >= (max(MIN_STRENGTH, LEAST_SHARE * found[0].strength) if found else MIN_STRENGTH):
                break
            direction = self._between(heights, index)
            # The shoulder of a peak is highest at the border of what that peak took away.
            if not any(direction @ peak.direction > np.cos(MIN_SEPARATION) for peak in found) \
                    and heights[index] >= heights[self._neighbours(index)].max():
                sure = bool(self._maps[1, index] >= LEAST_LOW_SHARE * self._maps[0, index])
                found.append(Peak(direction, min(1.0, float(heights[index])), sure))
            left[self._near[index]] = -1.0
        return found

    def _neighbours(self, index: int) -> List[int]:
        rows, columns = self._array.grid_shape
        row, column = divmod(index, columns)
        places = [(row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)]
        return [r * columns + c % columns for r, c in places if 0 <= r < rows and (self._array.wraps or 0 <= c < columns)]

    def _between(self, heights: np.ndarray, index: int) -> np.ndarray:
        """Direction (3,) of the top of parabolas through a point of the grid and its neighbours."""
        grid = heights.reshape(self._array.grid_shape)
        row, column = divmod(index, grid.shape[1])
        return self._array.direction_between(row + _top(grid[:, column], row, False),
                                             column + _top(grid[row], column, self._array.wraps))


def _top(values: np.ndarray, index: int, wraps: bool) -> float:
    """Where the parabola through values[index] and its neighbours is highest, -0.5..0.5 from index."""
    before, after = _ends(index, len(values))
    if not wraps and (index == 0 or index == len(values) - 1):
        return 0.0
    left, middle, right = float(values[before]), float(values[index]), float(values[after])
    bend = left - 2.0 * middle + right
    return 0.0 if bend >= 0.0 else float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5))


def _ends(index: int, count: int) -> Tuple[int, int]:
    return (index - 1) % count, (index + 1) % count
