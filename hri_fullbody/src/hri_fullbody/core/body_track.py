"""One tracked body: its id, its life, and where to look for it next."""

from __future__ import annotations

from typing import Optional

import numpy as np

from hri_fullbody.core.body_windows import FACE_WINDOW_SIZES, FaceBox, Window, window_from_face
from hri_fullbody.core.pose_model import BODY_LANDMARKS, PoseEstimate
from hri_pipeline.core.geometry import iou_matrix
from hri_pipeline.core.track_life import TrackLife

# A nose further than this from the middle of its face (in face sizes, 0.5 is the rim) belongs to somebody else.
NOSE_IN_FACE = 0.5
NOSE_IN_OWN_FACE = 0.65
SAME_BODY = 0.1
_LARGEST_STEP = 0.6
_FACE_HOLD = 0.5
_ANCHOR_HOLD = 2.0


def body_size(estimate: PoseEstimate) -> float:
    """Longer side of the box of the landmarks that are seen, px."""
    box = estimate.box()
    return float(max(box[2] - box[0], box[3] - box[1], 1.0))


def body_distance(a: PoseEstimate, b: PoseEstimate) -> float:
    """Median distance of the landmarks that both see, in units of the larger body."""
    both = (a.confidence[:BODY_LANDMARKS] > 0.3) & (b.confidence[:BODY_LANDMARKS] > 0.3)
    both = both if both.sum() > 4 else np.ones(BODY_LANDMARKS, bool)
    offset = (a.landmarks[:BODY_LANDMARKS, :2] - b.landmarks[:BODY_LANDMARKS, :2])[both]
    return float(np.median(np.hypot(*offset.T))) / max(body_size(a), body_size(b))


class BodyTrack:
    """One body over time. All stamps are seconds of the images' clock."""

    def __init__(self, body_id: str, estimate: PoseEstimate, stamp: float, life: TrackLife,
                 face: Optional[FaceBox] = None, anchor: Optional[float] = None) -> None:
        """anchor: side (in face sizes) of the face's window that found the body; None when its own landmarks did."""
        self.id = body_id
        self.life = life
        self.estimate = estimate
        self.seen = True
        self.face_id: Optional[str] = None
        self._face_stamp = stamp
        self._anchor_side = FACE_WINDOW_SIZES[0] if anchor is None else anchor
        self._anchored_until = -np.inf if anchor is None else stamp + _ANCHOR_HOLD
        if face is not None:
            self.link(face, stamp)

    def link(self, face: FaceBox, stamp: float) -> None:
        """Note that `face` is this body's own."""
        self.face_id = face.id
        self._face_stamp = stamp

    def forget_lost_face(self, stamp: float) -> None:
        """Let go of a face that has not been reported for half a second."""
        if self.face_id is not None and stamp - self._face_stamp > _FACE_HOLD:
            self.face_id = None

    def window(self, face: Optional[FaceBox], stamp: float) -> Window:
        """Where to look in the next image: along the landmarks, or below the face while it is the anchor."""
        if face is not None and stamp < self._anchored_until:
            return window_from_face(face, self._anchor_side)
        return self.estimate.next_window()

    def next_anchor(self, attempt: int) -> float:
        """Side, in face sizes, of the face's window to try in attempt 0, 1, ...: first the one that last worked."""
        start = FACE_WINDOW_SIZES.index(self._anchor_side) if self._anchor_side in FACE_WINDOW_SIZES else 0
        return FACE_WINDOW_SIZES[(start + attempt) % len(FACE_WINDOW_SIZES)]

    def hold_anchor(self, side: float, stamp: float) -> None:
        """Look below the face, with a window of `side` face sizes, for the next two seconds."""
        self._anchor_side = side
        self._anchored_until = stamp + _ANCHOR_HOLD

    def accepts(self, estimate: PoseEstimate, face: Optional[FaceBox], min_score: float) -> bool:
        """Tell whether an estimate can be this body: sure enough, nose in its own face, else near its last place."""
        if not is_sound(estimate, min_score):
            return False
        if face is not None:
            return face.distance(estimate.nose) <= NOSE_IN_OWN_FACE
        before, now = self.estimate.box(), estimate.box()
        step = np.abs((before[:2] + before[2:]) - (now[:2] + now[2:])).max() / 2.0
        return step <= _LARGEST_STEP * body_size(self.estimate)

    def update(self, estimate: PoseEstimate, stamp: float) -> None:
        """Take over an estimate that was accepted."""
        self.estimate = estimate
        self.seen = True
        self.life.seen(stamp)


def is_sound(estimate: PoseEstimate, min_score: float) -> bool:
    """Tell whether an estimate is sure enough, finite, and has a window to follow it."""
    finite = np.all(np.isfinite(estimate.landmarks)) and np.all(np.isfinite(estimate.world))
    if not (finite and estimate.score >= min_score):
        return False
    try:
        window = estimate.next_window()
    except ValueError:
        return False
    return window.size >= 16.0 and int((estimate.confidence[:BODY_LANDMARKS] > 0.3).sum()) >= 4


def covers(estimate: PoseEstimate, box: np.ndarray, min_iou: float = 0.35) -> bool:
    """Tell whether a person's box (4,) px is that of this body."""
    return bool(iou_matrix(estimate.box()[None], np.asarray(box)[None])[0, 0] > min_iou)
