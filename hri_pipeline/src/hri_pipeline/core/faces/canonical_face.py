"""The canonical face: 468 vertices of a mean face in metres, and the frame fixed to it.

The file canonical_face.npz holds MediaPipe's canonical face model (Apache-2.0) converted from centimetres:
`vertices` (468, 3) m with x to the right of the image, y up, z towards the camera, and the 33 vertices
(`procrustes_index`) whose place hardly changes with the expression.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hri_pipeline.core.faces.face_landmarks import LANDMARK_TO_MESH
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.onnx_model import ModelError

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
