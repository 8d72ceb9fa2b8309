"""F-formations from positions and directions."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import List, Sequence

import numpy as np
import pytest

from benchmarks.data_directory import ABSENT, data_directory
from benchmarks.groups import group_figures, public_scenes, simulated_scenes, stability, with_noise
from hri_pipeline.core.interactions.groups import find_formations, o_spaces
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS

SETTINGS = INTERACTION_PARAMETERS.resolve({})


def formations(people: Sequence[Sequence[float]], sd: float = 0.2,
               settings: SimpleNamespace = SETTINGS) -> List[List[int]]:
    table = np.array(people, dtype=float).reshape(-1, 3)
    return [formation.members for formation in find_formations(
        table[:, :2], table[:, 2], np.full(len(table), sd), settings)]


def circle(count: int, radius: float, x: float = 0.0, y: float = 0.0) -> List[List[float]]:
    angles = 2.0 * math.pi * np.arange(count) / count + 0.3
    return [[x + radius * math.cos(angle), y + radius * math.sin(angle), angle + math.pi] for angle in angles]


@pytest.mark.parametrize("count, radius", [(2, 0.4), (2, 0.75), (3, 0.6), (4, 0.7), (5, 0.8), (6, 1.0)])
def test_a_circle_is_one_group_wherever_it_is(count: int, radius: float) -> None:
    for x, y in ((0.0, 0.0), (-3.0, 1.0), (5000.0, -8000.0)):
        table = np.array(circle(count, radius, x, y))
        found = find_formations(table[:, :2], table[:, 2], np.full(count, 0.2), SETTINGS)
        assert [formation.members for formation in found] == [list(range(count))]
        assert np.allclose(found[0].o_space, (x, y), atol=0.05)
        assert 0.5 < found[0].confidence <= 1.0


def test_side_by_side_and_at_a_right_angle_are_pairs() -> None:
    assert formations([[0.0, 0.0, 1.5], [0.6, 0.0, 1.6]]) == [[0, 1]]
    assert formations([[0.0, 0.0, 0.0], [0.6, -0.6, math.pi / 2.0]]) == [[0, 1]]


def test_back_to_back_far_apart_and_alone_are_none() -> None:
    assert formations([[0.0, 0.0, math.pi], [0.8, 0.0, 0.0]]) == []
    assert formations([[0.0, 0.0, 0.0], [4.0, 0.0, math.pi]]) == []
    assert formations([[1.0, 2.0, 3.0]]) == []
    assert formations([]) == []


def test_two_circles_beside_each_other_stay_two_and_a_passer_by_is_in_none() -> None:
    people = circle(3, 0.6) + circle(4, 0.7, 3.0, 0.0) + [[1.5, 2.0, math.pi / 2.0]]
    assert formations(people) == [[0, 1, 2], [3, 4, 5, 6]]


def test_the_order_of_the_people_changes_nothing() -> None:
    people = np.array(circle(3, 0.6) + circle(4, 0.7, 3.0, 0.0) + [[1.5, 2.0, 1.5], [-2.0, 2.0, 0.0]])
    order = np.random.RandomState(1).permutation(len(people))
    shuffled = {frozenset(int(order[row]) for row in group) for group in formations(people[order])}
    assert shuffled == {frozenset(group) for group in formations(people)}


def test_people_without_a_direction_belong_by_their_place() -> None:
    people = circle(3, 0.5)
    people[1][2] = math.nan
    assert formations(people + [[3.0, 3.0, math.nan]]) == [[0, 1, 2]]
    assert formations([[0.0, 0.0, math.nan], [0.5, 0.0, math.nan]]) == [[0, 1]]
    assert formations([[0.0, 0.0, math.nan], [2.5, 0.0, math.nan]]) == []


@pytest.mark.parametrize("radius", (0.4, 0.7, 0.9, 1.2))
def test_circles_of_any_size_are_one_group(radius: float) -> None:
    angles = np.arange(5) * 2.0 * math.pi / 5.0
    people = [[radius * math.cos(angle), radius * math.sin(angle), angle + math.pi] for angle in angles]
    assert formations(people) == [[0, 1, 2, 3, 4]]


def test_an_uncertain_direction_counts_less_than_a_certain_one() -> None:
    people = np.array([[0.0, 0.0, math.pi], [0.9, 0.0, math.pi]])      # one looks at the other's back
    both = [find_formations(people[:, :2], people[:, 2] + [0.0, math.pi], np.full(2, sd), SETTINGS)
            for sd in (0.1, 3.0)]
    assert both[0] == []
    assert both[1][0].members == [0, 1]
    no_direction = find_formations(people[:, :2], np.full(2, math.nan), np.full(2, 0.1), SETTINGS)
    assert both[1][0].confidence == pytest.approx(no_direction[0].confidence, abs=0.01)


def test_an_uncertain_place_makes_a_group_less_certain() -> None:
    people = np.array(circle(3, 0.6))
    sure, unsure = (find_formations(people[:, :2], people[:, 2], np.full(3, 0.2), SETTINGS,
                                    np.full(3, sd))[0].confidence
                    for sd in (0.05, 0.5))
    assert sure > unsure


def test_the_middle_of_given_groups() -> None:
    table = np.array(circle(4, 0.7, 3.0, 1.0) + [[8.0, 8.0, math.nan]])
    middles = o_spaces(table[:, :2], table[:, 2], np.full(5, 0.2), SETTINGS, [[0, 1, 2, 3], [4]])
    assert np.allclose(middles, [[3.0, 1.0], [8.0, 8.0]], atol=1e-6)
    assert o_spaces(table[:, :2], table[:, 2], np.full(5, 0.2), SETTINGS, []).shape == (0, 2)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="2 positions, 1 directions"):
        find_formations(np.zeros((2, 2)), np.zeros(1), np.zeros(2), SETTINGS)
    with pytest.raises(ValueError, match="not finite"):
        find_formations(np.array([[0.0, math.nan], [1.0, 0.0]]), np.zeros(2), np.zeros(2), SETTINGS)
    with pytest.raises(ValueError, match="negative"):
        find_formations(np.zeros((2, 2)), np.zeros(2), np.array([0.1, -0.1]), SETTINGS)


def test_public_scenes_are_read_in_metres() -> None:
    if data_directory() is None:
        pytest.skip(ABSENT)
    coffee, synth = public_scenes("CoffeeBreak"), public_scenes("Synth")
    assert (len(coffee), len(synth)) == (119, 100)
    assert coffee[0].ids == (1, 2, 4, 5, 6, 7, 8)
    assert set(coffee[0].groups) == {frozenset((4, 5)), frozenset((1, 2))}
    assert np.allclose(coffee[0].positions[0], (1.767, 1.357), atol=1e-3)
    assert all(member in scene.ids for scene in coffee + synth for group in scene.groups for member in group)


def test_a_scene_file_that_is_absent_or_something_else_is_named(tmp_path) -> None:
    with pytest.raises(FileNotFoundError, match=r"features\.mat"):
        public_scenes("Synth", tmp_path)
    import scipy.io
    (tmp_path / "groups" / "Synth").mkdir(parents=True)
    for name in ("features", "groundtruth"):
        scipy.io.savemat(str(tmp_path / "groups" / "Synth" / (name + ".mat")), {"other": 1})
    with pytest.raises(ValueError, match="Synth does not hold"):
        public_scenes("Synth", tmp_path)


def test_one_setting_reaches_the_figures_on_all_scenes() -> None:
    if data_directory() is None:
        pytest.skip(ABSENT)
    found = group_figures()["f1"]
    assert found["CoffeeBreak"] >= 0.83
    assert found["Synth"] >= 0.90
    assert found["CoffeeBreak_noisy"] >= 0.78
    assert found["simulated"] >= 0.95


def test_time_makes_groups_better_and_ids_steady() -> None:
    found = stability(scenes=3, seconds=8.0)
    assert found["f1"] >= found["f1_unfiltered"]
    assert found["f1"] >= 0.9
    assert found["ids_per_group"] <= 1.2


def test_noise_is_of_the_size_that_is_asked_for() -> None:
    scenes = simulated_scenes(30, seed=3)
    moved = with_noise(scenes, 0.2, 0.35, seed=4)
    places = np.concatenate([after.positions - before.positions for before, after in zip(scenes, moved)])
    turned = np.concatenate([after.directions - before.directions for before, after in zip(scenes, moved)])
    assert places.std() == pytest.approx(0.2, rel=0.1)
    assert turned.std() == pytest.approx(0.35, rel=0.1)
    assert [scene.groups for scene in moved] == [scene.groups for scene in scenes]
