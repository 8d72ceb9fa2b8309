"""Simulated people who leave and return, and strangers who come instead: what body re-identification is asked.

People are what a camera and the body pipeline make of them: histograms of clothes, monocular places and statures, with
the noise that was measured of the people in vtest.avi (clothes) and is known of one camera (places, statures).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from hri_fullbody.core.tracking.reidentification import PARTS, BodyReidentifier, TrackAppearance, histogram_of_colours

RATE = 5.0
_PIXELS = 60
_DARK = 0.75                # of the clothes
_SAME_AS_TRUNK = 0.8        # sleeves and belly like the chest, shins like the thighs
_LIKE_SOMEBODY = 0.25       # of the strangers dress much like somebody who has just left,
_VERY_LIKE = 0.1            # and so many of these the same
_SAME_DOOR = 0.5            # of the strangers come where somebody has just left
_RETURNS = 0.5              # of those who leave
_DEPTH_NOISE, _ACROSS_NOISE, _PLACE_NOISE = 0.12, 0.02, 0.05
_STATURES = ((0.03, 0.03), (0.10, 0.06))    # standard deviations told and true: with depth images, and without


@dataclass
class SimulatedHuman:
    """Somebody. colours: (5, 3) mean lightness (0 to 255) and both colour axes of the parts. spread: (5, 3)."""

    colours: np.ndarray
    spread: np.ndarray
    stature: float
    place: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 3.0]))


class Encounter(NamedTuple):
    """A body that came. who: number of the human; earlier: id of the body it was before, None for somebody new.

    alone: nobody else who was lost lately is dressed alike.
    """

    id: str
    earlier: Optional[str]
    alone: bool


def human(random: np.random.Generator, like: Optional[SimulatedHuman] = None, dark: float = _DARK) -> SimulatedHuman:
    """Draw somebody; like: whose clothes are of similar colours; dark: share of dark clothes."""
    if like is not None:
        apart = np.array([6.0, 2.0, 2.0] if random.random() < _VERY_LIKE else [20.0, 6.0, 6.0])
        return SimulatedHuman(like.colours + random.normal(0.0, apart, (PARTS, 3)), like.spread,
                              float(random.normal(1.70, 0.09)))
    upper, lower = _colour(random, dark), _colour(random, dark)
    colours = np.array([upper if row == 0 or (row < 3 and random.random() < _SAME_AS_TRUNK) else
                        lower if row == 3 or (row == 4 and random.random() < _SAME_AS_TRUNK) else _colour(random, dark)
                        for row in range(PARTS)])
    return SimulatedHuman(colours, random.uniform([6.0, 1.5, 1.5], [25.0, 5.0, 5.0], (PARTS, 3)),
                          float(random.normal(1.70, 0.09)))


def _colour(random: np.random.Generator, dark: float) -> np.ndarray:
    if random.random() < dark:
        return np.array([random.uniform(15.0, 80.0), *random.normal(0.0, 4.0, 2)])
    hue, strength = random.uniform(0.0, 2.0 * math.pi), random.uniform(0.0, 45.0)
    return np.array([random.uniform(60.0, 220.0), strength * math.cos(hue), strength * math.sin(hue)])


def seen_clothes(person: SimulatedHuman, random: np.random.Generator) -> np.ndarray:
    """Return what is learnt of somebody's clothes in one stay: other light, another side, some background."""
    light, tint = random.normal(0.0, 5.0), random.normal(0.0, 1.0, 2)
    # Some stays are seen badly.
    noise = float(np.exp(random.normal(-0.5, 0.7)))
    rows = []
    for middle, spread in zip(person.colours, person.spread):
        pixels = random.normal(middle + np.array([light, *tint]) + noise * random.normal(0.0, [6.0, 1.5, 1.5]), spread,
                               (_PIXELS, 3))
        foreign = random.random(_PIXELS) < min(1.0, noise) * random.uniform(0.0, 0.2)
        pixels[foreign] = random.normal([130.0, -2.0, 6.0], [40.0, 6.0, 8.0], (int(foreign.sum()), 3))
        rows.append(histogram_of_colours(*pixels.T))
    return np.stack(rows)


class World:
    """A room with a camera: some people, of whom one after the other leaves, and returns, or somebody else comes."""

    def __init__(self, seed: int, people: int, memory: float = 10.0) -> None:
        self._random = np.random.default_rng(seed)
        self._told_sd, self._true_sd = _STATURES[int(self._random.integers(len(_STATURES)))]
        self._here: Dict[str, SimulatedHuman] = {}
        self._gone: Dict[str, Tuple[SimulatedHuman, float]] = {}
        self._looks: Dict[str, TrackAppearance] = {}
        self._count, self._memory, self._stamp = 0, memory, 0.0
        self.reidentifier = BodyReidentifier(memory)
        for _ in range(people):
            self._enter(self._placed(human(self._random)))
        self._watch(3.0)

    def run(self, visits: int) -> List[Tuple[Encounter, Optional[Tuple[str, float]]]]:
        """Let so many bodies come; returns each with what was told: (earlier id, likelihood), or None."""
        found = []
        while len(found) < visits:
            leaver = str(self._random.choice(sorted(self._here))) if self._here else None
            if leaver is not None:
                self._leave(leaver)
            if len(self._gone) == 0 or self._random.random() < 0.3:
                self._watch(float(self._random.uniform(0.5, 3.0)))
                continue
            self._watch(float(self._random.exponential(4.0)))
            encounter = self._somebody_comes()
            told = self._watch(2.0)
            found.append((encounter, told.get(encounter.id)))
            while len(self._here) < 2:
                self._enter(self._placed(human(self._random)))
                self._watch(2.0)
        return found

    def _somebody_comes(self) -> Encounter:
        known = {key: item for key, item in self._gone.items() if self._stamp - item[1] <= self._memory}
        if known and self._random.random() < _RETURNS:
            earlier = str(self._random.choice(sorted(known)))
            person, left = known[earlier]
            gap = self._stamp - left
            way = self._random.normal(0.0, 0.3 + 0.5 * min(gap, 4.0), 2)
            self._gone.pop(earlier)
            alone = not any(_alike(person, other) for other, _ in self._gone.values())
            back = replace(person, place=person.place + np.array([way[0], 0.0, way[1]]))
            return Encounter(self._enter(back), earlier, alone)
        like = None
        if known and self._random.random() < _LIKE_SOMEBODY:
            like = known[str(self._random.choice(sorted(known)))][0]
        stranger = self._placed(human(self._random, like))
        if known and self._random.random() < _SAME_DOOR:
            door = known[str(self._random.choice(sorted(known)))][0].place
            stranger.place = door + self._random.normal(0.0, [0.5, 0.0, 0.5])
        alone = not any(_alike(stranger, other) for other, _ in known.values())
        return Encounter(self._enter(stranger), None, alone)

    def _placed(self, person: SimulatedHuman) -> SimulatedHuman:
        far = self._random.uniform(1.5, 6.0)
        person.place = np.array([far * self._random.uniform(-0.5, 0.5), 0.0, far])
        return person

    def _enter(self, person: SimulatedHuman) -> str:
        self._count += 1
        key = "b{}".format(self._count)
        far = float(np.linalg.norm(person.place))
        # One camera takes somebody for nearer and smaller, or farther and taller, as long as it sees him.
        scale = float(np.exp(self._random.normal(0.0, _DEPTH_NOISE if self._told_sd > 0.05 else 0.02)))
        place = person.place * scale + self._random.normal(0.0, _ACROSS_NOISE * far, 3)
        stature = person.stature + float(self._random.normal(0.0, self._true_sd))
        self._here[key] = person
        self._looks[key] = TrackAppearance(key, seen_clothes(person, self._random), place, stature, self._told_sd)
        return key

    def _leave(self, key: str) -> None:
        self._gone[key] = (self._here.pop(key), self._stamp)
        self._looks.pop(key)

    def _watch(self, seconds: float) -> Dict[str, Tuple[str, float]]:
        """Let time pass; returns what is told meanwhile."""
        told = {}
        for _ in range(max(1, int(round(seconds * RATE)))):
            self._stamp += 1.0 / RATE
            bodies = [look._replace(place=None if look.place is None else look.place + self._random.normal(
                0.0, _PLACE_NOISE, 3)) for look in self._looks.values()]
            for item in self.reidentifier.update(bodies, self._stamp):
                told[item.id] = (item.earlier, item.likelihood)
        return told


def _alike(first: SimulatedHuman, second: SimulatedHuman) -> bool:
    """Tell whether two people are dressed so that the clothes do not tell them apart."""
    return bool(np.abs(first.colours - second.colours).mean(axis=0).max() < 12.0)
