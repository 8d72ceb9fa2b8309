"""Mel-frequency cepstral coefficients as HTK defines them.

The HTK Book (Young et al., version 3.4, sections 5.2 to 5.6): pre-emphasis 0.97, Hamming window, magnitude spectrum,
26 triangular filters equally wide on the mel scale, logarithm, discrete cosine transform, liftering with L = 22. These
are the settings of the INTERSPEECH 2009 emotion challenge (Schuller, Steidl, Batliner 2009).
"""

from __future__ import annotations

import numpy as np

PRE_EMPHASIS = 0.97
BANDS = 26
LIFTER = 22
COEFFICIENTS = 12
# HTK reads 16-bit samples as they are, and takes no logarithm of less than 1.
_FULL_SCALE = 32768.0
_LEAST_BAND = 1.0


def mel(frequency: np.ndarray) -> np.ndarray:
    """Return the mel scale of frequencies in Hz (HTK Book 5.4)."""
    return 1127.0 * np.log1p(np.asarray(frequency, dtype=np.float64) / 700.0)


def mel_filters(bands: int, bins: int, rate: float) -> np.ndarray:
    """Return (bands, bins) weights of triangular filters from 0 Hz to rate / 2, straight lines on the mel scale.

    bins: number of frequencies of the spectrum, from 0 to rate / 2 inclusive.
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
