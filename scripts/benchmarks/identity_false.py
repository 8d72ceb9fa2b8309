"""Faces and bodies that are published of images in which nobody is: photographs of things and animals, and patterns.

Each image is shown for some seconds as a film of a slowly swaying camera, to the faces' and the bodies' stage. An
image counts when any face or body is published. The photographs are those of a directory (`no_people` among the
pictures of evaluation, or $ROS4HRI_NO_PEOPLE) with the directories `tuning` and `report`: somebody has looked at each,
and there is neither a human nor a statue, a painting or a drawing of one in it. Each is shown whole, and in parts. The
patterns are drawn anew each time from their numbers.

What is in `tuning`, and patterns of even numbers, was used to set thresholds; the figure is that of the others.
"""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Mapping, Sequence, Tuple

import cv2
import numpy as np

from benchmarks.report import models_directory
from hri_fullbody.core.parameters import BODIES
from hri_fullbody.core.pipeline import BodyPipeline
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.sources.image_sources import PictureMotion

WIDTH, HEIGHT = 640, 480
PARTS = 2
"""Parts of each photograph that are shown beside the whole."""
PATTERNS = 400
"""Patterns, of both halves."""
IMAGES, STEP = 9, 0.3
"""Images of each film, and the time between them, s."""
HFOV = np.deg2rad(53.0)


def gratings(random: np.random.RandomState) -> np.ndarray:
    """Stripes of one to three directions."""
    row, column = np.indices((HEIGHT, WIDTH))
    total = np.zeros((HEIGHT, WIDTH))
    for _ in range(random.randint(1, 4)):
        angle, wave = random.uniform(0.0, np.pi), np.exp(random.uniform(np.log(6.0), np.log(120.0)))
        value = np.sin((np.cos(angle) * column + np.sin(angle) * row) * 2.0 * np.pi / wave)
        total += np.sign(value) if random.rand() < 0.5 else value
    return _coloured(total, random)


def noise(random: np.random.RandomState) -> np.ndarray:
    """Clouds: noise of several scales."""
    total = np.zeros((HEIGHT, WIDTH))
    for octave in range(2, 8):
        size = (2 ** octave * 4 // 3, 2 ** octave)
        part = cv2.resize(random.randn(size[1], size[0]), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        total += part * random.uniform(0.5, 1.0) / 2.0 ** (octave * random.choice([0.0, 0.5, 1.0]))
    return _coloured(total, random)


def tiles(random: np.random.RandomState) -> np.ndarray:
    """One random cell again and again, as on wallpaper and cloth, mirrored now and then."""
    side = random.randint(20, 160)
    cell = cv2.resize(random.randint(0, 255, (random.randint(2, 8), random.randint(2, 8), 3), np.uint8), (side, side),
                      interpolation=random.choice([cv2.INTER_NEAREST, cv2.INTER_CUBIC]))
    if random.rand() < 0.6:
        cell = np.hstack([cell, cell[:, ::-1]])
    count = (HEIGHT // cell.shape[0] + 1, WIDTH // cell.shape[1] + 1, 1)
    return np.ascontiguousarray(np.tile(cell, count)[:HEIGHT, :WIDTH])


def discs(random: np.random.RandomState) -> np.ndarray:
    """Discs, rings and boxes: plates, knobs, sockets, wheels, windows."""
    image = np.full((HEIGHT, WIDTH, 3), random.randint(0, 255, 3), np.uint8)
    for _ in range(random.randint(3, 30)):
        place = (int(random.randint(WIDTH)), int(random.randint(HEIGHT)))
        radius, colour = int(random.randint(5, 130)), random.randint(0, 255, 3).tolist()
        if random.rand() < 0.3:
            cv2.rectangle(image, place, (place[0] + radius, place[1] + radius // 2), colour, -1)
            continue
        cv2.circle(image, place, radius, colour, -1, cv2.LINE_AA)
        for part in random.uniform(0.1, 0.9, random.randint(0, 4)):
            x, y = (int(value + radius * random.uniform(-0.4, 0.4)) for value in place)
            inner = random.randint(0, 255, 3).tolist()
            cv2.circle(image, (x, y), max(1, int(0.5 * part * radius)), inner, -1, cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), random.uniform(0.5, 2.5))


def text(random: np.random.RandomState) -> np.ndarray:
    """Letters of all sizes on signs."""
    image = np.full((HEIGHT, WIDTH, 3), random.randint(0, 255, 3), np.uint8)
    letters = list("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdeghkmnopqsuvwxyz0123456789&@%#?!")
    for _ in range(random.randint(4, 40)):
        word = "".join(random.choice(letters, random.randint(1, 12)))
        place = (int(random.randint(-40, WIDTH)), int(random.randint(HEIGHT)))
        size = float(np.exp(random.uniform(np.log(0.4), np.log(7.0))))
        cv2.putText(image, word, place, int(random.randint(0, 8)), size, random.randint(0, 255, 3).tolist(),
                    max(1, int(2.0 * size)), cv2.LINE_AA)
    return image


def branches(random: np.random.RandomState) -> np.ndarray:
    """Thick and thin lines that fork like limbs: trees, furniture, cables."""
    image = np.full((HEIGHT, WIDTH, 3), random.randint(60, 255, 3), np.uint8)
    for _ in range(random.randint(2, 9)):
        place, angle = random.uniform((0, 0), (WIDTH, HEIGHT)), random.uniform(0.0, 2.0 * np.pi)
        width, colour = random.uniform(4.0, 50.0), random.randint(0, 200, 3).tolist()
        for _ in range(random.randint(2, 7)):
            end = place + random.uniform(30.0, 130.0) * np.array([np.cos(angle), np.sin(angle)])
            cv2.line(image, tuple(place.astype(int).tolist()), tuple(end.astype(int).tolist()), colour, int(width) + 1,
                     cv2.LINE_AA)
            place, angle, width = end, angle + random.uniform(-1.2, 1.2), 0.8 * width
        cv2.circle(image, tuple(place.astype(int).tolist()), int(1.5 * width) + 3, colour, -1, cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), random.uniform(0.5, 2.0))


def _coloured(values: np.ndarray, random: np.random.RandomState) -> np.ndarray:
    """Return values (H, W) as an image between two colours."""
    low, high = np.percentile(values, (2, 98))
    part = np.clip((values - low) / max(1e-9, float(high - low)), 0.0, 1.0)[..., None]
    one, other = random.randint(0, 255, 3), random.randint(0, 255, 3)
    return (one + part * (other.astype(float) - one)).astype(np.uint8)


KINDS: Sequence[Callable[[np.random.RandomState], np.ndarray]] = (gratings, noise, tiles, discs, text, branches)


def patterns(tuning: bool, count: int = PATTERNS) -> Iterator[Tuple[str, np.ndarray]]:
    """Yield (name, image) of the patterns for tuning, of even numbers, or of the others."""
    for number in range(0 if tuning else 1, count, 2):
        kind = KINDS[number // 2 % len(KINDS)]
        yield "{} {}".format(kind.__name__, number), kind(np.random.RandomState(number))


def pictures_directory() -> Path:
    """Return where the photographs without people are."""
    return Path(os.environ.get("ROS4HRI_NO_PEOPLE") or models_directory() / "evaluation" / "no_people")


def photographs(tuning: bool) -> Iterator[Tuple[str, np.ndarray]]:
    """Yield (name, image) of the photographs for tuning, or of the others. Raises ValueError for what is no picture."""
    for path in sorted((pictures_directory() / ("tuning" if tuning else "report")).glob("*.jpg")):
        image = cv2.imread(str(path))
        if image is None:
            raise ValueError("{} is no picture".format(path))
        yield path.stem, image
        height, width = image.shape[:2]
        random = np.random.RandomState(len(path.name))
        for part in range(PARTS):
            side, x, y = random.uniform(0.35, 0.7), random.rand(), random.rand()
            left, top = int(x * (1.0 - side) * width), int(y * (1.0 - side) * height)
            crop = image[top:top + int(side * height), left:left + int(side * width)]
            yield "{} part {}".format(path.stem, part), crop


class Watcher:
    """Shows images to the stages of faces and bodies, and tells what was published."""

    def __init__(self) -> None:
        quick = {"action_units": False, "expression": False, "age_gender": False, "face_budget": 1000.0}
        self._faces = FacePipeline(FACES.resolve(quick))
        self._bodies = BodyPipeline(BODIES.resolve({}))
        self._stamp = 1000.0

    def close(self) -> None:
        """Release all resources."""
        self._faces.close()

    def published(self, image: np.ndarray) -> Dict[str, int]:
        """Return how many faces and bodies are published in the film of an image."""
        scale = float(WIDTH) / max(image.shape[:2])
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA if scale < 1.0 else
                           cv2.INTER_LINEAR)
        size = (image.shape[1], image.shape[0])
        motion, camera = PictureMotion(image, *size), CameraModel.from_fov(*size, HFOV)
        self._faces.reset()
        self._bodies.reset()
        self._stamp += 100.0
        found: Dict[str, set] = {"faces": set(), "bodies": set()}
        for index in range(IMAGES):
            view, stamp = motion.view(index * STEP), self._stamp + index * STEP
            found["faces"].update(face.id for face in self._faces.update(view, camera, stamp))
            found["bodies"].update(body.id for body in self._bodies.update(view, camera, stamp))
        return {name: len(ids) for name, ids in found.items()}


def counted(images: Iterator[Tuple[str, np.ndarray]], watcher: Watcher) -> Dict[str, object]:
    """Return how many images there are, in how many a face or a body is published, and which these are."""
    result: Dict[str, object] = {"images": 0}
    names: Dict[str, List[str]] = {"faces": [], "bodies": []}
    wrong = total = 0
    for name, image in images:
        total += 1
        found: Mapping[str, int] = watcher.published(image)
        wrong += any(found.values())
        for what, count in found.items():
            names[what] += [name] * bool(count)
    result.update(images=total, wrong=wrong, **names)
    return result


def measured(tuning: bool) -> Dict[str, Dict[str, object]]:
    """Return what is published of photographs and patterns, of those for tuning or of the others."""
    with closing(Watcher()) as watcher:
        return {"photographs": counted(photographs(tuning), watcher), "patterns": counted(patterns(tuning), watcher)}


def per_1000(result: Mapping[str, Mapping[str, object]]) -> float:
    """Return the images with a false face or body, of a thousand. Raises ValueError without an image."""
    total = sum(int(str(part["images"])) for part in result.values())
    if not total:
        raise ValueError("there is no image")
    return 1000.0 * sum(int(str(part["wrong"])) for part in result.values()) / total


def figures() -> Dict[str, object]:
    """Return `false_per_1000`, of the images that nothing was tuned with, and the details."""
    result = measured(tuning=False)
    counts = {name: part["images"] for name, part in result.items()}
    return {"false_per_1000": per_1000(result), "details": {"false": result},
            "input": "{} views of photographs ({}), {} patterns".format(
                counts["photographs"], pictures_directory(), counts["patterns"])}
