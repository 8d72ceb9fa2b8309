"""Scenes for microphone arrays: real speech from one or two places of a simulated room, with noise, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import numpy as np

from hri_pipeline.evaluation.room import RATE, Room, images_at, with_noise
from hri_pipeline.evaluation.speech_files import HELD_OUT_FILES, TUNING_FILES, read_speech

RT60, SNR_DB = 0.3, 10.0
"""Reverberation time (s), and level (dB) of the first speaker above the noise; speakers are equally loud at the array."""
DIAMETERS = (0.065, 0.08, 0.1)
"""Diameters (m) of the arrays: four microphones on a circle, as on the heads of common robots."""
LEAST_ANGLE = np.radians(45.0)
"""Two speakers are at least so far apart, seen from the array."""
LEAD = 1.0
"""Seconds of noise before anybody speaks: a robot has listened before somebody comes."""
_LEVEL = 0.05
_READER = "librivox"
_WINDOW, _RANGE_DB, _BRIDGE = 400, 26.0, 0.2


@dataclass(frozen=True)
class ArrayScene:
    """What an array hears, 16 kHz.

    positions: (4, 3) m. directions: (S, 3) unit, from the array to each speaker. images: per speaker (n, 4), alone and
    without noise. sound: (n, 4) all together. speaking: (S, n) bool, within 26 dB of the speaker's loudest 25 ms, pauses
    below 0.2 s included.
    """

    positions: np.ndarray
    directions: np.ndarray
    images: Tuple[np.ndarray, ...]
    sound: np.ndarray
    speaking: np.ndarray


def make_scene(seed: int, speakers: int, seconds: float = 7.0, tuning: bool = False, taking_turns: bool = False) -> ArrayScene:
    """Return a scene: a room of 4 to 7 by 3.5 to 6 by 2.5 to 3.2 m, an array well inside, speakers 1 to 2 m away from it.

    The first speaker is the reader of LibriVox, the second one of the others; a lone speaker is either. tuning: recordings
    that constants may be chosen on, else those held out. taking_turns: speakers do not talk at the same time, but one after
    the other in parts of 2 s.
    """
    random = np.random.RandomState(seed)
    count = int(seconds * RATE)
    size = (random.uniform(4.0, 7.0), random.uniform(3.5, 6.0), random.uniform(2.5, 3.2))
    centre = np.array([random.uniform(1.5, size[0] - 1.5), random.uniform(1.4, size[1] - 1.4), random.uniform(0.9, 1.5)])
    positions = circle(4, DIAMETERS[seed % len(DIAMETERS)], random.uniform(0.0, np.pi))
    room = Room(size, RT60)
    places = _places(random, size, centre, speakers)
    banks = _banks(tuning)
    images: List[np.ndarray] = []
    speaking = np.zeros((speakers, int(LEAD * RATE) + count), dtype=bool)
    for index, place in enumerate(places):
        voice = _talk(banks[(index + (seed % 2 if speakers == 1 else 0)) % 2], count, random)
        if taking_turns:
            voice = voice * ((np.arange(count) // (2 * RATE)) % speakers == index)
        voice = np.concatenate([np.zeros(int(LEAD * RATE)), voice])
        image = images_at(room.responses(place, positions + centre), voice)
        images.append(image * (_LEVEL / _loudness(image.mean(axis=1))))
        speaking[index] = _speaking(voice)
    directions = (places - centre) / np.linalg.norm(places - centre, axis=1, keepdims=True)
    return ArrayScene(positions, directions, tuple(images), with_noise(images, SNR_DB, random), speaking)


def circle(count: int, diameter: float, turn: float = 0.0) -> np.ndarray:
    """Return the positions (count, 3) m of microphones on a level circle, the first at the angle `turn` (rad)."""
    angles = turn + 2.0 * np.pi * np.arange(count) / count
    return 0.5 * diameter * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)


def azimuths(directions: np.ndarray) -> np.ndarray:
    """Return the azimuths (...,) rad of directions (..., 3)."""
    return np.arctan2(directions[..., 1], directions[..., 0])


def azimuth_errors(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angle (rad, 0..pi) between the azimuths of directions."""
    return np.abs((azimuths(a) - azimuths(b) + np.pi) % (2.0 * np.pi) - np.pi)


def _places(random: np.random.RandomState, size: Sequence[float], centre: np.ndarray, count: int) -> np.ndarray:
    """Places (count, 3) m of the speakers' mouths, 0.3 m and more from the walls."""
    places: List[np.ndarray] = []
    while len(places) < count:
        angle, distance = random.uniform(-np.pi, np.pi), random.uniform(1.0, 2.0)
        place = centre + [distance * np.cos(angle), distance * np.sin(angle), random.uniform(-0.1, 0.4)]
        inside = np.all((place > 0.3) & (place < np.array(size) - 0.3))
        if inside and all(azimuth_errors(place - centre, other - centre) >= LEAST_ANGLE for other in places):
            places.append(place)
    return np.array(places)


def _banks(tuning: bool) -> Tuple[List[np.ndarray], List[np.ndarray]]:
    """The recordings of the reader, and those of the others."""
    speech: Dict[str, np.ndarray] = read_speech(TUNING_FILES if tuning else HELD_OUT_FILES)
    return ([sound for name, sound in speech.items() if _READER in name],
            [sound for name, sound in speech.items() if _READER not in name])


def _talk(bank: Sequence[np.ndarray], count: int, random: np.random.RandomState) -> np.ndarray:
    """Recordings one after the other, equally loud, with pauses of 0.2 s: (count,)."""
    parts: List[np.ndarray] = []
    while sum(len(part) for part in parts) < count:
        for index in random.permutation(len(bank)):
            sound = bank[index] - bank[index].mean()
            parts += [sound * (_LEVEL / _loudness(sound)), np.zeros(int(0.2 * RATE))]
    return np.concatenate(parts)[:count]


def _loudness(sound: np.ndarray) -> float:
    """Root mean square of a sound (n,) where it is not silent."""
    power = np.convolve(sound ** 2, np.full(_WINDOW, 1.0 / _WINDOW), "same")
    return float(np.sqrt(np.mean(power[power > 1e-3 * power.max()])))


def _speaking(voice: np.ndarray) -> np.ndarray:
    power = np.convolve(voice ** 2, np.full(_WINDOW, 1.0 / _WINDOW), "same")
    loud = power > power.max() * 10.0 ** (-_RANGE_DB / 10.0)
    result = loud.copy()
    edges = np.flatnonzero(np.diff(loud.astype(np.int8)))
    # From an end (True, False) to the next beginning (False, True).
    for end, begin in zip(edges[:-1], edges[1:]):
        if loud[end] and begin - end < _BRIDGE * RATE:
            result[end:begin + 1] = True
    return result
