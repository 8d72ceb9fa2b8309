"""The measures of `action_units_table` on a face mesh, without the head's pose and the picture's scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.faces.action_units_table import EYE_MIDDLES, MEASURES, MIRROR, RIGID, Measure, Points
from hri_pipeline.core.faces.canonical_face import CanonicalFace
from hri_pipeline.core.faces.face_mesh import POINTS

_AXES = {"up": np.array([0.0, -1.0, 0.0]), "left": np.array([1.0, 0.0, 0.0])}
"""In the axes of the canonical face: x to the subject's left, y down, z into the head."""
_GRAZING, _FACING = 0.0, 0.35
"""Cosine between a point's normal and the direction to the camera: not seen, and well seen."""


@dataclass(frozen=True)
class MeasuredFace:
    """values: (M, 2) measures on the subject's right and left (equal where there is one only), in parts of the
    distance of the eyes; visible: (M, 2) 0 to 1; rotation: (3, 3), turns canonical axes into those of the image;
    eye_distance: px, as of a face seen from the front; residual: root-mean-square misfit of the rigid points.
    """

    values: np.ndarray
    visible: np.ndarray
    rotation: np.ndarray
    eye_distance: float
    residual: float


class FaceMeasures:
    """Lays meshes onto the canonical face and takes the measures. Holds no state: one serves all faces."""

    names = tuple(measure.name for measure in MEASURES)

    def __init__(self, face: CanonicalFace) -> None:
        self.frame_rotation = face.face_frame().rotation
        eyes = [face.vertices[list(middle)].mean(axis=0) for middle in EYE_MIDDLES]
        model = face.vertices / float(np.linalg.norm(eyes[1] - eyes[0]))
        self._rigid = np.array(sorted(set(RIGID) | {MIRROR[i] for i in RIGID if i in MIRROR}))
        self._model = model[self._rigid] - model[self._rigid].mean(axis=0)
        rows = [_row(measure, side) for measure in MEASURES for side in (False, True)]
        self._used = np.array(sorted({point for row in rows for point, _, _ in row}))
        place = {point: index for index, point in enumerate(self._used)}
        self._weights = np.zeros((len(rows), len(self._used), 3))
        share = np.zeros((2, len(rows), len(self._used)))
        for number, row in enumerate(rows):
            for point, end, weight in row:
                self._weights[number, place[point]] += weight
                share[end, number, place[point]] += 1.0
        self._weights = self._weights.reshape(len(rows), -1)
        self._share = share / share.sum(axis=2, keepdims=True)
        self._normals = _normals(face)[self._used]

    def measure(self, mesh: np.ndarray, image_size: Optional[Tuple[int, int]] = None) -> Optional[MeasuredFace]:
        """Measure a mesh (478, 3) px; image_size: width, height px: points outside count as not seen.

        None when the mesh is not finite or has no extent. Raises ValueError for another shape.
        """
        mesh = np.asarray(mesh, dtype=np.float64)
        if mesh.shape != (POINTS, 3):
            raise ValueError("expected a mesh of ({}, 3), got {}".format(POINTS, mesh.shape))
        rigid = mesh[self._rigid]
        if not np.isfinite(mesh).all() or np.ptp(rigid, axis=0).max() < 1.0:
            return None
        centre = rigid.mean(axis=0)
        turn, scale, residual = _procrustes(rigid - centre, self._model)
        points = mesh[self._used]
        values = self._weights @ (scale * (points - centre) @ turn).ravel()
        # Towards the camera is -z of the image, seen in canonical axes.
        seen = np.clip((self._normals @ -turn[2] - _GRAZING) / (_FACING - _GRAZING), 0.0, 1.0)
        if image_size is not None:
            seen = seen * ((points[:, :2] >= 0.0) & (points[:, :2] < image_size)).all(axis=1)
        # Both ends of a measure must be seen.
        visible = np.minimum(self._share[0] @ seen, self._share[1] @ seen)
        return MeasuredFace(values.reshape(-1, 2), visible.reshape(-1, 2), turn, 1.0 / scale, residual)


def _procrustes(points: np.ndarray, model: np.ndarray) -> Tuple[np.ndarray, float, float]:
    """Rotation R (3, 3), scale s and residual of the least-squares fit s points R = model, both centred (Schönemann
    1966, scale after Umeyama 1991)."""
    u, singular, vt = np.linalg.svd(points.T @ model)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    turn = (u * sign) @ vt
    scale = float((singular * sign).sum() / (points ** 2).sum())
    residual = float(np.sqrt((((scale * points @ turn) - model) ** 2).sum(axis=1).mean()))
    return turn, max(scale, 1e-9), residual


def _row(measure: Measure, left: bool) -> Sequence[Tuple[int, int, np.ndarray]]:
    """(vertex, end 0 or 1, weight (3,)) of the points of a measure on one side; end: 0 `of`, 1 `over`."""
    axis = _AXES["up"] if measure.axis == "up" else _AXES["left"]
    if measure.axis == "out" and not left:
        axis = -axis
    row = []
    for end, (points, sign) in enumerate(((measure.of, 1.0), (measure.over, -1.0))):
        # What has no sides takes the points of both, so that a turned head does not bias it.
        chosen = _mirrored(points) if left and measure.sided else points
        if not measure.sided:
            chosen = tuple(sorted(set(points) | set(_mirrored(points))))
        row += [(point, end, sign * axis / len(chosen)) for point in chosen]
    return row


def _mirrored(points: Points) -> Points:
    return tuple(MIRROR.get(point, point) for point in points)


def _normals(face: CanonicalFace) -> np.ndarray:
    """(478, 3) outward unit directions, as of a cylinder about the neck's axis; irises as their eyes."""
    points = np.concatenate([face.vertices, np.zeros((POINTS - len(face.vertices), 3))])
    for first, middle in zip((468, 473), EYE_MIDDLES):
        points[first:first + 5] = face.vertices[list(middle)].mean(axis=0)
    normals = points - np.array([0.0, 0.0, 0.02])
    normals[:, 1] = 0.0
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
