"""Synthetic people for the tests: landmarks of a standing body, and a pose estimator that knows where they are."""

from __future__ import annotations

from typing import List, Optional, Sequence, Tuple

import numpy as np

from hri_fullbody.core.detection.pose_estimator import PoseEstimate
from hri_fullbody.core.detection.windows import FaceBox, Window

# Metres around the middle of the hips, in the axes of an image: a person who stands and faces the camera.
STANDING = np.zeros((33, 3))
STANDING[0:11] = [
    (0.0, -0.62, -0.14), (0.02, -0.66, -0.12), (0.03, -0.66, -0.11), (0.05, -0.66, -0.10),
    (-0.02, -0.66, -0.12), (-0.03, -0.66, -0.11), (-0.05, -0.66, -0.10),
    (0.08, -0.64, 0.0), (-0.08, -0.64, 0.0), (0.03, -0.58, -0.12), (-0.03, -0.58, -0.12)]
STANDING[11:23] = [
    (0.17, -0.48, 0.0), (-0.17, -0.48, 0.0), (0.22, -0.2, 0.02), (-0.22, -0.2, 0.02),
    (0.2, 0.04, -0.06), (-0.2, 0.04, -0.06),
    (0.2, 0.1, -0.07), (-0.2, 0.1, -0.07), (0.2, 0.12, -0.07), (-0.2, 0.12, -0.07),
    (0.19, 0.1, -0.05), (-0.19, 0.1, -0.05)]
STANDING[23:33] = [
    (0.1, 0.0, 0.0), (-0.1, 0.0, 0.0), (0.11, 0.42, -0.02), (-0.11, 0.42, -0.02),
    (0.11, 0.82, 0.04), (-0.11, 0.82, 0.04),
    (0.11, 0.86, 0.07), (-0.11, 0.86, 0.07), (0.12, 0.87, -0.08), (-0.12, 0.87, -0.08)]


def standing_at(x: float, y: float, scale: float = 200.0, score: float = 0.95) -> PoseEstimate:
    """Estimate of a standing person whose hips are at (x, y) px, `scale` px per metre."""
    landmarks = np.zeros((39, 3))
    landmarks[:33] = STANDING * scale + np.array([x, y, 0.0])
    landmarks[33] = (x, y, 0.0)
    landmarks[34] = (x, y - 0.9 * scale, 0.0)
    return PoseEstimate(score, landmarks, np.full(39, 0.95), STANDING.copy())


def face_of(estimate: PoseEstimate, face_id: str) -> FaceBox:
    """The box of the face of a synthetic person."""
    x, y = estimate.nose
    half = 0.08 * float(np.hypot(*(estimate.landmarks[34, :2] - estimate.landmarks[33, :2]))) / 0.9
    return FaceBox(face_id, np.array([x - half, y - half, x + half, y + half]))


def textured() -> np.ndarray:
    """A picture (720, 1280, 3) of many rectangles, whose corners tell of a zoom."""
    random = np.random.default_rng(3)
    image = np.full((720, 1280, 3), 110, np.uint8)
    for x, y, w, h in zip(*random.integers(((0,), (0,), (12,), (12,)), ((1280,), (720,), (120,), (120,)), (4, 400))):
        image[y:y + h, x:x + w] = random.integers(0, 255, 3)
    return image


class Scene:
    """A pose estimator that gives the person nearest to the middle of the window whose head is not hidden."""

    def __init__(self, people: Sequence[Tuple[float, float]]) -> None:
        self.people: List[Tuple[float, float]] = list(people)
        self.windows: List[Window] = []
        self.favourite: Optional[int] = None
        self.scale = 200.0      # px per metre

    def estimate(self, image: np.ndarray, window: Window, hidden: Sequence[np.ndarray] = (),
                 shown: Optional[np.ndarray] = None, mirrored: bool = False) -> PoseEstimate:
        self.windows.append(window)
        best, least = None, window.size / 2.0
        for index, (x, y) in enumerate(self.people):
            candidate = standing_at(x, y, self.scale)
            nose = candidate.nose
            if any(box[0] < nose[0] < box[2] and box[1] < nose[1] < box[3] for box in hidden):
                continue
            distance = max(abs(x - window.centre[0]), abs(y - window.centre[1]))
            if index == self.favourite and distance < window.size:
                return candidate
            if distance < least:
                best, least = candidate, distance
        return best if best is not None else standing_at(*window.centre, score=0.01)


class Walkers(Scene):
    """People of different colours who hide those behind them: the last one of `people` stands in front."""

    def __init__(self, people: Sequence[Tuple[float, float]], colours: Sequence[Tuple[int, int, int]],
                 reach: float = 60.0) -> None:
        """reach: px; a person whose hips are nearer than this to those of somebody before them is not seen."""
        super().__init__(people)
        self.colours = list(colours)
        self.reach = reach
        self._painted: tuple = (None, None)

    def visible(self) -> List[int]:
        """Numbers of the people who are not hidden."""
        return [index for index, (x, _) in enumerate(self.people)
                if not any(abs(x - other) < self.reach for other, _ in self.people[index + 1:])]

    def image(self) -> np.ndarray:
        """The picture (720, 1280, 3) of the people: each a coloured rectangle from the shoulders to the knees."""
        now = (tuple(self.people), tuple(self.colours))
        if now != self._painted[0]:
            picture = np.full((720, 1280, 3), 90, np.uint8)
            for (x, y), colour in zip(self.people, self.colours):
                left, right = int(max(0, x - 45)), int(max(0, x + 45))
                picture[int(max(0, y - 110)):int(y + 90), left:right] = colour
            self._painted = (now, picture)
        return self._painted[1]

    def estimate(self, image: np.ndarray, window: Window, hidden: Sequence[np.ndarray] = (),
                 shown: Optional[np.ndarray] = None, mirrored: bool = False) -> PoseEstimate:
        everybody = self.people
        self.people = [everybody[index] for index in self.visible()]
        try:
            return super().estimate(image, window, hidden, shown, mirrored)
        finally:
            self.people = everybody


class Phantoms(Walkers):
    """Like the network: where no head is left in a window, a body is made of the trunk beside a painted head."""

    def estimate(self, image: np.ndarray, window: Window, hidden: Sequence[np.ndarray] = (),
                 shown: Optional[np.ndarray] = None, mirrored: bool = False) -> PoseEstimate:
        found = super().estimate(image, window, hidden, shown, mirrored)
        seen = [self.people[index] for index in self.visible()
                if abs(self.people[index][0] - window.centre[0]) < window.size / 2.0]
        if found.score > 0.5 or not seen:
            return found
        made = standing_at(*min(seen, key=lambda place: abs(place[0] - window.centre[0])))
        made.landmarks[:11, 0] -= 18.0      # 0.05 sizes
        made.landmarks[11:, 0] -= 45.0
        return made
