"""F-formations from positions and directions, and groups over time."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Dict, Iterable, List, Sequence

import numpy as np
import pytest

from benchmarks.groups import group_figures, public_scenes, simulated_scenes, stability, with_noise
from benchmarks.report import ABSENT, data_directory
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.interactions.formations import find_formations, middles_of, votes_of
from hri_pipeline.core.interactions.groups import (
    ROBOT,
    Group,
    GroupTracker,
    Individual,
    _velocity,
    fuse_directions,
    group_numbers,
    individuals_of,
)
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS, InteractionSettings
from hri_pipeline.core.interactions.people import GazeTarget, Observer, PeopleSnapshot

SETTINGS = INTERACTION_PARAMETERS.resolve({})


def formations(people: Sequence[Sequence[float]], sd: float = 0.2,
               settings: InteractionSettings = SETTINGS) -> List[List[int]]:
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


@pytest.mark.parametrize("errors", ((40, -35, 35, -40, 30, -30), (40, 40, -40, -40, 20, 0)))
def test_a_wide_circle_is_one_group_although_headings_err(errors: Sequence[int]) -> None:
    angles = np.arange(6) * math.pi / 3.0
    people = [[1.1 * math.cos(angle), 1.1 * math.sin(angle), angle + math.pi + math.radians(error)]
              for angle, error in zip(angles, errors)]
    assert formations(people, math.radians(30.0)) == [[0, 1, 2, 3, 4, 5]]
    inside = people + [[0.3, 0.2, 0.5]]
    assert list(range(7)) not in formations(inside, math.radians(30.0)), "the space of a circle is empty"


def test_who_stands_behind_a_member_is_none() -> None:
    people = standing("abc", radius=0.6)
    positions = np.array([person.position for person in people] + [people[0].position * 2.4])
    directions = np.array([person.direction for person in people] + [people[0].direction])
    sds = np.full(4, math.radians(20.0))
    (group,) = find_formations(positions, directions, sds, SETTINGS, np.full(4, 0.1))
    assert group.members == [0, 1, 2]
    positions[3] = people[0].position * 1.5 + (0.0, 0.6)
    directions[3] = math.atan2(-positions[3, 1], -positions[3, 0])
    (group,) = find_formations(positions, directions, sds, SETTINGS, np.full(4, 0.1))
    assert group.members == [0, 1, 2, 3], "who has made room for himself is one"


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
    votes = votes_of(table[:, :2], table[:, 2], np.full(5, 0.2), SETTINGS)
    assert np.allclose(middles_of(votes, [[0, 1, 2, 3], [4]]), [[3.0, 1.0], [8.0, 8.0]], atol=1e-6)
    assert middles_of(votes, []).shape == (0, 2)


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


@pytest.mark.slow("recorded and simulated scenes")
def test_one_setting_reaches_the_figures_on_all_scenes() -> None:
    if data_directory() is None:
        pytest.skip(ABSENT)
    found = group_figures()["f1"]
    assert found["CoffeeBreak"] >= 0.83
    assert found["Synth"] >= 0.90
    assert found["CoffeeBreak_noisy"] >= 0.78
    assert found["simulated"] >= 0.95
    assert found["radii"] >= 0.93
    assert found["walkers"] >= 0.88


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


# -- groups over time

STEP = 0.1


def standing(ids: Sequence[str], x: float = 0.0, y: float = 0.0, radius: float = 0.6) -> List[Individual]:
    angles = 2.0 * math.pi * np.arange(len(ids)) / max(1, len(ids))
    return [Individual(name, np.array([x + radius * math.cos(angle), y + radius * math.sin(angle)]), angle + math.pi,
                       0.05, 0.2)
            for name, angle in zip(ids, angles)]


def alone(ids: Iterable[str]) -> List[Individual]:
    return [Individual(name, np.array([20.0 + 5.0 * index, 0.0]), 0.0) for index, name in enumerate(ids)]


class Film:
    """A tracker and the time."""

    def __init__(self, **given: float) -> None:
        self.tracker = GroupTracker(INTERACTION_PARAMETERS.resolve(given), seed=1)
        self.stamp = 1000.0
        self.groups: List[Group] = []

    def run(self, people: Sequence[Individual], seconds: float) -> Dict[tuple, str]:
        for _ in range(int(round(seconds / STEP))):
            self.stamp += STEP
            self.groups = self.tracker.update(people, self.stamp)
        return {group.members: group.id for group in self.groups}


def test_a_group_begins_after_the_delay_and_keeps_its_id() -> None:
    film = Film()
    assert film.run(standing("abc"), 0.3) == {}
    first = film.run(standing("abc"), 1.0)
    assert list(first) == [("a", "b", "c")]
    assert film.run(standing("abc"), 10.0) == first
    group = film.groups[0]
    assert is_valid_id(group.id)
    assert np.allclose(group.o_space, 0.0, atol=0.05)
    assert 0.5 < group.confidence <= 1.0


def test_one_who_joins_and_one_who_leaves_do_not_change_the_id() -> None:
    film = Film()
    first = film.run(standing("abc") + alone("d"), 5.0)
    joined = film.run(standing("abcd"), 5.0)
    assert joined == {("a", "b", "c", "d"): first[("a", "b", "c")]}
    left = film.run(standing("bcd") + alone("a"), 5.0)
    assert left == {("b", "c", "d"): first[("a", "b", "c")]}


def test_a_passer_by_for_half_a_second_is_no_member() -> None:
    film = Film()
    before = film.run(standing("abc") + alone("d"), 5.0)
    assert film.run(standing("abcd"), 0.5) == before
    assert film.run(standing("abc") + alone("d"), 1.0) == before


def walk(film: Film, company: Sequence[Individual], begin: Sequence[float], velocity: Sequence[float],
         seconds: float) -> float:
    """Let w walk beside the others; return for how long (s) it was in a group."""
    inside, place = 0.0, np.array(begin, dtype=float)
    for _ in range(int(round(seconds / STEP))):
        place = place + STEP * np.asarray(velocity)
        groups = film.run(list(company) + [Individual("w", place.copy(), None, 0.05, 0.3)], STEP)
        inside += STEP * any("w" in members for members in groups)
    return inside


def test_one_who_walks_through_a_group_is_no_member_and_one_who_walks_away_is_none_soon() -> None:
    assert walk(Film(), standing("abc"), (-3.0, 0.0), (1.0, 0.0), 6.0) == 0.0
    times = []
    for group_speed in (0.7, 10.0):
        film = Film(group_speed=group_speed)
        members = standing("abcw")
        assert set(film.run(members, 6.0)) == {("a", "b", "c", "w")}
        times.append(walk(film, members[:3], members[3].position, (0.0, -1.0), 6.0))
    assert times[0] < times[1] < 4.0


def test_people_who_walk_side_by_side_are_a_group() -> None:
    film = Film()
    found = {}
    for index in range(50):
        x = 0.1 * index
        found = film.run([Individual("a", np.array([x, 0.0]), 0.0), Individual("b", np.array([x, 0.6]), 0.0)], STEP)
    assert set(found) == {("a", "b")}


def test_three_who_walk_abreast_are_a_group_and_who_overtakes_them_is_not() -> None:
    film = Film()
    found = {}
    for index in range(60):
        x = 0.12 * index
        people = [Individual(name, np.array([x, 0.8 * row]), 0.0) for row, name in enumerate("abc")]
        people += [Individual("d", np.array([1.5 * x - 2.0, 2.5]), 0.0)]
        found = film.run(people, STEP)
    assert set(found) == {("a", "b", "c")}


def test_who_walks_with_another_is_seen_too_seldom_to_tell_the_pace_and_does_not_stand() -> None:
    tracker, found = GroupTracker(SETTINGS, seed=0), []
    for index in range(25):
        x = 0.48 * index
        people = [Individual("a", np.array([x, 0.0]), 0.0)]
        people += [Individual("b", np.array([x, 0.6]), 0.0)] if index % 4 else []
        found.append([group.members for group in tracker.update(people, 0.4 * index)])
    assert found[8:] == [[("a", "b")]] * 17


def test_where_a_group_splits_the_larger_part_has_the_id() -> None:
    film = Film()
    whole = film.run(standing("abcde", radius=0.8), 5.0)
    parts = film.run(standing("abc") + standing("de", x=6.0), 6.0)
    assert set(parts) == {("a", "b", "c"), ("d", "e")}
    assert parts[("a", "b", "c")] == whole[("a", "b", "c", "d", "e")]
    assert parts[("d", "e")] not in whole.values()


def test_where_groups_merge_the_larger_gives_the_id_and_of_equals_the_older() -> None:
    film = Film()
    parts = film.run(standing("ab") + standing("cde", x=6.0), 5.0)
    assert film.run(standing("abcde", radius=0.8), 6.0) == {("a", "b", "c", "d", "e"): parts[("c", "d", "e")]}
    film = Film()
    older = film.run(standing("ab") + alone("cd"), 5.0)
    film.run(standing("ab") + standing("cd", x=6.0), 5.0)
    assert film.run(standing("abcd", radius=0.7), 6.0) == {("a", "b", "c", "d"): older[("a", "b")]}


def test_a_group_that_ends_is_gone_and_a_new_one_has_a_new_id() -> None:
    film = Film()
    first = film.run(standing("ab"), 5.0)
    assert film.run(alone("ab"), 5.0) == {}
    again = film.run(standing("ab"), 5.0)
    assert set(again) == {("a", "b")}
    assert set(again.values()).isdisjoint(first.values())


def test_a_member_who_is_not_seen_for_a_moment_stays_and_one_who_is_gone_leaves() -> None:
    film = Film()
    first = film.run(standing("abc"), 5.0)
    everybody = standing("abc")
    assert film.run(everybody[:2], 0.7) == first
    assert film.run(everybody, 1.0) == first
    gone = film.run(everybody[:2], 2.0)
    assert gone == {("a", "b"): first[("a", "b", "c")]}
    assert film.run([], 2.0) == {}


def test_who_is_not_tracked_any_more_leaves_at_once_and_the_others_keep_the_id() -> None:
    film = Film()
    first = film.run(standing("abc") + standing("de", x=6.0), 5.0)
    groups = film.tracker.retain("abd")
    assert {group.members: group.id for group in groups} == {("a", "b"): first[("a", "b", "c")]}
    assert film.run([person for person in standing("abc") if person.id != "c"], STEP) == {
        ("a", "b"): first[("a", "b", "c")]}
    assert film.tracker.retain("") == [] == film.tracker.retain("abc")
    assert film.run(standing("abc"), 0.4) == {("a", "b", "c"): first[("a", "b", "c")]}, "a gap of the list ends nothing"


def test_people_who_get_other_ids_where_they_stand_are_the_same_group() -> None:
    film = Film()
    first = film.run(standing("abc"), 5.0)
    assert film.tracker.retain("xyz") == []
    assert film.run(standing("xyz"), 0.4) == {("x", "y", "z"): first[("a", "b", "c")]}


def test_somebody_new_elsewhere_takes_nobodys_place() -> None:
    film = Film()
    first = film.run(standing("abc"), 5.0)
    film.tracker.retain("bcx")
    company = [person for person in standing("abc") if person.id != "a"]
    assert film.run(company + alone("x"), 2.0) == {("b", "c"): first[("a", "b", "c")]}


def test_the_largest_part_has_the_id_also_when_it_takes_in_another_group() -> None:
    film = Film(group_time=0.0, group_delay=0.0)
    before = film.run(standing("abcde", radius=0.8) + standing("fg", x=6.0), 2.0)
    film.stamp += 1.1
    after = film.run(standing("abcfg", radius=0.8) + standing("de", x=6.0), STEP)
    assert after[("a", "b", "c", "f", "g")] == before[("a", "b", "c", "d", "e")]
    assert after[("d", "e")] not in before.values()


def test_of_equal_parts_that_without_the_robot_has_the_id() -> None:
    film = Film()
    whole = film.run(standing([ROBOT, "c", "a", "b"], radius=0.8), 5.0)
    film.stamp += 1.1
    parts = film.run(standing([ROBOT, "c"], x=6.0) + standing("ab"), 1.0)
    assert parts[("a", "b")] == whole[(ROBOT, "a", "b", "c")]


def test_the_robot_may_be_a_member() -> None:
    film = Film()
    people = standing(["a", "b"]) + standing(["c", "d", ROBOT], x=8.0)
    assert set(film.run(people, 5.0)) == {("a", "b"), (ROBOT, "c", "d")}


def test_the_robot_is_in_a_group_only_where_somebody_of_it_looks_at_it() -> None:
    film = Film()

    def people(watcher: str) -> List[Individual]:
        return [replace(person, looks_at_robot=None if person.id == ROBOT else person.id == watcher)
                for person in standing(["a", "b"], x=8.0) + standing(["c", "d", ROBOT])]

    first = film.run(people("a"), 5.0)
    assert set(first) == {("a", "b"), ("c", "d")}
    assert film.run(people("d"), 3.0) == {("a", "b"): first["a", "b"], (ROBOT, "c", "d"): first["c", "d"]}
    assert set(film.run(people(""), 3.0)) == {(ROBOT, "c", "d"), ("a", "b")}, "a look elsewhere ends nothing"
    assert set(film.run(people(""), 6.0)) == {("c", "d"), ("a", "b")}


def test_who_looks_at_the_robot_now_and_then_keeps_it_in_the_group_and_does_not_take_it_in() -> None:
    film = Film(group_period=0.0)

    def groups(looks: Sequence[bool], seconds: float) -> set:
        """All groups after the first 3 s; looks: at the robot, by turns."""
        found = [tuple(film.run([replace(person, looks_at_robot=looks[number % len(looks)] and person.id != ROBOT)
                                 for person in standing(["c", "d", ROBOT])], STEP))
                 for number in range(int(seconds / STEP))]
        return set(found[int(3.0 / STEP):])

    now_and_then = [True] + 9 * [False]
    assert groups(now_and_then, 12.0) == {(("c", "d"),)}
    assert groups([True], 5.0) == {((ROBOT, "c", "d"),)}
    assert groups(now_and_then, 12.0) == {((ROBOT, "c", "d"),)}


def test_a_velocity_is_that_of_the_line_of_least_squares() -> None:
    random = np.random.default_rng(1)
    times, places = 1.7e9 + np.sort(random.uniform(0.0, 2.0, 8)), random.normal(5000.0, 1.0, (8, 2))
    line = np.polyfit(times - times[0], places - places[0], 1)[0]
    assert _velocity([(at, x, y) for at, (x, y) in zip(times.tolist(), places.tolist())]) == pytest.approx(line)
    assert all(map(math.isnan, _velocity([(1.0, 0.0, 0.0), (2.0, 1.0, 0.0)])))


def test_people_are_taken_as_they_are_seen_and_numbered_by_their_group() -> None:
    people = PeopleSnapshot.of([Observer("a", np.array([1.0, 2.0, 1.6]), body_direction=np.array([0.0, 1.0, 0.0])),
                                Observer("b", np.array([0.0, 0.0, 1.6]))])
    first, second = individuals_of(people, 0.6, [GazeTarget("b", ROBOT, 0.9), GazeTarget("a", "b", 0.9)])
    assert first.direction == pytest.approx(math.pi / 2.0) and second.direction is None
    assert (first.looks_at_robot, second.looks_at_robot) == (False, True)
    assert individuals_of(people, 0.6)[0].looks_at_robot is None
    groups = [Group("x", ("b", "c"), 1.0, np.zeros(2))]
    assert group_numbers(["a", "b", "c"], groups).tolist() == [-1, 0, 0]


def test_a_group_of_one_is_none_and_a_group_of_the_robot_alone_neither() -> None:
    film = Film()
    assert film.run(alone(["a", ROBOT]), 3.0) == {}


def test_when_time_jumps_back_everything_starts_afresh_with_new_ids() -> None:
    film = Film()
    first = film.run(standing("abc"), 5.0)
    film.stamp -= 100.0
    assert film.run(standing("abc"), STEP) == {}
    again = film.run(standing("abc"), 2.0)
    assert set(again) == set(first)
    assert set(again.values()).isdisjoint(first.values())


def test_an_older_stamp_changes_nothing() -> None:
    film = Film()
    film.run(standing("abc"), 5.0)
    before = film.groups
    assert film.tracker.update(alone("abc"), film.stamp - 0.2) == before
    assert film.tracker.update(alone("abc"), film.stamp) == before


def test_after_a_long_gap_only_who_is_there_counts() -> None:
    film = Film()
    film.run(standing("abc"), 5.0)
    film.stamp += 3600.0
    assert film.run(alone("abc"), 1.0) == {}


def test_what_comes_from_outside_is_checked() -> None:
    film = Film()
    broken = Individual("x", np.array([math.nan, 0.0]), 0.0)
    odd = [Individual("y", np.array([30.0, 0.0]), math.nan, 0.1, math.inf),
           Individual("z", np.array([40.0, 0.0]), None)]
    assert set(film.run(standing("abc") + [broken] + odd, 3.0)) == {("a", "b", "c")}
    with pytest.raises(ValueError, match="twice"):
        film.tracker.update(standing("aa"), film.stamp + 1.0)
    with pytest.raises(ValueError, match="not finite"):
        film.tracker.update([], math.nan)


def test_nobody_is_kept_of_people_who_come_and_go() -> None:
    film = Film(group_period=0.0)
    for turn in range(200):
        film.run(standing(["a%d" % turn, "b%d" % turn]), STEP)
    film.run([], 5.0)
    tracker = film.tracker
    assert not any(map(len, (tracker._people, tracker._known, tracker._individuals, tracker._paths,
                             tracker._attention, tracker._gone)))


def test_the_trunk_comes_before_the_head() -> None:
    direction, sd = fuse_directions(0.0, 0.2, 0.8, 0.1)
    assert direction is not None and 0.0 < direction < 0.2
    assert sd < 0.2
    assert fuse_directions(None, 0.2, 0.8, 0.3) == (pytest.approx(0.8), pytest.approx(math.hypot(0.3, 0.6)))
    assert fuse_directions(0.5, 0.2, None, 0.1) == (pytest.approx(0.5), pytest.approx(0.2))
    assert fuse_directions(None, 0.2, math.nan, 0.1) == (None, math.inf)


def test_a_head_that_looks_back_does_not_turn_the_trunk() -> None:
    assert fuse_directions(0.0, 0.3, 2.5, 0.1) == (pytest.approx(0.0), pytest.approx(0.3))


def test_directions_are_fused_across_the_turn() -> None:
    direction, _ = fuse_directions(math.pi - 0.1, 0.3, -math.pi + 0.1, 0.3)
    assert direction is not None
    assert abs(math.remainder(direction - math.pi, 2.0 * math.pi)) < 0.1
