"""Templates of faces: unit vectors that are close to each other for two pictures of the same person.

Two networks are known, and told apart by their outputs: `face_recognition.onnx` (dlib's ResNet with 128 numbers; King
2017, "High quality face recognition with deep metric learning") and `faceres.onnx` (1024 numbers).

The crop matters more than the network. It is the one dlib's network was trained on: the similarity that takes the eye
corners and the base of the nose to those of dlib's mean face, with a border of 0.2 (dlib: 0.25). Over 11 same and 168
different pairs of 28 faces (Euclidean distance of the plain outputs): the largest of the same 0.40, the smallest of
the others 0.56; with an upright square around the mesh, 1.0 to 1.6 times its size, they overlap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, Tuple, Union

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.onnx import FETCH_HINT, ModelError, OnnxModel, model_path
from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.recognition.likelihood import TemplateCalibration

DEFAULT_FILE = "face_recognition.onnx"
BORDER = 0.2
"""Border around the mean face, in its sides."""
MAX_BATCH = 16
"""Most crops in one run of the network; more are taken in turns."""
_CORNERS = [33, 133, 362, 263, 2]
"""Mesh vertices: outer and inner corner of the subject's right eye, inner and outer of the left, base of the nose."""
_MEAN_FACE = np.array([[0.1206, 0.2137], [0.3341, 0.2291], [0.6461, 0.2290], [0.8596, 0.2135], [0.4901, 0.6278]])
"""Where dlib's mean face has these points, in sides of its box."""
_ARC_VERTICES = ((33, 133), (362, 263), (4,), (61,), (291,))
"""Mesh vertices whose means are the middle of either eye, the tip of the nose and the corners of the mouth."""
_ARC_FACE = np.array([[38.29, 51.70], [73.53, 51.50], [56.03, 71.74], [41.55, 92.37], [70.73, 92.20]]) / 112.0
"""Where those points lie in the crop of ArcFace (Deng et al. 2019, "ArcFace: Additive Angular Margin Loss for Deep Face
Recognition"), in sides of it."""
_CENTRE = tuple(0.001 * number for number in (
    -72, 67, 38, -60, -82, -7, -33, -82, 132, -66, 131, -43, -185, -1, -51, 118, -131, -110, -57, -30, 25, 23, 21,
    59, -102, -247, -44, -60, -12, -69, 7, 50, -134, -16, 19, 59, -22, -60, 129, 25, -176, -8, 39, 199, 151, 6,
    10, -59, 81, -204, 18, 122, 54, 36, 43, -114, 16, 86, -123, 34, 65, -56, -2, -49, 134, 63, -99, -102, 99,
    -115, -35, 51, -88, -155, -201, 10, 284, 103, -119, 22, -53, 1, 23, 77, -27, 1, -65, 11, 147, -25, -8, 183,
    -14, -15, 11, 51, -97, 18, -95, -3, -2, -39, 5, 70, -141, 111, -18, -20, -12, -5, -69, -33, 121, -179, 123,
    139, 37, 106, 57, 44, 11, -7, -96, -52, 29, -33, 13, 10))
"""Mean of the templates of the 22 people of the half `tuning` of scripts/benchmarks/identity_names.py."""

_LOWER_FACE = (0.45, 0.98, 0.15, 0.85)
"""Where dlib's crop shows the face from the middle of the nose down."""
COLOURED = 0.2
"""Mean of the weakest colour of a face over that of the strongest, below which its light is coloured. Of 45 people in
photographs one has .24, all others .35 and more."""


@dataclass(frozen=True)
class EmbeddingKind:
    """What differs between the networks.

    Attributes
    ----------
    input, output : names in the ONNX file, by which the network is recognised.
    size : side (px) of the crop.
    dimension : how many numbers a template has.
    mean : subtracted from the pixels, in the order of the network's colours.
    rgb : the network wants RGB, not BGR.
    calibration : of the distances of its templates.
    divisor : by which the pixels are divided then.
    alignment : `dlib` or `arcface`: which points of the face are brought where.
    lower_face : top, bottom, left and right of the part of the crop with nose and mouth, in sides of it; empty where it
        was not measured what the network makes of covered ones.
    """

    name: str
    input: str
    output: str
    size: int
    dimension: int
    mean: Tuple[float, float, float]
    rgb: bool
    calibration: TemplateCalibration
    divisor: float = 1.0
    alignment: str = "dlib"
    lower_face: Tuple[float, ...] = ()


KINDS: Dict[str, EmbeddingKind] = {
    # Fitted to 810 same and 13,608 different pairs: those of 28 faces (the pictures of face_recognition's tests, the
    # demonstration's photographs), each in 9 qualities down to 35 px, blur, noise, light. Same: 0.26 +- 0.06;
    # different: 0.60 +- 0.07; equal odds at 0.40, which is dlib's own threshold, and a scale of 0.0135. On 49 other
    # faces of 21 people (149 and 2,399 pairs; the pictures of fetch_models' group evaluation): same 0.22 +- 0.05, most
    # 0.36; different 0.58 +- 0.06, least 0.34. Few people, all adult, so the tails, which decide, are hardly known:
    # the midpoint is put 0.02 lower than the fit says. Kin and children lie 0.32 to 0.49 apart (measured on people who
    # are not in these pictures): the odds against them are such that with ten known people nobody farther than about
    # 0.32 gets a name. Views of one person at different times of a film: 0.20. Templates lie 0.39 +- 0.04 from the mean
    # of all people; those of a family in one photograph, who are 0.27 to 0.45 apart, 0.34 +- 0.02. The three nearest of
    # 80 others lie 0.39 +- 0.04 from somebody in another picture, 0.36 +- 0.04 from somebody in a group photograph.
    "face_recognition": EmbeddingKind("face_recognition", "image", "embedding", 150, 128, (0.0, 0.0, 0.0), True,
                                      TemplateCalibration(midpoint=0.38, fair_midpoint=0.40, scale=0.0135, near=0.15,
                                                          kin_midpoint=0.34, kin_scale=0.018, spread=0.20,
                                                          one_human=0.254, centre=_CENTRE, radius=0.41, crowd=0.38),
                                      lower_face=_LOWER_FACE),
    # Half of the people of scripts/benchmarks/identity_names.py: same, on other pictures, 0.60 +- 0.15, most 0.93
    # (elsewhere 0.77 +- 0.17); different 1.39 +- 0.10, least 0.81 (single views of all qualities). What kin are was not
    # measured: inferred from its error rate on a film of alike people, 1.0 to 1.3.
    "mobilefacenet": EmbeddingKind("mobilefacenet", "input", "embeddings", 112, 192, (127.5, 127.5, 127.5), True,
                                   TemplateCalibration(midpoint=1.05, fair_midpoint=1.08, scale=0.03, near=0.35,
                                                       kin_midpoint=0.98, kin_scale=0.06, spread=0.43, one_human=0.62),
                                   divisor=128.0, alignment="arcface"),
    # The same 28 faces, plain: same 0.64 +- 0.12, different 1.11 +- 0.07, least 0.89.
    "faceres": EmbeddingKind("faceres", "input_1", "descriptor", 224, 1024, (103.939, 116.779, 123.68), False,
                             TemplateCalibration(midpoint=0.82, fair_midpoint=0.86, scale=0.025, near=0.35)),
}


class FaceEmbedder:
    """One of the networks. Safe from several threads.

    Parameters
    ----------
    path : the ONNX file.
    providers, notify, threads : see OnnxModel.

    Raises
    ------
    ModelError
        The file is missing, damaged or another model.
    """

    def __init__(self, path: Union[str, Path], providers: Sequence[str] = ("cpu",),
                 notify: Optional[Callable[[str], None]] = None, threads: Threads = ONE_THREAD) -> None:
        model = OnnxModel(path, providers, notify=notify, threads=threads)
        self._kind = _kind_of(model, path)
        self._model = model
        self.kind = self._kind.name
        self.dimension = self._kind.dimension
        self.calibration = self._kind.calibration
        self.size = self._kind.size
        self.alignment = self._kind.alignment
        trial = self._run(np.zeros((1, self.size, self.size, 3), np.float32))
        if trial.size != self.dimension:
            raise ModelError("model file {} gives {} numbers instead of {}; it is another model: {}".format(
                path, trial.size, self.dimension, FETCH_HINT))

    def crop(self, bgr: np.ndarray, mesh: np.ndarray, camera: Optional[CameraModel] = None) -> np.ndarray:
        """Return the (size, size, 3) uint8 BGR crop of a face for `embed`.

        bgr: (H, W, 3) uint8; mesh: (468 or 478, 2 or more) px; camera: see face_chip. Raises ValueError for points that
        are not finite or in one place.
        """
        return face_chip(bgr, mesh, self.size, alignment=self.alignment, camera=camera)

    def embed(self, crops: Sequence[np.ndarray]) -> np.ndarray:
        """Return (N, dimension) float32 unit vectors of crops (N, size, size, 3) uint8 BGR; (0, dimension) for none.

        A crop of another size is scaled. Raises ValueError for a crop that is no colour image.
        """
        if not len(crops):
            return np.empty((0, self.dimension), np.float32)
        return unit(np.stack(self._model.threads.in_parts(self._vectors, crops)))

    def covered(self, crops: Sequence[np.ndarray], templates: np.ndarray) -> np.ndarray:
        """Return (N,) bool: whether crops (N, S, S, 3) uint8 BGR with these templates (N, dimension) do not show nose
        and mouth: a mask, a scarf, a cup. With that part upside down it is the same face still."""
        if not self._kind.lower_face or not len(crops):
            return np.zeros(len(crops), bool)
        turned = self.embed([_upside_down(crop, self._kind.lower_face) for crop in crops])
        return np.linalg.norm(turned - templates, axis=1) < self.calibration.spread

    def _vectors(self, crops: Sequence[np.ndarray]) -> List[np.ndarray]:
        """What the network says of each crop: (dimension,)."""
        return [vector for start in range(0, len(crops), MAX_BATCH)
                for vector in self._run(self._batch(crops[start:start + MAX_BATCH]))]

    def _batch(self, crops: Sequence[np.ndarray]) -> np.ndarray:
        batch = np.empty((len(crops), self.size, self.size, 3), np.float32)
        for place, crop in zip(batch, crops):
            crop = np.asarray(crop)
            if crop.ndim != 3 or crop.shape[2] != 3 or crop.dtype != np.uint8 or not crop.size:
                raise ValueError("a crop is {} {}, it must be (S, S, 3) uint8 BGR".format(crop.shape, crop.dtype))
            crop = without_coloured_light(crop)
            if crop.shape[:2] != (self.size, self.size):
                crop = cv2.resize(crop, (self.size, self.size), interpolation=cv2.INTER_AREA)
            place[...] = cv2.cvtColor(crop, cv2.COLOR_BGR2RGB) if self._kind.rgb else crop
        batch -= np.array(self._kind.mean, np.float32)
        batch /= self._kind.divisor
        return batch

    def _run(self, batch: np.ndarray) -> np.ndarray:
        return self._model.run({self._kind.input: batch})[self._kind.output].reshape(len(batch), -1)


def _upside_down(crop: np.ndarray, part: Sequence[float]) -> np.ndarray:
    """Return a crop (S, S, 3) with a part of it upside down; part: top, bottom, left, right, in sides of the crop."""
    height, width = crop.shape[:2]
    top, bottom, left, right = (int(share * side) for share, side in zip(part, (height, height, width, width)))
    turned = crop.copy()
    turned[top:bottom, left:right] = crop[top:bottom, left:right][::-1]
    return turned


def without_coloured_light(crop: np.ndarray) -> np.ndarray:
    """Return a crop (S, S, 3) uint8 BGR, in grey if its light is coloured: so networks know faces better than in blue
    or red, where people are unlike themselves and like each other."""
    edge = len(crop) // 5
    means = cv2.mean(crop[edge:len(crop) - edge, edge:crop.shape[1] - edge])[:3]
    if min(means) >= COLOURED * max(means):
        return crop
    return cv2.cvtColor(cv2.cvtColor(crop, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)


def load_face_embedder(configured: str = "", providers: Sequence[str] = ("cpu",),
                       notify: Optional[Callable[[str], None]] = None,
                       threads: Threads = ONE_THREAD) -> FaceEmbedder:
    """Load the network of a parameter: one of KINDS by its name, or a file; empty for face_recognition.onnx.

    Raises ModelError that names the file and what to do.
    """
    file, configured = (configured + ".onnx", "") if configured in KINDS else (DEFAULT_FILE, configured)
    return FaceEmbedder(model_path(configured, file), providers, notify, threads)


def face_chip(bgr: np.ndarray, mesh: np.ndarray, size: int, border: float = BORDER,
              alignment: str = "dlib", camera: Optional[CameraModel] = None,
              origin: Tuple[int, int] = (0, 0)) -> np.ndarray:
    """Return (size, size, 3) uint8 BGR: the face brought to a mean face; parts outside the image are black.

    bgr: (H, W, 3) uint8; mesh: (468 or 478, 2 or more) px; border: in sides of the box of dlib's mean face; alignment:
    `dlib`, or `arcface`, which has no border. camera: of the image; where it is calibrated, the face is shown as a
    camera sees it that looks at it: aside of the optical axis an image is stretched, so that people look unlike
    themselves. origin: x, y px in the image of the first pixel of `bgr`, where that is a part of it. Raises ValueError
    for points that are not finite or in one place.
    """
    vertices = np.asarray(mesh, dtype=np.float64)[:, :2]
    facing = None
    if camera is not None and camera.is_calibrated and np.isfinite(vertices).all():
        facing = camera.facing_map(vertices)
        vertices = cv2.perspectiveTransform(vertices[None], facing)[0]
    if alignment == "arcface":
        points, goal = np.stack([vertices[list(some)].mean(axis=0) for some in _ARC_VERTICES]), _ARC_FACE
    else:
        points, goal = vertices[_CORNERS], (_MEAN_FACE + border) / (1.0 + 2.0 * border)
    affine = similarity(points, goal * size)
    scale = math.hypot(affine[0, 0], affine[1, 0])
    # Halving steps against aliasing: a crop is drawn at up to four times its size and averaged.
    finer = min(max(int(1.0 / scale), 1), 4)
    side = (size * finer, size * finer)
    if facing is not None:
        facing = facing @ np.array([[1.0, 0.0, origin[0]], [0.0, 1.0, origin[1]], [0.0, 0.0, 1.0]])
    else:
        affine[:, 2] += affine[:, :2] @ origin
    if facing is None:
        chip = cv2.warpAffine(bgr, affine * finer, side, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    else:
        chip = cv2.warpPerspective(bgr, np.vstack([affine * finer, (0.0, 0.0, 1.0)]) @ facing, side,
                                   flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return chip if finer == 1 else cv2.resize(chip, (size, size), interpolation=cv2.INTER_AREA)


def similarity(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the (2, 3) similarity that takes points (N, 2) to points (N, 2) at the least squared error.

    Umeyama 1991, "Least-squares estimation of transformation parameters between two point patterns". Raises
    ValueError for points that are not finite or in one place.
    """
    # In the plane the rotation and scale are one complex number, and plain numbers are quicker for a few points.
    points, goals = [complex(*point) for point in source.tolist()], [complex(*point) for point in target.tolist()]
    centre, goal = sum(points) / len(points), sum(goals) / len(goals)
    spread = sum(((point - centre) * (point - centre).conjugate()).real for point in points)
    if not (math.isfinite(spread) and spread >= 1e-6):
        raise ValueError("the points of the face are not finite, or all lie in one place")
    turn = sum((point - centre).conjugate() * (wanted - goal) for point, wanted in zip(points, goals)) / spread
    shift = goal - turn * centre
    return np.array([[turn.real, -turn.imag, shift.real], [turn.imag, turn.real, shift.imag]])


def unit(vectors: np.ndarray) -> np.ndarray:
    """Return vectors (N, D) at length 1, float32; one without length stays as it is."""
    vectors = np.asarray(vectors, dtype=np.float32)
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)


def _kind_of(model: OnnxModel, path: Union[str, Path]) -> EmbeddingKind:
    for kind in KINDS.values():
        if kind.input in model.input_names and kind.output in model.output_names:
            return kind
    raise ModelError("model file {} (inputs {}, outputs {}) makes no face templates; known are: {}; {}".format(
        path, ", ".join(model.input_names), ", ".join(model.output_names),
        ", ".join(kind + ".onnx" for kind in KINDS), FETCH_HINT))
