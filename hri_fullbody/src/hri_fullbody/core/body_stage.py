"""Bodies from images: one call for each image, with the models behind it."""

from __future__ import annotations

import math
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

from hri_fullbody.core.placement.body_placement import place
from hri_fullbody.core.placement.body_shape import BodyShape, Surroundings
from hri_fullbody.core.sight.body_windows import FaceBox
from hri_fullbody.core.sight.person_detector import CenterNetDetector, PersonDetector
from hri_fullbody.core.sight.pose_model import BODY_LANDMARKS, PoseEstimate, PoseModel
from hri_fullbody.core.tracking.body_continuity import Appearance, BodyContinuity, Return
from hri_fullbody.core.tracking.body_schedule import PoseSchedule
from hri_fullbody.core.tracking.body_tracker import BodyTracker, PoseEstimator
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.model_store import model_path, models_directory
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.core.onnx_model import FETCH_MEND, ModelError
from hri_pipeline.core.timing import StageTimes

DETECTOR_MODEL = "person_centernet.onnx"
POSE_MODELS = ("lite", "full", "heavy")
_SEEN = 0.5
# Images that come more slowly (s) need not take the same time each, and who is there is found in few of them: two windows
# of the budget are for those who wait.
SLOW_S = 0.25
_SLOW_NEW = 2


def pose_model_path(configured: str) -> Path:
    """Return the file of the pose network: that of a short name (lite, full, heavy; empty for full) or a path.

    Raises ModelError that says how to get it.
    """
    name = configured or "full"
    if name not in POSE_MODELS:
        if os.sep not in name and not name.endswith(".onnx"):
            raise ModelError("parameter pose_model is {!r}; legal: {}, or the path of an ONNX file".format(
                name, ", ".join(POSE_MODELS)))
        return model_path(name, "pose_landmarks_full.onnx")
    model = "pose_landmarks_" + name
    path = models_directory() / (model + ".onnx")
    if not path.is_file():
        raise ModelError("model file {} for pose_model {} does not exist; {} --models {}`".format(
            path, name, FETCH_MEND.rstrip("`"), model))
    return path


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
        self._pose = pose or PoseModel(pose_model_path(settings.pose_model), **options)
        self._detector = detector or CenterNetDetector(
            model_path(settings.person_detector_model, DETECTOR_MODEL), threshold=settings.min_person_score,
            long_side=settings.person_detection_size, **options)
        self._tracker = BodyTracker(
            self._pose, IdGenerator().new, settings.body_birth_delay, settings.body_death_time,
            settings.min_body_score, settings.max_bodies, schedule=PoseSchedule(settings.pose_rate, settings.pose_budget))
        self._settings = settings
        self._shapes: Dict[str, BodyShape] = {}
        self._continuity = BodyContinuity(settings.body_memory)
        self.returned: List[Return] = []
        """Bodies that are confirmed since the last image and were there before under another id."""
        self._last_stamp = -np.inf
        self._last_detection = -np.inf
        self._detected_before = False
        self.times = StageTimes()

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters; the bodies stay."""
        self._settings = settings
        self._detector.threshold = settings.min_person_score
        self._tracker.limit(settings.body_birth_delay, settings.body_death_time, settings.min_body_score)
        self._tracker.schedule.limit(settings.pose_rate, settings.pose_budget)

    def reset(self) -> None:
        """Forget all bodies, for example because time went back."""
        self._tracker.reset()
        self._continuity.reset()
        self._shapes.clear()
        self._last_stamp = self._last_detection = -np.inf
        self._detected_before = False

    @property
    def tracked_ids(self) -> List[str]:
        """Ids of the confirmed bodies, also of those who wait for their look, or were looked for in vain only for a while."""
        return [track.id for track in self._tracker.tracks if track.life.confirmed]

    @property
    def placed_by_depth(self) -> int:
        """Number of the bodies whose distance came from a depth image when they were last looked at."""
        return sum(shape.by_depth for shape in self._shapes.values())

    def update(self, bgr: np.ndarray, camera: CameraModel, stamp: float, faces: Sequence[FaceBox] = (),
               depth: Optional[np.ndarray] = None, up: Optional[np.ndarray] = None,
               camera_height: Optional[float] = None) -> List[BodyObservation]:
        """Return the confirmed bodies in `bgr` (H, W, 3), taken by `camera` at `stamp` (s).

        Those that are not looked at in this image are where their motion takes them, with `measured` False.
        faces: those of this image or a moment before; optional, but they keep neighbours apart and give the distance.
        depth: (h, w) m, registered to the image, NaN or 0 where unknown. up: (3,) unit, away from the floor, in the
        optical frame, and camera_height: m above the floor; both or neither. A stamp older than the last starts afresh.
        """
        if stamp < self._last_stamp:
            self.reset()
        slow = SLOW_S < stamp - self._last_stamp < math.inf
        self._last_stamp = stamp
        height, width = bgr.shape[:2]
        camera = camera.resized(width, height)
        with self.times("poses"):
            self._tracker.follow(bgr, stamp, faces, lambda estimate: self._locate(estimate, camera), _SLOW_NEW if slow else 0)
        self._search(bgr, stamp, faces, slow)
        self.returned = self._continuity.update(
            [Appearance(track.id, track.looks, track.sight.root) for track in self._tracker.tracks if track.life.confirmed],
            stamp)
        with self.times("placement"):
            return self._observe(camera, stamp, faces, Surroundings(depth, up, camera_height))

    def _search(self, bgr: np.ndarray, stamp: float, faces: Sequence[FaceBox], slow: bool) -> None:
        """Look for new bodies: with the detector when it is due, else in a few of the places where they may be.

        When the detector is due in every image, or images are slow, both are done in each.
        """
        due = stamp - self._last_detection >= self._settings.person_detection_period
        detected_before, self._detected_before = self._detected_before, due
        if due:
            self._last_detection = stamp
            with self.times("person detector"):
                boxes, _ = self._detector.detect(bgr)
            self._tracker.propose(boxes, faces, stamp)
            if not detected_before and not slow:
                return
        windows, budget = self._settings.new_windows_per_image, self._settings.pose_budget
        if budget:
            windows = min(windows, max(1, budget - self._tracker.windows))
        with self.times("new bodies"):
            self._tracker.try_new(bgr, stamp, faces, windows)

    def _locate(self, estimate: PoseEstimate, camera: CameraModel) -> Optional[np.ndarray]:
        with self.times("perspective"):
            return place(camera.normalise(estimate.landmarks[:BODY_LANDMARKS, :2]), estimate.world,
                         estimate.confidence[:BODY_LANDMARKS] > _SEEN)

    def _observe(self, camera: CameraModel, stamp: float, faces: Sequence[FaceBox],
                 around: Surroundings) -> List[BodyObservation]:
        living = {track.id for track in self._tracker.tracks}
        self._shapes = {key: shape for key, shape in self._shapes.items() if key in living}
        poses: Dict[str, Optional[Pose]] = {face.id: face.pose for face in faces}
        return [self._shapes.setdefault(track.id, BodyShape()).observe(
                    track, camera, stamp, poses.get(track.face_id or ""), around)
                for track in self._tracker.published(stamp)]
