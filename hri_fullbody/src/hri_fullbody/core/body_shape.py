"""What is told about one body: smoothed key points in the image and in space."""

from __future__ import annotations

from typing import Optional

import numpy as np

from hri_fullbody.core.body_placement import body_pose, place
from hri_fullbody.core.pose_model import BODY_LANDMARKS, PoseEstimate
from hri_fullbody.core.skeleton import confidence_18, to_18_points
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.one_euro import OneEuro

# The window is about as large as a person: makes pixels comparable with metres, for which the filters are tuned.
_WINDOW_METRES = 2.2
_SEEN = 0.5
_KNOWN = 0.3
_BOX_MARGIN = 0.04


class BodyShape:
    """Filters of one body. One euro with 1.5 Hz and 6 per m/s lags 21 ms behind a waving wrist; the place in
    space, whose depth trembles more, is filtered harder."""

    def __init__(self) -> None:
        self._image = OneEuro(1.5, 6.0)
        self._relative = OneEuro(1.5, 6.0)
        self._place = OneEuro(0.8, 4.0)
        self._pixels_per_metre: Optional[float] = None

    def observe(self, body_id: str, estimate: PoseEstimate, camera: CameraModel, stamp: float) -> BodyObservation:
        """Make the observation of an estimate in the image that `camera` took at `stamp` (s)."""
        if self._pixels_per_metre is None:
            self._pixels_per_metre = estimate.next_window().size / _WINDOW_METRES
        confidence = estimate.confidence[:BODY_LANDMARKS]
        pixels = estimate.landmarks[:BODY_LANDMARKS, :2]
        smooth = self._image(pixels / self._pixels_per_metre, stamp) * self._pixels_per_metre
        points = self._place_smoothly(estimate, camera, stamp)
        sure = confidence_18(confidence)
        keypoints = np.column_stack([to_18_points(smooth), sure])
        in_space = np.full((18, 3), np.nan)
        pose = None
        if points is not None:
            in_space[sure >= _KNOWN] = to_18_points(points)[sure >= _KNOWN]
            pose = body_pose(points)
        box = visible_box(smooth, confidence, camera.width, camera.height)
        return BodyObservation(body_id, box, estimate.score, keypoints, in_space, pose)

    def _place_smoothly(self, estimate: PoseEstimate, camera: CameraModel, stamp: float) -> Optional[np.ndarray]:
        """Landmarks (33, 3) m in the optical frame, None when they cannot be placed."""
        rays = camera.normalise(estimate.landmarks[:BODY_LANDMARKS, :2])
        points = place(rays, estimate.world, estimate.confidence[:BODY_LANDMARKS] > _SEEN)
        if points is None:
            self._relative.reset()
            self._place.reset()
            return None
        root = points.mean(axis=0)
        return self._relative(points - root, stamp) + self._place(root, stamp)


def visible_box(points: np.ndarray, confidence: np.ndarray, width: int, height: int) -> np.ndarray:
    """Box (4,) px, inside the image, of the points (N, 2) px that are seen, with a margin of 4 % of its longer side."""
    seen = confidence > _KNOWN
    points = points[seen] if seen.sum() >= 4 else points
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _BOX_MARGIN * float((high - low).max())
    return np.clip(np.concatenate([low - margin, high + margin]), 0.0, [width, height, width, height])
