"""Appearance of a body: colours of five parts of the clothing, to recognise it after it was hidden."""

from __future__ import annotations

import math
from typing import List, Optional, Sequence, Tuple

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
    rows = _histograms(image, [
        _trunk_samples(points, *_CHEST), _trunk_samples(points, *_BELLY), _limb_samples(points, confidence, _SLEEVES),
        _limb_samples(points, confidence, _THIGHS), _limb_samples(points, confidence, _SHINS)])
    return rows if rows[0].any() else None


def difference(a: Optional[np.ndarray], b: Optional[np.ndarray]) -> Optional[float]:
    """Hellinger distance, 0 (equal) to 1 (nothing in common), over the parts that both show; None when there are none.

    E. Hellinger, "Neue Begruendung der Theorie quadratischer Formen", 1909.
    """
    if a is None or b is None:
        return None
    shown = np.count_nonzero(a.any(axis=1) & b.any(axis=1))
    if not shown:
        return None
    # What one does not show is 0 in the product. Rounding may take a sum a little beyond 1.
    return math.sqrt(max(0.0, 1.0 - float(np.sqrt(a * b).sum()) / shown))


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


def _histograms(image: np.ndarray, parts: Sequence[Optional[np.ndarray]]) -> np.ndarray:
    """Histograms (P, 21) of parts, samples (N, 2) px each; 0 where too few of them are inside the image."""
    rows = np.zeros((len(parts), BINS))
    samples = np.concatenate([np.zeros((0, 2))] + [part for part in parts if part is not None])
    owners = np.repeat(np.arange(len(parts)), [0 if part is None else len(part) for part in parts])
    height, width = image.shape[:2]
    x, y = np.floor(samples).astype(np.int64).T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    inside &= (np.bincount(owners[inside], minlength=len(parts)) >= _LEAST_SAMPLES)[owners]
    if inside.any():
        pixels = image[y[inside], x[inside]]
        lightness, first, second = cv2.cvtColor(pixels[None], cv2.COLOR_BGR2LAB)[0].T.astype(np.float64)
        shown, number = np.unique(owners[inside], return_inverse=True)
        rows[shown] = _rows(number, len(shown), lightness, first - 128.0, second - 128.0)
    return rows


def histogram_of_colours(lightness: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Histogram (21,), sum 1, of pixels (N,): their lightness (0 to 255), and where they lie on both axes of colour."""
    return _rows(np.zeros(len(lightness), np.int64), 1, lightness, first, second)[0]


def _rows(owners: np.ndarray, count: int, lightness: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Histograms (count, 21) of pixels (N,), each of which belongs to the row `owners` (N,)."""
    light = _counts(owners, count, lightness, _LIGHTNESS)
    # A little more or less light is forgiven.
    edged = np.concatenate([light[:, :1], light, light[:, -1:]], axis=1)
    light = 0.25 * edged[:, :-2] + 0.5 * light + 0.25 * edged[:, 2:]
    return np.concatenate([light / light.sum(axis=1, keepdims=True), _counts(owners, count, first, _COLOUR),
                           _counts(owners, count, second, _COLOUR)], axis=1) / 3.0


def _counts(owners: np.ndarray, count: int, values: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Histograms (count, B), sum 1 each, in which a value counts for the bins on both sides of it, the nearer more."""
    place = np.interp(values, middles, np.arange(len(middles)))
    left = np.minimum(place.astype(np.int64), len(middles) - 2)
    share, cell = place - left, owners * len(middles) + left
    size = count * len(middles)
    counts = (np.bincount(cell, 1.0 - share, size) + np.bincount(cell + 1, share, size)).reshape(count, len(middles))
    return np.asarray(counts / counts.sum(axis=1, keepdims=True))
