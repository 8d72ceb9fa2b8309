"""Bodies from images: one call for each image, with the models behind it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

from hri_fullbody.core.body_shape import BodyShape
from hri_fullbody.core.body_tracker import BodyTracker, PoseEstimator
from hri_fullbody.core.body_windows import FaceBox
from hri_fullbody.core.person_detector import CenterNetDetector, PersonDetector
from hri_fullbody.core.pose_model import PoseModel
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.model_store import model_path
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.timing import StageTimes

DETECTOR_MODEL = "person_centernet.onnx"
POSE_MODEL = "pose_landmarks_full.onnx"


class BodyStage:
    """Finds and follows bodies.

    settings: the values of body_parameters.BODY_STAGE_PARAMETERS and `providers`. notify: told in a line when a
    provider is missing.
    pose, detector: used instead of the models of the settings.
    Raises ModelError when a model is missing or damaged, ValueError for illegal settings.
    """

    def __init__(self, settings: SimpleNamespace, notify: Optional[Callable[[str], None]] = None,
                 pose: Optional[PoseEstimator] = None, detector: Optional[PersonDetector] = None) -> None:
        options = dict(providers=settings.providers, notify=notify)
        self._pose = pose or PoseModel(model_path(settings.pose_model, POSE_MODEL), **options)
        self._detector = detector or CenterNetDetector(
            model_path(settings.person_detector_model, DETECTOR_MODEL), threshold=settings.min_person_score,
            long_side=settings.person_detection_size, **options)
        self._tracker = BodyTracker(
            self._pose, IdGenerator().new, settings.body_birth_delay, settings.body_death_time,
            settings.min_body_score, settings.max_bodies)
        self._detection_period = settings.person_detection_period
        self._new_windows = settings.new_windows_per_image
        self._shapes: Dict[str, BodyShape] = {}
        self._last_stamp = -np.inf
        self._last_detection = -np.inf
        self.times = StageTimes()

    def reset(self) -> None:
        """Forget all bodies, for example because time went back."""
        self._tracker.reset()
        self._shapes.clear()
        self._last_stamp = self._last_detection = -np.inf

    @property
    def tracked_ids(self) -> List[str]:
        """Ids of the confirmed bodies, also of those unseen for less than the death time."""
        return [track.id for track in self._tracker.tracks if track.life.confirmed]

    def update(self, bgr: np.ndarray, camera: CameraModel, stamp: float,
               faces: Sequence[FaceBox] = ()) -> List[BodyObservation]:
        """Return the confirmed bodies seen in `bgr` (H, W, 3), taken by `camera` at `stamp` (s).

        faces: those of this image or a moment before; optional, but they keep neighbours apart.
        A stamp older than the last one starts afresh.
        """
        if stamp < self._last_stamp:
            self.reset()
        self._last_stamp = stamp
        height, width = bgr.shape[:2]
        camera = camera.resized(width, height)
        with self.times("poses"):
            self._tracker.follow(bgr, stamp, faces)
        if stamp - self._last_detection >= self._detection_period:
            self._last_detection = stamp
            with self.times("person detector"):
                boxes, _ = self._detector.detect(bgr)
            self._tracker.propose(boxes, faces)
        else:
            with self.times("new bodies"):
                self._tracker.try_new(bgr, stamp, faces, self._new_windows)
        with self.times("placement"):
            return self._observe(camera, stamp)

    def _observe(self, camera: CameraModel, stamp: float) -> List[BodyObservation]:
        living = {track.id for track in self._tracker.tracks}
        self._shapes = {key: shape for key, shape in self._shapes.items() if key in living}
        seen = [track for track in self._tracker.tracks if track.seen and track.life.confirmed]
        return [self._shapes.setdefault(track.id, BodyShape()).observe(track.id, track.estimate, camera, stamp)
                for track in seen]
