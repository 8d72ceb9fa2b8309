"""The 16 low-level descriptors of the INTERSPEECH 2009 emotion challenge, frame by frame (`AudioFeatureExtractor`).

B. Schuller, S. Steidl, A. Batliner: The INTERSPEECH 2009 Emotion Challenge. Proc. INTERSPEECH 2009, 312-315, table 1:
zero-crossing rate, root mean square of the frame's energy, pitch normalised to 500 Hz, harmonics-to-noise ratio from
the autocorrelation function, and the mel-frequency cepstral coefficients 1 to 12, of 25 ms every 10 ms.

`PitchEstimator` finds the fundamental frequency and the harmonics-to-noise ratio. P. Boersma: Accurate short-term
analysis of the fundamental frequency and the harmonics-to-noise ratio of a sampled sound. IFA Proceedings 17 (1993),
97-110. The autocorrelation of the windowed sound is divided by that of the window; its highest peak gives the period,
where a cost per octave prefers the higher frequency among nearly equal peaks. With r the correlation of the sound with
itself one period later, the ratio is 10 log10(r / (1 - r)) dB. Boersma's window correction holds for windows of six
periods and more; with the 3 periods of a low voice in 40 ms the ratio reaches 20 dB at most. Therefore r is computed
once more, at the period that was found, as the normalised correlation of two stretches one period apart, without a
window (L. Rabiner: On the use of autocorrelation analysis for pitch detection, IEEE Trans. ASSP 25 (1977), 24-33): that
is 1 for every periodic sound.

`MelCepstrum` computes the cepstral coefficients as in HTK. The HTK Book (Young et al., version 3.4, sections 5.2 to
5.6): pre-emphasis 0.97, Hamming window, magnitude spectrum, 26 triangular filters equally wide on the mel scale,
logarithm, discrete cosine transform, liftering with L = 22; the settings of the emotion challenge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import List, Tuple, Union

import numpy as np
from scipy import fft

from hri_pipeline.core.audio.stream import RATE

FRAME_S = 0.025
HOP_S = 0.010
PITCH_UNIT_HZ = 500.0
# A block does not continue the last one when its stamp differs by more than this from the end of that.
GAP_S = 0.020
# Number of frames that are computed together, which limits the memory for a long block.
_BATCH = 256


@dataclass(frozen=True)
class FeatureFrame:
    """Descriptors of one frame.

    Attributes
    ----------
    stamp : float
        s, of the first sample of the frame.
    zcr : float
        Zero crossings per sample, 0 to 1.
    rms : float
        Root mean square, 0 to 1.
    pitch : float
        F0 / 500 Hz, 0 where the frame is not voiced.
    hnr : float
        Harmonics-to-noise ratio, dB, -20 to 60.
    mfcc : np.ndarray
        (12,) mel-frequency cepstral coefficients 1 to 12.
    """

    stamp: float
    zcr: float
    rms: float
    pitch: float
    hnr: float
    mfcc: np.ndarray


def zero_crossings(frames: np.ndarray) -> np.ndarray:
    """Return (N,) sign changes per pair of neighbours of (N, length) samples; 0 counts as positive."""
    negative = np.signbit(frames)
    return np.mean(negative[:, 1:] != negative[:, :-1], axis=1)


@lru_cache(maxsize=None)
def _analysers(length: int) -> Tuple[PitchEstimator, MelCepstrum]:
    """Return the constant tables that all voices share."""
    return PitchEstimator(RATE), MelCepstrum(length, RATE)


class AudioFeatureExtractor:
    """Descriptors of one voice at 16 kHz.

        extractor = AudioFeatureExtractor()
        for frame in extractor.process(samples, stamp): ...

    The frames do not depend on the lengths of the blocks. Pitch and HNR are measured over the 40 ms around the frame,
    so a frame is complete 7.5 ms of sound after its end.

    Parameters
    ----------
    rate : float
        Hz, 1 to 100. 100 is every frame of 10 ms; a lower rate leaves out a whole number of frames each time.

    Raises
    ------
    ValueError
        For a rate outside 1 to 100.
    """

    def __init__(self, rate: float = 1.0 / HOP_S) -> None:
        if not 1.0 <= rate <= 1.0 / HOP_S:
            raise ValueError("the rate of the features is {} Hz, legal range 1 to {:g}".format(rate, 1.0 / HOP_S))
        self._length = int(round(FRAME_S * RATE))
        self._hop = int(round(HOP_S * RATE)) * max(1, int(round(1.0 / (HOP_S * rate))))
        self._pitch, self._cepstrum = _analysers(self._length)
        self._margin = (self._pitch.length - self._length) // 2
        self.reset()

    def reset(self) -> None:
        """Forget the sound so far."""
        # The pitch window of the first frame begins with silence.
        self._kept = np.zeros(self._margin)
        self._skip = 0
        self._end, self._newest = math.nan, -math.inf

    def process(self, samples: np.ndarray, stamp: float) -> List[FeatureFrame]:
        """Add samples and return the frames that they complete.

        Parameters
        ----------
        samples : np.ndarray
            (n,), -1 to 1.
        stamp : float
            s, of the first sample. The frames start anew when the block does not continue the last one; where it
            overlaps it their stamps do not go back.

        Raises
        ------
        ValueError
            When the samples are not (n,) finite numbers.
        """
        samples = np.asarray(samples, dtype=np.float64)
        if samples.ndim != 1 or not np.isfinite(samples).all():
            raise ValueError(
                "features need finite samples of one channel, not an array of shape {}".format(samples.shape)
            )
        if abs(stamp - self._end) > GAP_S:
            newest = self._newest
            self.reset()
            self._newest = newest if stamp > newest - FRAME_S else -math.inf
        self._end = stamp + len(samples) / RATE
        skipped = min(self._skip, len(samples))
        self._skip -= skipped
        self._kept = np.concatenate([self._kept, samples[skipped:]])
        frames: List[FeatureFrame] = []
        while len(self._kept) >= self._pitch.length:
            frames += self._batch()
        return frames

    def _batch(self) -> List[FeatureFrame]:
        count = min(_BATCH, 1 + (len(self._kept) - self._pitch.length) // self._hop)
        step = self._kept.strides[0]
        windows = np.lib.stride_tricks.as_strided(
            self._kept, (count, self._pitch.length), (self._hop * step, step), writeable=False)
        inner = windows[:, self._margin:self._margin + self._length]
        first = self._end - (len(self._kept) - self._margin) / RATE
        zcr = zero_crossings(inner).tolist()
        rms = np.sqrt(np.einsum("ij,ij->i", inner, inner) / self._length).tolist()
        frequency, hnr = self._pitch(windows)
        pitch, hnr, mfcc = (frequency / PITCH_UNIT_HZ).tolist(), hnr.tolist(), self._cepstrum(inner)
        used = count * self._hop
        self._skip = max(0, used - len(self._kept))
        self._kept = self._kept[used:].copy()
        stamps = [max(first + number * self._hop / RATE, self._newest) for number in range(count)]
        self._newest = stamps[-1]
        return [FeatureFrame(stamps[number], zcr[number], rms[number], pitch[number], hnr[number],
                             mfcc[number]) for number in range(count)]


PRE_EMPHASIS = 0.97
BANDS = 26
LIFTER = 22
COEFFICIENTS = 12
# HTK reads 16-bit samples as they are, and takes no logarithm of less than 1.
_FULL_SCALE = 32768.0
_LEAST_BAND = 1.0


def mel(frequency: Union[float, np.ndarray]) -> np.ndarray:
    """Return frequencies (Hz) on the mel scale (HTK Book 5.4)."""
    return 1127.0 * np.log1p(np.asarray(frequency, dtype=np.float64) / 700.0)


def mel_filters(bands: int, bins: int, rate: float) -> np.ndarray:
    """Return the weights (bands, bins) of triangular filters on the mel scale from 0 Hz to rate / 2.

    Parameters
    ----------
    bands : int
        Number of filters.
    bins : int
        Number of frequencies of the spectrum, from 0 to rate / 2 inclusive.
    rate : float
        Sample rate, Hz.
    """
    edges = np.linspace(0.0, float(mel(rate / 2.0)), bands + 2)[:, None]
    places = mel(np.linspace(0.0, rate / 2.0, bins))[None, :]
    width = edges[1, 0]
    return np.maximum(0.0, np.minimum(places - edges[:-2], edges[2:] - places) / width)


class MelCepstrum:
    """Coefficients 1 to 12 of frames of `length` samples at `rate` Hz."""

    def __init__(self, length: int, rate: float) -> None:
        self._size = 1 << (length - 1).bit_length()
        self._window = np.hamming(length)
        self._filters = np.ascontiguousarray(mel_filters(BANDS, self._size // 2 + 1, rate).T)
        order = np.arange(1, COEFFICIENTS + 1)[:, None]
        cosines = np.sqrt(2.0 / BANDS) * np.cos(np.pi * order * (np.arange(BANDS) + 0.5) / BANDS)
        lifter = 1.0 + LIFTER / 2.0 * np.sin(np.pi * order / LIFTER)
        self._transform = np.ascontiguousarray((lifter * cosines).T)

    def __call__(self, frames: np.ndarray) -> np.ndarray:
        """Return (N, 12) coefficients of (N, length) samples from -1 to 1."""
        emphasised = frames * _FULL_SCALE
        # The sample before the first of a frame counts as equal to it, as in HTK.
        emphasised[:, 1:] -= PRE_EMPHASIS * emphasised[:, :-1]
        emphasised[:, 0] *= 1.0 - PRE_EMPHASIS
        spectrum = np.abs(np.fft.rfft(emphasised * self._window, self._size))
        return np.log(np.maximum(spectrum @ self._filters, _LEAST_BAND)) @ self._transform


LOWEST_HZ = 75.0
HIGHEST_HZ = 500.0
VOICING_THRESHOLD = 0.45
# Boersma uses 0.01 with a path over many frames; single frames at an SNR of 5 dB need more (chosen on synthetic
# voices).
OCTAVE_COST = 0.08
# Boersma: three periods of the lowest frequency.
WINDOW_S = 3.0 / LOWEST_HZ
# A frame with a smaller root mean square (-90 dBFS, below one step of 16 bits) contains no voice.
SILENCE = 3e-5
HNR_RANGE_DB = (-20.0, 60.0)

# A lower peak cannot become voiced by refinement.
_LEAST_PEAK = 0.3
# The two stretches, and half the length of the sinc between the lags, in samples.
_STRETCH = 376
_DEPTH = 24
# Steps per sample in the search of the peak, before a parabola is fitted to three of them.
_STEPS = 8
# The later stretch is interpolated to 1 / _FINE of a sample, at most _REACH samples from the integer lag.
_FINE = 256
_REACH = 2


class PitchEstimator:
    """F0 and HNR of windows of `length` samples at `rate` Hz, independent of each other."""

    def __init__(self, rate: float) -> None:
        self.length = int(round(WINDOW_S * rate))
        self._rate = rate
        window = np.hanning(self.length + 2)[1:-1]
        self._window = window.astype(np.float32)
        self._floor = SILENCE ** 2 * float(window @ window)
        self._first = int(np.floor(rate / HIGHEST_HZ))
        self._last = int(np.ceil(rate / LOWEST_HZ))
        self._size = fft.next_fast_len(self.length + self._last + 2, real=True)
        correlation = fft.irfft(np.abs(fft.rfft(window, self._size)) ** 2, self._size)[:self._last + 2]
        self._correction = (correlation[0] / correlation).astype(np.float32)
        lags = np.arange(self._first, self._last + 1)
        self._cost = (OCTAVE_COST * np.log2(LOWEST_HZ * lags / rate)).astype(np.float32)
        steps = np.arange(-_STEPS, _STEPS + 1) / _STEPS
        self._sinc = _sinc(steps)
        # The energy of the later stretch changes little from lag to lag: linear interpolation is enough.
        self._between = np.maximum(0.0, 1.0 - np.abs(steps[None, :] - np.arange(-_DEPTH, _DEPTH + 1)[:, None]))
        self._kernels = np.ascontiguousarray(_sinc(np.arange(-_REACH * _FINE, _REACH * _FINE + 1) / _FINE).T)

    def __call__(self, windows: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return F0 (N,) in Hz, 0 where nothing is voiced, and HNR (N,) in dB of (N, length) samples from -1 to 1."""
        windows = windows - windows.mean(axis=1, keepdims=True)
        frequencies, ratios = np.zeros(len(windows)), np.empty(len(windows))
        for row, (lag, height) in enumerate(zip(*self._choose(windows))):
            if height > _LEAST_PEAK:
                period, height = self._refine(windows[row], lag)
                frequency = self._rate / period
                if height > VOICING_THRESHOLD and LOWEST_HZ <= frequency <= HIGHEST_HZ:
                    frequencies[row] = frequency
            ratios[row] = _decibels(height)
        return frequencies, ratios

    def _choose(self, windows: np.ndarray) -> Tuple[List[int], List[float]]:
        """Return the lag (samples) of the best peak of each window, and its height; 0 where there is no sound."""
        spectrum = fft.rfft((windows * self._window).astype(np.float32), self._size)
        power = spectrum.real ** 2 + spectrum.imag ** 2
        correlation = fft.irfft(power, self._size)[:, :self._last + 2]
        energy = correlation[:, 0]
        r = correlation * self._correction / np.maximum(energy, self._floor)[:, None]
        before, inner, after = (r[:, self._first + step:self._last + 1 + step] for step in (-1, 0, 1))
        # Peaks lie between samples: a parabola is exact enough to choose among them.
        slope = after - before
        curvature = np.maximum(2.0 * inner - before - after, 1e-6)
        top = np.minimum(inner + slope * slope / (8.0 * curvature), 1.0) - self._cost
        top[(inner < before) | (inner < after)] = -2.0
        best = np.argmax(top, axis=1)
        heights = np.where(energy > self._floor, inner[np.arange(len(inner)), best], 0.0)
        return (self._first + best).tolist(), heights.tolist()

    def _refine(self, window: np.ndarray, lag: int) -> Tuple[float, float]:
        """Return the period (samples) near `lag`, and the normalised correlation of the sound with itself one period
        later."""
        start = (self.length - _STRETCH - lag) // 2
        stretch = window[start:start + _STRETCH]
        later = window[start + lag - _DEPTH:start + lag + _STRETCH + _DEPTH]
        energies = np.cumsum(later * later)
        energies[_STRETCH:] -= energies[:-_STRETCH]
        curve = np.correlate(later, stretch) @ self._sinc / np.sqrt(energies[_STRETCH - 1:] @ self._between + 1e-30)
        best = min(max(int(curve.argmax()), 1), len(curve) - 2)
        before, at, after = curve[best - 1:best + 2].tolist()
        curvature = 2.0 * at - before - after
        shift = min(max(0.5 * (after - before) / curvature, -1.0), 1.0) if curvature > 0.0 else 0.0
        offset = (best + shift) / _STEPS - 1.0
        later = np.correlate(later, self._kernels[int(round((offset + _REACH) * _FINE))])
        energy = float(stretch @ stretch) * float(later @ later)
        return lag + offset, float(stretch @ later) / math.sqrt(energy) if energy > 0.0 else 0.0


def _sinc(offsets: np.ndarray) -> np.ndarray:
    """Return the weights (2 * _DEPTH + 1, N) that interpolate at `offsets` (N,) samples from the middle."""
    distance = offsets[None, :] - np.arange(-_DEPTH, _DEPTH + 1)[:, None]
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip(distance / (_DEPTH + 1), -1.0, 1.0))
    return np.sinc(distance) * taper


def _decibels(height: float) -> float:
    """Return the harmonics-to-noise ratio (dB) of a correlation, within HNR_RANGE_DB."""
    if height <= 0.0:
        return HNR_RANGE_DB[0]
    if height >= 1.0:
        return HNR_RANGE_DB[1]
    return min(max(10.0 * math.log10(height / (1.0 - height)), HNR_RANGE_DB[0]), HNR_RANGE_DB[1])
