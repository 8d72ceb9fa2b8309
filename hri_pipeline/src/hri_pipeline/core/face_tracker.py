"""Face tracks: who is who from one frame to the next, births and deaths in seconds.

A track predicts its place with constant velocity. Everything measured in a frame (the mesh found at each
predicted place and the ones found at fresh detections) is first freed of duplicates, then assigned to the
tracks at the least total cost. So when one face passes in front of another the one measurement goes to the
track whose motion it continues; the hidden face coasts, and is picked up again where it re-appears.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.assignment import assign
from hri_pipeline.core.face_landmarks import bounding_box
from hri_pipeline.core.geometry import iou_matrix
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
VELOCITY_TIME = 0.15
"""Time constant (s) of the velocity estimate."""


@dataclass(frozen=True)
class FaceMeasurement:
    """A face found in one frame. mesh: (478, 3) px; presence: 0..1; may_start: the detector is sure of it,
    so it may start a track."""

    mesh: np.ndarray
    presence: float
    may_start: bool

    @property
    def box(self) -> np.ndarray:
        """Bounding box (4,) px of the mesh."""
        return bounding_box(self.mesh)


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
        self._stamp = stamp
        self._centre, self._size = _place(measurement.box)

    def shift(self, stamp: float) -> np.ndarray:
        """Motion (2,) px expected between the last sight and `stamp`."""
        return self._velocity * max(0.0, stamp - self._stamp)

    def predicted_box(self, stamp: float) -> np.ndarray:
        """Box (4,) px expected at `stamp`."""
        return self.measurement.box + np.tile(self.shift(stamp), 2)

    def cost(self, centres: np.ndarray, sizes: np.ndarray, stamp: float) -> np.ndarray:
        """Cost (N,) of continuing with faces at centres (N, 2) px of sizes (N,) px, in face sizes."""
        distance = np.linalg.norm(centres - (self._centre + self.shift(stamp)), axis=1) / self._size
        cost = distance + SIZE_WEIGHT * np.abs(np.log(sizes / self._size))
        cost[cost > (GATE_SEEN if self.visible else GATE_LOST)] = np.inf
        return cost

    def continue_with(self, measurement: FaceMeasurement, stamp: float) -> None:
        """Take over a measurement of this face."""
        centre, size = _place(measurement.box)
        step = stamp - self._stamp
        if step > 0.0:
            weight = 1.0 - np.exp(-step / VELOCITY_TIME)
            self._velocity = self._velocity + weight * ((centre - self._centre) / step - self._velocity)
        self._centre, self._size, self._stamp = centre, size, max(stamp, self._stamp)
        self.measurement = measurement
        self.visible = True
        self.life.seen(stamp)

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

    def expected(self, stamp: float) -> List[FaceTrack]:
        """The tracks worth a look at their predicted place: those just seen, and those lost a moment ago."""
        return [track for track in self._tracks if not track.life.dead(stamp)
                and (track.visible or stamp - track.life.last_seen <= COAST_TIME)]

    def support(self, boxes: Sequence[np.ndarray], stamp: float) -> None:
        """Take the boxes (4,) px of the detector's faces at `stamp` (s): a pattern that looked like a face once is
        followed by the mesh as long as it stays, but is detected in few images only.
        """
        for track in self._tracks:
            expected = track.predicted_box(stamp)
            if any(same_face(box, expected) for box in boxes):
                track.support(stamp)

    def update(self, measurements: Sequence[FaceMeasurement], stamp: float) -> List[FaceTrack]:
        """Take the measurements of the frame at `stamp` (s) in; returns the tracks seen in it, oldest first.

        A face unseen for longer than the death time is dropped, a candidate that is missed once as well.
        """
        # Whoever was not looked for during a long gap between images is somebody else afterwards.
        self._tracks = [track for track in self._tracks if not track.life.dead(stamp)
                        and stamp - track.detected_at <= self._support_time]
        measurements = without_duplicates(measurements)
        rest = self._assign(measurements, stamp)
        self._tracks = [track for track in self._tracks if track.visible or self.is_confirmed(track)]
        for measurement in rest:
            if measurement.may_start and len(self._tracks) < self._max_faces:
                life = TrackLife(stamp, self._birth_delay, self._death_time)
                self._tracks.append(FaceTrack(self._ids.new(), measurement, life, stamp))
        return [track for track in self._tracks if track.visible]

    def _assign(self, measurements: List[FaceMeasurement], stamp: float) -> List[FaceMeasurement]:
        """Continue the tracks; returns the measurements that belong to none."""
        taken = set()
        pairs = []
        if self._tracks and measurements:
            places = [_place(measurement.box) for measurement in measurements]
            centres = np.array([centre for centre, _ in places])
            sizes = np.array([size for _, size in places])
            cost = np.array([track.cost(centres, sizes, stamp) for track in self._tracks])
            pairs = assign(cost, GATE_LOST)
        continued = dict(pairs)
        for row, track in enumerate(self._tracks):
            if row in continued:
                taken.add(continued[row])
                track.continue_with(measurements[continued[row]], stamp)
            else:
                track.miss()
        return [m for column, m in enumerate(measurements) if column not in taken]


def without_duplicates(measurements: Sequence[FaceMeasurement]) -> List[FaceMeasurement]:
    """Keep the surest measurement of each face; of two about as sure, the tracked mesh."""
    kept: List[FaceMeasurement] = []
    for candidate in sorted(measurements, key=lambda m: PRESENCE_MARGIN * m.may_start - m.presence):
        if not any(same_face(candidate.box, other.box) for other in kept):
            kept.append(candidate)
    return kept


def same_face(a: np.ndarray, b: np.ndarray) -> bool:
    """True when two boxes (4,) px are of the same face: large overlap, or centres close together."""
    if iou_matrix(a[None], b[None])[0, 0] > DUPLICATE_IOU:
        return True
    (centre_a, size_a), (centre_b, size_b) = _place(a), _place(b)
    return bool(np.linalg.norm(centre_a - centre_b) < DUPLICATE_DISTANCE * max(size_a, size_b))


def _place(box: np.ndarray) -> Tuple[np.ndarray, float]:
    """Centre (2,) px and size (mean side, px, at least 1) of a box."""
    return (box[:2] + box[2:]) / 2.0, max(1.0, float((box[2:] - box[:2]).mean()))
