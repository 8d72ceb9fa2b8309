"""How well gazes are found in simulated scenes whose truth is known, and how well the head's direction alone does."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

from hri_pipeline.core.interactions.gaze_targets import ROBOT, GazeTarget, GazeTargets, Onlooker
from hri_pipeline.core.interactions.interaction_parameters import INTERACTION_PARAMETERS
from hri_pipeline.evaluation.gaze_scenes import ROBOT_AT, SHOULDERS, Moment, run

SEEDS = tuple(range(100, 106))
"""Of the figures told. The parameters were chosen on TUNING_SEEDS."""
TUNING_SEEDS = tuple(range(6))
CLOSED_AFTER_S = 0.3
_CONE = math.radians(20.0)

Method = Callable[[Sequence[Onlooker], Optional[np.ndarray], float], List[GazeTarget]]


class PairCounts:
    """True and false pairs (sender, receiver) over all images."""

    def __init__(self) -> None:
        self.right = self.found = self.true = self.closed_gazes = 0

    def add(self, moment: Moment, gazes: Sequence[GazeTarget]) -> None:
        """Compare what was found in one image with the truth."""
        found = {(gaze.sender, gaze.receiver) for gaze in gazes}
        true = set(moment.gazes.items())
        self.right += len(found & true)
        self.found += len(found)
        self.true += len(true)
        self.closed_gazes += sum(moment.closed_for.get(gaze.sender, 0.0) > CLOSED_AFTER_S for gaze in gazes)

    def summary(self) -> Dict[str, float]:
        """Return precision, recall and the number of gazes out of eyes closed for more than 0.3 s."""
        return {"precision": self.right / max(self.found, 1), "recall": self.right / max(self.true, 1),
                "closed_gazes": self.closed_gazes}


def gaze(people: int, seconds: float = 60.0, closed_eyes_rule: bool = True, held: float = 0.0,
         seeds: Sequence[int] = SEEDS, settings: Optional[SimpleNamespace] = None, clear: float = SHOULDERS) -> Dict[str, float]:
    """Return the figures of so many people over `seconds` for each seed.

    closed_eyes_rule: False withholds what is known of the lids. held: correlation time (s) of all noise, 0: white. clear: see gaze_scenes.
    """
    settings = settings or INTERACTION_PARAMETERS.resolve({})
    return _score(people, seconds, held, seeds, lambda: GazeTargets(settings).update, closed_eyes_rule, clear)


def head_rule(people: int, seconds: float = 60.0, held: float = 0.0, seeds: Sequence[int] = SEEDS) -> Dict[str, float]:
    """Return the same of the head's direction alone: the nearest within 20 degrees, image by image."""
    return _score(people, seconds, held, seeds, lambda: nearest_in_cone, True)


def nearest_in_cone(people: Sequence[Onlooker], robot: Optional[np.ndarray], stamp: float) -> List[GazeTarget]:
    """Return of everybody the target nearest to the head's direction, if it is within 20 degrees."""
    found = []
    for person in people:
        if person.head_direction is None or person.head is None:
            continue
        best, least = None, _CONE
        targets = [(other.id, other.head) for other in people if other is not person and other.head is not None]
        targets += [] if robot is None else [(ROBOT, robot)]
        for identity, place in targets:
            way = place - person.head
            angle = math.acos(min(1.0, max(-1.0, float(way @ person.head_direction) / float(np.linalg.norm(way)))))
            if angle < least:
                best, least = identity, angle
        if best is not None:
            found.append(GazeTarget(person.id, best, 1.0))
    return found


def _score(people: int, seconds: float, held: float, seeds: Sequence[int], make: Callable[[], Method],
           closed_eyes_rule: bool, clear: float = SHOULDERS) -> Dict[str, float]:
    counts = PairCounts()
    for seed in seeds:
        method = make()
        for moment in run(people, seconds, seed, held, clear=clear):
            seen = moment.seen if closed_eyes_rule else [_without_lids(person) for person in moment.seen]
            counts.add(moment, method(seen, ROBOT_AT, moment.stamp))
    return counts.summary()


def _without_lids(person: Onlooker) -> Onlooker:
    return Onlooker(**dict(vars(person), eyes_closed=None))
