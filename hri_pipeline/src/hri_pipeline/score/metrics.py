"""Scores of a bag: persons, gazes and groups against the truth where the bag holds it, and what can be told without.

`score` gives all figures of a record. Below it are the metrics themselves: CLEAR-MOT, IDF1 and HOTA of tracks,
precision and recall of pairs and of groups, word errors; and `counts`, for bags whose truth is only how many people
there are and which words are said.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from typing import (
    AbstractSet,
    Any,
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
    TypeVar,
)

import numpy as np
from scipy.optimize import linear_sum_assignment

from hri_pipeline.core.geometry import iou_matrix
from hri_pipeline.score.bag import INTERACTIONS, KINDS, PERSONS, Record, TruthFrame

LATENCY = 0.1
"""A tracked list counts for stamps up to so many seconds before it came."""
SLACK = 0.3
"""Oldest place (s) that still counts, and time by which a gaze may change late in the figures `..._lenient`."""
MEMORY = 1.0
"""Time (s) for which somebody who was matched counts as known for gazes and groups, though no place comes: those are
held as well."""
_NEAR = 0.06
ANONYMOUS = "anonymous_person_"
"""Ids of people whom nobody has identified begin so; the change to a permanent id is no fault."""
_BINS = ((0.99, 1.0), (0.5, 0.99), (0.0, 0.5))

Figures = Dict[str, Any]
T = TypeVar("T")


def score(record: Record, distance: float = 0.5) -> Figures:
    """Return all figures of a record; one that cannot be told is None. distance: m, see clear_mot."""
    figures: Figures = {"duration_s": round(record.end - record.begin, 3)}
    figures.update(_persons(record))
    figures.update(_rates(record))
    figures.update(counts(record))
    figures["has_truth"] = bool(record.truth or record.true_words or any(record.counted.values()))
    if record.truth:
        frames = mot_frames(record)
        mot = clear_mot(frames, distance)
        figures.update(_mot(mot, record))
        identity = identity_scores(frames, distance)
        figures.update(idf1=identity.idf1, hota=identity.hota, deta=identity.deta, assa=identity.assa)
        figures.update(_gaze(record, mot))
        figures.update(_group_figures(record, mot))
        figures.update(_confidence(record, mot))
    figures["confidence_out_of_range"] = sum(not 0.0 <= value <= 1.0 for series in record.confidence.values() for _,
                                             value in series)
    return figures


def mot_frames(record: Record) -> List[MotFrame]:
    """Return the true and the found heads at each stamp of the truth.

    A person counts while it is tracked and has a frame.
    """
    times = [when for when, _ in record.tracked]
    frames = []
    for frame in record.truth:
        index = bisect.bisect_right(times, frame.stamp + LATENCY) - 1
        listed = record.tracked[index][1] if index >= 0 else frozenset()
        found = {}
        for person in listed:
            place = record.tracks[person].at(frame.stamp, SLACK) if person in record.tracks else None
            if place is not None:
                found[person] = place
        frames.append(MotFrame(frame.heads, found, frame.visible))
    return frames


def _persons(record: Record) -> Figures:
    minutes = max(record.end - record.begin, 1e-9) / 60.0
    ids = frozenset().union(*(ids for _, ids in record.tracked)) if record.tracked else frozenset()
    return {"persons_ids": len(ids), "persons_ids_per_minute": len(ids) / minutes,
            "persons_mean": _mean([len(ids) for _, ids in record.tracked]),
            "persons_most": max((len(ids) for _, ids in record.tracked), default=None),
            "gazes_mean": _mean([len(pairs) for _, pairs in record.gaze]),
            "groups_mean": _mean([len(groups) for _, groups in record.groups])}


def _rates(record: Record) -> Figures:
    seconds = max(record.end - record.begin, 1e-9)
    steps = np.concatenate([np.diff(track.stamps) for track in record.tracks.values() if len(track.stamps) > 1]
                           or [np.zeros(0)])
    ages = np.concatenate([np.array(track.ages) for track in record.tracks.values()] or [np.zeros(0)])
    return {"person_rate_hz": 1.0 / float(np.median(steps)) if len(steps) else None,
            "person_age_ms_p50": 1e3 * float(np.percentile(ages, 50)) if len(ages) else None,
            "person_age_ms_p95": 1e3 * float(np.percentile(ages, 95)) if len(ages) else None,
            "gaze_rate_hz": record.messages[INTERACTIONS + "gaze"] / seconds,
            "groups_rate_hz": record.messages[INTERACTIONS + "groups"] / seconds,
            "tracked_rate_hz": record.messages[PERSONS + "tracked"] / seconds,
            "foreign_frames": record.foreign_frames, "damaged_messages": record.damaged}


def permanent_switches(mot: MotScores) -> int:
    """Count how often a true person had another permanent id than the last permanent one."""
    last: Dict[str, str] = {}
    switches = 0
    for pairs in mot.pairs:
        for found, true in pairs.items():
            if not found.startswith(ANONYMOUS):
                switches += last.get(true, found) != found
                last[true] = found
    return switches


def _mot(mot: MotScores, record: Record) -> Figures:
    hours = max(record.end - record.begin, 1e-9) / 3600.0
    return {"mota": mot.mota, "motp_m": mot.distance, "persons_true": mot.persons_true, "persons_found": mot.persons,
            "id_switches": mot.switches, "id_switches_per_hour": mot.switches / hours,
            "id_switches_permanent": permanent_switches(mot), "fragments": mot.fragments,
            "misses": mot.misses, "false_positives": mot.false_positives, "matches": mot.matches,
            "true_places": mot.truths}


def _aligned(series: Sequence[Tuple[float, T]], truth: Sequence[TruthFrame]) -> List[Tuple[int, T]]:
    """(number of the truth's frame nearest in time, value) of each item that has one close enough; each frame once."""
    stamps = [frame.stamp for frame in truth]
    found: Dict[int, Tuple[float, T]] = {}
    for when, value in series:
        index = bisect.bisect_left(stamps, when)
        near = min((number for number in (index - 1, index) if 0 <= number < len(stamps)),
                   key=lambda n: abs(stamps[n] - when))
        apart = abs(stamps[near] - when)
        if apart <= _NEAR and (near not in found or apart < found[near][0]):
            found[near] = (apart, value)
    return [(number, value) for number, (_, value) in sorted(found.items())]


def known_people(mot: MotScores, truth: Sequence[TruthFrame]) -> List[Dict[str, str]]:
    """For each frame, true id by found id of all who were matched in the last MEMORY s."""
    recent: Dict[str, Tuple[float, str]] = {}
    names = []
    for frame, pairs in zip(truth, mot.pairs):
        recent.update((found, (frame.stamp, true)) for found, true in pairs.items())
        recent = {found: (when, true) for found, (when, true) in recent.items() if frame.stamp - when <= MEMORY}
        names.append({found: true for found, (_, true) in recent.items()})
    return names


def _true_ids(ids: Sequence[str], names: Mapping[str, str]) -> Tuple[str, ...]:
    """Ids of the truth; the robot stays the robot, and somebody whom the truth does not know gets an id of its own."""
    return tuple("" if found == "" else names.get(found, "?" + found) for found in ids)


def _gaze(record: Record, mot: MotScores) -> Figures:
    """Gaze pairs, of people who are tracked: who is not tracked cannot be said to look."""
    found, truth = [], []
    people = known_people(mot, record.truth)
    for number, pairs in _aligned(record.gaze, record.truth):
        names = people[number]
        known = frozenset(names.values()) | {""}
        found.append(frozenset(_true_ids(pair, names) for pair in pairs))
        truth.append(frozenset(pair for pair in record.truth[number].gaze if set(pair) <= known))
    if not found:
        return dict.fromkeys(("gaze_precision", "gaze_recall", "gaze_precision_lenient", "gaze_recall_lenient",
                              "gaze_frames"))
    step = float(np.median(np.diff([frame.stamp for frame in record.truth]))) if len(record.truth) > 1 else 1.0
    strict, lenient = pair_scores(found, truth), pair_scores(found, truth, max(1, round(SLACK / max(step, 1e-3))))
    return {"gaze_precision": strict.precision, "gaze_recall": strict.recall,
            "gaze_precision_lenient": lenient.precision, "gaze_recall_lenient": lenient.recall,
            "gaze_frames": len(found)}


def _group_figures(record: Record, mot: MotScores) -> Figures:
    found, truth = [], []
    people = known_people(mot, record.truth)
    for number, groups in _aligned(record.groups, record.truth):
        names = people[number]
        known = frozenset(names.values()) | {""}
        found.append([frozenset(_true_ids(tuple(group), names)) for group in groups])
        truth.append([group & known for group in record.truth[number].groups])
    if not found:
        return dict.fromkeys(("groups_precision", "groups_recall", "groups_f1", "groups_frames"))
    scores = group_scores(found, truth)
    return {"groups_precision": scores.precision, "groups_recall": scores.recall, "groups_f1": scores.f1,
            "groups_frames": scores.frames}


def _confidence(record: Record, mot: MotScores) -> Figures:
    """Median error (m) of the places by location confidence: the less confident, the larger it should be."""
    whose: Dict[str, str] = {}
    errors: Dict[Tuple[float, float], List[float]] = {limits: [] for limits in _BINS}
    for number, frame in enumerate(record.truth):
        whose.update(mot.pairs[number])
        for person, series in record.confidence.items():
            true, track = whose.get(person), record.tracks.get(person)
            index = bisect.bisect_right([when for when, _ in series], frame.stamp + LATENCY) - 1
            if true not in frame.heads or track is None or index < 0:
                continue
            place = track.at(frame.stamp, SLACK)
            limits = next((limits for limits in _BINS if limits[0] <= series[index][1] <= limits[1]), None)
            if place is not None and limits is not None and series[index][1] > 0.0:
                errors[limits].append(float(np.linalg.norm(np.subtract(place, frame.heads[true]))))
    return {"confidence_errors_m": [{"from": low, "to": high, "places": len(errors[low, high]),
                                     "median_error_m": float(np.median(errors[low, high])) if errors[low, high]
                                     else None}
                                    for low, high in _BINS]}


def _mean(values: Sequence[float]) -> Optional[float]:
    return float(np.mean(values)) if len(values) else None


SETTLE = 0.5
"""Part of the time from one change of the truth to the next that is left out: trackers take time for who comes and
goes."""
SERIES = Sequence[Tuple[float, frozenset]]


def counts(record: Record) -> Dict[str, object]:
    """Return figures of faces, bodies, voices and words; without their truth, the numbers of ids alone."""
    figures: Dict[str, object] = {}
    for kind in KINDS:
        listed, true = record.listed.get(kind, []), record.counted.get(kind, [])
        figures[kind + "_ids"] = len(frozenset().union(*(ids for _, ids in listed))) if listed else None
        figures.update(_missed(kind, listed, true, record.end))
    if record.true_words:
        figures.update(_words(record))
    return figures


def _missed(kind: str, listed: SERIES, true: SERIES, end: float) -> Dict[str, object]:
    """Sums, over the stretches in which the truth does not change, of how many too few and too many there were in most
    of its last part."""
    if not true:
        return {}
    missed = extra = there = 0
    for begin, stop, count in _stretches(true, end):
        found = _usual(listed, begin + SETTLE * (stop - begin), stop)
        there += count
        missed += max(0, count - found)
        extra += max(0, found - count)
    return {kind + "_true": there, kind + "_missed": missed, kind + "_extra": extra}


def _stretches(true: SERIES, end: float) -> List[Tuple[float, float, int]]:
    """(begin, end, how many) of each time in which the true ids stay the same."""
    found: List[Tuple[float, float, int]] = []
    begin, ids = true[0]
    for when, now in [*true[1:], (end, None)]:
        if now != ids:
            found.append((begin, when, len(ids)))
            begin, ids = when, now
    return found


def _usual(listed: SERIES, begin: float, end: float) -> int:
    """How many were listed for most of a time."""
    held: Dict[int, float] = {}
    times = [when for when, _ in listed]
    index = bisect.bisect_right(times, begin) - 1
    when = begin
    while when < end:
        later = times[index + 1] if index + 1 < len(times) else end
        number = len(listed[index][1]) if index >= 0 else 0
        held[number] = held.get(number, 0.0) + min(later, end) - when
        when, index = min(later, end), index + 1
    return max(held, key=lambda number: held[number]) if held else 0


def _words(record: Record) -> Dict[str, Optional[object]]:
    true = " ".join(record.true_words).split()
    heard = " ".join(text for _, text in sorted(item for texts in record.said.values() for item in texts)).split()
    errors = word_errors(true, heard)
    return {"sentences_true": len(record.true_words),
            "sentences_heard": sum(bool(text) for texts in record.said.values() for _, text in texts),
            "words_true": len(true), "words_heard": len(heard), "word_errors": errors,
            "word_error_rate": errors / len(true) if true else None}


TWO_THIRDS = 2.0 / 3.0
"""Tolerance T with which groups are mostly compared (Setti et al., PLoS ONE 10(5), 2015, section "Evaluation
metrics")."""

Members = AbstractSet[Hashable]


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
