"""Assignment, what it costs to do without one of its pairs, and the life of a track."""

import itertools

import numpy as np
import pytest

from hri_pipeline.core.tracks import TrackLife, assign, best_pairs

UNPAIRED = 20.0


def test_assignment_is_the_best_one():
    assert assign(np.array([[1.0, 0.9], [0.5, 9.0]]), 2.0) == [(0, 1), (1, 0)]


@pytest.mark.parametrize("seed", range(20))
def test_assignment_against_all_permutations(seed):
    generator = np.random.default_rng(seed)
    cost = generator.uniform(size=(4, 4))
    cost[generator.uniform(size=(4, 4)) < 0.3] = np.nan
    pairs = assign(cost, 0.7)
    best = (0, 0.0)
    for columns in itertools.permutations(range(4)):
        legal = [cost[row, column] for row, column in enumerate(columns) if cost[row, column] <= 0.7]
        best = max(best, (len(legal), -sum(legal)))
    assert len(pairs) == best[0]
    assert sum(cost[pair] for pair in pairs) == pytest.approx(-best[1])


@pytest.mark.parametrize("cost", [np.zeros((0, 3)), np.zeros((3, 0)), np.full((2, 2), np.nan), np.full((2, 2), 9.0),
                                  np.full((2, 2), -np.inf), np.full((2, 2), np.inf)])
def test_nothing_to_assign(cost):
    assert assign(cost, 1.0) == []


def test_bad_assignment():
    with pytest.raises(ValueError, match="two dimensions"):
        assign(np.zeros(3), 1.0)
    with pytest.raises(ValueError, match="max_cost"):
        assign(np.zeros((2, 2)), np.nan)


@pytest.mark.parametrize("rate", [5, 15, 60])
def test_birth_and_death_are_in_seconds_whatever_the_rate(rate):
    life = TrackLife(100.0, birth_delay=0.2, death_time=1.0)
    stamps = 100.0 + np.arange(1, rate + 1) / rate
    confirmed_at = None
    for stamp in stamps:
        life.seen(stamp)
        if life.confirmed and confirmed_at is None:
            confirmed_at = stamp
    assert 0.2 - 1e-6 <= confirmed_at - 100.0 < 0.2 + 1.0 / rate
    assert life.first_seen == 100.0 and life.last_seen == 101.0
    assert not life.dead(102.0) and life.dead(102.001)


def test_no_birth_delay():
    assert TrackLife(0.0, 0.0, 1.0).confirmed
    assert not TrackLife(0.0, 0.1, 1.0).confirmed


@pytest.mark.parametrize("birth, death", [(-1, 1), (np.nan, 1), (0, 0), (0, -1), (0, np.inf)])
def test_bad_life(birth, death):
    with pytest.raises(ValueError, match="legal range"):
        TrackLife(0.0, birth, death)


def least(costs):
    """The least cost and the pairs of all ways to pair up, one after the other."""
    rows, columns = costs.shape
    best = (np.inf, ())
    for taken in itertools.permutations([*range(columns), *[None] * rows], rows):
        pairs = tuple((row, column) for row, column in enumerate(taken) if column is not None)
        best = min(best, (sum(costs[pair] for pair in pairs) + 0.5 * UNPAIRED * (rows + columns - 2 * len(pairs)),
                          pairs))
    return best


@pytest.mark.parametrize("seed", range(25))
def test_the_margin_of_each_pair_is_that_of_pairing_up_anew_without_it(seed):
    rng = np.random.default_rng(seed)
    costs = rng.uniform(-6.0, 30.0, rng.integers(1, 5, 2))
    costs[rng.uniform(size=costs.shape) < 0.2] = np.inf
    total, pairs = least(costs)
    margins = best_pairs(costs, UNPAIRED)
    assert sorted(margins) == sorted(pairs)
    for pair, margin in margins.items():
        without = costs.copy()
        without[pair] = np.inf
        assert margin == pytest.approx(least(without)[0] - total, abs=1e-6)


def test_nobody_is_paired_where_nothing_is_cheaper_than_to_stay_alone():
    assert best_pairs(np.array([[20.5, np.inf]]), UNPAIRED) == {}
    assert best_pairs(np.array([[np.inf], [3.0]]), UNPAIRED) == {(1, 0): pytest.approx(17.0)}
