"""Figures of the groups: F1 on public and simulated scenes, stability over time, processor time."""

from __future__ import annotations

import math
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Dict, FrozenSet, List, Optional, Sequence, Set, Tuple

import numpy as np

from hri_pipeline.core.interactions.formations import find_formations
from hri_pipeline.core.interactions.group_tracker import GroupTracker, Stander
from hri_pipeline.core.interactions.interaction_parameters import INTERACTION_PARAMETERS
from hri_pipeline.evaluation.group_scenes import GroupScene, public_scenes, simulated_scenes, with_noise
from hri_pipeline.evaluation.scores import group_scores

PUBLISHED_F1: Dict[str, Dict[str, float]] = {"CoffeeBreak": {"GCFF": 0.88}, "Synth": {"GCFF": 0.97}}
"""F1 at T = 2/3 of GCFF (F. Setti et al., PLoS ONE 10(5), 2015), with parameters of its own for each sequence."""

POSITION_SD, DIRECTION_SD = 0.1, math.radians(20.0)
"""What the algorithm is told of the uncertainty, for all scenes alike (m, rad)."""
NOISE_POSITION, NOISE_DIRECTION = 0.2, math.radians(20.0)
NOISE_SEEDS = range(5)
RATE_HZ = 15.0


def found_groups(scenes: Sequence[GroupScene], settings: Optional[SimpleNamespace] = None,
                 direction_sd: float = DIRECTION_SD) -> List[List[FrozenSet[int]]]:
    """Return the groups found in each scene by itself. settings: of the interactions node, None: the defaults."""
    settings = settings or INTERACTION_PARAMETERS.resolve({})
    found = []
    for scene in scenes:
        count = len(scene.ids)
        formations = find_formations(scene.positions, scene.directions, np.full(count, direction_sd), settings,
                                     np.full(count, POSITION_SD))
        found.append([frozenset(scene.ids[row] for row in formation.members) for formation in formations])
    return found


def f1(scenes: Sequence[GroupScene], settings: Optional[SimpleNamespace] = None) -> Tuple[float, float]:
    """Return F1 of the groups found in the scenes at T = 2/3 and at T = 1 (the very same members)."""
    found, truth = found_groups(scenes, settings), [scene.groups for scene in scenes]
    return group_scores(found, truth).f1, group_scores(found, truth, 1.0).f1


def noisy_f1(scenes: Sequence[GroupScene], position_sd: float = NOISE_POSITION, direction_sd: float = NOISE_DIRECTION
             ) -> Tuple[float, float]:
    """Return the mean F1 at T = 2/3 and 1 with noise added (m, rad), over five draws."""
    draws = [f1(with_noise(scenes, position_sd, direction_sd, seed)) for seed in NOISE_SEEDS]
    two_thirds, same = np.mean(draws, axis=0).tolist()
    return two_thirds, same


def group_figures(directory: Optional[Path] = None) -> Dict[str, Dict[str, float]]:
    """Return F1 with one setting for all scenes: `f1` (T = 2/3), `f1_same_members` (T = 1), and at T = 2/3 the others.

    The setting was chosen on CoffeeBreak/Seq1 (`f1_chosen_on`, with and without noise), every second moment of Synth, and
    other simulated scenes; `f1_held_out` is on what took no part in that. Of CoffeeBreak the sequence chosen on is much
    the harder one for every method. directory: of the test data. Raises FileNotFoundError where the public scenes are absent.
    """
    names = ("CoffeeBreak", "Synth", "CoffeeBreak_noisy", "simulated")
    synth = public_scenes("Synth", directory)
    coffee, first, second = (public_scenes(name, directory)
                             for name in ("CoffeeBreak", "CoffeeBreak/Seq1", "CoffeeBreak/Seq2"))
    both = dict(zip(names, (f1(coffee), f1(synth), noisy_f1(coffee), f1(simulated_scenes(100, seed=2)))))
    return {
        "f1": {name: scores[0] for name, scores in both.items()},
        "f1_same_members": {name: scores[1] for name, scores in both.items()},
        "f1_chosen_on": {"CoffeeBreak": f1(first)[0], "Synth": f1(synth[::2])[0]},
        "f1_held_out": dict(zip(names, (f1(second)[0], f1(synth[1::2])[0], noisy_f1(second)[0], both["simulated"][0]))),
        "published": {name: scores["GCFF"] for name, scores in PUBLISHED_F1.items()}}


def stability(scenes: int = 10, seconds: float = 20.0, seed: int = 5) -> Dict[str, float]:
    """Return what the tracker makes of still scenes with noise (0.1 m, 20 degrees), 10 % of the people missing at each moment.

    `f1` (T = 2/3) over all moments after the first 5 s, `f1_unfiltered` of each moment by itself, `ids_per_group` (1: no id
    was ever given up).
    """
    settings = INTERACTION_PARAMETERS.resolve({})
    random = np.random.RandomState(seed)
    tracked: List[List[FrozenSet[int]]] = []
    single: List[List[FrozenSet[int]]] = []
    truth: List[Sequence[FrozenSet[int]]] = []
    ids: Set[str] = set()
    for number, scene in enumerate(simulated_scenes(scenes, seed)):
        tracker = GroupTracker(settings, seed=number)
        for index in range(int(seconds * RATE_HZ)):
            seen = _missing(with_noise([scene], 0.1, DIRECTION_SD, random.randint(2 ** 31))[0], random)
            groups = tracker.update(standers(seen), 1000.0 + index / RATE_HZ)
            if index < 5.0 * RATE_HZ:
                continue
            ids |= {"{}/{}".format(number, group.id) for group in groups}
            tracked.append([frozenset(int(member[1:]) for member in group.members) for group in groups])
            single += found_groups([seen], settings)
            truth.append(scene.groups)
    return {"f1": group_scores(tracked, truth).f1, "f1_unfiltered": group_scores(single, truth).f1,
            "ids_per_group": len(ids) / max(1, sum(len(scene.groups) for scene in simulated_scenes(scenes, seed)))}


def standers(scene: GroupScene, position_sd: float = POSITION_SD, direction_sd: float = DIRECTION_SD) -> List[Stander]:
    """Return the people of a scene as the tracker takes them; ids p0, p1, ..."""
    return [Stander("p{}".format(person), place, float(direction), position_sd, direction_sd)
            for person, place, direction in zip(scene.ids, scene.positions, scene.directions)]


def _missing(scene: GroupScene, random: np.random.RandomState, share: float = 0.1) -> GroupScene:
    rows = np.flatnonzero(random.uniform(size=len(scene.ids)) >= share)
    return GroupScene(tuple(scene.ids[row] for row in rows), scene.positions[rows], scene.directions[rows], scene.groups)


def milliseconds(people: int, repeats: int = 50, seed: int = 0) -> float:
    """Return the median processor time (ms) of finding the formations of so many people, 0.7 per square metre, anywhere."""
    settings = INTERACTION_PARAMETERS.resolve({})
    random = np.random.RandomState(seed)
    spent = []
    for _ in range(repeats):
        positions = random.uniform(0.0, 1.2 * math.sqrt(people), (people, 2))
        directions, sds = random.uniform(-math.pi, math.pi, people), np.full(people, DIRECTION_SD)
        began = time.thread_time()
        find_formations(positions, directions, sds, settings, np.full(people, POSITION_SD))
        spent.append(time.thread_time() - began)
    return 1e3 * float(np.median(spent))
