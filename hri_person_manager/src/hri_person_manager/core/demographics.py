"""Apparent age and gender of a person, fused over the faces that the person has had."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Optional

UNDEFINED, FEMALE, MALE, OTHER = range(4)      # the constants of hri_msgs/AgeAndGender and SoftBiometrics
AGE_DEVIATION = 6.3        # years, of the estimate from one face: the default model's mean error of 5 years
_LEAST_GENDER_CONFIDENCE = 0.6
_MAX_FACES = 20


@dataclass(frozen=True)
class DemographicsEstimate:
    """age and age_deviation in years, confidences 0 to 1, gender one of the constants; `stamp` s, of the newest image."""

    age: float
    age_deviation: float
    age_confidence: float
    gender: int
    gender_confidence: float
    stamp: float


@dataclass(frozen=True)
class _Face:
    age: float
    age_confidence: float
    female: float
    gender_confidence: float
    stamp: float


class Demographics:
    """What is known of one person. Each face counts once, with its newest estimate, as that is fused itself."""

    def __init__(self, earlier: Optional[DemographicsEstimate] = None) -> None:
        """Start with the estimate of an earlier run, if there is one; it counts as one face."""
        self._faces: "OrderedDict[str, _Face]" = OrderedDict()
        self._estimate: Optional[DemographicsEstimate] = None
        if earlier is not None:
            self.observe("", earlier.age, earlier.age_confidence, earlier.gender, earlier.gender_confidence,
                         earlier.stamp)

    def observe(self, face_id: str, age: float, age_confidence: float, gender: int, gender_confidence: float,
                stamp: float) -> bool:
        """Take the estimate of one face; returns whether it was sound and used.

        age: years; confidences: 0 (not known) to 1; stamp: s. The face that has been quiet longest goes first.
        """
        numbers = (age, age_confidence, gender_confidence, stamp)
        if not all(math.isfinite(number) for number in numbers) or not 0.0 <= age <= 130.0 or not (
                0.0 <= age_confidence <= 1.0 and 0.0 <= gender_confidence <= 1.0):
            return False
        female = {FEMALE: gender_confidence, MALE: 1.0 - gender_confidence}.get(gender, 0.5)
        known = gender_confidence if gender in (FEMALE, MALE) else 0.0
        self._faces.pop(face_id, None)
        self._faces[face_id] = _Face(age, age_confidence, female, known, stamp)
        while len(self._faces) > _MAX_FACES:
            self._faces.popitem(last=False)
        self._estimate = self._fuse()
        return True

    def absorb(self, other: "Demographics") -> None:
        """Take over the faces of a person that turned out to be the same."""
        for face_id, face in other._faces.items():
            self._faces.setdefault(face_id, face)
        self._estimate = self._fuse()

    def estimate(self) -> Optional[DemographicsEstimate]:
        """Return the fused estimate, None while nothing is known."""
        return self._estimate

    def _fuse(self) -> Optional[DemographicsEstimate]:
        """The faces are one human's, so their errors go together: confidences are averaged, not multiplied."""
        faces = [face for face in self._faces.values() if face.age_confidence > 0.0 or face.gender_confidence > 0.0]
        if not faces:
            return None
        weight = sum(face.age_confidence for face in faces)
        age = sum(face.age_confidence * face.age for face in faces) / weight if weight else 0.0
        spread = sum(face.age_confidence * (face.age - age) ** 2 for face in faces) / weight if weight else 0.0
        sure = sum(face.gender_confidence for face in faces)
        female = sum(face.gender_confidence * face.female for face in faces) / sure if sure else 0.5
        likely = max(female, 1.0 - female)
        gender = UNDEFINED if likely < _LEAST_GENDER_CONFIDENCE else FEMALE if female > 0.5 else MALE
        return DemographicsEstimate(
            age, math.sqrt(AGE_DEVIATION ** 2 + spread) if weight else 0.0, weight / len(faces), gender,
            likely if gender != UNDEFINED else 0.0, max(face.stamp for face in faces))
