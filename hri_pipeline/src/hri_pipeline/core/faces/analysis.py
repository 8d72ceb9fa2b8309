"""Action units, expression, age and gender, and recognition of tracked faces: what runs on which image.

Action units are cheap and are estimated from every measured mesh. The networks (expression, age and gender,
recognition) are not: at most one of them runs per image, on one face, the most overdue first, and rather not on an
image on which the detector ran. On average they take three quarters of `face_budget` at most, so that learning a crowd
does not slow tracking down. While there were no new faces, time is saved up; with much saved time, several faces are
recognised in one image. Where several networks are due, they take turns. Nothing runs that nobody subscribes to
(`FaceDemand`).
"""

from __future__ import annotations

import dataclasses
from typing import (
    AbstractSet,
    Any,
    Callable,
    Collection,
    Dict,
    FrozenSet,
    List,
    Mapping,
    Optional,
    Sequence,
    Set,
    Tuple,
)

import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.action_units import ActionUnitEstimator, ActionUnits, FaceMeasures
from hri_pipeline.core.faces.age_gender import AgeGenderFusion, load_age_gender
from hri_pipeline.core.faces.crops import relative_noise, turned_away
from hri_pipeline.core.faces.expression import (
    LEAST_CONFIDENCE,
    ExpressionEstimate,
    ExpressionModel,
    ExpressionTracker,
    view_quality,
)
from hri_pipeline.core.faces.mesh import CanonicalFace
from hri_pipeline.core.faces.parameters import FacePipelineSettings
from hri_pipeline.core.faces.scheduler import CropQualities, TimeBudget, most_overdue, next_turn
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.observations import FaceObservation, SoftBiometrics
from hri_pipeline.core.onnx import model_path
from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.recognition.face_identity import LEARN_QUALITY, PersonMatch
from hri_pipeline.core.recognition.face_recognition import FaceRecognition
from hri_pipeline.core.timing import StageTimes

STAGES = ("action_units", "expression", "age_gender", "recognition")
"""Names of the analyses, which are those of the parameters that switch them on."""
_PATIENCE = 2.0
"""Number of its own periods after which a network runs on an image on which the detector ran, too."""
_SHARE = 0.75
"""Processor time of these networks over the time budget of the mesh network."""
_SAVED_S = 0.3
"""Time (s) that may be saved up: some ten inferences."""
_AT_ONCE = 3
"""Faces that are recognised in one image while much time is saved up; else one."""
EXPRESSION_PERIOD = 0.5
"""Time (s) between two inferences of the expression network for a face; between them its action units are used."""
AGE_FIRST_PERIOD, AGE_LAST_PERIOD, AGE_QUICK_RUNS, AGE_SLOWER = 0.7, 20.0, 4, 1.6
"""Time (s) between two inferences of the age and gender network for a face: four quick ones, then each period is 1.6
times the last."""
LEAST_QUALITY = 0.3
"""Least quality of a crop for the age and gender network."""
MOST_NOISE = 0.075
"""Most noise of a crop, over its contrast, for that network, which takes noise for wrinkles. Of 27 faces on photographs
with noise and other faults .18 of the ages are more than 10 years from those of good images up to here, .75 beyond."""
Notify = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class FaceDemand:
    """Ids of the faces of which a result is wanted; recognition is wanted of all faces or of none."""

    action_units: AbstractSet[str] = frozenset()
    expression: AbstractSet[str] = frozenset()
    soft_biometrics: AbstractSet[str] = frozenset()
    recognition: bool = False

    @classmethod
    def everything(cls, ids: Collection[str]) -> "FaceDemand":
        """Return the demand for all results of these faces."""
        wanted: FrozenSet[str] = frozenset(ids)
        return cls(wanted, wanted, wanted, True)


class FaceAnalysis:
    """Runs the analyses that are switched on. Not thread-safe.

    Parameters
    ----------
    settings
        The values of parameters.ANALYSIS_PARAMETERS, `face_budget` and `providers`.
    canonical
        The canonical face.
    times
        Where the time of each analysis is noted.
    notify
        Called with one line of text for each execution provider that is skipped.
    threads
        Share the faces that are recognised in one image.

    Raises
    ------
    ModelError
        When the network of an analysis that is switched on is missing or wrong.
    """

    def __init__(self, settings: FacePipelineSettings, canonical: CanonicalFace, times: StageTimes,
                 notify: Optional[Callable[[str], None]] = None, threads: Threads = ONE_THREAD) -> None:
        self._threads = threads
        self.enabled = [name for name in STAGES if getattr(settings, name)]
        needs_units = settings.action_units or settings.expression
        self._measures = FaceMeasures(canonical) if needs_units else None
        self._units: Dict[str, ActionUnitEstimator] = {}
        self._publishes_units = settings.action_units
        self._expression = ExpressionProcessor(settings, notify) if settings.expression else None
        self._age_gender = AgeGenderProcessor(settings, notify) if settings.age_gender else None
        self.recognition = FaceRecognition(settings, notify, threads) if settings.recognition else None
        self._qualities = CropQualities()
        self._times = times
        self._time_budget = TimeBudget(1e-3 * _SHARE * settings.face_budget, _SAVED_S)
        self._camera: Optional[CameraModel] = None      # of the last image
        self._images = self._waits = 0
        self._last, self._stamp = "", -np.inf
        self.matches: List[PersonMatch] = []

    def reconfigure(self, settings: FacePipelineSettings) -> None:
        """Apply the values of the live parameters."""
        self._time_budget.change(1e-3 * _SHARE * settings.face_budget)
        if self.recognition is not None:
            self.recognition.recogniser.learn_delay = settings.recognition_learn_delay

    def update(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float, demand: FaceDemand,
               busy: bool = False, camera: Optional[CameraModel] = None) -> List[FaceObservation]:
        """Return the faces with their results; `matches` then holds the changes of the matches with persons.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8.
        faces
            All faces of this image.
        stamp
            Time of the image, s.
        demand
            Which results are wanted.
        busy
            Whether the detector ran on this image: networks then wait, if they can.
        camera
            Camera model of the image's size; None: not known.
        """
        self._camera = camera
        units = self._action_units(faces, stamp, demand)
        qualities = self._assess(bgr, faces, stamp, demand)
        self._run_one(bgr, faces, qualities, stamp, demand, busy)
        if self._expression is not None:
            self._expression.combine(faces, units, stamp, demand.expression)
        return [self._with_results(face, units, demand) for face in faces]

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        for face_id in [face_id for face_id in self._units if face_id not in ids]:
            del self._units[face_id]
        self._qualities.keep(ids)
        for processor in self._processors():
            processor.keep(ids)

    def turn(self, rotation: ImageRotation) -> None:
        """Take note that the images are turned by `rotation` from now on, against those before."""
        if self.recognition is not None:
            self.recognition.recogniser.turn(rotation)

    def reset(self) -> None:
        """Forget all faces; known persons stay."""
        self._units = {}
        self.matches = []
        self._qualities.reset()
        for processor in self._processors():
            processor.reset()

    def status(self) -> Dict[str, object]:
        """Return values for diagnostics."""
        values: Dict[str, object] = {"stages": " ".join(self.enabled) or "none",
                                     "networks_wait_percent": 100.0 * self._waits / max(1, self._images)}
        self._images = self._waits = 0
        if self.recognition is not None:
            values.update(self.recognition.status(self._qualities.flaws(LEARN_QUALITY)))
        return values

    def close(self) -> None:
        """Release all resources. Idempotent."""
        if self.recognition is not None:
            self.recognition.close()

    def _processors(self) -> list:
        return [processor for processor in (self._expression, self._age_gender, self.recognition)
                if processor is not None]

    def _action_units(self, faces: Sequence[FaceObservation], stamp: float, demand: FaceDemand
                      ) -> Dict[str, ActionUnits]:
        """Action units of the measured faces for which they are wanted, directly or for the expression."""
        if self._measures is None:
            return {}
        wanted: Set[str] = set(demand.expression) if self._expression is not None else set()
        if self._publishes_units:
            wanted |= demand.action_units
        found: Dict[str, ActionUnits] = {}
        if not wanted:
            return found
        with self._times("action_units"):
            for face in faces:
                if face.id in wanted and face.measured:
                    if face.id not in self._units:
                        self._units[face.id] = ActionUnitEstimator(self._measures)
                    estimator = self._units[face.id]
                    closed = None if face.gaze is None else face.gaze.eyes_closed
                    found[face.id] = estimator.update(face.mesh, face.pose, stamp, face.score, self._camera, closed,
                                                      face.dark_glasses)
        return found

    def _assess(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float,
                demand: FaceDemand) -> Mapping[str, float]:
        """Picture qualities of all faces; 0 for one that was not measured in this image."""
        wanted = self.recognition is not None and demand.recognition
        wanted = wanted or (self._age_gender is not None and bool(demand.soft_biometrics))
        if not wanted:
            return {}
        with self._times("crop_quality"):
            known = self._qualities.update(bgr, [face for face in faces if face.measured], stamp)
        return {face.id: known.get(face.id, 0.0) for face in faces}

    def _run_one(self, bgr: np.ndarray, faces: Sequence[FaceObservation], qualities: Mapping[str, float], stamp: float,
                 demand: FaceDemand, busy: bool) -> None:
        """Run the most overdue network on one face, and store the changes of the matches."""
        measured = [face for face in faces if face.measured]
        overdue = {"expression": 0.0, "age_gender": 0.0, "recognition": 0.0}
        if self._expression is not None:
            overdue["expression"] = self._expression.overdue(measured, stamp, demand.expression)
        if self._age_gender is not None:
            overdue["age_gender"] = self._age_gender.overdue(measured, qualities, stamp, demand.soft_biometrics)
        if self.recognition is not None and demand.recognition:
            # Recognition has priority: all other results belong to a person who must be known first.
            is_due = self.recognition.due(self._qualities.of_templates(qualities), stamp,
                                          limit=_AT_ONCE if self._time_budget.ample else 1, faces=measured)
            overdue["recognition"] = 2.0 * _PATIENCE if is_due else 0.0
        name = next_turn(overdue, self._last)
        paid = self._time_budget.next_image(stamp - self._stamp)
        self._stamp = stamp
        self._images += 1
        if overdue[name] < (_PATIENCE if busy else 1.0):
            name = ""
        elif not paid:
            self._waits += 1
            name = ""
        began = self._threads.time()
        self.matches = self._run_network(name, bgr, measured, qualities, stamp, demand)
        if name:
            self._last = name
            self._time_budget.spent(self._threads.time() - began)

    def _run_network(self, name: str, bgr: np.ndarray, faces: Sequence[FaceObservation], qualities: Mapping[str, float],
                     stamp: float, demand: FaceDemand) -> List[PersonMatch]:
        """Run the network of this name, none for the empty one; returns the changes of the matches."""
        if name == "recognition" and self.recognition is not None:
            with self._times("recognition"):
                return self.recognition.look(bgr, faces, stamp, self._camera)
        if name == "expression" and self._expression is not None:
            with self._times("expression"):
                self._expression.infer(bgr, faces, stamp, demand.expression, self._camera)
        elif name == "age_gender" and self._age_gender is not None:
            with self._times("age_gender"):
                self._age_gender.infer(bgr, faces, qualities, stamp, demand.soft_biometrics, self._camera)
        return [] if self.recognition is None else self.recognition.changes(stamp)

    def _with_results(self, face: FaceObservation, units: Mapping[str, ActionUnits],
                      demand: FaceDemand) -> FaceObservation:
        results: Dict[str, Any] = {}
        if self._publishes_units and face.id in demand.action_units:
            results["action_units"] = units.get(face.id)
        if self._expression is not None and face.id in demand.expression:
            results["expression"] = self._expression.estimate(face.id)
        if self._age_gender is not None and face.id in demand.soft_biometrics:
            results["soft_biometrics"] = self._age_gender.estimate(face.id)
        return dataclasses.replace(face, **results) if results else face


class ExpressionProcessor:
    """Runs the expression network periodically and fuses it with the action units of every image."""

    def __init__(self, settings: FacePipelineSettings, notify: Optional[Notify] = None) -> None:
        """settings: expression_model and providers. Raises ModelError."""
        path = model_path(settings.expression_model, "face_expression.onnx")
        self._model = ExpressionModel(path, settings.providers, notify)
        self.reset()

    def reset(self) -> None:
        """Forget all faces."""
        self._trackers: Dict[str, ExpressionTracker] = {}
        self._last_runs: Dict[str, float] = {}
        self._fresh: Dict[str, np.ndarray] = {}
        self._latest: Dict[str, Optional[ExpressionEstimate]] = {}

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        for table in (self._trackers, self._last_runs, self._fresh, self._latest):
            for face_id in [face_id for face_id in table if face_id not in ids]:
                del table[face_id]

    def overdue(self, faces: Sequence[FaceObservation], stamp: float, wanted: AbstractSet[str]) -> float:
        """Return how many periods ago the most overdue face was last analysed; 0 for none, 1 is due."""
        return self._next(faces, stamp, wanted)[1]

    def infer(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float, wanted: AbstractSet[str],
              camera: Optional[CameraModel] = None) -> None:
        """Run the network on the most overdue face; camera: of the image's size."""
        face, _ = self._next(faces, stamp, wanted)
        if face is not None:
            self._last_runs[face.id] = stamp
            self._fresh[face.id] = self._model.probabilities([self._model.crops(bgr, face.mesh, camera)])[0]

    def combine(self, faces: Sequence[FaceObservation], units: Mapping[str, ActionUnits], stamp: float,
                wanted: AbstractSet[str]) -> None:
        """Fuse network and action units for the faces that were measured in this image."""
        self._latest = {}
        for face in faces:
            if face.id in wanted and face.measured:
                if face.id not in self._trackers:
                    self._trackers[face.id] = ExpressionTracker()
                tracker = self._trackers[face.id]
                quality = view_quality(face.mesh, None if face.pose is None else turned_away(face.pose))
                self._latest[face.id] = tracker.update(self._fresh.pop(face.id, None), units.get(face.id), stamp,
                                                       quality)

    def estimate(self, face_id: str) -> Optional[ExpressionEstimate]:
        """Return the expression of a face in this image, None when it was not measured or is not sure enough."""
        latest = self._latest.get(face_id)
        return None if latest is None or latest.confidence < LEAST_CONFIDENCE else latest

    def _next(self, faces: Sequence[FaceObservation], stamp: float, wanted: AbstractSet[str]
              ) -> Tuple[Optional[FaceObservation], float]:
        return most_overdue([face for face in faces if face.id in wanted], self._last_runs,
                            lambda face_id: EXPRESSION_PERIOD, stamp)


class AgeGenderProcessor:
    """Runs the age and gender network on good crops, with a growing period."""

    def __init__(self, settings: FacePipelineSettings, notify: Optional[Notify] = None) -> None:
        """settings: age_gender_model and providers. Raises ModelError."""
        path = model_path(settings.age_gender_model, "age_gender.onnx")
        self._model = load_age_gender(path, "auto", settings.providers, notify)
        self.reset()

    def reset(self) -> None:
        """Forget all faces."""
        self._fusions: Dict[str, AgeGenderFusion] = {}
        self._last_runs: Dict[str, float] = {}
        self._counts: Dict[str, int] = {}
        self._known: Dict[str, Optional[SoftBiometrics]] = {}

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        for table in (self._fusions, self._last_runs, self._counts, self._known):
            for face_id in [face_id for face_id in table if face_id not in ids]:
                del table[face_id]

    def overdue(self, faces: Sequence[FaceObservation], qualities: Mapping[str, float], stamp: float,
                wanted: AbstractSet[str]) -> float:
        """Return how many periods ago the most overdue face was last analysed; 0 for none, 1 is due."""
        return self._next(faces, qualities, stamp, wanted)[1]

    def infer(self, bgr: np.ndarray, faces: Sequence[FaceObservation], qualities: Mapping[str, float], stamp: float,
              wanted: AbstractSet[str], camera: Optional[CameraModel] = None) -> None:
        """Run the network on the most overdue face that is seen well; camera: of the image's size."""
        face, _ = self._next(faces, qualities, stamp, wanted)
        if face is None:
            return
        self._last_runs[face.id] = stamp
        crop = self._model.crop(bgr, face.mesh, camera)
        if relative_noise(crop) > MOST_NOISE:
            return
        self._counts[face.id] = self._counts.get(face.id, 0) + 1
        fusion = self._fusions.setdefault(face.id, AgeGenderFusion())
        fusion.add(self._model.estimate([crop])[0], qualities[face.id], stamp)
        fused = fusion.estimate()
        self._known[face.id] = None if fused is None else SoftBiometrics(
            fused.age, fused.age_confidence, 1.0 - fused.p_female,
            max(fused.p_female, 1.0 - fused.p_female) if fused.gender_known else 0.0)

    def estimate(self, face_id: str) -> Optional[SoftBiometrics]:
        """Return what is known of a face, None while that is not enough."""
        return self._known.get(face_id)

    def _next(self, faces: Sequence[FaceObservation], qualities: Mapping[str, float], stamp: float,
              wanted: AbstractSet[str]) -> Tuple[Optional[FaceObservation], float]:
        good = [face for face in faces if face.id in wanted and qualities.get(face.id, 0.0) >= LEAST_QUALITY]
        return most_overdue(good, self._last_runs, self._period, stamp)

    def _period(self, face_id: str) -> float:
        runs = self._counts.get(face_id, 0)
        return min(AGE_FIRST_PERIOD * AGE_SLOWER ** max(0, runs - AGE_QUICK_RUNS), AGE_LAST_PERIOD)
