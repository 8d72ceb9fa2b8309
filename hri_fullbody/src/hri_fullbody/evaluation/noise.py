"""Noise of key points, as that of a depth camera or white: for measuring, always with a seed."""

from __future__ import annotations

from typing import Union

import numpy as np
from scipy.signal import lfilter

from hri_fullbody.core import skeleton as kp

Level = Union[int, float, str]
LEVELS = (10, 20, 30, "rgbd")


def add_noise(points: np.ndarray, level: Level, seed: int) -> np.ndarray:
    """Return noisy key points (T, 18, 3) m of true ones at about 30 Hz in the optical frame, NaN where missing.

    level: the standard deviation per axis in mm of white noise, or "rgbd" (see rgbd_noise).
    Raises ValueError for another level.
    """
    if level == "rgbd":
        return rgbd_noise(points, seed)
    if isinstance(level, str) or not np.isfinite(level) or level < 0:
        raise ValueError("noise {!r} is neither \"rgbd\" nor a number of millimetres, 0 and more".format(level))
    return points + np.random.default_rng(seed).normal(size=points.shape) * (level / 1000.0)


def rgbd_noise(points: np.ndarray, seed: int) -> np.ndarray:
    """Return key points as a detector in the image with a look into the depth image gives them.

    10 mm across the ray and 18 mm (z / 2 m)^2 along it, half of the variance slow; 2 % of the points lie 0.15
    to 0.9 m too far away and 5 % are missing, both in bursts; arms behind the trunk and the far side of the
    face are missing. points: (T, 18, 3) m, optical frame, 30 Hz.
    """
    random = np.random.default_rng(seed)
    depth = np.maximum(points[:, :, 2:3], 0.5)
    sigma = np.array([0.010, 0.010, 0.0]) + np.array([0.0, 0.0, 0.018]) * (depth / 2.0) ** 2
    noisy = points + 0.7 * (random.normal(size=points.shape) + _slow(random, points.shape, 0.9)) * sigma
    wrong = _bursts(random, points.shape[:2], 0.02, 3.0)
    noisy[wrong, 2] += random.uniform(0.15, 0.9, int(wrong.sum()))
    noisy[_bursts(random, points.shape[:2], 0.05, 8.0)] = np.nan
    _hide_arms(points, noisy)
    _hide_face(points, noisy)
    return noisy


def _slow(random: np.random.Generator, shape: tuple, memory: float) -> np.ndarray:
    """Stationary first-order autoregressive noise of variance 1 along the first axis."""
    white = random.normal(size=shape)
    white[1:] *= np.sqrt(1.0 - memory * memory)
    return lfilter([1.0], [1.0, -memory], white, axis=0)


def _bursts(random: np.random.Generator, shape: tuple, share: float, mean_length: float) -> np.ndarray:
    """Mask (T, 18) that is true in runs of 2 and more frames that begin with probability share / mean_length."""
    begins = random.random(shape) < share / mean_length
    lengths = 1 + random.geometric(1.0 / mean_length, size=shape)
    mask = np.zeros(shape, dtype=bool)
    for frame, point in np.argwhere(begins):
        if not mask[frame, point]:
            mask[frame:frame + lengths[frame, point], point] = True
    return mask


def _hide_arms(points: np.ndarray, noisy: np.ndarray) -> None:
    """Take away elbows and wrists that are 8 cm behind the trunk's line and within 10 cm of it in the image."""
    hips = (points[:, kp.LEFT_HIP] + points[:, kp.RIGHT_HIP]) / 2.0
    trunk = points[:, kp.NECK] - hips
    for name in (kp.LEFT_ELBOW, kp.RIGHT_ELBOW, kp.LEFT_WRIST, kp.RIGHT_WRIST):
        point = points[:, name]
        along = np.clip(((point - hips) * trunk).sum(-1) / (trunk * trunk).sum(-1), 0.0, 1.0)
        nearest = hips + along[:, None] * trunk
        beside = np.linalg.norm((point - nearest)[:, :2], axis=-1)
        noisy[(beside < 0.10) & (point[:, 2] > nearest[:, 2] + 0.08), name] = np.nan


def _hide_face(points: np.ndarray, noisy: np.ndarray) -> None:
    """Take away nose and eyes of a face turned 100 degrees away, and the ear on the far side."""
    nose, left, right = points[:, kp.NOSE], points[:, kp.LEFT_EAR], points[:, kp.RIGHT_EAR]
    ray = _unit(nose)
    away = (_unit(nose - (left + right) / 2.0) * ray).sum(-1) > 0.17
    for name in (kp.NOSE, kp.LEFT_EYE, kp.RIGHT_EYE):
        noisy[away, name] = np.nan
    side = (_unit(left - right) * ray).sum(-1)
    noisy[side > 0.6, kp.LEFT_EAR] = np.nan
    noisy[side < -0.6, kp.RIGHT_EAR] = np.nan


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
