"""Face tracks: data association from one image to the next, births and deaths in seconds.

A track is predicted by optical flow, or else with constant velocity. All measurements of an image (the mesh found at
each predicted place and the ones found at new detections) are first freed of duplicates, then assigned to the tracks at
the least total cost. So when one face passes in front of another the one measurement goes to the track whose motion and
colours it continues; the hidden face is predicted, and is found again where it re-appears.

A track is one face: where its look changes suddenly, it jumps, was lost, or the picture was cut, it goes on only with
what is the same by appearance (`appearance.AppearanceMatcher`). Another face at its place gets another track.
"""

from __future__ import annotations

import math
from typing import Callable, Collection, List, Mapping, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.faces.appearance import LOOKED_AWAY, AppearanceMatcher, Verdict
from hri_pipeline.core.faces.mesh import FaceRoi
from hri_pipeline.core.faces.track import (
    SIZE_WEIGHT,
    SURE_FACE,
    VERIFIED,
    FaceMeasurement,
    FaceTrack,
    appearance_distances,
)
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.tracks import TrackLife, assign

COAST_TIME = 0.4
"""Time (s) for which a face that is not seen any more is still measured at its predicted place."""
DUPLICATE_IOU, DUPLICATE_DISTANCE = 0.45, 0.4
"""Two measurements are of the same face above this overlap, or below this distance over the larger size."""
PRESENCE_MARGIN = 0.05
"""A fresh mesh replaces a tracked one of the same face when it is surer by this presence."""
PRESENCE_TOLERANCE = 0.1
"""The whole of a face replaces a part of it when its presence is smaller by less than this."""
SPARE_TRACKS = 3
"""Tracks that may wait for their confirmation while there are as many faces as allowed."""
DISPLACE_FACTOR = 1.3
"""A new face takes the place of a known one when its priority (`priority`) is higher by this factor."""
CENTRAL_WEIGHT = 0.5
"""Fraction of its priority that a face in the corner of the image loses."""
SLOW_IMAGES, SLOWEST = 2.0, 3.0
"""A face lives for so many intervals of the images, when that is more than the death time; longest interval (s) that
counts."""
LONGEST_WAIT = 2.0
"""A face that was seen when it was last looked for, and is followed by its motion since, lives for so many death times
without another look."""
LONGEST_STALL = 5.0
"""Longest time (s) between two images, as on a busy machine, after which a face goes on that is the same by
appearance: nobody was looked for meanwhile, so nobody was lost."""
_STALL_COUNTS = 0.5
"""Death times for which a stall counts."""
_LONGEST_SEARCH = 0.25
"""Longest time (s) from image to image that counts as one without a detection: the detector takes its regions in turn,
one an image."""
_INTERVAL_MEMORY = 0.8
GATE_SEEN, GATE_LOST = 0.7, 1.5
"""Largest legal cost for a track seen in the last frame, and for one that was not."""
COLOUR_WEIGHT = 0.5
"""Cost of an appearance distance of 1, in face sizes of distance."""
_GATE_AT_MOST = GATE_LOST + COLOUR_WEIGHT
STOOD = 0.3
"""Cost up to which a face that the border cuts off is where a lost one was."""
DOUBT_TIME, TURNED_DOUBT_TIME = 0.4, 0.8
"""Time (s) for which a face may look like neither the same nor another one; the same in profile."""
PART_SIZE, PART_INSIDE = 0.6, 0.7
"""A box is a part of another one when its size is below this fraction of the other's, and this much of it lies
inside."""
SCORE_MARGIN = 0.1
"""Detection scores that differ by less count as equal."""
CUT_SHARE = 0.15
"""Part of a face outside the image from which its look says nothing: what is missing is as that of anybody."""
PART_COST = 0.6
"""Cost of continuing a track that held on to a part of a face with the whole of it."""


class FaceTracker:
    """Assigns measurements to tracks; knows nothing of images."""

    def __init__(self, birth_delay: float, death_time: float, max_faces: int, ids: Optional[IdGenerator] = None,
                 min_detections: int = 1, support_time: float = np.inf,
                 judge: Optional[AppearanceMatcher] = None,
                 doubts: Callable[[FaceTrack], bool] = lambda track: False) -> None:
        """judge: compares looks of faces; doubts: tells of which new face it must be found out first whether it is
        one; the others but ids, and the errors: see limit."""
        self._ids = ids if ids is not None else IdGenerator()
        self._judge = judge if judge is not None else AppearanceMatcher()
        self._doubts = doubts
        self.replaced = False
        self._tracks: List[FaceTrack] = []
        self._stamp: Optional[float] = None
        self._interval, self._stalled = 0.0, False
        self.limit(birth_delay, death_time, max_faces, min_detections, support_time)

    def limit(self, birth_delay: float, death_time: float, max_faces: int, min_detections: int,
              support_time: float) -> None:
        """Set the limits, of the living tracks too.

        Parameters
        ----------
        birth_delay
            Time (s) for which a face must be seen before it is confirmed.
        death_time
            Time (s) unseen after which a face is dropped.
        max_faces
            Most confirmed faces.
        min_detections
            Hit count from which a face is confirmed.
        support_time
            Time (s) without a detection after which a face that only its mesh sees is dropped.

        Raises
        ------
        ValueError
            For a negative time, or less than one face or detection.
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
        """Whether a track has lived long enough, has enough hits, is verified, and is not doubted.

        Where one detection is enough, one with a low score is, too.
        """
        return track.life.confirmed and self._has_hits(track) and (track.published or (
            track.verification >= VERIFIED and not self._doubts(track)))

    @property
    def doubted(self) -> List[FaceTrack]:
        """New tracks that have enough hits and are verified, but doubted, oldest first."""
        return [track for track in self._tracks if not track.published and self._has_hits(track)
                and track.verification >= VERIFIED and self._doubts(track)]

    def _has_hits(self, track: FaceTrack) -> bool:
        return track.hit_count > (self._min_detections - 1e-6 if self._min_detections > 1 else 0.0)

    def reset(self) -> None:
        """Drop every track. Their ids are not given again."""
        self._tracks = []
        self._stamp, self._interval, self._stalled = None, 0.0, False

    def expected(self, stamp: float) -> List[FaceTrack]:
        """The tracks to measure at their predicted place: those just seen, and those lost a moment ago."""
        return [track for track in self._tracks if not self._dead(track, stamp) and not track.replaced
                and (track.visible or stamp - track.life.last_seen <= COAST_TIME)]

    def add_detections(self, boxes: Sequence[np.ndarray], stamp: float, weights: Optional[Sequence[float]] = None,
                       scores: Optional[Sequence[float]] = None,
                       crops: Sequence[FaceRoi] = ()) -> List[FaceTrack]:
        """Count the detections at `stamp` (s) for the tracks they belong to; returns the tracks that are detected.

        A false detection is tracked by the mesh as long as its picture stays, but is detected in few images only, with
        a low score. A track that holds on to a part of a detected face does not count as detected.

        Parameters
        ----------
        boxes
            Boxes (4,) px of the detected faces.
        stamp
            Time of the image, s.
        weights
            What each detection adds to the hit count, 0 to 1; 1 by default.
        scores
            Detection scores, 0 to 1; 0 by default.
        crops
            What each detection asks for as a crop; none by default.
        """
        weights = [1.0] * len(boxes) if weights is None else weights
        scores = [0.0] * len(boxes) if scores is None else scores
        detected = []
        for track in self._tracks:
            expected = track.predicted_box(stamp)
            candidates = [(weight, score, index) for index, (weight, score) in enumerate(zip(weights, scores))
                          if is_same_or_part(boxes[index], expected)]
            same = [candidate for candidate in candidates
                    if not (is_part(expected, boxes[candidate[2]]) or is_part(boxes[candidate[2]], expected))]
            if same:
                weight, score, index = max(same)
                track.add_detection(stamp, weight, score, crops[index] if len(crops) else None)
                detected.append(track)
            elif any(score > track.score - SCORE_MARGIN for _, score, _ in candidates):
                track.add_conflict()
        return detected

    def has_room_for(self, box: np.ndarray, view: Optional[Tuple[int, int]]) -> bool:
        """Whether a new face with this box (4,) px could be tracked: there are few, or it has a higher priority than
        one of them."""
        known = [track for track in self._tracks if self.is_confirmed(track) and not track.replaced]
        if len(known) < self._max_faces:
            return True
        return priority(box, view) > DISPLACE_FACTOR * min(priority(track.measurement.box, view) for track in known)

    def update(self, measurements: Sequence[FaceMeasurement], stamp: float,
               skipped: Collection[str] = (), view: Optional[Tuple[int, int]] = None,
               cut: bool = False) -> List[FaceTrack]:
        """Associate the measurements of an image with the tracks; returns the tracks seen in it, oldest first.

        A face unseen for longer than the death time is dropped, an unconfirmed one that is missed once as well.
        `replaced` then tells whether somebody else's face was found at the place of a track.

        Parameters
        ----------
        measurements
            Faces found in the image; there may be duplicates.
        stamp
            Time of the image, s.
        skipped
            Ids of tracks that were not measured in this image: they count as seen where they are predicted, if they
            were seen before.
        view
            Width and height of the image, px, None when not known: of more than `max_faces` the large and central ones
            stay.
        cut
            Whether the picture shows something else than the last one: nothing is where it is expected.
        """
        # After a gap that is long for these images, a face counts as a new one where its appearance does not tell.
        self._tracks = [track for track in self._tracks if not self._dead(track, stamp)
                        and self._unsupported(track, stamp) <= self._support_time]
        self._stalled = self._stamp is not None and stamp - self._stamp > self._death_time
        self._note_interval(stamp)
        measurements = without_duplicates(measurements)
        rest, strangers = self._assign(measurements, stamp, skipped, cut, view)
        self.replaced = bool(strangers)
        self._tracks = [track for track in self._tracks if track.visible or self.is_confirmed(track)]
        self._begin(rest, stamp, view, strangers)
        self._reunite(stamp)
        self._keep_best(view)
        return [track for track in self._tracks if track.visible]

    def take_templates(self, templates: Mapping[str, np.ndarray], stamp: float) -> None:
        """Take templates (D,) by id, which recognition has made of the faces measured in the image of `stamp` (s)."""
        for track in self._tracks:
            if track.id in templates and track.memory is not None and track.doubtful_since is None:
                self._judge.take_template(track.memory, templates[track.id], stamp)

    def _begin(self, measurements: Sequence[FaceMeasurement], stamp: float, view: Optional[Tuple[int, int]],
               strangers: Collection[int] = ()) -> None:
        """Start tracks, of the faces with the highest priority first. strangers: `id` of measurements at the place of
        a track: a detection there was one of this face."""
        new = [m for m in measurements if m.may_start or (id(m) in strangers and m.presence >= SURE_FACE)]
        for measurement in sorted(new, key=lambda m: -priority(m.box, view)):
            count = sum(not (track.replaced or track.refused) for track in self._tracks)
            if count >= self._max_faces + SPARE_TRACKS or not self.has_room_for(measurement.box, view):
                break
            life = TrackLife(stamp, self._birth_delay, self._death_time)
            track = FaceTrack(self._ids.new(), measurement, life, stamp)
            if id(measurement) in strangers:
                track.hit_count = 1.0
            if measurement.look is not None:
                track.memory = self._judge.begin(measurement.look, stamp)
            self._tracks.append(track)

    def _reunite(self, stamp: float) -> None:
        """Continue lost tracks with faces that were not published yet and are the same by appearance, wherever they
        are."""
        lost = [track for track in self._tracks if not track.visible]
        new = [track for track in self._tracks if not track.published and track.measured_at >= stamp]
        for candidate in new if lost else ():
            look = candidate.measurement.look
            same = [track for track in lost if not track.visible and track.memory is not None and look is not None
                    and self._judge.is_found(track.memory, look)]
            if len(same) == 1:
                same[0].add_detection(stamp, score=candidate.score)
                self._continue(same[0], candidate.measurement, stamp)
                self._tracks.remove(candidate)

    def _continue(self, track: FaceTrack, measurement: FaceMeasurement, stamp: float) -> None:
        """Update a track with a measurement of its face."""
        if measurement.look is not None and track.memory is not None:
            if track.doubtful_since is None:
                self._judge.remember(track.memory, measurement.look, stamp)
            else:
                measurement.look.release()
        track.continue_with(measurement, stamp)

    def _keep_best(self, view: Optional[Tuple[int, int]]) -> None:
        """Keep the `max_faces` faces of highest priority; published ones get a bonus, or they would flicker."""
        known = [track for track in self._tracks if self.is_confirmed(track) and not track.replaced]
        known.sort(key=lambda track: -priority(track.measurement.box,
                                               view) * (DISPLACE_FACTOR if track.published else 1.0))
        surplus = {track.id for track in known[self._max_faces:]}
        self._tracks = [track for track in self._tracks if track.id not in surplus]
        for track in known[:self._max_faces]:
            track.published = True

    def _dead(self, track: FaceTrack, stamp: float) -> bool:
        """Whether a track was not seen for longer than the death time, and than images as slow as these explain; one
        that only waits for its turn has more time."""
        stamp = self._looked_until(track, stamp)
        unseen = stamp - track.life.last_seen
        waits = track.visible and self._stamp is not None and stamp - self._stamp <= self._death_time
        return (track.life.dead(stamp) and unseen > SLOW_IMAGES * self._interval
                and not (waits and unseen <= LONGEST_WAIT * self._death_time))

    def _looked_until(self, track: FaceTrack, stamp: float) -> float:
        """Return `stamp` (s), or a time soon after the last image for a face that was seen in that one, and will be
        known by its appearance: what follows is a stall."""
        if self._stamp is None or not track.visible or track.memory is None or stamp - self._stamp > LONGEST_STALL:
            return stamp
        return min(stamp, self._stamp + _STALL_COUNTS * self._death_time)

    def _unsupported(self, track: FaceTrack, stamp: float) -> float:
        """Time (s) without a detection, to be asked for once an image; of slow images the detector searches few."""
        step = 0.0 if self._stamp is None else min(max(0.0, stamp - self._stamp), _LONGEST_SEARCH)
        track.unsupported = 0.0 if track.detected_at >= stamp else track.unsupported + step
        return track.unsupported

    def _note_interval(self, stamp: float) -> None:
        """Follow the time between images: up at once, down within some of them."""
        if self._stamp is not None:
            last = min(SLOWEST, max(0.0, stamp - self._stamp))
            self._interval = max(last, _INTERVAL_MEMORY * self._interval)
        self._stamp = stamp

    def _assign(self, measurements: List[FaceMeasurement], stamp: float, skipped: Collection[str],
                cut: bool, view: Optional[Tuple[int, int]]) -> Tuple[List[FaceMeasurement], Set[int]]:
        """Continue the tracks; returns the measurements that belong to none, and the `id` of those of them which are
        somebody else's face at the place of a track."""
        pairs: List[Tuple[int, int]] = []
        strangers: Set[int] = set()
        if self._tracks and measurements:
            cost = association_costs(self._tracks, measurements, stamp)
            if cut:
                cost = self._cost_by_appearance(measurements, cost)
            leaving = np.array([view is not None and outside(one.box, view) > CUT_SHARE for one in measurements])
            seen = np.array([track.visible for track in self._tracks])
            # Who is there has such a face before who is lost, whom it continues only where that one just stood.
            stood = np.array([stamp - track.life.last_seen <= COAST_TIME <= track.life.last_seen
                              - track.life.first_seen for track in self._tracks])
            claimed = (cost[seen] < _GATE_AT_MOST).any(axis=0)
            cost[~seen[:, None] & leaving & (~stood[:, None] | claimed | (cost > STOOD))] = np.inf
            pairs, strangers = self._same_faces(cost, measurements, stamp, cut, leaving)
        continued = dict(pairs)
        for row, track in enumerate(self._tracks):
            if row in continued:
                self._continue(track, measurements[continued[row]], stamp)
            elif track.id not in skipped:
                track.miss()
                track.replaced = track.replaced or cut
        taken = set(continued.values())
        return [m for column, m in enumerate(measurements) if column not in taken], {
            id(measurements[column]) for column in strangers - taken}

    def _cost_by_appearance(self, measurements: Sequence[FaceMeasurement], cost: np.ndarray) -> np.ndarray:
        """Costs (T, N) after a cut of the picture: those of the appearance, where it can be told, wherever a face
        is."""
        cost = cost.copy()
        for row, track in enumerate(self._tracks):
            for column, measurement in enumerate(measurements):
                if track.memory is not None and measurement.look is not None:
                    distance = self._judge.distance(track.memory, measurement.look)
                    cost[row, column] = cost[row, column] if distance is None else distance
        return cost

    def _same_faces(self, cost: np.ndarray, measurements: Sequence[FaceMeasurement], stamp: float, cut: bool,
                    leaving: np.ndarray) -> Tuple[List[Tuple[int, int]], Set[int]]:
        """Assign at the least cost, without pairs that are not the same face; returns the pairs, and the columns that
        were refused. leaving: of which measurements the place alone decides, of tracks that were seen last time."""
        judged: Set[Tuple[int, int]] = set()
        strangers: Set[int] = set()
        while True:
            pairs = assign(cost, _GATE_AT_MOST)
            others = [pair for pair in pairs if pair not in judged and (
                          cut or self._stalled or not leaving[pair[1]] or not self._tracks[pair[0]].visible)
                      and not self._is_same(self._tracks[pair[0]], measurements[pair[1]], stamp, cut)]
            if not others:
                return pairs, strangers
            judged.update(pairs)
            for row, column in others:
                cost[row, column] = np.inf
                strangers.add(column)
                self._tracks[row].replaced = True

    def _is_same(self, track: FaceTrack, measurement: FaceMeasurement, stamp: float, cut: bool) -> bool:
        """Whether a measurement at the place of a track shows its face; what cannot be told yet counts for a
        moment."""
        if track.memory is None or measurement.look is None:
            return True
        lost = stamp - track.life.last_seen > COAST_TIME and not (track.visible and track.is_followed)
        doubtful = cut or track.replaced or lost or self._stalled
        if not (doubtful or track.is_unusual(measurement, stamp)):
            return True
        verdict = self._judge.verdict(track.memory, measurement.look, stamp, doubtful,
                                      track.has_colours_of(measurement))
        if verdict is Verdict.SAME:
            track.doubtful_since = None
        elif verdict is Verdict.UNSURE:
            since = track.doubtful_since = stamp if track.doubtful_since is None else track.doubtful_since
            limit = TURNED_DOUBT_TIME if measurement.look.asymmetry > LOOKED_AWAY else DOUBT_TIME
            return stamp - since < limit
        return verdict is Verdict.SAME


def without_duplicates(measurements: Sequence[FaceMeasurement]) -> List[FaceMeasurement]:
    """Keep the best measurement of each face: of a whole and its part the one that the detector is surer of, and the
    whole where it is about as sure; of the same size the one with the higher presence; of two about as sure, the
    tracked mesh."""
    kept: List[FaceMeasurement] = []
    standing = [m for m in measurements if not any(_replaces(other, m) for other in measurements)]
    for candidate in sorted(standing, key=lambda m: PRESENCE_MARGIN * m.may_start - m.presence):
        if not any(is_same_or_part(candidate.box, other.box) for other in kept):
            kept.append(candidate)
    return kept


def _replaces(one: FaceMeasurement, other: FaceMeasurement) -> bool:
    """Whether one measurement replaces another one of the same face and of another size."""
    if is_part(other.box, one.box):
        return one.score >= other.score - SCORE_MARGIN and one.presence > other.presence - PRESENCE_TOLERANCE
    if is_part(one.box, other.box):
        return one.score > other.score + SCORE_MARGIN or one.presence >= other.presence + PRESENCE_TOLERANCE
    return False


def explains(box: np.ndarray, score: float, detected: np.ndarray, detection_score: float) -> bool:
    """Whether a detection (box (4,) px and score) is the face known at `box` with `score`, or a part of it."""
    if is_part(box, detected):
        return score > detection_score + SCORE_MARGIN
    if is_part(detected, box):
        return detection_score <= score + SCORE_MARGIN
    return same_face(box, detected)


def priority(box: np.ndarray, view: Optional[Tuple[int, int]]) -> float:
    """Priority of a face with this box (4,) px: its size, px, less towards the corners of an image of view px."""
    x0, y0, x1, y1 = box.tolist()
    size = (x1 - x0 + y1 - y0) / 2.0
    if view is None:
        return size
    away = math.hypot(x0 + x1 - view[0], y0 + y1 - view[1]) / math.hypot(*view)
    return size * (1.0 - CENTRAL_WEIGHT * min(1.0, away))


def is_same_or_part(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two boxes (4,) px are of the same face, or one is of a part of the other's face."""
    return same_face(a, b) or is_part(a, b) or is_part(b, a)


def same_face(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two boxes (4,) px are of the same face: large overlap, or centres close together."""
    # Plain numbers: this runs for every pair, and arrays of four are slow.
    (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1) = a.tolist(), b.tolist()
    inner = max(0.0, min(ax1, bx1) - max(ax0, bx0)) * max(0.0, min(ay1, by1) - max(ay0, by0))
    union = max(0.0, ax1 - ax0) * max(0.0, ay1 - ay0) + max(0.0, bx1 - bx0) * max(0.0, by1 - by0) - inner
    if inner > DUPLICATE_IOU * union:
        return True
    size = max(1.0, (ax1 - ax0 + ay1 - ay0) / 2.0, (bx1 - bx0 + by1 - by0) / 2.0)
    return math.hypot(ax0 + ax1 - bx0 - bx1, ay0 + ay1 - by0 - by1) / 2.0 < DUPLICATE_DISTANCE * size


def association_costs(tracks: Sequence[FaceTrack], measurements: Sequence[FaceMeasurement],
                      stamp: float) -> np.ndarray:
    """Cost (T, N) of continuing each track with each measurement, in face sizes; infinite when it is too far away."""
    places = [measurement.place for measurement in measurements]
    centres, sizes = np.array([place[0] for place in places]), np.array([place[1] for place in places])
    own = np.array([track.size for track in tracks])[:, None]
    away = centres - np.array([track.centre(stamp) for track in tracks])[:, None]
    cost = np.hypot(away[..., 0], away[..., 1]) / own + SIZE_WEIGHT * np.abs(np.log(sizes / own))
    gate = np.array([GATE_SEEN if track.visible else GATE_LOST for track in tracks])[:, None]
    colours = COLOUR_WEIGHT * appearance_distances([track.colours for track in tracks],
                                                   [measurement.colours for measurement in measurements])
    # Without a look, the colours alone say whether it is somebody else.
    compared = np.outer([track.memory is not None for track in tracks], [m.look is not None for m in measurements])
    cost[np.where(compared, cost, cost + colours) > gate] = np.inf
    # A track may hold on to a part of a face that the detector is as sure of.
    boxes = [track.predicted_box(stamp) for track in tracks]
    cost[np.array([[track.visible and one.score >= track.score - SCORE_MARGIN and is_part(box, one.box)
                    for one in measurements] for track, box in zip(tracks, boxes)])] = PART_COST
    return cost + colours


def outside(box: np.ndarray, view: Tuple[int, int]) -> float:
    """Part (0 to 1) of a box (4,) px that is outside an image of view (width, height) px."""
    (x0, y0, x1, y1), (width, height) = box.tolist(), view
    seen = max(0.0, min(x1, width) - max(x0, 0.0)) * max(0.0, min(y1, height) - max(y0, 0.0))
    return 1.0 - seen / max(1.0, (x1 - x0) * (y1 - y0))


def is_part(box: np.ndarray, other: np.ndarray) -> bool:
    """Whether a box (4,) px is much smaller than another one and lies in it: a mouth in its face."""
    (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1) = box.tolist(), other.tolist()
    if ax1 - ax0 + ay1 - ay0 >= PART_SIZE * (bx1 - bx0 + by1 - by0):
        return False
    inner = max(0.0, min(ax1, bx1) - max(ax0, bx0)) * max(0.0, min(ay1, by1) - max(ay0, by0))
    return inner > PART_INSIDE * (ax1 - ax0) * (ay1 - ay0)
