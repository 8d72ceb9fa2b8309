"""Arms of recorded people moved into an attitude: inverse kinematics of two bones with the skeleton's own lengths.

Lengths of the poses are in statures along forward, the arm's own side (outward) and up.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, Tuple

import numpy as np

from hri_fullbody.core import skeleton as kp
from hri_fullbody.core.language.arm_features import trunk_axes
from hri_fullbody.core.language.attitude import Attitude
from hri_fullbody.evaluation.mocap import FACE, Motion

_SIDES = {"left": (kp.LEFT_SHOULDER, 1.0), "right": (kp.RIGHT_SHOULDER, -1.0)}
# Half of the hand of Drillis and Contini's 0.108 statures lies between the wrist and the middle of the hand.
_HALF_HAND = 0.055
# Places of the face where the middle of a hand rests, m in the head frame at 1.70 m for a left hand; 2 cm off the skin.
_CONTACTS = {
    "chin": (0.115, 0.02, -0.10), "mouth": (0.14, 0.02, -0.05), "cheek": (0.105, 0.07, -0.02),
    "jaw": (0.08, 0.085, -0.06), "eyes": (0.135, 0.035, 0.035), "forehead": (0.125, 0.03, 0.08),
    "temple": (0.075, 0.095, 0.045)}


@dataclass(frozen=True)
class ArmPose:
    """Where an arm goes: the wrist (T, 3) m and the side to which the elbow points (T, 3), in the motion's frame."""

    wrist: np.ndarray
    pole: np.ndarray


@dataclass(frozen=True)
class _Frames:
    """Axes of the trunk and of gravity at each frame; rows of (T, 3, 3): forward, left, up."""

    trunk: np.ndarray
    level: np.ndarray


def move_arms(motion: Motion, attitude: Attitude, weight: np.ndarray, random: np.random.Generator) -> Motion:
    """Return the motion with its arms in a natural variant of `attitude`.

    weight: (T,) 0 (arms as recorded) to 1 (in the attitude). The variant is drawn from `random`.
    """
    frames = _frames(motion)
    makers = {Attitude.HANDS_RAISED: _raised, Attitude.HANDS_ON_FACE: _on_face, Attitude.ARMS_CROSSED: _crossed}
    points = motion.points.copy()
    for side, pose in makers[attitude](motion, frames, random).items():
        shoulder = _SIDES[side][0]
        sway = _sway(len(points), motion.rate, random)
        points[:, shoulder + 1:shoulder + 3] = _blend(
            motion.points[:, shoulder:shoulder + 3], replace(pose, wrist=pose.wrist + sway), weight)
    return replace(motion, points=points)


def bend_arm(shoulder: np.ndarray, target: np.ndarray, pole: np.ndarray, upper_arm: float,
             forearm: float) -> Tuple[np.ndarray, np.ndarray]:
    """Return elbow and wrist (T, 3) of arms that reach for targets (T, 3), the elbow towards `pole` (T, 3).

    A target out of reach is moved along its line from the shoulder.
    """
    line = target - shoulder
    distance = np.linalg.norm(line, axis=1, keepdims=True)
    along = line / np.maximum(distance, 1e-9)
    reach = np.clip(distance, abs(upper_arm - forearm) + 0.01, (upper_arm + forearm) * 0.999)
    foot = (upper_arm ** 2 - forearm ** 2 + reach ** 2) / (2.0 * reach)
    height = np.sqrt(np.maximum(upper_arm ** 2 - foot ** 2, 0.0))
    across = pole - (pole * along).sum(axis=1, keepdims=True) * along
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return shoulder + foot * along + height * across, shoulder + reach * along


def _blend(arm: np.ndarray, pose: ArmPose, weight: np.ndarray) -> np.ndarray:
    """Elbow and wrist (T, 2, 3) between an arm (T, 3, 3) as recorded and a pose; the bones keep their lengths."""
    shoulder, elbow, wrist = arm[:, 0], arm[:, 1], arm[:, 2]
    upper_arm = float(np.median(np.linalg.norm(elbow - shoulder, axis=1)))
    forearm = float(np.median(np.linalg.norm(wrist - elbow, axis=1)))
    part = weight[:, None]
    pole = (elbow - shoulder) / upper_arm
    bent = bend_arm(shoulder, wrist + part * (pose.wrist - wrist), pole + part * (pose.pole - pole), upper_arm, forearm)
    moved = np.stack(bent, axis=1)
    return np.where(part[:, :, None] > 0.0, moved, arm[:, 1:])


def _raised(motion: Motion, frames: _Frames, random: np.random.Generator) -> Dict[str, ArmPose]:
    """One hand or both, from a hand's length above the shoulder to straight up."""
    sides = (("left",), ("right",), ("left", "right"))[random.integers(3)]
    low = random.random() < 0.5
    rise = random.uniform(0.11, 0.17) if low else random.uniform(0.20, 0.30)
    # A low hand is held beside the face, not before it.
    ahead, outward = random.uniform(-0.02, 0.14), random.uniform(0.05 if low else -0.02, 0.14)
    poses = {}
    for side in sides:
        shoulder, sign = _SIDES[side]
        varied = np.array([ahead, outward, rise]) + random.uniform(-0.015, 0.015, 3)
        poses[side] = ArmPose(
            motion.points[:, shoulder] + motion.stature * _place(frames.level, varied, sign),
            _place(frames.level, (random.uniform(-0.2, 0.5), 1.0, random.uniform(-0.9, -0.1)), sign))
    return poses


def _crossed(motion: Motion, frames: _Frames, random: np.random.Generator) -> Dict[str, ArmPose]:
    """Forearms one over the other, each hand at the other arm: tight (hands at the upper arms) to loose."""
    beyond, level = random.uniform(0.0, 0.055), random.uniform(-0.21, -0.10)
    ahead, apart = random.uniform(0.075, 0.12), random.uniform(0.01, 0.03)
    upper = ("left", "right")[random.integers(2)]
    middle = motion.points[:, kp.NECK]
    poses = {}
    for side, (_, sign) in _SIDES.items():
        above = 1.0 if side == upper else -1.0
        place = np.array([ahead + 0.5 * above * apart, -beyond, level + 0.5 * above * apart])
        place += random.uniform(-0.008, 0.008, 3)
        pole = (random.uniform(-0.5, 0.2), random.uniform(0.4, 1.0), -1.0)
        poses[side] = ArmPose(middle + motion.stature * _place(frames.trunk, place, sign),
                              _place(frames.trunk, pole, sign))
    return poses


def _on_face(motion: Motion, frames: _Frames, random: np.random.Generator) -> Dict[str, ArmPose]:
    """One hand or both at chin, mouth, cheek, jaw, eyes, forehead or temple; the wrist bends."""
    sides = (("left",), ("right",), ("left", "right"))[random.integers(3)]
    contact = np.array(_CONTACTS[sorted(_CONTACTS)[random.integers(len(_CONTACTS))]])
    skull = motion.points[:, kp.NOSE] - motion.head_rotation @ (np.array(FACE[kp.NOSE]) * motion.stature / 1.70)
    head = motion.head_rotation.transpose(0, 2, 1)
    fingers = np.array([random.uniform(-0.5, 0.0), random.uniform(-0.8, 0.3), 1.0])
    poses = {}
    for side in sides:
        sign = _SIDES[side][1]
        middle = skull + motion.stature / 1.70 * _place(head, contact + random.uniform(-0.012, 0.012, 3), sign)
        hand = _HALF_HAND * motion.stature * fingers / np.linalg.norm(fingers)
        pole = (random.uniform(0.0, 0.6), random.uniform(0.2, 1.0), -1.0)
        poses[side] = ArmPose(middle - _place(head, hand, sign), _place(frames.trunk, pole, sign))
    return poses


def _place(axes: np.ndarray, values: np.ndarray, sign: float) -> np.ndarray:
    """(forward, outward, up) along axes (T, 3, 3) as vectors (T, 3); sign: 1 for the left side, -1 for the right."""
    return (np.asarray(values) * (1.0, sign, 1.0)) @ axes


def _frames(motion: Motion) -> _Frames:
    trunk = np.stack([trunk_axes(points, motion.up) for points in motion.points])
    left = trunk[:, 1] - (trunk[:, 1] @ motion.up)[:, None] * motion.up
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    up = np.broadcast_to(motion.up, left.shape)
    return _Frames(trunk, np.stack([np.cross(left, up), left, up], axis=1))


def _sway(count: int, rate: float, random: np.random.Generator) -> np.ndarray:
    """Slow unrest of a held hand (T, 3), about 1 cm."""
    time = np.arange(count)[:, None] / rate
    frequency, phase = random.uniform(0.2, 1.2, 3), random.uniform(0.0, 2.0 * np.pi, 3)
    return random.uniform(0.003, 0.012, 3) * np.sin(2.0 * np.pi * frequency * time + phase)
