"""When the detector looks at which part of the image: its cost follows what there is to see.

The whole image is searched by time. Parts of it (tiles), which show small faces, and the image with a border, which shows
a face that fills it, are searched one at a time: where a face waits for its confirmation, or where something has changed
since the last look; what does not change is looked at now and then only.
"""

from __future__ import annotations

from typing import List, Optional, Sequence

import numpy as np

from hri_pipeline.core.faces.face_detector import Region, tile_regions, wide_region

QUIET_FACTOR = 2.0
"""The time between two looks grows by this while every face seen is known and none is lost."""
STILL_FACTOR = 10.0
"""Times the detection period after which a part is searched although nothing changes in it."""
_THUMB_STEP = 16
_CHANGE = 12.0
"""Mean difference (grey values) of a patch of the thumbnail that is a change, not noise."""
_CHANGED_PART = 0.02
"""Part of a tile that must have changed."""


class DetectionSchedule:
    """Says which regions of the image the detector looks at now, spreading the cost over frames.

    The whole image is looked at once per `period` (s), or QUIET_FACTOR periods while nothing is unclear; half-way
    between, one part. The first call asks for everything.
    """

    def __init__(self, period: float, tiles: int) -> None:
        """Raises ValueError for a negative period or less than one tile."""
        if tiles < 1:
            raise ValueError("tiles must be at least 1, got %r" % (tiles,))
        self._tiles = tiles
        self.set_period(period)
        self.reset()

    def set_period(self, period: float) -> None:
        """Set the period (s), from the next look on; raises ValueError for a negative one."""
        if period < 0.0:
            raise ValueError("detection period must not be negative, got %r s" % (period,))
        self._period = period

    def reset(self) -> None:
        """Forget the past: the next call asks for every region."""
        self._next = -np.inf
        self._whole_next = True
        self._searched: List[float] = []
        self._thumbs: List[Optional[np.ndarray]] = []
        self._size = (0, 0)

    def hurry(self, stamp: float) -> None:
        """Something is unclear: look again one (short) period after `stamp` (s)."""
        self._next = min(self._next, stamp + self._step(False))

    def due(self, bgr: np.ndarray, stamp: float, waiting: Sequence[np.ndarray] = (), quiet: bool = False
            ) -> List[Region]:
        """Return regions (x0, y0, x1, y1 px) of the (H, W, 3) image of this stamp (s); often the empty list.

        waiting: centres (2,) px of faces that a look of the detector would confirm. quiet: nothing is unclear.
        """
        if stamp < self._next:
            return []
        height, width = bgr.shape[:2]
        whole = (0, 0, width, height)
        tiles = tile_regions(width, height, self._tiles)
        if tiles:
            tiles.append(wide_region(width, height))
        self._next = stamp + self._step(quiet)
        thumb = _thumbnail(bgr)
        if self._size != (width, height):
            self._size = (width, height)
            self._searched, self._thumbs = [stamp] * len(tiles), [thumb] * len(tiles)
            self._whole_next = not tiles
            return [whole] + tiles
        look_at_whole = self._whole_next or not tiles
        self._whole_next = not look_at_whole or not tiles
        if look_at_whole:
            return [whole]
        chosen = self._choose(tiles, thumb, stamp, waiting)
        if chosen is None:
            return []
        self._searched[chosen], self._thumbs[chosen] = stamp, thumb
        return [tiles[chosen]]

    def _step(self, quiet: bool) -> float:
        period = self._period * (QUIET_FACTOR if quiet else 1.0)
        return period / (2.0 if self._tiles > 1 else 1.0)

    def _choose(self, tiles: Sequence[Region], thumb: np.ndarray, stamp: float,
                waiting: Sequence[np.ndarray]) -> Optional[int]:
        """The tile that needs a look most, None when no one does."""
        best: Optional[int] = None
        best_need = 0.0
        for index, tile in enumerate(tiles):
            age = stamp - self._searched[index]
            waits = any(_contains(tile, point) for point in waiting)
            due = waits or age >= STILL_FACTOR * self._period or _changed(tile, thumb, self._thumbs[index])
            need = (age + self._period) * (4.0 if waits else 1.0)
            if due and need > best_need:
                best, best_need = index, need
        return best


def _thumbnail(bgr: np.ndarray) -> np.ndarray:
    """Grey values (h, w) of every 16th pixel, mean of the two by two around it against flicker."""
    half = _THUMB_STEP // 2
    total = np.zeros(bgr[half::_THUMB_STEP, half::_THUMB_STEP, 1].shape, np.float32)
    for row, column in ((half, half), (half - 2, half), (half, half - 2), (half - 2, half - 2)):
        part = bgr[row::_THUMB_STEP, column::_THUMB_STEP, 1]
        total += part[:total.shape[0], :total.shape[1]]
    return total / 4.0


def _changed(tile: Region, now: np.ndarray, before: Optional[np.ndarray]) -> bool:
    if before is None or before.shape != now.shape:
        return True
    x0, y0, x1, y1 = (max(0, value) // _THUMB_STEP for value in tile)
    difference = np.abs(now[y0:y1, x0:x1] - before[y0:y1, x0:x1])
    return bool(difference.size == 0 or (difference > _CHANGE).mean() > _CHANGED_PART)


def _contains(region: Region, point: np.ndarray) -> bool:
    x0, y0, x1, y1 = region
    return bool(x0 <= point[0] < x1 and y0 <= point[1] < y1)
