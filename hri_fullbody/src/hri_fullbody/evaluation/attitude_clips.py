"""Clips with a known attitude: recorded motion as it is, and with the arms moved into an attitude for a while.

Truth of the made clips: the time in which the arms are fully there. Truth of recorded motion, which has hands above
shoulders (lifting, swords overhead) and at the face (02_10 washes face and neck): told from the points without noise,
see `natural_truth`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import List, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core import skeleton as kp
from hri_fullbody.core.human.segment_table import SegmentTable
from hri_fullbody.core.language.attitude import Attitude
from hri_fullbody.evaluation.attitude_arms import move_arms
from hri_fullbody.evaluation.mocap import Motion, before_camera, load_motion
from hri_fullbody.evaluation.virtual_people import virtual_people

WALKING = ("02_01", "02_02", "02_03", "03_01")
ALL = ("02_01", "02_02", "02_03", "02_04", "02_05", "02_06", "02_07", "02_08", "02_09", "02_10", "03_01")
TUNED_ON = ("02_02", "02_04", "02_06", "02_08", "02_10")
HELD_OUT = tuple(name for name in ALL if name not in TUNED_ON)
CLASSES = (Attitude.HANDS_ON_FACE, Attitude.ARMS_CROSSED, Attitude.HANDS_RAISED)

_RATE = 30.0
_MAX_LEAN = np.cos(np.radians(40.0))
_BEFORE_S, _AFTER_S = 0.7, 0.8
_TRUE_RISE, _TRUE_FACE_M, _TRUE_TIME_S = 0.05, 0.15, 0.15
_HAND = 0.108


@dataclass(frozen=True)
class Truth:
    """An attitude from `start` to `end`, s. made: by moving the arms; else it was in the recording."""

    attitude: Attitude
    start: float
    end: float
    made: bool


@dataclass(frozen=True)
class Clip:
    """A motion in the optical frame with what it truly shows. source: name of the recording."""

    source: str
    motion: Motion
    truths: Tuple[Truth, ...]


def positive_clips(names: Sequence[str], variants: int, seed: int) -> List[Clip]:
    """Return `variants` clips of 3 to 4.5 s of each recording and attitude, each of another person and camera.

    The recording is played to and fro where it is too short. Raises FileNotFoundError without the recordings.
    """
    people = virtual_people(200, seed, SegmentTable.load())
    clips = []
    for name in names:
        for attitude in CLASSES:
            for variant in range(variants):
                random = np.random.default_rng([seed, int(name.replace("_", "")), int(attitude), variant])
                person = people[random.integers(len(people))]
                clips.append(_positive(load_motion(name, person, _RATE), attitude, random))
    return clips


def natural_clips(names: Sequence[str], headings: int, seed: int) -> List[Clip]:
    """Return the recordings as they are, each seen from `headings` directions all around, each of another person."""
    people = virtual_people(200, seed + 1, SegmentTable.load())
    clips = []
    for name in names:
        for index in range(headings):
            random = np.random.default_rng([seed, int(name.replace("_", "")), index])
            motion = before_camera(load_motion(name, people[random.integers(len(people))], _RATE),
                                   int(random.integers(2 ** 31)), heading=2.0 * np.pi * (index + random.random()) / headings)
            clips.append(Clip(name, motion, natural_truth(motion)))
    return clips


def natural_truth(motion: Motion, where: Optional[np.ndarray] = None) -> Tuple[Truth, ...]:
    """Tell what recorded motion shows, from points without noise. where: (T,) the frames to judge, None: all.

    Hands raised: a wrist 0.05 statures above its shoulder and above its elbow. Hands on face: a point of a straight
    hand within 0.15 m of nose or mouth (02_10 washes its face and neck with bent hands, whose fingers are nearer than
    those of the straight hand that is all the recording tells). Each for at least 0.15 s. Nobody crosses his arms.
    """
    points, up, stature = motion.points, motion.up, motion.stature
    mouth = points[:, kp.NOSE] - motion.head_rotation[:, :, 2] * (0.04 * stature / 1.70)
    raised = np.zeros(len(points), dtype=bool)
    face = np.zeros(len(points), dtype=bool)
    for shoulder in (kp.LEFT_SHOULDER, kp.RIGHT_SHOULDER):
        wrist, elbow = points[:, shoulder + 2], points[:, shoulder + 1]
        raised |= ((wrist - points[:, shoulder]) @ up > _TRUE_RISE * stature) & ((wrist - elbow) @ up > 0.0)
        along = (wrist - elbow) / np.linalg.norm(wrist - elbow, axis=1, keepdims=True)
        for part in np.linspace(0.0, _HAND, 5):
            hand = wrist + part * stature * along
            for place in (points[:, kp.NOSE], mouth):
                face |= np.linalg.norm(hand - place, axis=1) < _TRUE_FACE_M
    return tuple(Truth(attitude, start, end, False)
                 for attitude, mask in ((Attitude.HANDS_RAISED, raised), (Attitude.HANDS_ON_FACE, face))
                 for start, end in runs(mask if where is None else mask & where, motion.stamps) if end - start >= _TRUE_TIME_S)


def runs(mask: np.ndarray, stamps: np.ndarray) -> List[Tuple[float, float]]:
    """Return first and last stamp of every unbroken run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(float(stamps[first]), float(stamps[last - 1])) for first, last in zip(edges[::2], edges[1::2])]


def _positive(motion: Motion, attitude: Attitude, random: np.random.Generator) -> Clip:
    rise, fall, hold = random.uniform(0.3, 0.6), random.uniform(0.3, 0.6), random.uniform(1.2, 2.2)
    length = int((_BEFORE_S + rise + hold + fall + _AFTER_S) * motion.rate)
    motion = _upright_part(_to_and_fro(motion, length), length, random)
    seed = int(random.integers(2 ** 31))
    motion = before_camera(motion, seed, heading=random.uniform(-1.3, 1.3))
    time = motion.stamps - _BEFORE_S
    weight = np.minimum(_smooth(time / rise), 1.0 - _smooth((time - rise - hold) / fall))
    truth = Truth(attitude, _BEFORE_S + rise, _BEFORE_S + rise + hold, True)
    moved = move_arms(motion, attitude, weight, random)
    return Clip(motion.name, moved, (truth,) + natural_truth(moved, weight < 0.3))


def _to_and_fro(motion: Motion, length: int) -> Motion:
    while len(motion.points) < length:
        motion = replace(motion, points=np.concatenate([motion.points, motion.points[-2::-1]]),
                         head_rotation=np.concatenate([motion.head_rotation, motion.head_rotation[-2::-1]]))
    return motion


def _upright_part(motion: Motion, length: int, random: np.random.Generator) -> Motion:
    """Return a random part of `length` frames with the trunk upright, else the most upright one."""
    hips = 0.5 * (motion.points[:, kp.LEFT_HIP] + motion.points[:, kp.RIGHT_HIP])
    spine = motion.points[:, kp.NECK] - hips
    upright = (spine @ motion.up) / np.linalg.norm(spine, axis=1)
    starts = np.arange(len(upright) - length + 1)
    least = np.array([upright[start:start + length].min() for start in starts])
    good: Optional[np.ndarray] = starts[least > _MAX_LEAN]
    start = int(random.choice(good)) if len(good) else int(starts[least.argmax()])
    return motion.cut(start, start + length)


def _smooth(value: np.ndarray) -> np.ndarray:
    value = np.clip(value, 0.0, 1.0)
    return value * value * (3.0 - 2.0 * value)
