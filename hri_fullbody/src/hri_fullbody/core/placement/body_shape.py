"""What is told about one body: its key points in the image and in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

from hri_fullbody.core.placement.body_depth import measured_joints, trunk_ratio
from hri_fullbody.core.placement.body_placement import body_pose
from hri_fullbody.core.placement.body_scale import BodyScale, Cue, depth_cue, face_cue, floor_ratio
from hri_fullbody.core.sight.pose_model import BODY_LANDMARKS
from hri_fullbody.core.skeleton import (
    BLAZE_LEFT_HIP,
    BLAZE_LEFT_SHOULDER,
    BLAZE_RIGHT_HIP,
    BLAZE_RIGHT_SHOULDER,
    confidence_18,
    to_18_points,
)
from hri_fullbody.core.tracking.body_track import BodyTrack
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.one_euro import OneEuro

# A body is about as large as this: makes pixels comparable with metres, for which the filters are tuned.
_BODY_METRES = 1.76
_KNOWN = 0.3
_BOX_MARGIN = 0.04
_HIPS = [BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP]
_TRUNK = [BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER, BLAZE_LEFT_HIP, BLAZE_RIGHT_HIP]


@dataclass(frozen=True)
class Surroundings:
    """What else is known of an image.

    depth: (h, w) m, registered to it. up: (3,) unit, in the optical frame. camera_height: m above the floor.
    """

    depth: Optional[np.ndarray] = None
    up: Optional[np.ndarray] = None
    camera_height: Optional[float] = None


class BodyShape:
    """Filters of one body. The key points in the image go through a one euro filter, 1.5 Hz and 6 per m/s, which lags
    21 ms behind a waving wrist. In space only the distance is filtered, and only where no depth image gives it: it
    trembles most. What becomes of the rest is left to whoever fits a model to it."""

    def __init__(self) -> None:
        self._image = OneEuro(1.5, 6.0)
        self._distance = OneEuro(0.8, 4.0)
        self._scale = BodyScale()
        self._pixels_per_metre: Optional[float] = None
        self._pixels: Optional[np.ndarray] = None
        self._points: Optional[np.ndarray] = None
        self.by_depth = False
        """Whether a depth image has placed the body when it was last looked at."""

    def observe(self, track: BodyTrack, camera: CameraModel, stamp: float, face: Optional[Pose],
                around: Surroundings) -> BodyObservation:
        """Make the observation of a body at `stamp` (s). face: the pose of its own tracked face."""
        measured = track.stamp == stamp or self._pixels is None
        if measured:
            self._measure(track, camera, face, around)
        estimate = track.expected(stamp)
        confidence = estimate.confidence[:BODY_LANDMARKS]
        age = max(0.0, stamp - track.stamp)
        velocity = track.motion.velocity
        velocity = None if velocity is None else velocity * self._scale.value
        pixels = self._pixels + (0.0 if measured else track.moved(stamp))
        in_space, pose = np.full((18, 3), np.nan), None
        sure = confidence_18(confidence)
        known = confidence_18(track.estimate.confidence[:BODY_LANDMARKS]) >= _KNOWN
        if self._points is not None:
            points = self._points if measured or velocity is None else self._points + velocity * age
            in_space[known] = to_18_points(points)[known]
            pose = body_pose(points)
        box = visible_box(pixels, track.estimate.confidence[:BODY_LANDMARKS], camera.width, camera.height)
        return BodyObservation(track.id, box, estimate.score, np.column_stack([to_18_points(pixels), sure]), in_space,
                               pose, face, velocity, measured, self.by_depth)

    def _measure(self, track: BodyTrack, camera: CameraModel, face: Optional[Pose], around: Surroundings) -> None:
        estimate = track.estimate
        if self._pixels_per_metre is None:
            self._pixels_per_metre = estimate.extent / _BODY_METRES
        pixels = estimate.landmarks[:BODY_LANDMARKS, :2]
        self._pixels = self._image(pixels / self._pixels_per_metre, track.stamp) * self._pixels_per_metre
        points = track.sight.points
        if points is None:
            self._points, self.by_depth = None, False
            self._distance.reset()
        else:
            self._points = self._rescale(points, track, camera, face, around)

    def _rescale(self, points: np.ndarray, track: BodyTrack, camera: CameraModel, face: Optional[Pose],
                 around: Surroundings) -> np.ndarray:
        """Landmarks (33, 3) m at the size and the distance that depth image, face, or floor tell, the first that does."""
        pixels = track.estimate.landmarks[:BODY_LANDMARKS, :2]
        confidence = track.estimate.confidence[:BODY_LANDMARKS]
        size = (camera.width, camera.height)
        rays = camera.normalise(pixels)
        cue: Optional[Cue] = None
        if around.depth is not None:
            cue = depth_cue(trunk_ratio(around.depth, pixels, points, confidence, size), points[_TRUNK].mean(axis=0))
        self.by_depth = cue is not None
        cue = cue or face_cue(points, face)
        if cue is None and around.up is not None and around.camera_height is not None:
            cue = self._scale.floor_cue(floor_ratio(points, rays, confidence, around.up, around.camera_height))
        self._scale.update(cue, track.stamp)
        scale = self._scale.value
        exact = cue is not None and cue.exact
        anchor = cue.reference if exact else points[_HIPS].mean(axis=0)
        placed = points * scale + (anchor * (cue.ratio - scale) if exact else 0.0)
        if self.by_depth:
            self._distance.reset()
            return measured_joints(around.depth, pixels, rays, placed, confidence, size)
        depth = np.array([placed[_HIPS, 2].mean()])
        return placed + anchor / anchor[2] * (self._distance(depth, track.stamp) - depth)


def visible_box(points: np.ndarray, confidence: np.ndarray, width: int, height: int) -> np.ndarray:
    """Box (4,) px, inside the image, of the points (N, 2) px that are seen, with a margin of 4 % of its longer side."""
    seen = confidence > _KNOWN
    points = points[seen] if seen.sum() >= 4 else points
    low, high = points.min(axis=0), points.max(axis=0)
    margin = _BOX_MARGIN * float((high - low).max())
    return np.clip(np.concatenate([low - margin, high + margin]), 0.0, [width, height, width, height])
