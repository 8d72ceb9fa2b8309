"""Attitudes, waving and postures of people whom a depth camera recorded: the clips of UTD-MHAD.

Data: Chen, Jafari and Kehtarnavaz, "UTD-MHAD: a multimodal dataset for human action recognition", ICIP 2015; skeletons
of 20 joints of a Kinect v1, metres, x to the camera's left, y up, z ahead, 30 Hz. It estimates no face: nose, eyes and
ears are those of the head template of `mocap`, on the head joint. Its hips lie some 4 % of the stature too high.

Thresholds were tuned on the subjects of TUNED_ON; figures are told of REPORTED.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Sequence, Tuple

import numpy as np

from benchmarks.mocap import FACE, Level, add_noise
from benchmarks.report import ABSENT, data_directory
from hri_fullbody.core import keypoints as kp
from hri_fullbody.core.behaviour.attitude import AttitudeClass
from hri_fullbody.core.behaviour.gesture import GestureClass
from hri_fullbody.core.behaviour.posture import PostureClass
from hri_fullbody.core.behaviour.recognizer import BehaviourRecognizer, BodyBehaviour
from hri_fullbody.core.filtering import KeypointFilter
from hri_fullbody.core.localization.ground import GroundPlane

TUNED_ON, REPORTED = (1, 3), (5, 7)
NOISES: Tuple[Level, ...] = (10, 30, "rgbd")
RATE_HZ = 30.0
UP = np.array([0.0, -1.0, 0.0])
CROSS_ARMS, SIT_TO_STAND, STAND_TO_SIT, SQUAT = 6, 24, 25, 27
UPRIGHT = (1, 2, 5, 7, 8, 16, 18, 22, 23)
"""Actions of which all is done standing or walking."""
STILL_CLIPS = 422
CAMERA_SEED = 7
"""Of the simulated cameras of the figures; thresholds were tuned on those of 100."""
_HEIGHTS_M, _PITCHES, _HEADINGS = (0.5, 2.5), np.radians([0.0, 35.0]), np.radians([-60.0, 60.0])
_VIEWS = 3              # cameras of each body that sits or crouches, which are few
_HOLD_S = 1.5
_LOOK = 3               # frames of a clip between two runs of the pose network
_AVERAGE_M = 1.7
_ANKLE_ABOVE_FLOOR = 0.07
_EDGE = 3  # frames at both ends in which some clips jump
_HEAD_TO_FEET = 0.915  # centre of the head above the soles, statures
_SKULL_BASE = (0.02, 0.0, 0.02)  # of the head joint from the skull base, m at 1.70 m
_JOINTS = {kp.LEFT_SHOULDER: 4, kp.LEFT_ELBOW: 5, kp.LEFT_WRIST: 6, kp.RIGHT_SHOULDER: 8, kp.RIGHT_ELBOW: 9,
           kp.RIGHT_WRIST: 10, kp.LEFT_HIP: 12, kp.LEFT_KNEE: 13, kp.LEFT_ANKLE: 14, kp.RIGHT_HIP: 16,
           kp.RIGHT_KNEE: 17, kp.RIGHT_ANKLE: 18}
_HEAD, _SHOULDERS, _LEFT_FOOT, _RIGHT_FOOT = 0, 1, 15, 19


@dataclass(frozen=True)
class KinectClip:
    """One clip: number of the action and of the subject, points (T, 18, 3) m in the optical frame, stature in m."""

    action: int
    subject: int
    points: np.ndarray
    stature: float


def load_clips(subjects: Sequence[int]) -> List[KinectClip]:
    """Return all clips of some subjects. Raises FileNotFoundError, saying what is missing, without the data."""
    directory = data_directory()
    path = None if directory is None else directory / "utd_mhad_odd_subjects.npz"
    if path is None or not path.is_file():
        raise FileNotFoundError(ABSENT if path is None else "there is no {}".format(path))
    clips = []
    with np.load(str(path)) as table:
        for name in sorted(table.files):
            action, subject = (int(part[1:]) for part in name.split("_")[:2])
            if subject in subjects:
                clips.append(_clip(action, subject, table[name]))
    return clips


def figures(subjects: Sequence[int] = REPORTED) -> Dict[str, object]:
    """Return `arms_crossed` and, by posture, `precision` and `recall`, the worst of all noises, and `waving_false`.

    waving_false: of STILL_CLIPS people who hold up a hand without moving it, with depth noise, how many wave.
    posture: before random cameras 0.5 to 2.5 m high that look 0 to 35 degrees down, at people who face up to 60 degrees
    past them; nobody tells the tilt; each person stands for 1.5 s first. posture_up_known: before the recording's own
    camera. posture_never_stood: as `posture`, but who sits was never seen to stand; who crouches was, as recorded.
    """
    clips = load_clips(subjects)
    crossed = [_crossed_arms(clips, noise) for noise in NOISES]
    told: Dict[str, object] = {"arms_crossed": _worst(crossed), "waving_false": waving_false(clips)}
    for key, tilted, stood in (("posture", True, True), ("posture_up_known", False, False),
                               ("posture_never_stood", True, False)):
        postures = [_postures(clips, noise, tilted, stood) for noise in NOISES]
        told[key] = {name: _worst([of_noise[name] for of_noise in postures]) for name in postures[0]}
    return told


def behaviour(points: np.ndarray, stature: float, noise: Level, seed: int) -> List[BodyBehaviour]:
    """Run filter and recogniser over a clip, as the node does for a body."""
    noisy = add_noise(points, noise, seed) if noise else points
    smoother, recogniser = KeypointFilter(), BehaviourRecognizer()
    return [recogniser.update(smoother.update(["body"], frame[None], index / RATE_HZ).smooth[0], stature,
                              index / RATE_HZ, UP) for index, frame in enumerate(noisy)]


def tilted_behaviour(points: np.ndarray, stature: float, noise: Level, seed: int, height: float,
                     pitch: float) -> List[BodyBehaviour]:
    """The same before a camera `height` m above the floor that looks down by `pitch` rad, which is learnt."""
    noisy = add_noise(_before_camera(points, height, pitch), noise, seed)
    smoother, recogniser, ground, told = KeypointFilter(), BehaviourRecognizer(), GroundPlane(), []
    for index, frame in enumerate(noisy):
        stamp = index / RATE_HZ
        if index % _LOOK == 0:
            ground.add("body", frame * (_AVERAGE_M / stature), np.isfinite(frame[:, 0]).astype(float), stamp)
            ground.solve(stamp)
        smooth = smoother.update(["body"], frame[None], stamp).smooth[0]
        told.append(recogniser.update(smooth, stature, stamp, ground.up, ground.up_sd))
    return told


def _camera(seed: int, view: int) -> Tuple[float, float, float]:
    """Height (m), pitch and the heading (rad) by which a person faces past it, of a simulated camera."""
    random = np.random.default_rng([CAMERA_SEED, seed, view])
    height, pitch, heading = (random.uniform(*limits) for limits in (_HEIGHTS_M, _PITCHES, _HEADINGS))
    return height, pitch, heading


def _turned(points: np.ndarray, heading: float) -> np.ndarray:
    """Points (T, 18, 3) m turned about the vertical through the middle of the body, rad."""
    middle = points[:, [kp.LEFT_HIP, kp.RIGHT_HIP]].mean(axis=(0, 1))
    sine, cosine = np.sin(heading), np.cos(heading)
    return (points - middle) @ np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]) + middle


def _before_camera(points: np.ndarray, height: float, pitch: float) -> np.ndarray:
    """Points (T, 18, 3) m in the frame of such a camera, 2 to 4 m away, with the body near the middle of its view."""
    middle = points[:, [kp.LEFT_HIP, kp.RIGHT_HIP]].mean(axis=(0, 1))
    floor = np.percentile(points[:, [kp.LEFT_ANKLE, kp.RIGHT_ANKLE], 1], 90) + _ANKLE_ABOVE_FLOOR
    above = middle[1] - floor + height
    far = np.clip(above / np.tan(pitch), 2.0, 4.0) if pitch > 0.05 else 3.0
    camera = np.array([middle[0], floor - height, middle[2] - far])
    sine, cosine = np.sin(pitch), np.cos(pitch)
    return (points - camera) @ np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]]).T


def waving_false(clips: Sequence[KinectClip]) -> int:
    """Return how many of STILL_CLIPS raised, still hands wave, each with other depth noise."""
    count = 0
    for number in range(STILL_CLIPS):
        clip = clips[number % len(clips)]
        told = behaviour(_raised_and_still(clip, np.random.default_rng(number)), clip.stature, "rgbd", number)
        count += any(each.gesture == GestureClass.WAVING for each in told)
    return count


def _clip(action: int, subject: int, joints: np.ndarray) -> KinectClip:
    places = joints.transpose(2, 0, 1) * np.array([-1.0, -1.0, 1.0])
    points = np.zeros((len(places), 18, 3))
    for keypoint, joint in _JOINTS.items():
        points[:, keypoint] = places[:, joint]
    points[:, kp.NECK] = 0.5 * (points[:, kp.LEFT_SHOULDER] + points[:, kp.RIGHT_SHOULDER])
    feet = 0.5 * (places[:, _LEFT_FOOT] + places[:, _RIGHT_FOOT])
    stature = float(np.percentile(np.linalg.norm(places[:, _HEAD] - feet, axis=1), 90)) / _HEAD_TO_FEET
    left = _unit(points[:, kp.LEFT_SHOULDER] - points[:, kp.RIGHT_SHOULDER])
    up = places[:, _HEAD] - places[:, _SHOULDERS]
    up = _unit(up - (up * left).sum(axis=1, keepdims=True) * left)
    head = np.stack([np.cross(left, up), left, up], axis=2)
    for keypoint, place in FACE.items():
        points[:, keypoint] = places[:, _HEAD] + head @ (np.subtract(place, _SKULL_BASE) * stature / 1.70)
    return KinectClip(action, subject, points, stature)


def _crossed_arms(clips: Sequence[KinectClip], noise: Level) -> Dict[str, float]:
    hits = false = made = 0
    for seed, clip in enumerate(clips):
        found = any(each.attitude == AttitudeClass.ARMS_CROSSED
                    for each in behaviour(clip.points, clip.stature, noise, seed))
        made += clip.action == CROSS_ARMS
        hits += found and clip.action == CROSS_ARMS
        false += found and clip.action != CROSS_ARMS
    return _rates(hits, false, made)


def _postures(clips: Sequence[KinectClip], noise: Level, tilted: bool, stood: bool) -> Dict[str, Dict[str, float]]:
    """A clip shows a posture when it is told for most of the time in which it is held."""
    truths = [(clip, held) for clip in clips for held in _held_postures(clip)]
    made = dict.fromkeys(("sitting", "standing", "crouching"), 0)
    hits, false = dict(made), dict(made)
    for seed, (clip, (points, posture, last)) in enumerate(truths):
        if posture == "crouching" or (posture == "sitting" and stood):
            upright = -1 - _EDGE if clip.action == SIT_TO_STAND else _EDGE
            points = np.concatenate([_held(clip, upright % len(clip.points), int(_HOLD_S * RATE_HZ)), points])
        for view in range(_VIEWS if tilted and posture != "standing" else 1):
            height, pitch, heading = _camera(seed, view)
            told = (tilted_behaviour(_turned(points, heading), clip.stature, noise, _VIEWS * seed + view, height, pitch)
                    if tilted else behaviour(points, clip.stature, noise, seed))
            made[posture] += 1
            for name in made:
                share = float(np.mean([each.posture == int(PostureClass[name.upper()]) for each in told[last:]]))
                hits[name] += name == posture and share >= 0.5
                false[name] += name != posture and share > 0.2
    return {name: _rates(hits[name], false[name], made[name]) for name in made}


def _held_postures(clip: KinectClip) -> List[Tuple[np.ndarray, str, int]]:
    """Points of a posture that is held, its name, and the first frame that is judged.

    Seated people are there for some frames only: they are held for 1.5 s. So is the deepest moment of a squat.
    """
    still = int(_HOLD_S * RATE_HZ)
    if clip.action == SIT_TO_STAND:
        return [(_held(clip, _EDGE, still), "sitting", -20)]
    if clip.action == STAND_TO_SIT:
        return [(_held(clip, len(clip.points) - 1 - _EDGE, still), "sitting", -20)]
    if clip.action == SQUAT:
        hips = clip.points[:, kp.LEFT_HIP, 1] + clip.points[:, kp.RIGHT_HIP, 1]
        return [(_held(clip, int(hips.argmax()), still), "crouching", -20)]
    return [(clip.points, "standing", 15)] if clip.action in UPRIGHT else []


def _held(clip: KinectClip, frame: int, count: int) -> np.ndarray:
    return np.repeat(clip.points[frame:frame + 1], count, axis=0)


def _raised_and_still(clip: KinectClip, random: np.random.Generator) -> np.ndarray:
    """The first frame of a clip for 3.5 s, with one hand held up somewhere beside the head."""
    points = np.repeat(clip.points[:1], int(3.5 * RATE_HZ), axis=0)
    shoulder = (kp.LEFT_SHOULDER, kp.RIGHT_SHOULDER)[random.integers(2)]
    outward = _unit(points[0, shoulder] - points[0, kp.NECK])
    ahead = np.array([0.0, 0.0, -1.0])
    upper = _unit(outward * random.uniform(0.2, 1.0) + UP * random.uniform(-0.6, 0.3) + ahead * random.uniform(0, 0.7))
    lower = _unit(outward * random.uniform(-0.3, 0.4) + UP + ahead * random.uniform(0.0, 0.4))
    points[:, shoulder + 1] = points[0, shoulder] + 0.17 * clip.stature * upper
    points[:, shoulder + 2] = points[0, shoulder + 1] + 0.15 * clip.stature * lower
    return points


def _rates(hits: int, false: int, made: int) -> Dict[str, float]:
    return {"precision": round(hits / max(hits + false, 1), 3), "recall": round(hits / max(made, 1), 3)}


def _worst(rows: Sequence[Dict[str, float]]) -> Dict[str, float]:
    return {name: min(row[name] for row in rows) for name in ("precision", "recall")}


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
