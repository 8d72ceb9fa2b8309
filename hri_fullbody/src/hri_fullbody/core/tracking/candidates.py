"""Candidate windows for new bodies, tried a few per image so that no image takes long."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Deque, Dict, List, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.detection.pose_estimator import LEAST_SHARE, PoseEstimate, inside, is_sound
from hri_fullbody.core.detection.windows import (
    FACE_WINDOW_SIZES,
    PERSON_BOX_WINDOWS,
    FaceBox,
    Window,
    window_from_face,
    window_from_person_box,
)
from hri_fullbody.core.tracking.association import NOSE_IN_FACE
from hri_pipeline.core.geometry import iou_matrix
from hri_pipeline.core.images import PlaceView

PROMISING = 0.2
"""Score from which a window may hold a body, to be looked at again."""
_FACE_HEAD_SHARE, _FACE_ASIDE = 0.4, 0.25
_SAME_BOX = 0.5
_FIRST_PAUSE, _LONGEST_PAUSE = 0.5, 8.0
_NOT_RESTING = (-np.inf, _FIRST_PAUSE)
_MOST_FAILED, _MOST_RESTING = 20, 100
# A box that shares less with each other one stands alone; an unsure one that shares more with one is a part of that.
_APART, _PART = 0.1, 0.6
# In longer sides of a box: so near, and of so much of its size or the other way round, is somebody who stands beside.
_BESIDE, _SIMILAR = 1.0, 0.5


# A body out of another window than the first one of a box, or of a box that the detector is unsure of, is believed from
# this score on.
_SURE_SCORE = 0.9
# Grown-ups reach over 8 and more sizes of their faces. What is smaller is a figure squeezed into a part of somebody.
_OVERLAP, _LEAST_FACES = 0.5, 6.0
# Of a person's box, what is seen of somebody whose trunk is seen fills so much. Of 216 bodies on photographs that were
# cut, covered, darkened or shrunk four filled less: figures on a bag, on a hand, between two people, and in a face.
_TRUNK_FILLS = 0.25


# Refused places: how many are remembered, and overlap of boxes of what has not moved.
_MOST_REFUSED, _UNMOVED = 20, 0.7


@dataclass
class BodyCandidate:
    """A face without a body, or a person's box: tried with one window after another, each refined once.

    alone: the box has no neighbour. Among others it has one window only: another one may show a neighbour. An
    unsure one, which the detector takes for nobody by itself, has one window, too. in_group: another box of its size,
    be it faint, is beside it; accompanied: there is a face in one of these. looked: a further look saw no human.
    """

    face_id: Optional[str] = None
    box: Optional[np.ndarray] = None
    alone: bool = False
    unsure: bool = False
    in_group: bool = False
    accompanied: bool = False
    looked: bool = False
    attempt: int = 0
    first: Optional[PoseEstimate] = field(default=None, repr=False)

    def window(self, face: Optional[FaceBox]) -> Window:
        """The window to try now."""
        if self.first is not None:
            return self.first.next_window()
        if self.box is not None:
            return window_from_person_box(self.box, self.attempt)
        assert face is not None
        return window_from_face(face, FACE_WINDOW_SIZES[self.attempt])

    def judge(self, estimate: PoseEstimate, face: Optional[FaceBox], min_score: float) -> "WindowResult":
        """Take the result of `window` and decide: found (the better of two estimates), try again, or give up."""
        fits = face is None or face.distance(estimate.nose) <= NOSE_IN_FACE
        if self.box is not None and (self.attempt or self.unsure):
            min_score = max(min_score, _SURE_SCORE)
        if self.first is None:
            if fits and is_sound(estimate, min_score if self.unsure else PROMISING):
                self.first = estimate
                return WindowResult()
        elif fits and is_sound(estimate, min_score) and self._is_whole(estimate, face):
            return WindowResult(found=estimate)
        elif face is not None and is_sound(self.first, min_score) and self._is_whole(self.first, face):
            return WindowResult(found=self.first, anchor=FACE_WINDOW_SIZES[self.attempt])
        self.first = None
        self.attempt += 1
        windows = len(FACE_WINDOW_SIZES) if self.face_id is not None else len(PERSON_BOX_WINDOWS) if (
            self.alone and not self.unsure) else 1
        return WindowResult(failed=self.attempt >= windows)

    def _is_whole(self, estimate: PoseEstimate, face: Optional[FaceBox]) -> bool:
        """Tell whether a body is as large as its face or box demands, and that of the box."""
        if self.box is not None:
            return _shows(estimate, self.box, self.unsure)
        return face is None or estimate.extent >= _LEAST_FACES * face.size


@dataclass(frozen=True)
class WindowResult:
    """What came of one try. anchor: side in face sizes when only the face's own window shows the body."""

    found: Optional[PoseEstimate] = None
    anchor: Optional[float] = None
    failed: bool = False


class CandidateQueue:
    """The candidates that wait. A face whose windows all failed rests for a while, each time twice as long; a box has
    only its first window then."""

    def __init__(self) -> None:
        self._queue: Deque[BodyCandidate] = deque()
        self._failed: Deque[Tuple[np.ndarray, float]] = deque(maxlen=_MOST_FAILED)
        self._resting: Dict[str, Tuple[float, float]] = {}      # by face: until when, and its next pause, s

    def __len__(self) -> int:
        return len(self._queue)

    def offer_faces(self, faces: Sequence[FaceBox], stamp: float) -> None:
        """Queue faces that have no body. Faces that are gone are forgotten."""
        present = {face.id for face in faces}
        waiting = {candidate.face_id for candidate in self._queue}
        for face in faces:
            if face.id not in waiting and stamp >= self._resting.get(face.id, _NOT_RESTING)[0]:
                self._queue.append(BodyCandidate(face_id=face.id))
        self._queue = deque(item for item in self._queue if item.face_id is None or item.face_id in present)
        if len(self._resting) > _MOST_RESTING:
            self._resting = {key: value for key, value in self._resting.items() if key in present}

    def offer_boxes(self, boxes: Sequence[np.ndarray], faces: Sequence[FaceBox], others: Sequence[np.ndarray],
                    stamp: float, unsure: Sequence[np.ndarray] = ()) -> None:
        """Queue persons' boxes (4,) px instead of earlier ones; those with a face at the top are left to the face.

        others: boxes (4,) px of all people in the image, those of `boxes` included. unsure: boxes that may be nobody's.
        """
        waiting = [(item, item.box) for item in self._queue if item.box is not None]
        self._queue = deque(item for item in self._queue if item.face_id is not None)
        failed = [box for box, until in self._failed if stamp < until]
        offered = []
        maybe = [box for box in unsure if _at(box, failed) is None and not any(
            inside(box, other) > _PART for other in others)]
        for number, box in enumerate(np.asarray(box) for box in (*boxes, *maybe)):
            if any(face_at_top(face, box) for face in faces):
                continue
            known = _at(box, [place for _, place in waiting])
            doubtful, in_vain = number >= len(boxes), _at(box, failed) is not None
            alone = doubtful or (not in_vain and all(
                max(inside(box, other), inside(other, box)) < _APART for other in others if other is not box))
            group = [other for other in (*others, *unsure) if beside(box, other)]
            accompanied = any(face_at_top(face, other) for other in group for face in faces)
            candidate = replace(BodyCandidate() if known is None else waiting[known][0], box=box, alone=alone,
                                unsure=doubtful, in_group=bool(group), accompanied=accompanied)
            offered.append((candidate, in_vain or candidate.looked))
        # In slow images there may be one inference between two calls of the detector: what has begun is finished, and
        # what was looked at in vain lets the others go first.
        offered.sort(key=lambda one: (one[0].unsure, one[0].first is None, one[1]))
        self._queue.extend(item for item, _ in offered)

    def take(self) -> Optional[BodyCandidate]:
        """Return the next candidate, None when there is none."""
        return self._queue.popleft() if self._queue else None

    def put_back(self, candidate: BodyCandidate) -> None:
        """Return a candidate that needs another inference: it comes next."""
        self._queue.appendleft(candidate)

    def put_last(self, candidate: BodyCandidate) -> None:
        """Return a candidate that is tried from the start after all others."""
        self._queue.append(replace(candidate, attempt=0, first=None))

    def give_up(self, face_id: Optional[str], stamp: float, box: Optional[np.ndarray] = None) -> None:
        """Let a face rest below which there is no body, or a person's box without one."""
        if box is not None:
            self._failed.append((box, stamp + _LONGEST_PAUSE))
        if face_id is not None:
            _, pause = self._resting.get(face_id, _NOT_RESTING)
            self._resting[face_id] = stamp + pause, min(2.0 * pause, _LONGEST_PAUSE)

    def found(self, face_id: Optional[str]) -> None:
        """Forget the failures of a face that has a body."""
        self._resting.pop(face_id or "", None)

    def clear(self) -> None:
        """Forget everything."""
        self._queue.clear()
        self._failed.clear()
        self._resting.clear()


class RefusedPlaces:
    """Places where further looks saw no human: what stands there as it did is not looked at again.

    A place is forgotten once it has changed: a box of another size or place, or anything that moves in it, as all does
    when the camera moves. Of too many the oldest go.
    """

    def __init__(self) -> None:
        self._places: List[PlaceView] = []

    def __len__(self) -> int:
        return len(self._places)

    def add(self, image: np.ndarray, box: np.ndarray) -> None:
        """Remember a box (4,) px of an `image` (H, W, 3) BGR."""
        if self.contain(image, box):
            return
        self._places = [*self._places, PlaceView(image, box)][-_MOST_REFUSED:]

    def contain(self, image: np.ndarray, box: np.ndarray) -> bool:
        """Tell whether a box (4,) px of an `image` (H, W, 3) BGR shows what was refused, unchanged."""
        at = _at(box, [place.box for place in self._places])
        if at is None:
            return False
        place = self._places[at]
        if iou_matrix(place.box[None], box[None])[0, 0] >= _UNMOVED and place.is_unchanged(image):
            return True
        del self._places[at]
        return False

    def clear(self) -> None:
        """Forget all places."""
        self._places = []


def _at(box: np.ndarray, boxes: Sequence[np.ndarray]) -> Optional[int]:
    """Index of the box at the same place, None when there is none."""
    if not boxes:
        return None
    overlap = iou_matrix(box[None], np.array(boxes))[0]
    best = int(np.argmax(overlap))
    return best if overlap[best] >= _SAME_BOX else None


def beside(box: np.ndarray, other: np.ndarray) -> bool:
    """Tell whether another box (4,) px is that of somebody of about the size beside, and no part of this one."""
    side, its = float(max(box[2:] - box[:2])), float(max(other[2:] - other[:2]))
    offset = float(np.abs(box[:2] + box[2:] - other[:2] - other[2:]).max()) / 2.0
    return (offset < _BESIDE * side and _SIMILAR < its / max(side, 1e-6) < 1.0 / _SIMILAR
            and max(inside(box, other), inside(other, box)) < _PART)


def _shows(estimate: PoseEstimate, box: np.ndarray, nose: bool) -> bool:
    """Tell whether a body is that of the box (4,) px, no neighbour and no small thing. nose: it must lie in the box."""
    overlap = max(inside(estimate.box, box), inside(box, estimate.box))
    x, y = estimate.nose
    fills = not estimate.trunk_seen or inside(box, estimate.box) >= _TRUNK_FILLS
    return bool(fills and overlap >= _OVERLAP and estimate.extent >= LEAST_SHARE * max(box[2:] - box[:2])
                and (not nose or (box[0] <= x <= box[2] and box[1] <= y <= box[3])))


def face_at_top(face: FaceBox, box: np.ndarray) -> bool:
    """Tell whether a face is that of a person's box (4,) px: its middle lies in the upper 40 %, or, since somebody near
    the camera is cut by the rim of the image, below the middle of the top edge by hair at most."""
    x, y = face.centre
    if not (box[0] < x < box[2] and box[1] < y < box[3]):
        return False
    hair = face.box[1] - box[1] < face.box[3] - face.box[1]
    return bool(y < box[1] + _FACE_HEAD_SHARE * (box[3] - box[1])
                or (hair and abs(x - 0.5 * (box[0] + box[2])) < _FACE_ASIDE * (box[2] - box[0])))
