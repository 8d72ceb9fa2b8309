"""Where in the image there are people, as boxes."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import Callable, Deque, List, Optional, Protocol, Sequence, Tuple, Union

import cv2
import numpy as np

from hri_pipeline.core.geometry import iou_matrix
from hri_pipeline.core.onnx import OnnxModel
from hri_pipeline.core.process import ONE_THREAD, Threads

DEFAULT_FILE = "person_centernet.onnx"
_STEP = 32
_STRIDE = 4
_PERSON_CLASS = 0
_ANIMALS = [*range(14, 24), 77]     # the ten of COCO, and the teddy bear
_MAX_OVERLAP = 0.6
# Boxes of one thing overlap by so much; those of a rider and a horse, or of a chair and who sits on it, by less.
_SAME_THING = 0.8
# The look from near by: side of the input (px), and of what it shows in longer sides of the box; boxes that share more
# than _SAME_PLACE with it are its. Scores are compared from _NOTHING on.
_NEAR_SIZE, _NEAR_SHOWS, _SAME_PLACE, _NOTHING = 256, 1.3, 0.5, 0.02
# Of the leads of both looks over animals, multiplied. Cut-outs of animals and things: 16 of 19 have less; people on
# photographs that were cut, covered, darkened or shrunk: 0 of 262; with painted or cut heads: 2 of 133.
_LEAST_LEAD = 6.0
_REMEMBERED = 200
# What is shown around a face: half the side of a square, and how far its middle is below that of the face, in sizes of
# the face: head and shoulders; head and trunk.
_AROUND_FACE = ((1.4, 0.3), (2.4, 1.2))


class PersonDetector(Protocol):
    """Anything that finds people in an image. threshold: score from which they are returned; it may be changed."""

    threshold: float

    def detect(self, image: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return boxes (N, 4) x0, y0, x1, y1 px and scores (N,), best first, of `image` (H, W, 3) BGR."""
        ...

    def is_human(self, image: np.ndarray, box: np.ndarray) -> bool:
        """Tell of a box (4,) px that `detect` returned last whether it is a human in a second look, too."""
        ...

    def lead_around(self, image: np.ndarray, face: np.ndarray) -> float:
        """Return how many times the score of all else that of a person is, around a face's box (4,) px."""
        ...


def network_size(width: int, height: int, long_side: int) -> Tuple[int, int]:
    """Size (width, height) in px, multiples of 32, with the image's aspect and `long_side` at the longer side."""
    scale = long_side / float(max(width, height))
    steps = [max(1, int(round(side * scale / _STEP))) for side in (width, height)]
    return steps[0] * _STEP, steps[1] * _STEP


def decode_peaks(heat: np.ndarray, extents: np.ndarray, threshold: float) -> Tuple[np.ndarray, np.ndarray]:
    """Boxes (N, 4) in px of the network's input and scores (N,), best first.

    heat: (h, w) 0 to 1, one peak for each person. extents: (h, w, 4) distances left, top, right, bottom in px from the
    peak to the sides. A peak is the largest of its 3 x 3 cells. X. Zhou et al., "Objects as Points", 2019.
    """
    peaks = (heat >= threshold) & (heat >= cv2.dilate(heat, np.ones((3, 3), np.uint8)))
    rows, columns = np.nonzero(peaks)
    scores = heat[rows, columns].astype(np.float64)
    centres = np.stack([columns, rows], axis=1) * float(_STRIDE)
    sides = extents[rows, columns].astype(np.float64)
    boxes = np.concatenate([centres - sides[:, :2], centres + sides[:, 2:]], axis=1)
    order = np.argsort(-scores)
    return boxes[order], scores[order]


def decode_centres(heat: np.ndarray, extents: np.ndarray, threshold: float) -> Tuple[np.ndarray, np.ndarray]:
    """Like `decode_peaks`, but of boxes that overlap by more than 0.6 the best stays."""
    boxes, scores = decode_peaks(heat, extents, threshold)
    overlap = iou_matrix(boxes, boxes)
    kept: List[int] = []
    for index in range(len(boxes)):
        if all(overlap[index, other] <= _MAX_OVERLAP for other in kept):
            kept.append(index)
    return boxes[kept], scores[kept]


def suppressed(boxes: np.ndarray, scores: np.ndarray, rivals: np.ndarray, rival_scores: np.ndarray) -> np.ndarray:
    """Tell (N,) which boxes (N, 4) of people are rather those of rivals (M, 4), other things with higher scores."""
    same = iou_matrix(boxes, rivals) >= _SAME_THING
    return np.any(same & (rival_scores[None] > scores[:, None]), axis=1)


def class_scores(heat: np.ndarray, extents: np.ndarray, classes: Sequence[int], boxes: np.ndarray) -> np.ndarray:
    """Highest score (N,) of one of some classes at the place of each of `boxes` (N, 4), 0 where there is none.

    heat: (h, w, 80). extents: see `decode_peaks`.
    """
    found, scores = decode_peaks(np.ascontiguousarray(heat[:, :, list(classes)].max(axis=2)), extents, 0.5 * _NOTHING)
    if not len(found):
        return np.zeros(len(boxes))
    return np.where(iou_matrix(boxes, found) > _SAME_PLACE, scores[None], 0.0).max(axis=1)


def near_view(image: np.ndarray, box: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return a square of 256 px around a box (4,) px, grey outside the image, and the box in it."""
    middle, half = 0.5 * (box[:2] + box[2:]), 0.5 * _NEAR_SHOWS * float(max(box[2:] - box[:2]))
    scale = _NEAR_SIZE / (2.0 * half)
    x, y = (half - middle) * scale
    return _warped(image, scale, x, y), box * scale + np.array([x, y, x, y])


def views_around(image: np.ndarray, face: np.ndarray) -> Tuple[List[np.ndarray], np.ndarray]:
    """Return two squares of 256 px around the box (4,) px of a face: with the shoulders, and with the trunk, and the
    places (2, 2) of the middle of the face in them. Grey outside the image."""
    middle, size = 0.5 * (face[:2] + face[2:]), max(1.0, float(max(face[2:] - face[:2])))
    views, places = [], []
    for half, below in _AROUND_FACE:
        scale = _NEAR_SIZE / (2.0 * half * size)
        x, y = half * size * scale - (middle + (0.0, below * size)) * scale
        views.append(_warped(image, scale, x, y))
        places.append(middle * scale + (x, y))
    return views, np.array(places)


def _warped(image: np.ndarray, scale: float, x: float, y: float) -> np.ndarray:
    """Return a square of 256 px of an image that is scaled, and moved by x, y px then; grey outside the image."""
    return cv2.warpAffine(image, np.array([[scale, 0.0, x], [0.0, scale, y]]), (_NEAR_SIZE, _NEAR_SIZE),
                          borderMode=cv2.BORDER_CONSTANT, borderValue=(128, 128, 128))


def best_at(heat: np.ndarray, extents: np.ndarray, place: np.ndarray) -> float:
    """Highest score of a box around a place (2,) px, 0 without one. heat, extents: see `decode_peaks`."""
    boxes, scores = decode_peaks(heat, extents, 0.5 * _NOTHING)
    inside = np.all((boxes[:, :2] < place) & (boxes[:, 2:] > place), axis=1)
    return float(scores[inside][0]) if inside.any() else 0.0


def _shapes(long_side: int) -> Sequence[Tuple[int, ...]]:
    """Shapes of the network's input for usual cameras, 16:9 and 4:3, and for a look from near by."""
    sizes = [network_size(*camera, long_side) for camera in ((1280, 720), (640, 480))]
    return [(1, height, width, 3) for width, height in sizes] + [(2, _NEAR_SIZE, _NEAR_SIZE, 3)]


class CenterNetDetector:
    """CenterNet on MobileNetV3, trained on COCO: people, and not what its 79 other classes claim with more right."""

    def __init__(
        self,
        path: Union[str, Path],
        providers: Sequence[str] = ("cpu",),
        notify: Optional[Callable[[str], None]] = None,
        threshold: float = 0.3,
        long_side: int = 512,
        threads: Threads = ONE_THREAD,
    ) -> None:
        """threshold: 0 to 1. long_side: px of the network's input. threads: those that may run it beside other
        networks. Raises ValueError outside of these."""
        if not 0.0 < threshold < 1.0:
            raise ValueError("threshold {} must lie between 0 and 1".format(threshold))
        if long_side < _STEP:
            raise ValueError("long_side is {} px, legal range {} and more".format(long_side, _STEP))
        self._model = OnnxModel(path, providers, inputs=("images",), outputs=("heat", "ltrb"), notify=notify,
                                threads=threads, shapes=_shapes(long_side), most_on_cpu=1)
        self.threads = threads
        self.threshold = threshold
        self._long_side = long_side
        self._leads: Deque[Tuple[bytes, float]] = deque(maxlen=_REMEMBERED)

    def detect(self, image: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Return boxes (N, 4) px inside `image` (H, W, 3) BGR and scores (N,) 0 to 1, best first."""
        height, width = image.shape[:2]
        size = network_size(width, height, self._long_side)
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        feed = cv2.cvtColor(small, cv2.COLOR_BGR2RGB).astype(np.float32)
        output = self._model.run({"images": feed[None]})
        heat, extents = output["heat"][0], output["ltrb"][0]
        boxes, scores = decode_centres(
            np.ascontiguousarray(heat[:, :, _PERSON_CLASS]), extents, self.threshold)
        if not len(boxes):
            return boxes, scores
        others = heat[:, :, _PERSON_CLASS + 1:].max(axis=2)
        kept = ~suppressed(boxes, scores, *decode_centres(others, extents, self.threshold))
        boxes, scores = boxes[kept], scores[kept]
        animals = class_scores(heat, extents, _ANIMALS, boxes)
        boxes = boxes * np.array([width / size[0], height / size[1]] * 2)
        boxes = np.clip(boxes, 0.0, [width, height, width, height])
        solid = np.all(boxes[:, 2:] - boxes[:, :2] >= 2.0, axis=1)
        self._leads.extend((box.tobytes(), _lead(score, animal)) for box, score, animal in zip(
            boxes[solid], scores[solid], animals[solid]))
        return boxes[solid], scores[solid]

    def is_human(self, image: np.ndarray, box: np.ndarray) -> bool:
        """Look again, from near by and in the mirror, whether a box (4,) px of `detect` leads over animals and toys by
        far: an animal that resembles a human in one look seldom does in the other."""
        view, place = near_view(image, box)
        mirrored = np.array([_NEAR_SIZE - place[2], place[1], _NEAR_SIZE - place[0], place[3]])
        feed = cv2.cvtColor(view, cv2.COLOR_BGR2RGB).astype(np.float32)
        output = self._model.run({"images": np.stack([feed, feed[:, ::-1]])})
        person, animal = (sum(float(class_scores(heat, extents, classes, one[None])[0]) for heat, extents, one in zip(
            output["heat"], output["ltrb"], (place, mirrored))) for classes in ([_PERSON_CLASS], _ANIMALS))
        return bool(_lead(person, animal) * dict(self._leads).get(box.tobytes(), 1.0) >= _LEAST_LEAD)

    def lead_around(self, image: np.ndarray, face: np.ndarray) -> float:
        """Look from near by whether there is a person around a face's box (4,) px, rather than an animal or a thing."""
        views, places = views_around(image, face)
        feed = np.stack([cv2.cvtColor(view, cv2.COLOR_BGR2RGB) for view in views]).astype(np.float32)
        output = self._model.run({"images": feed})
        person = other = 0.0
        for heat, extents, place in zip(output["heat"], output["ltrb"], places):
            person += best_at(np.ascontiguousarray(heat[:, :, _PERSON_CLASS]), extents, place)
            other += best_at(heat[:, :, _PERSON_CLASS + 1:].max(axis=2), extents, place)
        return _lead(person, other)


def _lead(person: float, other: float) -> float:
    return (person + _NOTHING) / (other + _NOTHING)
