"""The worlds and the growing of the trees that judge looks."""

import importlib.util

import numpy as np
import pytest

from benchmarks.gaze_random import RandomWorld
from benchmarks.gaze_training import WHOLE, Looks, collect, grow, write
from hri_pipeline.core.interactions.gaze_cues import CUES, LEAST_BELIEF, SECOND_CUES, Trees


def looks(count=4000, seed=0):
    """Right where three cues lie within limits together; some of one of them are not known."""
    rng = np.random.RandomState(seed)
    cues = rng.normal(0.0, 1.0, (count, len(CUES)))
    right = (cues[:, 0] < 0.3) & (cues[:, 1] > -0.2) & (cues[:, 2] < 0.8)
    cues[(cues[:, 0] < -0.5) & (rng.rand(count) < 0.5), 0] = np.nan
    return Looks(cues, right.astype(float), np.ones(count))


def test_grown_trees_tell_what_needs_several_cues_together():
    start, trees = grow(looks(), 30)
    fresh = looks(seed=1)
    assert ((Trees(start, trees).odds(fresh.cues) > 0.0) == fresh.right).mean() > 0.9


def test_what_is_written_gives_the_same_odds(tmp_path):
    start, trees = grow(looks(), 5)
    trees.append(((0, 1, 2), (0.25, 10.5, -0.5), (-0.5, 10.25, 0.0, 1.0, 2.0, 3.0, 4.0, 20.75)))
    write({"": (0.5, trees[:2]), "SECOND_": (start, trees)}, tmp_path / "trees.py")
    spec = importlib.util.spec_from_file_location("trees", str(tmp_path / "trees.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    cues = looks(50).cues
    for found, wanted in ((Trees(module.START, module.TREES), Trees(0.5, trees[:2])),
                          (Trees(module.SECOND_START, module.SECOND_TREES), Trees(start, trees))):
        assert found.odds(cues) == pytest.approx(wanted.odds(cues), abs=1e-3)


def test_a_world_is_another_one_for_each_seed_and_the_same_for_the_same():
    first, again, other = ([moment.image.gazes for moment in RandomWorld(4, seed).moments(4.0)] for seed in (1, 1, 2))
    assert first == again != other
    assert any(first)


def test_looks_are_collected_with_their_truth():
    found = collect(1, WHOLE)
    assert found.cues.shape == (len(found.right), len(SECOND_CUES))
    assert (found.cues[:, 0] >= LEAST_BELIEF).all()
    assert 0.1 < found.right.mean() < 0.9
    likely = found.cues[:, 0] > 0.7
    assert found.right[likely].mean() > found.right[~likely].mean() + 0.2


def test_trunks_and_voices_are_left_out_of_some_worlds():
    def last(fixed):
        return list(RandomWorld(4, 3, dict(WHOLE, **fixed)).moments(8.0))[-1].image.people
    assert np.isfinite(last({}).trunks).all() and last({}).speaking is not None
    assert np.isnan(last({"no_trunks": 1.0}).trunks).all()
    assert last({"deaf": 1.0}).speaking is None
    worlds = [RandomWorld(2, seed) for seed in range(40)]
    for name in ("no_trunks", "trunk_gaps", "deaf"):
        assert 3 < sum(world._scene[name] > 0.0 for world in worlds) < 30
