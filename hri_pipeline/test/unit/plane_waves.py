"""Sounds from exact directions, as an array hears them without any room."""

import numpy as np

RATE = 16000
SQUARE = np.array([[0.04, 0.04, 0.0], [-0.04, 0.04, 0.0], [-0.04, -0.04, 0.0], [0.04, -0.04, 0.0]])


def towards(azimuth, elevation=0.0):
    """Unit vector (3,) at angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def plane_wave(sound, positions, direction, speed=343.0):
    """What microphones at `positions` (C, 3) hear of a sound (n,) from a direction: (n, C), delayed by whole
    spectra."""
    frequencies = np.fft.rfftfreq(len(sound), 1.0 / RATE)
    delays = -(positions - positions.mean(axis=0)) @ direction / speed
    spectrum = np.fft.rfft(sound)[:, None] * np.exp(-2j * np.pi * frequencies[:, None] * delays[None])
    return np.fft.irfft(spectrum, len(sound), axis=0)


def babble(seconds, seed, rate=4.0):
    """Something like speech: noise whose level and colour change several times a second, with pauses. (n,), rms
    0.05."""
    random = np.random.RandomState(seed)
    count = int(seconds * RATE)
    steps = int(seconds * rate) + 2
    knots = np.linspace(0.0, count, steps)
    result = np.zeros(count)
    for low, high in ((200, 500), (500, 1000), (1000, 1800), (1800, 3000), (3000, 5000)):
        spectrum = np.fft.rfft(random.standard_normal(count))
        frequencies = np.fft.rfftfreq(count, 1.0 / RATE)
        spectrum[(frequencies < low) | (frequencies >= high)] = 0.0
        level = np.interp(np.arange(count), knots, random.gamma(0.3, 1.0, steps))
        result += level * np.fft.irfft(spectrum, count)
    return 0.05 * result / np.sqrt(np.mean(result ** 2))


def noise(count, channels, level=1e-4, seed=0):
    """White noise (count, channels)."""
    return level * np.random.RandomState(seed).standard_normal((count, channels))


def angle(a, b):
    """Angle in degrees between two unit vectors."""
    return float(np.degrees(np.arccos(np.clip(np.dot(a, b), -1.0, 1.0))))
