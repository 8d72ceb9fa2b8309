"""The proportions of the human body, read from config/segments.yaml and checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Mapping, Optional, Sequence, Tuple

import numpy as np
import yaml

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
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or not legal[0] <= value <= legal[1]:
            raise self._wrong(key, value, "a number from {:g} to {:g}".format(*legal))
        return float(value)

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
