"""Follows several bodies through the images and keeps their ids."""

from __future__ import annotations

from typing import Callable, List, Optional, Protocol, Sequence

import numpy as np

from hri_fullbody.core.sight.body_sight import Sight, covers, distinct, inside, is_sound, same_body
from hri_fullbody.core.sight.body_windows import FACE_WINDOW_SIZES, FaceBox, Window, head_box, window_from_face
from hri_fullbody.core.sight.pose_model import PoseEstimate
from hri_fullbody.core.tracking.body_appearance import describe
from hri_fullbody.core.tracking.body_association import (
    MAX_COST,
    NOSE_IN_FACE,
    association_cost,
    cost_matrix,
    nearest_face,
)
from hri_fullbody.core.tracking.body_candidates import Candidate, CandidateQueue
from hri_fullbody.core.tracking.body_schedule import PoseSchedule
from hri_fullbody.core.tracking.body_support import drop_unsupported
from hri_fullbody.core.tracking.body_track import BodyTrack
from hri_pipeline.core.assignment import assign
from hri_pipeline.core.track_life import TrackLife

Locate = Callable[[PoseEstimate], Optional[np.ndarray]]

_SECOND_OFFSET, _SECOND_SHARE = 0.12, 0.75
_OCCLUDED_SHARE = 0.15
_DESCRIBE_S = 0.4
_OVERDUE = 1.5      # times as long as others lately waited for their looks


class PoseEstimator(Protocol):
    """Anything that finds the one body in a window; see PoseModel.estimate."""

    def estimate(self, image: np.ndarray, window: Window, hidden: Sequence[np.ndarray] = (),
                 shown: Optional[np.ndarray] = None) -> PoseEstimate:
        """Return the body in `window` of `image` (H, W, 3) BGR."""


class BodyTracker:
    """Bodies by id. Call `follow` for every image, then `propose` and `try_new` as time allows.

    Every look of an image is given to the body that it fits best by place, depth, appearance and face, whoever's
    window it came from: so two people who cross keep their ids, and a window captured by a neighbour refreshes the
    neighbour while its own body waits hidden, until the death time is over. The heads of the neighbours are
    painted over: in a tight group the network otherwise takes the wrong one (of 21 people in six photographs, 17 were
    found in the window below their face without, 21 with). A body whose nose leaves its own face is sought again
    below its face.
    """

    def __init__(self, pose: PoseEstimator, new_id: Callable[[], str], birth_delay: float, death_time: float,
                 min_score: float = 0.5, max_bodies: int = 10, max_retries: int = 3,
                 schedule: Optional[PoseSchedule] = None) -> None:
        """birth_delay, death_time: s. min_score: 0 to 1. max_retries: extra windows per image for captured bodies.

        schedule: who is looked at; None for everybody in every image. Raises ValueError for values outside their ranges.
        """
        if max_bodies < 1 or max_retries < 0:
            raise ValueError("max_bodies is {} (1 and more), max_retries {} (0 and more)".format(max_bodies, max_retries))
        self._pose = pose
        self._new_id = new_id
        self._max_bodies, self._max_retries = max_bodies, max_retries
        self.schedule = schedule or PoseSchedule()
        self._candidates = CandidateQueue()
        self._locate: Locate = lambda estimate: None
        self.tracks: List[BodyTrack] = []
        self.windows = 0
        """Windows looked at since the last `follow`."""
        self.limit(birth_delay, death_time, min_score)

    def limit(self, birth_delay: float, death_time: float, min_score: float) -> None:
        """Set what the constructor takes under these names, for the bodies that are tracked, too. Raises ValueError."""
        if not 0.0 < min_score < 1.0:
            raise ValueError("min_score is {}, legal range above 0 and below 1".format(min_score))
        for life in [TrackLife(0.0, birth_delay, death_time)] + [track.life for track in self.tracks]:
            life.limit(birth_delay, death_time)
        self._birth_delay, self._death_time, self._min_score = birth_delay, death_time, min_score

    def reset(self) -> None:
        """Forget all bodies."""
        self.tracks = []
        self._candidates.clear()
        self.schedule.reset()

    def published(self, stamp: float) -> List[BodyTrack]:
        """Confirmed bodies that the last look at each has found, no longer ago than the death time, or than looks take to come round."""
        return [track for track in self.tracks if track.life.confirmed and track.visible
                and stamp - track.stamp <= max(self._death_time, _OVERDUE * track.wait)]

    def follow(self, image: np.ndarray, stamp: float, faces: Sequence[FaceBox] = (),
               locate: Optional[Locate] = None, for_new: int = 0) -> None:
        """Look for the known bodies whose turn it is in `image` (H, W, 3) BGR; hide doubles, remove the dead.

        locate: places the landmarks of an estimate in the optical frame, (33, 3) m or None.
        for_new: windows of the schedule's budget that are left to bodies that wait to be found.
        """
        self._locate = locate or (lambda estimate: None)
        self.windows = 0
        own = {track.id: self._own_face(track, faces, stamp) for track in self.tracks}
        chosen = self.schedule.choose(self.tracks, stamp, min(for_new, len(self._candidates)))
        self._retries = self._max_retries
        looks = [self._look_for(track, image, stamp, own[track.id], faces) for track in chosen]
        sights = [sight for sight in looks if sight is not None]
        near = [nearest_face(sight, faces) for sight in sights]
        self._give(distinct(sights, [face.id if face else None for face in near]), chosen, stamp, faces)
        self._hide_doubles(stamp)
        self._link_faces(faces, stamp)
        self.tracks = [track for track in self.tracks if not track.dead(stamp)]

    def propose(self, boxes: Sequence[np.ndarray], faces: Sequence[FaceBox], stamp: float) -> None:
        """Note where the person detector sees people: boxes (4,) px."""
        self.tracks = drop_unsupported(self.tracks, boxes, stamp)
        free = [box for box in boxes if not self._explained(box, stamp)]
        self._candidates.offer_boxes(free, faces)

    def try_new(self, image: np.ndarray, stamp: float, faces: Sequence[FaceBox], max_windows: int) -> None:
        """Look at no more than `max_windows` windows for bodies that are not followed yet."""
        if len(self.tracks) >= self._max_bodies and all(track.visible for track in self.tracks):
            return
        alone = [face for face in faces if self._owner(face) is None]
        self._candidates.offer_faces(alone, stamp)
        by_id = {face.id: face for face in alone}
        for _ in range(max_windows):
            candidate = self._candidates.take()
            if candidate is None:
                return
            face = by_id.get(candidate.face_id) if candidate.face_id is not None else None
            if candidate.face_id is None and self._explained(candidate.box, stamp):
                continue
            self._try(candidate, image, stamp, face, faces)

    def _explained(self, box: np.ndarray, stamp: float) -> bool:
        return any(track.visible and covers(track.expected(stamp), box) for track in self.tracks)

    def _look_for(self, track: BodyTrack, image: np.ndarray, stamp: float, face: Optional[FaceBox],
                  faces: Sequence[FaceBox]) -> Optional[Sight]:
        """Look for one body: in its window, and while it is lost to a neighbour also below its own face."""
        track.looked_at = stamp
        if face is not None and not track.visible:
            return self._look_below(track, image, stamp, face, faces, track.misses)
        sight = self._sight(image, self._look(image, track.window(face, stamp), track, face, faces, stamp),
                            track, stamp)
        if face is None or (sight is not None and _fits(track, sight, stamp, face)):
            return sight
        for attempt in range(len(FACE_WINDOW_SIZES)):
            if self._retries <= 0:
                break
            self._retries -= 1
            again = self._look_below(track, image, stamp, face, faces, attempt)
            if again is not None:
                return again
        return sight

    def _look_below(self, track: BodyTrack, image: np.ndarray, stamp: float, face: FaceBox,
                    faces: Sequence[FaceBox], attempt: int) -> Optional[Sight]:
        """Look for a body below its own face; None when it is not there."""
        side = track.next_anchor(attempt)
        estimate = self._look(image, window_from_face(face, side), track, face, faces, stamp)
        sight = self._sight(image, estimate, track, stamp)
        if sight is None or not _fits(track, sight, stamp, face):
            return None
        track.hold_anchor(side, stamp)
        return sight

    def _give(self, sights: Sequence[Sight], looked: Sequence[BodyTrack], stamp: float,
              faces: Sequence[FaceBox]) -> None:
        """Give each sight to the body that it shows; bodies that were looked for in vain are hidden."""
        found = set()
        for row, column in assign(cost_matrix(self.tracks, sights, stamp, faces), MAX_COST):
            track, sight = self.tracks[row], sights[column]
            found.add(track.id)
            track.update(sight, stamp, self._unhidden(track, sight, stamp))
        for track in looked:
            if track.id not in found:
                track.missed(stamp)

    def _unhidden(self, track: BodyTrack, sight: Sight, stamp: float) -> bool:
        """Tell whether nobody else is near enough to stand before this body."""
        box = sight.estimate.box
        return all(inside(box, other.expected(stamp).box) < _OCCLUDED_SHARE
                   for other in self.tracks if other is not track)

    def _try(self, candidate: Candidate, image: np.ndarray, stamp: float, face: Optional[FaceBox],
             faces: Sequence[FaceBox]) -> None:
        estimate = self._look(image, candidate.window(face), None, face, faces, stamp)
        verdict = candidate.judge(estimate, face, self._min_score)
        if verdict.found is not None:
            self._candidates.found(candidate)
            sight = self._sight(image, verdict.found, None, stamp)
            if sight is not None:
                self._admit(sight, stamp, face, verdict.anchor, faces)
        elif verdict.failed:
            self._candidates.give_up(candidate, stamp)
        else:
            self._candidates.put_back(candidate)

    def _admit(self, sight: Sight, stamp: float, face: Optional[FaceBox], anchor: Optional[float],
               faces: Sequence[FaceBox]) -> None:
        """Make a track of a new sight, or give it to a body that was lost a moment ago."""
        if face is None:
            face = nearest_face(sight, faces)
            if face is not None and self._owner(face) is not None:
                return
        doubles = [track for track in self.tracks if track.visible and self._doubles(track, sight, stamp, face)]
        if any(face is None or track.face_id is not None for track in doubles):
            return
        lost = [track for track in self.tracks if not track.visible or track in doubles]
        cost = cost_matrix(lost, [sight], stamp, faces)
        best = int(np.argmin(cost[:, 0])) if lost else -1
        if best >= 0 and cost[best, 0] <= MAX_COST:
            lost[best].update(sight, stamp, False)
            if face is not None:
                lost[best].link(face, stamp)
            if anchor is not None:
                lost[best].hold_anchor(anchor, stamp)
        elif len(self.tracks) < self._max_bodies and not doubles:
            life = TrackLife(stamp, self._birth_delay, self._death_time)
            self.tracks.append(BodyTrack(self._new_id(), sight, stamp, life, face, anchor))

    @staticmethod
    def _doubles(track: BodyTrack, sight: Sight, stamp: float, face: Optional[FaceBox]) -> bool:
        """Tell whether a new sight shows a body that is followed: the same landmarks, or, without a face, its trunk."""
        expected = track.expected(stamp)
        if same_body(expected, sight.estimate):
            return True
        offset = float(np.hypot(*(expected.centre - sight.estimate.centre))) / track.motion.size
        return face is None and offset < _SECOND_OFFSET and inside(sight.estimate.box, expected.box) > _SECOND_SHARE

    def _sight(self, image: np.ndarray, estimate: PoseEstimate, track: Optional[BodyTrack],
               stamp: float) -> Optional[Sight]:
        """Make a sight of an estimate from the window of `track`, None when it is no body."""
        if not is_sound(estimate, self._min_score):
            return None
        looks = describe(image, estimate) if track is None or self._wants_looks(track, stamp) else None
        return Sight(estimate, self._locate(estimate), looks, None if track is None else track.id)

    def _wants_looks(self, track: BodyTrack, stamp: float) -> bool:
        """Tell whether the appearance matters: somebody may be mistaken for this body, or it was long not learnt."""
        if stamp - track.described_at >= _DESCRIBE_S or not track.visible:
            return True
        here = track.motion.predicted_centre(stamp)
        return any(np.hypot(*(other.motion.predicted_centre(stamp) - here)) < track.motion.size + other.motion.size
                   for other in self.tracks if other is not track)

    def _look(self, image: np.ndarray, window: Window, track: Optional[BodyTrack], own: Optional[FaceBox],
              faces: Sequence[FaceBox], stamp: float) -> PoseEstimate:
        """Estimate with the neighbours' heads hidden: all faces but the own one, or those known to be others'.

        Only where there are no faces at all, or the body was lost, the heads of the other bodies are hidden: they are
        less sure, and with a human's own head hidden the network may make a second body of the trunk.
        """
        self.windows += 1
        if own is not None:
            hidden = [head_box(face) for face in faces if face.id != own.id]
        else:
            hidden = [head_box(face) for face in faces if self._owner(face) not in (None, track)]
            if not faces or (track is not None and not track.visible):
                hidden += [other.expected(stamp).head_box() for other in self.tracks
                           if other is not track and other.visible]
        return self._pose.estimate(image, window, hidden, None if own is None else own.box)

    def _owner(self, face: FaceBox) -> Optional[BodyTrack]:
        return next((track for track in self.tracks if track.face_id == face.id), None)

    @staticmethod
    def _own_face(track: BodyTrack, faces: Sequence[FaceBox], stamp: float) -> Optional[FaceBox]:
        for face in faces:
            if face.id == track.face_id:
                track.link(face, stamp)
                return face
        track.forget_lost_face(stamp)
        return None

    def _link_faces(self, faces: Sequence[FaceBox], stamp: float) -> None:
        """Give free faces to the bodies just seen whose nose lies in them."""
        tracks = [track for track in self.tracks if track.visible and track.stamp == stamp and track.face_id is None]
        free = [face for face in faces if self._owner(face) is None]
        cost = np.array([[face.distance(track.estimate.nose) for face in free] for track in tracks])
        for row, column in assign(cost.reshape(len(tracks), len(free)), NOSE_IN_FACE):
            tracks[row].link(free[column], stamp)

    def _hide_doubles(self, stamp: float) -> None:
        """Of two tracks on one human show one: that with a face, else the one just seen, else the older."""
        order = sorted((track for track in self.tracks if track.visible),
                       key=lambda track: (track.face_id is None, -track.stamp, track.life.first_seen))
        shown: List[BodyTrack] = []
        for track in order:
            if any(same_body(track.expected(stamp), other.expected(stamp)) for other in shown
                   if track.face_id is None or other.face_id is None):
                track.missed(stamp)
            else:
                shown.append(track)


def _fits(track: BodyTrack, sight: Sight, stamp: float, face: Optional[FaceBox]) -> bool:
    return association_cost(track, sight, stamp, face, False) <= MAX_COST
