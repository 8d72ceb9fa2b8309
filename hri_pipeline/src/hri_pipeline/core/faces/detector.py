"""Face detection with the full-range BlazeFace network.

The network is a single-shot detector: a 48 x 48 grid of anchors over a square input of 192 px, one
score and sixteen numbers (box and six key points) per anchor. Regions of any size and aspect are
letter-boxed into the square, so a detection can be asked for the whole image, for tiles of it, or for
several of them in one batch. Box and key point layout: MediaPipe's published model card (Apache-2.0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.geometry import iou_matrix
from hri_pipeline.core.onnx import BATCH_SIZES, FETCH_HINT, ModelError, OnnxModel, model_path
from hri_pipeline.core.process import ONE_THREAD, Threads

INPUT_SIZE = 192
ANCHOR_STRIDES = (4,)
ANCHORS_PER_CELL = 1
KEYPOINTS = 6
RIGHT_EYE_KEYPOINT, LEFT_EYE_KEYPOINT = 0, 1
"""Indices of the subject's eyes among the six key points."""
NMS_IOU = 0.3
AGAIN = 2.0
"""Half the side of the square in which a face is looked for again, in its sizes: so large the network sees it best."""
AGAIN_NEAR, AGAIN_LEAST, AGAIN_MOST = 0.4, 0.5, 1.6
"""Distance of the face that is found again, and its least and largest width, in sizes of the first one."""
TILE_OVERLAP = 0.25

Region = Tuple[int, int, int, int]
Found = Tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class FaceDetection:
    """One detected face, in pixels of the whole image.

    box: (4,) x0, y0, x1, y1; keypoints: (6, 2) right eye, left eye, nose tip, mouth, right ear, left
    ear (the subject's right and left); score: 0..1.
    """

    box: np.ndarray
    keypoints: np.ndarray
    score: float


def ssd_anchors(size: int, strides: Sequence[int], per_cell: int) -> np.ndarray:
    """Anchor centres of a fixed-size-anchor SSD, (N, 2) as fractions of the input square.

    Consecutive equal strides share one grid with their anchors interleaved per cell.
    Raises ValueError when a stride or the size is not positive.
    """
    if size <= 0 or per_cell <= 0 or any(stride <= 0 for stride in strides):
        raise ValueError("size, strides and anchors per cell must be positive")
    grids, index = [], 0
    while index < len(strides):
        run = index
        while run < len(strides) and strides[run] == strides[index]:
            run += 1
        cells = -(-size // strides[index])
        axis = (np.arange(cells) + 0.5) / cells
        x, y = np.meshgrid(axis, axis)
        grid = np.stack([x.ravel(), y.ravel()], axis=1)
        grids.append(np.repeat(grid, per_cell * (run - index), axis=0))
        index = run
    return np.concatenate(grids).astype(np.float32)


def weighted_nms(
    boxes: np.ndarray, keypoints: np.ndarray, scores: np.ndarray, iou: float = NMS_IOU
) -> List[FaceDetection]:
    """Merge overlapping detections into their score-weighted mean, best score first.

    boxes: (N, 4) px; keypoints: (N, 6, 2) px; scores: (N,) 0..1. Averaging instead of discarding keeps the box
    steady between frames (BlazeFace, Bazarevsky et al. 2019). A merged detection has the best score of its group.
    """
    order = np.argsort(-scores, kind="stable")
    overlap = iou_matrix(boxes, boxes) > iou
    free = np.ones(len(scores), bool)
    merged = []
    for best in order:
        if not free[best]:
            continue
        group = overlap[best] & free
        group[best] = True
        free &= ~group
        weights = scores[group] / scores[group].sum()
        merged.append(FaceDetection(weights @ boxes[group], np.tensordot(weights, keypoints[group], axes=1),
                                    float(scores[best])))
    return merged


def tile_regions(width: int, height: int, tiles: int) -> List[Region]:
    """`tiles` x `tiles` regions that cover the image and overlap by TILE_OVERLAP; [] for tiles < 2."""
    if tiles < 2:
        return []
    tile_width = int(np.ceil(width / (tiles - (tiles - 1) * TILE_OVERLAP)))
    tile_height = int(np.ceil(height / (tiles - (tiles - 1) * TILE_OVERLAP)))
    regions = []
    for row in range(tiles):
        for column in range(tiles):
            x0 = round(column * (width - tile_width) / (tiles - 1))
            y0 = round(row * (height - tile_height) / (tiles - 1))
            regions.append((x0, y0, x0 + tile_width, y0 + tile_height))
    return regions


def wide_region(width: int, height: int) -> Region:
    """The image with a border of a quarter of its longer side: the network does not see a face that fills its input."""
    border = max(1, max(width, height) // 4)
    return -border, -border, width + border, height + border


class FaceDetector:
    """Finds faces in regions of an image; holds no state between calls."""

    OUTPUTS = {"Identity": 2304 * 16, "Identity_1": 2304}
    """Outputs that the model must have, and their sizes."""

    def __init__(self, model: OnnxModel, min_score: float = 0.6) -> None:
        """model: face_detection_full_range.onnx; min_score and errors: see set_min_score."""
        self._model = model
        self._anchors = ssd_anchors(INPUT_SIZE, ANCHOR_STRIDES, ANCHORS_PER_CELL)
        self.set_min_score(min_score)

    @property
    def threads(self) -> Threads:
        """Those that share the regions of an image now: others once a graphics card has failed."""
        return self._model.threads

    def set_min_score(self, min_score: float) -> None:
        """Set the score from which a face is returned; raises ValueError outside (0, 1)."""
        if not 0.0 < min_score < 1.0:
            raise ValueError("minimum detection score must be in (0, 1), got %r" % (min_score,))
        self._min_logit = float(np.log(min_score / (1.0 - min_score)))

    def detect(self, bgr: np.ndarray, regions: Sequence[Region]) -> List[FaceDetection]:
        """Detect faces in regions of an image.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8.
        regions
            x0, y0, x1, y1 px each; they overlap the image. All are searched in one batch, or by the model's threads.

        Returns
        -------
        List[FaceDetection]
            In pixels of the whole image, highest score first, without duplicates.

        Raises
        ------
        ModelError
            When the network fails.
        """
        if not regions:
            return []
        boxes, keypoints, scores = (np.concatenate(part) for part in zip(*self._search(bgr, regions)))
        return weighted_nms(boxes, keypoints, scores)

    def look_again(self, bgr: np.ndarray, boxes: Sequence[np.ndarray]) -> List[Optional[FaceDetection]]:
        """Look for each face again, where the network sees a face best: in a square of its own about it.

        A face is found there with a high score. A thing that looks like one in the whole image mostly is not.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8.
        boxes
            (4,) px each, of the faces' meshes.

        Returns
        -------
        List[Optional[FaceDetection]]
            The surest face at the place and of about the size of each box, None where there is none.

        Raises
        ------
        ModelError
            When the network fails.
        """
        if not len(boxes):
            return []
        sizes = [float((box[2:] - box[:2]).max()) for box in boxes]
        centres = [(box[:2] + box[2:]) / 2.0 for box in boxes]
        seen = self._search(bgr, [_square(centre, AGAIN * size, bgr.shape) for centre, size in zip(centres, sizes)])
        found: List[Optional[FaceDetection]] = []
        for centre, size, one in zip(centres, sizes, seen):
            near = [detection for detection in weighted_nms(*one)
                if float(np.linalg.norm((detection.box[:2] + detection.box[2:]) / 2.0 - centre)) < AGAIN_NEAR * size
                and AGAIN_LEAST * size < detection.box[2] - detection.box[0] < AGAIN_MOST * size]
            found.append(near[0] if near else None)
        return found

    def _search(self, bgr: np.ndarray, regions: Sequence[Region]) -> List[Found]:
        """What the network says of each region."""
        places, out = self._model.run_items(regions, lambda region, crop: _letterbox(bgr, region, crop),
                                            (INPUT_SIZE, INPUT_SIZE, 3))
        return [self._decode(out["Identity"][i], out["Identity_1"][i, :, 0], scale, offset)
                for i, (scale, offset) in enumerate(places)]

    def _decode(
        self, regressors: np.ndarray, logits: np.ndarray, scale: float, offset: np.ndarray
    ) -> Found:
        """Boxes (n, 4) px, key points (n, 6, 2) px and scores (n,) of one region."""
        kept = np.flatnonzero(logits > self._min_logit)
        raw = regressors[kept].astype(np.float64).reshape(-1, 2 + KEYPOINTS, 2)
        anchors = self._anchors[kept, None, :] * INPUT_SIZE
        centre, half, keypoints = raw[:, :1] + anchors, raw[:, 1:2] / 2.0, raw[:, 2:] + anchors
        corners = np.concatenate([centre - half, centre + half], axis=1) * scale + offset
        scores = 1.0 / (1.0 + np.exp(-logits[kept].astype(np.float64)))
        good = np.isfinite(raw).all(axis=(1, 2)) & (half > 0.0).all(axis=(1, 2))
        return corners.reshape(-1, 4)[good], (keypoints * scale + offset)[good], scores[good]


def _square(centre: np.ndarray, half: float, shape: Sequence[int]) -> Region:
    """The square about a place (2,) px; a part of it lies in the image (H, W, ...), whatever the place."""
    x, y = (min(max(float(value), 0.0), side - 1.0) for value, side in zip(centre, (shape[1], shape[0])))
    half = max(1.0, half)
    return int(x - half), int(y - half), int(x + half) + 1, int(y + half) + 1


def _letterbox(bgr: np.ndarray, region: Region, out: np.ndarray) -> Tuple[float, np.ndarray]:
    """Fit a region into `out` (S, S, 3) as RGB in [-1, 1]; returns image px per input px, and offset px."""
    x0, y0, x1, y1 = region
    scale = max(x1 - x0, y1 - y0) / float(INPUT_SIZE)
    # What lies outside the image stays black.
    inner_x, inner_y = max(x0, 0), max(y0, 0)
    patch = bgr[inner_y:min(y1, bgr.shape[0]), inner_x:min(x1, bgr.shape[1])]
    height, width = patch.shape[:2]
    new_width, new_height = max(1, round(width / scale)), max(1, round(height / scale))
    margin_x = (INPUT_SIZE - (x1 - x0) / scale) / 2.0 + (inner_x - x0) / scale
    margin_y = (INPUT_SIZE - (y1 - y0) / scale) / 2.0 + (inner_y - y0) / scale
    left, top = min(int(margin_x), INPUT_SIZE - new_width), min(int(margin_y), INPUT_SIZE - new_height)
    if scale >= 4.0:
        # Every second pixel is enough when the area filter averages the rest, and four times as quick.
        half = (max(1, width // 2), max(1, height // 2))
        patch = cv2.resize(patch, half, interpolation=cv2.INTER_NEAREST)
    method = cv2.INTER_AREA if scale > 1.0 else cv2.INTER_LINEAR
    small = cv2.resize(patch, (new_width, new_height), interpolation=method)
    out.fill(-1.0)
    inside = out[top:top + new_height, left:left + new_width]
    inside[...] = cv2.cvtColor(small, cv2.COLOR_BGR2RGB)
    inside *= 1.0 / 127.5
    inside -= 1.0
    return scale, np.array([inner_x - left * scale, inner_y - top * scale])


def load_face_network(configured: str, default: str, outputs: Mapping[str, int], providers: Sequence[str],
                      notify: Optional[Callable[[str], None]], threads: Threads = ONE_THREAD,
                      batch_sizes: Sequence[int] = BATCH_SIZES, few_on_cpu: bool = False,
                      most_on_cpu: int = 0) -> OnnxModel:
    """Load the detector or the mesh network, and run it once: this warms it up, and tells a wrong model.

    outputs: numbers in each output for one image. threads and those behind it: see OnnxModel. Raises ModelError naming
    the file.
    """
    path = model_path(configured, default)
    model = OnnxModel(path, providers, inputs=("input_1",), outputs=tuple(outputs), notify=notify, threads=threads,
                      batch_sizes=batch_sizes, few_on_cpu=few_on_cpu, most_on_cpu=most_on_cpu)
    trial = model.run({"input_1": np.zeros((1, INPUT_SIZE, INPUT_SIZE, 3), np.float32)})
    for name, size in outputs.items():
        if trial[name].size != size:
            raise ModelError("model file {} gives {} numbers in {} instead of {}; it is another model: {}".format(
                path, trial[name].size, name, size, FETCH_HINT))
    return model
