"""Assignment, life of a track, the 1 euro filter and stage times."""

import itertools

import numpy as np
import pytest

from hri_pipeline.core.assignment import assign
from hri_pipeline.core.one_euro import OneEuro
from hri_pipeline.core.timing import StageTimes
from hri_pipeline.core.track_life import TrackLife


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


def test_one_euro_is_quiet_at_rest_and_follows_motion():
    generator = np.random.default_rng(0)
    still = OneEuro(min_cutoff=1.0, beta=0.0)
    noise = generator.normal(size=(300, 2))
    filtered = np.array([still(value, index / 30) for index, value in enumerate(noise)])
    assert filtered[50:].std() < 0.5 * noise.std()
    fast, slow = OneEuro(1.0, beta=6.0), OneEuro(1.0, beta=0.0)
    for index in range(60):
        value = np.array([index / 30 * 5.0])
        last_fast, last_slow = fast(value, index / 30), slow(value, index / 30)
    assert abs(last_fast - value) < 0.2 * abs(last_slow - value)


def test_one_euro_against_the_paper_by_hand():
    cutoff_filter = OneEuro(min_cutoff=1.0, beta=0.0, d_cutoff=1.0)
    cutoff_filter(np.array([0.0]), 0.0)
    ratio = 2 * np.pi * 1.0 * 0.1
    assert cutoff_filter(np.array([1.0]), 0.1)[0] == pytest.approx(ratio / (ratio + 1))


def test_one_euro_restarts():
    smooth = OneEuro()
    smooth(np.zeros(2), 1.0)
    np.testing.assert_array_equal(smooth(np.ones(2), 1.0), np.zeros(2))     # same stamp
    np.testing.assert_array_equal(smooth(np.ones(2), 0.5), np.ones(2))      # back in time
    np.testing.assert_array_equal(smooth(np.ones(3), 0.6), np.ones(3))      # another shape
    smooth.reset()
    np.testing.assert_array_equal(smooth(np.full(3, 9.0), 0.7), np.full(3, 9.0))


def test_one_euro_lets_nan_through_and_forgets_it():
    smooth = OneEuro()
    smooth(np.array([0.0, 0.0]), 0.0)
    assert np.isnan(smooth(np.array([np.nan, 0.0]), 0.1)[0])
    assert smooth(np.array([5.0, 0.0]), 0.2)[0] == 5.0


@pytest.mark.parametrize("arguments", [{"min_cutoff": 0}, {"min_cutoff": np.nan}, {"beta": -1}, {"d_cutoff": 0}])
def test_bad_one_euro(arguments):
    with pytest.raises(ValueError, match=next(iter(arguments))):
        OneEuro(**arguments)


def test_stage_times():
    ticks = iter([0.0, 0.010, 1.0, 1.030])
    times = StageTimes(clock=lambda: next(ticks))
    with times("mesh"):
        pass
    with pytest.raises(KeyError):
        with times("mesh"):
            raise KeyError("counted all the same")
    median, high = times.summary()["mesh"]
    assert median == pytest.approx(20.0) and high == pytest.approx(29.0)
    times.clear()
    assert times.summary() == {}
    with pytest.raises(ValueError):
        StageTimes(window=0)
