"""Separation of the sources in the sound of a microphone array.

`SoundSeparator` is the entry: it finds and follows directions (core/audio/localisation.py) and lets `SourceBeamformers`
filter the sound of each out of the mixture. Frames are 32 ms long, one every 16 ms: a sample is complete 16 to 32 ms
after it came in. The filters have no delay of their own: sample i of the output was heard at sample i of the input.

Model of the beamformers: every source is a zero-mean Gaussian with a power per bin that changes from frame to frame,
and a spatial covariance of full rank per bin that hardly changes (N. Duong, E. Vincent and R. Gribonval,
"Under-determined reverberant audio source separation using a full-rank spatial covariance model", IEEE Transactions on
Audio, Speech and Language Processing 18, 2010). The multichannel Wiener filter of that model is the MVDR beamformer
against all other sources and the noise, followed by its single-channel postfilter. Powers follow by the multiplicative
update of H. Sawada et al. ("Multichannel extensions of non-negative matrix factorization with complex-valued data",
same journal 21, 2013), one step per frame; covariances begin as a plane wave from the direction plus diffuse sound, and
adapt to the room.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from hri_pipeline.core.audio.array import MicrophoneArray
from hri_pipeline.core.audio.channel_order import ChannelOrder
from hri_pipeline.core.audio.localisation import DirectionFinder, DirectionTracker, TrackedSource
from hri_pipeline.core.audio.parameters import ArraySettings
from hri_pipeline.core.audio.spectra import (
    BINS,
    FRAME,
    FREQUENCIES,
    HOP,
    RATE,
    FrameSplitter,
    NoiseSpectrum,
    OverlapAdd,
    mean_power,
)

TRACK_EVERY = 2
"""Frames between two updates of the directions (32 ms)."""
ONSET_TIME = 0.1
"""A source is heard this long (s) before its direction stands out."""
LEVEL_WEIGHT, SHARE_WEIGHT, LEAST_EVIDENCE = 0.004, 0.025, -0.08
"""While another source is heard: a source is heard itself where the height of the response in its direction, its level
below its loudest (dB), and the logarithm of its share of the bins, weighted so, exceed LEAST_EVIDENCE. The weights are
those of a logistic regression on simulated rooms with other recordings and seeds than the benchmark's."""
LEAST_PART, SHARE_STEP, LOUDEST_DECAY = 0.02, 0.15, 6.0
"""Least share that counts, smoothing factor of the share per frame (0.1 s), and decay of the loudest level (dB/s)."""


@dataclass(frozen=True)
class SourceSignal:
    """The separated sound of one source.

    Attributes
    ----------
    key : int
        Of the source, see TrackedSource.
    samples : np.ndarray
        (n,) float32 at 16 kHz, n a multiple of HOP.
    offset : int
        Index of samples[0] relative to the first sample of the last block; its stamp is that of the block + offset /
        RATE.
    direction : np.ndarray or None
        (3,) unit vector from the microphones to the source, in the microphone frame; None when it is ambiguous (see the
        parameter `line_front`).
    direction_sd : float
        rad.
    active : bool
        Whether the source itself is heard, and not only what the filter lets through of others.
    before : int
        Number of the first samples that are from before the source was heard.
    """

    key: int
    samples: np.ndarray
    offset: int
    direction: Optional[np.ndarray]
    direction_sd: float
    active: bool
    before: int = 0


class _Frame(NamedTuple):
    number: int
    spectrum: np.ndarray
    noise: np.ndarray


class _Output:
    """The separated signal of one source that has not been returned yet; begin, next, heard: indices of frames, heard
    that from which the source was heard."""

    def __init__(self, begin: int, heard: int) -> None:
        self.begin = self.next = begin
        self.heard = heard
        self.parts: List[np.ndarray] = []
        self._overlap = OverlapAdd()
        self._share = self._power = 0.0
        self._loudest = -math.inf

    def add(self, spectrum: np.ndarray, share: float) -> None:
        """Add a frame; share: see SourceBeamformers.shares."""
        self.parts.append(self._overlap.add(spectrum))
        self.next += 1
        self._share += SHARE_STEP * (share - self._share)
        self._power = 0.5 * (self._power + float(np.vdot(spectrum, spectrum).real))
        self._loudest = max(self._loudest - LOUDEST_DECAY * HOP / RATE, self._level())

    def is_heard(self, height: float) -> bool:
        """Tell whether the source itself is heard while another one is; height: of the response in its direction."""
        return (height + LEVEL_WEIGHT * (self._level() - self._loudest)
                + SHARE_WEIGHT * math.log(self._share + LEAST_PART)) > LEAST_EVIDENCE

    def _level(self) -> float:
        return 10.0 * math.log10(self._power + 1e-12)

    def take(self) -> np.ndarray:
        samples = np.concatenate(self.parts)
        self.parts = []
        self.begin = self.next
        return samples


class SoundSeparator:
    """Separates the sources in the sound of a microphone array. The output does not depend on the lengths of the
    blocks.

    A new source is confirmed after some tenths of a second; its first signal reaches back by `source_look_back`.
    A silent source leaves the output after `source_hold_time`. It returns with the same key, again with a look-back,
    until `source_memory` has passed. A key can be there twice in one result when the block was so long that its source
    fell silent and returned.

    Parameters
    ----------
    positions : np.ndarray
        (C, 3) m, in the microphone frame.
    settings : ArraySettings, optional

    Raises
    ------
    ParameterError
        See check_positions.
    """

    latency = FRAME / RATE
    """Largest time (s) by which the output is behind the input."""

    def __init__(self, positions: np.ndarray, settings: ArraySettings = ArraySettings()) -> None:  # noqa: B008 (frozen)
        self.array = MicrophoneArray(positions)
        self._settings = settings
        self._splitter = FrameSplitter(self.array.channels)
        self._noise = NoiseSpectrum(BINS, self.array.channels)
        self._finder = DirectionFinder(self.array, settings.max_sources)
        # It outlives reset(): microphones stay where they are.
        self._order = ChannelOrder(self.array)
        self._tracker = DirectionTracker(settings.source_birth_time, settings.source_memory, settings.max_sources)
        self._beamformers = SourceBeamformers(self.array)
        self._recent: Deque[_Frame] = deque(maxlen=int(math.ceil(settings.source_look_back * RATE / HOP)))
        self._outputs: Dict[int, _Output] = {}
        self.reset()

    def reconfigure(self, settings: ArraySettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings

    def reset(self) -> None:
        """Forget the sound so far, after a gap or when time jumps. Keys are not used again."""
        self._splitter.reset()
        self._noise.reset()
        self._finder.reset()
        self._tracker.reset()
        self._beamformers.reset()
        self._recent.clear()
        self._outputs.clear()
        self._ended: Dict[int, int] = {}
        self._finished: List[SourceSignal] = []
        self._sources: List[TrackedSource] = []
        self._frame = 0
        self._heard = 0

    @property
    def fitting_order(self) -> Tuple[int, ...]:
        """For each position the index of the channel that fits there by the sound, where the channels do not fit as
        they are; else empty."""
        return self._order.found

    @property
    def sources(self) -> List[TrackedSource]:
        """All remembered sources, also silent ones, oldest first."""
        return list(self._sources)

    def process(self, samples: np.ndarray) -> List[SourceSignal]:
        """Add samples and return what has been separated of each source that is not silent.

        Parameters
        ----------
        samples : np.ndarray
            (N, C), -1 to 1, any N. A sample that is not finite counts as 0.

        Raises
        ------
        ValueError
            For another number of channels than the array has.
        """
        samples = np.asarray(samples, dtype=np.float32)
        if samples.ndim != 2 or samples.shape[1] != self.array.channels:
            raise ValueError("sound of shape {} does not suit an array of {} microphones; hand in (N, {})".format(
                samples.shape, self.array.channels, self.array.channels))
        if not np.isfinite(samples).all():
            samples = np.nan_to_num(samples, nan=0.0, posinf=0.0, neginf=0.0)
        first = self._heard
        self._heard += len(samples)
        for spectrum in self._splitter.split(samples):
            self._process_frame(spectrum, first)
        sources = {source.key: source for source in self._sources}
        signals = self._finished + [self._signal(sources[key], output, first)
                                    for key, output in self._outputs.items() if output.parts]
        self._finished = []
        return signals

    def _process_frame(self, spectrum: np.ndarray, first: int) -> None:
        bin_weights = self._noise.update(mean_power(spectrum))
        self._finder.add(spectrum, bin_weights)
        self._order.add(spectrum, bin_weights)
        if self._frame % TRACK_EVERY == 0:
            self._track(first)
        frame = _Frame(self._frame, spectrum, self._noise.power)
        if self._outputs:
            self._separate(frame)
        self._recent.append(frame)
        self._frame += 1

    def _separate(self, frame: _Frame) -> None:
        separated = self._beamformers.separate(frame.spectrum, frame.noise)
        shares = self._beamformers.shares(frame.spectrum, frame.noise)
        for key, found in separated.items():
            if self._outputs[key].next == frame.number:
                self._outputs[key].add(found, shares[key])

    def _track(self, first: int) -> None:
        """Update the sources; begin and end their outputs."""
        stamp = self._frame * HOP / RATE
        before = {source.key: source for source in self._sources}
        self._sources = self._tracker.update(self._finder.peaks(), stamp)
        heard = {source.key: source.direction for source in self._sources
                 if stamp - source.heard_at <= self._settings.source_hold_time}
        for key in [key for key in self._outputs if key not in heard]:
            output = self._outputs.pop(key)
            self._ended[key] = output.next
            if output.parts:
                self._finished.append(self._signal(before[key], output, first))
        remembered = {source.key for source in self._sources}
        self._ended = {key: end for key, end in self._ended.items() if key in remembered}
        self._beamformers.steer(heard)
        new = [key for key in heard if key not in self._outputs]
        if new:
            self._begin(new)

    def _begin(self, keys: List[int]) -> None:
        """Begin outputs of sources as far back as sound is kept; the filters learn from that sound as well."""
        oldest = self._recent[0].number if self._recent else self._frame
        since = {source.key: int((source.heard_since - ONSET_TIME) * RATE / HOP) for source in self._sources}
        for key in keys:
            self._outputs[key] = _Output(max(oldest, self._ended.get(key, 0)), since[key])
        for frame in self._recent:
            if frame.number >= min(self._outputs[key].begin for key in keys):
                self._separate(frame)

    def _signal(self, source: TrackedSource, output: _Output, first: int) -> SourceSignal:
        begin = output.begin * HOP
        before = max(0, (min(output.heard, output.next) - output.begin) * HOP)
        is_known = self.array.shape != "line" or self._settings.line_front
        is_heard = source.active and (not source.together or output.is_heard(self._finder.height(source.direction)))
        return SourceSignal(source.key, output.take(), begin - first, source.direction if is_known else None,
                            source.sd, is_heard, before)


POWER_MEMORY = 0.95
"""Smoothing factor of a source's power from frame to frame (0.3 s): less makes voices shrill, more lets echoes of
others in."""
POWER_STEP = 1.5
"""Exponent of the update of the powers. 1 is a full step towards the maximum likelihood; more compensates for having
only one step; from 2.5 on the powers oscillate."""
DIFFUSE_PART = 0.6
"""Diffuse share of a new source's covariance: echoes, and errors of the direction."""
LEARNING_RATE, LEARN_EVERY = 0.12, 4
"""Share of a covariance that one frame replaces in a bin of this source alone, and frames between two such updates (0.5
s)."""
NOISE_FACTOR = 1.1
LOADING = 1e-3
"""Least noise (diagonal loading) as a share of the power of all sources: no filter removes more than 30 dB."""
LEAST = 1e-3
"""Least power of a source in each bin, as a share of the noise: from 0 it could not rise again."""
ANCHOR = 0.3
"""Share of the expected covariance of the direction in each update: so wrong updates are forgotten."""
SPEECH_BAND, SOUND, LEAST_BINS = slice(7, 192), 6.0, 20
"""Bins (0.2 to 6 kHz) of which a source may have a share, how far they exceed the noise, and their least number."""
LEAST_TURN = np.cos(np.radians(8.0))
"""Cosine of the angle by which a source must move for a new expected covariance; what was learnt of it is forgotten.
That of all sources is forgotten when a new one comes: until then it was taken for a part of the others."""


class SourceBeamformers:
    """Filters for a changing set of sources of one array.

    The frequency is the last dimension of all arrays, (..., BINS), which makes numpy fastest.

    Parameters
    ----------
    array : MicrophoneArray
    """

    def __init__(self, array: MicrophoneArray) -> None:
        self._array = array
        self._diffuse = _frequency_last(array.diffuse_coherence(FREQUENCIES))
        self.reset()

    def reset(self) -> None:
        """Drop all sources."""
        self._keys: List[int] = []
        self._directions = np.zeros((0, 3))
        channels = self._array.channels
        self._covariances = np.zeros((0, channels, channels, BINS), dtype=np.complex64)
        self._expected = self._covariances.copy()
        self._powers = np.zeros((0, BINS), dtype=np.float32)
        self._frame = 0

    def steer(self, directions: Dict[int, np.ndarray]) -> None:
        """Set the sources and their directions: filters of new sources begin, those of missing ones end.

        Parameters
        ----------
        directions : dict
            Key of the source -> (3,) unit vector.
        """
        stay = [row for row, key in enumerate(self._keys) if key in directions]
        if len(stay) < len(self._keys):
            self._keys = [self._keys[row] for row in stay]
            self._directions, self._expected = self._directions[stay], self._expected[stay]
            self._covariances, self._powers = self._covariances[stay], self._powers[stay]
        new = [key for key in directions if key not in self._keys]
        for row, key in enumerate(self._keys):
            turned = self._directions[row] @ directions[key] < LEAST_TURN
            if turned:
                self._directions[row] = directions[key]
                self._expected[row] = self._expect(directions[key])
            if turned or new:
                self._covariances[row] = self._expected[row]
        for key in new:
            self._keys.append(key)
            expected = self._expect(directions[key])[None]
            self._directions = np.vstack([self._directions, directions[key]])
            self._expected = np.concatenate([self._expected, expected])
            self._covariances = np.concatenate([self._covariances, expected])
            self._powers = np.vstack([self._powers, np.zeros((1, BINS), dtype=np.float32)])

    def separate(self, spectrum: np.ndarray, noise: np.ndarray) -> Dict[int, np.ndarray]:
        """Return the spectrum (BINS,) of each source, by key, at the first microphone.

        Parameters
        ----------
        spectrum : np.ndarray
            (C, BINS) of one frame.
        noise : np.ndarray
            (BINS,) power of the noise in one channel.
        """
        if not self._keys:
            return {}
        noise = np.float32(NOISE_FACTOR) * noise
        share = np.maximum(mean_power(spectrum) - noise, LEAST * noise) / len(self._keys)
        powers = POWER_MEMORY * self._powers + (1.0 - POWER_MEMORY) * share
        inverted = inverse(self._total(powers, noise))
        whitened = _times(inverted, spectrum)
        seen = np.einsum("if,sif->sf", whitened.conj(), _times(self._covariances, whitened)).real
        # The trace of a product of Hermitian matrices.
        expected = np.einsum("ijf,sijf->sf", inverted.conj(), self._covariances).real
        step = (np.maximum(seen, 0.0) / np.maximum(expected, 1e-30)) ** POWER_STEP
        self._powers = np.maximum(powers * step, LEAST * noise).astype(np.float32)
        return self._filter(spectrum, noise)

    def shares(self, spectrum: np.ndarray, noise: np.ndarray) -> Dict[int, float]:
        """Return the share of the bins with sound, of the last frame, in which each source has the largest power, by
        key; arguments as of separate()."""
        if not self._keys:
            return {}
        powers, noise = self._powers[:, SPEECH_BAND], noise[SPEECH_BAND]
        sounds = mean_power(spectrum)[SPEECH_BAND] > SOUND * noise
        largest = np.where(sounds & (powers.max(axis=0) > 2.0 * noise), powers.argmax(axis=0), -1)
        count = max(LEAST_BINS, int(sounds.sum()))
        return {key: float((largest == row).sum()) / count for row, key in enumerate(self._keys)}

    def _filter(self, spectrum: np.ndarray, noise: np.ndarray) -> Dict[int, np.ndarray]:
        total = self._total(self._powers, noise)
        self._frame += 1
        learns = self._frame % LEARN_EVERY == 0
        inverted = inverse(total) if learns else None
        whitened = solve(total, spectrum) if inverted is None else _times(inverted, spectrum)
        images = self._powers[:, None] * _times(self._covariances, whitened)
        if inverted is not None:
            self._learn(inverted, images, noise)
        return {key: images[row, 0] for row, key in enumerate(self._keys)}

    def _learn(self, inverted: np.ndarray, images: np.ndarray, noise: np.ndarray) -> None:
        """Move each covariance towards its estimate from this frame, by the source's share of each bin."""
        share = self._powers / (self._powers.sum(axis=0) + noise)
        for row in range(len(self._keys)):
            covariance, power = self._covariances[row], self._powers[row]
            # Covariance of the source given the frame: of the estimate, plus the posterior uncertainty.
            found = _product(covariance, _product(inverted, covariance))
            found *= -power
            found += covariance
            found *= power
            found += images[row][:, None] * images[row].conj()[None]
            level = np.einsum("iif->f", found).real / self._array.channels
            rate = LEARNING_RATE * share[row]
            found *= (1.0 - ANCHOR) * rate / np.maximum(level, 1e-30)
            covariance *= 1.0 - rate
            covariance += found
            covariance += ANCHOR * rate * self._expected[row]

    def _total(self, powers: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Return the covariance (C, C, BINS) of all sources and the noise."""
        total = powers[0] * self._covariances[0]
        for power, covariance in zip(powers[1:], self._covariances[1:]):
            total += power * covariance
        least = np.maximum(noise, LOADING * powers.sum(axis=0))
        for channel in range(self._array.channels):
            total[channel, channel] += least
        return total

    def _expect(self, direction: np.ndarray) -> np.ndarray:
        """Return the covariance (C, C, BINS), mean of the diagonal 1, of sound from a direction in a room."""
        wave = self._array.steering(direction[None], FREQUENCIES)[:, 0].T
        direct = wave[:, None] * wave.conj()[None]
        return ((1.0 - DIFFUSE_PART) * direct + DIFFUSE_PART * self._diffuse).astype(np.complex64)


def inverse(matrices: np.ndarray) -> np.ndarray:
    """Return the inverses of Hermitian positive definite matrices (C, C, F), for all F at once.

    Gauss-Jordan without pivoting, which such matrices do not need; LAPACK takes five times as long for small ones.
    """
    left = matrices.copy()
    change = np.empty_like(left)
    for pivot in range(len(left)):
        scale = 1.0 / left[pivot, pivot].real
        row = left[pivot] * scale
        column = left[:, pivot].copy()
        left -= np.multiply(column[:, None], row, out=change)
        left[:, pivot] = column * -scale
        left[pivot] = row
        left[pivot, pivot] = scale
    return left


def solve(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the inverses of Hermitian positive definite matrices (C, C, F) times the vectors (C, F), for all F at
    once.

    Gauss elimination without pivoting: less than half the work of the inverse.
    """
    left, right = matrices.copy(), vectors.copy()
    scales = []
    for pivot in range(len(left)):
        scales.append(1.0 / left[pivot, pivot].real)
        factors = left[pivot + 1:, pivot] * scales[pivot]
        left[pivot + 1:, pivot + 1:] -= factors[:, None] * left[pivot, pivot + 1:]
        right[pivot + 1:] -= factors * right[pivot]
    for pivot in range(len(left) - 1, -1, -1):
        right[pivot] -= np.sum(left[pivot, pivot + 1:] * right[pivot + 1:], axis=0)
        right[pivot] *= scales[pivot]
    return right


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return matrices (..., C, C, F) times vectors (C, F): (..., C, F)."""
    return np.einsum("...ijf,jf->...if", matrices, vectors)


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return matrices (C, C, F) times matrices (C, C, F)."""
    return np.einsum("ijf,jkf->ikf", a, b)


def _frequency_last(matrices: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(np.moveaxis(matrices, 0, -1))
