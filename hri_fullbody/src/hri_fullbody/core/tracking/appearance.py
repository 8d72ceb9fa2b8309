"""Appearance of a body: colours of five parts of the clothing, to recognise it after it was hidden."""

from __future__ import annotations

from typing import List, Optional, Tuple

import cv2
import numpy as np

from hri_fullbody.core.detection.pose_estimator import PoseEstimate
from hri_fullbody.core.keypoints import (
    BLAZE_LEFT_ANKLE,
    BLAZE_LEFT_ELBOW,
    BLAZE_LEFT_HIP,
    BLAZE_LEFT_KNEE,
    BLAZE_LEFT_SHOULDER,
    BLAZE_LEFT_WRIST,
    BLAZE_RIGHT_ANKLE,
    BLAZE_RIGHT_ELBOW,
    BLAZE_RIGHT_HIP,
    BLAZE_RIGHT_KNEE,
    BLAZE_RIGHT_SHOULDER,
    BLAZE_RIGHT_WRIST,
)

# Where the bins of lightness, and of both colour axes (CIE 1976 L*a*b*, 8 bits), have their middles; a value between
# two counts for both, so that no colour lies on a border. Narrow where clothes are: most are dark and of little colour.
_LIGHTNESS = np.array([0.0, 30.0, 60.0, 90.0, 130.0, 180.0, 255.0])
_COLOUR = np.array([-40.0, -20.0, -8.0, 0.0, 8.0, 20.0, 40.0])
_LEAST_CONFIDENCE = 0.4
_LEAST_SAMPLES = 12
# Where the samples lie: across and along, in parts of the trunk and of the limb. The rims show background.
_ACROSS, _ALONG = (grid.ravel()[:, None] for grid in np.meshgrid(np.linspace(0.15, 0.85, 9), np.linspace(0.0, 1.0, 8)))
_CHEST, _BELLY = (0.05, 0.45), (0.5, 0.92)
_LIMB = np.linspace(0.15, 0.9, 16)[:, None]
_TRUNK = (BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER, BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP)
_SLEEVES = ((BLAZE_LEFT_SHOULDER, BLAZE_LEFT_ELBOW), (BLAZE_LEFT_ELBOW, BLAZE_LEFT_WRIST),
            (BLAZE_RIGHT_SHOULDER, BLAZE_RIGHT_ELBOW), (BLAZE_RIGHT_ELBOW, BLAZE_RIGHT_WRIST))
_THIGHS = ((BLAZE_LEFT_HIP, BLAZE_LEFT_KNEE), (BLAZE_RIGHT_HIP, BLAZE_RIGHT_KNEE))
_SHINS = ((BLAZE_LEFT_KNEE, BLAZE_LEFT_ANKLE), (BLAZE_RIGHT_KNEE, BLAZE_RIGHT_ANKLE))
PARTS = 5
BINS = len(_LIGHTNESS) + 2 * len(_COLOUR)


def describe(image: np.ndarray, estimate: PoseEstimate) -> Optional[np.ndarray]:
    """Histograms (5, 21) of the colours of chest, belly, sleeves, thighs and shins in `image` (H, W, 3) BGR.

    Each row is lightness and both colour axes, a third each, and sums to 1, or to 0 where the part is not seen. About
    300 samples: 0.3 ms. None when the shoulders are not seen.
    """
    points, confidence = estimate.landmarks[:, :2], estimate.confidence
    if confidence[[BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER]].min() < _LEAST_CONFIDENCE:
        return None  # hips below the image are told well enough for where the trunk is
    rows = [_histogram(image, samples) for samples in (
        _trunk_samples(points, *_CHEST), _trunk_samples(points, *_BELLY), _limb_samples(points, confidence, _SLEEVES),
        _limb_samples(points, confidence, _THIGHS), _limb_samples(points, confidence, _SHINS))]
    if rows[0] is None:
        return None
    return np.stack([np.zeros(BINS) if row is None else row for row in rows])


def difference(a: Optional[np.ndarray], b: Optional[np.ndarray]) -> Optional[float]:
    """Hellinger distance, 0 (equal) to 1 (nothing in common), over the parts that both show; None when there are none.

    E. Hellinger, "Neue Begruendung der Theorie quadratischer Formen", 1909.
    """
    if a is None or b is None:
        return None
    shown = (a.sum(axis=1) > 0.0) & (b.sum(axis=1) > 0.0)
    if not shown.any():
        return None
    alike = np.clip(np.sqrt(a[shown] * b[shown]).sum(axis=1), 0.0, 1.0)
    return float(np.sqrt(1.0 - float(alike.mean())))


def blend(old: Optional[np.ndarray], new: Optional[np.ndarray], weight: float) -> Optional[np.ndarray]:
    """Move `old` towards `new` by `weight` (0 to 1), part by part; a part that only one of them shows is taken over."""
    if old is None or new is None:
        return new if old is None else old
    known, shown = old.sum(axis=1) > 0.0, new.sum(axis=1) > 0.0
    share = np.where(known & shown, weight, np.where(known, 0.0, 1.0))[:, None]
    return (1.0 - share) * old + share * new


def _trunk_samples(points: np.ndarray, first: float, last: float) -> np.ndarray:
    """Samples (N, 2) px of the trunk from one part of its length to another."""
    left_shoulder, right_shoulder, left_hip, right_hip = (points[index] for index in _TRUNK)
    top = left_shoulder + _ACROSS * (right_shoulder - left_shoulder)
    bottom = left_hip + _ACROSS * (right_hip - left_hip)
    return top + (first + _ALONG * (last - first)) * (bottom - top)


def _limb_samples(points: np.ndarray, confidence: np.ndarray,
                  limbs: Tuple[Tuple[int, int], ...]) -> Optional[np.ndarray]:
    found: List[np.ndarray] = [points[first] + _LIMB * (points[last] - points[first]) for first, last in limbs
                               if confidence[[first, last]].min() >= _LEAST_CONFIDENCE]
    return np.concatenate(found) if found else None


def _histogram(image: np.ndarray, samples: Optional[np.ndarray]) -> Optional[np.ndarray]:
    """Histogram (21,) of the samples (N, 2) px inside the image; None when they are too few."""
    if samples is None:
        return None
    height, width = image.shape[:2]
    cells = np.floor(samples).astype(np.int64)
    inside = (cells[:, 0] >= 0) & (cells[:, 0] < width) & (cells[:, 1] >= 0) & (cells[:, 1] < height)
    if inside.sum() < _LEAST_SAMPLES:
        return None
    pixels = image[cells[inside, 1], cells[inside, 0]]
    lightness, first, second = cv2.cvtColor(pixels[None], cv2.COLOR_BGR2LAB)[0].T.astype(np.float64)
    return histogram_of_colours(lightness, first - 128.0, second - 128.0)


def histogram_of_colours(lightness: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Histogram (21,), sum 1, of pixels (N,): their lightness (0 to 255), and where they lie on both axes of colour."""
    # A little more or less light is forgiven.
    light = np.convolve(np.pad(_counts(lightness, _LIGHTNESS), 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    return np.concatenate([light / light.sum(), _counts(first, _COLOUR), _counts(second, _COLOUR)]) / 3.0


def _counts(values: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Histogram, sum 1, in which a value counts for the bins on both sides of it, the nearer one more."""
    values = np.clip(values, middles[0], middles[-1])
    left = np.clip(np.searchsorted(middles, values) - 1, 0, len(middles) - 2)
    share = (values - middles[left]) / (middles[left + 1] - middles[left])
    counts: np.ndarray = (np.bincount(left, 1.0 - share, len(middles)) + np.bincount(left + 1, share, len(middles)))
    return counts / len(values)
