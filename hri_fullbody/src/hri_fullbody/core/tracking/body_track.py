"""One tracked body: its id, its life, and where to look for it next."""

from __future__ import annotations

from dataclasses import replace
from typing import Optional, Tuple

import numpy as np

from hri_fullbody.core.sight.body_sight import Sight
from hri_fullbody.core.sight.body_windows import FACE_WINDOW_SIZES, FaceBox, Window, window_from_face
from hri_fullbody.core.sight.pose_model import PoseEstimate
from hri_fullbody.core.tracking.body_appearance import blend
from hri_fullbody.core.tracking.body_motion import BodyMotion
from hri_pipeline.core.track_life import TrackLife

_FACE_HOLD = 0.5
_ANCHOR_HOLD = 2.0
_FADE_S = 0.4
_OCCLUDED_NOISE = 4.0     # times as much, while somebody else is in the same place
_LOOKS_LEARN_S = 1.5
_VAIN_LOOKS = 2
# A body slower than this (sizes per second) stays where it was: what seems to move a little is the network's noise, and
# a window that follows it would drift away.
_STILL = 0.25


class BodyTrack:
    """One body over time. All stamps are seconds of the images' clock.

    visible: the last look found it. looked_at: stamp of that look. misses: looks in a row that did not find it.
    turn: for the schedule, rising with every look. wait: time (s) that looks took lately to come round. looks: its appearance, learnt while unoccluded.
    """

    def __init__(self, body_id: str, sight: Sight, stamp: float, life: TrackLife,
                 face: Optional[FaceBox] = None, anchor: Optional[float] = None) -> None:
        """anchor: side (in face sizes) of the face's window that found the body; None when its own landmarks did."""
        self.id = body_id
        self.life = life
        self.sight = sight
        self.stamp = stamp
        self.visible = True
        self.looked_at = stamp
        self.misses = 0
        self.turn = 0
        self.wait = 0.0
        self.supported_at = stamp
        self.looks: Optional[np.ndarray] = sight.looks
        self.described_at = stamp
        self.motion = BodyMotion(sight.estimate.centre, sight.estimate.extent, sight.root, stamp)
        self.face_id: Optional[str] = None
        self._expected: Optional[Tuple[float, PoseEstimate]] = None
        self._face_stamp = stamp
        self._anchor_side = FACE_WINDOW_SIZES[0] if anchor is None else anchor
        self._anchored_until = -np.inf if anchor is None else stamp + _ANCHOR_HOLD
        if face is not None:
            self.link(face, stamp)

    @property
    def estimate(self) -> PoseEstimate:
        """The body as it was last seen."""
        return self.sight.estimate

    def link(self, face: FaceBox, stamp: float) -> None:
        """Note that `face` is this body's own."""
        self.face_id = face.id
        self._face_stamp = stamp

    def forget_lost_face(self, stamp: float) -> None:
        """Let go of a face that has not been reported for half a second."""
        if self.face_id is not None and stamp - self._face_stamp > _FACE_HOLD:
            self.face_id = None

    def window(self, face: Optional[FaceBox], stamp: float) -> Window:
        """Where to look at `stamp`: where the landmarks will be, or below the face while it is the anchor."""
        if face is not None and stamp < self._anchored_until:
            return window_from_face(face, self._anchor_side)
        window = self.estimate.next_window()
        x, y = np.asarray(window.centre) + self.moved(stamp)
        return Window((float(x), float(y)), window.size, window.angle)

    def next_anchor(self, attempt: int) -> float:
        """Side, in face sizes, of the face's window to try in attempt 0, 1, ...: first the one that last worked."""
        start = FACE_WINDOW_SIZES.index(self._anchor_side) if self._anchor_side in FACE_WINDOW_SIZES else 0
        return FACE_WINDOW_SIZES[(start + attempt) % len(FACE_WINDOW_SIZES)]

    def hold_anchor(self, side: float, stamp: float) -> None:
        """Look below the face, with a window of `side` face sizes, for the next two seconds."""
        self._anchor_side = side
        self._anchored_until = stamp + _ANCHOR_HOLD

    def moved(self, stamp: float) -> np.ndarray:
        """Way (2,) px in the image since the body was last seen, as its motion tells; 0 at rest."""
        if self.motion.speed() < _STILL:
            return np.zeros(2)
        return self.motion.predicted_centre(stamp) - self.sight.estimate.centre

    def expected(self, stamp: float) -> PoseEstimate:
        """The body at `stamp` where its motion takes it; the longer it was not seen the lower the confidence."""
        age = max(0.0, stamp - self.stamp)
        if age == 0.0:
            return self.estimate
        if self._expected is None or self._expected[0] != stamp:
            self._expected = (stamp, self._moved_on(age, stamp))
        return self._expected[1]

    def _moved_on(self, age: float, stamp: float) -> PoseEstimate:
        landmarks = self.estimate.landmarks.copy()
        landmarks[:, :2] += self.moved(stamp)
        fade = float(np.exp(-age / max(_FADE_S, self.wait)))
        return replace(self.estimate, score=self.estimate.score * fade, landmarks=landmarks,
                       confidence=self.estimate.confidence * fade)

    def update(self, sight: Sight, stamp: float, unhidden: bool) -> None:
        """Take over a sight of this body. unhidden: nobody stands before it, so that its appearance may be learnt."""
        step = max(0.0, stamp - self.stamp)
        self.sight, self.stamp, self._expected = sight, stamp, None
        self.described_at = self.described_at if sight.looks is None else stamp
        self.visible, self.looked_at, self.misses = True, stamp, 0
        self.motion.update(sight.estimate.centre, sight.estimate.extent, sight.root, stamp,
                           1.0 if unhidden else _OCCLUDED_NOISE)
        if unhidden:
            self.looks = blend(self.looks, sight.looks, float(1.0 - np.exp(-step / _LOOKS_LEARN_S)))
        self.life.seen(stamp)

    def dead(self, stamp: float) -> bool:
        """Tell whether the body has been looked for twice in vain, and unseen for longer than the death time.

        Who is not looked at is not gone: with many people, or few images, the turn of each comes later than that; the id stays.
        """
        return self.misses >= _VAIN_LOOKS and self.life.dead(stamp)

    def missed(self, stamp: float) -> None:
        """Note that a look did not find the body."""
        self.visible, self.looked_at = False, stamp
        self.misses += 1


