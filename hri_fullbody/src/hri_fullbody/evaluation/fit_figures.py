"""Figures of the fitting chain: errors on motion capture, headings, lag, stature.

Motions: all recordings at hand, cut to 20 s, each of a virtual person before a camera at a random place (seeded).
Errors are over the twelve joints of shoulders, elbows, wrists, hips, knees and ankles and all images from the first
settled model on. Raises FileNotFoundError with the reason where the recordings are absent.
"""

from __future__ import annotations

from typing import Dict, List, Sequence, Tuple

import numpy as np

from hri_fullbody.core import skeleton as kp
from hri_fullbody.core.body_modeller import BodyInput, BodyModeller
from hri_fullbody.core.human.human_model import PAPER, Dimensions
from hri_fullbody.core.human.segment_table import SegmentTable
from hri_fullbody.core.human.stature import StatureEstimator
from hri_fullbody.core.joints.forward_kinematics import forward
from hri_fullbody.core.smoothing.keypoint_filter import KeypointFilter
from hri_fullbody.evaluation.chain import mpjpe_mm, track
from hri_fullbody.evaluation.mocap import Motion, before_camera, load_motion, trial_names
from hri_fullbody.evaluation.noise import LEVELS, Level, add_noise
from hri_fullbody.evaluation.virtual_people import virtual_people

TUNED_ON = "02"
"""Subject on whose recordings filter, gate and weights were tuned; the others were in view when models were compared."""
HEADINGS_DEG = tuple(range(0, 360, 45))
_LONGEST = 600
_LEGS = [kp.LEFT_KNEE, kp.LEFT_ANKLE, kp.RIGHT_KNEE, kp.RIGHT_ANKLE]
_WAVE_HZ, _WAVE_RAD, _WAVE_S, _RATE = 1.5, 0.5, 6.0, 30.0


def motions(table: SegmentTable, seed: int = 5, names: Sequence[str] = (), recorded: bool = False,
            views: int = 1) -> List[Motion]:
    """Return the motions before their cameras. names: which recordings, empty: all. recorded: the actors as they
    are instead of virtual people. views: how many people and cameras for each recording."""
    names = views * (list(names) or trial_names())
    people = virtual_people(len(names), seed, table)
    return [before_camera(load_motion(name, None if recorded else person), seed + 100 * n).cut(0, _LONGEST)
            for n, (name, person) in enumerate(zip(names, people))]


def fit_errors(chosen: Sequence[Motion], table: SegmentTable, limb_lengths: bool,
               levels: Sequence[Level] = LEVELS, interface: str = "paper", seed: int = 7) -> Dict[str, float]:
    """Mean joint error, mm, by level of noise, of the whole chain."""
    modeller = BodyModeller(interface=interface, table=table, limb_lengths=limb_lengths)
    return {str(level): round(mpjpe_mm(track(modeller, chosen, level, seed)), 2) for level in levels}


def heading_errors(table: SegmentTable, level: Level, seed: int = 5) -> Dict[int, float]:
    """Mean joint error, mm, by heading in degrees (0 faces the camera), 5 s of each recording at 2.5 m."""
    names = trial_names()
    people = virtual_people(len(names), seed, table)
    worlds = [load_motion(name, person).cut(0, 150) for name, person in zip(names, people)]
    modeller, errors = BodyModeller(table=table), {}
    for heading in HEADINGS_DEG:
        seen = [before_camera(world, seed, np.radians(heading), 2.5) for world in worlds]
        errors[heading] = round(mpjpe_mm(track(modeller, seen, level, 7)), 2)
    return errors


def worst_heading_ratio(table: SegmentTable, level: Level = 10) -> Tuple[float, Dict[int, float]]:
    """Return the worst heading's error as a part of the best one's, and all errors."""
    errors = heading_errors(table, level)
    return round(max(errors.values()) / min(errors.values()), 3), errors


def wave(table: SegmentTable, level: Level = 10, people: int = 10) -> Tuple[float, float]:
    """Return lag (ms) and share of the amplitude left of a hand that waves at 1.5 Hz, the means over `people`.

    The forearm of a raised right arm swings by 0.5 rad. Lag and amplitude are those of the oscillation along the
    direction in which the true wrist moves most.
    """
    dimensions = Dimensions.from_stature(1.7, table)
    stamps = np.arange(int(_WAVE_S * _RATE)) / _RATE
    q = np.zeros((len(stamps), len(PAPER.joint_names)))
    q[:, PAPER.joint_names.index("r_p_shoulder")] = 1.5
    q[:, PAPER.joint_names.index("r_r_shoulder")] = 1.5
    q[:, PAPER.joint_names.index("r_elbow")] = 1.2 + _WAVE_RAD * np.sin(2.0 * np.pi * _WAVE_HZ * stamps)
    # Columns: forward, left and up of a human who faces the camera, in the optical frame.
    facing = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    points, _, _ = forward(np.tile(facing, (len(q), 1, 1)), np.tile([0.0, 0.2, 2.5], (len(q), 1)), q,
                           [dimensions] * len(q), PAPER)
    noisy = np.stack([add_noise(points, level, seed) for seed in range(people)])
    modeller, fitted = BodyModeller(table=table), np.full((people, len(q), 3), np.nan)
    for frame, stamp in enumerate(stamps):
        bodies = [BodyInput(str(n), noisy[n, frame]) for n in range(people)]
        for body in modeller.update(bodies, float(stamp)):
            fitted[int(body.id), frame] = body.fitted[kp.RIGHT_WRIST]
    late = stamps >= 1.0
    found = np.array([_lag(points[late, kp.RIGHT_WRIST], one[late], stamps[late]) for one in fitted])
    return round(1e3 * float(found[:, 0].mean()), 1), round(float(found[:, 1].mean()), 3)


def _lag(truth: np.ndarray, fitted: np.ndarray, stamps: np.ndarray) -> Tuple[float, float]:
    """Lag (s) and amplitude ratio of (T, 3) against (T, 3) at the frequency of the wave."""
    centred = truth - truth.mean(axis=0)
    direction = np.linalg.svd(centred, full_matrices=False)[2][0]
    angle = 2.0 * np.pi * _WAVE_HZ * stamps
    basis = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(angle))])
    phasors = [complex(*np.linalg.lstsq(basis, line @ direction, rcond=None)[0][:2]) for line in (truth, fitted)]
    turn = phasors[1] / phasors[0]
    return float(np.angle(turn)) / (2.0 * np.pi * _WAVE_HZ), abs(turn)


def stature_errors(table: SegmentTable, legs: bool = True, level: Level = 30, seconds: float = 2.0,
                   count: int = 66, seed: int = 11) -> np.ndarray:
    """Errors (count,) m of the stature after so many seconds of `count` virtual people on all recordings in turn.

    legs: False: knees and ankles are not seen. The points go through the gate, as in the node.
    """
    people, names = virtual_people(count, seed, table), trial_names()
    errors = np.empty(count)
    for n, person in enumerate(people):
        motion = before_camera(load_motion(names[n % len(names)], person), seed + n)
        first = (37 * n) % max(len(motion.points) - int(seconds * motion.rate), 1)
        motion = motion.cut(first, first + int(seconds * motion.rate))
        noisy = add_noise(motion.points, level, seed + n)
        if not legs:
            noisy[:, _LEGS] = np.nan
        estimator, gate = StatureEstimator(table), KeypointFilter()
        for points, stamp in zip(noisy, motion.stamps):
            estimator.add(gate.update(["one"], points[None], float(stamp)).gated[0], float(stamp))
        errors[n] = estimator.estimate().stature - person.stature
    return errors
