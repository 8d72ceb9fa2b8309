"""What a face does, expresses, and whose it is: the stages behind the geometry, each only when somebody wants it.

Action units are cheap and come from every look. The networks (expression, age and gender, recognition) are not: at most
one of them runs per image, on one face, the most overdue first, and rather not in an image in which the detector ran. Over
time they take three quarters of `face_budget` at most, so that learning a crowd does not cost it its images, but for what
they have saved up while nobody was new: while that is much, some faces are recognised in one image. Where several networks
are due, they take turns.
"""

from __future__ import annotations

import dataclasses
import time
from types import SimpleNamespace
from typing import AbstractSet, Callable, Collection, Dict, FrozenSet, List, Mapping, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.faces.action_units import ActionUnitEstimator, ActionUnits
from hri_pipeline.core.faces.canonical_face import CanonicalFace
from hri_pipeline.core.faces.face_budget import TimeShare
from hri_pipeline.core.faces.face_measures import FaceMeasures
from hri_pipeline.core.faces.face_quality import FaceQualities
from hri_pipeline.core.faces.face_traits import AgeGenderStage, ExpressionStage
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.recognition.face_identity import Match
from hri_pipeline.core.recognition.face_recognition_stage import RecognitionStage
from hri_pipeline.core.timing import StageTimes

STAGES = ("action_units", "expression", "age_gender", "recognition")
"""Names of the stages, which are those of the parameters that switch them."""
_PATIENCE = 2.0
"""Overdue, in its own periods, from which a network runs in an image in which the detector ran, too."""
_SHARE = 0.75
"""Part of the budget of looks that the networks may take besides."""
_SAVED_S = 0.3
"""Time of the networks that may be saved up: some ten looks."""
_AT_ONCE = 3
"""Faces that are recognised in one image while much is saved up; else one."""


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
    """Runs the stages that are switched on. Not safe for use from several threads at once.

    settings: those of face_parameters.ANALYSIS_PARAMETERS, `face_budget` and `providers`. clock: s of processor time,
    what the budget counts. Raises ModelError when the network of a stage that is switched on is missing or wrong.
    """

    def __init__(self, settings: SimpleNamespace, canonical: CanonicalFace, times: StageTimes,
                 notify: Optional[Callable[[str], None]] = None, clock: Callable[[], float] = time.thread_time) -> None:
        self.enabled = [name for name in STAGES if getattr(settings, name)]
        needs_units = settings.action_units or settings.expression
        self._measures = FaceMeasures(canonical) if needs_units else None
        self._units: Dict[str, ActionUnitEstimator] = {}
        self._publishes_units = settings.action_units
        self._expression = ExpressionStage(settings, notify) if settings.expression else None
        self._age_gender = AgeGenderStage(settings, notify) if settings.age_gender else None
        self.recognition = RecognitionStage(settings, notify) if settings.recognition else None
        self._qualities = FaceQualities()
        self._times = times
        self._clock = clock
        self._share = TimeShare(1e-3 * _SHARE * settings.face_budget, _SAVED_S)
        self._images = self._waits = 0
        self._last, self._stamp = "", -np.inf
        self.matches: List[Match] = []

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters."""
        self._share.change(1e-3 * _SHARE * settings.face_budget)
        if self.recognition is not None:
            self.recognition.recogniser.learn_delay = settings.recognition_learn_delay

    def update(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float, demand: FaceDemand,
               busy: bool = False) -> List[FaceObservation]:
        """Return the faces with what is known of them; `matches` then holds the changed matches of this image.

        bgr: (H, W, 3) uint8; faces: all of this image; stamp: s; busy: the image has cost much already.
        """
        units = self._action_units(faces, stamp, demand, (bgr.shape[1], bgr.shape[0]))
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
        for stage in self._stages():
            stage.keep(ids)

    def reset(self) -> None:
        """Forget all faces; known persons stay."""
        self._units = {}
        self.matches = []
        self._qualities.reset()
        for stage in self._stages():
            stage.reset()

    def status(self) -> Dict[str, object]:
        """Return values for diagnostics."""
        values: Dict[str, object] = {"stages": " ".join(self.enabled) or "none",
                                     "networks_wait_percent": 100.0 * self._waits / max(1, self._images)}
        self._images = self._waits = 0
        if self.recognition is not None:
            values.update(self.recognition.status())
        return values

    def close(self) -> None:
        """Give everything back. Idempotent."""
        if self.recognition is not None:
            self.recognition.close()

    def _stages(self) -> list:
        return [stage for stage in (self._expression, self._age_gender, self.recognition) if stage is not None]

    def _action_units(self, faces: Sequence[FaceObservation], stamp: float, demand: FaceDemand, size: Tuple[int, int]
                      ) -> Dict[str, ActionUnits]:
        """Action units of the faces that were looked at and of which somebody wants them, directly or for more."""
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
                    estimator = self._units.setdefault(face.id, ActionUnitEstimator(self._measures))
                    found[face.id] = estimator.update(face.mesh, face.pose, stamp, face.score, size)
        return found

    def _assess(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float,
                demand: FaceDemand) -> Mapping[str, float]:
        """Qualities of all faces; 0 for one that was not looked at in this image."""
        wanted = self.recognition is not None and demand.recognition
        wanted = wanted or (self._age_gender is not None and bool(demand.soft_biometrics))
        if not wanted:
            return {}
        with self._times("crop_quality"):
            known = self._qualities.update(bgr, [face for face in faces if face.measured], stamp)
        return {face.id: known.get(face.id, 0.0) for face in faces}

    def _run_one(self, bgr: np.ndarray, faces: Sequence[FaceObservation], qualities: Mapping[str, float], stamp: float,
                 demand: FaceDemand, busy: bool) -> None:
        """Run the most overdue network on one face, and take what has changed in who is who."""
        measured = [face for face in faces if face.measured]
        overdue = {"expression": 0.0, "age_gender": 0.0, "recognition": 0.0}
        if self._expression is not None:
            overdue["expression"] = self._expression.overdue(measured, stamp, demand.expression)
        if self._age_gender is not None:
            overdue["age_gender"] = self._age_gender.overdue(measured, qualities, stamp, demand.soft_biometrics)
        if self.recognition is not None and demand.recognition:
            # Who is who comes first: until it is known, everything else lacks its person.
            is_due = self.recognition.due(qualities, stamp, limit=_AT_ONCE if self._share.ample else 1)
            overdue["recognition"] = 2.0 * _PATIENCE if is_due else 0.0
        name = next_turn(overdue, self._last)
        paid = self._share.next_image(stamp - self._stamp)
        self._stamp = stamp
        self._images += 1
        if overdue[name] < (_PATIENCE if busy else 1.0):
            name = ""
        elif not paid:
            self._waits += 1
            name = ""
        began = self._clock()
        self.matches = self._run_network(name, bgr, measured, qualities, stamp, demand)
        if name:
            self._last = name
            self._share.spent(self._clock() - began)

    def _run_network(self, name: str, bgr: np.ndarray, faces: Sequence[FaceObservation], qualities: Mapping[str, float],
                     stamp: float, demand: FaceDemand) -> List[Match]:
        """Run the network of this name, none for the empty one; returns what has changed in who is who."""
        if name == "recognition":
            with self._times("recognition"):
                return self.recognition.look(bgr, faces, stamp)
        if name == "expression":
            with self._times("expression"):
                self._expression.look(bgr, faces, stamp, demand.expression)
        elif name == "age_gender":
            with self._times("age_gender"):
                self._age_gender.look(bgr, faces, qualities, stamp, demand.soft_biometrics)
        return [] if self.recognition is None else self.recognition.changes(stamp)

    def _with_results(self, face: FaceObservation, units: Mapping[str, ActionUnits], demand: FaceDemand) -> FaceObservation:
        results: Dict[str, object] = {}
        if self._publishes_units and face.id in demand.action_units:
            results["action_units"] = units.get(face.id)
        if self._expression is not None and face.id in demand.expression:
            results["expression"] = self._expression.estimate(face.id)
        if self._age_gender is not None and face.id in demand.soft_biometrics:
            results["soft_biometrics"] = self._age_gender.estimate(face.id)
        return dataclasses.replace(face, **results) if results else face


def next_turn(overdue: Mapping[str, float], last: str) -> str:
    """Return the most overdue name; the one that had its turn `last` only when no other is due (1 and more)."""
    others = [name for name in overdue if name != last and overdue[name] >= 1.0]
    return max(others or overdue, key=lambda name: overdue[name])
