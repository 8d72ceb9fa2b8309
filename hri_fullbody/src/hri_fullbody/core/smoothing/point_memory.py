"""Key points that go missing for a moment stay where they were on the body."""

from __future__ import annotations

import math

import numpy as np

from hri_fullbody.core.skeleton import LEFT_SHOULDER, NECK, RIGHT_SHOULDER


class PointMemory:
    """Fills missing key points of one body for `hold` s with their last place relative to the neck."""

    def __init__(self, hold: float = 0.7) -> None:
        self._hold = hold
        self._origin = np.full(3, np.nan)
        self._origin_seen = -math.inf
        self._offsets = np.full((18, 3), np.nan)
        self._seen = np.full(18, -np.inf)

    def fill(self, points: np.ndarray, stamp: float) -> np.ndarray:
        """Return the points (18, 3) m, NaN unknown, of time `stamp` (s), with remembered ones filled in.

        Without a neck it is the middle of the shoulders, and for `hold` s where it was. Stamps must not go back.
        """
        known = np.isfinite(points[:, 0])
        origin = points[NECK] if known[NECK] else 0.5 * (points[LEFT_SHOULDER] + points[RIGHT_SHOULDER])
        if math.isfinite(origin[0]):
            self._origin, self._origin_seen = origin.copy(), stamp
        elif stamp - self._origin_seen <= self._hold:
            origin = self._origin
        else:
            return points
        self._offsets[known] = points[known] - origin
        self._seen[known] = stamp
        missing = ~known & (self._seen >= stamp - self._hold)
        missing[NECK] = not known[NECK]
        self._offsets[NECK] = 0.0
        return np.where(missing[:, None], origin + self._offsets, points)
