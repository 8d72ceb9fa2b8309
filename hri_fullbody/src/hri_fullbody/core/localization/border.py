"""Bodies that a side or the top of the image cuts: a pose network squeezes a whole person into what it still sees."""

from __future__ import annotations

import math
from typing import Optional

import numpy as np

_REACH = 0.1            # of the body's extent: what comes so near to the border may go on behind it
_FARTHER = 0.08         # logarithm of the range: as much as ranges of one who is seen whole are apart,
_FARTHER_RATE = 0.02    # and more per s since the last range that was right
_SPEED = 0.3            # m/s by which the range follows one who is cut; a squeezed one shrinks faster


def is_cut(box: np.ndarray, extent: float, width: int) -> bool:
    """Tell whether a body whose seen landmarks have this box (4,) px may go on beyond the left, right or upper border.

    extent: its size, px. width: of the image, px. Beyond the lower border are legs, of which nothing else depends.
    """
    return bool(min(box[0], width - box[2], box[1]) < _REACH * extent)


class CutRange:
    """Whether the range of a body that is cut agrees with what it was before: a squeezed one seems to be farther."""

    def __init__(self) -> None:
        self._range: Optional[float] = None
        self._stamp = 0.0

    def is_right(self, distance: float, stamp: float, cut: bool, sure: bool) -> bool:
        """Take the range (m) of a body's landmarks at `stamp` (s); tell whether they show where it is.

        cut: see is_cut. sure: face or depth image tell the distance. The longer ago the last right range is, the more
        is allowed; a body that was never seen otherwise is right.
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
