"""Spectra of overlapping frames of sound, sound from spectra (overlap-add), and the power spectrum of the background
noise."""

from __future__ import annotations

from typing import Iterator, Optional

import numpy as np
import scipy.fft
from scipy.ndimage import uniform_filter1d

from hri_pipeline.core.audio.stream import RATE

FRAME, HOP = 512, 256
"""Samples of a frame (32 ms), and from one frame to the next (16 ms)."""
BINS = FRAME // 2 + 1
FREQUENCIES = np.arange(BINS) * (RATE / FRAME)
"""Hz of each bin, (BINS,)."""
# The root of a periodic Hann window, for analysis and synthesis: frames that overlap by half add up to the original
# sound.
_WINDOW = np.sin(np.pi * (np.arange(FRAME) + 0.5) / FRAME).astype(np.float32)


def mean_power(spectrum: np.ndarray) -> np.ndarray:
    """Return the power (BINS,) of a spectrum (C, BINS), mean over its channels."""
    return np.einsum("cf,cf->f", spectrum, spectrum.conj()).real * np.float32(1.0 / len(spectrum))


class FrameSplitter:
    """Cuts blocks of any length into frames. Frame k begins with sample k * HOP, counted from the last reset.

    Parameters
    ----------
    channels : int
    """

    def __init__(self, channels: int) -> None:
        self._rest = np.zeros((0, channels), dtype=np.float32)

    def reset(self) -> None:
        """Forget the samples of the incomplete frame."""
        self._rest = self._rest[:0]

    def split(self, samples: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the spectrum (C, BINS), complex64, of each frame that `samples` (N, C) complete."""
        sound = np.concatenate([self._rest, samples]) if len(self._rest) else samples
        count = max(0, (len(sound) - FRAME) // HOP + 1)
        self._rest = np.array(sound[count * HOP:], dtype=np.float32)
        for index in range(count):
            frame = sound[index * HOP:index * HOP + FRAME].T * _WINDOW
            yield scipy.fft.rfft(frame, axis=1)


class OverlapAdd:
    """Puts the spectra of one signal together to sound; every frame completes HOP samples."""

    def __init__(self) -> None:
        self._tail = np.zeros(FRAME - HOP, dtype=np.float32)

    def add(self, spectrum: np.ndarray) -> np.ndarray:
        """Return the first HOP samples, float32, of the frame with this spectrum (BINS,)."""
        frame = scipy.fft.irfft(spectrum, FRAME) * _WINDOW
        done = (self._tail + frame[:HOP]).astype(np.float32)
        self._tail = frame[HOP:]
        return done


SMOOTHING = 0.85
"""Smoothing factor of the power from frame to frame before its minimum is taken (0.1 s)."""
PARTS, PART_FRAMES = 6, 32
"""The minimum is taken over the last 6 times 0.5 s, which is longer than a phrase: speech itself does not count as
noise."""
BIAS, BIAS_POWER = 1.1, -0.63
"""The mean power of white noise is 1 + 1.1 C^-0.63 times the minimum of its smoothed power, with C channels (measured
with 2, 4 and 8)."""
NEIGHBOURS = 7
"""Bins (0.2 kHz) over which the noise is averaged: the noise of fans and rooms changes little from bin to bin."""
RENEW_EVERY = 4
"""Frames between two updates of the noise: it changes slowly."""
SILENCE = 1e-9
"""Smallest power of a bin, far less than the last bit of 16."""
ECHO_DECAY = 0.72
"""Share of the power that a room returns one frame later, for a reverberation time of 0.65 s.

Echoes come from wrong directions.
"""


class NoiseSpectrum:
    """Power of the stationary noise in each bin, by minimum statistics.

    R. Martin, IEEE Transactions on Speech and Audio Processing 9 (2001), without the adaptive smoothing.

    Parameters
    ----------
    bins : int
    channels : int
        Over how many channels the power is averaged.

    Attributes
    ----------
    power : np.ndarray
        (bins,) expected power of the noise.
    """

    def __init__(self, bins: int, channels: int) -> None:
        self._bins = bins
        self._bias = 1.0 + BIAS * channels ** BIAS_POWER
        self.reset()

    def reset(self) -> None:
        """Forget the sound so far."""
        self._smooth: Optional[np.ndarray] = None
        self._minima = np.full((PARTS, self._bins), np.inf, dtype=np.float32)
        self._frame = 0
        self._echo = np.zeros(self._bins, dtype=np.float32)
        self.power = np.full(self._bins, SILENCE, dtype=np.float32)

    def update(self, power: np.ndarray) -> np.ndarray:
        """Add a frame and update `power`.

        Parameters
        ----------
        power : np.ndarray
            (bins,) mean over the channels.

        Returns
        -------
        np.ndarray
            (bins,) weight of each bin, 0 to 1: the share of its power that is direct sound, neither noise nor echo.
        """
        before = power if self._smooth is None else self._smooth
        self._smooth = SMOOTHING * before + (1.0 - SMOOTHING) * power
        part = (self._frame // PART_FRAMES) % PARTS
        if self._frame % PART_FRAMES == 0:
            self._minima[part] = np.inf
        np.minimum(self._minima[part], self._smooth, out=self._minima[part])
        if self._frame % RENEW_EVERY == 0:
            noise = uniform_filter1d(self._minima.min(axis=0), NEIGHBOURS, mode="nearest")
            self.power = np.maximum(self._bias * noise, SILENCE)
        self._frame += 1
        weights = np.clip(1.0 - (1.5 * self.power + self._echo) / np.maximum(power, SILENCE), 0.0, 1.0)
        self._echo = ECHO_DECAY * np.maximum(self._echo, power)
        return weights
