"""Face tracks: who is who from one frame to the next, births and deaths in seconds.

A track goes where its picture has moved, or on with constant velocity. Everything measured in a frame (the mesh found at
each predicted place and the ones found at fresh detections) is first freed of duplicates, then assigned to the
tracks at the least total cost. So when one face passes in front of another the one measurement goes to the
track whose motion and colours it continues; the hidden face coasts, and is picked up again where it re-appears.
"""

from __future__ import annotations

import math
from typing import Collection, List, Optional, Sequence

import numpy as np

from hri_pipeline.core.assignment import assign
from hri_pipeline.core.faces.face_track import COLOUR_WEIGHT, GATE_LOST, FaceMeasurement, FaceTrack
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.track_life import TrackLife

COAST_TIME = 0.4
"""Time (s) for which a face that is not seen any more is still searched at its predicted place."""
DUPLICATE_IOU, DUPLICATE_DISTANCE = 0.45, 0.4
"""Two measurements are of the same face above this overlap, or below this distance over the larger size."""
PRESENCE_MARGIN = 0.05
"""A fresh mesh replaces a tracked one of the same face when it is surer by this presence."""
SLOW_IMAGES, SLOWEST = 2.0, 3.0
"""A face lives for so many intervals of the images, when that is more than the death time; longest interval (s) that counts."""
_INTERVAL_MEMORY = 0.8


class FaceTracker:
    """Assigns measurements to tracks; knows nothing of images."""

    def __init__(self, birth_delay: float, death_time: float, max_faces: int, ids: Optional[IdGenerator] = None,
                 min_detections: int = 1, support_time: float = np.inf) -> None:
        """All but ids, and the errors: see limit."""
        self._ids = ids if ids is not None else IdGenerator()
        self._tracks: List[FaceTrack] = []
        self._stamp: Optional[float] = None
        self._interval = 0.0
        self.limit(birth_delay, death_time, max_faces, min_detections, support_time)

    def limit(self, birth_delay: float, death_time: float, max_faces: int, min_detections: int, support_time: float) -> None:
        """Set the limits, of the living tracks too. birth_delay, death_time: s. min_detections: how often the detector must
        have seen a face before it counts. support_time: s after which a face that only its mesh sees is dropped.

        Raises ValueError for a negative time, or less than one face or detection.
        """
        if max_faces < 1 or min_detections < 1:
            raise ValueError("max_faces and min_detections must be at least 1, got %r and %r" % (
                max_faces, min_detections))
        if not support_time > 0.0:
            raise ValueError("support_time must be above 0 s, got %r" % (support_time,))
        for life in [TrackLife(0.0, birth_delay, death_time)] + [track.life for track in self._tracks]:
            life.limit(birth_delay, death_time)
        self._birth_delay, self._death_time = birth_delay, death_time
        self._max_faces, self._min_detections, self._support_time = max_faces, min_detections, support_time

    @property
    def tracks(self) -> List[FaceTrack]:
        """All living tracks, oldest first, candidates included."""
        return list(self._tracks)

    @property
    def ids(self) -> List[str]:
        """Ids of the confirmed living tracks, oldest first."""
        return [track.id for track in self._tracks if self.is_confirmed(track)]

    def is_confirmed(self, track: FaceTrack) -> bool:
        """Tell whether a track has lived long enough and been detected often enough to be a face.

        Where one detection is enough, a weak one is, too.
        """
        needed = self._min_detections - 1e-6 if self._min_detections > 1 else 0.0
        return track.life.confirmed and track.detections > needed

    def reset(self) -> None:
        """Drop every track. Their ids are not given again."""
        self._tracks = []
        self._stamp, self._interval = None, 0.0

    def expected(self, stamp: float) -> List[FaceTrack]:
        """The tracks worth a look at their predicted place: those just seen, and those lost a moment ago."""
        return [track for track in self._tracks if not self._dead(track, stamp)
                and (track.visible or stamp - track.life.last_seen <= COAST_TIME)]

    def support(self, boxes: Sequence[np.ndarray], stamp: float, evidence: Optional[Sequence[float]] = None) -> None:
        """Take the boxes (4,) px of the detector's faces at `stamp` (s): a pattern that looked like a face once is
        followed by the mesh as long as it stays, but is detected in few images only, and not surely.

        evidence: how much of a detection each box counts, 0 to 1; None for 1.
        """
        counts = [1.0] * len(boxes) if evidence is None else evidence
        for track in self._tracks:
            expected = track.predicted_box(stamp)
            best = max((count for box, count in zip(boxes, counts) if same_face(box, expected)), default=None)
            if best is not None:
                track.support(stamp, best)

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
