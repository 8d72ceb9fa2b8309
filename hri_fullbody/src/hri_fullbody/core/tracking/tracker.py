"""Multi-body tracker: follows several bodies through the images and keeps their ids."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Callable, Container, Dict, List, Mapping, Optional, Sequence, Set, Tuple, cast

import numpy as np

from hri_fullbody.core.detection.pose_estimator import (
    SAME_BODY,
    BatchPoseEstimator,
    PoseDetection,
    PoseEstimate,
    PoseEstimator,
    PoseWindow,
    body_distance,
    covers,
    distinct,
    inside,
    is_sound,
    one_human,
    same_body,
)
from hri_fullbody.core.detection.windows import FACE_WINDOW_SIZES, FaceBox, Window, head_box, window_from_face
from hri_fullbody.core.tracking.association import (
    MAX_COST,
    confirm_by_boxes,
    cost_matrix,
    drop_unconfirmed,
    end_rivalries,
    fits,
    judge_mistaken,
    link_faces,
    nearest_face,
    waiting_in,
)
from hri_fullbody.core.tracking.candidates import (
    PROMISING,
    BodyCandidate,
    CandidateQueue,
    RefusedPlaces,
    WindowResult,
    beside,
)
from hri_fullbody.core.tracking.reidentification import describe
from hri_fullbody.core.tracking.track import BodyTrack
from hri_pipeline.core.error_log import ItemGuard
from hri_pipeline.core.ignored_regions import IgnoredRegions
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.images import PictureCuts
from hri_pipeline.core.picture_jumps import Jump
from hri_pipeline.core.scheduler import InferenceScheduler, Request
from hri_pipeline.core.tracks import TrackLife, assign

Locate = Callable[[PoseEstimate], Optional[np.ndarray]]
IsHuman = Callable[[np.ndarray, np.ndarray], bool]

_SECOND_OFFSET, _SECOND_SHARE = 0.12, 0.75
_OCCLUDED_SHARE = 0.15
_ONE_PLACE = 0.5        # of the smaller box of two bodies of which one began where the other was hidden
_DESCRIBE_S = 0.4
# Sizes of the mirrored windows, in that of its own, in which a body must be seen of which the detector is unsure: of 37
# in photographs of people that were cut, covered, darkened or shrunk 35 are, of 11 in a flag none.
_MIRRORED_WINDOWS = (1.0, 0.85, 1.18)
_LEAST_INSIDE = 0.25    # of the box of the landmarks that are seen: what lies outside the image is made up
_STALE_S = 0.5          # after a cut of the picture, faces of before it may still be told for so long
_LONGEST_BLANK = 0.3    # s of images of nothing, after which place alone tells too little of who is who in a crowd
SLOW_S = 0.25
"""Images that come more slowly (s) need not take the same time each, and who is there is found in few of them."""
_OVERDUE = 1.5      # times as long as others lately waited for their inference


class BodyTracker:
    """Bodies by id. Call `follow` for every image, then `propose` and `try_new` as time allows.

    Each detection of an image is assigned to the body that it fits best by place, depth, appearance and face, whatever
    window it came from: two people who cross keep their ids, and a detection of a neighbour in the window of a hidden
    body updates the neighbour, while the hidden body is kept until its death time. The heads of the neighbours are
    painted over: in a tight group the network otherwise detects the wrong person (of 21 people in six photographs, 17
    were found in the window below their face without it, 21 with it). A body whose nose leaves its own face is searched
    again below its face.
    """

    def __init__(self, pose: PoseEstimator, new_id: Callable[[], str], birth_delay: float, death_time: float,
                 min_score: float = 0.5, max_bodies: int = 10, max_retries: int = 3,
                 schedule: Optional[InferenceScheduler] = None, guard: Optional[ItemGuard] = None,
                 ignored: Optional[IgnoredRegions] = None, is_human: Optional[IsHuman] = None) -> None:
        """birth_delay, death_time: s. min_score: 0 to 1. max_retries: extra windows per image for captured bodies.

        schedule: which bodies get an inference; None: all in every image. guard: counts inferences that raised; each
        costs one body only. ignored: where no body begins. is_human: looks again at a person's box of an image, if
        no human is known beside it, before a body without a face begins. Raises ValueError for values outside their
        ranges.
        """
        if max_bodies < 1 or max_retries < 0:
            raise ValueError("max_bodies is {} (1 and more), max_retries {} (0 and more)".format(
                max_bodies, max_retries))
        self._pose = pose
        self._new_id = new_id
        self._max_bodies, self._max_retries = max_bodies, max_retries
        self.schedule = schedule or InferenceScheduler(batches=False)
        self._guard = guard or ItemGuard()
        self._ignored = ignored or IgnoredRegions()
        self._is_human = is_human or (lambda image, box: True)
        self._candidates = CandidateQueue()
        self._refused = RefusedPlaces()
        self._prepared: Dict[str, Tuple[Window, PoseEstimate]] = {}
        self._cuts = PictureCuts(jumps=True)
        self._shown_faces: Set[str] = set()
        self._stale_faces: Set[str] = set()
        self._stale_until = self._followed_at = self._jumped_at = -math.inf
        self._carried = False
        self._locate: Locate = lambda estimate: None
        self.tracks: List[BodyTrack] = []
        self.windows = 0
        """Inferences since the last `follow`."""
        self.jump: Optional[Jump] = None    # of the last image, with which all that is known has gone
        self.limit(birth_delay, death_time, min_score)

    def limit(self, birth_delay: float, death_time: float, min_score: float) -> None:
        """Set what the constructor takes under these names, for the bodies that are tracked, too. Raises ValueError."""
        if not 0.0 < min_score < 1.0:
            raise ValueError("min_score is {}, legal range above 0 and below 1".format(min_score))
        for life in [TrackLife(0.0, birth_delay, death_time)] + [track.life for track in self.tracks]:
            life.limit(birth_delay, death_time)
        self._birth_delay, self._death_time, self._min_score = birth_delay, death_time, min_score

    def turn(self, rotation: ImageRotation) -> None:
        """Turn what is known of earlier images."""
        self._ignored.turn(rotation.quarters)
        self._cuts.turn(rotation)
        self._candidates.clear()
        self._refused.clear()
        for track in self.tracks:
            track.turn(rotation)

    def carry(self, moved: Callable[[np.ndarray], np.ndarray]) -> None:
        """Move all bodies with the image, before `follow`: the camera has turned since the image before.

        moved: where points (N, 2) px of that are in this one.
        """
        self._carried = True
        for track in self.tracks:
            track.carry(moved(track.place[None])[0] - track.place)

    def _jump(self, jump: Jump, stamp: float) -> None:
        """Move all bodies with a picture that has jumped, and look at each in the image of `stamp` (s)."""
        self._candidates.clear()
        self._refused.clear()
        self._jumped_at, self.jump = stamp, jump
        for track in self.tracks:
            track.jump(jump)
            self.schedule.renew(track.id)

    def boxes(self) -> List[np.ndarray]:
        """Return the boxes (4,) px of those who are seen, where they were in the last image."""
        return [track.expected(self._followed_at).box for track in self.tracks if track.visible]

    def reset(self) -> None:
        """Forget all bodies."""
        self.tracks = []
        self._candidates.clear()
        self._refused.clear()
        self._cuts.reset()
        self._stale_until = self._followed_at = self._jumped_at = -math.inf
        self.schedule.reset()

    def published(self, stamp: float) -> List[BodyTrack]:
        """Confirmed bodies that their last inference found (after a gap, the last two), not longer ago than the death
        time or their turn takes; of slow images also those that only it missed. None that may lie on a hidden
        neighbour, and none where the image is passed over (`is_blank`)."""
        if self.is_blank:
            return []
        return [track for track in self.tracks if track.confirmed and not track.mistaken
                and (track.kept or track.visible and not track.returning)
                and stamp - (track.inferred_at if track.kept else track.stamp) <= max(
                    self._death_time, _OVERDUE * track.wait)]

    def follow(self, image: np.ndarray, stamp: float, faces: Sequence[FaceBox] = (),
               locate: Optional[Locate] = None, for_new: int = 0) -> None:
        """Update the known bodies whose turn it is from `image` (H, W, 3) BGR, remove the dead.

        locate: places the landmarks of an estimate in the optical frame, (33, 3) m or None.
        for_new: windows of the schedule's budget that are left for new bodies.
        """
        self._locate = locate or (lambda estimate: None)
        self.windows, self.jump = 0, None
        if self._cuts.update(image, stamp):
            for track in self.tracks:
                track.cut_off(stamp)
            self._stale_faces, self._stale_until = self._shown_faces, stamp + _STALE_S
        elif self._cuts.jump is not None and not self._carried:
            self._jump(self._cuts.jump, stamp)
        self._carried = False
        if self._cuts.blank:    # the network makes bodies of noise, which drift to a neighbour
            if stamp - self._cuts.shown_at > _LONGEST_BLANK:
                for track in self.tracks:
                    track.darken(stamp)
            self._judge_hidden(stamp, image.shape[1], ())
            self.tracks = [track for track in self.tracks if not track.dead(stamp)]
            return
        self._shown_faces = {face.id for face in faces}
        faces = self._fresh(faces, stamp)
        own = {track.id: self._own_face(track, faces, stamp) for track in self.tracks}
        chosen = self._choose(stamp, min(for_new, len(self._candidates)))
        self._retries = self._max_retries
        with self.schedule.measure() as count:
            self._guard.attempt("batch of windows", self._infer_together, chosen, image, stamp, own, faces)
            results = self._guard.each(
                "body", lambda track: self._infer_track(track, image, stamp, own[track.id], faces), chosen)
            count(self.windows)
        detections = [detection for detection in results if detection is not None]
        near = [nearest_face(detection, faces) for detection in detections]
        doubles = self._associate(distinct(detections, [face.id if face else None for face in near]), chosen, stamp,
                                  faces)
        link_faces(self.tracks, faces, stamp)
        self._judge_hidden(stamp, image.shape[1], doubles)
        judge_mistaken(self.tracks, stamp, faces)
        self.tracks = [track for track in self.tracks if not track.dead(stamp)]

    def _judge_hidden(self, stamp: float, width: float, doubles: Container[str]) -> None:
        """Note of the bodies that are not seen in an image of `width` px who is hidden, and who is kept all the same.

        doubles: who has yielded to another body in this image.
        """
        slow = SLOW_S < stamp - self._followed_at < math.inf
        self._followed_at = stamp
        for track in self.tracks:
            if not track.visible:
                track.judge_hidden(stamp, width, self._cuts.blank)
                if track.inferred_at == stamp:
                    track.kept = slow and track.hidden and track.misses == 1 and track.id not in doubles

    def _choose(self, stamp: float, reserved: int) -> List[BodyTrack]:
        """The bodies whose turn it is, most urgent first; reserved: see InferenceScheduler.choose."""
        waiting = {track.id: track for track in self.tracks if stamp > track.inferred_at}
        largest = max([1.0] + [track.motion.size for track in self.tracks])
        chosen = self.schedule.choose(
            [Request(name, track.urgency(largest)) for name, track in waiting.items()], stamp, reserved)
        wait = self.schedule.wait(len(self.tracks))
        for track in self.tracks:
            track.wait = wait
        return [waiting[name] for name in chosen]

    @property
    def is_blank(self) -> bool:
        """Whether the last image was passed over: it showed nothing, or a part of it was missing."""
        return self._cuts.blank

    @property
    def awaits_detector(self) -> bool:
        """Whether there is a body for which the person detector was not asked yet."""
        return any(track.box_confirmed is None for track in self.tracks)

    def awaits_return(self, stamp: float) -> bool:
        """Tell whether there is a hidden body that may come back any time."""
        return any(track.waits(stamp) for track in self.tracks)

    def propose(self, boxes: Sequence[np.ndarray], faces: Sequence[FaceBox], stamp: float,
                faint: Optional[Sequence[np.ndarray]] = None) -> None:
        """Note where the person detector sees people: boxes (4,) px. faint: these and less sure ones."""
        if self._cuts.blank:
            return
        faces = self._fresh(faces, stamp)
        confirm_by_boxes(self.tracks, boxes if faint is None else faint, stamp,
                         {face.id: face.pose for face in faces if face.pose is not None})
        end_rivalries(self.tracks, boxes, stamp)
        for track in self.tracks:
            # In this image nobody is where it would be.
            track.kept &= any(covers(track.expected(stamp), box) for box in (boxes if faint is None else faint))
        kept = drop_unconfirmed(self.tracks, boxes, stamp)
        for track in self.tracks:
            if track.box_confirmed:
                self._candidates.found(track.face_id)
            elif track not in kept:
                self._candidates.give_up(track.face_id, stamp)
        self.tracks = kept
        free = [box for box in boxes if not self._has_track(box, stamp)]
        others = [*boxes, *(track.expected(stamp).box for track in kept if track.visible),
                  *(face.box for face in faces)]
        unsure = [box for box in faint or () if not self._has_track(box, stamp)]
        self._candidates.offer_boxes(free, faces, others, stamp, unsure)

    def try_new(self, image: np.ndarray, stamp: float, faces: Sequence[FaceBox], max_windows: int) -> int:
        """Run at most `max_windows` inferences for bodies that are not tracked yet; return how many were to be run."""
        if self._cuts.blank or len(self.tracks) >= self._max_bodies and all(track.visible for track in self.tracks):
            return 0
        faces = self._fresh(faces, stamp)
        alone = [face for face in faces if self._owner(face) is None]
        self._candidates.offer_faces(alone, stamp)
        by_id = {face.id: face for face in alone}
        tried = 0       # places that stay refused delay nobody
        while tried < max_windows:
            candidate = self._candidates.take()
            if candidate is None:
                break
            face = by_id.get(candidate.face_id) if candidate.face_id is not None else None
            has_track = candidate.box is not None and self._has_track(candidate.box, stamp)
            if candidate.box is not None and not has_track and self._stays_refused(
                    candidate, candidate.box, image, stamp):
                continue
            tried += 1
            if has_track:
                continue
            box = candidate.box if face is None else face.box
            if box is not None and self._ignored.contain(box, (image.shape[1], image.shape[0])):
                self._candidates.give_up(candidate.face_id, stamp)
                continue
            if not self._guard.attempt("place of a new body", self._try_candidate, candidate, image, stamp, face,
                                       faces):
                self._candidates.give_up(candidate.face_id, stamp)
        return tried

    def _fresh(self, faces: Sequence[FaceBox], stamp: float) -> Sequence[FaceBox]:
        """The faces without those that may be of the picture before a cut or a jump."""
        faces = [face for face in faces if face.stamp is None or face.stamp >= self._jumped_at]
        return faces if stamp >= self._stale_until else [face for face in faces if face.id not in self._stale_faces]

    def _has_track(self, box: np.ndarray, stamp: float) -> bool:
        return any(track.visible and covers(track.expected(stamp), box) for track in self.tracks)

    def _infer_together(self, chosen: Sequence[BodyTrack], image: np.ndarray, stamp: float,
                        own: Dict[str, Optional[FaceBox]], faces: Sequence[FaceBox]) -> None:
        """Run the network once for the first windows of all chosen bodies, where that is faster."""
        self._prepared = {}
        if not getattr(self._pose, "takes_batches", False) or len(chosen) < 2:
            return
        windows = {track.id: self._pose_window(track.window(own[track.id], stamp), track, own[track.id], faces, stamp)
                   for track in chosen if own[track.id] is None or track.visible}
        estimates = cast(BatchPoseEstimator, self._pose).estimate_all(image, list(windows.values()))
        self._prepared = {name: (one.window, estimate)
                          for (name, one), estimate in zip(windows.items(), estimates)}

    def _infer_track(self, track: BodyTrack, image: np.ndarray, stamp: float, face: Optional[FaceBox],
                     faces: Sequence[FaceBox]) -> Optional[PoseDetection]:
        """Detect one body in its window; while a neighbour occludes it also below its own face."""
        track.inferred_at = stamp
        if face is not None and not track.visible:
            return self._infer_below_face(track, image, stamp, face, faces, track.misses)
        detection = self._make_detection(image,
                                         self._infer(image, track.window(face, stamp), track, face, faces, stamp),
                                         track, stamp)
        if face is None or (detection is not None and fits(track, detection, stamp, face)):
            return detection
        for attempt in range(len(FACE_WINDOW_SIZES)):
            if self._retries <= 0:
                break
            self._retries -= 1
            again = self._infer_below_face(track, image, stamp, face, faces, attempt)
            if again is not None:
                return again
        return detection

    def _infer_below_face(self, track: BodyTrack, image: np.ndarray, stamp: float, face: FaceBox,
                          faces: Sequence[FaceBox], attempt: int) -> Optional[PoseDetection]:
        """Detect a body below its own face; None when it is not there."""
        side = track.next_anchor(attempt)
        estimate = self._infer(image, window_from_face(face, side), track, face, faces, stamp)
        detection = self._make_detection(image, estimate, track, stamp)
        if detection is None or not fits(track, detection, stamp, face):
            return None
        track.hold_anchor(side, stamp)
        return detection

    def _associate(self, detections: Sequence[PoseDetection], chosen: Sequence[BodyTrack], stamp: float,
                   faces: Sequence[FaceBox]) -> Set[str]:
        """Assign each detection to a track; chosen tracks without one are marked as missed. Returns the doubles."""
        pairs = {self.tracks[row].id: detections[column]
                 for row, column in assign(cost_matrix(self.tracks, detections, stamp, faces), MAX_COST)}
        missed = {track.id for track in chosen if track.id not in pairs}
        doubles = self._doubles({name: detection.estimate for name, detection in pairs.items()}, missed, stamp, faces)
        for track in self.tracks:
            if track.id in pairs and track.id not in doubles:
                self._found(track, pairs[track.id], stamp, self._unhidden(track, pairs[track.id], stamp))
            elif track in chosen or track.id in doubles:
                track.missed(stamp)
        return doubles

    def _found(self, track: BodyTrack, detection: PoseDetection, stamp: float, unhidden: bool) -> None:
        """Give a detection to a body; one that was not seen before is looked at again in the next image: where it goes
        is not known, and its turn is that of a hidden one, up to a second away."""
        if not track.visible:
            self.schedule.renew(track.id)
        track.update(detection, stamp, unhidden)

    def _doubles(self, seen: Mapping[str, PoseEstimate], missed: Container[str], stamp: float,
                 faces: Sequence[FaceBox]) -> Set[str]:
        """Ids of the bodies that are told from the same part of the image as another one, and yield to it.

        seen: estimates of this image by id; other visible bodies are where they are expected. missed: ids of those that
        were looked for in this image in vain. Of two one stays: that with a face in this image, else that which was not
        missed, else the less weak (see `BodyTrack.weakness`). Two faces are two humans. Who began where another one was
        hidden yields once that one is there again.
        """
        shown_faces = {face.id for face in faces}
        order = sorted((track for track in self.tracks if track.visible or track.id in seen),
                       key=lambda track: (track.face_id not in shown_faces, track.id in missed,
                                          *track.weakness(track.id in seen, stamp)))
        shown: Dict[str, PoseEstimate] = {}
        for track in order:
            estimate = seen.get(track.id, track.expected(stamp))
            if track.face_id in shown_faces or not any(one_human(estimate, other) for other in shown.values()):
                shown[track.id] = estimate
        back = {track.id for track in order if not track.has_gap(stamp)}
        return {track.id for track in order if track.id not in shown or (
            track.rival in shown and track.rival in back and _at_one_place(shown[track.id], shown[track.rival]))}

    def _unhidden(self, track: BodyTrack, detection: PoseDetection, stamp: float) -> bool:
        """Tell whether nobody else is near enough to stand before this body."""
        box = detection.estimate.box
        return all(inside(box, other.expected(stamp).box) < _OCCLUDED_SHARE
                   for other in self.tracks if other is not track)

    def _try_candidate(self, candidate: BodyCandidate, image: np.ndarray, stamp: float, face: Optional[FaceBox],
                       faces: Sequence[FaceBox]) -> None:
        estimate = self._infer(image, candidate.window(face), None, face, faces, stamp)
        if face is None and candidate.first is None and self._returns(image, estimate, stamp, faces):
            return
        result = candidate.judge(estimate, face, self._min_score)
        if result.found is not None and not self._seen_again(candidate, image, result.found, faces, stamp):
            assert candidate.box is not None
            self._refused.add(image, candidate.box)
            if candidate.in_group and not candidate.looked:
                # Of those beside one may be known as a human by then.
                self._candidates.put_last(replace(candidate, looked=True))
                return
            result = WindowResult(failed=True)
        if result.found is not None:
            detection = self._make_detection(image, result.found, None, stamp)
            if detection is not None:
                self._start_track(detection, stamp, face, result.anchor, faces, candidate.box)
        elif result.failed:
            self._candidates.give_up(candidate.face_id, stamp, candidate.box if candidate.alone else None)
        else:
            self._candidates.put_back(candidate)

    def _seen_again(self, candidate: BodyCandidate, image: np.ndarray, estimate: PoseEstimate,
                    faces: Sequence[FaceBox], stamp: float) -> bool:
        """Tell whether a person's box shows a human in further looks: of the detector where no human is known beside
        it, and where it was unsure of the pose network."""
        if candidate.box is None:
            return True
        if not self._accompanied(candidate, candidate.box, stamp):
            if self._refused.contain(image, candidate.box):
                return False
            self.windows += 1
            if not self._is_human(image, candidate.box):
                return False
        return not candidate.unsure or self._mirrored_too(image, estimate, faces, stamp)

    def _accompanied(self, candidate: BodyCandidate, box: np.ndarray, stamp: float) -> bool:
        """Tell whether a human of about the size is known beside a person's box: the look from near by shows both."""
        return candidate.accompanied or any(track.visible and beside(box, track.expected(stamp).box)
                                            for track in self.tracks)

    def _stays_refused(self, candidate: BodyCandidate, box: np.ndarray, image: np.ndarray, stamp: float) -> bool:
        """Tell whether a person's box was refused and nothing has changed; who is hidden may come back there."""
        return (all(track.visible for track in self.tracks) and not self._accompanied(candidate, box, stamp)
                and self._refused.contain(image, box))

    def _mirrored_too(self, image: np.ndarray, estimate: PoseEstimate, faces: Sequence[FaceBox], stamp: float) -> bool:
        """Tell whether the network sees a body at the same place in mirrored windows of several sizes: of a human it
        does, of a flag or an animal it makes something else in one of them."""
        window = estimate.next_window()
        for part in _MIRRORED_WINDOWS:
            self.windows += 1
            one = self._pose_window(replace(window, size=part * window.size), None, None, faces, stamp)
            again = self._pose.estimate(image, one.window, one.hidden, mirrored=True)
            if not is_sound(again, PROMISING) or body_distance(estimate, again) >= 2.0 * SAME_BODY:
                return False
        return True

    def _returns(self, image: np.ndarray, estimate: PoseEstimate, stamp: float, faces: Sequence[FaceBox]) -> bool:
        """Give what a person's box shows at once to the hidden body that it fits; tell whether there is one."""
        if all(track.visible for track in self.tracks):
            return False
        detection = self._make_detection(image, estimate, None, stamp)
        if detection is None or nearest_face(detection, faces) is not None or any(
                track.visible and one_human(track.expected(stamp), estimate) for track in self.tracks):
            return False
        costs = cost_matrix(self.tracks, [detection], stamp, faces)[:, 0]
        best = int(np.argmin(costs))
        if self.tracks[best].visible or costs[best] > MAX_COST:
            return False
        self._found(self.tracks[best], detection, stamp, False)
        self.tracks[best].box_confirmed = True
        return True

    def _start_track(self, detection: PoseDetection, stamp: float, face: Optional[FaceBox], anchor: Optional[float],
                     faces: Sequence[FaceBox], box: Optional[np.ndarray] = None) -> None:
        """Start a track with a new detection, or give it to a body lost a moment ago.

        face None: it came from a person's box (4,) px.
        """
        boxed = face is None
        if face is None:
            face = nearest_face(detection, faces)
            if face is not None and self._owner(face) is not None:
                return
        doubles = [track for track in self.tracks if track.visible
                   and self._is_duplicate(track, detection, stamp, face)]
        if any(face is None or track.face_id is not None for track in doubles):
            return
        lost = [track for track in self.tracks if not track.visible or track in doubles]
        cost = cost_matrix(lost, [detection], stamp, faces)
        best = int(np.argmin(cost[:, 0])) if lost else -1
        if best >= 0 and cost[best, 0] <= MAX_COST:
            self._found(lost[best], detection, stamp, False)
            lost[best].box_confirmed = lost[best].box_confirmed or boxed or None
            if face is not None:
                lost[best].link(face, stamp)
            if anchor is not None:
                lost[best].hold_anchor(anchor, stamp)
        elif len(self.tracks) < self._max_bodies and not doubles:
            life = TrackLife(stamp, self._birth_delay, self._death_time)
            rival = None if box is None or face is not None else waiting_in(self.tracks, box, stamp)
            track = BodyTrack(self._new_id(), detection, stamp, life, face, anchor, boxed or None)
            track.rival = None if rival is None else rival.id
            if face is not None:
                self._look_beside(track, stamp)
            self.tracks.append(track)

    def _look_beside(self, new: BodyTrack, stamp: float) -> None:
        """Let who overlaps a new body with a face, and has none, be looked at in the next image: it may be a body that
        the network made of this human and a neighbour before."""
        for track in self.tracks:
            if track.visible and track.face_id is None and _at_one_place(track.expected(stamp), new.estimate):
                self.schedule.renew(track.id)

    @staticmethod
    def _is_duplicate(track: BodyTrack, detection: PoseDetection, stamp: float, face: Optional[FaceBox]) -> bool:
        """Tell whether a new detection shows a body that is followed: the same landmarks, or, without a face, its
        trunk."""
        expected = track.expected(stamp)
        if same_body(expected, detection.estimate) or (face is None and one_human(expected, detection.estimate)):
            return True
        offset = float(np.hypot(*(expected.centre - detection.estimate.centre))) / track.motion.size
        return face is None and offset < _SECOND_OFFSET and inside(detection.estimate.box, expected.box) > _SECOND_SHARE

    def _make_detection(self, image: np.ndarray, estimate: PoseEstimate, track: Optional[BodyTrack],
                        stamp: float) -> Optional[PoseDetection]:
        """Make a detection of an estimate from the window of `track`, None when it is no body."""
        picture = np.array([0.0, 0.0, image.shape[1], image.shape[0]])
        if not is_sound(estimate, self._min_score) or inside(estimate.box, picture) < _LEAST_INSIDE:
            return None
        appearance = describe(image, estimate) if track is None or self._needs_appearance(track, stamp) else None
        return PoseDetection(estimate, self._locate(estimate), appearance, None if track is None else track.id)

    def _needs_appearance(self, track: BodyTrack, stamp: float) -> bool:
        """Tell whether the appearance matters: somebody may be mistaken for this body, or it was long not learnt."""
        if stamp - track.described_at >= _DESCRIBE_S or not track.visible:
            return True
        here = track.motion.predicted_centre(stamp)
        return any(math.hypot(*(other.motion.predicted_centre(stamp) - here).tolist())
                   < track.motion.size + other.motion.size for other in self.tracks if other is not track)

    def _infer(self, image: np.ndarray, window: Window, track: Optional[BodyTrack], own: Optional[FaceBox],
               faces: Sequence[FaceBox], stamp: float) -> PoseEstimate:
        """Estimate with the neighbours' heads hidden; what was done in a batch is taken from it."""
        self.windows += 1
        prepared = self._prepared.pop(track.id, None) if track is not None else None
        if prepared is not None and prepared[0] == window:
            return prepared[1]
        one = self._pose_window(window, track, own, faces, stamp)
        return self._pose.estimate(image, one.window, one.hidden, one.shown)

    def _pose_window(self, window: Window, track: Optional[BodyTrack], own: Optional[FaceBox],
                     faces: Sequence[FaceBox], stamp: float) -> PoseWindow:
        """Hide all faces but the own one, or those known to be others'.

        Only where there are no faces at all, or the body was lost, the heads of the other bodies are hidden: they are
        less sure, and with a human's own head hidden the network may make a second body of the trunk.
        """
        if own is not None:
            hidden = [head_box(face) for face in faces if face.id != own.id]
        else:
            hidden = [head_box(face) for face in faces if self._owner(face) not in (None, track)]
            if not faces or (track is not None and not track.visible):
                hidden += [other.expected(stamp).head_box() for other in self.tracks
                           if other is not track and other.visible]
        return PoseWindow(window, hidden, None if own is None else own.box)

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


def _at_one_place(a: PoseEstimate, b: PoseEstimate) -> bool:
    return max(inside(a.box, b.box), inside(b.box, a.box)) > _ONE_PLACE
