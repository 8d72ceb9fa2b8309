"""Expression, and age and gender, as stages of the faces: which face the network looks at next, and what it said."""

from __future__ import annotations

from types import SimpleNamespace
from typing import AbstractSet, Callable, Collection, Dict, Mapping, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.faces.action_units import ActionUnits
from hri_pipeline.core.faces.age_gender import AgeGenderFusion, load_age_gender
from hri_pipeline.core.faces.expression import ExpressionEstimate, ExpressionModel, ExpressionTracker
from hri_pipeline.core.model_store import model_path
from hri_pipeline.core.observations import FaceObservation, SoftBiometrics

EXPRESSION_PERIOD = 0.5
"""Time (s) between two looks of the expression network at a face; between them its action units speak."""

AGE_FIRST_PERIOD, AGE_LAST_PERIOD, AGE_QUICK_LOOKS, AGE_SLOWER = 0.7, 20.0, 4, 1.6
"""Time (s) between two looks of the age and gender network at a face: the first four come quickly, then each takes 1.6
times as long to come."""
LEAST_QUALITY = 0.3
"""Least quality of a crop that is shown to the age and gender network."""

Notify = Callable[[str], None]


def most_overdue(faces: Sequence[FaceObservation], looked: Mapping[str, float], periods: Callable[[str], float],
                 stamp: float) -> Tuple[Optional[FaceObservation], float]:
    """Return the face whose last look (s) is longest ago in its own period (s), and how many periods; None, 0 for none.

    A face without a look counts as two periods overdue.
    """
    best: Tuple[Optional[FaceObservation], float] = (None, 0.0)
    for face in faces:
        late = (stamp - looked[face.id]) / periods(face.id) if face.id in looked else 2.0
        if late > best[1]:
            best = (face, late)
    return best


class ExpressionStage:
    """Runs the expression network now and then and fuses it with the action units of every image."""

    def __init__(self, settings: SimpleNamespace, notify: Optional[Notify] = None) -> None:
        """settings: expression_model and providers. Raises ModelError."""
        path = model_path(settings.expression_model, "face_expression.onnx")
        self._model = ExpressionModel(path, settings.providers, notify)
        self.reset()

    def reset(self) -> None:
        """Forget all faces."""
        self._trackers: Dict[str, ExpressionTracker] = {}
        self._looked: Dict[str, float] = {}
        self._fresh: Dict[str, np.ndarray] = {}
        self._latest: Dict[str, Optional[ExpressionEstimate]] = {}

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        for table in (self._trackers, self._looked, self._fresh, self._latest):
            for face_id in [face_id for face_id in table if face_id not in ids]:
                del table[face_id]

    def overdue(self, faces: Sequence[FaceObservation], stamp: float, wanted: AbstractSet[str]) -> float:
        """Return how many periods the most overdue look is late; 0 for none, 1 is due."""
        return self._next(faces, stamp, wanted)[1]

    def look(self, bgr: np.ndarray, faces: Sequence[FaceObservation], stamp: float, wanted: AbstractSet[str]) -> None:
        """Let the network look at the most overdue face."""
        face, _ = self._next(faces, stamp, wanted)
        if face is not None:
            self._looked[face.id] = stamp
            self._fresh[face.id] = self._model.probabilities([self._model.crop(bgr, face.mesh)])[0]

    def combine(self, faces: Sequence[FaceObservation], units: Mapping[str, ActionUnits], stamp: float,
                wanted: AbstractSet[str]) -> None:
        """Take what network and action units say of the faces that were looked at in this image."""
        self._latest = {}
        for face in faces:
            if face.id in wanted and face.measured:
                tracker = self._trackers.setdefault(face.id, ExpressionTracker())
                self._latest[face.id] = tracker.update(self._fresh.pop(face.id, None), units.get(face.id), stamp)

    def estimate(self, face_id: str) -> Optional[ExpressionEstimate]:
        """Return the expression of a face in this image, None when it was not looked at."""
        return self._latest.get(face_id)

    def _next(self, faces: Sequence[FaceObservation], stamp: float, wanted: AbstractSet[str]
              ) -> Tuple[Optional[FaceObservation], float]:
        return most_overdue([face for face in faces if face.id in wanted], self._looked,
                            lambda face_id: EXPRESSION_PERIOD, stamp)


class AgeGenderStage:
    """Runs the age and gender network rarely, on good crops, ever more rarely the more it has said."""

    def __init__(self, settings: SimpleNamespace, notify: Optional[Notify] = None) -> None:
        """settings: age_gender_model and providers. Raises ModelError."""
        path = model_path(settings.age_gender_model, "age_gender.onnx")
        self._model = load_age_gender(path, "auto", settings.providers, notify)
        self.reset()

    def reset(self) -> None:
        """Forget all faces."""
        self._fusions: Dict[str, AgeGenderFusion] = {}
        self._looked: Dict[str, float] = {}
        self._counts: Dict[str, int] = {}
        self._known: Dict[str, Optional[SoftBiometrics]] = {}

    def keep(self, ids: Collection[str]) -> None:
        """Forget all faces but these."""
        for table in (self._fusions, self._looked, self._counts, self._known):
            for face_id in [face_id for face_id in table if face_id not in ids]:
                del table[face_id]

    def overdue(self, faces: Sequence[FaceObservation], qualities: Mapping[str, float], stamp: float,
                wanted: AbstractSet[str]) -> float:
        """Return how many periods the most overdue look is late; 0 for none, 1 is due."""
        return self._next(faces, qualities, stamp, wanted)[1]

    def look(self, bgr: np.ndarray, faces: Sequence[FaceObservation], qualities: Mapping[str, float], stamp: float,
             wanted: AbstractSet[str]) -> None:
        """Let the network look at the most overdue face that is seen well."""
        face, _ = self._next(faces, qualities, stamp, wanted)
        if face is None:
            return
        self._looked[face.id] = stamp
        self._counts[face.id] = self._counts.get(face.id, 0) + 1
        fusion = self._fusions.setdefault(face.id, AgeGenderFusion())
        fusion.add(self._model.estimate([self._model.crop(bgr, face.mesh)])[0], qualities[face.id], stamp)
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
        return most_overdue(good, self._looked, self._period, stamp)

    def _period(self, face_id: str) -> float:
        looks = self._counts.get(face_id, 0)
        return min(AGE_FIRST_PERIOD * AGE_SLOWER ** max(0, looks - AGE_QUICK_LOOKS), AGE_LAST_PERIOD)
