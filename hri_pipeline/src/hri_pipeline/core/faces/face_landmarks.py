"""The 70 facial landmarks of hri_msgs/FacialLandmarks taken from the 478-point face mesh.

Points 0..67 follow the order of dlib's 68-point predictor (iBUG 300-W mark-up), 68 and 69 are the
pupils. The correspondence of mesh vertices and the 68 points circulates in many public repositories;
four entries of it are corrected here (0: 162 -> 127, 16: 389 -> 356, 17: 71 -> 70, 26: 301 -> 300) after a
comparison with dlib's predictor on 34 faces: mean distance over outer-eye distance 0.061 -> 0.056, jaw
0.119 -> 0.105, brows 0.067 -> 0.056. The jaw of the 68 points is an image contour, the mesh's is a place on
the skin, so a rest remains there. "Right" and "left" are the subject's.
"""

from __future__ import annotations

import numpy as np

MESH_POINTS = 478
LANDMARKS = 70
RIGHT_PUPIL, LEFT_PUPIL = 68, 69

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


def landmarks_from_mesh(
    mesh: np.ndarray, presence: float, width: int, height: int, visibility: np.ndarray
) -> np.ndarray:
    """The 70 landmarks (70, 3): x px, y px, confidence 0..1.

    mesh: (478, 3) px; presence: probability 0..1 that the mesh lies on a face; visibility: (70,) 0..1, how
    much each point is turned towards the camera (see `visibility_of_landmarks`). A point outside the image
    of width x height px is a guess of the network: its confidence is 0.
    Raises ValueError when the mesh is not (478, 2 or more).
    """
    mesh = np.asarray(mesh, dtype=np.float64)
    if mesh.ndim != 2 or mesh.shape[0] != MESH_POINTS or mesh.shape[1] < 2:
        raise ValueError("expected a mesh of (%d, 3), got %r" % (MESH_POINTS, mesh.shape))
    points = np.empty((LANDMARKS, 3))
    points[:, :2] = mesh[LANDMARK_TO_MESH, :2]
    x, y = points[:, 0], points[:, 1]
    inside = (x >= 0.0) & (y >= 0.0) & (x < width) & (y < height)
    points[:, 2] = min(1.0, max(0.0, presence)) * np.minimum(np.maximum(visibility, 0.0), 1.0) * inside
    return points


def normalised(landmarks: np.ndarray, width: int, height: int) -> np.ndarray:
    """Landmarks (70, 3) with x and y as fractions of the image, clipped to [0, 1]."""
    if width <= 0 or height <= 0:
        raise ValueError("image size must be positive, got %r x %r" % (width, height))
    result = np.array(landmarks, dtype=np.float64)
    result[:, :2] = np.clip(result[:, :2] / (width, height), 0.0, 1.0)
    return result


def bounding_box(points: np.ndarray) -> np.ndarray:
    """x0, y0, x1, y1 (4,) px of points (N, 2 or more)."""
    return np.concatenate([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])
