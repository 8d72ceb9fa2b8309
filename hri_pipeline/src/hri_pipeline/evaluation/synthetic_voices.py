"""Voices whose fundamental frequency and harmonics-to-noise ratio are known: pulses, formants, white noise."""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np
from scipy.signal import lfilter

RATE = 16000
# Formants (Hz) and bandwidths (Hz) of American vowels: Peterson and Barney (1952), men; bandwidths: Dunn (1961).
VOWELS = {
    "a": ((730.0, 60.0), (1090.0, 70.0), (2440.0, 110.0)),
    "i": ((270.0, 60.0), (2290.0, 100.0), (3010.0, 120.0)),
    "u": ((300.0, 60.0), (870.0, 80.0), (2240.0, 110.0)),
}
FREQUENCIES = (90.0, 103.7, 120.0, 150.0, 180.0, 220.0, 262.3, 300.0, 350.0, 400.0, 440.0)
RATIOS_DB = (5.0, 10.0, 20.0, 30.0, 40.0)
# The spectrum of the glottal pulse falls by 12 dB per octave (Fant 1960), and radiation from the lips gives 6 back.
_TILT = -1.0
_HIGHEST_HZ = 7600.0


def voiced(frequency: float, seconds: float, formants: Sequence[Tuple[float, float]]) -> np.ndarray:
    """Return (n,) samples at 16 kHz of a periodic voice without aliases, of root mean square 1.

    frequency: Hz, need not divide the sample rate. formants: (Hz, bandwidth Hz).
    """
    time = np.arange(int(seconds * RATE)) / RATE
    harmonics = np.arange(1, int(_HIGHEST_HZ / frequency) + 1)
    sound = np.zeros(len(time))
    for harmonic in harmonics:
        sound += harmonic ** _TILT * np.cos(2.0 * np.pi * harmonic * frequency * time)
    for centre, bandwidth in formants:
        radius = np.exp(-np.pi * bandwidth / RATE)
        sound = lfilter([1.0 - radius], [1.0, -2.0 * radius * np.cos(2.0 * np.pi * centre / RATE), radius ** 2], sound)
    return sound / np.sqrt(np.mean(sound ** 2))


def with_noise(sound: np.ndarray, ratio: float, random: np.random.Generator, level: float = 0.1) -> np.ndarray:
    """Return `sound` with white noise `ratio` dB below it, the voice at root mean square `level`."""
    noise = random.normal(size=len(sound)) * np.sqrt(np.mean(sound ** 2)) * 10.0 ** (-ratio / 20.0)
    return level * (sound + noise)
