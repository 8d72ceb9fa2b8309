"""Proportions of the human body, and the stature and segment lengths of a person from noisy key points.

The proportions are read from config/segments.yaml. The logarithms of the body's lengths are normal with the table's
mean and covariance; the lengths seen, each with its own variance, condition them (best linear unbiased prediction). So
any subset of segments gives the stature and every length, each with its standard deviation. Lengths are those between
the key points as their source places them; the stature is that of the person.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Mapping, Optional, Sequence, Tuple

import numpy as np
import yaml

from hri_fullbody.core import keypoints as kp

SEGMENTS: Tuple[str, ...] = (
    "upper_arm", "forearm", "thigh", "shank", "trunk", "half_shoulders", "half_hips", "neck")
"""Lengths of the kinematic model between joint centres; `neck` is from the shoulders' line to the skull base."""
STATISTICS: Tuple[str, ...] = ("stature",) + SEGMENTS + ("ankle_height",)
"""Order of the statistics' rows and columns."""
FACE_POINTS: Tuple[str, ...] = ("nose", "left_eye", "right_eye", "left_ear", "right_ear")
HEAD_POINTS: Tuple[str, ...] = ("sellion",) + FACE_POINTS

_FILE = "segments.yaml"
_LONGEST_QUOTE = 200
_RATIO_RANGE = (0.005, 0.6)
_CV_RANGE = (0.001, 0.5)
_HEAD_POINT_RANGE = (-0.5, 0.5)


def default_segments_file() -> Path:
    """Find the package's own segments.yaml, in the sources or in an install space.

    Raises ValueError naming the places looked at.
    """
    here = Path(__file__).resolve()
    places = [here.parents[4] / "config" / _FILE]
    places += [parent / "share" / "hri_fullbody" / "config" / _FILE for parent in here.parents]
    for place in places:
        if place.is_file():
            return place
    raise ValueError("no {} of the package hri_fullbody at {} or above {}; build and source the workspace, or give the"
                     " file by the parameter `segments`".format(_FILE, places[0], here))


@dataclass(frozen=True)
class SegmentTable:
    """ratios and variations: by name of `SEGMENTS` and "ankle_height", shares of the stature and their relative
    standard deviation between people.

    head_points: by name of `HEAD_POINTS` (3,) m from the skull base at `reference_stature` (m), x out of the
    face, z to the scalp. pivot_share: height of the head's pivot above the shoulders as a share of the neck.
    log_mean (10,), log_covariance (10, 10): of the logarithms of lengths in m, in the order of `names`.
    """

    ratios: Mapping[str, float]
    variations: Mapping[str, float]
    pivot_share: float
    reference_stature: float
    head_points: Mapping[str, np.ndarray]
    log_mean: np.ndarray
    log_covariance: np.ndarray
    names: Tuple[str, ...] = STATISTICS

    @classmethod
    def load(cls, path: Optional[str] = None) -> "SegmentTable":
        """Read a table; None or "" is the package's own. Raises ValueError naming file, key and legal range."""
        file = Path(path).expanduser() if path else default_segments_file()
        try:
            content = yaml.safe_load(file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise ValueError("segment table {} cannot be read: {}".format(file, error)) from error
        return _Reader(str(file)).table(content)

    def ratio(self, name: str) -> float:
        """Share of the stature. Raises KeyError for a segment that does not exist."""
        return self.ratios[name]


class _Reader:
    """Turns the content of a file into a table; every error names file and key."""

    def __init__(self, file: str) -> None:
        self._file = file

    def table(self, content: object) -> SegmentTable:
        top = self._mapping(content, "the file", ("segments", "head", "statistics"))
        segments = self._mapping(top["segments"], "segments", SEGMENTS + ("ankle_height",))
        ratios: Dict[str, float] = {}
        variations: Dict[str, float] = {}
        for name, entry in segments.items():
            key = "segments/" + name
            row = self._mapping(entry, key, ("ratio", "cv"))
            ratios[name] = self._number(row["ratio"], key + "/ratio", _RATIO_RANGE)
            variations[name] = self._number(row["cv"], key + "/cv", _CV_RANGE)
        head = self._mapping(top["head"], "head", ("pivot_share", "reference_stature", "points"))
        points = self._mapping(head["points"], "head/points", HEAD_POINTS)
        mean, covariance = self._statistics(top["statistics"])
        return SegmentTable(
            ratios, variations,
            self._number(head["pivot_share"], "head/pivot_share", (0.0, 1.0)),
            self._number(head["reference_stature"], "head/reference_stature", (0.5, 2.5)),
            {name: self._row(value, "head/points/" + name, 3, _HEAD_POINT_RANGE) for name, value in points.items()},
            mean, covariance)

    def _statistics(self, content: object) -> Tuple[np.ndarray, np.ndarray]:
        entry = self._mapping(content, "statistics", ("names", "log_mean", "log_covariance"))
        if entry["names"] != list(STATISTICS):
            raise self._wrong("statistics/names", entry["names"], "exactly [{}]".format(", ".join(STATISTICS)))
        size = len(STATISTICS)
        mean = self._row(entry["log_mean"], "statistics/log_mean", size, (-6.0, 2.0))
        key = "statistics/log_covariance"
        rows = entry["log_covariance"]
        if not isinstance(rows, list) or len(rows) != size:
            raise self._wrong(key, rows, "{0} rows of {0} numbers".format(size))
        covariance = np.stack([
            self._row(row, "{}[{}]".format(key, index), size, (-1.0, 1.0)) for index, row in enumerate(rows)])
        if not np.allclose(covariance, covariance.T, rtol=0.0, atol=1e-9):
            raise self._wrong(key, "not symmetric", "a symmetric matrix")
        if np.linalg.eigvalsh(covariance)[0] <= 0.0:
            raise self._wrong(key, "not positive definite", "a positive definite matrix")
        return mean, covariance

    def _mapping(self, value: object, key: str, names: Sequence[str]) -> Mapping[str, object]:
        if not isinstance(value, dict):
            raise self._wrong(key, value, "a mapping with the keys " + ", ".join(names))
        missing = [name for name in names if name not in value]
        unknown = [str(name) for name in value if name not in names]
        if missing or unknown:
            raise self._wrong(key, "missing: {}; unknown: {}".format(missing, unknown),
                              "exactly the keys " + ", ".join(names))
        return value

    def _number(self, value: object, key: str, legal: Tuple[float, float]) -> float:
        if isinstance(value, (int, float)) and not isinstance(value, bool) and legal[0] <= value <= legal[1]:
            return float(value)
        raise self._wrong(key, value, "a number from {:g} to {:g}".format(*legal))

    def _row(self, value: object, key: str, size: int, legal: Tuple[float, float]) -> np.ndarray:
        if not isinstance(value, list) or len(value) != size:
            raise self._wrong(key, value, "a list of {} numbers".format(size))
        row = np.array([self._number(item, "{}[{}]".format(key, i), legal) for i, item in enumerate(value)])
        row.flags.writeable = False
        return row

    def _wrong(self, key: str, value: object, legal: str) -> ValueError:
        text = repr(value)
        if len(text) > _LONGEST_QUOTE:
            text = text[:_LONGEST_QUOTE] + " ..."
        return ValueError("segment table {}: {} is {}; legal: {}".format(self._file, key, text, legal))


# Pairs of key points; 18 and 19 are the middles of hips and ears.
_HIPS, _EARS = 18, 19
_PAIRS = np.array([
    (kp.LEFT_SHOULDER, kp.LEFT_ELBOW), (kp.RIGHT_SHOULDER, kp.RIGHT_ELBOW),
    (kp.LEFT_ELBOW, kp.LEFT_WRIST), (kp.RIGHT_ELBOW, kp.RIGHT_WRIST),
    (kp.LEFT_HIP, kp.LEFT_KNEE), (kp.RIGHT_HIP, kp.RIGHT_KNEE),
    (kp.LEFT_KNEE, kp.LEFT_ANKLE), (kp.RIGHT_KNEE, kp.RIGHT_ANKLE),
    (kp.NECK, _HIPS), (kp.LEFT_SHOULDER, kp.RIGHT_SHOULDER), (kp.LEFT_HIP, kp.RIGHT_HIP), (kp.NECK, _EARS)])
# Columns of _PAIRS that tell each of SEGMENTS, and the length as a part of the distance.
_COLUMNS = ((0, 1), (2, 3), (4, 5), (6, 7), (8,), (9,), (10,), (11,))
_FACTORS = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.5, math.nan])
# Middle of the ears above the skull base as a part of the stature: 25 mm at 1.70 m.
_EARS_ABOVE_BASE = 0.025 / 1.70
# Systematic deviations of a length seen, relative, for the stature (none) and SEGMENTS. By definition: trackers put
# joint centres at other places than anatomy; the model has to follow them, the stature must not. By posture: the
# trunk bends, the head nods. Together they are those of the comparison of trackers with motion capture.
_DEFINITION = np.array([0.0, 0.025, 0.025, 0.025, 0.025, 0.03, 0.06, 0.12, 0.0])
_POSTURE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.12])
MONOCULAR = 0.09
"""Relative standard deviation of a length that a network guesses from one colour image, see `StatureEstimator.add`."""
# Sine of the angle to the ray below which such a guess is not believed: it is mostly depth.
_FORESHORTENED = 0.6
_OUTLIER_MADS = 3.5
_LEAST_SPREAD_M = 0.004
# Successive images share their error: ten of them tell as much as one.
_CORRELATED = 10.0
_USUAL_NOISE_M, _USUAL_SAMPLES = 0.05, 5
_MOST_BIAS = 0.12
_LEAST_SAMPLES = 3
_KNOWN_VARIANCE = 0.72      # of that between people, below which a stature is told


@dataclass(frozen=True)
class StatureEstimate:
    """Stature and lengths by name (SEGMENTS) with their standard deviations, m. samples: images it rests on;
    seen: how many of the lengths were seen. known: whether the stature is more than the average of all people."""

    stature: float
    stature_sd: float
    lengths: Dict[str, float]
    lengths_sd: Dict[str, float]
    samples: int
    seen: int
    known: bool = False


class StatureEstimator:
    """Lengths of one body over the last seconds.

    window: s, how long a measured length counts. scale_sd: relative spread of size that is added to the table's
    adults where lengths are measured; 0.1 lets children be as small as they are. Raises ValueError for values that are
    not above 0.
    """

    def __init__(self, table: SegmentTable, window: float = 5.0, scale_sd: float = 0.10,
                 max_rate: float = 32.0) -> None:
        for name, value in (("window", window), ("scale_sd", scale_sd), ("max_rate", max_rate)):
            if not math.isfinite(value) or value <= 0.0:
                raise ValueError("{} is {}, it must be above 0".format(name, value))
        self._mean = np.asarray(table.log_mean, dtype=np.float64)[:9]
        covariance = np.asarray(table.log_covariance, dtype=np.float64)[:9, :9]
        self._covariance, self._scale_sd = covariance, scale_sd
        self._factors = _FACTORS.copy()
        neck = float(np.exp(self._mean[8] - self._mean[0]))
        self._factors[7] = neck / (neck + _EARS_ABOVE_BASE)
        self._window, self._period = window, 1.0 / max_rate
        self._stamps = np.zeros(int(math.ceil(window * max_rate)) + 1)
        self._distances = np.zeros((len(self._stamps), len(_PAIRS)))
        self._systematic = np.zeros(len(self._stamps))
        self.reset()

    def reset(self) -> None:
        """Forget everything that was measured."""
        self._stamps[:] = -np.inf
        self._next, self._newest = 0, -math.inf

    def add(self, points: np.ndarray, stamp: float, systematic: float = 0.0) -> None:
        """Take the key points (18, 3) m in the optical frame, NaN missing, at `stamp` (s). They should be free of
        outliers, and not filtered. A stamp that goes back forgets the past; images faster than max_rate are left out.

        systematic: relative error of the lengths that stays, of each and as much of all of them together; 0 for
        points measured in space, `MONOCULAR` for those guessed from a colour image. Segments that are seen along the
        ray are then left out, and who is small is more likely to be a wrongly scaled adult than a child.
        """
        if stamp < self._newest:
            self.reset()
        if stamp - self._newest < self._period:
            return
        more = np.empty((20, 3))
        more[:18] = points
        more[kp.NECK] = (more[kp.LEFT_SHOULDER] + more[kp.RIGHT_SHOULDER]) / 2.0
        more[_HIPS] = (more[kp.LEFT_HIP] + more[kp.RIGHT_HIP]) / 2.0
        more[_EARS] = (more[kp.LEFT_EAR] + more[kp.RIGHT_EAR]) / 2.0
        across = more[_PAIRS[:, 0]] - more[_PAIRS[:, 1]]
        self._distances[self._next] = np.sqrt(np.einsum("ij,ij->i", across, across))
        if systematic > 0.0:
            ray = (more[_PAIRS[:, 0]] + more[_PAIRS[:, 1]]) / 2.0
            along = np.einsum("ij,ij->i", across, ray) ** 2
            whole = np.einsum("ij,ij->i", across, across) * np.einsum("ij,ij->i", ray, ray)
            self._distances[self._next, along > (1.0 - _FORESHORTENED ** 2) * whole] = np.nan
        self._systematic[self._next] = systematic
        self._stamps[self._next] = self._newest = stamp
        self._next = (self._next + 1) % len(self._stamps)

    @property
    def duration(self) -> float:
        """Time between the oldest and the newest measurement that count, s; 0 without any."""
        recent = self._recent()
        return float(self._newest - self._stamps[recent].min()) if recent.any() else 0.0

    @property
    def samples(self) -> int:
        """Number of images that count."""
        return int(self._recent().sum())

    def _recent(self) -> np.ndarray:
        return self._stamps >= self._newest - self._window if math.isfinite(self._newest) else self._stamps > 0

    def estimate(self, size: Optional[Tuple[float, float]] = None) -> StatureEstimate:
        """Return the estimate of now; without any measurement that of the table.

        size: stature as a part of the average one by cues outside the body, and the standard deviation of its
        logarithm.
        """
        recent = self._recent()
        logarithms, noise = self._observed(self._distances[recent])
        seen = np.flatnonzero(np.isfinite(logarithms))
        # The person's lengths as this source of key points defines them.
        mean, covariance = self._mean, self._prior(float(self._systematic[recent].mean()) if recent.any() else 0.0)
        if len(seen):
            index = seen + 1
            variances = noise[seen] + _POSTURE[index] ** 2
            gain = np.linalg.solve(covariance[np.ix_(index, index)] + np.diag(variances), covariance[index]).T
            mean = mean + gain @ (logarithms[seen] - mean[index])
            covariance = covariance - gain @ covariance[index]
        if size is not None:
            gain = covariance[:, 0] / (covariance[0, 0] + size[1] ** 2)
            mean = mean + gain * (self._mean[0] + math.log(size[0]) - mean[0])
            covariance = covariance - np.outer(gain, covariance[0])
        values = np.exp(mean)
        spread = values * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return StatureEstimate(
            float(values[0]), float(spread[0]), dict(zip(SEGMENTS, values[1:].tolist())),
            dict(zip(SEGMENTS, spread[1:].tolist())), int(recent.sum()), len(seen),
            bool(covariance[0, 0] < _KNOWN_VARIANCE * self._covariance[0, 0]))

    def _prior(self, systematic: float) -> np.ndarray:
        """Covariance (9, 9) of the logarithms of stature and lengths as a source with this error shows them."""
        guessed = min(systematic / MONOCULAR, 1.0) ** 2
        covariance = self._covariance + (1.0 - guessed) * self._scale_sd ** 2 + np.diag(_DEFINITION ** 2)
        covariance[1:, 1:] += guessed * self._scale_sd ** 2 + systematic ** 2 * (1.0 + np.eye(len(SEGMENTS)))
        return covariance

    def _observed(self, distances: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Logarithms (8,) of the lengths seen, NaN for others, and the variances of their noise."""
        length, spread, count = (values.tolist() for values in robust_lengths(distances))
        logarithms, variances = np.full(len(SEGMENTS), np.nan), np.full(len(SEGMENTS), np.nan)
        for name, columns in enumerate(_COLUMNS):
            # Two points at one place, as of a body that is not there, are no length.
            known = [column for column in columns if count[column] >= _LEAST_SAMPLES and length[column] > 0.0]
            if not known:
                continue
            mean = sum(length[column] for column in known) / len(known)
            samples = sum(count[column] for column in known)
            apart = sum(spread[column] for column in known) / len(known)
            # The spread of a few images says little: some more with the usual noise are thought beside them.
            noise = (samples * apart ** 2 + _USUAL_SAMPLES * _USUAL_NOISE_M ** 2) / (
                (samples + _USUAL_SAMPLES) * mean ** 2)
            logarithms[name] = math.log(max(mean * self._factors[name], 0.02))
            variances[name] = noise / max(samples / _CORRELATED, 1.0)
        return logarithms, variances


def robust_lengths(distances: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length, standard deviation of one measurement, and number of measurements, of distances (T, B) m, NaN missing.

    Each is the median without outliers, less the variance over the length: noise across a bone makes it longer, by
    as much as noise along it scatters it. Returns three arrays (B,); without measurements the first two are NaN.
    """
    middle = _median(distances)
    spread = 1.4826 * _median(np.abs(distances - middle))
    near = np.abs(distances - middle) < _OUTLIER_MADS * np.maximum(spread, _LEAST_SPREAD_M)
    cleared = np.where(near, distances, np.nan)
    count = near.sum(axis=0)
    middle = _median(cleared)
    total = np.maximum(count, 1)
    mean = np.where(near, distances, 0.0).sum(axis=0) / total
    spread = np.sqrt(np.where(near, (distances - mean) ** 2, 0.0).sum(axis=0) / total)
    bias = np.minimum(spread * spread, _MOST_BIAS * middle * middle) / np.maximum(middle, 1e-6)
    return middle - bias, np.where(count > 0, spread, np.nan), count


def _median(values: np.ndarray) -> np.ndarray:
    """Median down the columns of (T, B) without the NaN; NaN where there is nothing else."""
    if not len(values):
        return np.full(values.shape[1], np.nan)
    ordered = np.sort(values, axis=0)
    count = (~np.isnan(values)).sum(axis=0)
    columns = np.arange(values.shape[1])
    low, high = ordered[np.maximum(count - 1, 0) // 2, columns], ordered[np.minimum(count // 2, len(values) - 1),
                                                                         columns]
    return np.where(count > 0, (low + high) / 2.0, np.nan)
