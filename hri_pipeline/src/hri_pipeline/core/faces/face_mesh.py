"""The 478-point face mesh (attention mesh) of several faces in one batch.

The network refines the lips, the eyes and the irises of the 468-vertex mesh with attention heads of their
own (Grishchenko et al. 2020, "Attention Mesh"); here the refined points replace the coarse ones, and the
ten iris points are appended. Vertex lists of the heads: MediaPipe's published landmark-refinement graph
(Apache-2.0).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence

import cv2
import numpy as np

from hri_pipeline.core.faces.face_detector import LEFT_EYE, RIGHT_EYE, FaceDetection
from hri_pipeline.core.geometry import crop_rotated
from hri_pipeline.core.onnx_model import OnnxModel

INPUT_SIZE = 192
VERTICES = 468
POINTS = 478
MARGIN = 1.5
"""Side of the crop over the side of the face's box."""
RIGHT_EYE_CORNER, LEFT_EYE_CORNER = 33, 263
"""Vertices of the outer corners of the subject's eyes."""

_LIPS = np.array([
    61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291, 185, 40, 39, 37, 0, 267, 269, 270, 409,
    78, 95, 88, 178, 87, 14, 317, 402, 318, 324, 308, 191, 80, 81, 82, 13, 312, 311, 310, 415,
    76, 77, 90, 180, 85, 16, 315, 404, 320, 307, 306, 184, 74, 73, 72, 11, 302, 303, 304, 408,
    62, 96, 89, 179, 86, 15, 316, 403, 319, 325, 292, 183, 42, 41, 38, 12, 268, 271, 272, 407,
])
_RIGHT_EYE_REGION = np.array([
    33, 7, 163, 144, 145, 153, 154, 155, 133, 246, 161, 160, 159, 158, 157, 173, 130, 25, 110, 24,
    23, 22, 26, 112, 243, 247, 30, 29, 27, 28, 56, 190, 226, 31, 228, 229, 230, 231, 232, 233, 244,
    113, 225, 224, 223, 222, 221, 189, 35, 124, 46, 53, 52, 65, 143, 111, 117, 118, 119, 120, 121,
    128, 245, 156, 70, 63, 105, 66, 107, 55, 193,
])
_LEFT_EYE_REGION = np.array([
    263, 249, 390, 373, 374, 380, 381, 382, 362, 466, 388, 387, 386, 385, 384, 398, 359, 255, 339,
    254, 253, 252, 256, 341, 463, 467, 260, 259, 257, 258, 286, 414, 446, 261, 448, 449, 450, 451,
    452, 453, 464, 342, 445, 444, 443, 442, 441, 413, 265, 353, 276, 283, 282, 295, 372, 340, 346,
    347, 348, 349, 350, 357, 465, 383, 300, 293, 334, 296, 336, 285, 417,
])
_CONTOUR = 16
"""The first 16 vertices of an eye region are the eyelids' contour."""


@dataclass(frozen=True)
class FaceRoi:
    """A rotated square of the image: centre (2,) px, side size px, angle rad (x axis towards image y)."""

    centre: np.ndarray
    size: float
    angle: float


@dataclass(frozen=True)
class FaceMeshResult:
    """presence: probability 0..1 that there is a face; points: (478, 3) px, z away from the camera in the
    scale of x, relative to the head."""

    presence: float
    points: np.ndarray


def roi_from_detection(detection: FaceDetection) -> FaceRoi:
    """Crop for a detected face: its box with a margin, turned so that the eyes are level."""
    eyes = detection.keypoints[LEFT_EYE] - detection.keypoints[RIGHT_EYE]
    size = float((detection.box[2:] - detection.box[:2]).max())
    centre = (detection.box[:2] + detection.box[2:]) / 2.0
    return FaceRoi(centre, MARGIN * size, float(np.arctan2(eyes[1], eyes[0])))


def roi_from_mesh(points: np.ndarray, shift: Optional[np.ndarray] = None) -> FaceRoi:
    """Crop for the next frame from the mesh (478, 3) px of this one, moved by shift (2,) px."""
    xy = points[:, :2]
    eyes = xy[LEFT_EYE_CORNER] - xy[RIGHT_EYE_CORNER]
    angle = float(np.arctan2(eyes[1], eyes[0]))
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    level = xy @ turn
    low, high = level.min(axis=0), level.max(axis=0)
    centre = turn @ ((low + high) / 2.0)
    return FaceRoi(centre if shift is None else centre + shift, MARGIN * float((high - low).max()), angle)


class FaceMesh:
    """Runs the mesh network on several crops at once; holds no state between calls."""

    OUTPUTS = {"output_mesh_identity": 3 * VERTICES, "output_lips": 160, "output_left_eye": 142,
               "output_right_eye": 142, "output_left_iris": 10, "output_right_iris": 10, "conv_faceflag": 1}
    """Outputs that the model must have, and their sizes. Its "left" is the left of the image: the subject's right."""

    def __init__(self, model: OnnxModel) -> None:
        """model: face_landmarks_attention.onnx."""
        self._model = model

    def run(self, bgr: np.ndarray, rois: Sequence[FaceRoi]) -> List[FaceMeshResult]:
        """One result per crop, in order, of a (H, W, 3) uint8 image."""
        if not rois:
            return []
        batch = np.empty((len(rois), INPUT_SIZE, INPUT_SIZE, 3), np.float32)
        affines = []
        for crop, roi in zip(batch, rois):
            patch, affine = crop_rotated(bgr, roi.centre, roi.size, roi.angle, INPUT_SIZE)
            crop[...] = cv2.cvtColor(patch, cv2.COLOR_BGR2RGB)
            affines.append(affine)
        batch *= 1.0 / 255.0
        out = {name: values.reshape(len(rois), -1).astype(np.float64)
               for name, values in self._model.run({"input_1": batch}).items()}
        results = []
        for i, (roi, affine) in enumerate(zip(rois, affines)):
            points = _assemble({name: values[i] for name, values in out.items()})
            points[:, :2] = points[:, :2] @ affine[:, :2].T + affine[:, 2]
            points[:, 2] *= roi.size / INPUT_SIZE
            logit = min(50.0, max(-50.0, float(out["conv_faceflag"][i, 0])))
            results.append(FaceMeshResult(1.0 / (1.0 + np.exp(-logit)), points))
        return results


def _assemble(out: Dict[str, np.ndarray]) -> np.ndarray:
    """Join the outputs of the network for one face to (478, 3) crop px."""
    points = np.empty((POINTS, 3))
    points[:VERTICES] = out["output_mesh_identity"].reshape(VERTICES, 3)
    points[_LIPS, :2] = out["output_lips"].reshape(-1, 2)
    points[_RIGHT_EYE_REGION, :2] = out["output_left_eye"].reshape(-1, 2)
    points[_LEFT_EYE_REGION, :2] = out["output_right_eye"].reshape(-1, 2)
    points[468:473, :2] = out["output_left_iris"].reshape(-1, 2)
    points[473:478, :2] = out["output_right_iris"].reshape(-1, 2)
    points[468:473, 2] = points[_RIGHT_EYE_REGION[:_CONTOUR], 2].mean()
    points[473:478, 2] = points[_LEFT_EYE_REGION[:_CONTOUR], 2].mean()
    return points
