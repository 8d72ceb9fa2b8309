"""Apparent age and gender: networks behind one interface, and the fusion of their estimates of one face over time.

An estimate of somebody's appearance, trained on pictures of famous people; no statement about who somebody is.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, List, Optional, Protocol, Sequence, Tuple, Type, Union

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.crops import aligned_crop
from hri_pipeline.core.onnx import ModelError, OnnxModel

MIN_AGE, MAX_AGE = 0.0, 110.0
"""Legal range (years); an answer outside is left out."""


@dataclass(frozen=True)
class AgeGender:
    """One estimate: age and its standard deviation (years), probability 0 to 1 of a female appearance.

    picture_sd: standard deviation (years) of an error that all estimates from such pictures share, which does not
    average out.
    """

    age: float
    age_sd: float
    p_female: float
    picture_sd: float = 0.0


class AgeGenderModel(Protocol):
    """What a network of age and gender has to do."""

    def crop(self, bgr: np.ndarray, points: np.ndarray, camera: Optional[CameraModel] = None) -> np.ndarray:
        """Cut the network's view of a face, (S, S, 3) uint8 BGR; points: mesh (478, 3) px; camera: see
        `aligned_crop`."""

    def estimate(self, crops: Sequence[np.ndarray]) -> List[AgeGender]:
        """Return one answer per crop, in order."""


class _OnnxAgeGender(ABC):
    """What the adapters share: a network that is checked by a trial run."""

    INPUTS: Tuple[str, ...] = ()
    OUTPUTS: Dict[str, int] = {}
    """Outputs and the numbers in each for one face."""
    SIZE = 0
    MARGIN = 1.0
    """Side of the crop over that of the mesh."""
    AGE_SD = 8.0
    """Standard deviation (years) of what one good estimate is off by, besides _COMMON_SD."""
    BLUR = 0.0
    """Standard deviation (px) of the blur with which a crop is shown a second time; 0: once only."""
    BLURRED_WEIGHT, BLURRED_SD = 0.0, 0.0
    """Weight of the age of the blurred crop, and `picture_sd` over how far it is from the other."""

    def __init__(self, path: Union[str, Path], providers: Sequence[str] = ("cpu",),
                 notify: Optional[Callable[[str], None]] = None) -> None:
        """Raises ModelError that names the file and what it lacks."""
        self._model = OnnxModel(path, providers, inputs=self.INPUTS, outputs=tuple(self.OUTPUTS), notify=notify,
                                most_on_cpu=1)
        trial = self._run(np.zeros((1, self.SIZE, self.SIZE, 3), np.float32))
        for name, size in self.OUTPUTS.items():
            if trial[name].size != size:
                raise ModelError("model file {} gives {} numbers in {} instead of {}; it is no {} network".format(
                    path, trial[name].size, name, size, type(self).__name__))

    def crop(self, bgr: np.ndarray, points: np.ndarray, camera: Optional[CameraModel] = None) -> np.ndarray:
        """Cut the network's view. Raises ValueError for points that are not finite."""
        return aligned_crop(bgr, points, self.SIZE, self.MARGIN, camera)

    def estimate(self, crops: Sequence[np.ndarray]) -> List[AgeGender]:
        """Return one answer per crop, in order; an age that is not finite is returned as NaN with an infinite
        deviation."""
        return [self._estimate(crop) for crop in crops]

    def _estimate(self, crop: np.ndarray) -> AgeGender:
        sharp = self._answer(self._run(crop[None].astype(np.float32)))
        if not (self.BLUR > 0.0 and math.isfinite(sharp.age)):
            return sharp
        blurred = self._answer(self._run(cv2.GaussianBlur(crop, (0, 0), self.BLUR)[None].astype(np.float32)))
        if not math.isfinite(blurred.age):
            return blurred
        shift = blurred.age - sharp.age
        return replace(sharp, age=sharp.age + self.BLURRED_WEIGHT * shift, picture_sd=self.BLURRED_SD * abs(shift))

    @abstractmethod
    def _run(self, batch: np.ndarray) -> Dict[str, np.ndarray]:
        """Outputs of the network for crops (N, S, S, 3) float32 BGR."""

    @abstractmethod
    def _answer(self, out: Dict[str, np.ndarray]) -> AgeGender:
        """Estimate from the outputs for one face."""

    def _checked(self, age: float, p_female: float) -> AgeGender:
        if not (MIN_AGE <= age <= MAX_AGE and 0.0 <= p_female <= 1.0):
            return AgeGender(float("nan"), float("inf"), 0.5)
        return AgeGender(age, self.AGE_SD, p_female)


class FaceApiAgeGender(_OnnxAgeGender):
    """age_gender.onnx of face-api (MIT): RGB 112 px, `age` in years, `gender` male and female.

    On 46 faces of the demonstration and evaluation pictures: 45 genders right; 4.1 years of mean error on the 24 whose
    age is roughly known. Larger crops are worse (margin 1.3: 5.1 years). Of one man on 11 photographs the ages spread
    by 3.1 years; with _COMMON_SD the age is within 10 years a little more often than is said.

    What noise, its smoothing, compression and sharpening add to a face makes it older. The same crop blurred tells: an
    age that hangs on the finest details goes with them.
    """

    INPUTS = ("image",)
    OUTPUTS = {"age": 1, "gender": 2}
    SIZE = 112
    AGE_SD = 4.0
    # Fitted on 23 faces spoilt in 41 ways, against what is told of them clean: an age of one spoilt crop is off by 6.5
    # years (root mean square) alone, by 5.8 with the blurred one.
    BLUR, BLURRED_WEIGHT, BLURRED_SD = 2.0, 0.3, 0.53

    def _run(self, batch: np.ndarray) -> Dict[str, np.ndarray]:
        return self._model.run({"image": np.ascontiguousarray(batch[..., ::-1])})

    def _answer(self, out: Dict[str, np.ndarray]) -> AgeGender:
        return self._checked(float(out["age"].ravel()[0]), float(out["gender"].ravel()[1]))


class RetailAgeGender(_OnnxAgeGender):
    """age-gender-recognition-retail-0013 of the Open Model Zoo, or an ONNX file of the same signature.

    Input N x 3 x 62 x 62, BGR, 0 to 255; outputs `prob` (female, male) and `age_conv3` or `fc3_a`, years over 100. It
    knows ages from 18 to 75.
    """

    AGE_NAMES = ("age_conv3", "fc3_a")
    SIZE = 62
    MARGIN = 1.2
    AGE_SD = 9.0

    def __init__(self, path: Union[str, Path], providers: Sequence[str] = ("cpu",),
                 notify: Optional[Callable[[str], None]] = None) -> None:
        """Raises ModelError that names the file and what it lacks."""
        found = signature(path)
        ages = [name for name in self.AGE_NAMES if name in found[1]]
        if not ages or len(found[0]) != 1:
            raise ModelError("model file {} has the inputs {} and outputs {}; age-gender-recognition-retail-0013 has "
                             "one input, and the outputs prob and {}".format(
                                 path, ", ".join(found[0]), ", ".join(found[1]), " or ".join(self.AGE_NAMES)))
        self._age, self._input = ages[0], found[0][0]
        self.INPUTS, self.OUTPUTS = (self._input,), {self._age: 1, "prob": 2}
        super().__init__(path, providers, notify)

    def _run(self, batch: np.ndarray) -> Dict[str, np.ndarray]:
        return self._model.run({self._input: np.ascontiguousarray(batch.transpose(0, 3, 1, 2))})

    def _answer(self, out: Dict[str, np.ndarray]) -> AgeGender:
        return self._checked(100.0 * float(out[self._age].ravel()[0]), float(out["prob"].ravel()[0]))


KINDS: Dict[str, Type[_OnnxAgeGender]] = {"face_api": FaceApiAgeGender, "retail_0013": RetailAgeGender}


def signature(path: Union[str, Path]) -> Tuple[List[str], List[str]]:
    """Names of the inputs and outputs of an ONNX file. Raises ModelError naming the file."""
    model = OnnxModel(path)
    return model.input_names, model.output_names


def load_age_gender(path: Union[str, Path], kind: str = "auto", providers: Sequence[str] = ("cpu",),
                    notify: Optional[Callable[[str], None]] = None) -> AgeGenderModel:
    """Load a network; kind: one of KINDS, or `auto`: by the names of its outputs.

    Raises ModelError that names the file, what it has, and what is known.
    """
    if kind == "auto":
        names = set(signature(path)[1])
        fitting = [key for key, outputs in (("face_api", {"age", "gender"}), ("retail_0013", {"prob"}))
                   if outputs <= names]
        if not fitting:
            raise ModelError("model file {} has the outputs {}; known are networks with age and gender (face-api), or"
                             " prob and age_conv3 (age-gender-recognition-retail-0013)".format(
                                 path, ", ".join(sorted(names))))
        kind = fitting[0]
    if kind not in KINDS:
        raise ModelError("unknown kind {!r} of age and gender network; known: auto, {}".format(kind, ", ".join(KINDS)))
    return KINDS[kind](path, providers, notify)


@dataclass(frozen=True)
class FusedAgeGender:
    """age and age_sd: years; age_confidence: 0 to 1, probability that the age is right within AGE_TOLERANCE;
    p_female: 0 to 1; gender_known: False while neither is sure enough; samples: how many estimates contributed."""

    age: float
    age_sd: float
    age_confidence: float
    p_female: float
    gender_known: bool
    samples: int


AGE_TOLERANCE = 10.0
"""Half the width (years) of the range of which age_confidence speaks."""
_KEPT = 30
"""Estimates that are kept, the best and latest of them."""
_COMMON_SD = 5.0
"""Standard deviation (years) of the error that all estimates of one face share: the network's, not the picture's."""
_HALF_LIFE = 120.0
"""Time (s) after which an estimate counts half: a face is one track, of minutes."""
_NEEDED_WEIGHT = 0.6
"""Sum of weights from which there is a result: one very good estimate or several mediocre ones."""
_MAX_LOG_ODDS = 3.0
"""Most log-odds that one estimate gives to a gender."""
_MIN_SURE = 0.75
_HUBER = 1.5
"""Residuals beyond so many standard deviations count less (Huber 1964)."""


class AgeGenderFusion:
    """Fuses the estimates of one face over time: weighted by picture quality, robust against outliers."""

    def __init__(self) -> None:
        self._samples: List[Tuple[float, float, float, float, float, float]] = []
        self._last = -math.inf

    def add(self, estimate: AgeGender, quality: float, stamp: float) -> None:
        """Add an estimate from a picture of a quality (0 to 1, see `crops.crop_quality`) at a time (s).

        A stamp that goes back is a new start. What is not finite, or of quality 0, is left out.
        """
        if stamp < self._last:
            self._samples = []
        self._last = stamp
        numbers = (stamp, estimate.age, estimate.age_sd, estimate.p_female, quality, estimate.picture_sd)
        if not all(math.isfinite(number) for number in numbers) or not quality > 0.0 or not estimate.age_sd > 0.0:
            return
        self._samples.append((stamp, estimate.age, estimate.age_sd, min(max(estimate.p_female, 1e-3), 1.0 - 1e-3),
                              min(quality, 1.0), estimate.picture_sd))
        if len(self._samples) > _KEPT:
            weights = self._weights(stamp)
            self._samples.pop(int(np.argmin(weights)))

    def estimate(self) -> Optional[FusedAgeGender]:
        """Return what is known, None while that is not enough.

        The deviation falls with the number of estimates, but never below the error of the network itself.
        """
        if not self._samples:
            return None
        weights = self._weights(self._last)
        total = float(weights.sum())
        if total < _NEEDED_WEIGHT:
            return None
        samples = np.array(self._samples)
        # Who was seen in noise first and well later is as old as seen well.
        picture = samples[:, 5] ** 2
        clear = weights * _COMMON_SD ** 2 / (_COMMON_SD ** 2 + picture)
        age, sd = _robust_mean(samples[:, 1], samples[:, 2], clear)
        age_sd = math.sqrt(sd ** 2 + _COMMON_SD ** 2 + float((clear * picture).sum() / clear.sum()))
        odds = np.clip(np.log(samples[:, 3] / (1.0 - samples[:, 3])), -_MAX_LOG_ODDS, _MAX_LOG_ODDS)
        # Estimates of one face have a common error: their mean counts, not their sum.
        p_female = 1.0 / (1.0 + math.exp(-float((weights * odds).sum()) / total))
        confidence = math.erf(AGE_TOLERANCE / (age_sd * math.sqrt(2.0)))
        sure = max(p_female, 1.0 - p_female) >= _MIN_SURE
        return FusedAgeGender(age, age_sd, confidence, p_female, sure, len(samples))

    def _weights(self, now: float) -> np.ndarray:
        samples = np.array(self._samples)
        return samples[:, 4] ** 2 * 0.5 ** ((now - samples[:, 0]) / _HALF_LIFE)


def _robust_mean(ages: np.ndarray, deviations: np.ndarray, weights: np.ndarray) -> Tuple[float, float]:
    """Weighted Huber mean of the ages and its standard deviation, years."""
    order = np.argsort(ages)
    share = np.cumsum(weights[order]) / weights.sum()
    mean = float(ages[order][np.searchsorted(share, 0.5)])
    factor = weights / deviations ** 2
    for _ in range(5):
        away = np.abs(ages - mean) / deviations
        used = factor * np.minimum(1.0, _HUBER / np.maximum(away, 1e-9))
        mean = float((used * ages).sum() / used.sum())
    return mean, float(1.0 / math.sqrt(used.sum()))
