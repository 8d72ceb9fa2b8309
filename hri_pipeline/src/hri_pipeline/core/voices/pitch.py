"""Fundamental frequency and harmonics-to-noise ratio from the autocorrelation.

P. Boersma: Accurate short-term analysis of the fundamental frequency and the harmonics-to-noise ratio of a sampled
sound. IFA Proceedings 17 (1993), 97-110. The autocorrelation of the windowed sound is divided by that of the window;
its highest peak gives the period, where a cost per octave prefers the higher frequency among near equals. With r the
correlation of the sound with itself one period later, the ratio is 10 log10(r / (1 - r)) dB.

Boersma's window correction holds for windows of six periods and more; of the 3 periods of a low voice that 40 ms hold it
leaves 20 dB at most. r is therefore taken once more, at the period that was found, as the normalised correlation of two
stretches one period apart, without a window (L. Rabiner: On the use of autocorrelation analysis for pitch detection,
IEEE Trans. ASSP 25 (1977), 24-33): that is 1 for every periodic sound.
"""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np
from scipy import fft

LOWEST_HZ = 75.0
HIGHEST_HZ = 500.0
VOICING_THRESHOLD = 0.45
# Boersma's 0.01 goes with a path over many frames; frame by frame, noise of 5 dB needs more (chosen on synthetic voices).
OCTAVE_COST = 0.08
# Boersma: three periods of the lowest frequency.
WINDOW_S = 3.0 / LOWEST_HZ
# A frame of less than this root mean square (-90 dB of full scale, below one step of 16 bits) holds no voice.
SILENCE = 3e-5
HNR_RANGE_DB = (-20.0, 60.0)

# A peak that is lower is not voiced however exactly it is looked at.
_WORTH_IT = 0.3
# The two stretches, and half the length of the sinc between the lags, in samples.
_STRETCH = 376
_DEPTH = 24
# Steps per sample at which the peak is looked for before a parabola is laid through three of them.
_STEPS = 8
# The later stretch is taken to 1 / _FINE of a sample, at most _REACH samples from the whole lag.
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
        # The energy of the later stretch changes little from lag to lag: straight lines will do.
        self._between = np.maximum(0.0, 1.0 - np.abs(steps[None, :] - np.arange(-_DEPTH, _DEPTH + 1)[:, None]))
        self._kernels = np.ascontiguousarray(_sinc(np.arange(-_REACH * _FINE, _REACH * _FINE + 1) / _FINE).T)

    def __call__(self, windows: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return F0 (N,) in Hz, 0 where nothing is voiced, and HNR (N,) in dB of (N, length) samples from -1 to 1."""
        windows = windows - windows.mean(axis=1, keepdims=True)
        frequencies, ratios = np.zeros(len(windows)), np.empty(len(windows))
        for row, (lag, height) in enumerate(zip(*self._choose(windows))):
            if height > _WORTH_IT:
                period, height = self._refine(windows[row], lag)
                frequency = self._rate / period
                if height > VOICING_THRESHOLD and LOWEST_HZ <= frequency <= HIGHEST_HZ:
                    frequencies[row] = frequency
            ratios[row] = _decibels(height)
        return frequencies, ratios

    def _choose(self, windows: np.ndarray) -> Tuple[List[int], List[float]]:
        """Lag in whole samples of the best peak of each window, and its height; 0 where there is no sound."""
        spectrum = fft.rfft((windows * self._window).astype(np.float32), self._size)
        power = spectrum.real ** 2 + spectrum.imag ** 2
        correlation = fft.irfft(power, self._size)[:, :self._last + 2]
        energy = correlation[:, 0]
        r = correlation * self._correction / np.maximum(energy, self._floor)[:, None]
        before, inner, after = (r[:, self._first + step:self._last + 1 + step] for step in (-1, 0, 1))
        # Between samples a peak is higher than at them: a parabola is enough to choose among the peaks.
        slope = after - before
        curvature = np.maximum(2.0 * inner - before - after, 1e-6)
        top = np.minimum(inner + slope * slope / (8.0 * curvature), 1.0) - self._cost
        top[(inner < before) | (inner < after)] = -2.0
        best = np.argmax(top, axis=1)
        heights = np.where(energy > self._floor, inner[np.arange(len(inner)), best], 0.0)
        return (self._first + best).tolist(), heights.tolist()

    def _refine(self, window: np.ndarray, lag: int) -> Tuple[float, float]:
        """Period in samples near `lag`, and the normalised correlation of the sound with itself one period later."""
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
    """Weights (2 * _DEPTH + 1, N) that give the value `offsets` samples away from the middle of as many samples."""
    distance = offsets[None, :] - np.arange(-_DEPTH, _DEPTH + 1)[:, None]
    taper = 0.5 + 0.5 * np.cos(np.pi * np.clip(distance / (_DEPTH + 1), -1.0, 1.0))
    return np.sinc(distance) * taper


def _decibels(height: float) -> float:
    """Harmonics-to-noise ratio in dB of a correlation, within HNR_RANGE_DB."""
    if height <= 0.0:
        return HNR_RANGE_DB[0]
    if height >= 1.0:
        return HNR_RANGE_DB[1]
    return min(max(10.0 * math.log10(height / (1.0 - height)), HNR_RANGE_DB[0]), HNR_RANGE_DB[1])
