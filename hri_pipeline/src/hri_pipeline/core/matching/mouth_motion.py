"""How much a mouth moves: the opening of the lips out of action units or landmarks, and its motion over time."""

from __future__ import annotations

from typing import Tuple

import numpy as np

LIPS_PART, JAW_DROP = 25, 26
JAW_SHARE = 0.25
"""Share of the jaw (AU26) in the opening: lips that stay closed over a moving jaw chew, they do not speak."""
WINDOW_S = 0.5
"""Span in which the motion is measured: two syllables (speech has 4 to 5 a second; Greenberg 2003, J. Phonetics 31)."""
MIN_SAMPLES = 3
MIN_SPAN_S = 0.15
_WIDEST = 3.0
"""Who speaks with a broad smile moves the lips beyond where AU25 is at its fullest; action units cannot tell that."""
_CAPACITY = 1024
"""Samples kept: half of them are 17 s at 30 images a second."""

# Landmarks of dlib's scheme: the inner lips, upper and lower one of each pair; both eyes; the base of the nose.
_UPPER, _LOWER = (61, 62, 63), (67, 66, 65)
_EYES, _NOSE_BASE = tuple(range(36, 48)), 33
_EYES_TO_NOSE = 0.77
"""Height from the middle of the eyes to the base of the nose in distances of the eyes, in the canonical face."""
_GAP_START, _GAP_FULL = 0.02, 0.20
"""Gap of the lips in distances of the eyes at which AU25 begins and is at its fullest, as in action_units_table."""


def opening_of_units(intensity: np.ndarray, confidence: np.ndarray) -> Tuple[float, float]:
    """Return opening (0..1) and weight (0..1; 0: not known) out of the 99 action units of a face."""
    weight = float(confidence[LIPS_PART])
    if not weight > 0.0:
        return 0.0, 0.0
    jaw = float(intensity[JAW_DROP]) if confidence[JAW_DROP] > 0.0 else float(intensity[LIPS_PART])
    return (1.0 - JAW_SHARE) * float(intensity[LIPS_PART]) + JAW_SHARE * jaw, min(1.0, weight)


def opening_of_landmarks(landmarks: np.ndarray, aspect: float) -> Tuple[float, float]:
    """Return opening (on the scale of AU25, and beyond it up to 3) and weight out of landmarks (70, 3): x, y in 0..1, confidence.

    aspect: width over height of the image. The gap of the inner lips is measured against the height from the eyes to the
    base of the nose, which neither a turn of the head nor the jaw changes much.
    """
    points = landmarks[:, :2] * np.array([aspect, 1.0])
    height = float(np.linalg.norm(points[list(_EYES)].mean(axis=0) - points[_NOSE_BASE]))
    used = list(_UPPER + _LOWER + _EYES) + [_NOSE_BASE]
    weight = float(landmarks[used, 2].min())
    if not height > 1e-6 or not weight > 0.0:
        return 0.0, 0.0
    gap = float(np.linalg.norm(points[list(_UPPER)] - points[list(_LOWER)], axis=1).mean())
    part = (gap / height * _EYES_TO_NOSE - _GAP_START) / (_GAP_FULL - _GAP_START)
    return float(np.clip(part, 0.0, _WIDEST)), min(1.0, weight)


class MouthTrack:
    """Opening of one mouth over the last seconds."""

    def __init__(self) -> None:
        self._samples = np.empty((_CAPACITY, 3))
        self._count = 0

    @property
    def newest(self) -> float:
        """Stamp (s) of the last sample, minus infinity without one."""
        return float(self._samples[self._count - 1, 0]) if self._count else float("-inf")

    def add(self, stamp: float, opening: float, weight: float) -> None:
        """Take the opening (0..1) in the image of time `stamp` (s); one that is not newer, or without weight, is left out."""
        if weight <= 0.0 or stamp <= self.newest:
            return
        if self._count == _CAPACITY:
            self._samples[:_CAPACITY // 2] = self._samples[_CAPACITY // 2:]
            self._count = _CAPACITY // 2
        self._samples[self._count] = stamp, opening, weight
        self._count += 1

    def motion(self, times: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return the motion (T,), standard deviation of the opening around each of the times (s), and its weight (T,).

        times: in ascending order. NaN and 0 where less than MIN_SAMPLES samples lie in the window.
        """
        begin = int(np.searchsorted(self._samples[:self._count, 0], times[0] - 0.5 * WINDOW_S))
        stamps, openings, weights = self._samples[begin:self._count].T
        if not len(stamps):
            return np.full(len(times), np.nan), np.zeros(len(times))
        first = np.searchsorted(stamps, times - 0.5 * WINDOW_S, side="left")
        last = np.searchsorted(stamps, times + 0.5 * WINDOW_S, side="right")
        count = last - first
        sums = np.zeros((3, len(stamps) + 1))
        np.cumsum(np.stack([openings, openings ** 2, weights]), axis=1, out=sums[:, 1:])
        total, squares, weight = sums[:, last] - sums[:, first]
        known = count >= MIN_SAMPLES
        known[known] &= stamps[last[known] - 1] - stamps[first[known]] >= MIN_SPAN_S
        safe = np.maximum(count, 2)
        variance = np.maximum(0.0, squares - total ** 2 / safe) / (safe - 1)
        return np.where(known, np.sqrt(variance), np.nan), np.where(known, weight / safe, 0.0)
