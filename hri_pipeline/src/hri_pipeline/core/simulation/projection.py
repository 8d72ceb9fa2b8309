"""The people of a scene in the image: landmarks of faces, key points of bodies, boxes. No picture is made."""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose

HIP_HEIGHT = 0.521
"""Height of the hip joints in statures, and the lengths below: joint centres of the mean of ANSUR II (Gordon et al.,
NATICK/TR-15/007, 2014) and of de Leva (J. Biomechanics 29, 1996)."""
_TRUNK, _HALF_SHOULDERS, _HALF_HIPS, _UPPER_ARM, _FOREARM, _THIGH, _SHANK = (
    0.278,
    0.105,
    0.052,
    0.163,
    0.154,
    0.240,
    0.241,
)
_EYES_CENTRE = -0.013   # x of the eyes in the face frame, m
_HEAD_AXIS = -0.08      # x of the axis about which a head is roughly a cylinder, m


def _template() -> np.ndarray:
    """(70, 3) m in the face frame (x out, y to the subject's left, z up, origin at the sellion), a relaxed adult
    face."""
    points: List[Tuple[float, float, float]] = []
    for index in range(17):
        turn = math.pi * index / 16.0
        points.append((-0.09 + 0.075 * math.sin(turn), -0.072 * math.cos(turn), -0.01 - 0.105 * math.sin(turn)))
    brow = [(-0.022, 0.058, 0.014), (-0.012, 0.048, 0.021), (-0.007, 0.037, 0.024), (-0.004, 0.026, 0.022),
            (-0.002, 0.015, 0.018)]
    points += [(x, -y, z) for x, y, z in brow] + brow[::-1]
    points += [(0.0, 0.0, 0.0), (0.006, 0.0, -0.015), (0.013, 0.0, -0.030), (0.020, 0.0, -0.045)]
    points += (
        [(0.005, y, -0.052) for y in (-0.016, -0.008)]
        + [(0.010, 0.0, -0.055)]
        + [(0.005, y, -0.052) for y in (0.008, 0.016)]
    )
    eye = [(0.047, 0.0), (0.038, 1.0), (0.027, 1.0), (0.018, 0.0), (0.027, -1.0), (0.038, -1.0)]
    points += [(_EYES_CENTRE, -y, 0.0055 * z) for y, z in eye]
    points += [(_EYES_CENTRE, eye[index][0], 0.0055 * eye[index][1]) for index in (3, 2, 1, 0, 5, 4)]
    for half, tall, count in ((0.026, 0.009, 6), (0.021, 0.003, 4)):
        for index in range(2 * count):
            turn = math.pi * index / count
            points.append((0.004, -half * math.cos(turn), -0.075 + tall * math.sin(turn)))
    return np.array(points + [(_EYES_CENTRE, -0.0325, 0.0), (_EYES_CENTRE, 0.0325, 0.0)])


FACE = _template()
FACE.setflags(write=False)
_EYE_LIDS = [37, 38, 40, 41, 43, 44, 46, 47]
_LOWER_LIP = [55, 56, 57, 58, 59, 65, 66, 67, 7, 8, 9]
_NORMALS = (FACE - np.array([_HEAD_AXIS, 0.0, 0.0])) * np.array([1.0, 1.0, 0.0])
_NORMALS = _NORMALS / np.linalg.norm(_NORMALS, axis=1, keepdims=True)


def landmarks(face: Pose, camera: CameraModel, eyes_closed: float = 0.0, mouth: float = 0.0) -> np.ndarray:
    """Return (70, 3) x px, y px, confidence of a face; a point that is behind the head or outside the image has little
    or none.

    face: face frame in the optical frame. eyes_closed, mouth: how far lids are closed and the jaw has dropped, 0 to 1.
    """
    points = FACE.copy()
    points[_EYE_LIDS, 2] *= 1.0 - 0.9 * eyes_closed
    points[_LOWER_LIP, 2] -= 0.012 * mouth
    placed = face.apply(points)
    towards = -placed / np.maximum(np.linalg.norm(placed, axis=1, keepdims=True), 1e-9)
    facing = ((_NORMALS @ face.rotation.T) * towards).sum(axis=1)
    return _seen(camera.project(placed), np.clip((facing + 0.2) / 0.4, 0.05, 1.0), camera)


def keypoints(body: Pose, head: Pose, stature: float, camera: CameraModel) -> np.ndarray:
    """Return (18, 3) x px, y px, confidence of somebody who stands upright, in the order of hri_msgs/Skeleton2D.

    body, head: body and face frame in the optical frame. stature: m.
    """
    placed = body.apply(stature * _standing())
    face = head.apply(np.array([(0.020, 0.0, -0.045), (-0.013, 0.0325, 0.0), (-0.013, -0.0325, 0.0),
                                (-0.10, 0.072, -0.01),
                                (-0.10, -0.072, -0.01)]))
    points = np.vstack([face[:1], placed, face[1:]])
    confidence = np.full(len(points), 0.9)
    away = float(head.rotation[:, 0] @ head.translation) > 0.0
    confidence[[0, 14, 15]] = 0.1 if away else 0.9
    return _seen(camera.project(points), confidence, camera)


def box(points: np.ndarray, margin: float) -> np.ndarray:
    """Return x0, y0, x1, y1 px around the points (N, 3) that are known, wider by `margin` of its size on each side;
    zeros without any."""
    known = points[np.isfinite(points[:, :2]).all(axis=1), :2]
    if not len(known):
        return np.zeros(4)
    low, high = known.min(axis=0), known.max(axis=0)
    return np.concatenate([low - margin * (high - low), high + margin * (high - low)])


def _standing() -> np.ndarray:
    """(13, 3) neck, right arm, left arm, right leg, left leg in statures, in the body frame (origin between the
    hips)."""
    def arm(side: float) -> List[Tuple[float, float, float]]:
        shoulder = side * _HALF_SHOULDERS
        return [(0.0, shoulder, _TRUNK), (0.01, 1.15 * shoulder, _TRUNK - _UPPER_ARM),
                (0.04, 1.15 * shoulder, _TRUNK - _UPPER_ARM - _FOREARM)]

    def leg(side: float) -> List[Tuple[float, float, float]]:
        hip = side * _HALF_HIPS
        return [(0.0, hip, 0.0), (0.0, hip, -_THIGH), (-0.01, hip, -_THIGH - _SHANK)]
    return np.array([(0.0, 0.0, _TRUNK), *arm(-1.0), *arm(1.0), *leg(-1.0), *leg(1.0)])


def _seen(pixels: np.ndarray, confidence: np.ndarray, camera: CameraModel) -> np.ndarray:
    inside = (
        (pixels[:, 0] >= 0.0) & (pixels[:, 1] >= 0.0) & (pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)
    )
    return np.column_stack([pixels, np.where(inside, confidence, 0.0)])
