"""Bodies that return and bodies that cross: the part `returns` of scripts/benchmark identity."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_fullbody.core.parameters import BODIES
from hri_fullbody.core.pipeline import BodyPipeline
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.score.metrics import MotFrame, box_distance, clear_mot, identity_scores

LABELS = Path(__file__).with_name("vtest.txt")
RATE = 10.0
"""Images of vtest.avi per second."""
FIELD_OF_VIEW = 1.05
"""Horizontal, rad: what the stack takes a camera without calibration to have."""
_SAME_PLACE = 0.5
_OF_STAY = 0.6
"""Part of a body's images in which it has to lie on one human for it to be that human."""


class FilmError(RuntimeError):
    """The film is not there."""


@dataclass(frozen=True)
class Stay:
    """One stay of somebody in the image. boxes: (N, 4) px at `frames` (N,), rising. hidden: first and last image."""

    name: str
    frames: np.ndarray
    boxes: np.ndarray
    hidden: Tuple[Tuple[int, int], ...]

    def box(self, frame: int) -> Optional[np.ndarray]:
        """Box (4,) px in an image; None before and after the stay."""
        if not self.frames[0] <= frame <= self.frames[-1]:
            return None
        return np.array([np.interp(frame, self.frames, self.boxes[:, column]) for column in range(4)])

    def is_hidden(self, frame: int) -> bool:
        """Tell whether the person need not be found in an image."""
        return any(first <= frame <= last for first, last in self.hidden)


def read_labels(path: Path = LABELS) -> List[Stay]:
    """Read who is where in vtest.avi. Raises ValueError for a line of another kind."""
    boxes: Dict[str, List[Tuple[float, ...]]] = {}
    hidden: Dict[str, List[Tuple[int, int]]] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, *rest = line.split() or ["#"]
        if kind == "box":
            boxes.setdefault(rest[0], []).append(tuple(float(value) for value in rest[1:6]))
        elif kind == "hidden":
            hidden.setdefault(rest[0], []).append((int(rest[1]), int(rest[2])))
        elif not kind.startswith("#"):
            raise ValueError("{}: {!r} is neither a box nor hidden".format(path, line))
    return [Stay(name, np.array(rows)[:, 0], np.array(rows)[:, 1:], tuple(hidden.get(name, ())))
            for name, rows in boxes.items()]


def find_film() -> Path:
    """Return the path of vtest.avi: $ROS4HRI_VTEST, the cache, or Debian's package opencv-doc. Raises FilmError."""
    cache = Path(os.environ.get("ROS4HRI_CACHE", str(Path.home() / ".cache" / "ros4hri")))
    listed = subprocess.run(["dpkg", "-L", "opencv-doc"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                            universal_newlines=True, check=False).stdout.split()
    for path in [Path(os.environ.get("ROS4HRI_VTEST", "")), cache / "vtest.avi"] + [
            Path(name) for name in listed if name.endswith("/vtest.avi")]:
        if path.is_file():
            return path
    raise FilmError("vtest.avi is not there: `apt-get install opencv-doc` brings it, ROS4HRI_VTEST names its path")


def images(path: Path) -> Iterator[np.ndarray]:
    """Yield the images (H, W, 3) BGR of a film."""
    film = cv2.VideoCapture(str(path))
    while True:
        read, image = film.read()
        if not read:
            return
        yield image


class FilmTrack(NamedTuple):
    """What the pipeline makes of the film: boxes by id of each image, and (image, id, earlier id, likelihood) told."""

    boxes: List[Dict[str, np.ndarray]]
    told: List[Tuple[int, str, str, float]]


def track_film(path: Path, settings: Mapping[str, object] = {}) -> FilmTrack:
    """Run the body pipeline, as the node `bodies` would, over the film."""
    pipeline = BodyPipeline(BODIES.resolve(dict(settings)))
    boxes: List[Dict[str, np.ndarray]] = []
    told: List[Tuple[int, str, str, float]] = []
    camera: Optional[CameraModel] = None
    for number, image in enumerate(images(path)):
        camera = camera or CameraModel.from_fov(image.shape[1], image.shape[0], FIELD_OF_VIEW)
        bodies = pipeline.update(image, camera, number / RATE)
        boxes.append({body.id: body.box for body in bodies})
        told += [(number, item.id, item.earlier, item.likelihood) for item in pipeline.reidentified]
    return FilmTrack(boxes, told)


def frames_of(track: FilmTrack, stays: Sequence[Stay]) -> List[MotFrame]:
    """Pair what was found with the labels, image by image."""
    frames = []
    for number, found in enumerate(track.boxes):
        truth = {stay.name: stay.box(number) for stay in stays}
        there = {name: tuple(box) for name, box in truth.items() if box is not None}
        needed = {stay.name for stay in stays if stay.name in there and not stay.is_hidden(number)}
        frames.append(MotFrame(there, {key: tuple(box) for key, box in found.items()}, needed))
    return frames
