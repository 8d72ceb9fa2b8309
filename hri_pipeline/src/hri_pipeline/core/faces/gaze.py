"""Where a face looks, from the irises and the head together, and whether its eyes are closed.

The irises say more than the head while they are large enough to be measured; below that the direction is the head's
and the confidence says so. While the eyes are closed there is no direction.
"""

from __future__ import annotations

import math
from typing import List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.eyes import EyeGeometry, EyeMeasures
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import GazeEstimate
from hri_pipeline.core.one_euro import OneEuro

CLOSED_RATIO = 0.17
"""Aspect ratio of the lids (geometric mean of both eyes) below which they are closed: right for all of 62 closed and 120
open labelled faces (evaluation/eyes.txt), on which it was set; 0.175 takes one laughing face for closed."""
_RATIO_WIDTH = 0.02
"""Change of the aspect ratio that makes the odds of closed e times as large: its noise."""
CLOSED, OPEN = 0.65, 0.35
"""Smoothed closedness from which the eyes are closed, and below which they are open again."""
_CLOSED_TIME = 0.06
"""Time constant (s) of the closedness: shorter than a blink (0.1 to 0.3 s), longer than one image's noise."""
LEAST_IRIS, GOOD_IRIS = 5.0, 10.0
"""Diameter (px) of the iris up to which it tells nothing, and from which it decides alone."""
MAX_AWAY = np.deg2rad((40.0, 30.0))
"""Largest turn (rad) of eyes in the head, to the sides and up or down (Stahl 1999: people turn the head before)."""
_AGREE, _DISAGREE = np.deg2rad(8.0), np.deg2rad(25.0)
"""Angle (rad) between the two eyes' directions up to which they agree, and from which they tell nothing."""
HEAD_CONFIDENCE, EYES_CONFIDENCE = 0.4, 0.9
_LEAST_FACE, _GOOD_FACE = 20.0, 50.0
"""Width (px) of a face below which its lids tell nothing, and from which they can be relied on."""


class GazeEstimator:
    """Gaze of one image; holds no state between calls."""

    def __init__(self, eyes: EyeGeometry) -> None:
        self._eyes = eyes

    def estimate(self, mesh: np.ndarray, pose: Pose, camera: CameraModel, presence: float = 1.0) -> GazeEstimate:
        """Return the gaze of one face, see `estimate_all`."""
        return self.estimate_all([mesh], [pose], camera, [presence])[0][0]

    def estimate_all(self, meshes: Sequence[np.ndarray], poses: Sequence[Pose], camera: CameraModel,
                     presences: Sequence[float]) -> Tuple[List[GazeEstimate], np.ndarray]:
        """Return direction and closedness of each face, and the diameters of the irises (F, 2) px.

        The direction is there for closed eyes too (`GazeFilter` withholds it). meshes: (478, 2 or more) px; poses: face
        frames in the optical frame at the canonical size; presences: 0 to 1.
        """
        if not len(meshes):
            return [], np.zeros((0, 2))
        stack = np.stack([np.asarray(mesh, dtype=np.float64)[:, :2] for mesh in meshes])
        rotations = np.stack([pose.rotation for pose in poses])
        measures = self._eyes.measure(stack, rotations, np.stack([pose.translation for pose in poses]), camera)
        widths = stack[..., 0].max(axis=1) - stack[..., 0].min(axis=1)
        closed = _closedness(measures, widths)
        directions, trusts = _directions(measures, rotations)
        gazes = []
        for index, presence in enumerate(presences):
            confidence = HEAD_CONFIDENCE + trusts[index] * (EYES_CONFIDENCE - HEAD_CONFIDENCE)
            gazes.append(GazeEstimate(directions[index], float(confidence * presence), float(closed[index]),
                                      float(trusts[index])))
        return gazes, measures.irises


def _closedness(measures: EyeMeasures, widths: np.ndarray) -> np.ndarray:
    """(F,) how likely the eyes are closed, 0 to 1, 0.5 when nothing is known; looking down counts as closed."""
    # In profile only the near eye counts.
    weights = np.maximum(measures.visibility, 1e-3) ** 2
    # The geometric mean: hair over one eye makes it look wide open, and nothing makes an open one look shut.
    logs = np.log(np.maximum(measures.openness, 1e-3))
    ratio = np.exp((weights * logs).sum(axis=1) / weights.sum(axis=1))
    trust = np.minimum(np.maximum((widths - _LEAST_FACE) / (_GOOD_FACE - _LEAST_FACE), 0.0), 1.0)
    odds = np.minimum(np.maximum((CLOSED_RATIO - ratio) / _RATIO_WIDTH, -30.0), 30.0)
    closed = 0.5 + trust * (1.0 / (1.0 + np.exp(-odds)) - 0.5)
    return np.where(np.isfinite(ratio), closed, 0.5)


def _directions(measures: EyeMeasures, rotations: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """(F, 3) directions of the gaze, and (F,) how far the irises decide them: 0 is the head alone."""
    sizes = (measures.irises - LEAST_IRIS) / (GOOD_IRIS - LEAST_IRIS)
    weights = measures.visibility * np.minimum(np.maximum(sizes, 0.0), 1.0)
    lines = measures.lines
    apart = np.arccos(np.minimum(np.maximum((lines[:, 0] * lines[:, 1]).sum(axis=1), -1.0), 1.0))
    agree = np.minimum(np.maximum((_DISAGREE - apart) / (_DISAGREE - _AGREE), 0.0), 1.0)
    trust = weights.max(axis=1) * np.where(measures.visibility.min(axis=1) > 0.3, agree, 1.0)
    trust = np.where(np.isfinite(lines).all(axis=(1, 2)), trust, 0.0)
    mean = (np.nan_to_num(lines) * (weights + 1e-9)[..., None]).sum(axis=1)
    # In the head: x out of the face, y to the subject's left, z up.
    inside = (mean[:, None] @ rotations)[:, 0]
    left = np.arctan2(inside[:, 1], inside[:, 0])
    up = np.arctan2(inside[:, 2], np.sqrt(inside[:, 0] ** 2 + inside[:, 1] ** 2))
    # What eyes cannot turn to is an error; and where they tell nothing, the head does.
    left = np.minimum(np.maximum(left, -MAX_AWAY[0]), MAX_AWAY[0])
    up = np.minimum(np.maximum(up, -MAX_AWAY[1]), MAX_AWAY[1])
    inside = trust[:, None] * np.stack([np.cos(up) * np.cos(left), np.cos(up) * np.sin(left), np.sin(up)], axis=1)
    inside[:, 0] += 1.0 - trust
    inside /= np.sqrt((inside ** 2).sum(axis=1))[:, None]
    return (rotations @ inside[..., None])[..., 0], trust


class GazeFilter:
    """Smooths the gaze of one face and withholds it while the eyes are closed."""

    def __init__(self, min_cutoff: float = 2.0, beta: float = 6.0) -> None:
        """min_cutoff: Hz at rest; beta: Hz per (rad/s)."""
        self._direction = OneEuro(min_cutoff, beta)
        self._closed: Optional[float] = None
        self._stamp = 0.0
        self.is_closed = False

    def __call__(self, gaze: GazeEstimate, stamp: float) -> GazeEstimate:
        """Return the filtered gaze at `stamp` (s); its direction is None while the eyes are closed."""
        if self._closed is None or stamp < self._stamp:
            self._closed = gaze.eyes_closed
        else:
            gain = 1.0 - np.exp(-(stamp - self._stamp) / _CLOSED_TIME)
            self._closed += gain * (gaze.eyes_closed - self._closed)
        self._stamp = stamp
        self.is_closed = self._closed > (OPEN if self.is_closed else CLOSED)
        closed = float(self._closed)
        if self.is_closed or gaze.direction is None:
            self._direction.reset()
            return GazeEstimate(None, 0.0, closed)
        direction = self._direction(gaze.direction, stamp)
        return GazeEstimate(direction / np.linalg.norm(direction), gaze.confidence * min(1.0, 2.0 * (1.0 - closed)),
                            closed, gaze.from_eyes)


def gaze_frame(face: Pose, direction: np.ndarray) -> Pose:
    """Return the gaze frame in the face frame: z along the gaze, y down, at the same place.

    face: face frame in the optical frame; direction: (3,) unit vector in the optical frame.
    """
    # Plain numbers: for every face of every image, and arrays of three are slow.
    x, y, z = (direction @ face.rotation).tolist()
    down = (z * x, z * y, z * z - 1.0)
    length = math.sqrt(down[0] ** 2 + down[1] ** 2 + down[2] ** 2)
    if length < 1e-6:
        # Straight up or down: any upright will do, the subject's left makes the frame complete.
        down, length = (z, 0.0, -x), 1.0
    u, v, w = down[0] / length, down[1] / length, down[2] / length
    return Pose(np.array([[v * z - w * y, u, x], [w * x - u * z, v, y], [u * y - v * x, w, z]]), np.zeros(3))

