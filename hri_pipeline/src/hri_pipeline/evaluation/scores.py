"""Scores of tracks, gazes and groups against the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import (
    AbstractSet,
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
)

import numpy as np
from scipy.optimize import linear_sum_assignment

TWO_THIRDS = 2.0 / 3.0
"""Tolerance T with which groups are mostly compared (Setti et al., PLoS ONE 10(5), 2015, section "Evaluation metrics")."""

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

    found, truth: one entry per frame, in the same order, each the member sets of all groups; sets of less than two do not
    count. A group G and a true one H agree when at least `tolerance` of the larger of the two is shared,
    |G & H| / max(|G|, |H|) >= T: the cardinality criterion of Setti et al. (PLoS ONE 10(5), 2015) in the form of
    Vascon et al. (ACCV 2014); T = 1 asks for the very same members. A group agrees with one at most where T > 1/2.
    A frame where nothing is found and nothing is true has precision and recall 1; where only one of both is empty, the
    one that divides by zero is 1 and the other 0.
    Raises ValueError when the lengths differ, there is no frame, or T is not in (0, 1].
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


def _frame(found: Sequence[FrozenSet[Hashable]], truth: Sequence[FrozenSet[Hashable]], tolerance: float) -> Tuple[float, float]:
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


def pair_scores(found: Sequence[AbstractSet[Hashable]], truth: Sequence[AbstractSet[Hashable]], slack: int = 0) -> PairScores:
    """Compare pairs, such as (sender, receiver) of gazes, frame by frame.

    slack: number of frames by which a change may come early or late: a pair is right when it is true in any frame not farther
    away, and missed only when it is true in all of them. Raises ValueError for different lengths.
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


class MotFrame(NamedTuple):
    """One moment. truth, found: places (m, any number of axes) by id. required: the true ids that have to be found; None: all."""

    truth: Mapping[str, Place]
    found: Mapping[str, Place]
    required: Optional[AbstractSet[str]] = None


@dataclass(frozen=True)
class MotScores:
    """CLEAR-MOT. truths: true places that had to be found, of all frames. distance: mean of all matches, m; None without any.

    persons: true ids that were ever found, of `persons_true` that had to be. pairs: for each frame, found id -> true id.
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


def clear_mot(frames: Iterable[MotFrame], distance: float = 0.5) -> MotScores:
    """Compare found with true places: CLEAR-MOT (Bernardin and Stiefelhagen, EURASIP J. Image and Video Processing 2008).

    A pair that was matched in the frame before stays so while it is not farther apart than `distance` (m); the rest is matched
    with the least total distance. A switch: a true id is matched with another found id than the last time. A fragment: a true
    id that was matched and lost, is matched again. A found place next to somebody who need not be found is no false positive.
    Raises ValueError for a distance that is not positive.
    """
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
        matched = _matched(frame, before, distance)
        for true, found in matched.items():
            total += _apart(frame.truth[true], frame.found[found])
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


def _matched(frame: MotFrame, before: Mapping[str, str], distance: float) -> Dict[str, str]:
    """True id -> found id of one frame."""
    matched = {true: found for true, found in before.items() if true in frame.truth and found in frame.found
               and _apart(frame.truth[true], frame.found[found]) <= distance}
    truths = [true for true in frame.truth if true not in matched]
    taken = set(matched.values())
    founds = [found for found in frame.found if found not in taken]
    if truths and founds:
        cost = np.array([[_apart(frame.truth[true], frame.found[found]) for found in founds] for true in truths])
        rows, columns = linear_sum_assignment(np.where(cost <= distance, cost, 1e6))
        matched.update((truths[row], founds[column]) for row, column in zip(rows, columns) if cost[row, column] <= distance)
    return matched


def _apart(first: Place, second: Place) -> float:
    return float(np.linalg.norm(np.subtract(first, second)))
