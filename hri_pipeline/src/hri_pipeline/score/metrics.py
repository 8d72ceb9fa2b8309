"""Metrics: CLEAR-MOT, IDF1 and HOTA of tracks, precision and recall of pairs and of groups, word errors;
and golden figures: what a recording has to score at least, from a YAML file, and the comparison with what it scores."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import (
    AbstractSet,
    Callable,
    Dict,
    FrozenSet,
    Hashable,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
    Union,
)

import numpy as np
import yaml
from scipy.optimize import linear_sum_assignment

from hri_pipeline.core.geometry import iou_matrix

TWO_THIRDS = 2.0 / 3.0
"""Tolerance T with which groups are mostly compared (Setti et al., PLoS ONE 10(5), 2015, section "Evaluation
metrics")."""

Members = AbstractSet[Hashable]
HIGHER, LOWER, SAME, TOLD = "higher", "lower", "same", "told"
WORSE, BETTER, AS_GOOD, MISSING = "WORSE", "better", "ok", "MISSING"
_KEYS = {"value", "better", "tolerance"}


@dataclass(frozen=True)
class GroupScores:
    """Precision and recall (0 to 1), each the mean over the frames; f1 is the harmonic mean of these two means."""

    precision: float
    recall: float
    frames: int

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall, 0 where both are 0."""
        total = self.precision + self.recall
        return 2.0 * self.precision * self.recall / total if total > 0.0 else 0.0


def group_scores(found: Sequence[Iterable[Members]], truth: Sequence[Iterable[Members]],
                 tolerance: float = TWO_THIRDS) -> GroupScores:
    """Compare the groups of each frame with the true ones.

    found, truth: one entry per frame, in the same order, each the member sets of all groups; sets of less than two do
    not count. A group G and a true one H agree when at least `tolerance` of the larger of the two is shared, |G & H| /
    max(|G|, |H|) >= T: the cardinality criterion of Setti et al. (PLoS ONE 10(5), 2015) in the form of Vascon et al.
    (ACCV 2014); T = 1 asks for the very same members. A group agrees with one at most where T > 1/2. A frame where
    nothing is found and nothing is true has precision and recall 1; where only one of both is empty, the one that
    divides by zero is 1 and the other 0. Raises ValueError when the lengths differ, there is no frame, or T is not in
    (0, 1].
    """
    if len(found) != len(truth):
        raise ValueError("{} frames found and {} of truth".format(len(found), len(truth)))
    if not len(truth):
        raise ValueError("there is no frame to compare")
    if not 0.0 < tolerance <= 1.0:
        raise ValueError("the tolerance T is {}, legal range above 0 to 1".format(tolerance))
    precisions, recalls = [], []
    for ours, theirs in zip(found, truth):
        precision, recall = _frame(_groups(ours), _groups(theirs), tolerance)
        precisions.append(precision)
        recalls.append(recall)
    return GroupScores(sum(precisions) / len(truth), sum(recalls) / len(truth), len(truth))


def _groups(members: Iterable[Members]) -> List[FrozenSet[Hashable]]:
    return [frozenset(group) for group in members if len(frozenset(group)) > 1]


def _frame(found: Sequence[FrozenSet[Hashable]], truth: Sequence[FrozenSet[Hashable]],
           tolerance: float) -> Tuple[float, float]:
    if not found or not truth:
        return (0.0 if found else 1.0), (0.0 if truth else 1.0)
    right = sum(any(len(group & other) >= tolerance * max(len(group), len(other)) - 1e-9 for other in found)
                for group in truth)
    return right / len(found), right / len(truth)


@dataclass(frozen=True)
class PairScores:
    """Counts of pairs over all frames: right, wrong (found, not true), missed (true, not found)."""

    right: int
    wrong: int
    missed: int

    @property
    def precision(self) -> Optional[float]:
        """Share of the pairs found that are true; None where nothing was found."""
        return self.right / (self.right + self.wrong) if self.right + self.wrong else None

    @property
    def recall(self) -> Optional[float]:
        """Share of the true pairs that were found; None where there was none."""
        return self.right / (self.right + self.missed) if self.right + self.missed else None

    @property
    def f1(self) -> Optional[float]:
        """Harmonic mean of precision and recall; None where nothing was found and nothing true."""
        total = 2 * self.right + self.wrong + self.missed
        return 2.0 * self.right / total if total else None


def pair_scores(found: Sequence[AbstractSet[Hashable]], truth: Sequence[AbstractSet[Hashable]],
                slack: int = 0) -> PairScores:
    """Compare pairs, such as (sender, receiver) of gazes, frame by frame.

    slack: number of frames by which a change may come early or late: a pair is right when it is true in any frame not
    farther away, and missed only when it is true in all of them. Raises ValueError for different lengths.
    """
    if len(found) != len(truth):
        raise ValueError("{} frames found and {} of truth".format(len(found), len(truth)))
    right = wrong = missed = 0
    for index, pairs in enumerate(found):
        around = truth[max(0, index - slack):index + slack + 1]
        ever = frozenset().union(*around)
        always = frozenset(around[0]).intersection(*around[1:])
        right += len(pairs & ever)
        wrong += len(pairs - ever)
        missed += len(always - pairs)
    return PairScores(right, wrong, missed)


Place = Sequence[float]
Apart = Callable[[Place, Place], float]


class MotFrame(NamedTuple):
    """One moment. truth, found: places (m, any number of axes) by id. required: the true ids that have to be found;
    None: all."""

    truth: Mapping[str, Place]
    found: Mapping[str, Place]
    required: Optional[AbstractSet[str]] = None


@dataclass(frozen=True)
class MotScores:
    """CLEAR-MOT. truths: true places that had to be found, of all frames. distance: mean of all matches, m; None
    without any.

    persons: true ids that were ever found, of `persons_true` that had to be. pairs: for each frame, found id -> true
    id.
    """

    truths: int
    matches: int
    misses: int
    false_positives: int
    switches: int
    fragments: int
    distance: Optional[float]
    persons: int
    persons_true: int
    pairs: Tuple[Dict[str, str], ...]

    @property
    def mota(self) -> Optional[float]:
        """Accuracy: 1 less misses, false positives and switches per true place; None without any. May be below 0."""
        wrong = self.misses + self.false_positives + self.switches
        return 1.0 - wrong / self.truths if self.truths else None


def clear_mot(frames: Iterable[MotFrame], distance: float = 0.5, apart: Optional[Apart] = None) -> MotScores:
    """Compare found with true places: CLEAR-MOT (Bernardin and Stiefelhagen, EURASIP J. Image and Video Processing
    2008).

    A pair that was matched in the frame before stays so while it is not farther apart than `distance` (m); the rest is
    matched with the least total distance. A switch: a true id is matched with another found id than the last time. A
    fragment: a true id that was matched and lost, is matched again. A found place next to somebody who need not be
    found is no false positive. apart: another measure of how far two places are from each other, in the unit of
    `distance`, such as `box_distance`. Raises ValueError for a distance that is not positive.
    """
    apart = apart or _apart
    if not distance > 0.0:
        raise ValueError("the distance is {} m, legal range above 0".format(distance))
    last: Dict[str, str] = {}
    before: Dict[str, str] = {}
    lost: set = set()
    ever: set = set()
    wanted: set = set()
    pairs: List[Dict[str, str]] = []
    counts = dict.fromkeys(("truths", "matches", "misses", "false_positives", "switches", "fragments"), 0)
    total = 0.0
    for frame in frames:
        required = set(frame.truth) if frame.required is None else set(frame.required) & set(frame.truth)
        matched = _matched(frame, before, distance, apart)
        for true, found in matched.items():
            total += apart(frame.truth[true], frame.found[found])
            counts["switches"] += true in last and last[true] != found
            counts["fragments"] += true in lost
            last[true] = found
        lost = (lost | (set(before) & required)) - set(matched)
        counts["truths"] += len(required | set(matched))
        counts["matches"] += len(matched)
        counts["misses"] += len(required - set(matched))
        counts["false_positives"] += len(frame.found) - len(matched)
        ever |= set(matched)
        wanted |= required
        before = matched
        pairs.append({found: true for true, found in matched.items()})
    mean = total / counts["matches"] if counts["matches"] else None
    return MotScores(distance=mean, persons=len(ever & wanted), persons_true=len(wanted), pairs=tuple(pairs), **counts)


def _matched(frame: MotFrame, before: Mapping[str, str], distance: float, apart: Apart) -> Dict[str, str]:
    """True id -> found id of one frame."""
    matched = {true: found for true, found in before.items() if true in frame.truth and found in frame.found
               and apart(frame.truth[true], frame.found[found]) <= distance}
    truths = [true for true in frame.truth if true not in matched]
    taken = set(matched.values())
    founds = [found for found in frame.found if found not in taken]
    if truths and founds:
        cost = np.array([[apart(frame.truth[true], frame.found[found]) for found in founds] for true in truths])
        rows, columns = linear_sum_assignment(np.where(cost <= distance, cost, 1e6))
        matched.update((truths[row], founds[column]) for row,
                       column in zip(rows, columns) if cost[row, column] <= distance)
    return matched


def _apart(first: Place, second: Place) -> float:
    return float(np.linalg.norm(np.subtract(first, second)))


def box_distance(first: Place, second: Place) -> float:
    """Return 1 less the intersection over union of two boxes x0, y0, x1, y1, px: 0 to 1."""
    return 1.0 - float(iou_matrix(np.array([first], dtype=np.float64), np.array([second], dtype=np.float64))[0, 0])


@dataclass(frozen=True)
class IdentityScores:
    """How well ids are kept over the whole time, 0 to 1; None where there is nothing to compare.

    idf1: share of the places, true and found, that the best one-to-one pairing of ids makes agree. hota: geometric
    mean of detection (deta) and association (assa), averaged over thresholds of the similarity.
    """

    idf1: Optional[float]
    hota: Optional[float]
    deta: Optional[float]
    assa: Optional[float]


_ALPHAS = np.arange(0.05, 0.99, 0.05)
_HALF = 0.5
_TINY = 1e-9


def identity_scores(frames: Iterable[MotFrame], distance: float = 0.5,
                    apart: Optional[Apart] = None) -> IdentityScores:
    """Compare ids over the whole time: IDF1 and HOTA.

    IDF1: E. Ristani et al., "Performance Measures and a Data Set for Multi-Target, Multi-Camera Tracking", ECCV
    workshops 2016, with pairs not farther apart than `distance`. HOTA: J. Luiten et al., "HOTA: A Higher Order Metric
    for Evaluating Multi-Object Tracking", IJCV 129, 2021, with the similarity 1 - apart / (2 distance), not below 0:
    its middle threshold is `distance`, and with `box_distance` and 0.5 it is the intersection over union. Who need not
    be found, and what is found there, is left out first, as MOTChallenge does with distractors. Raises ValueError for a
    distance that is not positive.
    """
    if not distance > 0.0:
        raise ValueError("the distance is {} m, legal range above 0".format(distance))
    trues: Dict[str, int] = {}
    founds: Dict[str, int] = {}
    steps = []
    for frame in (required_only(frame, distance, apart) for frame in frames):
        steps.append((np.array([trues.setdefault(name, len(trues)) for name in frame.truth], dtype=int),
                      np.array([founds.setdefault(name, len(founds)) for name in frame.found], dtype=int),
                      _similarity(frame, distance, apart)))
    true_count = np.bincount(np.concatenate([rows for rows, _, _ in steps] or [[]]).astype(int), minlength=len(trues))
    found_count = np.bincount(np.concatenate([columns for _, columns, _ in steps] or [[]]).astype(int),
                              minlength=len(founds))
    if not trues and not founds:
        return IdentityScores(None, None, None, None)
    together = np.zeros((len(trues), len(founds)))
    for rows, columns, alike in steps:
        together[np.ix_(rows, columns)] += alike >= _HALF - _TINY
    best = together[linear_sum_assignment(-together)].sum()
    idf1 = 2.0 * float(best) / float(true_count.sum() + found_count.sum())
    return IdentityScores(idf1, *_hota(steps, true_count, found_count))


Step = Tuple[np.ndarray, np.ndarray, np.ndarray]


def required_only(frame: MotFrame, distance: float = 0.5, apart: Optional[Apart] = None) -> MotFrame:
    """Return a frame without those who need not be found, and without what is found nearer to them than to others."""
    if frame.required is None:
        return frame
    true, found, alike = list(frame.truth), list(frame.found), _similarity(frame, distance, apart)
    rows, columns = linear_sum_assignment(-np.where(alike >= _HALF - _TINY, alike, 0.0))
    beside = {found[column] for row, column in zip(rows, columns)
              if true[row] not in frame.required and alike[row, column] >= _HALF - _TINY}
    return MotFrame({name: place for name, place in frame.truth.items() if name in frame.required},
                    {name: place for name, place in frame.found.items() if name not in beside})


def _similarity(frame: MotFrame, distance: float, apart: Optional[Apart]) -> np.ndarray:
    """Similarities (T, F), 0 to 1, of the places of a frame; 0.5 at `distance`."""
    measure = apart or _apart
    return np.array([[max(0.0, 1.0 - measure(true, found) / (2.0 * distance)) for found in frame.found.values()]
                     for true in frame.truth.values()]).reshape(len(frame.truth), len(frame.found))


def _hota(steps: Sequence[Step], true_count: np.ndarray, found_count: np.ndarray) -> Tuple[float, float, float]:
    """HOTA, DetA and AssA: means over the thresholds. In each frame the pairs are those whose ids go together best
    over the whole time (equation 12 and section 5 of the article), of these the more similar ones."""
    overlap = np.zeros((len(true_count), len(found_count)))
    for rows, columns, alike in steps:
        either = alike.sum(axis=1, keepdims=True) + alike.sum(axis=0, keepdims=True) - alike
        overlap[np.ix_(rows, columns)] += np.divide(alike, either, out=np.zeros_like(alike), where=either > _TINY)
    total = true_count[:, None] + found_count[None, :]
    global_alike = overlap / np.maximum(total - overlap, _TINY)
    matches = np.zeros((len(_ALPHAS),) + overlap.shape)
    for rows, columns, alike in steps:
        chosen = linear_sum_assignment(-global_alike[np.ix_(rows, columns)] * alike)
        matches[:, rows[chosen[0]], columns[chosen[1]]] += alike[chosen] >= _ALPHAS[:, None] - _TINY
    hits = matches.sum(axis=(1, 2))
    detection = hits / np.maximum(true_count.sum() + found_count.sum() - hits, 1)
    association = (matches * matches / np.maximum(total - matches, 1)).sum(axis=(1, 2)) / np.maximum(hits, 1)
    return (float(np.sqrt(detection * association).mean()), float(detection.mean()), float(association.mean()))


def word_errors(said: Sequence[str], recognised: Sequence[str]) -> int:
    """Return the least number of substitutions, omissions and insertions between two sentences (Levenshtein 1966)."""
    row = list(range(len(recognised) + 1))
    for count, word in enumerate(said, 1):
        last, row = row, [count]
        for place, other in enumerate(recognised):
            row.append(min(last[place] + (word != other), last[place + 1] + 1, row[place] + 1))
    return row[-1]


class GoldenError(ValueError):
    """A file of golden figures that is not to be used; the text names file, figure and what is legal."""


@dataclass(frozen=True)
class Golden:
    """One figure. value: as it was. better: higher, lower or same is good; told: shown and never wrong.

    tolerance: by how much it may be worse, in the figure's unit, because no two runs are the same.
    """

    key: str
    value: float
    better: str
    tolerance: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """A figure, what it is now (None: there is none), and the verdict: ok, better, WORSE, MISSING or told."""

    golden: Golden
    value: Optional[float]
    verdict: str

    @property
    def failed(self) -> bool:
        """Whether the recording scores worse than it has to."""
        return self.verdict in (WORSE, MISSING)


def load_golden(path: Union[str, Path], section: str = "") -> List[Golden]:
    """Read the golden figures of a section; empty: of the only one. Raises GoldenError."""
    file = Path(path).expanduser()
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise GoldenError("{}: {}".format(file, " ".join(str(error).split()))) from error
    if not isinstance(content, dict) or not content:
        raise GoldenError("{}: a mapping of sections is needed".format(file))
    if not section and len(content) == 1:
        section = str(next(iter(content)))
    if section not in content:
        raise GoldenError("{}: {}; sections: {}".format(
            file, "there is no section {!r}".format(section) if section else "name a section",
            ", ".join(map(str, content))))
    rows = content[section]
    if not isinstance(rows, dict) or not rows:
        raise GoldenError("{}, {}: a mapping of figures is needed".format(file, section))
    return [_golden("{}, {}".format(file, section), str(key), row) for key, row in rows.items()]


def compare(figures: Mapping[str, object], golden: Sequence[Golden]) -> List[Outcome]:
    """Compare figures with golden ones.

    A list or mapping in the figures is named with dots: confidence_errors_m.0.places.
    """
    flat = _flat(figures)
    return [_outcome(wanted, flat.get(wanted.key)) for wanted in golden]


def comparison_table(outcomes: Sequence[Outcome]) -> str:
    """Return the comparison as lines of text."""
    lines = ["{:40} {:>9}  {:>9}  {:>9}  {:8} {}".format("figure", "golden", "tolerance", "now", "verdict",
                                                         "better is")]
    lines += ["{:40} {:>9.4g}  {:>9}  {:>9}  {:8} {}".format(
        one.golden.key, one.golden.value, "-" if one.verdict == TOLD else "{:.4g}".format(one.golden.tolerance),
        "-" if one.value is None else "{:.4g}".format(one.value), one.verdict, one.golden.better) for one in outcomes]
    failed, better = sum(one.failed for one in outcomes), [one.golden.key for one in outcomes if one.verdict == BETTER]
    lines.append("{} of {} figures are worse than they have to be.".format(failed, len(outcomes)) if failed
                 else "No figure is worse than it has to be.")
    if better:
        lines.append("Better, so that the golden figure may be raised: " + ", ".join(better))
    return "\n".join(lines)


def _golden(where: str, key: str, row: object) -> Golden:
    if not isinstance(row, dict) or set(row) - _KEYS or not {"value", "better"} <= set(row):
        raise GoldenError(
            "{}, {}: value and better are needed, tolerance may be given, and nothing else".format(where, key)
        )
    if row["better"] not in (HIGHER, LOWER, SAME, TOLD):
        raise GoldenError("{}, {}: better is {!r}, legal: higher, lower, same, told".format(where, key, row["better"]))
    for name in ("value", "tolerance"):
        value = row.get(name, 0.0)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise GoldenError("{}, {}: {} is {!r}, a finite number is needed".format(where, key, name, value))
    if row.get("tolerance", 0.0) < 0.0:
        raise GoldenError("{}, {}: tolerance is {:g}, legal from 0".format(where, key, row["tolerance"]))
    return Golden(key, float(row["value"]), row["better"], float(row.get("tolerance", 0.0)))


def _outcome(golden: Golden, value: Optional[float]) -> Outcome:
    if golden.better == TOLD:
        return Outcome(golden, value, TOLD)
    if value is None:
        return Outcome(golden, None, MISSING)
    gain = value - golden.value if golden.better == HIGHER else golden.value - value
    if golden.better == SAME:
        gain = -abs(gain)
    slack = golden.tolerance + 1e-9 * max(1.0, abs(golden.value))
    return Outcome(golden, value, WORSE if gain < -slack else BETTER if gain > slack else AS_GOOD)


def _flat(figures: object, prefix: str = "") -> Dict[str, float]:
    """Numbers of nested mappings and lists by their dotted names; what is no finite number is left out."""
    if isinstance(figures, (bool, int, float)):
        return {prefix: float(figures)} if math.isfinite(figures) else {}
    items = (
        figures.items()
        if isinstance(figures, Mapping)
        else enumerate(figures) if isinstance(figures, (list, tuple)) else ()
    )
    found: Dict[str, float] = {}
    for key, value in items:
        found.update(_flat(value, "{}.{}".format(prefix, key) if prefix else str(key)))
    return found
