"""How a face moves: as living ones do, or not at all as on a picture of somebody; and so fast that its crop is blurred.

Mouth, eyes and the turning of the head change the shape of a face mesh all the time; that of a picture changes by the
noise of the image only, however the camera pans.
"""

from __future__ import annotations

from collections import deque
from typing import Deque, Optional, Tuple

import cv2
import numpy as np

from hri_pipeline.core.image_rotation import ImageRotation

WINDOW_S, SAMPLE_S = 6.0, 0.2
"""Time (s) over which shapes are compared, and the least between two of them."""
LEAST_SAMPLES = 20
STILL = 0.015
"""RMS change of a shape, as a share of its size, below which a face may be a picture. Measured: pictures in noise 0.003
to 0.010, seven films of people who speak or grimace 0.022 to 0.14."""
RATIO = 3.0
"""By how much more a living face moves than the picture beside it."""
_STRIDE = 8
EVEN = 0.65
"""Evenness of a crop, as a share of the best one of its face, below which it is blurred by motion. Three people in a
pan of 90 degrees a second: templates of crops below it are .27 to .39 from those at rest, others .06 to .23."""
BLUR_PATIENCE_S = 1.0
"""Time (s) after which a face whose crops stay uneven looks so."""
_JUDGED_SIZE, _DETAIL = 64, 1.5


class FaceMotion:
    """The shapes of one face over the last seconds."""

    def __init__(self) -> None:
        self._shapes: Deque[Tuple[float, np.ndarray]] = deque()

    def add(self, mesh: np.ndarray, stamp: float) -> None:
        """Take the mesh (N, 2 or 3), px, of the image at `stamp` (s)."""
        if self._shapes and 0.0 <= stamp - self._shapes[-1][0] < SAMPLE_S:
            return
        points = np.asarray(mesh[::_STRIDE, :2], dtype=np.float64)
        points = points - points.mean(axis=0)
        size = float(np.sqrt((points ** 2).sum(axis=1).mean()))
        if not 0.0 < size < np.inf:
            return
        self._shapes.append((stamp, points / size))
        while not 0.0 <= stamp - self._shapes[0][0] <= WINDOW_S:
            self._shapes.popleft()

    def turn(self, rotation: ImageRotation) -> None:
        """Turn with the images: the face has not moved."""
        self._shapes = deque((stamp, shape @ rotation.matrix[:2, :2].T) for stamp, shape in self._shapes)

    def change(self) -> Optional[float]:
        """Return the RMS change of the shape, as a share of its size; None before it was seen for long enough."""
        if len(self._shapes) < LEAST_SAMPLES:
            return None
        shapes = np.array([shape for _, shape in self._shapes])
        return float(np.sqrt(((shapes - shapes.mean(axis=0)) ** 2).sum(axis=2).mean()))

    def is_picture_beside(self, other: FaceMotion) -> bool:
        """Tell whether this is the picture and `other` lives, where one is known to be a picture of the other."""
        own, living = self.change(), other.change()
        return own is not None and living is not None and own < STILL and living > RATIO * own


class MotionBlur:
    """Whether crops of one face are blurred by a motion of the head or the camera: their details lie along it."""

    def __init__(self) -> None:
        self._best = 0.0
        self._since: Optional[float] = None

    def is_blurred(self, crop: np.ndarray, stamp: float) -> bool:
        """Take a crop (S, S, 3) uint8 BGR of the image at `stamp` (s); tell if it is blurred against the others."""
        value = evenness(crop)
        self._since = stamp if self._since is None or stamp < self._since else self._since
        if value < EVEN * self._best and stamp - self._since < BLUR_PATIENCE_S:
            return True
        self._best = value if value < EVEN * self._best else max(value, self._best)
        self._since = None
        return False


def evenness(crop: np.ndarray) -> float:
    """Return the contrast of the details of a crop (S, S, 3) uint8 BGR in the direction with least of it, over that
    across it, 0 to 1: from the structure tensor (Foerstner and Guelch 1987)."""
    grey = cv2.cvtColor(cv2.resize(crop, (_JUDGED_SIZE, _JUDGED_SIZE), interpolation=cv2.INTER_AREA),
                        cv2.COLOR_BGR2GRAY).astype(np.float32)
    details = grey - cv2.GaussianBlur(grey, (0, 0), _DETAIL)
    along_x = (details[1:-1, 2:] - details[1:-1, :-2]).ravel()
    along_y = (details[2:, 1:-1] - details[:-2, 1:-1]).ravel()
    xx, xy, yy = float(along_x @ along_x), float(along_x @ along_y), float(along_y @ along_y)
    mean, apart = 0.5 * (xx + yy), float(np.hypot(0.5 * (xx - yy), xy))
    return float(np.sqrt(max(0.0, mean - apart) / max(1e-6, mean + apart)))
