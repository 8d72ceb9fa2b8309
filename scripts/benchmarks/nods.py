"""Nods and shakes of simulated heads: how many are found, and how often something else is taken for one.

Heads of five kinds, seen 10 times per second: still, looking around, talking, walking, and those that nod or shake now
and then while they do one of the former. What they do is drawn for each head and second:

- pose noise: standard deviations of 0.4 (yaw) and 0.3 degrees (pitch), correlation 0.4 from image to image: somewhat
  more than of 12 faces of 60 to 310 px on photographs that were moved and made noisy (0.2 to 0.4, 0.1 to 0.26; 0.4);
- sway of people who sit or stand: 1 degree, below 0.5 Hz;
- looks: other directions up to 45 degrees to the side, 20 down and 12 up, each 0.4 to 3 s, in 0.2 to 0.5 s (Fuller, J.
  Vestibular Res. 2, 1992), often to and fro between two;
- speech: movements of 0.7 to 3 degrees (standard deviation) in both axes between 0.3 and 4 Hz (Hadar, Steiner, Clifford
  Rose, Human Movement Science 2, 1983), and 1 degree more of pitch from the jaw;
- steps: pitch of 2 to 5 degrees from peak to peak at 1.6 to 2.2 Hz, half of it in yaw at half the frequency
  (Hirasaki et al., Exp. Brain Res. 127, 1999), towards or away from the camera at 0.5 to 1.4 m/s;
- gestures: 2 to 5 cycles of 1.2 to 3 Hz, from peak to peak 6 to 25 (nods) or 8 to 35 degrees (shakes), which grow
  smaller or larger by up to 30 %, with up to a fifth of it in the other axis.
"""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple, Sequence, Tuple

import numpy as np

from hri_pipeline.core.faces.head_gestures import HeadGestures

RATE_HZ = 10.0
SEEDS, TUNING_SEEDS = tuple(range(100, 140)), tuple(range(20))
"""Heads of the figures told; the detector's limits were looked at with the others."""
KINDS = ("still", "looking", "talking", "walking")
NOD, SHAKE = "nod", "shake"
_SECONDS = 60.0
_SLACK_S = 0.5
"""A gesture is found when it is told at any time from its begin to so long after its end."""


class Gesture(NamedTuple):
    """kind: NOD or SHAKE; begin, end: s."""

    kind: str
    begin: float
    end: float


class Head(NamedTuple):
    """One head over time: stamps (N,) s, yaws and pitches (N,) rad and distances (N,) m as measured, and the truth."""

    stamps: np.ndarray
    yaws: np.ndarray
    pitches: np.ndarray
    distances: np.ndarray
    gestures: List[Gesture]


def head(kind: str, seed: int, rate: float = RATE_HZ) -> Head:
    """Return a head of KINDS over one minute; every second one nods and shakes, too."""
    rng = np.random.RandomState(7919 * KINDS.index(kind) + seed)
    stamps = np.arange(int(_SECONDS * rate)) / rate
    angles = np.array([_band(stamps, 0.05, 0.5, rng), _band(stamps, 0.05, 0.5, rng)])
    distances = np.full(len(stamps), rng.uniform(0.6, 3.0))
    if kind == "looking":
        angles += _looks(stamps, rng)
    elif kind == "talking":
        size = rng.uniform(0.7, 3.0)
        angles += size * np.array([_band(stamps, 0.3, 4.0, rng), _band(stamps, 0.3, 4.0, rng)])
        angles[1] += _band(stamps, 2.0, 5.0, rng)
    elif kind == "walking":
        steps, begin = rng.uniform(1.6, 2.2), rng.uniform(0.0, 6.0)
        size = 0.5 * rng.uniform(2.0, 5.0)
        angles[1] += size * np.sin(2.0 * math.pi * steps * stamps + begin)
        angles[0] += 0.5 * size * np.sin(math.pi * steps * stamps + begin)
        # To and fro in front of the camera.
        way = rng.uniform(0.5, 1.4) * stamps % 6.0
        distances = 1.0 + np.minimum(way, 6.0 - way)
    gestures = _gestures(stamps, angles, rng) if seed % 2 else []
    noise = np.array([_noise(len(stamps), 0.4, rng), _noise(len(stamps), 0.3, rng)])
    yaws, pitches = np.radians(angles + noise)
    return Head(stamps, yaws, pitches, distances + rng.normal(0.0, 0.01, len(stamps)), gestures)


def _noise(count: int, sd: float, rng: np.random.RandomState) -> np.ndarray:
    noise = rng.normal(0.0, sd, count)
    for index in range(1, count):
        noise[index] = 0.4 * noise[index - 1] + math.sqrt(1.0 - 0.16) * noise[index]
    return noise


def _band(stamps: np.ndarray, low: float, high: float, rng: np.random.RandomState) -> np.ndarray:
    """Movement (N,) of standard deviation 1 between two frequencies (Hz), the slow parts larger."""
    frequencies = np.exp(rng.uniform(math.log(low), math.log(high), 40))
    waves = np.sin(2.0 * math.pi * np.outer(stamps, frequencies) + rng.uniform(0.0, 2.0 * math.pi, 40))
    sum_of = (waves / np.sqrt(frequencies)).sum(axis=1)
    return sum_of / sum_of.std()


def _looks(stamps: np.ndarray, rng: np.random.RandomState) -> np.ndarray:
    """Directions (2, N) degrees of a head that looks around, now and then to and fro between two places."""
    angles = np.zeros((2, len(stamps)))
    now, here, before = 0.0, np.zeros(2), np.zeros(2)
    while now < stamps[-1]:
        there = before if rng.rand() < 0.4 else np.array([rng.uniform(-45.0, 45.0), rng.uniform(-20.0, 12.0)])
        takes = rng.uniform(0.2, 0.5)
        part = np.clip((stamps - now) / takes, 0.0, 1.0)
        moved = (there - here)[:, None] * (10.0 * part ** 3 - 15.0 * part ** 4 + 6.0 * part ** 5)
        angles = np.where(stamps >= now, here[:, None] + moved, angles)
        before, here = here, there
        now += takes + rng.uniform(0.4, 3.0)
    return angles


def _gestures(stamps: np.ndarray, angles: np.ndarray, rng: np.random.RandomState) -> List[Gesture]:
    """Add nods and shakes to the angles (2, N), degrees; return them."""
    found: List[Gesture] = []
    now = rng.uniform(2.0, 6.0)
    while now < stamps[-1] - 5.0:
        kind = NOD if rng.rand() < 0.5 else SHAKE
        axis = 1 if kind == NOD else 0
        cycles, frequency = rng.randint(2, 6), rng.uniform(1.2, 3.0)
        size = rng.uniform(6.0, 25.0) if kind == NOD else rng.uniform(8.0, 35.0)
        lasts = cycles / frequency
        part = (stamps - now) / lasts
        during = (part >= 0.0) & (part <= 1.0)
        grown = 1.0 + rng.uniform(-0.3, 0.3) * (2.0 * part - 1.0)
        # A nod begins and ends where the head was: down, and up again.
        wave = -0.5 * (1.0 - np.cos(2.0 * math.pi * cycles * part)) if kind == NOD else 0.5 * np.sin(
            2.0 * math.pi * cycles * part)
        angles[axis] += np.where(during, size * grown * wave, 0.0)
        angles[1 - axis] += np.where(during, rng.uniform(0.0, 0.2) * size * grown * wave, 0.0)
        found.append(Gesture(kind, now, now + lasts))
        now += lasts + rng.uniform(2.0, 7.0)
    return found


def told(one: Head) -> List[Gesture]:
    """Return what is found in a head: each time without a break of more than _SLACK_S."""
    gestures, found = HeadGestures(), []
    open_ones: Dict[str, Tuple[float, float]] = {}
    for stamp, yaw, pitch, distance in zip(one.stamps, one.yaws, one.pitches, one.distances):
        gesture = gestures.update(yaw, pitch, distance, stamp)
        for kind, strength in ((NOD, gesture.nod), (SHAKE, gesture.shake)):
            if strength <= 0.0:
                continue
            begin, end = open_ones.get(kind, (stamp, stamp))
            if stamp - end > _SLACK_S:
                found.append(Gesture(kind, begin, end))
                begin = stamp
            open_ones[kind] = begin, stamp
    return found + [Gesture(kind, begin, end) for kind, (begin, end) in open_ones.items()]


def nod_figures(seeds: Sequence[int] = SEEDS, rate: float = RATE_HZ) -> Dict[str, Dict[str, float]]:
    """Return {"nod", "shake": precision, recall, told, true}: of gestures, over all kinds of heads."""
    sums = {kind: np.zeros(4) for kind in (NOD, SHAKE)}
    for kind in KINDS:
        for seed in seeds:
            one = head(kind, seed, rate)
            found = told(one)
            for name, counts in sums.items():
                true = [gesture for gesture in one.gestures if gesture.kind == name]
                answers = [gesture for gesture in found if gesture.kind == name]
                counts += (sum(any(_same(answer, gesture) for gesture in true) for answer in answers), len(answers),
                           sum(any(_same(answer, gesture) for answer in answers) for gesture in true), len(true))
    return {name: {"precision": right / max(1.0, said), "recall": hit / max(1.0, there), "told": said, "true": there}
            for name, (right, said, hit, there) in ((name, counts.tolist()) for name, counts in sums.items())}


def _same(answer: Gesture, gesture: Gesture) -> bool:
    return answer.begin <= gesture.end + _SLACK_S and answer.end >= gesture.begin


__all__ = ["KINDS", "SEEDS", "TUNING_SEEDS", "head", "nod_figures", "told"]
