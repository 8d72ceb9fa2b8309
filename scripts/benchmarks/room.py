"""Sound in a simulated shoebox room: what each microphone of an array hears of each speaker.

Image-source method, J. B. Allen and D. A. Berkley, "Image method for efficiently simulating small-room acoustics",
Journal of the Acoustical Society of America 65 (1979) 943-950. Walls absorb alike; the absorption comes from the
reverberation time by Eyring's formula (C. F. Eyring, JASA 1, 1930). Delays are fractional: each image is a sinc under a
Hann window. Nothing moves, the sources radiate alike in all directions, and air does not absorb.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence, Tuple

import numpy as np
from scipy.signal import butter, fftconvolve, sosfilt

from hri_pipeline.core.audio.array import SPEED_OF_SOUND

RATE = 16000
_HALF_WIDTH = 32
"""Half the length (samples) of the windowed sinc."""
_FRACTIONS = 512
"""Fractional delays are rounded to 1/512 sample (42 micrometres of sound)."""
_HIGH_PASS = 60.0
"""Hz; images are all positive and would add up to a slow push, which no loudspeaker makes (Allen and Berkley, section
III)."""


@dataclass(frozen=True)
class Room:
    """A shoebox room. size: (3,) m; rt60: s, time in which sound decays by 60 dB; 0 means walls that return nothing.

    Raises ValueError for a size or time that no room has.
    """

    size: Tuple[float, float, float]
    rt60: float

    def __post_init__(self) -> None:
        if len(self.size) != 3 or not all(0.5 <= side <= 100.0 for side in self.size):
            raise ValueError("a room has three sides of 0.5 to 100 m, not {!r}".format(self.size))
        if not 0.0 <= self.rt60 <= 5.0:
            raise ValueError("rt60 is {!r} s, legal range 0 to 5".format(self.rt60))

    @property
    def reflection(self) -> float:
        """Factor of the pressure at each reflection, 0..1 (Eyring)."""
        if self.rt60 == 0.0:
            return 0.0
        a, b, c = self.size
        surface = 2.0 * (a * b + b * c + c * a)
        decay = 24.0 * np.log(10.0) / SPEED_OF_SOUND * a * b * c / (surface * self.rt60)
        return float(np.exp(-0.5 * decay))

    def responses(self, source: Sequence[float], microphones: np.ndarray) -> np.ndarray:
        """Return the impulse responses (C, L), 16 kHz, from `source` (3,) to `microphones` (C, 3), both in m from a
        corner of the room. Direct sound arrives at its true time, with amplitude 1 / distance.

        Raises ValueError for a point outside the room.
        """
        source = np.asarray(source, dtype=np.float64)
        microphones = np.asarray(microphones, dtype=np.float64)
        for point in np.vstack([source[None], microphones]):
            if not np.all((point > 0.0) & (point < self.size)):
                raise ValueError("the point {} lies outside the room {}".format(np.round(point, 3), self.size))
        images, gains = self._images(source, float(np.linalg.norm(microphones - source, axis=1).max()))
        length = self._length(float(np.linalg.norm(microphones - source, axis=1).max()))
        responses = np.stack([_impulses(np.linalg.norm(images - place, axis=1), gains, length)
                              for place in microphones])
        if self.rt60 > 0.0:
            responses = sosfilt(butter(2, _HIGH_PASS, "highpass", fs=RATE, output="sos"), responses, axis=1)
        return responses

    def _length(self, farthest: float) -> int:
        return int(np.ceil((farthest / SPEED_OF_SOUND + self.rt60) * RATE)) + 2 * _HALF_WIDTH

    def _images(self, source: np.ndarray, farthest: float) -> Tuple[np.ndarray, np.ndarray]:
        """Places (K, 3) m and gains (K,) of all images that arrive within the reverberation time."""
        if self.rt60 == 0.0:
            return source[None], np.ones(1)
        reach = farthest + SPEED_OF_SOUND * self.rt60
        axes = []
        for side, place in zip(self.size, source):
            order = int(np.ceil(reach / (2.0 * side))) + 1
            n = np.arange(-order, order + 1)
            # Allen and Berkley's (1 - 2p) x + 2 n L with |n - p| + |n| reflections.
            axes.append((np.concatenate([place + 2.0 * n * side, -place + 2.0 * n * side]),
                         np.concatenate([2 * np.abs(n), np.abs(n - 1) + np.abs(n)])))
        places = np.stack(np.meshgrid(*[axis[0] for axis in axes], indexing="ij"), axis=-1).reshape(-1, 3)
        orders = sum(np.meshgrid(*[axis[1] for axis in axes], indexing="ij")).reshape(-1)
        near = np.linalg.norm(places - source, axis=1) < reach + farthest
        return places[near], self.reflection ** orders[near].astype(np.float64)


def _impulses(distances: np.ndarray, gains: np.ndarray, length: int) -> np.ndarray:
    """Sum of delayed impulses (length,), each gain / distance at distance / speed of sound."""
    delays = distances / SPEED_OF_SOUND * RATE
    inside = delays < length - _HALF_WIDTH
    delays, heights = delays[inside], (gains / distances)[inside]
    steps = np.round(delays * _FRACTIONS).astype(np.int64)
    whole, fraction = steps // _FRACTIONS, steps % _FRACTIONS
    taps = np.arange(-_HALF_WIDTH + 1, _HALF_WIDTH + 1)
    # One row per fraction: sinc(t) under a Hann window that ends where the taps end.
    away = taps[None, :] - np.arange(_FRACTIONS)[:, None] / _FRACTIONS
    kernels = np.sinc(away) * np.cos(0.5 * np.pi * np.clip(away / _HALF_WIDTH, -1.0, 1.0)) ** 2
    response = np.zeros(length + 2 * _HALF_WIDTH)
    for begin in range(0, len(whole), 20000):
        part = slice(begin, begin + 20000)
        places = whole[part, None] + taps + _HALF_WIDTH
        response += np.bincount(places.ravel(), (heights[part, None] * kernels[fraction[part]]).ravel(), len(response))
    return response[_HALF_WIDTH:_HALF_WIDTH + length]


def images_at(responses: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Return what the microphones hear of `sound` (n,): (n, C), cut at the length of the sound."""
    return np.stack([fftconvolve(sound, response)[:len(sound)] for response in responses], axis=1)


def with_noise(sounds: Sequence[np.ndarray], snr_db: float, random: np.random.RandomState) -> np.ndarray:
    """Return the sum of images (n, C) with white noise, independent between microphones.

    snr_db: level of the first image where it is not silent, mean over the microphones, above the noise.
    """
    total = np.sum(sounds, axis=0)
    first = np.asarray(sounds[0])
    heard = np.mean(first ** 2, axis=1)
    power = float(heard[heard > 1e-4 * heard.max()].mean())
    noise = np.sqrt(power * 10.0 ** (-snr_db / 10.0))
    return total + noise * random.standard_normal(total.shape)
