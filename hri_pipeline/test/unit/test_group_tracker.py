"""Groups over time."""

from __future__ import annotations

import math
from typing import Dict, Iterable, List, Sequence

import numpy as np
import pytest

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.interactions.groups import ROBOT, Group, GroupTracker, Individual, fuse_directions
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS

SETTINGS = INTERACTION_PARAMETERS.resolve({})
STEP = 0.1


def circle(ids: Sequence[str], x: float = 0.0, y: float = 0.0, radius: float = 0.6) -> List[Individual]:
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
    assert film.run(circle("abc"), 0.3) == {}
    first = film.run(circle("abc"), 1.0)
    assert list(first) == [("a", "b", "c")]
    assert film.run(circle("abc"), 10.0) == first
    group = film.groups[0]
    assert is_valid_id(group.id)
    assert np.allclose(group.o_space, 0.0, atol=0.05)
    assert 0.5 < group.confidence <= 1.0


def test_one_who_joins_and_one_who_leaves_do_not_change_the_id() -> None:
    film = Film()
    first = film.run(circle("abc") + alone("d"), 5.0)
    joined = film.run(circle("abcd"), 5.0)
    assert joined == {("a", "b", "c", "d"): first[("a", "b", "c")]}
    left = film.run(circle("bcd") + alone("a"), 5.0)
    assert left == {("b", "c", "d"): first[("a", "b", "c")]}


def test_a_passer_by_for_half_a_second_is_no_member() -> None:
    film = Film()
    before = film.run(circle("abc") + alone("d"), 5.0)
    assert film.run(circle("abcd"), 0.5) == before
    assert film.run(circle("abc") + alone("d"), 1.0) == before


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
    assert walk(Film(), circle("abc"), (-3.0, 0.0), (1.0, 0.0), 6.0) == 0.0
    times = []
    for group_speed in (0.7, 10.0):
        film = Film(group_speed=group_speed)
        members = circle("abcw")
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


def test_where_a_group_splits_the_larger_part_has_the_id() -> None:
    film = Film()
    whole = film.run(circle("abcde", radius=0.8), 5.0)
    parts = film.run(circle("abc") + circle("de", x=6.0), 6.0)
    assert set(parts) == {("a", "b", "c"), ("d", "e")}
    assert parts[("a", "b", "c")] == whole[("a", "b", "c", "d", "e")]
    assert parts[("d", "e")] not in whole.values()


def test_where_groups_merge_the_larger_gives_the_id_and_of_equals_the_older() -> None:
    film = Film()
    parts = film.run(circle("ab") + circle("cde", x=6.0), 5.0)
    assert film.run(circle("abcde", radius=0.8), 6.0) == {("a", "b", "c", "d", "e"): parts[("c", "d", "e")]}
    film = Film()
    older = film.run(circle("ab") + alone("cd"), 5.0)
    film.run(circle("ab") + circle("cd", x=6.0), 5.0)
    assert film.run(circle("abcd", radius=0.7), 6.0) == {("a", "b", "c", "d"): older[("a", "b")]}


def test_a_group_that_ends_is_gone_and_a_new_one_has_a_new_id() -> None:
    film = Film()
    first = film.run(circle("ab"), 5.0)
    assert film.run(alone("ab"), 5.0) == {}
    again = film.run(circle("ab"), 5.0)
    assert set(again) == {("a", "b")}
    assert set(again.values()).isdisjoint(first.values())


def test_a_member_who_is_not_seen_for_a_moment_stays_and_one_who_is_gone_leaves() -> None:
    film = Film()
    first = film.run(circle("abc"), 5.0)
    everybody = circle("abc")
    assert film.run(everybody[:2], 0.7) == first
    assert film.run(everybody, 1.0) == first
    gone = film.run(everybody[:2], 2.0)
    assert gone == {("a", "b"): first[("a", "b", "c")]}
    assert film.run([], 2.0) == {}


def test_the_robot_may_be_a_member() -> None:
    film = Film()
    people = circle(["a", "b"]) + circle(["c", "d", ROBOT], x=8.0)
    assert set(film.run(people, 5.0)) == {("a", "b"), (ROBOT, "c", "d")}


def test_a_group_of_one_is_none_and_a_group_of_the_robot_alone_neither() -> None:
    film = Film()
    assert film.run(alone(["a", ROBOT]), 3.0) == {}


def test_when_time_jumps_back_everything_starts_afresh_with_new_ids() -> None:
    film = Film()
    first = film.run(circle("abc"), 5.0)
    film.stamp -= 100.0
    assert film.run(circle("abc"), STEP) == {}
    again = film.run(circle("abc"), 2.0)
    assert set(again) == set(first)
    assert set(again.values()).isdisjoint(first.values())


def test_an_older_stamp_changes_nothing() -> None:
    film = Film()
    film.run(circle("abc"), 5.0)
    before = film.groups
    assert film.tracker.update(alone("abc"), film.stamp - 0.2) == before
    assert film.tracker.update(alone("abc"), film.stamp) == before


def test_after_a_long_gap_only_who_is_there_counts() -> None:
    film = Film()
    film.run(circle("abc"), 5.0)
    film.stamp += 3600.0
    assert film.run(alone("abc"), 1.0) == {}


def test_what_comes_from_outside_is_checked() -> None:
    film = Film()
    broken = Individual("x", np.array([math.nan, 0.0]), 0.0)
    odd = [Individual("y", np.array([30.0, 0.0]), math.nan, 0.1, math.inf),
           Individual("z", np.array([40.0, 0.0]), None)]
    assert set(film.run(circle("abc") + [broken] + odd, 3.0)) == {("a", "b", "c")}
    with pytest.raises(ValueError, match="twice"):
        film.tracker.update(circle("aa"), film.stamp + 1.0)
    with pytest.raises(ValueError, match="not finite"):
        film.tracker.update([], math.nan)


def test_nobody_is_kept_of_people_who_come_and_go() -> None:
    film = Film(group_period=0.0)
    for turn in range(200):
        film.run(circle(["a%d" % turn, "b%d" % turn]), STEP)
    film.run([], 5.0)
    assert (
        film.tracker._people == []
        and film.tracker._known == []
        and film.tracker._individuals == {}
        and film.tracker._paths == {}
    )


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
