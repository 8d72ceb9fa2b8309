"""Figures of the fitting chain (gate, filter, stature, joints): errors on motion capture, lag, stature, time.

Motions: all recordings at hand, cut to 20 s, each of a virtual person before a camera at a random place (seeded).
Errors are over the twelve joints of shoulders, elbows, wrists, hips, knees and ankles and all images from the first
settled model on. Raises FileNotFoundError with the reason where the recordings are absent.

Time of inverse kinematics: processor time of the thread, and
wall-clock beside it; medians over blocks of 38 images, of which the quickest block counts, since other programs on the
machine slow both down.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from benchmarks.face_figures import GEOMETRY_ONLY, PHOTOGRAPH_HFOV, read_image
from benchmarks.mocap import (
    LEVELS,
    Level,
    RecordedMotion,
    add_noise,
    before_camera,
    load_motion,
    trial_names,
    virtual_people,
)
from hri_fullbody.core import keypoints as kp
from hri_fullbody.core.detection.pose_estimator import BODY_LANDMARKS
from hri_fullbody.core.detection.windows import FaceBox
from hri_fullbody.core.filtering import KeypointFilter
from hri_fullbody.core.keypoints import BLAZE_INNER_EYES, BLAZE_LEFT_ANKLE, BLAZE_RIGHT_ANKLE
from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.kinematics.solver import JointSolver
from hri_fullbody.core.localization.ground import GroundPlane
from hri_fullbody.core.localization.localizer import BodyScale, face_cue, floor_ratio
from hri_fullbody.core.model.anthropometry import MONOCULAR, SegmentTable, StatureEstimator
from hri_fullbody.core.model.human import PAPER, Dimensions
from hri_fullbody.core.modeller import BodyInput, BodyModeller
from hri_fullbody.core.parameters import VISION
from hri_fullbody.core.pipeline import BodyPipeline
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import FaceObservation

TUNED_ON = "02"
"""Subject on whose recordings filter, gate and weights were tuned; the others were in view when models were
compared."""
_LONGEST = 600
_LEGS = [kp.LEFT_KNEE, kp.LEFT_ANKLE, kp.RIGHT_KNEE, kp.RIGHT_ANKLE]
_ANKLE_ABOVE_FLOOR = 0.07
_WAVE_HZ, _WAVE_RAD, _WAVE_S, _RATE = 1.5, 0.5, 6.0, 30.0


def motions(table: SegmentTable, seed: int = 5, names: Sequence[str] = (), recorded: bool = False,
            views: int = 1) -> List[RecordedMotion]:
    """Return the motions before their cameras. names: which recordings, empty: all. recorded: the actors as they
    are instead of virtual people. views: how many people and cameras for each recording."""
    names = views * (list(names) or trial_names())
    people = virtual_people(len(names), seed, table)
    return [before_camera(load_motion(name, None if recorded else person), seed + 100 * n).cut(0, _LONGEST)
            for n, (name, person) in enumerate(zip(names, people))]


def fit_errors(chosen: Sequence[RecordedMotion], table: SegmentTable, limb_lengths: bool,
               levels: Sequence[Level] = LEVELS, interface: str = "paper", seed: int = 7) -> Dict[str, float]:
    """Mean joint error, mm, by level of noise, of the whole chain."""
    modeller = BodyModeller(interface=interface, table=table, limb_lengths=limb_lengths)
    return {str(level): round(mpjpe_mm(track(modeller, chosen, level, seed)), 2) for level in levels}


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


def monocular_statures(table: SegmentTable, groups: int = 40, seed: int = 17) -> Dict[str, Optional[float]]:
    """Return how well one camera that nobody has measured tells statures: `r` and `sd_mm` against the truth, the same
    of `alone` without the neighbours' floor, and the share that is `told` instead of unknown.

    Simulated groups of 2 to 5 people of the ANSUR II statistics who walk or stand 1.8 to 5 m before a camera 0.8 to 2 m
    high that looks 0 to 25 degrees down, for 3 s. The network sees each at the average size, with 20 mm of noise; faces
    are seen of half of them, and are 6 % larger or smaller than the average (correlation with the stature 0.4), with
    the tails of Student's distribution of three degrees of freedom, which the estimator does not know. within_sd: share
    of those who are told whose truth is within the stated standard deviation; 0.68 is right.
    """
    truth, found, alone, told, within = [], [], [], [], []
    for group in range(groups):
        for true, estimate, by_face in _group_statures(table, np.random.default_rng([seed, group])):
            truth.append(true)
            found.append(estimate.stature)
            alone.append(by_face.stature)
            told.append(estimate.known)
            if estimate.known:
                within.append(abs(estimate.stature - true) <= estimate.stature_sd)
    errors = 1e3 * (np.array(found) - truth)
    return {"r": round(float(np.corrcoef(truth, found)[0, 1]), 3), "sd_mm": round(float(errors.std()), 1),
            "alone_r": round(float(np.corrcoef(truth, alone)[0, 1]), 3),
            "alone_sd_mm": round(float(np.std(1e3 * (np.array(alone) - truth))), 1),
            "bias_mm": round(float(errors.mean()), 1), "told": round(float(np.mean(told)), 3),
            "within_sd": round(float(np.mean(within)), 3) if within else None,
            "spread_mm": round(float(np.std(truth) * 1e3), 1), "people": len(truth)}


def _group_statures(table: SegmentTable, random: np.random.Generator) -> List[Tuple[float, object, object]]:
    """True stature, estimate and estimate without the floor of each person of one group."""
    people = virtual_people(int(random.integers(2, 6)), int(random.integers(2 ** 31)), table)
    height, pitch = random.uniform(0.8, 2.0), random.uniform(0.0, math.radians(25.0))
    average = float(np.exp(table.log_mean[0]))
    seen, faces = [], []
    for person in people:
        motion = load_motion(("02_01", "02_02", "02_10", "03_01")[random.integers(4)], person, 10.0)
        seen.append(_before_tilted_camera(motion, random, height, pitch) * (average / person.stature))
        size = math.log(person.stature / average)
        face = 0.4 * size * 0.06 / 0.055 + math.sqrt(1.0 - 0.4 ** 2) * 0.06 * random.standard_t(3) / math.sqrt(3.0)
        faces.append(math.exp(size - face) if random.random() < 0.5 else None)
    ground, scales = GroundPlane(), [(BodyScale(), BodyScale()) for _ in people]
    estimators = [(StatureEstimator(table), StatureEstimator(table)) for _ in people]
    for frame in range(30):
        points = [body[frame % len(body)] + random.normal(size=(18, 3)) * 0.02 for body in seen]
        for number, body in enumerate(points):
            ground.add(str(number), body, np.ones(18), 0.1 * frame)
        ground.solve(0.1 * frame)
        for number, body in enumerate(points):
            for index, (scale, estimator) in enumerate(zip(scales[number], estimators[number])):
                _size_up(body, faces[number], scale, ground, None if index else str(number))
                estimator.add(body * scale.value, 0.1 * frame, MONOCULAR)
    return [(person.stature, *(estimator.estimate(scale.measured) for estimator, scale in zip(*pair)))
            for person, *pair in zip(people, estimators, scales)]


def _size_up(body: np.ndarray, face: Optional[float], scale: BodyScale, ground: GroundPlane,
             floor_of: Optional[str]) -> None:
    """Give the cues of one image to a scale. floor_of: the body's id, None: without the floor."""
    landmarks = np.zeros((BODY_LANDMARKS, 3))
    for landmark, point in ((BLAZE_LEFT_ANKLE, kp.LEFT_ANKLE), (BLAZE_RIGHT_ANKLE, kp.RIGHT_ANKLE),
                            *((inner, kp.NOSE) for inner in BLAZE_INNER_EYES)):
        landmarks[landmark] = body[point]
    if face is not None:
        eyes = landmarks[BLAZE_INNER_EYES[0]]
        scale.update(face_cue(landmarks, Pose(np.eye(3), eyes * face)))
    height = None if floor_of is None else ground.camera_height(floor_of)
    if height is not None:
        rays = landmarks[:, :2] / np.maximum(landmarks[:, 2:], 0.1)
        scale.update(scale.floor_cue(
            floor_ratio(landmarks, rays, np.ones(BODY_LANDMARKS), ground.up, height[0]), height[1]))


def _before_tilted_camera(motion: RecordedMotion, random: np.random.Generator, height: float,
                          pitch: float) -> np.ndarray:
    """Key points (T, 18, 3) m of a motion at a random place before a camera, in its optical frame."""
    points = motion.points.copy()
    points[..., 1] -= np.percentile(points[:, [kp.LEFT_ANKLE, kp.RIGHT_ANKLE], 1], 5) - _ANKLE_ABOVE_FLOOR
    points[..., [0, 2]] -= points[:, kp.NECK, [0, 2]].mean(axis=0)
    angle, far = random.uniform(0.0, 2.0 * np.pi), random.uniform(2.2, 5.0)
    cosine, sine = math.cos(angle), math.sin(angle)
    x, z = cosine * points[..., 0] + sine * points[..., 2], cosine * points[..., 2] - sine * points[..., 0]
    level = np.stack([x + random.uniform(-0.3, 0.3) * far, height - points[..., 1], z + far], axis=-1)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(pitch), -math.sin(pitch)],
                     [0.0, math.sin(pitch), math.cos(pitch)]])
    return level @ turn.T


JOINTS = (kp.LEFT_SHOULDER, kp.RIGHT_SHOULDER, kp.LEFT_ELBOW, kp.RIGHT_ELBOW, kp.LEFT_WRIST, kp.RIGHT_WRIST,
          kp.LEFT_HIP, kp.RIGHT_HIP, kp.LEFT_KNEE, kp.RIGHT_KNEE, kp.LEFT_ANKLE, kp.RIGHT_ANKLE)
"""The twelve joints over which the mean error is taken; face points are a template."""


@dataclass(frozen=True)
class Tracked:
    """One motion after the chain: fitted key points (T, 18, 3) m, NaN while there was no model; revision (T,);
    stature (T,) m the estimate of each frame."""

    motion: RecordedMotion
    fitted: np.ndarray
    revision: np.ndarray
    stature: np.ndarray

    def errors(self) -> np.ndarray:
        """Distances (F, 12) m of the twelve joints from the truth, of frames with settled dimensions."""
        frames = self.revision > 0
        apart = self.fitted[frames] - self.motion.points[frames]
        return np.linalg.norm(apart[:, JOINTS], axis=-1)


def track(modeller: BodyModeller, motions: Sequence[RecordedMotion], level: Level, seed: int) -> List[Tracked]:
    """Run all motions at once, each as one body seen by its own camera, with noise of `level`."""
    count, length = len(motions), max(len(motion.points) for motion in motions)
    noisy = [add_noise(motion.points, level, seed + 1000 * n) for n, motion in enumerate(motions)]
    fitted = np.full((count, length, 18, 3), np.nan)
    revision, stature = np.zeros((count, length), dtype=int), np.full((count, length), np.nan)
    numbers = {str(n): n for n in range(count)}
    modeller.reset()
    for frame in range(length):
        bodies = [BodyInput(name, noisy[n][frame]) for name, n in numbers.items() if frame < len(noisy[n])]
        # Gravity differs from camera to camera here, so that it is not told: the harder case.
        for body in modeller.update(bodies, frame / motions[0].rate):
            n = numbers[body.id]
            fitted[n, frame], revision[n, frame], stature[n, frame] = body.fitted, body.revision, body.stature
    return [Tracked(motion, fitted[n, :len(motion.points)], revision[n, :len(motion.points)],
                    stature[n, :len(motion.points)]) for n, motion in enumerate(motions)]


def mpjpe_mm(tracked: Sequence[Tracked]) -> float:
    """Mean error over all joints and frames of all motions, mm."""
    return float(1e3 * np.concatenate([one.errors() for one in tracked]).mean())


_NOISE_MM = 10
_WARM_UP, _BLOCK = 10, 38


def solver_ms(table: SegmentTable, count: int, frames: int = 200) -> Tuple[float, float]:
    """Return processor and wall-clock time (ms) of the joints of `count` bodies in one batch: JointSolver.solve."""
    points, dimensions = _bodies(table, count, frames)
    solver = JointSolver()
    states: list = [None] * count

    def one(frame: int) -> None:
        nonlocal states
        states = solver.solve(points[:, frame], dimensions, states, 1.0 / 30.0).states

    return _medians(one, frames)


def modeller_ms(table: SegmentTable, count: int, frames: int = 200) -> Tuple[float, float]:
    """Return processor and wall-clock time (ms) of everything: gate, low pass, stature, joints of `count` bodies."""
    points, _ = _bodies(table, count, frames)
    modeller = BodyModeller(table=table)

    def one(frame: int) -> None:
        modeller.update([BodyInput(str(n), points[n, frame]) for n in range(count)], frame / 30.0)

    return _medians(one, frames)


def _bodies(table: SegmentTable, count: int, frames: int) -> Tuple[np.ndarray, List[Dimensions]]:
    """Noisy key points (count, frames, 18, 3) m of recordings, and the people's true dimensions."""
    chosen = [motion for motion in motions(table) if len(motion.points) >= 60]
    points, dimensions = [], []
    for n in range(count):
        motion = chosen[n % len(chosen)]
        noisy = add_noise(motion.points, _NOISE_MM, n)
        points.append(noisy[np.arange(frames) % len(noisy)])
        person = motion.person
        lengths = {name: value for name, value in vars(person).items() if name != "stature"}
        dimensions.append(Dimensions.from_segments(person.stature, lengths, table))
    return np.stack(points), dimensions


def _medians(one: Callable[[int], None], frames: int) -> Tuple[float, float]:
    """Processor and wall-clock time (ms) of a frame: the least of the blocks' medians."""
    used, passed = [], []
    for frame in range(frames):
        clocks = time.thread_time(), time.perf_counter()
        one(frame)
        used.append(time.thread_time() - clocks[0])
        passed.append(time.perf_counter() - clocks[1])
    starts = range(_WARM_UP, frames - _BLOCK + 1, _BLOCK)
    return tuple(round(1e3 * min(float(np.median(values[start:start + _BLOCK])) for start in starts), 3)
                 for values in (used, passed))  # type: ignore[return-value]


def face_body_depth_ratio_median(models: Path) -> float:
    """Return the median of the distance of a face over that of the nose of its body, found without the face's pose.

    models: the directory of the models. Raises RuntimeError when no face and body were found together.
    """
    settings = VISION.resolve(GEOMETRY_ONLY)
    stages = FacePipeline(settings), BodyPipeline(settings)
    ratios: List[float] = []
    for number in range(1, 7):
        image = read_image(models / "demo" / "sample{}.jpg".format(number))
        camera = CameraModel.from_fov(image.shape[1], image.shape[0], PHOTOGRAPH_HFOV)
        faces, bodies = [], []
        for stage in stages:
            stage.reset()
        for index in range(14):
            stamp = 1000.0 + 0.1 * index
            faces = stages[0].update(image, camera, stamp)
            boxes = [FaceBox.from_landmarks(face.id, face.landmarks) for face in faces]
            bodies = stages[1].update(image, camera, stamp, boxes)
        ratios += _depth_ratios(faces, bodies)
    if not ratios:
        raise RuntimeError("no face and body were found together")
    return float(np.median(ratios))


def _depth_ratios(faces: List[FaceObservation], bodies: list) -> List[float]:
    """Distance of each face over that of the body whose nose is nearest to its own, within a face's size."""
    ratios = []
    for face in faces:
        if face.pose is None or not bodies:
            continue
        apart = [float(np.linalg.norm(body.keypoints[0, :2] - face.landmarks[30, :2])) for body in bodies]
        body = bodies[int(np.argmin(apart))]
        depth = float(body.keypoints_3d[0, 2])
        if min(apart) < 0.3 * float(face.box[3] - face.box[1]) and np.isfinite(depth) and depth > 0.0:
            ratios.append(float(face.pose.translation[2]) / depth)
    return ratios
