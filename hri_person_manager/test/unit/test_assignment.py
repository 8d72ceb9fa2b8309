"""The best pairing and what it costs to do without one of its pairs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hri_person_manager.core.assignment import best_pairs

UNPAIRED = 20.0


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
