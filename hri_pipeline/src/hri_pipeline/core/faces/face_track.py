"""One tracked face: where it was seen, where it goes, what it looks like."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.faces.face_landmarks import bounding_box
from hri_pipeline.core.track_life import TrackLife

GATE_SEEN, GATE_LOST = 0.7, 1.5
"""Largest legal cost for a track seen in the last frame, and for one that was not."""
SIZE_WEIGHT = 0.7
"""Cost of a change of size by a factor e, in face sizes of distance."""
VELOCITY_TIME = 0.15
"""Time constant (s) of the velocity estimate."""
COLOUR_WEIGHT = 0.5
"""Cost of a face that looks like an altogether different one, in face sizes of distance."""
_COLOUR_GRID = (4, 5)
_COLOUR_MEMORY = 0.9
_SAME_COLOURS, _OTHER_COLOURS = 0.03, 0.12
"""Mean difference of the colours (of 1) of one face between two images, and of two people's."""


@dataclass(frozen=True)
class FaceMeasurement:
    """A face found in one frame. mesh: (478, 3) px; presence: 0..1; may_start: the detector is sure of it,
    so it may start a track; colours: see `face_colours`, None when not looked at; evidence: how much of a detection the
    one counts that it comes from, 0 to 1."""

    mesh: np.ndarray
    presence: float
    may_start: bool
    colours: Optional[np.ndarray] = None
    evidence: float = 1.0

    @cached_property
    def box(self) -> np.ndarray:
        """Bounding box (4,) px of the mesh."""
        return bounding_box(self.mesh)

    @cached_property
    def place(self) -> Tuple[np.ndarray, float]:
        """Centre (2,) px and size px of the box."""
        return _place(self.box)


class FaceTrack:
    """State of one tracked face."""

    def __init__(self, track_id: str, measurement: FaceMeasurement, life: TrackLife, stamp: float) -> None:
        self.id = track_id
        self.life = life
        self.measurement = measurement
        self.visible = True
        self.detections = measurement.evidence
        self.detected_at = stamp
        self._velocity = np.zeros(2)
        self._colours = measurement.colours
        self._stamp = self._moved_at = stamp
        self._moved = np.zeros(2)
        self._followed = False
        self._centre, self._size = measurement.place

    @property
    def measured_at(self) -> float:
        """Stamp (s) of the last measurement."""
        return self._stamp

    def shift(self, stamp: float) -> np.ndarray:
        """Motion (2,) px expected between the last sight and `stamp`."""
        return self._moved + self._velocity * max(0.0, stamp - self._moved_at)

    def move(self, motion: Optional[np.ndarray], stamp: float) -> None:
        """Take how far the picture of this face has moved, (2,) px, from the last image to the one of `stamp` (s).

        None when that is not seen: then it goes on as before.
        """
        step = stamp - self._moved_at
        if step <= 0.0:
            return
        self._followed = motion is not None and (self._followed or self._moved_at == self._stamp)
        if motion is None:
            motion = self._velocity * step
        else:
            self._steer(motion, step)
        self._moved, self._moved_at = self._moved + motion, stamp

    def _steer(self, motion: np.ndarray, step: float) -> None:
        """Follow the velocity: motion (2,) px in `step` s."""
        weight = 1.0 - math.exp(-step / VELOCITY_TIME)
        self._velocity = self._velocity + weight * (motion / step - self._velocity)

    def predicted_box(self, stamp: float) -> np.ndarray:
        """Box (4,) px expected at `stamp`."""
        return self.measurement.box + np.concatenate([self.shift(stamp)] * 2)

    def cost(self, measurements: Sequence[FaceMeasurement], stamp: float) -> np.ndarray:
        """Cost (N,) of continuing with each measurement, in face sizes; infinite when it is too far away."""
        places = [measurement.place for measurement in measurements]
        centres, sizes = np.array([place[0] for place in places]), np.array([place[1] for place in places])
        away = centres - (self._centre + self.shift(stamp))
        distance = np.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2) / self._size
        cost = distance + SIZE_WEIGHT * np.abs(np.log(sizes / self._size))
        cost[cost > (GATE_SEEN if self.visible else GATE_LOST)] = np.inf
        return cost + COLOUR_WEIGHT * np.array([self._strangeness(m.colours) for m in measurements])

    def continue_with(self, measurement: FaceMeasurement, stamp: float) -> None:
        """Take over a measurement of this face."""
        centre, size = measurement.place
        if stamp > self._stamp and not (self._followed and self._moved_at >= stamp):
            self._steer(centre - self._centre, stamp - self._stamp)
        self._centre, self._size, self._stamp = centre, size, max(stamp, self._stamp)
        self._moved, self._moved_at, self._followed = np.zeros(2), self._stamp, False
        self._learn(measurement.colours)
        self.measurement = measurement
        self.visible = True
        self.life.seen(stamp)

    def _learn(self, colours: Optional[np.ndarray]) -> None:
        if colours is None or self._colours is None:
            self._colours = colours if self._colours is None else self._colours
        else:
            self._colours = _COLOUR_MEMORY * self._colours + (1.0 - _COLOUR_MEMORY) * colours

    def _strangeness(self, colours: Optional[np.ndarray]) -> float:
        """0 for colours as usual, 1 for those of somebody else."""
        if colours is None or self._colours is None:
            return 0.0
        difference = float(np.abs(colours - self._colours).sum()) / colours.size
        return min(1.0, max(0.0, (difference - _SAME_COLOURS) / (_OTHER_COLOURS - _SAME_COLOURS)))

    def support(self, stamp: float, evidence: float = 1.0) -> None:
        """Note that the detector sees a face here, too. evidence: how sure it is, 0 to 1."""
        self.detections += evidence
        self.detected_at = stamp

    def miss(self) -> None:
        """Note that the face was not found in this frame."""
        self.visible = False


def face_colours(bgr: np.ndarray, box: np.ndarray) -> Optional[np.ndarray]:
    """Return the colours of a face, (5, 4, 3) 0 to 1, coarse; None when the box (4,) px lies outside the image."""
    height, width = bgr.shape[:2]
    x0, y0, x1, y1 = (int(min(max(value, 0.0), limit)) for value, limit in zip(
        box.tolist(), (width, height, width, height)))
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    # Every fourth pixel of a large face is enough.
    step = max(1, min(x1 - x0, y1 - y0) // 24)
    patch = np.ascontiguousarray(bgr[y0:y1:step, x0:x1:step])
    return cv2.resize(patch, _COLOUR_GRID, interpolation=cv2.INTER_AREA).astype(np.float64) / 255.0


def _place(box: np.ndarray) -> Tuple[np.ndarray, float]:
    """Centre (2,) px and size (mean side, px, at least 1) of a box."""
    x0, y0, x1, y1 = box.tolist()
    return np.array([(x0 + x1) / 2.0, (y0 + y1) / 2.0]), max(1.0, (x1 - x0 + y1 - y0) / 2.0)
