"""Figures of direction and separation in simulated rooms (see `array_scenes`): four microphones, one or two speakers.

Which sound a figure speaks of goes by the time of the sound, not by the time at which it was known: a source's first signal
reaches back to before it was confirmed.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.sound.sound_separation import SoundSeparator
from hri_pipeline.evaluation.array_scenes import ArrayScene, azimuth_errors, make_scene
from hri_pipeline.evaluation.room import RATE

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
    """Return the errors of azimuth (rad) of all sources that are heard while all speakers of the scene speak, each against
    the speaker next to it."""
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

    Reference: the image of the speaker at the first microphone, with all echoes. Looked at from when all have begun to speak
    until the first of them has ended. A speaker without a source gains nothing: 0.
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
    return len({piece.key for piece in pieces}) - len({key for key in keys_of_speakers(scene, pieces) if key is not None})


def figures_of(speakers: int, seeds: Sequence[int], tuning: bool = False) -> Dict[str, float]:
    """Return the figures of scenes with so many speakers: angles in degrees, gains in dB, cpu in % of a core."""
    errors, gains, apart, within, others, spent, length = [], [], [], [], 0, 0.0, 0.0
    for seed in seeds:
        scene = make_scene(seed, speakers, tuning=tuning)
        pieces, seconds = listen(scene)
        errors.append(np.degrees(direction_errors(scene, pieces)))
        within += [azimuth_errors(scene.directions, piece.direction).min() <= piece.sd for piece in pieces if piece.active]
        gains += separation_gains(scene, pieces)
        apart.append(kept_apart(scene, pieces))
        others += strangers(scene, pieces)
        spent, length = spent + seconds, length + len(scene.sound) / RATE
    found = np.concatenate(errors)
    return {"error_median": float(np.median(found)), "error_p90": float(np.percentile(found, 90)),
            "kept": float(np.mean(apart)), "kept_least": float(np.min(apart)), "gain_mean": float(np.mean(gains)),
            "gain_least": float(np.min(gains)), "within_sd": float(np.mean(within)),
            "strangers_per_minute": 60.0 * others / length, "cpu_percent": 100.0 * spent / length}


def array_figures(scenes: int = 12) -> Dict[str, object]:
    """Return the figures of `scripts/benchmark voices`, on recordings, rooms and places that nothing was chosen on.

    doa_error_deg_1, doa_error_deg_2: medians; kept_apart: mean; si_sdr_gain_db: mean of two speakers who talk at the same time;
    details beside them. Raises FileNotFoundError when the recordings are not there.
    """
    seeds = range(FIRST_SEED, FIRST_SEED + scenes)
    alone, both = figures_of(1, seeds), figures_of(2, seeds)
    report: Dict[str, object] = {
        "doa_error_deg_1": alone["error_median"], "doa_error_deg_2": both["error_median"],
        "kept_apart": both["kept"], "si_sdr_gain_db": both["gain_mean"]}
    report["array_details"] = {"scenes": scenes, "one": alone, "two": both}
    return report
