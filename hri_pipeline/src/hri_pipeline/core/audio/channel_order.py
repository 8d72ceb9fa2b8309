"""Whether the channels of an array are in the order of its positions: else the directions of all voices are wrong, and
nothing else tells.

What is compared is the steered response power (SRP-PHAT, see core/audio/localisation.py) in its strongest direction,
with the channels as they are, and with two of them exchanged or one turned over; the channels as they are may fit
somebody near as well, of whom no plane wave comes. An order that turns or mirrors the array only turns or mirrors all
directions: no sound tells it.
"""

from __future__ import annotations

from itertools import combinations
from typing import Iterator, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.audio.array import SPEED_OF_SOUND, MicrophoneArray
from hri_pipeline.core.audio.localisation import HIGHEST, LOWEST, MIN_BINS
from hri_pipeline.core.audio.spectra import FREQUENCIES, RATE

LAG_STEP = 0.25
"""Samples between two lags of a correlation."""
HEIGHTS = (1.0, 0.8, 0.5)
"""Cosines of the elevations that are compared for arrays in one plane, whose own grid may have none."""
NEAR, NEAR_DIRECTIONS = (0.4, 0.6, 0.8, 1.2, 2.0, 10.0), 300
"""Distances from the centre, in extents of the array, and directions all around it, in which the channels as they are
may fit as well: of who is nearer than the array is wide another order fits better than any plane wave."""
PIECE_FRAMES, PIECES, JUDGED_EVERY = 16, 24, 8
"""Frames with sound in a piece (0.26 s and more), pieces that are compared, and new ones from one comparison to the
next: 10 to 15 s of speech."""
LEAST_RESPONSE = 0.5
"""Least mean response, 0 to 1, in the order that fits best: no order fits microphones of different delay, and in much
reverberation a wrong one may. One speaker in rooms with a reverberation time of 0.5 s reaches 0.55 to 0.85."""
BETTER, BETTER_SHARE = 1.1, 0.4
"""Another order fits if the response is so many times as strong, in the mean and in this share of the pieces: in some
directions several orders fit alike. Over channels in the right order none was better by 1.01, but by up to 1.6 of
somebody less than an array's width away, see NEAR; wrong ones are better by 1.02 to 2.8."""
_EQUAL = 1.01


def order_problem(order: Sequence[int], channels: Sequence[int], working: Sequence[int]) -> str:
    """Return what is wrong and how to correct it.

    Parameters
    ----------
    order : sequence of int
        ChannelOrder.found, of the microphones that work.
    channels : sequence of int
        Numbers of the channels in the order of all positions.
    working : sequence of int
        Indices in `channels` of those that work.
    """
    fitting = list(channels)
    for position, channel in zip(working, order):
        fitting[position] = channels[working[channel]]
    return "directions are wrong: the sound does not fit ~microphone_positions with ~microphone_channels: {}, and " \
           "better with {}; correct one of them, and clap in front: where the direction is not 0, turn or mirror the " \
           "positions".format(list(channels), fitting)


class _Fit(NamedTuple):
    """Positions (C,) of the channels, their signs (C,), and the strongest response (K,) of each piece with these."""

    places: np.ndarray
    signs: np.ndarray
    response: np.ndarray

    def is_better(self, other: _Fit) -> bool:
        """Tell whether this fits clearly better than another."""
        mean = float(self.response.mean())
        return (mean >= LEAST_RESPONSE and mean > BETTER * float(other.response.mean())
                and float(np.mean(self.response > BETTER * other.response)) >= BETTER_SHARE)


class ChannelOrder:
    """Compares the order of the channels of an array with the sound.

    Parameters
    ----------
    array : MicrophoneArray

    Attributes
    ----------
    found : tuple of int
        For each position the index of the channel that fits there, where the channels do not fit as they are; empty
        where they do, or nothing is known.
    """

    def __init__(self, array: MicrophoneArray) -> None:
        self.found: Tuple[int, ...] = ()
        self._channels = array.channels
        self._first, self._second = np.array(list(combinations(range(array.channels), 2))).T
        self._band = np.flatnonzero((FREQUENCIES >= LOWEST) & (FREQUENCIES <= HIGHEST))
        directions = array.directions[::2]
        if array.shape == "plane":
            directions = np.concatenate([factor * directions for factor in HEIGHTS])
        self._delays = array.delays(directions) * (RATE / LAG_STEP)
        points = np.concatenate([distance * array.extent * _all_around(NEAR_DIRECTIONS) for distance in NEAR])
        ways = np.linalg.norm(points[:, None] - (array.positions - array.centre), axis=2)
        self._near_delays = ways * (RATE / LAG_STEP / SPEED_OF_SOUND)
        self._widest = int(np.ceil(array.extent / SPEED_OF_SOUND * RATE / LAG_STEP)) + 1
        lags = np.arange(-self._widest, self._widest + 1) * (LAG_STEP / RATE)
        self._turns = np.exp(2j * np.pi * FREQUENCIES[self._band][:, None] * lags).astype(np.complex64)
        # Of the newest pieces, the correlation of each pair at each lag.
        self._pieces = np.zeros((PIECES, len(self._first), len(lags)), np.float32)
        self._count = 0
        self._begin_piece()

    def _begin_piece(self) -> None:
        self._cross = np.zeros((len(self._first), len(self._band)), np.complex64)
        self._weight = 0.0
        self._frames = 0

    def add(self, spectrum: np.ndarray, bin_weights: np.ndarray) -> None:
        """Add a frame (C, BINS) complex and the weights (BINS,) of its bins, 0 to 1, see NoiseSpectrum.update."""
        weights = bin_weights[self._band]
        if self._channels < 3 or float(weights.sum()) < MIN_BINS:
            return
        phases = spectrum[:, self._band]
        phases = phases / np.maximum(np.abs(phases), 1e-12)
        self._cross += weights * (phases[self._first] * phases[self._second].conj())
        self._weight += float(weights.sum())
        self._frames += 1
        if self._frames == PIECE_FRAMES:
            self._end_piece()

    def _end_piece(self) -> None:
        self._pieces[self._count % PIECES] = (self._cross @ self._turns).real / self._weight
        self._count += 1
        if self._count >= PIECES and self._count % JUDGED_EVERY == 0:
            self._judge(self._pieces)
        self._begin_piece()

    def _judge(self, pieces: np.ndarray) -> None:
        """Compare the order as it is with others, from pieces (K, pairs, lags)."""
        places, signs = np.arange(self._channels), np.ones(self._channels, np.float32)
        given = best = self._fit(pieces, places, signs)
        while True:
            other = max((self._fit(pieces, *change) for change in _changes(best.places, best.signs)),
                        key=lambda fit: float(fit.response.sum()))
            if float(other.response.sum()) <= _EQUAL * float(best.response.sum()):
                break
            best = other
        if best.is_better(given) and best.is_better(self._fit(pieces, places, signs, self._near_delays)):
            # Where signs alone are wrong, the order is right.
            order = np.argsort(best.places)
            self.found = tuple(order.tolist()) if (order != np.arange(self._channels)).any() else ()
        elif self.found and given.is_better(self._fit(pieces, np.argsort(self.found), given.signs)):
            self.found = ()

    def _fit(self, pieces: np.ndarray, places: np.ndarray, signs: np.ndarray,
             delays: Optional[np.ndarray] = None) -> _Fit:
        """Return how these places and signs fit. delays: (D, C) steps, those of plane waves without."""
        delays = (self._delays if delays is None else delays)[:, places]
        lags = np.rint(delays[:, self._first] - delays[:, self._second]).astype(int) + self._widest
        total = np.zeros((len(pieces), len(lags)), np.float32)
        for pair, sign in enumerate(signs[self._first] * signs[self._second]):
            total += sign * pieces[:, pair, lags[:, pair]]
        return _Fit(places, signs, total.max(axis=1) / len(self._first))


def _all_around(count: int) -> np.ndarray:
    """Return unit vectors (count, 3), spread evenly: a spiral by the golden angle."""
    heights = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turns = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    radii = np.sqrt(1.0 - heights ** 2)
    return np.stack([radii * np.cos(turns), radii * np.sin(turns), heights], axis=1)


def _changes(places: np.ndarray, signs: np.ndarray) -> Iterator[Tuple[np.ndarray, np.ndarray]]:
    """Yield all places and signs with two channels exchanged, or one turned over."""
    for first, second in combinations(range(len(places)), 2):
        exchanged = places.copy()
        exchanged[[first, second]] = places[[second, first]]
        yield exchanged, signs
    for channel in range(len(places)):
        turned = signs.copy()
        turned[channel] *= -1.0
        yield places, turned
