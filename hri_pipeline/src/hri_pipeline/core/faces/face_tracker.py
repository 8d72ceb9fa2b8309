"""Face tracks: who is who from one frame to the next, births and deaths in seconds.

A track predicts its place with constant velocity. Everything measured in a frame (the mesh found at each
predicted place and the ones found at fresh detections) is first freed of duplicates, then assigned to the
tracks at the least total cost. So when one face passes in front of another the one measurement goes to the
track whose motion and colours it continues; the hidden face coasts, and is picked up again where it re-appears.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Collection, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.assignment import assign
from hri_pipeline.core.faces.face_landmarks import bounding_box
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.track_life import TrackLife

COAST_TIME = 0.4
"""Time (s) for which a face that is not seen any more is still searched at its predicted place."""
GATE_SEEN, GATE_LOST = 0.7, 1.5
"""Largest legal cost for a track seen in the last frame, and for one that was not."""
SIZE_WEIGHT = 0.7
"""Cost of a change of size by a factor e, in face sizes of distance."""
DUPLICATE_IOU, DUPLICATE_DISTANCE = 0.45, 0.4
"""Two measurements are of the same face above this overlap, or below this distance over the larger size."""
PRESENCE_MARGIN = 0.05
"""A fresh mesh replaces a tracked one of the same face when it is surer by this presence."""
SLOW_IMAGES, SLOWEST = 2.0, 3.0
"""A face lives for so many intervals of the images, when that is more than the death time; longest interval (s) that counts."""
_INTERVAL_MEMORY = 0.8
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
    so it may start a track; colours: see `face_colours`, None when not looked at."""

    mesh: np.ndarray
    presence: float
    may_start: bool
    colours: Optional[np.ndarray] = None

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
        self.detections = 1
        self.detected_at = stamp
        self._velocity = np.zeros(2)
        self._colours = measurement.colours
        self._stamp = stamp
        self._centre, self._size = measurement.place

    @property
    def measured_at(self) -> float:
        """Stamp (s) of the last measurement."""
        return self._stamp

    def shift(self, stamp: float) -> np.ndarray:
        """Motion (2,) px expected between the last sight and `stamp`."""
        return self._velocity * max(0.0, stamp - self._stamp)

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
        step = stamp - self._stamp
        if step > 0.0:
            weight = 1.0 - np.exp(-step / VELOCITY_TIME)
            self._velocity = self._velocity + weight * ((centre - self._centre) / step - self._velocity)
        self._centre, self._size, self._stamp = centre, size, max(stamp, self._stamp)
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

    def support(self, stamp: float) -> None:
        """Note that the detector sees a face here, too."""
        self.detections += 1
        self.detected_at = stamp

    def miss(self) -> None:
        """Note that the face was not found in this frame."""
        self.visible = False


class FaceTracker:
    """Assigns measurements to tracks; knows nothing of images."""

    def __init__(self, birth_delay: float, death_time: float, max_faces: int, ids: Optional[IdGenerator] = None,
                 min_detections: int = 1, support_time: float = np.inf) -> None:
        """birth_delay, death_time: s. min_detections: how often the detector must have seen a face before it counts.
        support_time: s after which a face that only its mesh sees is dropped.

        Raises ValueError for a negative time, or less than one face or detection.
        """
        if max_faces < 1 or min_detections < 1:
            raise ValueError("max_faces and min_detections must be at least 1, got %r and %r" % (
                max_faces, min_detections))
        if not support_time > 0.0:
            raise ValueError("support_time must be above 0 s, got %r" % (support_time,))
        TrackLife(0.0, birth_delay, death_time)
        self._birth_delay = birth_delay
        self._death_time = death_time
        self._max_faces = max_faces
        self._min_detections = min_detections
        self._support_time = support_time
        self._ids = ids if ids is not None else IdGenerator()
        self._tracks: List[FaceTrack] = []
        self._stamp: Optional[float] = None
        self._interval = 0.0

    @property
    def tracks(self) -> List[FaceTrack]:
        """All living tracks, oldest first, candidates included."""
        return list(self._tracks)

    @property
    def ids(self) -> List[str]:
        """Ids of the confirmed living tracks, oldest first."""
        return [track.id for track in self._tracks if self.is_confirmed(track)]

    def is_confirmed(self, track: FaceTrack) -> bool:
        """Tell whether a track has lived long enough and been detected often enough to be a face."""
        return track.life.confirmed and track.detections >= self._min_detections

    def reset(self) -> None:
        """Drop every track. Their ids are not given again."""
        self._tracks = []
        self._stamp, self._interval = None, 0.0

    def expected(self, stamp: float) -> List[FaceTrack]:
        """The tracks worth a look at their predicted place: those just seen, and those lost a moment ago."""
        return [track for track in self._tracks if not self._dead(track, stamp)
                and (track.visible or stamp - track.life.last_seen <= COAST_TIME)]

    def support(self, boxes: Sequence[np.ndarray], stamp: float) -> None:
        """Take the boxes (4,) px of the detector's faces at `stamp` (s): a pattern that looked like a face once is
        followed by the mesh as long as it stays, but is detected in few images only.
        """
        for track in self._tracks:
            expected = track.predicted_box(stamp)
            if any(same_face(box, expected) for box in boxes):
                track.support(stamp)

    def update(self, measurements: Sequence[FaceMeasurement], stamp: float,
               skipped: Collection[str] = ()) -> List[FaceTrack]:
        """Take the measurements of the frame at `stamp` (s) in; returns the tracks seen in it, oldest first.

        A face unseen for longer than the death time is dropped, a candidate that is missed once as well.
        skipped: ids of tracks that were not looked for in this frame: they are taken to be where they are expected,
        and belong to those seen when they were before.
        """
        # Whoever was not looked for during a gap that is long for these images is somebody else afterwards.
        self._tracks = [track for track in self._tracks if not self._dead(track, stamp)
                        and stamp - track.detected_at <= self._support_time]
        self._note_interval(stamp)
        measurements = without_duplicates(measurements)
        rest = self._assign(measurements, stamp, skipped)
        self._tracks = [track for track in self._tracks if track.visible or self.is_confirmed(track)]
        for measurement in rest:
            if measurement.may_start and len(self._tracks) < self._max_faces:
                life = TrackLife(stamp, self._birth_delay, self._death_time)
                self._tracks.append(FaceTrack(self._ids.new(), measurement, life, stamp))
        return [track for track in self._tracks if track.visible]

    def _dead(self, track: FaceTrack, stamp: float) -> bool:
        """Tell whether a track was not seen for longer than the death time, and than images as slow as these explain."""
        return track.life.dead(stamp) and stamp - track.life.last_seen > SLOW_IMAGES * self._interval

    def _note_interval(self, stamp: float) -> None:
        """Follow the time between images: up at once, down within some of them."""
        if self._stamp is not None:
            last = min(SLOWEST, max(0.0, stamp - self._stamp))
            self._interval = max(last, _INTERVAL_MEMORY * self._interval)
        self._stamp = stamp

    def _assign(self, measurements: List[FaceMeasurement], stamp: float,
                skipped: Collection[str]) -> List[FaceMeasurement]:
        """Continue the tracks; returns the measurements that belong to none."""
        taken = set()
        pairs = []
        if self._tracks and measurements:
            cost = np.array([track.cost(measurements, stamp) for track in self._tracks])
            pairs = assign(cost, GATE_LOST + COLOUR_WEIGHT)
        continued = dict(pairs)
        for row, track in enumerate(self._tracks):
            if row in continued:
                taken.add(continued[row])
                track.continue_with(measurements[continued[row]], stamp)
            elif track.id not in skipped:
                track.miss()
        return [m for column, m in enumerate(measurements) if column not in taken]


def without_duplicates(measurements: Sequence[FaceMeasurement]) -> List[FaceMeasurement]:
    """Keep the surest measurement of each face; of two about as sure, the tracked mesh."""
    kept: List[FaceMeasurement] = []
    for candidate in sorted(measurements, key=lambda m: PRESENCE_MARGIN * m.may_start - m.presence):
        if not any(same_face(candidate.box, other.box) for other in kept):
            kept.append(candidate)
    return kept


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


def same_face(a: np.ndarray, b: np.ndarray) -> bool:
    """True when two boxes (4,) px are of the same face: large overlap, or centres close together."""
    # Plain numbers: this runs for every pair, and arrays of four are slow.
    (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1) = a.tolist(), b.tolist()
    inner = max(0.0, min(ax1, bx1) - max(ax0, bx0)) * max(0.0, min(ay1, by1) - max(ay0, by0))
    union = max(0.0, ax1 - ax0) * max(0.0, ay1 - ay0) + max(0.0, bx1 - bx0) * max(0.0, by1 - by0) - inner
    if inner > DUPLICATE_IOU * union:
        return True
    size = max(1.0, (ax1 - ax0 + ay1 - ay0) / 2.0, (bx1 - bx0 + by1 - by0) / 2.0)
    return math.hypot(ax0 + ax1 - bx0 - bx1, ay0 + ay1 - by0 - by1) / 2.0 < DUPLICATE_DISTANCE * size


def _place(box: np.ndarray) -> Tuple[np.ndarray, float]:
    """Centre (2,) px and size (mean side, px, at least 1) of a box."""
    x0, y0, x1, y1 = box.tolist()
    return np.array([(x0 + x1) / 2.0, (y0 + y1) / 2.0]), max(1.0, (x1 - x0 + y1 - y0) / 2.0)
