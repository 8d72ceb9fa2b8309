"""Optical flow of some points on each face: pyramidal Lucas-Kanade (Bouguet 2000) on the green channel at half size.

Ten faces cost about 1 ms, a fifth of one inference of the mesh network, and, unlike a constant velocity, it sees that a
head or the camera has turned back.
"""

from __future__ import annotations

from typing import List, Optional, Sequence

import cv2
import numpy as np

from hri_pipeline.core.image_rotation import ImageRotation

SHRINK = 2
"""Pixels of the image for one of the picture in which points are followed."""
_GRID = 4
_INNER = 0.35
"""Half the side of the grid of points, of the box: its rim shows what is behind the face."""
_PLACES = np.stack(np.meshgrid(*[np.linspace(-_INNER, _INNER, _GRID)] * 2), axis=-1).reshape(1, -1, 2)
"""The points, sides of the box from its centre."""
_WINDOW, _LEVELS = (9, 9), 3
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 8, 0.05)
_LEAST_BOX = 8.0
"""Side (px of the picture) of the smallest box that has room for points that differ."""
_SPREAD, _SPREAD_PART = 0.7, 0.05
"""Points agree whose motions differ from the median by less than this (px of the picture) and this part of the box."""
_AGREEING = 0.5
"""Part of the points that must agree."""
_OTHER = 20.0
"""Mean difference of grey values about a point from which it is another one."""


class FaceFlow:
    """Optical flow of boxes from each image to the next. Not thread-safe.

    An image without boxes is kept as it is, and shrunk only if there are some in the next one.
    """

    def __init__(self) -> None:
        self._image: Optional[np.ndarray] = None        # the last one, where it has not been shrunk
        self._picture: Optional[np.ndarray] = None      # the last one, shrunk

    def update(self, bgr: np.ndarray, boxes: Sequence[np.ndarray],
               expected: Sequence[np.ndarray]) -> List[Optional[np.ndarray]]:
        """Return how far (2,) px each box has moved from the last image to `bgr` (H, W, 3); None where that is not
        seen.

        boxes: (4,) px each, where they were in the last image; expected: (2,) px each, where the search begins. Nobody
        may write to `bgr` until the next call.
        """
        if not boxes:
            self._image, self._picture = bgr, None
            return []
        before = shrink(self._image) if self._image is not None else self._picture
        self._image, self._picture = None, shrink(bgr)
        if before is None or before.shape != self._picture.shape:
            return [None] * len(boxes)
        places = np.asarray(boxes, dtype=np.float64) / SHRINK
        points = _grids(places)
        guess = points + np.asarray(expected, dtype=np.float64)[:, None] / SHRINK
        found, status, error = cv2.calcOpticalFlowPyrLK(
            before, self._picture, _flat(points), _flat(guess), winSize=_WINDOW, maxLevel=_LEVELS, criteria=_STOP,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
        motions = np.asarray(found).reshape(points.shape).astype(np.float64) - points
        good = (np.asarray(status).reshape(points.shape[:2]) > 0) & (
            np.asarray(error).reshape(points.shape[:2]) < _OTHER
        )
        return _common(motions, good, (places[:, 2:] - places[:, :2]).min(axis=1))

    def turn(self, rotation: ImageRotation) -> None:
        """Turn the last image."""
        self._image = None if self._image is None else rotation.image(self._image)
        self._picture = None if self._picture is None else rotation.image(self._picture)

    def reset(self) -> None:
        """Forget the last image."""
        self._image = self._picture = None


def shrink(bgr: np.ndarray) -> np.ndarray:
    """Return the picture (H / SHRINK, W / SHRINK) of an image (H, W, 3), in which points are followed."""
    green = cv2.extractChannel(bgr, 1)
    size = (max(1, green.shape[1] // SHRINK), max(1, green.shape[0] // SHRINK))
    return cv2.resize(green, size, interpolation=cv2.INTER_AREA)


def _grids(boxes: np.ndarray) -> np.ndarray:
    """Points (N, P, 2) on a grid in the inner part of boxes (N, 4)."""
    return (boxes[:, None, :2] + boxes[:, None, 2:]) / 2.0 + _PLACES * (boxes[:, None, 2:] - boxes[:, None, :2])


def _flat(points: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(points.reshape(-1, 1, 2), dtype=np.float32)


def _common(motions: np.ndarray, good: np.ndarray, sides: np.ndarray) -> List[Optional[np.ndarray]]:
    """The motion (2,) px of the image that most points of each box share; None without one.

    motions: (N, P, 2) px of the picture; good: (N, P), which points were found; sides: (N,) px of the picture.
    """
    ordered = np.sort(np.where(good[..., None], motions, np.inf), axis=1)
    counts = good.sum(axis=1)
    middle = ordered[np.arange(len(ordered)), counts // 2]
    middle[~np.isfinite(middle).all(axis=1)] = 0.0
    apart = motions - middle[:, None]
    agree = good & (np.hypot(apart[..., 0], apart[..., 1]) < (_SPREAD + _SPREAD_PART * sides)[:, None])
    agreeing = agree.sum(axis=1)
    enough = (agreeing >= _AGREEING * good.shape[1]) & (sides >= _LEAST_BOX)
    mean = SHRINK * (motions * agree[..., None]).sum(axis=1) / np.maximum(agreeing, 1)[:, None]
    return [motion if known else None for motion, known in zip(mean, enough.tolist())]
