"""Direction and separation of voices in simulated rooms: four microphones, one or two speakers, real speech, noise.

Which sound a figure speaks of goes by the time of the sound, not by the time at which it was known: a source's first
signal reaches back to before it was confirmed.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from benchmarks.room import RATE, Room, images_at, with_noise
from benchmarks.speech_files import HELD_OUT_FILES, TUNING_FILES, read_speech
from hri_pipeline.core.audio.separation import SoundSeparator

BLOCK = 480
"""Samples (30 ms) handed in at a time."""
RIGHT = np.radians(20.0)
"""A source within this angle of a speaker is this speaker's; two speakers are more than twice as far apart."""
FIRST_SEED = 1000
"""Constants were chosen on seeds below 100."""


@dataclass(frozen=True)
class Piece:
    """One signal as it came out. begin: sample of the scene."""

    key: int
    begin: int
    samples: np.ndarray
    direction: np.ndarray
    sd: float
    active: bool

    @property
    def span(self) -> slice:
        """The samples of the scene that it covers."""
        return slice(self.begin, self.begin + len(self.samples))


def listen(scene: ArrayScene, block: int = BLOCK) -> Tuple[List[Piece], float]:
    """Return what the separator makes of a scene, and the processor time (s) of that."""
    separator = SoundSeparator(scene.positions)
    sound = scene.sound.astype(np.float32)
    pieces: List[Piece] = []
    began = time.process_time()
    for first in range(0, len(sound), block):
        for signal in separator.process(sound[first:first + block]):
            pieces.append(Piece(signal.key, first + signal.offset, signal.samples, signal.direction,
                                signal.direction_sd, signal.active))
    return pieces, time.process_time() - began


def direction_errors(scene: ArrayScene, pieces: Sequence[Piece]) -> np.ndarray:
    """Return the errors of azimuth (rad) of all sources that are heard while all speakers of the scene speak, each
    against the speaker next to it."""
    return np.array([azimuth_errors(scene.directions, piece.direction).min() for piece in pieces
                     if piece.active and scene.speaking[:, piece.span].all()])


def keys_of_speakers(scene: ArrayScene, pieces: Sequence[Piece]) -> List[Optional[int]]:
    """Return per speaker the key of the source that has its direction for most of the time; None: nobody has."""
    keys: List[Optional[int]] = []
    for direction in scene.directions:
        lengths: Dict[int, int] = {}
        for piece in pieces:
            if azimuth_errors(direction, piece.direction) <= RIGHT:
                lengths[piece.key] = lengths.get(piece.key, 0) + len(piece.samples)
        keys.append(max(lengths, key=lambda key: lengths[key]) if lengths else None)
    return keys


def kept_apart(scene: ArrayScene, pieces: Sequence[Piece]) -> float:
    """Return the part of the time when all speak in which each speaker has a source of its own at its place, always the
    same one."""
    apart = scene.speaking.all(axis=0)
    wanted = int(apart.sum())
    for direction, key in zip(scene.directions, keys_of_speakers(scene, pieces)):
        there = np.zeros(apart.shape, dtype=bool)
        for piece in pieces:
            if piece.key == key and azimuth_errors(direction, piece.direction) <= RIGHT:
                there[piece.span] = True
        apart = apart & there
    return float(apart.sum()) / wanted


def si_sdr(estimate: np.ndarray, reference: np.ndarray) -> float:
    """Return the scale-invariant signal-to-distortion ratio (dB) of a signal (n,) against a reference (n,): J. Le Roux
    et al., "SDR - half-baked or well done?", ICASSP 2019."""
    target = float(estimate @ reference) / float(reference @ reference) * reference
    return float(10.0 * np.log10(np.sum(target ** 2) / np.sum((estimate - target) ** 2)))


def separation_gains(scene: ArrayScene, pieces: Sequence[Piece]) -> List[float]:
    """Return per speaker by how many dB the SI-SDR of its source is above that of the first microphone.

    Reference: the image of the speaker at the first microphone, with all echoes. Looked at from when all have begun to
    speak until the first of them has ended. A speaker without a source gains nothing: 0.
    """
    together = np.flatnonzero(scene.speaking.all(axis=0))
    part = slice(together[0], min(together[-1] + 1, max(piece.span.stop for piece in pieces)) if pieces else None)
    gains = []
    for image, key in zip(scene.images, keys_of_speakers(scene, pieces)):
        signal = np.zeros(len(scene.sound))
        for piece in pieces:
            if piece.key == key:
                signal[piece.span] = piece.samples
        before = si_sdr(scene.sound[part, 0], image[part, 0])
        gains.append(si_sdr(signal[part], image[part, 0]) - before if signal[part].any() else 0.0)
    return gains


def strangers(scene: ArrayScene, pieces: Sequence[Piece]) -> int:
    """Return the number of sources besides one for each speaker."""
    return len({piece.key for piece in pieces}) - len({key for key in keys_of_speakers(scene, pieces)
                                                       if key is not None})


def figures_of(speakers: int, seeds: Sequence[int], tuning: bool = False) -> Dict[str, float]:
    """Return the figures of scenes with so many speakers: angles in degrees, gains in dB, cpu in % of a core."""
    errors, gains, apart, within, others, spent, length = [], [], [], [], 0, 0.0, 0.0
    for seed in seeds:
        scene = make_scene(seed, speakers, tuning=tuning)
        pieces, seconds = listen(scene)
        errors.append(np.degrees(direction_errors(scene, pieces)))
        within += [azimuth_errors(scene.directions, piece.direction).min() <= piece.sd for piece in pieces
                   if piece.active]
        gains += separation_gains(scene, pieces)
        apart.append(kept_apart(scene, pieces))
        others += strangers(scene, pieces)
        spent, length = spent + seconds, length + len(scene.sound) / RATE
    found = np.concatenate(errors)
    return {"error_median": float(np.median(found)), "error_p90": float(np.percentile(found, 90)),
            "kept": float(np.mean(apart)), "kept_least": float(np.min(apart)), "gain_mean": float(np.mean(gains)),
            "gain_least": float(np.min(gains)), "within_sd": float(np.mean(within)),
            "strangers_per_minute": 60.0 * others / length, "cpu_percent": 100.0 * spent / length}


def figures(scenes: int = 12) -> Dict[str, object]:
    """Return the figures of `scripts/benchmark voices`, on recordings, rooms and places that nothing was chosen on.

    doa_error_deg_1, doa_error_deg_2: medians; kept_apart: mean; si_sdr_gain_db: mean of two speakers who talk at the
    same time; details beside them. Raises FileNotFoundError when the recordings are not there.
    """
    seeds = range(FIRST_SEED, FIRST_SEED + scenes)
    alone, both = figures_of(1, seeds), figures_of(2, seeds)
    report: Dict[str, object] = {
        "doa_error_deg_1": alone["error_median"], "doa_error_deg_2": both["error_median"],
        "kept_apart": both["kept"], "si_sdr_gain_db": both["gain_mean"]}
    report["array_details"] = {"scenes": scenes, "one": alone, "two": both}
    return report


RT60, SNR_DB = 0.3, 10.0
"""Reverberation time (s), and level (dB) of the first speaker above the noise; speakers are equally loud at the
array."""
DIAMETERS = (0.065, 0.08, 0.1)
"""Diameters (m) of the arrays: four microphones on a circle, as on the heads of common robots."""
LEAST_ANGLE = np.radians(45.0)
"""Two speakers are at least so far apart, seen from the array."""
LEAD = 1.0
"""Seconds of noise before anybody speaks: a robot has listened before somebody comes."""
LEVEL = 0.05
"""Loudness (root mean square) of each speaker."""
_READER = "librivox"
_WINDOW, _RANGE_DB, _BRIDGE = 400, 26.0, 0.2


@dataclass(frozen=True)
class ArrayScene:
    """What an array hears, 16 kHz.

    positions: (4, 3) m. directions: (S, 3) unit, from the array to each speaker. images: per speaker (n, 4), alone and
    without noise. sound: (n, 4) all together. speaking: (S, n) bool, within 26 dB of the speaker's loudest 25 ms,
    pauses below 0.2 s included.
    """

    positions: np.ndarray
    directions: np.ndarray
    images: Tuple[np.ndarray, ...]
    sound: np.ndarray
    speaking: np.ndarray


def make_scene(seed: int, speakers: int, seconds: float = 7.0, tuning: bool = False,
               taking_turns: bool = False) -> ArrayScene:
    """Return a scene: a room of 4 to 7 by 3.5 to 6 by 2.5 to 3.2 m, an array well inside, speakers 1 to 2 m away from
    it.

    The first speaker is the reader of LibriVox, the second one of the others; a lone speaker is either. tuning:
    recordings that constants may be chosen on, else those held out. taking_turns: speakers do not talk at the same
    time, but one after the other in parts of 2 s.
    """
    random = np.random.RandomState(seed)
    count = int(seconds * RATE)
    size = (random.uniform(4.0, 7.0), random.uniform(3.5, 6.0), random.uniform(2.5, 3.2))
    centre = np.array([random.uniform(1.5, size[0] - 1.5), random.uniform(1.4, size[1] - 1.4),
                       random.uniform(0.9, 1.5)])
    positions = circle(4, DIAMETERS[seed % len(DIAMETERS)], random.uniform(0.0, np.pi))
    room = Room(size, RT60)
    places = _places(random, size, centre, speakers)
    banks = _banks(tuning)
    images: List[np.ndarray] = []
    speaking = np.zeros((speakers, int(LEAD * RATE) + count), dtype=bool)
    for index, place in enumerate(places):
        voice = talk(banks[(index + (seed % 2 if speakers == 1 else 0)) % 2], count, random)
        if taking_turns:
            voice = voice * ((np.arange(count) // (2 * RATE)) % speakers == index)
        voice = np.concatenate([np.zeros(int(LEAD * RATE)), voice])
        image = images_at(room.responses(place, positions + centre), voice)
        images.append(image * (LEVEL / loudness(image.mean(axis=1))))
        speaking[index] = speaking_samples(voice)
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


def talk(bank: Sequence[np.ndarray], count: int, random: np.random.RandomState) -> np.ndarray:
    """Recordings one after the other, equally loud, with pauses of 0.2 s: (count,)."""
    parts: List[np.ndarray] = []
    while sum(len(part) for part in parts) < count:
        for index in random.permutation(len(bank)):
            sound = bank[index] - bank[index].mean()
            parts += [sound * (LEVEL / loudness(sound)), np.zeros(int(0.2 * RATE))]
    return np.concatenate(parts)[:count]


def loudness(sound: np.ndarray) -> float:
    """Root mean square of a sound (n,) where it is not silent."""
    power = np.convolve(sound ** 2, np.full(_WINDOW, 1.0 / _WINDOW), "same")
    return float(np.sqrt(np.mean(power[power > 1e-3 * power.max()])))


def speaking_samples(voice: np.ndarray) -> np.ndarray:
    """Return where a clean voice (n,) speaks, (n,) bool: within 26 dB of its loudest, pauses below 0.2 s included."""
    power = np.convolve(voice ** 2, np.full(_WINDOW, 1.0 / _WINDOW), "same")
    loud = power > power.max() * 10.0 ** (-_RANGE_DB / 10.0)
    result = loud.copy()
    edges = np.flatnonzero(np.diff(loud.astype(np.int8)))
    # From an end (True, False) to the next beginning (False, True).
    for end, begin in zip(edges[:-1], edges[1:]):
        if loud[end] and begin - end < _BRIDGE * RATE:
            result[end:begin + 1] = True
    return result
