"""Candidate windows for new bodies, tried a few per image so that no image takes long."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Deque, Dict, Optional, Sequence

import numpy as np

from hri_fullbody.core.detection.pose_estimator import PoseEstimate, is_sound
from hri_fullbody.core.detection.windows import (
    FACE_WINDOW_SIZES,
    FaceBox,
    Window,
    window_from_face,
    window_from_person_box,
)
from hri_fullbody.core.tracking.association import NOSE_IN_FACE
from hri_pipeline.core.geometry import iou_matrix

_PROMISING = 0.2
_FACE_HEAD_SHARE = 0.4
_SAME_BOX = 0.5
_FIRST_PAUSE, _LONGEST_PAUSE = 0.5, 8.0


@dataclass
class BodyCandidate:
    """A face without a body, or a person's box: tried with one window after another, each refined once."""

    face_id: Optional[str] = None
    box: Optional[np.ndarray] = None
    attempt: int = 0
    first: Optional[PoseEstimate] = field(default=None, repr=False)

    def side(self) -> Optional[float]:
        """Side of the face's window of this attempt in face sizes; None for a person's box."""
        return FACE_WINDOW_SIZES[self.attempt] if self.face_id is not None else None

    def window(self, face: Optional[FaceBox]) -> Window:
        """The window to try now."""
        if self.first is not None:
            return self.first.next_window()
        if self.box is not None:
            return window_from_person_box(self.box)
        assert face is not None
        return window_from_face(face, FACE_WINDOW_SIZES[self.attempt])

    def judge(self, estimate: PoseEstimate, face: Optional[FaceBox], min_score: float) -> "WindowResult":
        """Take the result of `window` and decide: found (the better of two estimates), try again, or give up."""
        fits = face is None or face.distance(estimate.nose) <= NOSE_IN_FACE
        if self.first is None:
            if fits and is_sound(estimate, _PROMISING):
                self.first = estimate
                return WindowResult()
        elif fits and is_sound(estimate, min_score):
            return WindowResult(found=estimate)
        elif face is not None and is_sound(self.first, min_score):
            return WindowResult(found=self.first, anchor=self.side())
        self.first = None
        self.attempt += 1
        return WindowResult(failed=self.face_id is None or self.attempt >= len(FACE_WINDOW_SIZES))


@dataclass(frozen=True)
class WindowResult:
    """What came of one try. anchor: side in face sizes when only the face's own window shows the body."""

    found: Optional[PoseEstimate] = None
    anchor: Optional[float] = None
    failed: bool = False


class CandidateQueue:
    """The candidates that wait. A face whose windows all failed rests for a while, each time twice as long."""

    def __init__(self) -> None:
        self._queue: Deque[BodyCandidate] = deque()
        self._rest_until: Dict[str, float] = {}
        self._pause: Dict[str, float] = {}

    def __len__(self) -> int:
        return len(self._queue)

    def offer_faces(self, faces: Sequence[FaceBox], stamp: float) -> None:
        """Queue faces that have no body. Faces that are gone are forgotten."""
        present = {face.id for face in faces}
        waiting = {candidate.face_id for candidate in self._queue}
        for face in faces:
            if face.id not in waiting and stamp >= self._rest_until.get(face.id, -np.inf):
                self._queue.append(BodyCandidate(face_id=face.id))
        self._queue = deque(item for item in self._queue if item.face_id is None or item.face_id in present)
        if len(self._pause) > 100:
            self._pause = {key: value for key, value in self._pause.items() if key in present}
            self._rest_until = {key: value for key, value in self._rest_until.items() if key in present}

    def offer_boxes(self, boxes: Sequence[np.ndarray], faces: Sequence[FaceBox]) -> None:
        """Queue persons' boxes (4,) px instead of earlier ones; those with a face at the top are left to the face."""
        begun = [item for item in self._queue if item.face_id is None and item.first is not None]
        self._queue = deque(item for item in self._queue if item.face_id is not None)
        free = [np.asarray(box) for box in boxes if not any(face_at_top(face, box) for face in faces)]
        offered = [BodyCandidate(box=box, first=_first_estimate(box, begun)) for box in free]
        # In slow images there may be one inference between two calls of the detector: what has begun is finished.
        self._queue.extend(sorted(offered, key=lambda item: item.first is None))

    def take(self) -> Optional[BodyCandidate]:
        """Return the next candidate, None when there is none."""
        return self._queue.popleft() if self._queue else None

    def put_back(self, candidate: BodyCandidate) -> None:
        """Return a candidate that needs another inference: it comes next."""
        self._queue.appendleft(candidate)

    def give_up(self, face_id: Optional[str], stamp: float) -> None:
        """Let a face rest below which there is no body; None: it was a person's box."""
        if face_id is not None:
            pause = self._pause.get(face_id, _FIRST_PAUSE)
            self._rest_until[face_id] = stamp + pause
            self._pause[face_id] = min(2.0 * pause, _LONGEST_PAUSE)

    def found(self, face_id: Optional[str]) -> None:
        """Forget the failures of a face that has a body."""
        self._pause.pop(face_id or "", None)

    def clear(self) -> None:
        """Forget everything."""
        self._queue.clear()
        self._rest_until.clear()
        self._pause.clear()


def _first_estimate(box: np.ndarray, begun: Sequence[BodyCandidate]) -> Optional[PoseEstimate]:
    """Return the first estimate of an earlier box at the same place."""
    if not begun:
        return None
    overlap = iou_matrix(box[None], np.array([item.box for item in begun]))[0]
    best = int(np.argmax(overlap))
    return begun[best].first if overlap[best] >= _SAME_BOX else None


def face_at_top(face: FaceBox, box: np.ndarray) -> bool:
    """Tell whether the middle of a face lies in the upper 40 % of a person's box (4,) px."""
    x, y = face.centre
    return bool(box[0] < x < box[2] and box[1] < y < box[1] + _FACE_HEAD_SHARE * (box[3] - box[1]))
