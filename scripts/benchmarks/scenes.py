"""Pictures with exactly 1, 3 or 10 real people, put together from the demo photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Tuple

import cv2
import numpy as np

WIDTH, HEIGHT = 1280, 720
BACKGROUND = 40

# Of each part: photograph; left, top, right, bottom of the cut as fractions of it; left, top, width, height
# of its place in the scene, px. A part keeps its proportions and stands in the middle of its place.
# The ten are nine people: one of sample1 is one of sample3, too (demo_03 in identities.txt); so nine are recognised.
Part = Tuple[str, Tuple[float, float, float, float], Tuple[int, int, int, int]]
SCENES: Dict[int, Tuple[Part, ...]] = {
    1: (("sample3.jpg", (0.0, 0.0, 0.47, 1.0), (0, 0, WIDTH, HEIGHT)),),
    3: (("sample3.jpg", (0.0, 0.0, 1.0, 1.0), (0, 0, WIDTH, HEIGHT)),),
    10: (("sample6.jpg", (0.05, 0.05, 1.0, 1.0), (0, 0, 640, HEIGHT)),
         ("sample3.jpg", (0.0, 0.07, 1.0, 0.91), (640, 0, 640, 360)),
         ("sample1.jpg", (0.0, 0.09, 1.0, 0.95), (640, 360, 640, 360))),
}


def make_scene(people: int, photographs: Path) -> np.ndarray:
    """Return the (720, 1280, 3) BGR picture with this number of people.

    Raises ValueError for another number than those of SCENES, OSError when a photograph is missing.
    """
    if people not in SCENES:
        raise ValueError("there is no scene with {} people; there are: {}".format(
            people, ", ".join(str(number) for number in sorted(SCENES))))
    scene = np.full((HEIGHT, WIDTH, 3), BACKGROUND, np.uint8)
    for name, cut, place in SCENES[people]:
        picture = cv2.imread(str(photographs / name))
        if picture is None:
            raise OSError("photograph {} is missing; run `rosrun hri_pipeline fetch_models`".format(
                photographs / name))
        _paste(scene, _cut(picture, cut), place)
    return scene


def one_picture(path: Path) -> np.ndarray:
    """Return a whole photograph as a (720, 1280, 3) BGR picture. Raises OSError when it is missing."""
    scene, picture = np.full((HEIGHT, WIDTH, 3), BACKGROUND, np.uint8), cv2.imread(str(path))
    if picture is None:
        raise OSError("photograph {} is missing; run `rosrun hri_pipeline fetch_models`".format(path))
    _paste(scene, picture, (0, 0, WIDTH, HEIGHT))
    return scene


def _cut(picture: np.ndarray, cut: Tuple[float, float, float, float]) -> np.ndarray:
    height, width = picture.shape[:2]
    return picture[int(cut[1] * height):int(cut[3] * height), int(cut[0] * width):int(cut[2] * width)]


def _paste(scene: np.ndarray, part: np.ndarray, place: Tuple[int, int, int, int]) -> None:
    scale = min(place[2] / part.shape[1], place[3] / part.shape[0])
    width, height = int(part.shape[1] * scale), int(part.shape[0] * scale)
    left, top = place[0] + (place[2] - width) // 2, place[1] + (place[3] - height) // 2
    scene[top:top + height, left:left + width] = cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA)
