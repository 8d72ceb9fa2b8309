"""Sound cut into overlapping frames and their spectra, and spectra put together to sound again."""

from __future__ import annotations

from typing import Iterator

import numpy as np
import scipy.fft

RATE = 16000
FRAME, HOP = 512, 256
"""Samples (32 ms and 16 ms) of a frame, and from one to the next."""
BINS = FRAME // 2 + 1
FREQUENCIES = np.arange(BINS) * (RATE / FRAME)
"""Hz of each bin, (BINS,)."""
# The root of a periodic Hann window, before and after: frames that overlap by half add up to what they were made of.
_WINDOW = np.sin(np.pi * (np.arange(FRAME) + 0.5) / FRAME).astype(np.float32)


def mean_power(spectrum: np.ndarray) -> np.ndarray:
    """Return the power (BINS,) of a spectrum (C, BINS), mean over its channels."""
    return np.einsum("cf,cf->f", spectrum, spectrum.conj()).real * np.float32(1.0 / len(spectrum))


class FrameSplitter:
    """Cuts blocks of any length into frames. Frame k holds the samples from k * HOP on, counted from the last reset."""

    def __init__(self, channels: int) -> None:
        if channels < 1:
            raise ValueError("sound has at least one channel, not {}".format(channels))
        self._channels = channels
        self._rest = np.zeros((0, channels), dtype=np.float32)

    def reset(self) -> None:
        """Forget the samples that no frame was complete with."""
        self._rest = self._rest[:0]

    def split(self, samples: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the spectra (C, BINS), complex64, of all frames that `samples` (N, C) complete."""
        sound = np.concatenate([self._rest, samples]) if len(self._rest) else samples
        count = max(0, (len(sound) - FRAME) // HOP + 1)
        self._rest = np.array(sound[count * HOP:], dtype=np.float32)
        for index in range(count):
            frame = sound[index * HOP:index * HOP + FRAME].T * _WINDOW
            yield scipy.fft.rfft(frame, axis=1)


class OverlapAdd:
    """Puts the spectra of one signal together; every frame finishes HOP samples."""

    def __init__(self) -> None:
        self._tail = np.zeros(FRAME - HOP, dtype=np.float32)

    def add(self, spectrum: np.ndarray) -> np.ndarray:
        """Return the HOP samples, float32, that the frame with `spectrum` (BINS,) begins with."""
        frame = scipy.fft.irfft(spectrum, FRAME) * _WINDOW
        done = (self._tail + frame[:HOP]).astype(np.float32)
        self._tail = frame[HOP:]
        return done
