"""Appearance of a body: colour histograms of trunk and thighs, to recognise it after it was hidden."""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

from hri_fullbody.core.detection.pose_estimator import PoseEstimate
from hri_fullbody.core.keypoints import (
    BLAZE_LEFT_HIP,
    BLAZE_LEFT_KNEE,
    BLAZE_LEFT_SHOULDER,
    BLAZE_RIGHT_HIP,
    BLAZE_RIGHT_KNEE,
    BLAZE_RIGHT_SHOULDER,
)

_HUES, _GREYS = 12, 5
_BINS = _HUES + _GREYS
# A pixel with less saturation or value has no hue worth the name; out of 255.
_LEAST_SATURATION, _LEAST_VALUE = 50, 40
_LEAST_CONFIDENCE = 0.4
_LEAST_SAMPLES = 24
# Where the samples lie: across and along, in parts of the trunk and of the thigh. The rims show background and arms.
_TRUNK_ACROSS, _TRUNK_ALONG = np.meshgrid(np.linspace(0.12, 0.88, 10), np.linspace(0.08, 0.92, 12))
_THIGH_ALONG = np.linspace(0.2, 0.9, 20)
_TRUNK = (BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER, BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP)
_THIGHS = ((BLAZE_LEFT_HIP, BLAZE_LEFT_KNEE), (BLAZE_RIGHT_HIP, BLAZE_RIGHT_KNEE))


def describe(image: np.ndarray, estimate: PoseEstimate) -> Optional[np.ndarray]:
    """Histograms (2, 17) of the colours of trunk and thighs in `image` (H, W, 3) BGR; rows sum to 1, or to 0 when
    unseen.

    Coloured pixels count by hue, the others by brightness. About 300 samples: 0.1 ms. None when the shoulders are not
    seen.
    """
    points, confidence = estimate.landmarks[:, :2], estimate.confidence
    if confidence[[BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER]].min() < _LEAST_CONFIDENCE:
        return None  # hips below the image are told well enough for where the trunk is
    trunk = _histogram(image, _trunk_samples(points))
    if trunk is None:
        return None
    thighs = [points[hip] + _THIGH_ALONG[:, None] * (points[knee] - points[hip])
              for hip, knee in _THIGHS if confidence[[hip, knee]].min() >= _LEAST_CONFIDENCE]
    legs = _histogram(image, np.concatenate(thighs)) if thighs else None
    return np.stack([trunk, np.zeros(_BINS) if legs is None else legs])


def difference(a: Optional[np.ndarray], b: Optional[np.ndarray]) -> Optional[float]:
    """Hellinger distance, 0 (equal) to 1 (nothing in common), over the parts that both show; None when there are none.

    The trunk counts twice. E. Hellinger, "Neue Begruendung der Theorie quadratischer Formen", 1909.
    """
    if a is None or b is None:
        return None
    shown = (a.sum(axis=1) > 0.0) & (b.sum(axis=1) > 0.0)
    if not shown.any():
        return None
    alike = np.clip(np.sqrt(a * b).sum(axis=1), 0.0, 1.0)
    weights = np.array([2.0, 1.0])[shown]
    return float(np.sqrt(1.0 - float(alike[shown] @ weights) / float(weights.sum())))


def blend(old: Optional[np.ndarray], new: Optional[np.ndarray], weight: float) -> Optional[np.ndarray]:
    """Move `old` towards `new` by `weight` (0 to 1), part by part; a part that only one of them shows is taken over."""
    if old is None or new is None:
        return new if old is None else old
    known, shown = old.sum(axis=1) > 0.0, new.sum(axis=1) > 0.0
    share = np.where(known & shown, weight, np.where(known, 0.0, 1.0))[:, None]
    return (1.0 - share) * old + share * new


def _trunk_samples(points: np.ndarray) -> np.ndarray:
    left_shoulder, right_shoulder, left_hip, right_hip = (points[index] for index in _TRUNK)
    across, along = _TRUNK_ACROSS.ravel()[:, None], _TRUNK_ALONG.ravel()[:, None]
    top = left_shoulder + across * (right_shoulder - left_shoulder)
    bottom = left_hip + across * (right_hip - left_hip)
    return top + along * (bottom - top)


def _histogram(image: np.ndarray, samples: np.ndarray) -> Optional[np.ndarray]:
    """Histogram (17,) of the samples (N, 2) px inside the image; None when they are too few."""
    height, width = image.shape[:2]
    cells = np.floor(samples).astype(np.int64)
    inside = (cells[:, 0] >= 0) & (cells[:, 0] < width) & (cells[:, 1] >= 0) & (cells[:, 1] < height)
    if inside.sum() < _LEAST_SAMPLES:
        return None
    pixels = image[cells[inside, 1], cells[inside, 0]]
    hue, saturation, value = cv2.cvtColor(pixels[None], cv2.COLOR_BGR2HSV)[0].T.astype(np.int64)
    coloured = (saturation >= _LEAST_SATURATION) & (value >= _LEAST_VALUE)
    hues = np.bincount(hue[coloured] * _HUES // 180, minlength=_HUES)[:_HUES].astype(np.float64)
    # A colour on the border of two bins must not jump from one to the other.
    hues = 0.5 * hues + 0.25 * (np.roll(hues, 1) + np.roll(hues, -1))
    greys = np.bincount(value[~coloured] * _GREYS // 256, minlength=_GREYS).astype(np.float64)
    greys = np.convolve(np.pad(greys, 1, mode="edge"), [0.2, 0.6, 0.2], mode="valid")
    both = np.concatenate([hues, greys])
    return both / both.sum()
