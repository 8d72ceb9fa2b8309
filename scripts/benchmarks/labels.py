"""Labelled real faces: reading a table of labels, the images it speaks of, and eyes that are open or closed
(eyes.txt)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

import cv2
import numpy as np


@dataclass(frozen=True)
class LabelledFace:
    """One face of a picture or film.

    file: below the models directory; frame: of a film, from 0; x, y: a point between the eyes as a fraction of the
    image's width and height; label: what a person saw.
    """

    file: str
    frame: int
    x: float
    y: float
    label: str

    @property
    def closed(self) -> bool:
        """Whether the label is that of closed eyes."""
        return self.label == "closed"


def read_labels(path: Path, legal: Optional[Sequence[str]] = None) -> List[LabelledFace]:
    """Read a table of labels; legal: the labels that may stand there, None: any. Raises ValueError naming file and
    line."""
    labels = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            file, frame, x, y, label = line.split("\t")
            face = LabelledFace(file, int(frame), float(x), float(y), label)
        except ValueError as error:
            raise ValueError("{}, line {}: expected file, frame, x, y and label with tabs between, got {!r}".format(
                path, number, line)) from error
        if legal is not None and label not in legal:
            raise ValueError("{}, line {}: label {!r}, legal are {}".format(path, number, label, ", ".join(legal)))
        if face.frame < 0 or not (0.0 <= face.x <= 1.0 and 0.0 <= face.y <= 1.0):
            raise ValueError("{}, line {}: frame, x or y out of range".format(path, number))
        labels.append(face)
    return labels


def images(labels: Sequence[LabelledFace], directory: Path) -> Iterator[Tuple[List[LabelledFace], np.ndarray]]:
    """Yield (the labels of one image, the image (H, W, 3) uint8 BGR), file by file, frames in order.

    directory: of the models. Raises FileNotFoundError with the mend when a file is absent, ValueError when a film
    has fewer frames than the labels say or a picture cannot be read.
    """
    for file in sorted({label.file for label in labels}):
        path = directory / file
        if not path.is_file():
            raise FileNotFoundError("{} is absent; get it with `rosrun hri_pipeline fetch_models --models"
                                    " demo,evaluation`".format(path))
        by_frame: Dict[int, List[LabelledFace]] = {}
        for label in labels:
            if label.file == file:
                by_frame.setdefault(label.frame, []).append(label)
        for frame, image in frames(path, sorted(by_frame)):
            yield by_frame[frame], image


def frames(path: Path, wanted: Sequence[int]) -> Iterator[Tuple[int, np.ndarray]]:
    """Yield (number, image) of the wanted frames (rising) of a film; a picture has the frame 0.

    Frames are counted while reading: seeking by number is inexact in compressed films. Raises ValueError naming
    the file when a frame is not there.
    """
    capture = cv2.VideoCapture(str(path))
    try:
        number = -1
        for frame in wanted:
            while number < frame:
                if not capture.grab():
                    raise ValueError("{} has no frame {}".format(path, frame))
                number += 1
            found, image = capture.retrieve()
            if not found:
                raise ValueError("frame {} of {} cannot be read".format(frame, path))
            yield frame, image
    finally:
        capture.release()


def nearest_face(label: LabelledFace, boxes: np.ndarray, shape: Sequence[int]) -> Optional[int]:
    """Return the index of the face box (N, 4) px whose middle is nearest to the label, of those that hold its point.

    shape: of the image (H, W, ...). None when no box holds it: the face was not found.
    """
    point = np.array([label.x * shape[1], label.y * shape[0]])
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 4)
    inside = ((boxes[:, :2] <= point) & (point <= boxes[:, 2:])).all(axis=1)
    if not inside.any():
        return None
    distance = np.linalg.norm((boxes[:, :2] + boxes[:, 2:]) / 2.0 - point, axis=1)
    return int(np.argmin(np.where(inside, distance, np.inf)))


__all__ = ["TABLE", "LabelledFace", "confusion", "frames", "images", "labelled_eyes", "nearest_face"]

TABLE = Path(__file__).with_name("eyes.txt")


def labelled_eyes(path: Optional[Path] = None) -> List[LabelledFace]:
    """Read the labels (`open` or `closed`), by default those of this package.

    Raises ValueError naming file and line.
    """
    return read_labels(path or TABLE, ("open", "closed"))


def confusion(labels: Sequence[LabelledFace], predicted: Sequence[Optional[bool]]) -> Dict[str, int]:
    """Count closed found closed (tp), open found closed (fp), open found open (tn), closed found open (fn).

    predicted: one per label, None where there was no answer: counted as `unknown`. Raises ValueError when the
    lengths differ.
    """
    if len(labels) != len(predicted):
        raise ValueError("{} labels and {} answers".format(len(labels), len(predicted)))
    table = {"tp": 0, "fp": 0, "tn": 0, "fn": 0, "unknown": 0}
    for label, answer in zip(labels, predicted):
        if answer is None:
            table["unknown"] += 1
        elif label.closed:
            table["tp" if answer else "fn"] += 1
        else:
            table["fp" if answer else "tn"] += 1
    return table
