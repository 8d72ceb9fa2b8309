"""Where things are in an image after the camera has suddenly zoomed, or bars have come: what both images show, in
another size or far away from where it was.

Corners are compared by what is about them (E. Rublee et al., "ORB: an efficient alternative to SIFT or SURF", 2011),
and most must agree upon one size and place.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Optional

import cv2
import numpy as np

_SIDE, _LEAST_SIDE = 480, 64    # px: longer side of the picture in which corners are looked for, or less; shorter one
_CORNERS, _LEVEL, _LEVELS, _PATCH = 400, 1.2, 8, 15
_ALIKE = 60             # bits of 256 by which one corner differs in two images, at most
_REACH, _TRIES = 3.0, 500       # px by which those that agree differ; RANSAC
# Of ten photographs a fifth of the corners and more agreed up to a zoom of 2, at 3 none to a third; of two different
# ones 6 corners at most.
_AGREEING, _SHARE = 15, 0.15
# So many others (a part of those that agree, and some by chance) may go nearly (px) where these go, or stay. More do
# where the camera turns: of 64 turns by 12 to 24 degrees before four photographs that nothing was tuned on, 14 passed
# for jumps without this, with places up to 250 px wrong, none with it; of 36 zooms and shifts 35 are found, as without.
# More stay where somebody near comes nearer.
_NEARLY, _NEARLY_PART, _STAYING, _BY_CHANCE = (6.0, 24.0), 0.1, 1.5, 3
_SPREAD = 0.2           # of the picture over which they are spread in both directions, not in a logo or a clock alone
_MOST_ROLL = math.radians(5.0)
_LARGEST = 3.5          # times
# By so much of its size things must grow, or shrink. Less of it is a slow zoom, which optical flow follows, or a camera
# that turns: then it lies between (.89 to 1.11 in turns by 4 to 20 degrees before three photographs), and no one size
# and place is that of all that is seen. A shifted picture is as large as before.
_GROWN, _SAME_SIZE = math.log(1.15), 0.01
_SAME_PLACE = 0.03      # of the longer side


class Jump(NamedTuple):
    """What was at a point of the image before is at `scale` times that plus `shift` (2,) px."""

    scale: float
    shift: np.ndarray

    @property
    def has_grown(self) -> bool:
        """Whether things are clearly larger or smaller."""
        return abs(math.log(self.scale)) >= _GROWN

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Move points (N, 2 or more), x and y px; what stands behind them, in px, too, grows with them."""
        moved = self.scale * np.asarray(points, dtype=np.float64)
        moved[:, :2] += self.shift
        return moved


def picture_of(bgr: np.ndarray) -> np.ndarray:
    """What `find_jump` compares of an image (H, W, 3) uint8: a copy (h, w), every so many pixels of it."""
    step = _step(bgr)
    return np.ascontiguousarray(bgr[::step, ::step, 1])


def _step(bgr: np.ndarray) -> int:
    return max(1, -(-max(bgr.shape[:2]) // _SIDE))


def find_jump(before: np.ndarray, bgr: np.ndarray) -> Optional[Jump]:
    """Return how an image (H, W, 3) uint8 shows what one of the same size, of which `before` is the picture, has shown
    in another size, or elsewhere; None where it does not, or has not jumped."""
    picture, step = picture_of(bgr), _step(bgr)
    if picture.shape != before.shape or min(picture.shape) < _LEAST_SIDE:
        return None
    # The stubs of OpenCV know ORB.create only, which older versions of it have not.
    orb = cv2.ORB_create(  # type: ignore[attr-defined]
        _CORNERS, _LEVEL, _LEVELS, _PATCH, 0, 2, cv2.ORB_HARRIS_SCORE, _PATCH)
    corners, bits = orb.detectAndCompute(before, None)
    others, other_bits = orb.detectAndCompute(picture, None)
    if bits is None or other_bits is None:
        return None
    pairs = [pair for pair in cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(bits, other_bits)
             if pair.distance < _ALIKE]
    start = np.array([corners[pair.queryIdx].pt for pair in pairs]).reshape(-1, 2)
    end = np.array([others[pair.trainIdx].pt for pair in pairs]).reshape(-1, 2)
    agree = _agreeing(start, end)
    if np.count_nonzero(agree) < max(_AGREEING, _SHARE * len(pairs)):
        return None
    if min(np.ptp(start[agree], axis=0).min(), np.ptp(end[agree], axis=0).min()) < _SPREAD * min(picture.shape):
        return None
    jump = _jump(start[agree], end[agree], max(picture.shape))
    if jump is None or not _explains(jump, start, end, agree):
        return None
    return Jump(jump.scale, step * jump.shift)


def _agreeing(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Which (N,) of the pairs of points (N, 2) px agree upon one size, place and hardly any roll; none of too few."""
    nobody = np.zeros(len(start), dtype=bool)
    if len(start) < _AGREEING:
        return nobody
    matrix, inliers = cv2.estimateAffinePartial2D(start, end, method=cv2.RANSAC, ransacReprojThreshold=_REACH,
                                                  maxIters=_TRIES)
    if matrix is None:
        return nobody
    across, down = np.asarray(matrix)[:, 0].tolist()
    if abs(math.atan2(down, across)) > _MOST_ROLL:
        return nobody
    return np.asarray(inliers).ravel() > 0


def _explains(jump: Jump, start: np.ndarray, end: np.ndarray, agree: np.ndarray) -> bool:
    """Whether the other pairs of points (N, 2) px than those that agree (N,) upon a jump are mere mistakes: hardly any
    stays, or goes nearly where they go."""
    apart = np.hypot(*(end - jump.pixels(start))[~agree].T)
    moved = np.hypot(*(end - start)[~agree].T)
    nearly = (apart > _NEARLY[0]) & (apart < _NEARLY[1])
    return max(np.count_nonzero(nearly),
               np.count_nonzero(moved < _STAYING)) <= _BY_CHANCE + _NEARLY_PART * np.count_nonzero(agree)


def _jump(start: np.ndarray, end: np.ndarray, side: int) -> Optional[Jump]:
    """The jump between points (N, 2) px of two pictures, whose longer side is `side` px, by least squares; None for
    none."""
    middle, there = start.mean(axis=0), end.mean(axis=0)
    scale = float(((end - there) * (start - middle)).sum() / max(1e-9, ((start - middle) ** 2).sum()))
    if not 1.0 / _LARGEST < scale < _LARGEST:
        return None
    jump = Jump(scale, there - scale * middle)
    far = float(np.hypot(*(there - middle))) >= _SAME_PLACE * side
    return jump if jump.has_grown or (far and abs(scale - 1.0) < _SAME_SIZE) else None
