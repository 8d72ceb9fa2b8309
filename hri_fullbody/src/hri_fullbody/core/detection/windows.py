"""Windows, the rotated squares of the image in which the pose network detects one body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Iterable, List, Optional, Tuple

import numpy as np

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import ImageRotation

LANDMARK_MARGIN = 1.25
# Windows for a person's box in the order in which they are worth trying: times how broad the person is at least tall,
# and the side of the window in units of that height. A box that ends at a table or at the rim of the image shows the
# upper part of a body: a window of its size squeezes a small figure into it. Of 38 people in photographs 37 are
# found in the first window with a breadth of 2.5, 38 with 3, 28 with 1.25 of the longer side.
PERSON_BOX_WINDOWS: Tuple[Tuple[float, float], ...] = ((2.75, 1.25), (1.0, 1.7), (3.5, 1.25), (1.0, 1.25))
_FLAT = 1.8     # a box that is so many times as broad as high is that of somebody who lies

# The network tells where the middle of the hips is and how far the body reaches around it.
CENTRE_LANDMARK, REACH_LANDMARK = 33, 34

# Side of the window in units of the face's size, in the order in which they are worth trying, and how far
# below the face its centre lies, in units of the side. Measured on 21 faces of six group photographs: window
# from the landmarks 11.4 face sizes wide (10 % and 90 %: 9.3, 12.7), centre 3.3 below the face. The smaller
# ones come first since they hold fewer neighbours.
FACE_WINDOW_SIZES: Tuple[float, ...] = (9.0, 7.0, 5.5, 11.5)
FACE_WINDOW_DROP = 0.3


@dataclass(frozen=True)
class Window:
    """A square of `size` px around `centre` (x, y) px, its x axis turned by `angle` rad towards the image's y."""

    centre: Tuple[float, float]
    size: float
    angle: float = 0.0

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for value in (*self.centre, self.size, self.angle)) or self.size <= 0.0:
            raise ValueError("a window needs finite numbers and a size above 0: {}".format(
                (self.centre, self.size, self.angle)))


@dataclass(frozen=True)
class FaceBox:
    """A face that somebody else tracks. box: (4,) x0, y0, x1, y1 px, the bounding box of its 70 landmarks.

    pose: face frame (origin at the sellion) in the optical frame, m; None when it is not known. stamp: of the image (s)
    in which it was seen; None: of the one that it is given with.
    """

    id: str
    box: np.ndarray
    pose: Optional[Pose] = None
    stamp: Optional[float] = None

    @cached_property
    def centre(self) -> np.ndarray:
        """Middle of the box (2,) px."""
        return (self.box[:2] + self.box[2:]) / 2.0

    @cached_property
    def size(self) -> float:
        """Side of the square of the same area, px: depends less on the view than height or width."""
        x0, y0, x1, y1 = self.box.tolist()
        return math.sqrt(max((x1 - x0) * (y1 - y0), 1.0))

    @classmethod
    def from_landmarks(cls, face_id: str, landmarks: np.ndarray, pose: Optional[Pose] = None) -> "FaceBox":
        """Make the box of landmarks (N, 2 or more) px. Raises ValueError when they are not finite or all one point."""
        points = np.asarray(landmarks, dtype=np.float64)[:, :2]
        box = np.concatenate([points.min(axis=0), points.max(axis=0)])
        x0, y0, x1, y1 = box.tolist()
        if not (math.isfinite(x1 - x0) and math.isfinite(y1 - y0)) or x1 - x0 < 1.0 or y1 - y0 < 1.0:
            raise ValueError("landmarks of face {} span no box: {}".format(face_id, box))
        return cls(face_id, box, pose)

    def turned(self, rotation: ImageRotation) -> FaceBox:
        """Return the face in the turned image and optical frame."""
        if not rotation.quarters:
            return self
        return FaceBox(self.id, rotation.box(self.box), None if self.pose is None else rotation.pose(self.pose),
                       self.stamp)

    def distance(self, point: np.ndarray) -> float:
        """How far a point (2,) px lies from the middle, larger of x and y, in face sizes: about 0.5 on the rim."""
        (x, y), (centre_x, centre_y) = point.tolist(), self._middle
        return max(abs(x - centre_x), abs(y - centre_y)) / self.size

    @cached_property
    def _middle(self) -> Tuple[float, float]:
        x, y = self.centre.tolist()
        return x, y


def face_boxes(faces: Iterable[Tuple[str, np.ndarray, Optional[Pose]]]) -> List[FaceBox]:
    """Boxes of faces: id, landmarks (N, 2 or more) px, pose. A face that spans no box says nothing about a body."""
    found = []
    for face_id, landmarks, pose in faces:
        known = pose is not None and np.isfinite(pose.rotation).all() and np.isfinite(pose.translation).all()
        try:
            found.append(FaceBox.from_landmarks(face_id, landmarks, pose if known else None))
        except ValueError:
            continue
    return found


def window_from_person_box(box: np.ndarray, attempt: int = 0) -> Window:
    """Window number `attempt` of PERSON_BOX_WINDOWS for a detected person's box (4,) px, hanging from its top."""
    x0, y0, x1, y1 = (float(value) for value in box)
    width, height = x1 - x0, y1 - y0
    breadths, margin = PERSON_BOX_WINDOWS[attempt]
    tall = max(width, height, breadths * min(width, height))
    return Window(((x0 + x1) / 2.0, (y0 + y1) / 2.0 if width > _FLAT * height else y0 + 0.5 * tall), margin * tall)


def window_from_face(face: FaceBox, side: float) -> Window:
    """Window for the body below an upright face, `side` face sizes a side."""
    x, y = face.centre
    size = side * face.size
    return Window((float(x), float(y + FACE_WINDOW_DROP * size)), size)


def window_from_landmarks(landmarks: np.ndarray) -> Window:
    """Window for the next image out of the landmarks (39, 2 or more) px of this one: upright along the body.

    Raises ValueError when the two auxiliary points coincide or are not finite.
    """
    centre, reach = landmarks[CENTRE_LANDMARK, :2], landmarks[REACH_LANDMARK, :2]
    offset = reach - centre
    x, y = offset.tolist()
    distance, angle = math.hypot(x, y), math.atan2(x, -y)
    return Window((float(centre[0]), float(centre[1])), 2.0 * LANDMARK_MARGIN * distance, angle)


def head_box(face: FaceBox) -> np.ndarray:
    """Box (4,) px of the head around the box of a face's landmarks, which ends at the brows."""
    x0, y0, x1, y1 = face.box.tolist()
    width, height = x1 - x0, y1 - y0
    return np.array([x0 - 0.1 * width, y0 - 0.3 * height, x1 + 0.1 * width, y1 + 0.05 * height])
