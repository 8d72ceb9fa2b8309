"""The main road of faces: from an image to the published observations of every tracked face.

`FacePipeline.update` shows the steps in order: tracking (`FaceTrackingPipeline.update`: optical flow, scheduling of the
mesh network, face mesh, face detector, data association), geometry (`face_geometry`: head pose, gaze, size of the
head), and analysis (`FaceAnalysis`: action units, expression, age and gender, recognition).
"""

from __future__ import annotations

from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import FaceAnalysis, FaceDemand
from hri_pipeline.core.faces.appearance import AppearanceMatcher
from hri_pipeline.core.faces.face_geometry import FaceGeometry, TrackedFace
from hri_pipeline.core.faces.mesh import Blendshapes, load_canonical_face
from hri_pipeline.core.faces.parameters import FacePipelineSettings
from hri_pipeline.core.faces.tracking_pipeline import FaceTrackingPipeline
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.images import ASPECT_TOLERANCE
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.onnx import model_path
from hri_pipeline.core.person_detector import PersonDetector
from hri_pipeline.core.process import Threads
from hri_pipeline.core.recognition.face_identity import PersonMatch
from hri_pipeline.core.recognition.face_recognition import FaceRecognition
from hri_pipeline.core.timing import StageTimes

NOTHING = FaceDemand()


class FacePipeline:
    """Detects, tracks and analyses the faces of an image sequence. Not thread-safe.

    Parameters
    ----------
    settings
        The values of FACE_PIPELINE_PARAMETERS and `providers`.
    notify
        Called with one line of text for each execution provider that is skipped.
    threads
        Of the networks; by default as the settings say. They are closed by close().
    person_detector
        Returns one that is there already, when it is first needed; by default an own one is loaded.

    Raises
    ------
    ModelError
        When a model file is missing or wrong.
    """

    def __init__(self, settings: FacePipelineSettings, notify: Optional[Callable[[str], None]] = None,
                 threads: Optional[Threads] = None,
                 person_detector: Optional[Callable[[], PersonDetector]] = None) -> None:
        self.times = StageTimes()
        canonical = load_canonical_face(model_path(settings.canonical_face, "canonical_face.npz"))
        blendshapes = Blendshapes(model_path(settings.face_blendshapes_model, "face_blendshapes.onnx"),
                                  settings.providers, notify)
        self._geometry = FaceGeometry(canonical, blendshapes)
        self._threads = threads or Threads.of_node(settings.threads, settings.cpu_share)
        self._analysis = FaceAnalysis(settings, canonical, self.times, notify, self._threads)
        self._tracking = FaceTrackingPipeline(settings, self.times, notify, judge=self._judge(),
                                              threads=self._threads, person_detector=person_detector)
        self._last_stamp = -np.inf
        self._published = self._predicted = 0

    @property
    def tracked_ids(self) -> List[str]:
        """Ids of all faces being tracked, oldest first: those seen in the last image and those just hidden."""
        return self._tracking.tracked_ids

    @property
    def seen_turn(self) -> Optional[int]:
        """Quarter turns anticlockwise by which faces stand upright in the images, None while that is not known."""
        return self._tracking.seen_turn

    @property
    def recognition(self) -> Optional[FaceRecognition]:
        """Face recognition; None when it is switched off."""
        return self._analysis.recognition

    @property
    def matches(self) -> List[PersonMatch]:
        """Changes of the matches between faces and persons in the last image."""
        return self._analysis.matches

    def update(self, bgr: np.ndarray, camera: CameraModel, stamp: float, depth: Optional[np.ndarray] = None,
               demand: FaceDemand = NOTHING,
               placed: Optional[Callable[[List[FaceObservation]], None]] = None) -> List[FaceObservation]:
        """Return the confirmed faces seen in this image, oldest first.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8.
        camera
            Camera model; scaled when it is of another image size.
        stamp
            Time of the image, s, increasing. A stamp that goes back is a new start: every face is dropped.
        depth
            (h, w) m, registered with the image; ignored when it is of another shape.
        demand
            Which results of the analysis are wanted; none by default.
        placed
            Called with faces when their poses are known, before the analysis; where the detector searches this image,
            with those that were known before it does, and then with the others.

        Raises
        ------
        ModelError
            When a network fails.
        """
        if stamp < self._last_stamp:
            self.reset()
        self._last_stamp = stamp
        height, width = bgr.shape[:2]
        camera = camera.resized(width, height)
        if depth is not None and abs(depth.shape[1] * height / (depth.shape[0] * width) - 1.0) > ASPECT_TOLERANCE:
            depth = None
        observed: Dict[str, FaceObservation] = {}
        with self.times.in_parts("face_pose") as measured:

            def place(found: Sequence[TrackedFace]) -> None:
                # Unconfirmed ones get a pose, too: when they are confirmed, it may not be their turn for a measurement.
                new = [face for face in found if face.id not in observed]
                with measured():
                    poses = self._geometry.observe(new, camera, stamp, depth, bgr)
                observed.update((face.id, face) for face in poses)
                if placed is not None:
                    placed([observation for observation, face in zip(poses, new) if face.confirmed])

            tracked = self._tracking.update(bgr, stamp, place, camera)
            self._forget_dropped()
            place(tracked)
        faces = [observed[face.id] for face in tracked if face.confirmed]
        self._count(faces)
        faces = self._analysis.update(bgr, faces, stamp, demand, self._tracking.detected, camera)
        if self.recognition is not None:
            self._tracking.take_templates(self.recognition.made, stamp)
        return faces

    def _judge(self) -> AppearanceMatcher:
        """Return what compares the looks of faces, by templates where persons are recognised."""
        if self._analysis.recognition is None:
            return AppearanceMatcher()
        embedder = self._analysis.recognition.embedder
        return AppearanceMatcher(embedder.embed, embedder.size, embedder.calibration.fair_midpoint, embedder.alignment)

    def _forget_dropped(self) -> None:
        """Drop the state of faces that are not tracked any more."""
        ids = self._tracking.all_ids
        self._geometry.keep(ids)
        self._analysis.keep(ids)

    def _count(self, faces: Sequence[FaceObservation]) -> None:
        """Count how many of the published faces were predicted instead of measured."""
        self._published += len(faces)
        self._predicted += sum(not face.measured for face in faces)

    def note_timing(self, age: float, took: float) -> None:
        """Note, before update, the age (s) of the image, and the time (s) that the last one took in all."""
        self._tracking.scheduler.note_timing(age, took)

    def reconfigure(self, settings: FacePipelineSettings) -> None:
        """Apply the values of the live parameters; the faces stay."""
        self._tracking.reconfigure(settings)
        self._analysis.reconfigure(settings)

    def turn(self, rotation: ImageRotation) -> None:
        """Take note that the images are turned by `rotation` from now on, against those before; the faces stay."""
        self._tracking.turn(rotation)
        self._geometry.turn(rotation)
        self._analysis.turn(rotation)

    def reset(self) -> None:
        """Drop every face, as after a jump in time; ids are not used again."""
        self._tracking.reset()
        self._geometry.reset()
        self._analysis.reset()
        self._last_stamp = -np.inf

    def status(self) -> Dict[str, object]:
        """Return values for diagnostics, since the last call."""
        values: Dict[str, object] = {"tracked": len(self.tracked_ids), "mesh_ms": 1e3 * self._tracking.scheduler.cost,
                                     "spare_percent": 100.0 * self._tracking.scheduler.spare,
                                     "threads": self._tracking.scheduler.threads,
                                     "predicted_percent": 100.0 * self._predicted / max(1, self._published)}
        self._published = self._predicted = 0
        values.update(self._analysis.status())
        values.update(self.times.values())
        return values

    def close(self) -> None:
        """Release all resources. Idempotent."""
        self._analysis.close()
        self._threads.close()
