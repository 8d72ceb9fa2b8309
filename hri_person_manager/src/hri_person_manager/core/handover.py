"""From a face to its body without a stop and without a step: who turns away is placed by the body, soon, from where the face was."""

from __future__ import annotations

from collections import deque
from typing import Deque, Hashable, Optional, Tuple

import numpy as np

from hri_pipeline.core.geometry import Pose

SHORTEST = 0.25            # s without a face after which the body goes on; bodies may be ahead of faces by the age of an image
PERIODS = 3.0              # the same, in periods of the face, where these are longer
SAME_TIME = 0.1            # s between a face and a body that are compared
LARGEST_STEP = 1.0         # m; farther apart a face and a body are of two people, or one of them is wrong
HALF_LIFE = 1.0            # s in which half of the step is given up: the longer the face is away, the more the body is right
_GAIN = 0.3                # of a new step
_HISTORY = 30              # faces


class Handover:
    """Follows how far the place of a face is from that of its body, while both are seen. Times are stamps, s; places m in a named frame."""

    def __init__(self) -> None:
        self._faces: Deque[Tuple[float, str, np.ndarray]] = deque(maxlen=_HISTORY)
        self._period: Optional[float] = None
        self._step: Optional[np.ndarray] = None
        self._of: Tuple[str, Hashable] = ("", None)

    def face(self, frame: str, position: np.ndarray, stamp: float) -> None:
        """Take the place of the face."""
        since = stamp - self._faces[-1][0] if self._faces else 0.0
        if since < 0.0:
            self.clear()
        elif 0.0 < since < 1.0:
            self._period = since if self._period is None else self._period + _GAIN * (since - self._period)
        self._faces.append((stamp, frame, position))

    def body(self, frame: str, position: np.ndarray, stamp: float, feature: Hashable) -> None:
        """Take the place of the body while the face is there; feature: which frame of which body."""
        near = min(self._faces, key=lambda face: abs(face[0] - stamp), default=None)
        if near is None or abs(near[0] - stamp) > SAME_TIME or near[1] != frame:
            return
        step = near[2] - position
        known = self._step is not None and self._of == (frame, feature)
        self._step = self._step + _GAIN * (step - self._step) if known else step
        self._of = (frame, feature)

    def patience(self, longest: float) -> float:
        """Return how long (s) the body waits for the face, `longest` s at most and where the two were never seen together."""
        if self._step is None or self._period is None:
            return longest
        return min(longest, max(SHORTEST, PERIODS * self._period))

    def carried(self, frame: str, pose: Pose, stamp: float, feature: Hashable) -> Pose:
        """Return where the person is by the body alone: its place and what is left of the step to the face."""
        if self._step is None or self._of != (frame, feature) or np.linalg.norm(self._step) > LARGEST_STEP:
            return pose
        away = max(0.0, stamp - self._faces[-1][0])
        return Pose(pose.rotation, pose.translation + 0.5 ** (away / HALF_LIFE) * self._step)

    def clear(self) -> None:
        """Forget everything."""
        self._faces.clear()
        self._period = self._step = None
