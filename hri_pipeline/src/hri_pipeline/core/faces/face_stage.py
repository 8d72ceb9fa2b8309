"""From images to tracked faces with everything that is known of them: the one place where all face stages meet."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Callable, Dict, List, Optional

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.canonical_face import load_canonical_face
from hri_pipeline.core.faces.face_analysis import FaceAnalysis, FaceDemand
from hri_pipeline.core.faces.face_finder import FaceFinder
from hri_pipeline.core.faces.face_geometry import FaceGeometry
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.model_store import model_path
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.recognition.face_identity import Match
from hri_pipeline.core.recognition.face_recognition_stage import RecognitionStage
from hri_pipeline.core.timing import StageTimes

NOTHING = FaceDemand()


class FaceStage:
    """Finds and follows faces. Not safe for use from several threads at once.

    settings: the values of FACE_STAGE_PARAMETERS and `providers`. notify: told in one line about an execution
    provider that is skipped. Raises ModelError when a model file is missing or wrong.
    """

    def __init__(self, settings: SimpleNamespace, ids: Optional[IdGenerator] = None,
                 notify: Optional[Callable[[str], None]] = None) -> None:
        self.times = StageTimes()
        self._finder = FaceFinder(settings, self.times, ids, notify)
        canonical = load_canonical_face(model_path(settings.canonical_face, "canonical_face.npz"))
        self._geometry = FaceGeometry(canonical)
        self._analysis = FaceAnalysis(settings, canonical, self.times, notify)
        self._last_stamp = -np.inf
        self._predicted = 0
        self._seen = 0

    @property
    def tracked_ids(self) -> List[str]:
        """Ids of all faces being tracked, oldest first: those seen in the last image and those just hidden."""
        return self._finder.tracked_ids

    @property
    def recognition(self) -> Optional[RecognitionStage]:
        """The stage that knows persons; None when it is switched off."""
        return self._analysis.recognition

    @property
    def matches(self) -> List[Match]:
        """What has changed in who is who by the last image."""
        return self._analysis.matches

    def update(self, bgr: np.ndarray, camera: CameraModel, stamp: float, depth: Optional[np.ndarray] = None,
               demand: FaceDemand = NOTHING) -> List[FaceObservation]:
        """Confirmed faces seen in this image, oldest first.

        bgr: (H, W, 3) uint8; camera: its model, scaled when it is of another size; stamp: s, increasing; depth: (H, W) m
        registered with the image (one of another size is left out); demand: which results behind the geometry are
        wanted, by default none. A stamp that goes back is a new start: every face is dropped.
        """
        if stamp < self._last_stamp:
            self.reset()
        self._last_stamp = stamp
        height, width = bgr.shape[:2]
        camera = camera.resized(width, height)
        if depth is not None and depth.shape[:2] != (height, width):
            depth = None
        sightings = self._finder.update(bgr, stamp)
        living = self._finder.living_ids
        self._geometry.keep(living)
        self._analysis.keep(living)
        with self.times("face_pose"):
            # Those that wait for their confirmation are posed, too: when they get it, it may not be their turn.
            observed = self._geometry.observe(sightings, camera, stamp, depth)
            faces = [face for face, sighting in zip(observed, sightings) if sighting.confirmed]
        self._seen += len(faces)
        self._predicted += sum(not face.measured for face in faces)
        return self._analysis.update(bgr, faces, stamp, demand, self._finder.detected)

    def set_stature(self, face_id: str, stature: float) -> None:
        """Take the stature (m) of a face's person, known from its body: it tells the size of the head."""
        self._geometry.set_stature(face_id, stature)

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters; the faces stay."""
        self._finder.reconfigure(settings)
        self._analysis.reconfigure(settings)

    def reset(self) -> None:
        """Drop every face, as after a jump in time; ids are not given again."""
        self._finder.reset()
        self._geometry.reset()
        self._analysis.reset()
        self._last_stamp = -np.inf

    def status(self) -> Dict[str, object]:
        """Return values for diagnostics, since the last call."""
        values: Dict[str, object] = {"tracked": len(self.tracked_ids), "mesh_ms": 1e3 * self._finder.look_cost,
                                     "predicted_percent": 100.0 * self._predicted / max(1, self._seen)}
        self._seen = self._predicted = 0
        values.update(self._analysis.status())
        values.update(self.times.values())
        return values

    def close(self) -> None:
        """Give everything back. Idempotent."""
        self._analysis.close()
