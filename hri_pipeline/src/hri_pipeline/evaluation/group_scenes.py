"""Scenes of people with known groups: public ones, with or without noise, and simulated ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import FrozenSet, List, Optional, Sequence, Tuple

import numpy as np
import scipy.io

from hri_pipeline.evaluation.data_directory import ABSENT, data_directory

SEQUENCES = {"CoffeeBreak": ("CoffeeBreak/Seq1", "CoffeeBreak/Seq2"), "Synth": ("Synth",)}
"""Public scenes, below data/groups: M. Cristani et al., BMVC 2011; CoffeeBreak's headings are of heads, in four bins."""

_CENTIMETRE = 0.01


@dataclass(frozen=True)
class GroupScene:
    """One moment. ids: (N,); positions: (N, 2) m; directions: (N,) rad from x towards y; groups: sets of ids, two and more."""

    ids: Tuple[int, ...]
    positions: np.ndarray
    directions: np.ndarray
    groups: Tuple[FrozenSet[int], ...]


def public_scenes(name: str, directory: Optional[Path] = None) -> List[GroupScene]:
    """Return the labelled moments of `CoffeeBreak`, `Synth`, or of one sequence (`CoffeeBreak/Seq1`).

    directory: that of the test data, None: the project's. Raises FileNotFoundError naming a file that is absent, and
    ValueError naming one whose contents are something else.
    """
    directory = directory or data_directory()
    if directory is None:
        raise FileNotFoundError(ABSENT)
    scenes: List[GroupScene] = []
    for sequence in SEQUENCES.get(name, (name,)):
        scenes += _read(Path(directory) / "groups" / sequence)
    return scenes


def _read(directory: Path) -> List[GroupScene]:
    found = []
    for name in ("features.mat", "groundtruth.mat"):
        if not (directory / name).is_file():
            raise FileNotFoundError("{} is absent".format(directory / name))
        found.append(scipy.io.loadmat(str(directory / name), squeeze_me=True))
    features, truth = found
    try:
        rows = {int(stamp): people for stamp, people in zip(np.atleast_1d(features["timestamp"]), features["features"])}
        moments = list(zip(np.atleast_1d(truth["GTtimestamp"]), truth["GTgroups"]))
        return [_scene(rows[int(stamp)], groups) for stamp, groups in moments if int(stamp) in rows]
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ValueError("{} does not hold id, x, y and heading per person and the groups: {!r}".format(
            directory, error)) from error


def _scene(people: np.ndarray, groups: np.ndarray) -> GroupScene:
    """Return the scene of (N, 4) id, x cm, y cm, heading rad, and of groups as read: one per row, or one in all."""
    people = np.asarray(people, dtype=np.float64)
    people = people.reshape(-1, 4) if people.size else np.zeros((0, 4))
    groups = np.atleast_1d(groups)
    if groups.dtype == object:
        sets = [np.atleast_1d(group) for group in groups]
    else:
        sets = [groups] if groups.ndim == 1 else list(groups)
    members = [frozenset(int(person) for person in group.ravel()) for group in sets if group.size]
    return GroupScene(tuple(int(person) for person in people[:, 0]), people[:, 1:3] * _CENTIMETRE, people[:, 3].copy(),
                      tuple(group for group in members if len(group) > 1))


def with_noise(scenes: Sequence[GroupScene], position_sd: float, direction_sd: float, seed: int) -> List[GroupScene]:
    """Return the scenes with normal noise on each coordinate (sd in m) and on the direction (sd in rad)."""
    random = np.random.RandomState(seed)
    return [replace(scene, positions=scene.positions + random.normal(0.0, position_sd, scene.positions.shape),
                    directions=scene.directions + random.normal(0.0, direction_sd, scene.directions.shape))
            for scene in scenes]


def simulated_scenes(count: int, seed: int, width: float = 7.0) -> List[GroupScene]:
    """Return moments with one to four groups of two to six people and up to four people alone, in width x width m.

    Circles with 0.6 to 1 m per person, pairs face to face, at a right angle (L) or side by side, 0.8 to 1.6 m from each other
    if face to face, as A. Kendon (1990) describes them; directions within 12 degrees (sd) of the middle. Who is alone
    stands 0.8 m from every circle at least and looks anywhere.
    """
    random = np.random.RandomState(seed)
    return [_simulated(random, width) for _ in range(count)]


def _simulated(random: np.random.RandomState, width: float) -> GroupScene:
    places: List[Tuple[float, float]] = []
    directions: List[float] = []
    groups: List[FrozenSet[int]] = []
    discs: List[Tuple[np.ndarray, float]] = []
    for _ in range(random.randint(1, 5)):
        size = int(random.choice([2, 2, 3, 3, 4, 5, 6]))
        radius = random.uniform(0.4, 0.8) if size == 2 else max(0.45, size * random.uniform(0.6, 1.0) / (2.0 * math.pi))
        middle = _free_place(random, width, discs, radius + 0.6)
        if middle is None:
            continue
        discs.append((middle, radius))
        step = 2.0 * math.pi / size if size > 2 else float(random.choice([math.pi, math.pi / 2.0, math.pi / 3.0]))
        angles = random.uniform(-math.pi, math.pi) + step * np.arange(size) + random.normal(0.0, 0.1, size)
        groups.append(frozenset(range(len(places), len(places) + size)))
        for angle in angles:
            place = middle + radius * np.array([math.cos(angle), math.sin(angle)]) + random.normal(0.0, 0.05, 2)
            places.append((float(place[0]), float(place[1])))
            directions.append(float(angle) + math.pi + random.normal(0.0, math.radians(12.0)))
    for _ in range(random.randint(0, 5)):
        alone = _free_place(random, width, discs, 0.8)
        if alone is not None:
            discs.append((alone, 0.2))
            places.append((float(alone[0]), float(alone[1])))
            directions.append(random.uniform(-math.pi, math.pi))
    return GroupScene(tuple(range(len(places))), np.array(places).reshape(-1, 2), np.array(directions), tuple(groups))


def _free_place(random: np.random.RandomState, width: float, discs: Sequence[Tuple[np.ndarray, float]], distance: float
                ) -> Optional[np.ndarray]:
    """Return a place (2,) m farther than `distance` from every disc, None when 50 attempts find none."""
    for _ in range(50):
        place = random.uniform(0.0, width, 2)
        if all(np.linalg.norm(place - middle) > radius + distance for middle, radius in discs):
            return place
    return None
