"""What runs on which image, besides the mesh network (`core.scheduler`): the detector, the measure of picture quality,
and the networks of the analysis.

Detector (`DetectionScheduler`): the whole image is searched periodically; tiles of it, which show
small faces, and the image with a border, which shows a face that fills it, are searched one at a time, where a face
waits for its confirmation or where the image has changed; tiles that do not change are searched rarely. Networks of the
analysis (`TimeBudget`, `next_turn`, `most_overdue`): a token bucket of processor time, and the most overdue network and
face first.
"""

from __future__ import annotations

import math
from typing import Callable, Collection, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.faces.crops import CropJudgement, aligned_crop, judge_crop
from hri_pipeline.core.faces.detector import Region, tile_regions, wide_region
from hri_pipeline.core.observations import FaceObservation

_USUAL_STEP = 1.0 / 12.0
"""Time between two images (s) from which a share grows with it: fewer images leave more time for each."""
QUIET_FACTOR = 2.0
"""Factor on the detection period while every face is confirmed and none is lost."""
STILL_FACTOR = 10.0
"""Number of detection periods after which a tile is searched although nothing changes in it."""
_THUMB_STEP = 16
_CHANGE = 12.0
"""Mean difference (grey values) of a patch of the thumbnail that is a change, not noise."""
_CHANGED_PART = 0.02
"""Fraction of a tile that must have changed."""
_QUALITY_SIZE, _QUALITY_PERIOD, _QUALITIES_PER_IMAGE = 64, 0.5, 2
"""Side (px) of the crop whose quality is measured, period (s) for each face, and most measurements per image."""


class TimeBudget:
    """Token bucket of processor time: work may take `share` s per image on average.

    saved: capacity of the bucket, s, full at the beginning: a new person is then recognised at once, and only a crowd
    has to wait.
    """

    def __init__(self, share: float, saved: float = 0.0) -> None:
        """Raises ValueError when the share is not positive, or saved is negative."""
        if not saved >= 0.0:
            raise ValueError("{} s to be saved up; it must be 0 or more".format(saved))
        self._saved, self._owed = saved, -saved
        self.change(share)

    def change(self, share: float) -> None:
        """Set the time (s) per image. Raises ValueError when it is not positive."""
        if not share > 0.0:
            raise ValueError("a share of {} s per image; it must be above 0".format(share))
        self._share = share

    def next_image(self, step: float = 0.0) -> bool:
        """Refill for the next image, `step` s after the last; returns whether there is time for work."""
        self._owed = max(-self._saved, self._owed - self._share * max(1.0, step / _USUAL_STEP))
        return self._owed < 1e-9

    @property
    def ample(self) -> bool:
        """Whether the bucket is more than half full."""
        return self._owed < -0.5 * self._saved

    def spent(self, seconds: float) -> None:
        """Subtract the time (s) that the work took."""
        if math.isfinite(seconds):
            self._owed += max(0.0, seconds)


class DetectionScheduler:
    """Chooses the regions of the image for the detector, spreading the cost over images.

    The whole image is searched once per `period` (s), or QUIET_FACTOR periods while all faces are known; half-way
    between, one tile. The first call asks for everything.
    """

    def __init__(self, period: float, tiles: int) -> None:
        """Raises ValueError for a negative period or less than one tile."""
        if tiles < 1:
            raise ValueError("tiles must be at least 1, got %r" % (tiles,))
        self._tiles = tiles
        self.set_period(period)
        self.reset()

    def set_period(self, period: float) -> None:
        """Set the period (s), from the next detection on; raises ValueError for a negative one."""
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
        self._keep_state()

    def lose(self) -> None:
        """Take note that nothing came of the last search: the next image gets it."""
        self._next, self._whole_next, self._size, self._searched, self._thumbs = self._before

    def hurry(self, stamp: float) -> None:
        """Run the detector again one (short) period after `stamp` (s): there may be a new face."""
        self._next = min(self._next, stamp + self._step(False))

    def due(self, bgr: np.ndarray, stamp: float, waiting: Sequence[np.ndarray] = (), quiet: bool = False,
            panned: bool = False) -> List[Region]:
        """Return regions (x0, y0, x1, y1 px) to search in this image; often the empty list.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8.
        stamp
            Time of the image, s.
        waiting
            Centres (2,) px of faces that a detection would confirm.
        quiet
            Whether all faces are known and seen.
        panned
            Whether the camera turns: people come in on one side, and there is no time for tiles.
        """
        if stamp < self._next:
            return []
        self._keep_state()
        height, width = bgr.shape[:2]
        whole = (0, 0, width, height)
        tiles = tile_regions(width, height, self._tiles)
        if tiles:
            tiles.append(wide_region(width, height))
        self._next = stamp + self._step(quiet and not panned)
        thumb = _thumbnail(bgr)
        if self._size != (width, height):
            self._size = (width, height)
            self._searched, self._thumbs = [stamp] * len(tiles), [thumb] * len(tiles)
            self._whole_next = not tiles
            return [whole] + tiles
        whole_now = self._whole_next or not tiles or panned
        self._whole_next = not whole_now or not tiles
        if whole_now:
            return [whole]
        chosen = self._choose(tiles, thumb, stamp, waiting)
        if chosen is None:
            return []
        self._searched[chosen], self._thumbs[chosen] = stamp, thumb
        return [tiles[chosen]]

    def _keep_state(self) -> None:
        """Note what `lose` goes back to."""
        self._before = (self._next, self._whole_next, self._size, list(self._searched), list(self._thumbs))

    def _step(self, quiet: bool) -> float:
        period = self._period * (QUIET_FACTOR if quiet else 1.0)
        return period / (2.0 if self._tiles > 1 else 1.0)

    def _choose(self, tiles: Sequence[Region], thumb: np.ndarray, stamp: float,
                waiting: Sequence[np.ndarray]) -> Optional[int]:
        """Index of the tile to search next, None when none needs it."""
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


class CropQualities:
    """Keeps the latest picture quality of every face's crop; at most two are measured per image, the oldest first: they
    cost time."""

    def __init__(self) -> None:
        self._values: Dict[str, CropJudgement] = {}
        self._stamps: Dict[str, float] = {}

    def flaws(self, quality: float) -> Dict[str, str]:
        """Return what spoils the crops most of the faces whose templates are below a quality (0 to 1), by their ids."""
        return {face_id: judged.flaw for face_id, judged in self._values.items() if judged.template_quality < quality}

    def of_templates(self, qualities: Mapping[str, float]) -> Mapping[str, float]:
        """Return, of the qualities (0 to 1) of crops, those of their templates."""
        return {face_id: quality * self._values[face_id].exposure if face_id in self._values else quality
                for face_id, quality in qualities.items()}

    def update(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float) -> Mapping[str, float]:
        """Return the qualities (0 to 1) of the faces among `faces` that have one, the stale ones measured anew."""
        stale = [face for face in faces if stamp - self._stamps.get(face.id, -np.inf) >= _QUALITY_PERIOD]
        stale.sort(key=lambda face: self._stamps.get(face.id, -np.inf))
        size = (bgr.shape[1], bgr.shape[0])
        for face in stale[:_QUALITIES_PER_IMAGE]:
            crop = aligned_crop(bgr, face.mesh, _QUALITY_SIZE)
            self._values[face.id] = judge_crop(face.mesh, face.pose, crop, face.score, size)
            self._stamps[face.id] = stamp
        return {face.id: self._values[face.id].quality for face in faces if face.id in self._values}

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        for face_id in [face_id for face_id in self._values if face_id not in ids]:
            del self._values[face_id], self._stamps[face_id]

    def reset(self) -> None:
        """Forget all faces."""
        self._values, self._stamps = {}, {}


def next_turn(overdue: Mapping[str, float], last: str) -> str:
    """Return the name of the most overdue network; the one that ran `last` only when no other is due (1 and more)."""
    others = [name for name in overdue if name != last and overdue[name] >= 1.0]
    return max(others or overdue, key=lambda name: overdue[name])


def most_overdue(faces: Sequence[FaceObservation], last_runs: Mapping[str, float], periods: Callable[[str], float],
                 stamp: float) -> Tuple[Optional[FaceObservation], float]:
    """Return the face whose last inference (s) is longest ago in its own period (s), and how many periods; None, 0 for
    none.

    A face without an inference counts as two periods overdue.
    """
    best: Tuple[Optional[FaceObservation], float] = (None, 0.0)
    for face in faces:
        late = (stamp - last_runs[face.id]) / periods(face.id) if face.id in last_runs else 2.0
        if late > best[1]:
            best = (face, late)
    return best
