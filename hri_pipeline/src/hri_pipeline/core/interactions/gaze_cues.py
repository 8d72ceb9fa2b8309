"""How likely each look is, judged by what the last seconds have shown beside the belief of the filter.

The filter takes one image after the other by fixed variances. Small decision trees see its belief together with how far
eyes and head have been beside each target over several times, on which side of the trunk, who speaks and who looks
back. A second pass sees also what the first one said: of the same look over the last seconds, of its rivals, and of the
looks of others; and how far each person is known to turn the head. The odds are the mean of both. The trees were grown
by `scripts/benchmarks/gaze_training.py` in a simulated world whose errors and habits are drawn anew for each scene, and
stand as numbers in `gaze_trees.py`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Dict, List, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.interactions.gaze_trees import LEVELS, SECOND_START, SECOND_TREES, START, TREES
from hri_pipeline.core.interactions.head_habits import HeadHabits, rivals
from hri_pipeline.core.interactions.people import PeopleSnapshot

if TYPE_CHECKING:
    from hri_pipeline.core.interactions.gaze import SightLines

TIMES = (0.4, 1.0, 2.5)
"""Time constants (s) of the means of where eyes and head were."""
_SPEECH_TIMES = (0.3, 1.5)
LEAST_BELIEF = 0.02
"""Targets less likely than this to the filter are not judged again."""
_MISSED_S = 0.5
"""Who had a face (and, for the first pass, a trunk) a moment (s) ago is judged as somebody with it."""
_FIRST_TIMES = (0.4, 1.5, 8.0)
"""Time constants (s) of the means of what the first pass said."""
_LEAST_CHANCE = 1e-4
_EYES_S = 2.0
"""Of whom no eyes have been seen for longer (s), the first pass has the last word: the second knows nobody whose
detector measures no eyes."""
_NOW = ("now", *TIMES)
CUES = ("belief", "rival", "nobody", "robot", "distance", "range", "spread", "aside", "above", "head_aside", "trunk",
        *("{}_{}".format(name, time) for name in ("off", "eyes_to_side", "eyes_up", "head_to_side", "head_up")
          for time in _NOW),
        "looks_back", "heard", "heard_long", "speaks", "grouped", "in_group", "face_missing", "eyes_missing")
"""Names of what is known of each look, in the order of the columns; NaN where it is not known."""
SECOND_CUES = (*CUES, "trunk_missing", "unheard", "eyes_sd", "first", "first_rival",
               *("first_{}".format(time) for time in _FIRST_TIMES), "first_back", "first_joint", "first_sum",
               "habit_now", "habit_0.4", "habit_1.0", "share", "habit_rival")
"""Those of the second pass: also for how long (s) there has been no trunk, whether nobody listens, the deviation (rad)
of the eyes; how likely the look, the likeliest other one of the observer, the look back, all others at this target and
all of the observer are to the first pass; and those of HeadHabits."""
_AT = {name: number for number, name in enumerate(CUES)}
_OFF, _TO_SIDE, _UP, _HEAD_TO_SIDE, _HEAD_UP = (slice(_AT[name + "_now"], _AT[name + "_now"] + len(_NOW)) for name in (
    "off", "eyes_to_side", "eyes_up", "head_to_side", "head_up"))
_HEARD = slice(_AT["heard"], _AT["heard"] + len(_SPEECH_TIMES))


def turns(units: np.ndarray, directions: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Return by how much (rad) units (N, T, 3) are left of and above directions (N, 3), each (N, T)."""
    bearings = np.arctan2(units[..., 1], units[..., 0]) - np.arctan2(directions[:, 1], directions[:, 0])[:, None]
    bearings -= 2.0 * math.pi * np.rint(bearings / (2.0 * math.pi))
    heights = _height(units[..., 2]) - _height(directions[:, 2])[:, None]
    return bearings * np.hypot(units[..., 0], units[..., 1]), heights


def _height(sines: np.ndarray) -> np.ndarray:
    return np.arcsin(np.minimum(np.maximum(sines, -1.0), 1.0))


class GazeCues:
    """Follows what the last seconds have shown of each look."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._ids: List[str] = []
        self._means = np.full((len(TIMES), 0, 1, 4), np.nan)
        self._now = self._means[0]
        self._firsts = np.full((len(_FIRST_TIMES), 0, 1), np.nan)
        self._habits = HeadHabits()
        self._speech = np.zeros((len(_SPEECH_TIMES), 1))
        self._face_at, self._eyes_at, self._trunk_at = np.zeros(0), np.zeros(0), np.zeros(0)

    def update(self, people: PeopleSnapshot, lines: "SightLines", stamp: float, dt: float) -> None:
        """Take one image; stamp, dt: its time and that since the last one (s)."""
        self._follow(people.ids)
        self._now = np.empty((*lines.distances.shape, 4))
        for first, directions in ((0, people.gazes), (2, people.faces)):
            self._now[..., first], self._now[..., first + 1] = turns(lines.units, directions)
        np.copyto(self._means, self._now, where=np.isnan(self._means[0]))
        steps = self._now - self._means
        steps[np.isnan(steps)] = 0.0
        self._means += np.array([1.0 - math.exp(-dt / time) for time in TIMES])[:, None, None, None] * steps
        if people.speaking is not None:
            for time, row in zip(_SPEECH_TIMES, self._speech):
                row[:-1] += (1.0 - math.exp(-dt / time)) * (people.speaking - row[:-1])
        self._face_at = np.where(people.faceless, self._face_at, stamp)
        self._eyes_at = np.where(np.isnan(people.gazes[:, 0]), self._eyes_at, stamp)
        self._trunk_at = np.where(np.isnan(people.trunks[:, 0]), self._trunk_at, stamp)

    def of(self, rows: np.ndarray, targets: np.ndarray, people: PeopleSnapshot, lines: "SightLines",
           beliefs: np.ndarray, head_radius: float, stamp: float) -> np.ndarray:
        """Return the cues (K, len(CUES)) of the looks of `rows` (K,) at `targets` (K,), the robot last, after `update`.

        beliefs (N, T + 1): see GazeTargetFilter.
        """
        cues = np.empty((len(CUES), len(rows)))
        wide = self._of_directions(cues, rows, targets, people, lines, head_radius)
        _of_belief(cues, beliefs, rows, targets)
        cues[_AT["distance"]], cues[_AT["spread"]] = lines.distances[rows, targets], wide
        cues[_AT["range"]] = np.sqrt((people.rays * people.rays).sum(axis=1))[rows]
        count = len(people)
        groups = np.full(count + 1, -1)
        if people.groups is not None:
            groups[:-1] = people.groups
        eyes_back = self._means[0, np.where(targets < count, targets, 0), rows]
        mine = groups[rows]
        cues[_AT["looks_back"]] = np.where(targets < count, np.hypot(eyes_back[:, 0], eyes_back[:, 1]), np.nan)
        cues[_HEARD], cues[_AT["speaks"]] = self._speech[:, targets], self._speech[-1, rows]
        cues[_AT["in_group"]] = mine >= 0
        cues[_AT["grouped"]] = (mine == groups[targets]) & (mine >= 0)
        cues[_AT["face_missing"]] = self.face_missing(stamp)[rows]
        cues[_AT["eyes_missing"]] = stamp - self._eyes_at[rows]
        return cues.T

    def take_first(self, people: PeopleSnapshot, lines: "SightLines", first: np.ndarray, head_radius: float, dt: float
                   ) -> None:
        """Take what the first pass says (N, T), after `update`."""
        self._habits.compare(people, self._now[..., 2], lines.extents(head_radius)[0], dt)
        self._habits.learn(first)
        np.copyto(self._firsts, first, where=np.isnan(self._firsts[0]))
        for time, means in zip(_FIRST_TIMES, self._firsts):
            means += (1.0 - math.exp(-dt / time)) * (first - means)

    def of_second(self, rows: np.ndarray, targets: np.ndarray, people: PeopleSnapshot, lines: "SightLines",
                  first: np.ndarray, stamp: float) -> np.ndarray:
        """Return the cues of SECOND_CUES beyond CUES of the same looks as `of`, after `take_first`."""
        count = len(people)
        back = np.append(first[:, :count].T, np.zeros((count, 1)), axis=1)
        now = first[rows, targets]
        said = np.stack([self.trunk_missing(stamp)[rows], np.full(len(rows), people.speaking is None),
                         people.deviations[rows, 2], now, rivals(first, rows, targets),
                         *self._firsts[:, rows, targets], back[rows, targets], first.sum(axis=0)[targets] - now,
                         first.sum(axis=1)[rows]], axis=1)
        return np.append(said, self._habits.cues(rows, targets, lines.possible), axis=1)

    def _of_directions(self, cues: np.ndarray, rows: np.ndarray, targets: np.ndarray, people: PeopleSnapshot,
                       lines: "SightLines", head_radius: float) -> np.ndarray:
        """Fill in the cues of eyes, heads and trunks; return the standard deviation (K,), rad, of eyes to the sides."""
        square = people.deviations[rows, 2] ** 2
        wide, high = (np.sqrt(square + extent[rows, targets]) for extent in lines.extents(head_radius))
        trunk = turns(lines.units[rows, targets][:, None], people.trunks[rows])[0][:, 0]
        side = np.sign(trunk)
        seen = np.concatenate([self._now[None, rows, targets], self._means[:, rows, targets]])
        x, y, heads = seen[..., 0] / wide, seen[..., 1] / high, seen[..., 2]
        cues[_AT["aside"]], cues[_AT["above"]] = np.abs(x[0]), np.abs(y[0])
        cues[_AT["head_aside"]], cues[_AT["trunk"]] = np.abs(heads[0]), np.abs(trunk)
        cues[_OFF], cues[_TO_SIDE], cues[_UP] = np.hypot(x, y), side * x, y
        cues[_HEAD_TO_SIDE], cues[_HEAD_UP] = side * heads, seen[..., 3]
        return wide

    def face_missing(self, stamp: float) -> np.ndarray:
        """Return for how long (s) everybody has had no face (N,)."""
        return stamp - self._face_at

    def trunk_missing(self, stamp: float) -> np.ndarray:
        """Return for how long (s) everybody has had no trunk (N,)."""
        return stamp - self._trunk_at

    def _follow(self, ids: Sequence[str]) -> None:
        """Let the rows be those of `ids`; of somebody new nothing is known."""
        if list(ids) == self._ids:
            return
        rows: Dict[str, int] = {identity: row for row, identity in enumerate(self._ids)}
        count = len(self._ids)
        before = np.array([rows.get(identity, -1) for identity in ids], dtype=np.int64)
        targets = np.append(np.where(before >= 0, before, count + 1), count)
        padded = np.full((len(TIMES), count + 1, count + 2, 4), np.nan)
        padded[:, :-1, :-1] = self._means
        self._means = padded[:, before][:, :, targets]
        firsts = np.full((len(_FIRST_TIMES), count + 1, count + 2), np.nan)
        firsts[:, :-1, :-1] = self._firsts
        self._firsts = firsts[:, before][:, :, targets]
        self._speech = np.append(self._speech, np.zeros((len(_SPEECH_TIMES), 1)), axis=1)[:, np.append(before, count)]
        self._face_at, self._eyes_at, self._trunk_at = (np.append(times, -math.inf)[before] for times in (
            self._face_at, self._eyes_at, self._trunk_at))
        self._ids = list(ids)


def _of_belief(cues: np.ndarray, beliefs: np.ndarray, rows: np.ndarray, targets: np.ndarray) -> None:
    """Fill in the belief in each target, in the likeliest other one, in nobody; whether it is the robot."""
    last = beliefs.shape[1] - 2
    cues[_AT["belief"]], cues[_AT["nobody"]] = beliefs[rows, targets], beliefs[rows, -1]
    cues[_AT["robot"]] = targets == last
    cues[_AT["rival"]] = rivals(beliefs[:, :-1], rows, targets)


class Trees:
    """Boosted symmetric trees: all nodes of one level ask the same (Prokhorenkova et al., CatBoost, NeurIPS 2018)."""

    def __init__(self, start: float, trees: Sequence[Sequence[Sequence[float]]]) -> None:
        """start: log odds without any tree. trees: of each the cues and the limits of its levels, and the values of its
        leaves, where the first level is the lowest bit."""
        self._start = start
        self._cues = np.array([tree[0] for tree in trees], dtype=np.int64).reshape(-1, LEVELS)
        self._limits = np.array([tree[1] for tree in trees], dtype=np.float64).reshape(-1, LEVELS)
        self._values = np.array([tree[2] for tree in trees], dtype=np.float64).reshape(-1)
        self._first = np.arange(len(trees)) << LEVELS

    def odds(self, cues: np.ndarray) -> np.ndarray:
        """Return the log odds (K,) of looks by their cues (K, len(CUES)); what is not known is below all limits."""
        leaves = (cues[:, self._cues] > self._limits) @ (1 << np.arange(LEVELS))
        return self._start + self._values[leaves + self._first].sum(axis=1)


class GazeJudge:
    """Judges the looks that the filter believes possible."""

    def __init__(self, first: Optional[Trees] = None, second: Optional[Trees] = None) -> None:
        """first, second: by CUES and by SECOND_CUES."""
        self._cues = GazeCues()
        self._said = np.zeros((0, 1))
        self._first, self._second = first or Trees(START, TREES), second or Trees(SECOND_START, SECOND_TREES)

    def reset(self) -> None:
        """Forget everybody."""
        self._cues.reset()

    def update(self, people: PeopleSnapshot, lines: "SightLines", beliefs: np.ndarray, head_radius: float,
               stamp: float, dt: float) -> np.ndarray:
        """Return how likely everybody looks at each target (N, T); see GazeCues. Of people without a face it is what
        the filter believes, of those without eyes, and of all where groups are not known, what the first pass says."""
        rows, targets, cues = self.looks(people, lines, beliefs, head_radius, stamp, dt)
        if people.groups is None:       # the second pass knows only people of whom it is told who stands together
            return self._said.copy()
        eyed = cues[:, _AT["eyes_missing"]] <= _EYES_S
        judged = self._said.copy()
        looks = rows[eyed], targets[eyed]
        # The mean of both: the second alone trusts the habits of its worlds too much where people have others.
        judged[looks] = _chances(0.5 * (self._second.odds(cues[eyed]) + _odds(judged[looks])))
        return judged

    def looks(self, people: PeopleSnapshot, lines: "SightLines", beliefs: np.ndarray, head_radius: float,
              stamp: float, dt: float) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the looks to judge: observers (K,), targets (K,) and cues (K, len(SECOND_CUES))."""
        self._cues.update(people, lines, stamp, dt)
        faced = self._cues.face_missing(stamp) <= _MISSED_S
        rows, targets = np.nonzero((beliefs[:, :-1] >= LEAST_BELIEF) & lines.possible & faced[:, None])
        cues = self._cues.of(rows, targets, people, lines, beliefs, head_radius, stamp)
        first = beliefs[:, :-1].copy()
        # The first trees were grown where all trunks were seen.
        whole = self._cues.trunk_missing(stamp)[rows] <= _MISSED_S
        first[rows[whole], targets[whole]] = _chances(self._first.odds(cues[whole]))
        self._said = first
        self._cues.take_first(people, lines, first, head_radius, dt)
        return rows, targets, np.append(cues, self._cues.of_second(rows, targets, people, lines, first, stamp), axis=1)


def _odds(chances: np.ndarray) -> np.ndarray:
    kept = np.minimum(np.maximum(chances, _LEAST_CHANCE), 1.0 - _LEAST_CHANCE)
    return np.log(kept / (1.0 - kept))


def _chances(odds: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-odds))
