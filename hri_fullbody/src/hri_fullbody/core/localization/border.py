"""Bodies that a side or the top of the image cuts: a pose network squeezes a whole person into what it still sees."""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np

# Parts of the body's extent: what comes so near to the border may go on behind it; a face that is lost so near to it
# has left.
_REACH, _FACE_REACH = 0.1, 0.2
_FARTHER = 0.08         # logarithm of the range: as much as ranges of one who is seen whole are apart,
_FARTHER_RATE = 0.02    # and more per s since the last range that was right
_SPEED = 0.3            # m/s by which the range follows one who is cut; a squeezed one shrinks faster


def is_cut(box: np.ndarray, extent: float, width: int) -> bool:
    """Tell whether a body whose seen landmarks have this box (4,) px may go on beyond the left, right or upper border.

    extent: its size, px. width: of the image, px. Beyond the lower border are legs, of which nothing else depends.
    """
    x0, y0, x1, _ = box.tolist()
    return min(x0, width - x1, y0) < _REACH * extent


def is_leaving(face: np.ndarray, extent: float, size: Tuple[int, int]) -> bool:
    """Tell whether a face at (2,) px, of a body of this extent (px), is so near to the border that it may leave the
    image. size: width and height of the image, px."""
    (x, y), (width, height) = face.tolist(), size
    return min(x, y, width - x, height - y) < _FACE_REACH * extent


class CutRange:
    """Whether the range of a body that is cut agrees with what it was before: a squeezed one seems to be farther."""

    def __init__(self) -> None:
        self._range: Optional[float] = None
        self._stamp = 0.0

    def is_right(self, distance: float, stamp: float, cut: bool, sure: bool) -> bool:
        """Take the range (m) of a body's landmarks at `stamp` (s); tell whether they show where it is.

        cut: its face has left, and the border cuts it. sure: face or depth image tell the distance. The longer ago the
        last right range is, the more is allowed; a body that was never seen otherwise is right.
        """
        elapsed = max(0.0, stamp - self._stamp)
        if not cut:
            self._range, self._stamp = distance, stamp
        elif self._range is not None:
            if not sure and math.log(distance / self._range) > _FARTHER + _FARTHER_RATE * elapsed:
                return False
            way = _SPEED * elapsed
            self._range, self._stamp = self._range + min(max(distance - self._range, -way), way), stamp
        elif sure:
            self._range, self._stamp = distance, stamp
        return True
