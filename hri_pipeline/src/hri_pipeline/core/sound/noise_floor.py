"""Steady background noise of a microphone array, bin by bin, and how far a frame stands out of it and of its own echo."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

SMOOTHING = 0.85
"""Memory of the power from one frame to the next before its minimum is taken (0.1 s)."""
PARTS, PART_FRAMES = 6, 32
"""The minimum is that of the last 6 times 0.5 s: longer than a phrase of two people, so that speech itself is no noise."""
BIAS, BIAS_POWER = 1.1, -0.63
"""The minimum of the smoothed power of white noise lies below its mean by a factor 1 + 1.1 C^-0.63 with C channels
(measured with 2, 4 and 8)."""
NEIGHBOURS = 7
"""Bins (0.2 kHz) over which the noise is averaged: that of fans and rooms changes little from one bin to the next."""
RENEW_EVERY = 4
"""Frames from one look at the minima to the next: noise changes slowly."""
SILENCE = 1e-9
"""Power of a bin below which there is nothing: far less than the last bit of 16."""
ECHO_DECAY = 0.72
"""What is left of the power of a room one frame later at a reverberation time of 0.65 s; echoes come from wrong directions."""


class NoiseFloor:
    """Minimum statistics, after R. Martin, IEEE Transactions on Speech and Audio Processing 9 (2001), without its
    adaptive smoothing."""

    def __init__(self, bins: int, channels: int) -> None:
        self._bins = bins
        self._bias = 1.0 + BIAS * channels ** BIAS_POWER
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._smooth = None
        self._minima = np.full((PARTS, self._bins), np.inf, dtype=np.float32)
        self._frame = 0
        self._echo = np.zeros(self._bins, dtype=np.float32)
        self.power = np.full(self._bins, SILENCE, dtype=np.float32)

    def update(self, power: np.ndarray) -> np.ndarray:
        """Take the power (bins,) of a frame, mean over the channels; returns how sure each bin is direct sound, 0..1.

        Afterwards `power` is the expected power of the noise.
        """
        if self._smooth is None:
            self._smooth = power.copy()
        self._smooth = SMOOTHING * self._smooth + (1.0 - SMOOTHING) * power
        part = (self._frame // PART_FRAMES) % PARTS
        if self._frame % PART_FRAMES == 0:
            self._minima[part] = np.inf
        np.minimum(self._minima[part], self._smooth, out=self._minima[part])
        if self._frame % RENEW_EVERY == 0:
            noise = uniform_filter1d(self._minima.min(axis=0), NEIGHBOURS, mode="nearest")
            self.power = np.maximum(self._bias * noise, SILENCE)
        self._frame += 1
        sure = np.clip(1.0 - (1.5 * self.power + self._echo) / np.maximum(power, SILENCE), 0.0, 1.0)
        self._echo = ECHO_DECAY * np.maximum(self._echo, power)
        return sure
