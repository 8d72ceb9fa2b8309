"""Follows several bodies through the images and keeps their ids."""

from __future__ import annotations

from typing import Callable, List, Optional, Protocol, Sequence

import numpy as np

from hri_fullbody.core.body_candidates import Candidate, CandidateQueue
from hri_fullbody.core.body_track import NOSE_IN_FACE, SAME_BODY, BodyTrack, body_distance, covers
from hri_fullbody.core.body_windows import FACE_WINDOW_SIZES, FaceBox, Window, window_from_face
from hri_fullbody.core.pose_model import PoseEstimate
from hri_pipeline.core.assignment import assign
from hri_pipeline.core.track_life import TrackLife

_RESUME_DISTANCE = 0.35


class PoseEstimator(Protocol):
    """Anything that finds the one body in a window; see PoseModel.estimate."""

    def estimate(self, image: np.ndarray, window: Window, hidden: Sequence[np.ndarray] = (),
                 shown: Optional[np.ndarray] = None) -> PoseEstimate:
        """Return the body in `window` of `image` (H, W, 3) BGR."""
        ...


class BodyTracker:
    """Bodies by id. Call `follow` for every image, then `propose` and `try_new` as time allows.

    Every window is looked at with the faces of the neighbours painted over: in a tight group the network otherwise
    takes the wrong head (of 21 people in six photographs, 17 were found in the window below their face without,
    21 with). A body whose nose leaves its own face has been captured by a neighbour; it is sought again below its face.
    """

    def __init__(self, pose: PoseEstimator, new_id: Callable[[], str], birth_delay: float, death_time: float,
                 min_score: float = 0.5, max_bodies: int = 10, max_retries: int = 3) -> None:
        """birth_delay, death_time: s. min_score: 0 to 1. max_retries: extra windows per image for captured bodies.

        Raises ValueError for values outside their ranges.
        """
        if not 0.0 < min_score < 1.0:
            raise ValueError("min_score is {}, legal range above 0 and below 1".format(min_score))
        if max_bodies < 1 or max_retries < 0:
            raise ValueError("max_bodies is {} (1 and more), max_retries {} (0 and more)".format(
                max_bodies, max_retries))
        TrackLife(0.0, birth_delay, death_time)
        self._pose = pose
        self._new_id = new_id
        self._birth_delay, self._death_time = birth_delay, death_time
        self._min_score = min_score
        self._max_bodies = max_bodies
        self._max_retries = max_retries
        self._candidates = CandidateQueue()
        self.tracks: List[BodyTrack] = []

    def reset(self) -> None:
        """Forget all bodies."""
        self.tracks = []
        self._candidates.clear()

    def follow(self, image: np.ndarray, stamp: float, faces: Sequence[FaceBox] = ()) -> None:
        """Look for every known body in `image` (H, W, 3) BGR, remove doubles and the dead."""
        retries = self._max_retries
        for track in self.tracks:
            track.seen = False
            face = self._own_face(track, faces, stamp)
            estimate = self._look(image, track.window(face, stamp), track, face, faces)
            attempt = 0
            while not self._accepts(track, estimate, face, faces) and face is not None and retries > 0 \
                    and attempt < len(FACE_WINDOW_SIZES):
                side = track.next_anchor(attempt)
                estimate = self._look(image, window_from_face(face, side), track, face, faces)
                if self._accepts(track, estimate, face, faces):
                    track.hold_anchor(side, stamp)
                attempt, retries = attempt + 1, retries - 1
            if self._accepts(track, estimate, face, faces):
                track.update(estimate, stamp)
        self._link_faces(faces, stamp)
        self._remove_doubles()
        self.tracks = [track for track in self.tracks if not track.life.dead(stamp)]

    def propose(self, boxes: Sequence[np.ndarray], faces: Sequence[FaceBox]) -> None:
        """Note where the person detector sees people: boxes (4,) px."""
        free = [box for box in boxes
                if not any(track.seen and covers(track.estimate, box) for track in self.tracks)]
        self._candidates.offer_boxes(free, faces)

    def try_new(self, image: np.ndarray, stamp: float, faces: Sequence[FaceBox], max_windows: int) -> None:
        """Look at no more than `max_windows` windows for bodies that are not followed yet."""
        alone = [face for face in faces if self._owner(face) is None]
        self._candidates.offer_faces(alone, stamp)
        by_id = {face.id: face for face in alone}
        for _ in range(max_windows):
            candidate = self._candidates.take()
            if candidate is None:
                return
            face = by_id.get(candidate.face_id) if candidate.face_id is not None else None
            if candidate.face_id is None and any(
                    track.seen and covers(track.estimate, candidate.box) for track in self.tracks):
                continue
            self._try(candidate, image, stamp, face, faces)

    def _try(self, candidate: Candidate, image: np.ndarray, stamp: float, face: Optional[FaceBox],
             faces: Sequence[FaceBox]) -> None:
        estimate = self._look(image, candidate.window(face), None, face, faces)
        verdict = candidate.judge(estimate, face, self._min_score)
        if verdict.found is not None:
            self._candidates.found(candidate)
            self._admit(verdict.found, stamp, face, verdict.anchor, faces)
        elif verdict.failed:
            self._candidates.give_up(candidate, stamp)
        else:
            self._candidates.put_back(candidate)

    def _admit(self, estimate: PoseEstimate, stamp: float, face: Optional[FaceBox], anchor: Optional[float],
               faces: Sequence[FaceBox]) -> None:
        """Make a track of a new estimate, or give it to a body that was lost a moment ago."""
        if face is None:
            face = nearest_face(estimate, faces)
            if face is not None and self._owner(face) is not None:
                return
        doubles = [track for track in self.tracks if body_distance(track.estimate, estimate) < SAME_BODY]
        if any(track.seen and (face is None or track.face_id is not None) for track in doubles):
            return
        lost = [track for track in self.tracks if not track.seen or track in doubles]
        cost = np.array([[body_distance(track.estimate, estimate)] for track in lost]).reshape(len(lost), 1)
        for row, _ in assign(cost, _RESUME_DISTANCE):
            lost[row].update(estimate, stamp)
            if face is not None:
                lost[row].link(face, stamp)
            if anchor is not None:
                lost[row].hold_anchor(anchor, stamp)
            return
        if len(self.tracks) < self._max_bodies:
            life = TrackLife(stamp, self._birth_delay, self._death_time)
            self.tracks.append(BodyTrack(self._new_id(), estimate, stamp, life, face, anchor))

    def _look(self, image: np.ndarray, window: Window, track: Optional[BodyTrack], own: Optional[FaceBox],
              faces: Sequence[FaceBox]) -> PoseEstimate:
        """Estimate with the neighbours' heads hidden: all faces but the own one, or those known to be others'.

        Only where there are no faces at all the heads of the other bodies are hidden: they are less sure, and with a
        human's own head hidden the network may make a second body of the trunk.
        """
        if own is not None:
            hidden = [head_box(face) for face in faces if face.id != own.id]
        else:
            hidden = [head_box(face) for face in faces if self._owner(face) not in (None, track)]
            if not faces:
                hidden = [other.estimate.head_box() for other in self.tracks if other is not track and other.seen]
        return self._pose.estimate(image, window, hidden, None if own is None else own.box)

    def _accepts(self, track: BodyTrack, estimate: PoseEstimate, face: Optional[FaceBox],
                 faces: Sequence[FaceBox]) -> bool:
        if not track.accepts(estimate, face, self._min_score):
            return False
        if face is not None:
            return True
        other = nearest_face(estimate, faces)
        return other is None or self._owner(other) in (None, track)

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
        """Give free faces to the seen bodies whose nose lies in them."""
        tracks = [track for track in self.tracks if track.seen and track.face_id is None]
        free = [face for face in faces if self._owner(face) is None]
        cost = np.array([[face.distance(track.estimate.nose) for face in free] for track in tracks])
        for row, column in assign(cost.reshape(len(tracks), len(free)), NOSE_IN_FACE):
            tracks[row].link(free[column], stamp)

    def _remove_doubles(self) -> None:
        """Keep one of two tracks on one human: the one with a face, else the older one."""
        order = sorted((track for track in self.tracks if track.seen),
                       key=lambda track: (track.face_id is None, track.life.first_seen))
        kept: List[BodyTrack] = []
        for track in order:
            if all(body_distance(track.estimate, other.estimate) >= SAME_BODY for other in kept):
                kept.append(track)
        self.tracks = [track for track in self.tracks if not track.seen or track in kept]


def nearest_face(estimate: PoseEstimate, faces: Sequence[FaceBox]) -> Optional[FaceBox]:
    """Return the face in which the nose of an estimate lies, None when in none."""
    best = min(faces, key=lambda face: face.distance(estimate.nose), default=None)
    return best if best is not None and best.distance(estimate.nose) <= NOSE_IN_FACE else None


def head_box(face: FaceBox) -> np.ndarray:
    """Box (4,) px of the head around the box of a face's landmarks, which ends at the brows."""
    width, height = face.box[2:] - face.box[:2]
    return face.box + np.array([-0.1 * width, -0.3 * height, 0.1 * width, 0.05 * height])
