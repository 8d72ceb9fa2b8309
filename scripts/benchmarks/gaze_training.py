"""Grows the trees of `core/interactions/gaze_trees.py` in the worlds of `gaze_random`.

    cd scripts; bash lib/in_workspace.sh training python3 -m benchmarks.gaze_training

collects looks (about 6 minutes of one core), and writes the trees of the second pass anew; with `--first` those of the
first one, from scenes in which all trunks are seen and all voices heard: the second pass follows. Nothing of
`gaze_independent` or of real pictures is used: they say afterwards whether it holds.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from benchmarks.gaze_random import RandomWorld
from hri_pipeline.core.interactions import gaze_trees
from hri_pipeline.core.interactions.gaze import ROBOT, GazeTargets
from hri_pipeline.core.interactions.gaze_cues import CUES, SECOND_CUES, GazeJudge
from hri_pipeline.core.interactions.groups import GroupTracker, Individual, group_numbers, individuals_of
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS

_SECONDS, _EVERY_S = 30.0, 0.2
_COUNTS = (3, 4, 5, 6, 8, 10, 12, 2, 4, 6, 8, 12)
SEEDS = (*range(74), *range(75, 180, 2))
WHOLE = {"rate": 15.0, "no_trunks": 0.0, "trunk_gaps": 0.0, "deaf": 0.0}
_BINS = 32
_RATE, _REGULAR, _LEAST = 0.15, 2.0, 30.0
"""Of each tree: how much of it counts; L2 penalty of its leaves; least sum of p (1 - p) in a leaf."""
TREES, SECOND_TREES = 100, 400
_HEADER = '"""Numbers of the trees of gaze_cues, written by scripts/benchmarks/gaze_training.py; not by hand."""\n'
Tree = Tuple[Tuple[int, ...], Tuple[float, ...], Tuple[float, ...]]


class Looks(NamedTuple):
    """cues (K, C); right (K,), whether it was so; weights (K,): scenes with many people count for less."""

    cues: np.ndarray
    right: np.ndarray
    weights: np.ndarray


class _Recorder(GazeJudge):
    """Keeps the looks of the last image, and believes the filter."""

    def update(self, people, lines, beliefs, head_radius, stamp, dt):
        self.ids = [*people.ids, ROBOT]
        self.rows, self.targets, self.cues = self.looks(people, lines, beliefs, head_radius, stamp, dt)
        return beliefs[:, :-1]


def collect(seed: int, fixed: Optional[Mapping[str, float]] = None) -> Looks:
    """Return looks of one scene with SECOND_CUES, every 0.2 s; fixed: see RandomWorld."""
    settings = INTERACTION_PARAMETERS.resolve({})
    targets, groups, recorder = GazeTargets(settings), GroupTracker(settings, seed=0), _Recorder()
    targets._judge = recorder
    gazes: Sequence = ()
    due = 0.0
    cues, right = [np.zeros((0, len(SECOND_CUES)))], [np.zeros(0)]
    for moment in RandomWorld(_COUNTS[seed % len(_COUNTS)], seed, fixed).moments(_SECONDS):
        image = moment.image
        robot = Individual(ROBOT, moment.camera[:2], 0.0, 0.05, 0.1)
        together = groups.update([*individuals_of(image.people, settings.group_head_sd, gazes), robot], image.stamp)
        image.people.groups = group_numbers(image.people.ids, together)
        gazes = targets.update(image.people, moment.camera, image.stamp)
        if image.stamp >= due - 1e-6 and image.people.ids:
            due, names = image.stamp + _EVERY_S, recorder.ids
            cues.append(recorder.cues)
            right.append(np.array([image.gazes.get(names[row]) == names[target] for row, target in zip(
                recorder.rows.tolist(), recorder.targets.tolist())], dtype=float))
    found = np.concatenate(right)
    return Looks(np.concatenate(cues), found, np.full(len(found), 1.0 / np.sqrt(max(len(found), 1))))


def joined(looks: Sequence[Looks]) -> Looks:
    """Return the looks of several scenes; the weights are 1 on average."""
    cues, right, weights = (np.concatenate(columns) for columns in zip(*looks))
    return Looks(cues, right, weights / weights.mean())


def grow(looks: Looks, trees: int) -> Tuple[float, List[Tree]]:
    """Return the log odds without any tree, and boosted symmetric trees (Friedman, Ann. Statist. 29, 2001, with second
    derivatives)."""
    limits = [_limits(column) for column in looks.cues.T]
    bins = np.stack([np.searchsorted(limit, np.where(np.isnan(column), -np.inf, column)) for limit, column in zip(
        limits, looks.cues.T)])
    part = float(np.average(looks.right, weights=looks.weights))
    start = float(np.log(part / (1.0 - part)))
    odds, grown = np.full(len(looks.right), start), []
    for _ in range(trees):
        chances = 1.0 / (1.0 + np.exp(-odds))
        slopes, curves = looks.weights * (chances - looks.right), looks.weights * chances * (1.0 - chances)
        leaves, chosen = np.zeros(len(odds), dtype=np.int64), []
        for level in range(gaze_trees.LEVELS):
            cue, limit = _best(bins, leaves, slopes, curves, 1 << level)
            leaves += (bins[cue] > limit).astype(np.int64) << level
            chosen.append((cue, limit))
        count = 1 << gaze_trees.LEVELS
        values = -_RATE * np.bincount(leaves, slopes, count) / (np.bincount(leaves, curves, count) + _REGULAR)
        odds += values[leaves]
        grown.append((tuple(cue for cue, _ in chosen), tuple(round(float(limits[cue][limit]), 4) for cue, limit in
                                                             chosen), tuple(np.round(values, 3).tolist())))
    return start, grown


def _limits(column: np.ndarray) -> np.ndarray:
    """Return finite values between which about equally many known values of a cue lie."""
    with np.errstate(invalid="ignore"):
        found = np.nanquantile(column, np.linspace(0.0, 1.0, _BINS + 1)[1:-1])
    return np.unique(found[np.isfinite(found)])


def _best(bins: np.ndarray, leaves: np.ndarray, slopes: np.ndarray, curves: np.ndarray, count: int) -> Tuple[int, int]:
    """Return the cue and the bin up to which a leaf keeps its looks that part all leaves best."""
    best, found = (0, 0), -np.inf
    for cue, column in enumerate(bins):
        cells = leaves * _BINS + column
        slope, curve = (np.bincount(cells, values, count * _BINS).reshape(count, _BINS) for values in (slopes, curves))
        below, less = slope.cumsum(axis=1), curve.cumsum(axis=1)
        above, more = below[:, -1:] - below, less[:, -1:] - less
        gains = below ** 2 / (less + _REGULAR) + above ** 2 / (more + _REGULAR)
        whole = below[:, -1:] ** 2 / (less[:, -1:] + _REGULAR)
        gains = np.where((less > _LEAST) & (more > _LEAST), gains, whole).sum(axis=0)[:-1]
        if gains.max() > found:
            best, found = (cue, int(gains.argmax())), float(gains.max())
    return best


def write(passes: Mapping[str, Tuple[float, Sequence[Tree]]], path: Path) -> None:
    """Write the module; passes: what their names begin with, and of each what `grow` returns."""
    lines = [_HEADER, "LEVELS = {}".format(gaze_trees.LEVELS)]
    for prefix, (start, grown) in passes.items():
        lines += ["{}START = {:.4f}".format(prefix, start), "{}TREES = (".format(prefix)]
        lines += [*(re.sub(r"(?<![0-9])0\.(?=[0-9])", ".", "    {},".format(tree)) for tree in grown), ")"]
    path.write_text("\n".join(lines) + "\n")


def main() -> None:
    """Collect, grow, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, help="of the scenes")
    parser.add_argument("--first", action="store_true", help="grow the trees of the first pass")
    options = parser.parse_args()
    looks = joined([collect(seed, WHOLE if options.first else None) for seed in options.seeds])
    passes: Dict[str, Tuple[float, Sequence[Tree]]] = {"": (gaze_trees.START, gaze_trees.TREES), "SECOND_": (
        gaze_trees.SECOND_START, gaze_trees.SECOND_TREES)}
    if options.first:
        passes[""] = grow(looks._replace(cues=looks.cues[:, :len(CUES)]), TREES)
    else:
        passes["SECOND_"] = grow(looks, SECOND_TREES)
    write(passes, Path(gaze_trees.__file__))
    print("{} looks".format(len(looks.right)))


if __name__ == "__main__":
    main()
