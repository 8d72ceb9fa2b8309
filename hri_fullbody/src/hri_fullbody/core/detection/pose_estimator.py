"""BlazePose: the landmarks of the one body in a window of the image, and how two estimates compare."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Callable, List, Optional, Protocol, Sequence, Tuple, Union

import cv2
import numpy as np

from hri_fullbody.core.detection.windows import CENTRE_LANDMARK, REACH_LANDMARK, Window, window_from_landmarks
from hri_fullbody.core.keypoints import (
    BLAZE_LEFT_HIP,
    BLAZE_LEFT_SHOULDER,
    BLAZE_NOSE,
    BLAZE_RIGHT_HIP,
    BLAZE_RIGHT_SHOULDER,
)
from hri_pipeline.core.geometry import crop_rotated, median_of_few
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.onnx import FETCH_HINT, ModelError, OnnxModel, model_path, models_directory
from hri_pipeline.core.picture_jumps import Jump
from hri_pipeline.core.process import ONE_THREAD, Threads

INPUT_SIZE = 256
LANDMARKS = 39
BODY_LANDMARKS = 33
_HEAD_LANDMARKS = 11
_TRUNK = [BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER, BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP]
_KNOWN, _SEEN = 0.3, 0.5
_LANDMARK_OUTPUT, _SCORE_OUTPUT, _WORLD_OUTPUT = "Identity", "Identity_1", "Identity_4"
# The landmarks with left and right exchanged: those of the body come in pairs, five of the head and eleven below.
_OTHER_SIDE = np.array([0, 4, 5, 6, 1, 2, 3, 8, 7, 10, 9] + [number + 1 - 2 * (number % 2 == 0)
                                                             for number in range(11, BODY_LANDMARKS)]
                       + list(range(BODY_LANDMARKS, LANDMARKS)))
_CORNERS = np.array([[0, 1], [2, 1], [2, 3], [0, 3]])    # x and y in x0, y0, x1, y1
_GREY = (128, 128, 128)
POSE_MODELS = ("lite", "full", "heavy")


@dataclass(frozen=True)
class PoseEstimate:
    """One body as the network sees it.

    score: 0 to 1, that there is a body. landmarks: (39, 3) x, y, px in the image, and depth in px around the hips.
    confidence: (39,) 0 to 1. world: (33, 3) m around the middle of the hips, for a person of average height, in the
    axes of the image (x right, y down, z away).
    """

    score: float
    landmarks: np.ndarray
    confidence: np.ndarray
    world: np.ndarray

    @cached_property
    def nose(self) -> np.ndarray:
        """The nose (2,) px."""
        return self.landmarks[BLAZE_NOSE, :2]

    @cached_property
    def centre(self) -> np.ndarray:
        """Middle of the trunk (2,) px."""
        points = self.landmarks
        return (points[BLAZE_LEFT_SHOULDER, :2] + points[BLAZE_RIGHT_SHOULDER, :2]
                + points[BLAZE_LEFT_HIP, :2] + points[BLAZE_RIGHT_HIP, :2]) / 4.0

    @cached_property
    def extent(self) -> float:
        """Size of the body as the network reports it for the next window, px: does not depend on what is hidden."""
        x, y = self.landmarks[REACH_LANDMARK, :2] - self.landmarks[CENTRE_LANDMARK, :2]
        return max(2.0 * math.hypot(x, y), 1.0)

    @cached_property
    def box(self) -> np.ndarray:
        """Bounding box (4,) px of the landmarks that are seen, of all when fewer than four are."""
        points = self.landmarks[:BODY_LANDMARKS, :2]
        seen = self.confidence[:BODY_LANDMARKS] > _KNOWN
        points = points[seen] if seen.sum() >= 4 else points
        return np.concatenate([points.min(axis=0), points.max(axis=0)])

    @cached_property
    def trunk_seen(self) -> bool:
        """Whether both shoulders and both hips are seen."""
        return bool(self.confidence[_TRUNK].min() > _SEEN)

    def turned(self, rotation: ImageRotation) -> PoseEstimate:
        """Return what the network would see in the turned image."""
        return replace(self, landmarks=rotation.pixels(self.landmarks), world=rotation.vectors(self.world))

    def jumped(self, jump: Jump) -> PoseEstimate:
        """Return what the network would see after the picture has jumped."""
        return replace(self, landmarks=jump.pixels(self.landmarks))

    def head_box(self) -> np.ndarray:
        """Box (4,) px of the head, around the landmarks of nose, eyes, ears and mouth."""
        points = self.landmarks[:_HEAD_LANDMARKS, :2]
        low, high = points.min(axis=0), points.max(axis=0)
        half = 0.7 * float(np.linalg.norm(high - low))
        middle = (low + high) / 2.0
        return np.concatenate([middle - half, middle + half])

    def next_window(self) -> Window:
        """Window for the next image. Raises ValueError when the landmarks are degenerate."""
        return window_from_landmarks(self.landmarks)


def decode(landmarks: np.ndarray, score: float, world: np.ndarray, affine: np.ndarray, angle: float,
           mirrored: bool = False) -> PoseEstimate:
    """Turn the network's numbers into image coordinates.

    landmarks: (195,) 39 x (x, y, z px of the input, logits of visibility and presence). world: (117,) 39 x 3 m in the
    window's axes. affine: (2, 3) from input to image pixels. angle: rad, that of the window. mirrored: the network was
    shown the input with left and right exchanged; the estimate is that of the image as it is.
    A landmark counts as much as the less sure of being in the image and being unhidden.
    """
    raw = np.asarray(landmarks, dtype=np.float64).reshape(LANDMARKS, 5)
    metric = np.asarray(world, dtype=np.float64).reshape(LANDMARKS, 3)[:BODY_LANDMARKS].copy()
    if mirrored:
        raw, metric = raw[_OTHER_SIDE], metric[_OTHER_SIDE[:BODY_LANDMARKS]]
        raw[:, 0], metric[:, 0] = INPUT_SIZE - 1.0 - raw[:, 0], -metric[:, 0]
    points = np.empty((LANDMARKS, 3))
    points[:, :2] = raw[:, :2] @ affine[:, :2].T + affine[:, 2]
    points[:, 2] = raw[:, 2] * math.hypot(affine[0, 0], affine[1, 0])
    sure = 1.0 / (1.0 + np.exp(-np.minimum(np.maximum(raw[:, 3:].min(axis=1), -50.0), 50.0)))
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    metric[:, :2] = metric[:, :2] @ turn.T
    return PoseEstimate(float(score), points, sure, metric)


@dataclass(frozen=True)
class PoseWindow:
    """One place to look at: the window; hidden: boxes (4,) px painted grey first, such as the faces of neighbours, so
    that the network cannot take them; shown: a box (4,) px that stays visible even where a hidden one covers it;
    mirrored: the network sees it with left and right exchanged."""

    window: Window
    hidden: Sequence[np.ndarray] = ()
    shown: Optional[np.ndarray] = None
    mirrored: bool = False


class PoseEstimator(Protocol):
    """Anything that finds the one body in a window; see BlazePose."""

    def estimate(self, image: np.ndarray, window: Window, hidden: Sequence[np.ndarray] = (),
                 shown: Optional[np.ndarray] = None, mirrored: bool = False) -> PoseEstimate:
        """Return the body in `window` of `image` (H, W, 3) BGR."""


class BatchPoseEstimator(PoseEstimator, Protocol):
    """A PoseEstimator that is faster with several windows at once."""

    def estimate_all(self, image: np.ndarray, windows: Sequence[PoseWindow]) -> List[PoseEstimate]:
        """Return the body of each window."""


class BlazePose:
    """The pose network. Not to be called by several threads. A file whose network takes just one window gets one."""

    def __init__(
        self,
        path: Union[str, Path],
        providers: Sequence[str] = ("cpu",),
        notify: Optional[Callable[[str], None]] = None,
        threads: Threads = ONE_THREAD,
    ) -> None:
        self._model = OnnxModel(path, providers, inputs=("input_1",),
                                outputs=(_LANDMARK_OUTPUT, _SCORE_OUTPUT, _WORLD_OUTPUT), notify=notify,
                                threads=threads)
        self._takes_one = isinstance(self._model.input_shapes["input_1"][0], int)

    @property
    def threads(self) -> Threads:
        """Those that share the windows of an image now: others once a graphics card has failed."""
        return ONE_THREAD if self._takes_one else self._model.threads

    @property
    def takes_batches(self) -> bool:
        """Whether several windows at once are faster. They are on a GPU, and where several threads share them; in one
        thread of a CPU a window takes 0.98 of the time in a batch of three (measured)."""
        return not self._takes_one and (self._model.on_card or self.threads.count > 1)

    def estimate(self, image: np.ndarray, window: Window, hidden: Sequence[np.ndarray] = (),
                 shown: Optional[np.ndarray] = None, mirrored: bool = False) -> PoseEstimate:
        """Find the body in `window` of `image` (H, W, 3) BGR; hidden, shown, mirrored: see PoseWindow."""
        return self.estimate_all(image, [PoseWindow(window, hidden, shown, mirrored)])[0]

    def estimate_all(self, image: np.ndarray, windows: Sequence[PoseWindow]) -> List[PoseEstimate]:
        """Find the body in each window of `image` (H, W, 3) BGR, in one run of the network, or shared by its
        threads."""
        if not windows:
            return []
        affines, output = self._model.run_items(windows, lambda one, place: _crop(image, one, place),
                                                (INPUT_SIZE, INPUT_SIZE, 3))
        scores = np.asarray(output[_SCORE_OUTPUT]).reshape(len(windows), -1)
        return [decode(landmarks, float(score[0]), world, affine, one.window.angle, one.mirrored)
                for landmarks, score, world, affine, one in zip(
                    output[_LANDMARK_OUTPUT], scores, output[_WORLD_OUTPUT], affines, windows)]


def _crop(image: np.ndarray, one: PoseWindow, out: np.ndarray) -> np.ndarray:
    """Write a window as RGB in [0, 1] to `out` (S, S, 3); returns the affine (2, 3) from it to the image."""
    patch, affine = crop_rotated(image, one.window.centre, one.window.size, one.window.angle, INPUT_SIZE)
    _hide(patch, affine, one.hidden, one.shown)
    patch = cv2.flip(patch, 1) if one.mirrored else patch
    np.multiply(cv2.cvtColor(patch, cv2.COLOR_BGR2RGB, dst=patch), np.float32(1.0 / 255.0), out=out)
    return affine


def _hide(patch: np.ndarray, affine: np.ndarray, hidden: Sequence[np.ndarray], shown: Optional[np.ndarray]) -> None:
    """Paint boxes (image px) grey in the patch, but not `shown`."""
    if not len(hidden):
        return
    inverse = cv2.invertAffineTransform(affine)
    corners = _corners(np.asarray(hidden), inverse)
    outside = np.any((corners.max(axis=1) < 0) | (corners.min(axis=1) > max(patch.shape[:2])), axis=1)
    if outside.all():
        return
    if shown is None:
        for corner in corners[~outside]:
            cv2.fillConvexPoly(patch, corner, _GREY)
        return
    own = _corners(shown[None], inverse)[0]
    x, y = zip(*own.tolist())
    left, top = max(min(x), 0), max(min(y), 0)
    part = patch[top:max(max(y) + 1, 0), left:max(max(x) + 1, 0)]
    before = part.copy()
    for corner in corners[~outside]:
        cv2.fillConvexPoly(patch, corner, _GREY)
    if part.size:
        stays = np.zeros(part.shape[:2], np.uint8)
        cv2.fillConvexPoly(stays, own - (left, top), (1.0,))
        np.copyto(part, before, where=stays[..., None] > 0)


def _corners(boxes: np.ndarray, affine: np.ndarray) -> np.ndarray:
    """Corners (N, 4, 2) in whole px of the patch of boxes (N, 4) px in the image."""
    corners = boxes[:, _CORNERS] @ affine[:, :2].T + affine[:, 2]
    return np.minimum(np.maximum(np.rint(corners), -4096.0), 4096.0).astype(np.int32)


SAME_BODY = 0.1
"""Distance, in sizes of the larger body, below which two estimates show one human."""
# In sizes of the larger body.
_FAR = 0.6
# No landmark of a body is farther from the image's corner (px), or from the hips (m), whatever the network says.
_LARGEST_PX, _LARGEST_M = 1e5, 5.0
# Of what is smaller (px) no key points can be told: letters and spots resemble people far away.
_LEAST_PX = 24.0
_SAME_TRUNK, _SAME_NOSE, _SAME_IOU = 0.09, 0.12, 0.35
_HEAD_ASIDE, _HEAD_DOWN, _MOSTLY = 0.3, 0.4, 0.6    # of a person's box, where the head is; of what is seen of a body
LEAST_SHARE = 0.88
"""Of the longer side of a person's box: a body reaches at least as far as what is seen of it. Of 36 people .96 and
more."""
_SAME_HEAD = 0.065      # three quarters of a head's breadth; two who cross are told from 0.07 on


@dataclass(frozen=True)
class PoseDetection:
    """What the pose network found in one window.

    points: (33, 3) m, the landmarks placed in the optical frame, None when they cannot be. appearance: see
    `tracking.reidentification.describe`. source: id of the body whose window it was, None for a new one.
    """

    estimate: PoseEstimate
    points: Optional[np.ndarray] = field(default=None, repr=False)
    appearance: Optional[np.ndarray] = field(default=None, repr=False)
    source: Optional[str] = None

    @cached_property
    def root(self) -> Optional[np.ndarray]:
        """Middle of the hips (3,) m in the optical frame, None when it is not known."""
        return None if self.points is None else (self.points[BLAZE_LEFT_HIP] + self.points[BLAZE_RIGHT_HIP]) / 2.0


def body_size(estimate: PoseEstimate) -> float:
    """Longer side of the box of the landmarks that are seen, px."""
    x0, y0, x1, y1 = estimate.box.tolist()
    return max(x1 - x0, y1 - y0, 1.0)


def body_distance(a: PoseEstimate, b: PoseEstimate) -> float:
    """Median distance of the landmarks that both see, in units of the larger body."""
    both = (a.confidence[:BODY_LANDMARKS] > _KNOWN) & (b.confidence[:BODY_LANDMARKS] > _KNOWN)
    both = both if both.sum() > 4 else np.ones(BODY_LANDMARKS, bool)
    offset = (a.landmarks[:BODY_LANDMARKS, :2] - b.landmarks[:BODY_LANDMARKS, :2])[both]
    return median_of_few(np.hypot(*offset.T)) / max(body_size(a), body_size(b))


def same_body(a: PoseEstimate, b: PoseEstimate) -> bool:
    """Tell whether two estimates show one human: the same landmarks, or trunk and nose at the same place.

    Most pairs are told apart by the trunks alone. Of two people whose trunks and heads coincide one is hidden.
    """
    size = max(a.extent, b.extent)
    offset = math.hypot(*(a.centre - b.centre).tolist()) / size
    if offset > _FAR:
        return False
    if offset < _SAME_TRUNK and math.hypot(*(a.nose - b.nose).tolist()) < _SAME_NOSE * size:
        return True
    return body_distance(a, b) < SAME_BODY


def one_human(a: PoseEstimate, b: PoseEstimate) -> bool:
    """Tell whether two estimates come from one human: the same body, or noses in one head.

    Of somebody whose head is hidden the network makes a body with the head of a neighbour, whatever its limbs are.
    """
    return same_body(a, b) or math.hypot(*(a.nose - b.nose).tolist()) < _SAME_HEAD * max(a.extent, b.extent)


def is_sound(estimate: PoseEstimate, min_score: float) -> bool:
    """Tell whether an estimate is sure enough, of possible numbers, and has a window to follow it."""
    # A comparison with NaN is false.
    possible = (np.abs(estimate.landmarks).max() < _LARGEST_PX and np.abs(estimate.world).max() < _LARGEST_M
                and np.isfinite(estimate.confidence).all())
    if not (possible and estimate.score >= min_score):
        return False
    try:
        window = estimate.next_window()
    except ValueError:
        return False
    return (window.size >= _LEAST_PX and body_size(estimate) >= _LEAST_PX
            and int((estimate.confidence[:BODY_LANDMARKS] > _KNOWN).sum()) >= 4)


def covers(estimate: PoseEstimate, box: np.ndarray) -> bool:
    """Tell whether a person's box (4,) px is that of this body: it is seen there, or its head is where that of the box
    should be and what is seen of it lies in the box."""
    box = np.asarray(box)
    # Plain numbers: this runs for every pair of a body and a box, and arrays of four are slow.
    (x0, y0, x1, y1), (a0, b0, a1, b1) = estimate.box.tolist(), box.tolist()
    width, height = a1 - a0, b1 - b0
    common = max(min(x1, a1) - max(x0, a0), 0.0) * max(min(y1, b1) - max(y0, b0), 0.0)
    both = max(x1 - x0, 0.0) * max(y1 - y0, 0.0) + max(width, 0.0) * max(height, 0.0) - common
    if common > _SAME_IOU * both:
        return True
    x, y = estimate.nose.tolist()
    return bool(abs(x - 0.5 * (a0 + a1)) < _HEAD_ASIDE * width and 0.0 <= y - b0 < _HEAD_DOWN * height
                and inside(estimate.box, box) > _MOSTLY and estimate.extent >= LEAST_SHARE * max(width, height))


def inside(box: np.ndarray, other: np.ndarray) -> float:
    """Part of the area of a box (4,) px that lies in another."""
    x0, y0, x1, y1 = box.tolist()
    a0, b0, a1, b1 = other.tolist()
    width, height = min(x1, a1) - max(x0, a0), min(y1, b1) - max(y0, b0)
    return max(width, 0.0) * max(height, 0.0) / (max(x1 - x0, 1e-6) * max(y1 - y0, 1e-6))


def distinct(detections: Sequence[PoseDetection], faces: Sequence[Optional[str]]) -> List[PoseDetection]:
    """Keep one of several detections of one human: the surest.

    faces: for each detection the id of the face in which its nose lies, or None; two faces are two humans.
    """
    kept: List[Tuple[PoseDetection, Optional[str]]] = []
    for detection, face in sorted(zip(detections, faces), key=lambda pair: -pair[0].estimate.score):
        if not any(same_body(detection.estimate, other.estimate) for other, its in kept
                   if face is None or its is None or face == its):
            kept.append((detection, face))
    return [detection for detection, _ in kept]


def pose_model_path(configured: str) -> Path:
    """Return the file of the pose network: that of a short name (lite, full, heavy; empty for full) or a path.

    Raises ModelError that says how to get it.
    """
    name = configured or "full"
    if name not in POSE_MODELS:
        if os.sep not in name and not name.endswith(".onnx"):
            raise ModelError("parameter pose_model is {!r}; legal: {}, or the path of an ONNX file".format(
                name, ", ".join(POSE_MODELS)))
        return model_path(name, "pose_landmarks_full.onnx")
    model = "pose_landmarks_" + name
    path = models_directory() / (model + ".onnx")
    if not path.is_file():
        raise ModelError("model file {} for pose_model {} does not exist; {} --models {}`".format(
            path, name, FETCH_HINT.rstrip("`"), model))
    return path
