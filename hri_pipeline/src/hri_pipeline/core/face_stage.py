"""From images to tracked faces: detector now and then, mesh and head pose in every frame."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Callable, Dict, List, Mapping, Optional, Sequence

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.canonical_face import load_canonical_face
from hri_pipeline.core.face_detector import DetectionSchedule, FaceDetection, FaceDetector
from hri_pipeline.core.face_landmarks import landmarks_from_mesh
from hri_pipeline.core.face_mesh import INPUT_SIZE, FaceMesh, FaceMeshResult, roi_from_detection, roi_from_mesh
from hri_pipeline.core.face_tracker import FaceMeasurement, FaceTrack, FaceTracker, same_face
from hri_pipeline.core.head_pose import HeadPoseEstimator, PoseSmoother
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.model_store import model_path
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.onnx_model import FETCH_MEND, ModelError, OnnxModel
from hri_pipeline.core.timing import StageTimes

KEEP_RATIO = 0.2
"""A tracked face is kept down to this part of the presence that a new one needs: in profile it flickers."""
RECALL_RATIO = 0.6
"""A known face that was lost is found again down to this part of the score that a new one needs."""
SURE = 0.9
"""Presence below which a tracked mesh is started anew where the detector sees the face: near profile its
crop drifts."""
MIN_INSIDE = 0.3
"""Least part of the mesh's points that must lie in the image."""
MIN_SIZE = 8.0
"""Least size (px) of a mesh that can be a face."""


class FaceStage:
    """Finds and follows faces. Not safe for use from several threads at once.

    settings: the values of FACE_STAGE_PARAMETERS and `providers`. notify: told in one line about an execution
    provider that is skipped. Raises ModelError when a model file is missing or wrong.
    """

    def __init__(self, settings: SimpleNamespace, ids: Optional[IdGenerator] = None,
                 notify: Optional[Callable[[str], None]] = None) -> None:
        detector = _load(settings.face_detector_model, "face_detection_full_range.onnx", FaceDetector.OUTPUTS,
                         settings.providers, notify)
        mesh = _load(settings.face_mesh_model, "face_landmarks_attention.onnx", FaceMesh.OUTPUTS,
                     settings.providers, notify)
        canonical = load_canonical_face(model_path(settings.canonical_face, "canonical_face.npz"))
        self._min_score = settings.min_detection_score
        self._detector = FaceDetector(detector, RECALL_RATIO * self._min_score)
        self._schedule = DetectionSchedule(settings.face_detection_period, settings.face_detection_tiles)
        self._mesh = FaceMesh(mesh)
        self._head_pose = HeadPoseEstimator(canonical)
        self._tracker = FaceTracker(
            settings.face_birth_delay, settings.face_death_time, settings.max_faces, ids,
            settings.face_min_detections, settings.face_support_time)
        self._min_presence = settings.min_face_presence
        self._smoothers: Dict[str, PoseSmoother] = {}
        self._last_stamp = -np.inf
        self.times = StageTimes()

    @property
    def tracked_ids(self) -> List[str]:
        """Ids of all faces being tracked, oldest first: those seen in the last image and those just hidden."""
        return self._tracker.ids

    def update(self, bgr: np.ndarray, camera: CameraModel, stamp: float) -> List[FaceObservation]:
        """Confirmed faces seen in this image, oldest first.

        bgr: (H, W, 3) uint8; camera: its model, scaled when it is of another size; stamp: s, increasing. A
        stamp that goes back is a new start: every face is dropped.
        """
        if stamp < self._last_stamp:
            self.reset()
        self._last_stamp = stamp
        height, width = bgr.shape[:2]
        camera = camera.resized(width, height)
        measurements = self._measure(bgr, stamp)
        seen = self._tracker.update(measurements, stamp)
        living = {track.id for track in self._tracker.tracks}
        self._smoothers = {key: value for key, value in self._smoothers.items() if key in living}
        with self.times("face_pose"):
            return [self._observe(track, camera, stamp) for track in seen if self._tracker.is_confirmed(track)]

    def reset(self) -> None:
        """Drop every face, as after a jump in time; ids are not given again."""
        self._tracker.reset()
        self._schedule.reset()
        self._smoothers = {}
        self._last_stamp = -np.inf

    def _measure(self, bgr: np.ndarray, stamp: float) -> List[FaceMeasurement]:
        """Meshes at the predicted places of the tracks, and at detections that none of these surely explains."""
        height, width = bgr.shape[:2]
        with self.times("face_mesh"):
            expected = self._tracker.expected(stamp)
            rois = [roi_from_mesh(track.measurement.mesh, track.shift(stamp)) for track in expected]
            found = [FaceMeasurement(result.points, result.presence, False)
                     for result in self._mesh.run(bgr, rois)
                     if _is_face(result, width, height, KEEP_RATIO * self._min_presence)]
        regions = self._schedule.due(width, height, stamp)
        if not regions:
            return found
        with self.times("face_detection"):
            detections = self._detector.detect(bgr, regions)
        self._tracker.support([detection.box for detection in detections], stamp)
        with self.times("face_birth"):
            return found + self._look_closer(bgr, self._unexplained(detections, found, stamp))

    def _unexplained(self, detections: Sequence[FaceDetection], found: Sequence[FaceMeasurement],
                     stamp: float) -> List[FaceDetection]:
        """Detections where no mesh is sure: new faces, and, with a lower score, known ones that were lost."""
        sure = [measurement.box for measurement in found if measurement.presence >= SURE]
        living = [track.predicted_box(stamp) for track in self._tracker.tracks]
        return [detection for detection in detections
                if not any(same_face(detection.box, box) for box in sure)
                and (detection.score >= self._min_score or any(same_face(detection.box, box) for box in living))]

    def _look_closer(self, bgr: np.ndarray, detections: Sequence[FaceDetection]) -> List[FaceMeasurement]:
        """Meshes at detections. Their crop is a coarse one: the network is believed from the second look on."""
        height, width = bgr.shape[:2]
        first = self._mesh.run(bgr, [roi_from_detection(detection) for detection in detections])
        sound = [(detection, result) for detection, result in zip(detections, first) if _is_finite(result)]
        second = self._mesh.run(bgr, [roi_from_mesh(result.points) for _, result in sound])
        return [FaceMeasurement(result.points, result.presence, detection.score >= self._min_score)
                for (detection, _), result in zip(sound, second)
                if _is_face(result, width, height, self._min_presence)]

    def _observe(self, track: FaceTrack, camera: CameraModel, stamp: float) -> FaceObservation:
        mesh, presence = track.measurement.mesh, track.measurement.presence
        pose = self._head_pose.estimate(mesh, camera)
        smoother = self._smoothers.setdefault(track.id, PoseSmoother())
        if pose is None:
            smoother.reset()
        else:
            pose = smoother(pose, stamp)
        landmarks = landmarks_from_mesh(
            mesh, presence, camera.width, camera.height, self._head_pose.visibility(pose))
        return FaceObservation(track.id, track.measurement.box, presence, landmarks, mesh, pose)


def _load(configured: str, default: str, outputs: Mapping[str, int], providers: Sequence[str],
          notify: Optional[Callable[[str], None]]) -> OnnxModel:
    """Load a network and run it once: that shows another one with the same names, and warms it up.

    outputs: numbers in each output for one image. Raises ModelError naming the file.
    """
    path = model_path(configured, default)
    model = OnnxModel(path, providers, inputs=("input_1",), outputs=tuple(outputs), notify=notify)
    trial = model.run({"input_1": np.zeros((1, INPUT_SIZE, INPUT_SIZE, 3), np.float32)})
    for name, size in outputs.items():
        if trial[name].size != size:
            raise ModelError("model file {} gives {} numbers in {} instead of {}; it is another model: {}".format(
                path, trial[name].size, name, size, FETCH_MEND))
    return model


def _is_finite(result: FaceMeshResult) -> bool:
    """True when the mesh can be cropped again: finite, and of some size."""
    xy = result.points[:, :2]
    return bool(np.isfinite(result.points).all() and np.ptp(xy, axis=0).max() >= MIN_SIZE)


def _is_face(result: FaceMeshResult, width: int, height: int, min_presence: float) -> bool:
    """True when the mesh is sound, lies on a face, and enough of it in the image."""
    if result.presence < min_presence or not _is_finite(result):
        return False
    xy = result.points[:, :2]
    return bool(((xy >= 0.0) & (xy < (width, height))).all(axis=1).mean() >= MIN_INSIDE)
