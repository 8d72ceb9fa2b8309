"""How likely a face and a body are one human's, from one image: eyes, nose and ears of both, and where both heads are."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

# Point of the skeleton (hri_msgs/Skeleton2D), landmarks of which the mean is the same point (dlib's 68
# points), weight. The ears count less: the jaw line ends in front of them.
_SAME_POINTS: Tuple[Tuple[int, Tuple[int, ...], float], ...] = (
    (0, (30,), 1.0),
    (14, (42, 43, 44, 45, 46, 47), 1.0),
    (15, (36, 37, 38, 39, 40, 41), 1.0),
    (16, (16,), 0.3),
    (17, (0,), 0.3),
)
_MIN_WEIGHT = 1.3       # at least two points, one of them an eye or the nose
# Two estimates of one head: across the line of sight (m), and along it, where both are inexact and more so far away.
ACROSS_M, ALONG_M, ALONG_SHARE = 0.2, 0.3, 0.15
PLACES_ALONE = 0.9      # likelihood of two heads at one place of which the image tells nothing


def face_points(landmarks: np.ndarray, aspect: float) -> np.ndarray:
    """Return what the comparison needs of a face: (6, 3), five points x, y, confidence, and its size.

    landmarks: (70, 3) x, y in 0..1 of the image and confidence; aspect: width over height of the image. The
    points are in heights of the image. The last row holds the size of the face three times: the square root
    of the area of the landmarks' bounding box, 0 where it has none.
    """
    points = landmarks * np.array([aspect, 1.0, 1.0])
    found = [(*points[list(indices), :2].mean(axis=0), points[list(indices), 2].min())
             for _, indices, _ in _SAME_POINTS]
    seen = points[points[:, 2] > 0.0, :2]
    extent = np.ptp(seen, axis=0) if len(seen) else np.zeros(2)
    size = math.sqrt(float(extent[0] * extent[1]))
    return np.array(found + [(size, size, size)])


def body_points(skeleton: np.ndarray, aspect: float) -> np.ndarray:
    """Return what the comparison needs of a skeleton (18, 3): (5, 3) x, y, confidence, as in face_points."""
    return skeleton[[joint for joint, _, _ in _SAME_POINTS]] * np.array([aspect, 1.0, 1.0])


def likelihoods(faces: np.ndarray, bodies: np.ndarray, distance_scale: float,
                min_point_confidence: float) -> np.ndarray:
    """Return (F, B) likelihoods that a face and a body are of one human, NaN where too little is seen.

    faces: (F, 6, 3) of face_points, bodies: (B, 5, 3) of body_points. The likelihood is exp(-d^2 / 2 s^2)
    with d the weighted mean distance of the points in sizes of the face and s = distance_scale.
    """
    size = faces[:, None, 5, 0]
    face, body = faces[:, None, :5], bodies[None]
    usable = (face[..., 2] >= min_point_confidence) & (body[..., 2] >= min_point_confidence)
    weights = np.where(usable, [weight for _, _, weight in _SAME_POINTS], 0.0)
    total = weights.sum(axis=2)
    apart = np.hypot(face[..., 0] - body[..., 0], face[..., 1] - body[..., 1])
    known = (total >= _MIN_WEIGHT - 1e-9) & (size > 0.0)
    distance = (weights * apart).sum(axis=2) / np.where(known, total * size, 1.0)
    return np.where(known, np.exp(-0.5 * (distance / distance_scale) ** 2), np.nan)


def place_likelihoods(faces: np.ndarray, bodies: np.ndarray) -> np.ndarray:
    """Return (F, B) likelihoods that faces (F, 3) and heads of skeletons (B, 3) are at one place; NaN where one is NaN.

    Positions in m in the optical frame of one camera, which sees directions exactly and distances less so.
    """
    faces, bodies = faces[:, None], bodies[None]
    apart = faces - bodies
    distance = np.linalg.norm(faces, axis=2)
    sight = faces / np.maximum(distance, 1e-6)[..., None]
    along = np.abs((apart * sight).sum(axis=2))
    across = np.linalg.norm(apart - (apart * sight).sum(axis=2)[..., None] * sight, axis=2)
    return np.exp(-0.5 * ((across / ACROSS_M) ** 2 + (along / (ALONG_M + ALONG_SHARE * distance)) ** 2))


def combined(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Fuse the likelihoods (F, B) of image and places, either of which may be NaN; the image is the more exact one."""
    both = image * np.sqrt(places)
    return np.where(np.isnan(places), image, np.where(np.isnan(image), PLACES_ALONE * places, both))
