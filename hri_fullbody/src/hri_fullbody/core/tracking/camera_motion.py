"""Compensation of the camera's motion: how far it has turned from image to image, by what the images show.

While a robot turns its head, everybody moves through the image together. Without this a body would be searched where it
was, which in a fast pan is where its neighbour is by now, and so would the faces that another node has found in an
image of before. The motion is that of most of the corners in the picture (pyramidal Lucas-Kanade, Bouguet 2000), as in
N. Aharon et al., "BoT-SORT", 2022, but as two angles: those are the same all over the image. Transforms of the robot
tell the same, but come too late, as a rule.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Callable, Deque, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_fullbody.core.detection.windows import FaceBox
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.images import PictureCuts

_SIDE = 320             # px, longer side of the picture in which corners are followed
_CORNERS, _QUALITY, _APART = 80, 0.01, 8
_WINDOW, _LEVELS = (15, 15), 3
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.05)
_OTHER = 25.0           # mean difference of grey values about a corner from which it is another one
_LEAST, _AGREEING = 8, 0.5      # corners, and the part of those which are still in the image that must move alike:
_ALIKE = 0.01           # rad by which they may differ
_STAY = 0.15            # part of the corners beside the people from which, where they stay, the camera stands
_RIM = 0.1              # of a body's box about it, in its heights
_STANDS = 0.002         # rad from one image to the next up to which the camera stands
_HISTORY_S, _AHEAD_S = 1.0, 0.2
_LONGEST_STEP_S = 0.5   # between two images that show the same scene

Boxes = Sequence[np.ndarray]


class _Turn(NamedTuple):
    """All that the camera has turned (2,) rad, to the right and downwards, until the image of `stamp` (s)."""

    stamp: float
    angles: np.ndarray


class CameraMotion:
    """How far the camera has turned between the images of the last second.

    A standing camera costs a comparison of two small pictures: corners are looked for only where most of the picture
    has changed, or while it moves.
    """

    def __init__(self) -> None:
        self._changes = PictureCuts()
        self._last: Optional[np.ndarray] = None
        self._picture: Optional[np.ndarray] = None      # of the last image, where it was needed
        self._turns: Deque[_Turn] = deque()
        self._camera: Optional[CameraModel] = None
        self.moves = False
        """Whether the camera has turned between the last two images."""

    def update(self, bgr: np.ndarray, camera: CameraModel, stamp: float, people: Callable[[], Boxes] = tuple) -> None:
        """Take the image (H, W, 3) of `camera` at `stamp` (s); nobody may write to it until the next call.

        people: tells the boxes (4,) px of those in the image before, whose motion is their own.
        """
        cut = self._changes.update(bgr, stamp) or self._changes.blank
        before, self._last, self._camera = self._last, None if self._changes.blank else bgr, camera
        picture, self._picture = self._picture, None
        step = stamp - self._turns[-1].stamp if self._turns else math.inf
        if before is None or cut or before.shape != bgr.shape or not 0.0 < step <= _LONGEST_STEP_S:
            self._begin(stamp)
            return
        seen = None
        if self._changes.changed or self.moves:
            self._picture = _picture(bgr)
            seen = _turned(_picture(before) if picture is None else picture, self._picture, camera, people())
        self.moves = seen is not None and math.hypot(*seen.tolist()) > _STANDS
        last = self._turns[-1].angles
        self._turns.append(_Turn(stamp, last + seen if self.moves and seen is not None else last))
        while stamp - self._turns[0].stamp > _HISTORY_S:
            self._turns.popleft()

    def reset(self) -> None:
        """Forget all images."""
        self._changes.reset()
        self._last, self._picture, self._turns, self.moves = None, None, deque(), False

    def step(self) -> np.ndarray:
        """Return how far the camera has turned (2,) rad since the image before."""
        return self._turns[-1].angles - self._turns[-2].angles if len(self._turns) > 1 else np.zeros(2)

    def since(self, stamp: float) -> np.ndarray:
        """Return how far the camera has turned (2,) rad from `stamp` (s) to the last image; of a stamp after that one,
        as fast as it turned last."""
        if not self._turns:
            return np.zeros(2)
        newest = self._turns[-1]
        if stamp > newest.stamp:
            if len(self._turns) < 2 or stamp - newest.stamp > _AHEAD_S:
                return np.zeros(2)
            return -self.step() * (stamp - newest.stamp) / (newest.stamp - self._turns[-2].stamp)
        stamps = [turn.stamp for turn in self._turns]
        return newest.angles - np.array([np.interp(stamp, stamps, [turn.angles[axis] for turn in self._turns])
                                         for axis in range(2)])

    def moved(self, points: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return where points (N, 2) px of an image are after the camera has turned by (2,) rad."""
        if self._camera is None or not turn.any():
            return points
        return _pixels(_angles(points, self._camera) - turn, self._camera)

    def face_now(self, face: FaceBox) -> FaceBox:
        """Return where a face that was seen in an image of another time is in the last one."""
        turn = self.since(face.stamp) if face.stamp is not None else np.zeros(2)
        if not turn.any():
            return face
        way = self.moved(face.centre[None], turn)[0] - face.centre
        return replace(face, box=face.box + np.concatenate([way, way]),
                       pose=None if face.pose is None else _seen_after(face.pose, turn))

    def _begin(self, stamp: float) -> None:
        self._turns, self.moves = deque([_Turn(stamp, np.zeros(2))]), False


def _seen_after(pose: Pose, turn: np.ndarray) -> Pose:
    """Return a pose in the optical frame after the camera has turned by (2,) rad."""
    pan, tilt = turn.tolist()
    about_y = np.array([[math.cos(pan), 0.0, -math.sin(pan)], [0.0, 1.0, 0.0], [math.sin(pan), 0.0, math.cos(pan)]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(tilt), -math.sin(tilt)], [0.0, math.sin(tilt), math.cos(tilt)]])
    return Pose(about_x @ about_y, np.zeros(3)).compose(pose)


def _turned(before: np.ndarray, now: np.ndarray, camera: CameraModel, people: Boxes) -> Optional[np.ndarray]:
    """Return how far the camera has turned (2,) rad between two pictures (h, w), None where that is not seen.

    The corners are looked for where phase correlation says (Kuglin and Hines 1975), which tells of large motions, too,
    but not whether all has moved. people: boxes (4,) px of the image of `before`.
    """
    scale = np.array([camera.width / before.shape[1], camera.height / before.shape[0]])
    corners = cv2.goodFeaturesToTrack(before, _CORNERS, _QUALITY, _APART, mask=_beside(people, before.shape, scale))
    if corners is None or len(corners) < _LEAST:
        return None
    guess = (corners + _shift(before, now)).astype(np.float32)
    found, status, error = cv2.calcOpticalFlowPyrLK(before, now, corners, guess, winSize=_WINDOW, maxLevel=_LEVELS,
                                                    criteria=_STOP, flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
    good = (np.asarray(status).ravel() > 0) & (np.asarray(error).ravel() < _OTHER)
    if np.count_nonzero(good) < _LEAST:
        return None
    start, end = (_angles(np.asarray(points).reshape(-1, 2)[good] * scale, camera) for points in (corners, found))
    return _common(start, start - end, camera)


def _common(start: np.ndarray, turns: np.ndarray, camera: CameraModel) -> Optional[np.ndarray]:
    """Return the turn (2,) rad in which most corners agree, None where they do not, or too many stay where they are:
    then it is somebody, or something large, that has moved.

    start: (N, 2) rad where the corners were; turns: (N, 2) rad, what each tells.
    """
    alike = np.linalg.norm(turns[:, None] - turns, axis=2) < _ALIKE
    agreeing = alike[int(np.argmax(alike.sum(axis=1)))]
    turn = turns[agreeing].mean(axis=0)
    there = _pixels(start - turn, camera)
    inside = ((there >= 0.0) & (there < (camera.width, camera.height))).all(axis=1)
    if np.count_nonzero(agreeing) < max(_LEAST, _AGREEING * np.count_nonzero(inside)):
        return None
    stay = np.linalg.norm(turns, axis=1) < min(_STANDS, 0.5 * math.hypot(*turn.tolist()))
    return None if np.count_nonzero(stay) > _STAY * len(stay) else turn


def _beside(people: Boxes, size: Sequence[int], scale: np.ndarray) -> Optional[np.ndarray]:
    """Mask (h, w) uint8 of a picture of (h, w) px that leaves out people's boxes (4,) px of an image `scale` (2,) times
    as large; None where there is nobody."""
    if not len(people):
        return None
    mask = np.full(tuple(size), 255, np.uint8)
    for box in people:
        rim = _RIM * float(box[3] - box[1])
        left, top, right, bottom = np.clip(np.concatenate([(box[:2] - rim) / scale, (box[2:] + rim) / scale]),
                                           0.0, max(size)).astype(int).tolist()
        mask[top:bottom, left:right] = 0
    return mask


def _shift(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Return how far (2,) px two pictures (h, w) fit each other best."""
    size = max(2, before.shape[1] // 2), max(2, before.shape[0] // 2)
    one, other = (cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32)
                  for picture in (before, now))
    way, _ = cv2.phaseCorrelate(one, other, np.asarray(cv2.createHanningWindow(size, cv2.CV_32F)))
    return 2.0 * np.array(way)


def _picture(bgr: np.ndarray) -> np.ndarray:
    """The green channel (h, w), the longer side _SIDE px or less."""
    green = cv2.extractChannel(bgr, 1)
    scale = min(1.0, _SIDE / max(green.shape))
    size = max(1, round(scale * green.shape[1])), max(1, round(scale * green.shape[0]))
    return cv2.resize(green, size, interpolation=cv2.INTER_AREA)


def _lens(camera: CameraModel) -> Tuple[np.ndarray, np.ndarray]:
    """Focal lengths and principal point (2,) px."""
    return np.array([camera.matrix[0, 0], camera.matrix[1, 1]]), camera.matrix[:2, 2]


def _angles(points: np.ndarray, camera: CameraModel) -> np.ndarray:
    """Angles (N, 2) rad to the right and downwards of points (N, 2) px."""
    focal, middle = _lens(camera)
    return np.arctan((points - middle) / focal)


def _pixels(angles: np.ndarray, camera: CameraModel) -> np.ndarray:
    """Points (N, 2) px of angles (N, 2) rad; those behind the camera are far outside the image."""
    focal, middle = _lens(camera)
    return np.tan(np.clip(angles, -1.4, 1.4)) * focal + middle
