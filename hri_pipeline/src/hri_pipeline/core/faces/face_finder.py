"""From images to the meshes of tracked faces: detector now and then, mesh network as often as the budget allows."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.faces.face_budget import FaceBudget
from hri_pipeline.core.faces.face_detector import FaceDetection, FaceDetector
from hri_pipeline.core.faces.face_flow import FaceFlow
from hri_pipeline.core.faces.face_landmarks import bounding_box
from hri_pipeline.core.faces.face_mesh import INPUT_SIZE, FaceMesh, FaceMeshResult, roi_from_detection, roi_from_mesh
from hri_pipeline.core.faces.face_schedule import DetectionSchedule
from hri_pipeline.core.faces.face_track import FaceMeasurement, FaceTrack, face_colours
from hri_pipeline.core.faces.face_tracker import FaceTracker, same_face
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.model_store import model_path
from hri_pipeline.core.onnx_model import FETCH_MEND, ModelError, OnnxModel
from hri_pipeline.core.timing import StageTimes

KEEP_RATIO = 0.2
"""A tracked face is kept down to this part of the presence that a new one needs: in profile it flickers."""
RECALL_RATIO = 0.6
"""A known face that was lost is found again down to this part of the score that a new one needs."""
SURE = 0.9
"""Presence below which a tracked mesh is started anew where the detector sees the face: near profile its
crop drifts."""
CERTAIN = 0.97
"""Presence from which the mesh vouches for a face that the detector is not sure of: of 30 px, or half hidden."""
MIN_INSIDE = 0.3
"""Least part of the mesh's points that must lie in the image."""
MIN_SIZE = 8.0
"""Least size (px) of a mesh that can be a face."""
_SUPPORT_AGE = 0.4
"""Part of the support time after which a look of the detector is wanted where a face is."""
_PREDICTION_TIME = 0.3
"""Time constant (s) with which a face that was not looked at becomes unsure."""


@dataclass(frozen=True)
class FaceSighting:
    """A tracked face in one image. mesh: (478, 3) px; box: (4,) px; presence: 0 to 1; measured: False when it was not
    looked at in this image and its last mesh was moved along its way; confirmed: it may be published."""

    id: str
    mesh: np.ndarray
    box: np.ndarray
    presence: float
    measured: bool
    confirmed: bool


class FaceFinder:
    """Finds and follows faces in an image sequence. Not safe for use from several threads at once.

    settings: the values of FACE_STAGE_PARAMETERS and `providers`. notify: told in one line about an execution
    provider that is skipped. times: where the time of each step is noted. clock: s of processor time, what the budget
    counts. `detected` tells whether the detector ran on the last image. Raises ModelError when a model file is missing or wrong.
    """

    def __init__(self, settings: SimpleNamespace, times: StageTimes, ids: Optional[IdGenerator] = None,
                 notify: Optional[Callable[[str], None]] = None,
                 clock: Callable[[], float] = time.thread_time) -> None:
        detector = _load(settings.face_detector_model, "face_detection_full_range.onnx", FaceDetector.OUTPUTS,
                         settings.providers, notify)
        mesh = _load(settings.face_mesh_model, "face_landmarks_attention.onnx", FaceMesh.OUTPUTS,
                     settings.providers, notify)
        self._detector = FaceDetector(detector)
        self._schedule = DetectionSchedule(settings.face_detection_period, settings.face_detection_tiles)
        self._mesh = FaceMesh(mesh)
        self._budget = FaceBudget(*_share(settings))
        self._tracker = FaceTracker(ids=ids, **_limits(settings))
        self._clock = clock
        self._times = times
        self._flow = FaceFlow()
        self._stamp = 0.0
        self.detected = False
        self._set_thresholds(settings)

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters."""
        self._schedule.set_period(settings.face_detection_period)
        self._budget.share(*_share(settings))
        self._tracker.limit(**_limits(settings))
        self._set_thresholds(settings)

    def _set_thresholds(self, settings: SimpleNamespace) -> None:
        self._min_score, self._min_presence = settings.min_detection_score, settings.min_face_presence
        self._support_age = _SUPPORT_AGE * settings.face_support_time
        self._detector.set_min_score(RECALL_RATIO * self._min_score)

    @property
    def tracked_ids(self) -> List[str]:
        """Ids of all faces being tracked, oldest first: those seen in the last image and those just hidden."""
        return self._tracker.ids

    @property
    def living_ids(self) -> Set[str]:
        """Ids of all tracks, those that wait for their confirmation too."""
        return {track.id for track in self._tracker.tracks}

    @property
    def look_cost(self) -> float:
        """What one look of the mesh network costs here, s."""
        return self._budget.cost

    def update(self, bgr: np.ndarray, stamp: float) -> List[FaceSighting]:
        """Return the faces seen in the (H, W, 3) uint8 image of `stamp` (s), oldest first."""
        self._move(bgr, stamp)
        expected = self._tracker.expected(stamp)
        chosen = set(self._budget.choose([track.id for track in expected], stamp, self._meeting(expected, stamp)))
        found = self._follow(bgr, [track for track in expected if track.id in chosen], stamp)
        skipped = {track.id for track in expected} - chosen
        found += self._discover(bgr, found, skipped, stamp)
        seen = self._tracker.update(found, stamp, skipped)
        return [self._sighting(track, stamp) for track in seen]

    def reset(self) -> None:
        """Drop every face, as after a jump in time; ids are not given again."""
        self._tracker.reset()
        self._schedule.reset()
        self._budget.reset()
        self._flow.reset()

    def _move(self, bgr: np.ndarray, stamp: float) -> None:
        """Move the tracks along with their pictures."""
        tracks = [track for track in self._tracker.tracks if track.visible]
        boxes = [track.predicted_box(self._stamp) for track in tracks]
        ahead = [track.shift(stamp) - track.shift(self._stamp) for track in tracks]
        with self._times("face_flow"):
            for track, motion in zip(tracks, self._flow.update(bgr, boxes, ahead)):
                track.move(motion, stamp)
        self._stamp = stamp

    def _follow(self, bgr: np.ndarray, tracks: Sequence[FaceTrack], stamp: float) -> List[FaceMeasurement]:
        """Meshes at the predicted places of tracks."""
        if not tracks:
            return []
        with self._times("face_mesh"):
            began = self._clock()
            rois = [roi_from_mesh(track.measurement.mesh, track.shift(stamp)) for track in tracks]
            results = self._mesh.run(bgr, rois)
            self._budget.spent(self._clock() - began, len(rois))
        height, width = bgr.shape[:2]
        return [self._measurement(bgr, result, False) for track, result in zip(tracks, results)
                if is_face(result, width, height, self._least_presence(track))]

    def _least_presence(self, track: FaceTrack) -> float:
        """Presence from which a track goes on: the mesh of what the detector is not sure of must be."""
        doubtful = track.detections < 1.0 and not self._tracker.is_confirmed(track)
        return SURE if doubtful else KEEP_RATIO * self._min_presence

    def _evidence(self, detection: FaceDetection) -> float:
        """How much of a detection one counts. Patterns that are no faces are seen now and then, with half the score."""
        return min(1.0, detection.score / self._min_score) ** 2

    def _discover(self, bgr: np.ndarray, found: Sequence[FaceMeasurement], skipped: Set[str],
                  stamp: float) -> List[FaceMeasurement]:
        """Meshes of new and of lost faces, when it is time for the detector."""
        regions = self._schedule.due(bgr, stamp, self._waiting(stamp), self._is_quiet())
        self.detected = bool(regions)
        if not regions:
            return []
        with self._times("face_detection"):
            detections = self._detector.detect(bgr, regions)
        self._tracker.support([detection.box for detection in detections], stamp,
                              [self._evidence(detection) for detection in detections])
        explained = [measurement.box for measurement in found if measurement.presence >= SURE]
        explained += [track.predicted_box(stamp) for track in self._tracker.tracks
                      if track.id in skipped and track.visible and track.measurement.presence >= SURE]
        unexplained = self._unexplained(detections, explained)
        if any(detection.score >= self._min_score for detection in unexplained):
            self._schedule.hurry(stamp)
        with self._times("face_birth"):
            return self._look_closer(bgr, unexplained)

    @staticmethod
    def _unexplained(detections: Sequence[FaceDetection], explained: Sequence[np.ndarray]) -> List[FaceDetection]:
        """Detections where no mesh is sure: new faces, and known ones that were lost."""
        return [detection for detection in detections
                if not any(same_face(detection.box, box) for box in explained)]

    def _look_closer(self, bgr: np.ndarray, detections: Sequence[FaceDetection]) -> List[FaceMeasurement]:
        """Meshes at detections. Their crop is a coarse one: the network is believed from the second look on."""
        height, width = bgr.shape[:2]
        first = self._mesh.run(bgr, [roi_from_detection(detection) for detection in detections])
        sound = [(detection, result) for detection, result in zip(detections, first) if _is_sound(result)]
        second = self._mesh.run(bgr, [roi_from_mesh(result.points) for _, result in sound])
        return [self._measurement(bgr, result, detection.score >= self._min_score or result.presence >= CERTAIN,
                                  self._evidence(detection))
                for (detection, _), result in zip(sound, second)
                if is_face(result, width, height, self._min_presence)]

    @staticmethod
    def _measurement(bgr: np.ndarray, result: FaceMeshResult, may_start: bool, evidence: float = 0.0) -> FaceMeasurement:
        return FaceMeasurement(result.points, result.presence, may_start,
                               face_colours(bgr, bounding_box(result.points)), evidence)

    def _waiting(self, stamp: float) -> List[np.ndarray]:
        """Centres (2,) px of the faces that the detector has yet to confirm, or has not for long."""
        boxes = [track.predicted_box(stamp) for track in self._tracker.tracks
                 if not self._tracker.is_confirmed(track) or stamp - track.detected_at > self._support_age]
        return [(box[:2] + box[2:]) / 2.0 for box in boxes]

    def _is_quiet(self) -> bool:
        """Tell whether there are faces, and all of them known and seen."""
        tracks = self._tracker.tracks
        return bool(tracks) and all(track.visible and self._tracker.is_confirmed(track) for track in tracks)

    @staticmethod
    def _meeting(tracks: Sequence[FaceTrack], stamp: float) -> List[str]:
        """Ids of faces that overlap others: who is who is decided by looking at all of them."""
        if len(tracks) < 2:
            return []
        boxes = [track.predicted_box(stamp).tolist() for track in tracks]
        return [track.id for index, track in enumerate(tracks)
                if any(_touch(boxes[index], box) for other, box in enumerate(boxes) if other != index)]

    def _sighting(self, track: FaceTrack, stamp: float) -> FaceSighting:
        measured = track.measured_at >= stamp
        mesh, box, presence = track.measurement.mesh, track.measurement.box, track.measurement.presence
        if not measured:
            shift = track.shift(stamp)
            mesh = mesh + np.append(shift, 0.0)
            box = box + np.concatenate([shift] * 2)
            presence *= math.exp(-(stamp - track.measured_at) / _PREDICTION_TIME)
        return FaceSighting(track.id, mesh, box, presence, measured, self._tracker.is_confirmed(track))


def _share(settings: SimpleNamespace) -> Tuple[float, float]:
    """Rate (Hz) and budget (s) of the looks, for FaceBudget."""
    return settings.face_mesh_rate, 1e-3 * settings.face_budget


def _limits(settings: SimpleNamespace) -> Dict[str, Any]:
    """Arguments of FaceTracker.limit()."""
    return {"birth_delay": settings.face_birth_delay, "death_time": settings.face_death_time, "max_faces": settings.max_faces,
            "min_detections": settings.face_min_detections, "support_time": settings.face_support_time}


def _touch(a: Sequence[float], b: Sequence[float]) -> bool:
    """True when two boxes overlap by a tenth of the smaller one's sides."""
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    return width > 0.1 * min(a[2] - a[0], b[2] - b[0]) and height > 0.1 * min(a[3] - a[1], b[3] - b[1])


def is_face(result: FaceMeshResult, width: int, height: int, min_presence: float) -> bool:
    """True when the mesh is sound, lies on a face, and enough of it in the image."""
    if result.presence < min_presence or not _is_sound(result):
        return False
    x, y = result.points[:, 0], result.points[:, 1]
    inside = (x >= 0.0) & (y >= 0.0) & (x < width) & (y < height)
    return bool(np.count_nonzero(inside) >= MIN_INSIDE * len(inside))


def _is_sound(result: FaceMeshResult) -> bool:
    """True when the mesh can be cropped again: finite, and of some size."""
    xy = result.points[:, :2]
    return bool(np.isfinite(result.points).all() and np.ptp(xy, axis=0).max() >= MIN_SIZE)


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
