"""The 478-point face mesh: its network, the 70 landmarks, the canonical face, whether a mesh lies on a face, and
blendshapes.

Network: the attention mesh refines the lips, the eyes and the irises of the 468-vertex mesh (Grishchenko et al. 2020,
"Attention Mesh"); here the refined points replace the coarse ones, and the ten iris points are appended. Vertex lists:
MediaPipe's published landmark-refinement graph (Apache-2.0).

Landmarks of hri_msgs/FacialLandmarks: points 0..67 follow the order of dlib's 68-point predictor (iBUG 300-W mark-up),
68 and 69 are the pupils. The correspondence of mesh vertices and the 68 points is found in many public repositories;
four entries of it are corrected here (0: 162 -> 127, 16: 389 -> 356, 17: 71 -> 70, 26: 301 -> 300) after a comparison
with dlib's predictor on 34 faces: mean distance over outer-eye distance 0.061 -> 0.056, jaw 0.119 -> 0.105, brows 0.067
-> 0.056. The jaw of the 68 points is an image contour, the mesh's is a place on the skin, so a difference remains
there. "Right" and "left" are the subject's.

Canonical face: 468 vertices of a mean face in metres, and the frame fixed to it. The file canonical_face.npz holds
MediaPipe's canonical face model (Apache-2.0) converted from centimetres: `vertices` (468, 3) m with x to the right of
the image, y up, z towards the camera, and the 33 vertices (`procrustes_index`) that hardly move with the expression.

Blendshapes: how strongly each of 52 movements is made, by MediaPipe's network (Grishchenko et al., "Blendshapes GHUM:
Real-time monocular facial blendshape prediction", 2023). It sees 146 of the mesh's points in the image, removes place
and size itself, and gives coefficients of 0 (not at all) to 1 by the names of ARKit, of the subject's sides. They know
eyelids better than a ratio of lengths does, as they were learnt from many people.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence, Tuple, Union

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel, FacingView
from hri_pipeline.core.faces.detector import LEFT_EYE_KEYPOINT, RIGHT_EYE_KEYPOINT, FaceDetection
from hri_pipeline.core.geometry import Pose, crop_rotated, lowest_highest
from hri_pipeline.core.onnx import FETCH_HINT, ModelError, OnnxModel
from hri_pipeline.core.process import Threads

MESH_POINTS = 478
LANDMARKS = 70
JAW = (127, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 356)
RIGHT_BROW = (70, 63, 105, 66, 107)
LEFT_BROW = (336, 296, 334, 293, 300)
NOSE_BRIDGE = (168, 197, 5, 4)
NOSTRILS = (75, 97, 2, 326, 305)
RIGHT_EYE = (33, 160, 158, 133, 153, 144)
LEFT_EYE = (362, 385, 387, 263, 373, 380)
OUTER_LIPS = (61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181)
INNER_LIPS = (78, 82, 13, 312, 308, 317, 14, 87)
PUPILS = (468, 473)
LANDMARK_TO_MESH = np.array(
    JAW + RIGHT_BROW + LEFT_BROW + NOSE_BRIDGE + NOSTRILS + RIGHT_EYE + LEFT_EYE + OUTER_LIPS
    + INNER_LIPS + PUPILS
)
"""(70,) mesh vertex of each landmark."""
LANDMARK_TO_MESH.setflags(write=False)
VERTICES = 468
SELLION = 168
"""Vertex of the sellion: the deepest point of the nasal bridge, least z on the mid-line of the model."""
PITCH_BIAS = np.deg2rad(-1.5)
"""Angle (rad) by which the model's z axis points below the direction of the face in frontal portraits.

Measured against the line of sight with the points of `head_pose`, on 30 faces within 22 degrees of the camera and with
open eyes: 12 of the demo photographs (median 3 degrees above this, many chins are held low) and 18 other portraits
(median 3 degrees below it). Another set of points has another bias: with the 33 Procrustes points it is about 0.
"""
_HEAD_CENTRE_Z = -0.02
"""Depth (m) of the axis about which the face is roughly a cylinder."""
INPUT_SIZE = 192
MARGIN = 1.5
"""Side of the crop over the side of the face's box."""
RIGHT_EYE_CORNER, LEFT_EYE_CORNER = 33, 263
_FOREHEAD, _CHIN = 10, 152
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
_KEYPOINT_VERTICES = ((33, 133), (362, 263), (1,), (13, 14))
"""Vertices in the middle of which the detector's first key points lie: right eye, left eye, tip of nose, mouth."""
_CONTOUR = 16
"""The first 16 vertices of an eye region are the eyelids' contour."""
MIN_INSIDE = 0.3
"""Least fraction of the mesh's points that must lie in the image."""
MIN_SIZE = 8.0
"""Least size (px) of a mesh that can be a face."""
TURN = 0.3
"""Angle (rad) by which a crop is turned to verify a face: its mesh must stay on the face."""
AGAIN_ABOVE, AGAIN_SPAN = 0.06, 0.06
"""What the score of a face that is looked for again exceeds the least score of a new one by when nothing is said, and
the difference from it at which the verification score is -1 or 1."""
AGREEMENT = 0.03
"""Mean distance of the detector's eyes, nose and mouth from the mesh's, over its size, up to which they agree."""
SPREAD_LIMIT, SPREAD_SLOPE, SPREAD_LEAST, SPREAD_SPAN = 0.05, 0.15, 0.03, 0.03
"""Legal spread (see `mesh_spread`) of a face that the detector sees with a score of 0.45, its growth with the score,
its least value, and the difference from it at which the verification score is -1 or 1."""


def landmarks_from_meshes(meshes: Sequence[np.ndarray], presences: Sequence[float], width: int, height: int,
                          visibilities: Sequence[np.ndarray]) -> np.ndarray:
    """The 70 landmarks of several faces at once, (F, 70, 3): x px, y px, confidence 0 to 1.

    Parameters
    ----------
    meshes
        (478, 2 or more) px each.
    presences
        Probability 0 to 1 that a mesh lies on a face.
    width, height
        Size of the image, px. A point outside it is a guess of the network: its confidence is 0.
    visibilities
        (70,) 0 to 1 each, how much the points are turned towards the camera (see `HeadPoseEstimator.visibility`).

    Raises
    ------
    ValueError
        When a mesh has another shape.
    """
    points = np.empty((len(meshes), LANDMARKS, 3))
    for place, mesh in zip(points, meshes):
        if np.ndim(mesh) != 2 or len(mesh) != MESH_POINTS or mesh.shape[1] < 2:
            raise ValueError("expected a mesh of (%d, 3), got %r" % (MESH_POINTS, np.shape(mesh)))
        place[:, :2] = mesh[LANDMARK_TO_MESH, :2]
    if len(meshes):
        xy = points[..., :2]
        inside = ((xy >= 0.0) & (xy < (width, height))).all(axis=2)
        seen = np.minimum(np.maximum(np.stack(visibilities), 0.0), 1.0)
        points[..., 2] = np.minimum(np.maximum(presences, 0.0), 1.0)[:, None] * seen * inside
    return points


def bounding_box(points: np.ndarray) -> np.ndarray:
    """x0, y0, x1, y1 (4,) px of points (N, 2 or more)."""
    return np.concatenate(lowest_highest(points[:, :2]))


@dataclass(frozen=True)
class CanonicalFace:
    """vertices: (468, 3) m in the axes of an optical frame (x right, y down, z away from the camera);
    rigid: (33,) indices of vertices that the expression hardly moves."""

    vertices: np.ndarray
    rigid: np.ndarray

    def face_frame(self) -> Pose:
        """Pose of the face frame in the model: origin at the sellion, x out of the face, y to the
        subject's left, z to the scalp. `PITCH_BIAS` is taken out here."""
        cosine, sine = np.cos(PITCH_BIAS), np.sin(PITCH_BIAS)
        x_axis = np.array([0.0, -sine, -cosine])
        y_axis = np.array([1.0, 0.0, 0.0])
        z_axis = np.cross(x_axis, y_axis)
        return Pose(np.stack([x_axis, y_axis, z_axis], axis=1), self.vertices[SELLION].copy())

    def landmark_normals(self) -> np.ndarray:
        """(70, 3) outward unit directions at the landmarks, as of a cylinder about the neck's axis.

        Good enough to tell the hidden cheek of a face in profile from the one that is seen.
        """
        index = np.where(LANDMARK_TO_MESH < VERTICES, LANDMARK_TO_MESH, 0)
        points = self.vertices[index].copy()
        points[68] = self.vertices[[33, 133]].mean(axis=0)
        points[69] = self.vertices[[263, 362]].mean(axis=0)
        return _away_from_axis(points)

    def outward_normals(self, indices: np.ndarray) -> np.ndarray:
        """(N, 3) outward unit directions at vertices, as of a cylinder about the neck's axis."""
        return _away_from_axis(self.vertices[indices].copy())


def _away_from_axis(points: np.ndarray) -> np.ndarray:
    normals = points - np.array([0.0, 0.0, -_HEAD_CENTRE_Z])
    normals[:, 1] = 0.0
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)


def load_canonical_face(path: Path) -> CanonicalFace:
    """Read canonical_face.npz. Raises ModelError naming the file when it is not such a model."""
    try:
        with np.load(str(path), allow_pickle=False) as data:
            vertices = np.array(data["vertices"], dtype=np.float64)
            rigid = np.array(data["procrustes_index"], dtype=np.int64)
    except (OSError, ValueError, KeyError) as error:
        raise ModelError("%s is no canonical face model (%s); run `rosrun hri_pipeline fetch_models`"
                         % (path, error)) from error
    if vertices.shape != (VERTICES, 3) or not np.isfinite(vertices).all():
        raise ModelError("%s: expected %d finite vertices, got %r" % (path, VERTICES, vertices.shape))
    if rigid.ndim != 1 or len(rigid) < 6 or rigid.min() < 0 or rigid.max() >= VERTICES:
        raise ModelError("%s: procrustes_index is out of range" % (path,))
    if not 0.1 < np.ptp(vertices[:, 0]) < 0.3:
        raise ModelError("%s: the face is %.3f wide; metres expected" % (path, np.ptp(vertices[:, 0])))
    return CanonicalFace(vertices * np.array([1.0, -1.0, -1.0]), rigid)


@dataclass(frozen=True)
class FaceRoi:
    """A rotated square of the image: centre (2,) px, side size px, angle rad (x axis towards image y).

    view: where it lies in the view of a camera that looks at it, and not in the image.
    """

    centre: np.ndarray
    size: float
    angle: float
    view: Optional[FacingView] = None


@dataclass(frozen=True)
class FaceMeshResult:
    """presence: probability 0..1 that there is a face; points: (478, 3) px, z away from the camera in the
    scale of x, relative to the head."""

    presence: float
    points: np.ndarray


def roi_from_detection(detection: FaceDetection) -> FaceRoi:
    """Crop for a detected face: its box with a margin, turned so that the eyes are level."""
    eyes = detection.keypoints[LEFT_EYE_KEYPOINT] - detection.keypoints[RIGHT_EYE_KEYPOINT]
    size = float((detection.box[2:] - detection.box[:2]).max())
    centre = (detection.box[:2] + detection.box[2:]) / 2.0
    return FaceRoi(centre, MARGIN * size, float(np.arctan2(eyes[1], eyes[0])))


def roi_from_mesh(points: np.ndarray, shift: Optional[np.ndarray] = None,
                  camera: Optional[CameraModel] = None) -> FaceRoi:
    """Crop for the next frame from the mesh (478, 3) px of this one, moved by shift (2,) px.

    camera: of the image. Where it is calibrated, the crop is that of a camera that looks at the face: aside of the
    optical axis an image is stretched, and the network has learnt what faces look like ahead.
    """
    places = points[:, :2] if shift is None else points[:, :2] + shift
    view = None if camera is None else camera.facing_view(places)
    if view is None:
        return level_roi(places, RIGHT_EYE_CORNER, LEFT_EYE_CORNER, MARGIN)
    # What lies outermost in the image does so in the view: the other points need not go through the lens.
    hull = cv2.convexHull(places.astype(np.float32))[:, 0]
    outline = np.concatenate([places[[RIGHT_EYE_CORNER, LEFT_EYE_CORNER]], hull])
    return replace(level_roi(view.see(outline), 0, 1, MARGIN), view=view)


def level_roi(points: np.ndarray, right: int, left: int, margin: float) -> FaceRoi:
    """Square around points (N, 2) px, turned so that the line from number `right` to number `left` of them is level.

    margin: its side over the larger side of the points' box.
    """
    eyes = points[left] - points[right]
    angle = float(np.arctan2(eyes[1], eyes[0]))
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    level = points @ turn
    low, high = level.min(axis=0), level.max(axis=0)
    return FaceRoi(turn @ ((low + high) / 2.0), margin * float((high - low).max()), angle)


def eye_share(points: np.ndarray) -> float:
    """Distance between the outer corners of the eyes over that from forehead to chin, of a mesh (478, 2 or more) px.

    0.49 to 0.69 on faces turned by up to 50 degrees, below on others.
    """
    eyes, height = points[LEFT_EYE_CORNER] - points[RIGHT_EYE_CORNER], points[_CHIN] - points[_FOREHEAD]
    return math.hypot(eyes[0], eyes[1]) / max(1e-6, math.hypot(height[0], height[1]))


class FaceMesh:
    """Runs the mesh network on several crops at once; holds no state between calls."""

    OUTPUTS = {"output_mesh_identity": 3 * VERTICES, "output_lips": 160, "output_left_eye": 142,
               "output_right_eye": 142, "output_left_iris": 10, "output_right_iris": 10, "conv_faceflag": 1}
    """Outputs that the model must have, and their sizes. Its "left" is the left of the image: the subject's right."""

    def __init__(self, model: OnnxModel) -> None:
        """model: face_landmarks_attention.onnx."""
        self._model = model

    @property
    def threads(self) -> Threads:
        """Those that share the crops now: others once a graphics card has failed."""
        return self._model.threads

    def together_on_card(self, count: int) -> int:
        """How many of so many crops take hardly longer than one, on a graphics card; 0: they run on the CPU."""
        return self._model.together_on_card(count)

    def run(self, bgr: np.ndarray, rois: Sequence[FaceRoi]) -> List[FaceMeshResult]:
        """Run the network; one result per crop, in order. The model's threads share the crops.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8.
        rois
            Rotated squares of the image, all in one batch.

        Raises
        ------
        ModelError
            When the network fails.
        """
        if not rois:
            return []
        affines, found = self._model.run_items(rois, lambda roi, place: _crop(bgr, roi, place),
                                              (INPUT_SIZE, INPUT_SIZE, 3))
        out = {name: values.reshape(len(rois), -1).astype(np.float64) for name, values in found.items()}
        results = []
        for i, (roi, affine) in enumerate(zip(rois, affines)):
            points = _assemble({name: values[i] for name, values in out.items()})
            points[:, :2] = points[:, :2] @ affine[:, :2].T + affine[:, 2]
            if roi.view is not None:
                points[:, :2] = roi.view.back(points[:, :2])
            points[:, 2] *= roi.size / INPUT_SIZE
            logit = min(50.0, max(-50.0, float(out["conv_faceflag"][i, 0])))
            results.append(FaceMeshResult(1.0 / (1.0 + np.exp(-logit)), points))
        return results


def cut_square(bgr: np.ndarray, roi: FaceRoi, size: int) -> Tuple[np.ndarray, np.ndarray]:
    """Return the picture (size, size, 3) of a rotated square, and the affine (2, 3) from it to where that lies."""
    crop = partial(crop_rotated, bgr) if roi.view is None else partial(roi.view.crop, bgr)
    return crop(roi.centre.tolist(), roi.size, roi.angle, size)


def _crop(bgr: np.ndarray, roi: FaceRoi, out: np.ndarray) -> np.ndarray:
    """Write a crop as RGB in [0, 1] to `out` (S, S, 3); returns the affine (2, 3) from it to where the square lies."""
    patch, affine = cut_square(bgr, roi, INPUT_SIZE)
    np.multiply(cv2.cvtColor(patch, cv2.COLOR_BGR2RGB), np.float32(1.0 / 255.0), out=out)
    return affine


def _assemble(out: Dict[str, np.ndarray]) -> np.ndarray:
    """Join the outputs of the network for one face to (478, 3) crop px."""
    points = np.empty((MESH_POINTS, 3))
    points[:VERTICES] = out["output_mesh_identity"].reshape(VERTICES, 3)
    points[_LIPS, :2] = out["output_lips"].reshape(-1, 2)
    points[_RIGHT_EYE_REGION, :2] = out["output_left_eye"].reshape(-1, 2)
    points[_LEFT_EYE_REGION, :2] = out["output_right_eye"].reshape(-1, 2)
    points[468:473, :2] = out["output_left_iris"].reshape(-1, 2)
    points[473:478, :2] = out["output_right_iris"].reshape(-1, 2)
    points[468:473, 2] = points[_RIGHT_EYE_REGION[:_CONTOUR], 2].mean()
    points[473:478, 2] = points[_LEFT_EYE_REGION[:_CONTOUR], 2].mean()
    return points


def is_face(result: FaceMeshResult, width: int, height: int, min_presence: float) -> bool:
    """Whether the mesh is sound, lies on a face, and enough of it lies in the image."""
    if result.presence < min_presence or not np.isfinite(result.points).all():
        return False
    x0, y0, x1, y1 = bounding_box(result.points).tolist()
    if max(x1 - x0, y1 - y0) < MIN_SIZE:
        return False
    if x0 >= 0.0 and y0 >= 0.0 and x1 < width and y1 < height:
        return True
    x, y = result.points[:, 0], result.points[:, 1]
    inside = (x >= 0.0) & (y >= 0.0) & (x < width) & (y < height)
    return bool(np.count_nonzero(inside) >= MIN_INSIDE * len(inside))


def mesh_spread(straight: FaceMeshResult, turned: FaceMeshResult) -> float:
    """Mean distance between the points of a mesh and those found in a turned crop, over the size of the face.

    On faces it is 0.02 (median) to 0.06, on false detections 0.12.
    """
    xy = straight.points[:, :2]
    size = max(1.0, float(np.ptp(xy, axis=0).mean()))
    return float(np.linalg.norm(xy - turned.points[:, :2], axis=1).mean()) / size


def verification_score(score: float, straight: FaceMeshResult, turned: FaceMeshResult) -> float:
    """Score of the verification, -1 (no face) to 1 (a face), from the detection score (0 to 1) and the mesh of a turned
    crop."""
    if not np.isfinite(turned.points).all():
        return -1.0
    legal = max(SPREAD_LEAST, SPREAD_LIMIT + SPREAD_SLOPE * (score - 0.45))
    return min(1.0, max(-1.0, (legal - mesh_spread(straight, turned)) / SPREAD_SPAN))


def agreement_score(again: Optional[FaceDetection], straight: FaceMeshResult, min_score: float) -> float:
    """Score of the verification, -1 (no face) to 1 (a face), from a second look of the detector.

    Two networks that were trained apart must see a face, and its eyes, nose and mouth at the same places. On 247 faces
    of photographs and films, down to 30 px, half of them turned away, the score less the distance beyond `AGREEMENT` is
    0.69 and more, on 104 things that were taken for a face for a moment 0.66 and less.

    Parameters
    ----------
    again
        The face that `FaceDetector.look_again` has found, None for none.
    straight
        The mesh.
    min_score
        Detection score (0 to 1) that a new face needs.
    """
    if again is None:
        return -1.0
    xy = straight.points[:, :2]
    places = np.array([xy[list(vertices)].mean(axis=0) for vertices in _KEYPOINT_VERTICES])
    size = max(1.0, float(np.ptp(xy, axis=0).max()))
    apart = float(np.linalg.norm(again.keypoints[:len(places)] - places, axis=1).mean()) / size
    evidence = again.score - max(0.0, apart - AGREEMENT)
    return float(min(1.0, max(-1.0, (evidence - min_score - AGAIN_ABOVE) / AGAIN_SPAN)))


def turned_roi(roi: FaceRoi) -> FaceRoi:
    """The same square turned by TURN, to verify a face."""
    return replace(roi, angle=roi.angle + TURN)


def is_sound(result: FaceMeshResult) -> bool:
    """Whether the mesh can be cropped again: finite, and not too small."""
    xy = result.points[:, :2]
    return bool(np.isfinite(result.points).all() and np.ptp(xy, axis=0).max() >= MIN_SIZE)


COUNT = 52
POINTS = np.array([
    0, 1, 4, 5, 6, 7, 8, 10, 13, 14, 17, 21, 33, 37, 39, 40, 46, 52, 53, 54, 55, 58, 61, 63, 65, 66, 67, 70, 78, 80, 81,
    82, 84, 87, 88, 91, 93, 95, 103, 105, 107, 109, 127, 132, 133, 136, 144, 145, 146, 148, 149, 150, 152, 153, 154,
    155, 157, 158, 159, 160, 161, 162, 163, 168, 172, 173, 176, 178, 181, 185, 191, 195, 197, 234, 246, 249, 251, 263,
    267, 269, 270, 276, 282, 283, 284, 285, 288, 291, 293, 295, 296, 297, 300, 308, 310, 311, 312, 314, 317, 318, 321,
    323, 324, 332, 334, 336, 338, 356, 361, 362, 365, 373, 374, 375, 377, 378, 379, 380, 381, 382, 384, 385, 386, 387,
    388, 389, 390, 397, 398, 400, 402, 405, 409, 415, 454, 466, 468, 469, 470, 471, 472, 473, 474, 475, 476, 477])
"""(146,) vertices of the mesh that the network reads, in its order: the interface of the model."""
Sides = Tuple[int, int]
"""Index of a movement on the subject's right, and on the left."""
EYE_BLINK: Sides = (10, 9)
LOOK_DOWN: Sides = (12, 11)
LOOK_IN: Sides = (14, 13)
LOOK_OUT: Sides = (16, 15)
LOOK_UP: Sides = (18, 17)
_INPUT, _OUTPUT = "serving_default_input_points:0", "StatefulPartitionedCall:0"


class Blendshapes:
    """Runs the network on the meshes of several faces at once; holds no state between calls."""

    def __init__(self, path: Union[str, Path], providers: Sequence[str] = ("cpu",),
                 notify: Optional[Callable[[str], None]] = None) -> None:
        """path: face_blendshapes.onnx. Raises ModelError naming the file when it is missing or another model."""
        self._model = OnnxModel(path, providers, inputs=(_INPUT,), outputs=(_OUTPUT,), notify=notify, few_on_cpu=True)
        trial = self._model.run({_INPUT: np.ones((1, len(POINTS), 2), np.float32)})[_OUTPUT]
        if trial.shape != (1, COUNT):
            raise ModelError("model file {} gives {} instead of {} blendshapes; it is another model: {}".format(
                path, trial.shape, COUNT, FETCH_HINT))

    def run(self, meshes: Sequence[np.ndarray], camera: Optional[CameraModel] = None) -> np.ndarray:
        """Return the coefficients (F, 52), 0 to 1.

        meshes: (478, 2 or more) px each. camera: of the image; see `roi_from_mesh`. Raises ModelError when the network
        fails.
        """
        if not len(meshes):
            return np.zeros((0, COUNT))
        places = [np.asarray(mesh)[POINTS, :2] for mesh in meshes]
        if camera is not None and camera.is_calibrated:
            places = [camera.facing(points) for points in places]
        points = np.stack(places).astype(np.float32)
        return self._model.run({_INPUT: points})[_OUTPUT].astype(np.float64)
