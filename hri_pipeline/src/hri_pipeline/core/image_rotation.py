"""Images of cameras that are mounted upside down or on their side: they are turned before people are looked for, and
what is found is turned back; only this module turns anything. And whether images stand upright: the networks find
people only where they do, and put others at wrong places."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Callable, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import BodyObservation, FaceObservation

AUTO = "auto"
CHOICES = (AUTO, "0", "90", "180", "270")
_CV_TURNS = {1: cv2.ROTATE_90_CLOCKWISE, 2: cv2.ROTATE_180, 3: cv2.ROTATE_90_COUNTERCLOCKWISE}
_QUARTER = 0.5 * math.pi
_KEPT = 0.25 * math.pi + math.radians(10.0)
"""Roll (rad) against the turned image up to which a turn is kept; a new one is that to the nearest quarter."""
_LEAST_TILT = math.sin(math.radians(15.0))
"""Sine of the angle between the view and the vertical below which the roll says nothing."""
_TURNS = tuple(np.array(rows, dtype=np.float64) for rows in (
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)), ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    ((-1, 0, 0), (0, -1, 0), (0, 0, 1)), ((0, 1, 0), (-1, 0, 0), (0, 0, 1))))
"""From vectors of the original optical frame to those of the turned one, by quarter turns clockwise."""
# A person who is so clear in one orientation of the image is far less so in all others: of five photographs .50 to .76
# upright, .43 at most turned.
_CLEAR = 0.5
# Faces are clear turned, too, but less: of 40 photographs 35 had .82 and more upright, .02 and more above all others.
_CLEAR_FACE, _BETTER = 0.82, 0.02
_CHECK_S = 10.0     # one more run of the detector, until somebody was seen upright
_NEEDED = 2
_OTHER_TURNS = (2, 1, 3)
_LEAST_TOLD_TILT = 0.5   # sine of the angle between the view and the vertical, below which no turn of the image is told

Detect = Callable[[np.ndarray], Tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ImageRotation:
    """A turn of the image about the optical axis.

    The turned image belongs to a turned optical frame, x right and y down in it. What is not turned (quarters 0) is
    returned as it is, not copied. Pixels have their centres at whole numbers.

    Attributes
    ----------
    quarters : int
        Quarter turns clockwise, 0 to 3, that make the turned image of the original one.
    width, height : int
        Size of the original image, px.
    """

    quarters: int
    width: int
    height: int

    @property
    def degrees(self) -> int:
        """The turn, degrees clockwise."""
        return 90 * self.quarters

    @property
    def matrix(self) -> np.ndarray:
        """Rotation (3, 3) from vectors of the original optical frame to those of the turned one."""
        return _TURNS[self.quarters]

    def image(self, image: np.ndarray) -> np.ndarray:
        """Turn an image (H, W) or (H, W, C), of any size."""
        return cv2.rotate(image, _CV_TURNS[self.quarters]) if self.quarters else image

    def camera(self, camera: CameraModel) -> CameraModel:
        """Return the model of the turned image of `camera`, scaled to the size of the image."""
        camera = camera.resized(self.width, self.height)
        return TurnedCamera.of(camera, self) if self.quarters else camera

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Turn points (N, 2 or more), x and y px and whatever stands behind them."""
        return _turned(points, self.quarters, self.width, self.height)

    def pixels_back(self, points: np.ndarray) -> np.ndarray:
        """Turn such points of the turned image back."""
        return self.back.pixels(points)

    def box_back(self, box: np.ndarray) -> np.ndarray:
        """Turn a box (4,) x0, y0, x1, y1 px back."""
        return self.back.box(box)

    def box(self, box: np.ndarray) -> np.ndarray:
        """Turn a box (4,) x0, y0, x1, y1 px."""
        if not self.quarters:
            return box
        corners = self.pixels(np.asarray(box, dtype=np.float64).reshape(2, 2))
        return np.concatenate([corners.min(axis=0), corners.max(axis=0)])

    def vectors(self, vectors: np.ndarray) -> np.ndarray:
        """Turn points or directions (..., 3) of the optical frame."""
        return vectors @ self.matrix.T if self.quarters else vectors

    def vectors_back(self, vectors: np.ndarray) -> np.ndarray:
        """Turn points or directions (..., 3) of the turned optical frame back."""
        return vectors @ self.matrix if self.quarters else vectors

    def pose(self, pose: Pose) -> Pose:
        """Return a pose in the turned optical frame of one in the original."""
        return Pose(self.matrix @ pose.rotation, self.matrix @ pose.translation) if self.quarters else pose

    def pose_back(self, pose: Pose) -> Pose:
        """Return a pose in the original optical frame of one in the turned."""
        return self.back.pose(pose)

    def of_camera(self, pose: Pose) -> Pose:
        """Return the pose of the turned optical frame, in the frame in which `pose` is that of the original."""
        return Pose(pose.rotation @ self.matrix.T, pose.translation) if self.quarters else pose

    def face_back(self, face: FaceObservation) -> FaceObservation:
        """Turn a face back that was seen in the turned image."""
        if not self.quarters:
            return face
        gaze = face.gaze
        if gaze is not None and gaze.direction is not None:
            gaze = replace(gaze, direction=self.vectors_back(gaze.direction))
        return replace(face, box=self.box_back(face.box), landmarks=self.pixels_back(face.landmarks),
                       mesh=self.pixels_back(face.mesh), gaze=gaze,
                       pose=None if face.pose is None else self.pose_back(face.pose))

    def body_back(self, body: BodyObservation) -> BodyObservation:
        """Turn a body back that was seen in the turned image."""
        if not self.quarters:
            return body
        return replace(
            body, box=self.box_back(body.box), keypoints=self.pixels_back(body.keypoints),
            keypoints_3d=self.vectors_back(body.keypoints_3d),
            pose=None if body.pose is None else self.pose_back(body.pose),
            head=None if body.head is None else self.pose_back(body.head),
            velocity=None if body.velocity is None else self.vectors_back(body.velocity),
            hands=None if body.hands is None else self.vectors_back(body.hands))

    def since(self, quarters: int) -> ImageRotation:
        """Return what turns the image that is turned by `quarters` into the one that is turned by this rotation."""
        width, height = (self.height, self.width) if quarters % 2 else (self.width, self.height)
        return ImageRotation((self.quarters - quarters) % 4, width, height)

    @cached_property
    def back(self) -> ImageRotation:
        """The turn of the turned image into the original one."""
        width, height = (self.height, self.width) if self.quarters % 2 else (self.width, self.height)
        return ImageRotation(-self.quarters % 4, width, height)


@dataclass(frozen=True)
class TurnedCamera(CameraModel):
    """The model of a turned image: every lens is that of `source`, so tangential distortion needs no other numbers.

    `matrix` has the focal lengths and the principal point of the turned image, without skew; `distortion` is that of
    the source.
    """

    source: CameraModel = field(repr=False)
    rotation: ImageRotation = field(repr=False)

    def __post_init__(self) -> None:
        """The source was checked."""

    @classmethod
    def of(cls, source: CameraModel, rotation: ImageRotation) -> TurnedCamera:
        """Return the model of the image of `source` after `rotation`."""
        sideways = bool(rotation.quarters % 2)
        focal = np.diag(source.matrix)[[1, 0, 2] if sideways else [0, 1, 2]]
        matrix = np.diag(focal)
        matrix[:2, 2] = rotation.pixels(source.matrix[None, :2, 2])[0]
        width, height = (source.height, source.width) if sideways else (source.width, source.height)
        return cls(width, height, matrix, source.distortion, source.distortion_model, source.calibration, source,
                   rotation)

    def normalise(self, pixels: np.ndarray) -> np.ndarray:
        """Map pixels of the turned image to undistorted rays of its optical frame."""
        rays = self.source.normalise(self.rotation.pixels_back(np.asarray(pixels, dtype=np.float64).reshape(-1, 2)))
        return np.asarray(rays @ self.rotation.matrix[:2, :2].T)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Map points of the turned optical frame to pixels of the turned image."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        return self.rotation.pixels(self.source.project(self.rotation.vectors_back(points)))

    def resized(self, width: int, height: int) -> CameraModel:
        """Return the model of the same view in an image of another size, px; itself when it has that size."""
        if (self.width, self.height) == (width, height):
            return self
        original = (height, width) if self.rotation.quarters % 2 else (width, height)
        return replace(self.rotation, width=original[0], height=original[1]).camera(self.source)


class RotationChooser:
    """The parameter `image_rotation` over time: a fixed one, or that by which the camera stands upright.

    quarters: the turn in use, quarters clockwise; auto: whether the camera's roll decides.
    """

    def __init__(self, setting: str = AUTO) -> None:
        if setting not in CHOICES:
            raise ValueError("image_rotation is {!r}; legal: {}".format(setting, ", ".join(CHOICES)))
        self.auto = setting == AUTO
        self.quarters = 0 if self.auto else int(setting) // 90
        self._decided = False

    def update(self, up: Optional[np.ndarray]) -> int:
        """Return the turn for an image, quarters clockwise; up: (3,) unit vector against gravity in its optical frame,
        None while that is not known: the turn stays, as it does while the camera looks nearly straight up or down."""
        if not self.auto or up is None or not math.hypot(up[0], up[1]) >= _LEAST_TILT:
            return self.quarters
        roll = math.atan2(-up[0], -up[1])
        limit = _KEPT if self._decided else 0.5 * _QUARTER
        if abs(math.remainder(roll - self.quarters * _QUARTER, math.tau)) > limit:
            self.quarters = int(round(roll / _QUARTER)) % 4
        self._decided = True
        return self.quarters


def _turned(points: np.ndarray, quarters: int, width: int, height: int) -> np.ndarray:
    if not quarters:
        return points
    points = np.array(points, dtype=np.float64)
    x, y = points[:, 0].copy(), points[:, 1].copy()
    points[:, 0] = {1: height - 1 - y, 2: width - 1 - x, 3: y}[quarters]
    points[:, 1] = {1: x, 2: height - 1 - y, 3: width - 1 - x}[quarters]
    return points


def quarter_turns(up: np.ndarray) -> Optional[int]:
    """Return by how many quarter turns anticlockwise an image stands upright (0 to 3); None where the camera looks
    steeply up or down. up: (3,) unit vector against gravity in the optical frame."""
    if math.hypot(up[0], up[1]) < _LEAST_TOLD_TILT:
        return None
    return int(round(math.atan2(up[0], -up[1]) / (0.5 * math.pi))) % 4


class ImageOrientation:
    """Finds out whether the images of a camera come turned, as of one that is mounted upside down.

    turn: quarter turns anticlockwise by which people stand upright in them; None while nobody was seen clearly.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all images."""
        self.turn: Optional[int] = None
        self._next: Optional[float] = None
        self._asked = self._seen = 0

    def images_turn(self) -> None:
        """Take note that images are turned otherwise from now on: of turned people nothing is known any more, and
        upright ones stay so, as it is gravity that turns the images."""
        if self.turn != 0:
            self.reset()

    def update(self, image: np.ndarray, scores: np.ndarray, stamp: float, detect: Detect) -> None:
        """Take an image of `stamp` (s) in which `detect` gave people with `scores`; at times `detect` is asked about
        the image as it stands after a turn. Once people were seen upright, the camera is."""
        if self.turn == 0:
            return
        if len(scores) and float(np.max(scores)) >= _CLEAR:
            self.turn = 0
            return
        if self._next is None or stamp < self._next:
            self._next = stamp + _CHECK_S if self._next is None else self._next
            return
        self._next = stamp + _CHECK_S
        turn = _OTHER_TURNS[self._asked % len(_OTHER_TURNS)]
        found = detect(np.ascontiguousarray(np.rot90(image, turn)))[1]
        if not len(found) or float(np.max(found)) < _CLEAR:
            self._asked, self._seen = self._asked + 1, 0
            return
        self._seen += 1
        if self._seen >= _NEEDED:
            self.turn = turn


class FaceOrientation:
    """The same by faces alone: all four orientations are compared at times, until the upright one was best twice.

    turn: as of ImageOrientation.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all images."""
        self.turn: Optional[int] = None
        self._next = -math.inf
        self._last: Optional[int] = None
        self._image: Optional[np.ndarray] = None    # whose orientations are asked about
        self._scores: List[float] = []

    def images_turn(self) -> None:
        """Take note that images are turned otherwise from now on: of turned people nothing is known any more, and
        upright ones stay so, as it is gravity that turns the images."""
        if self.turn != 0:
            self.reset()

    def update(self, image: np.ndarray, stamp: float, detect: Detect) -> None:
        """Take an image of `stamp` (s), that nobody writes to; every 10 s `detect` is asked about the four orientations
        of one, in as many calls: it costs time."""
        if self.turn == 0:
            return
        if self._image is None:
            if stamp < self._next:
                return
            self._next, self._image, self._scores = stamp + _CHECK_S, image, []
        found = detect(np.ascontiguousarray(np.rot90(self._image, len(self._scores))))[1]
        self._scores.append(float(np.max(found, initial=0.0)))
        if len(self._scores) == len(_TURNS):
            self._image = None
            self._compare(self._scores)

    def _compare(self, best: Sequence[float]) -> None:
        """Take the best scores of one image by its turn."""
        turn = int(np.argmax(best))
        _, second, first = sorted(best)[-3:]
        if first < _CLEAR_FACE or first - second < _BETTER:
            return
        if turn == self._last:
            self.turn = turn
        self._last = turn


_WORDS = ("upright", "a quarter turn anticlockwise", "half a turn", "a quarter turn clockwise")


def turned_problem(seen: Optional[int], transform: Optional[int], rotation: int = 0, by_gravity: bool = False) -> str:
    """Return what is wrong with the camera's mounting, and the mend; empty when all is well or not known.

    seen, transform: quarter turns anticlockwise by which images stand upright that were turned by `rotation` (degrees
    clockwise), as the people in them and the transform to ~up_frame tell; None: not known. by_gravity: the rotation is
    that of the transform.
    """
    transform = None if by_gravity else transform
    if seen == 0 and transform:
        return ("people stand upright in the images, but the transform to ~up_frame says that these are turned: they "
                "would be upright after {}. Mend: correct the transform of the camera".format(_WORDS[transform]))
    if not (seen or transform):
        return ""
    turned = ", which are turned by {} degrees clockwise already".format(rotation) if rotation else ""
    return ("the images come turned: {} after {}{}, so that bodies and faces are missed or at wrong places. Mend: {}set"
            " image_rotation:={}{}".format(
                "people are clear in them only" if seen else "by the transform to ~up_frame they would be upright",
                _WORDS[seen or transform or 0], turned,
                "correct the transform of the camera to ~up_frame, or " if by_gravity else "",
                (rotation - 90 * (seen or transform or 0)) % 360,
                "" if by_gravity else ", or up_frame with image_rotation:=auto"))
