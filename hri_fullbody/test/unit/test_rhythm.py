"""When something is done again: images by their stamps, processes after they ended."""

from __future__ import annotations

import numpy as np
import pytest

from hri_fullbody.core.stamp_pacer import StampPacer
from hri_pipeline.core.restart_policy import LONGEST_WAIT_S, PROVEN_S, RestartPolicy


@pytest.mark.parametrize("given, wanted, expected", [
    (30.0, 15.0, 15.0), (20.0, 15.0, 15.0), (10.0, 15.0, 10.0), (60.0, 15.0, 15.0), (25.0, 0.0, 25.0), (16.0, 15.0, 15.0)])
def test_the_rate_is_that_asked_for_on_average(given, wanted, expected):
    pacer = StampPacer(wanted)
    stamps = 1e9 + np.arange(0.0, 40.0, 1.0 / given)
    taken = [stamp for stamp in stamps if pacer.is_due(stamp)]
    assert len(taken) / 40.0 == pytest.approx(expected, rel=0.02)


def test_an_uneven_camera_gets_no_bursts():
    pacer = StampPacer(15.0)
    rng = np.random.default_rng(1)
    stamps = np.cumsum(rng.uniform(0.01, 0.2, 2000))
    taken = np.array([stamp for stamp in stamps if pacer.is_due(stamp)])
    assert np.all(np.diff(taken) > 0.0)
    for start in taken:
        assert np.sum((taken >= start) & (taken < start + 1.0)) <= 16


def test_a_stamp_is_never_taken_twice_and_a_reset_starts_anew():
    pacer = StampPacer(0.0)
    assert pacer.is_due(5.0) and not pacer.is_due(5.0) and not pacer.is_due(4.0)
    pacer.reset()
    assert pacer.is_due(1.0)
    with pytest.raises(ValueError):
        StampPacer(-1.0)
    with pytest.raises(ValueError):
        StampPacer(float("nan"))


def test_waits_grow_and_end_after_a_good_run():
    policy = RestartPolicy()
    waits = [policy.ended(0.3) for _ in range(12)]
    assert waits[:4] == [0.0, 0.5, 1.0, 2.0] and waits[-1] == LONGEST_WAIT_S
    assert policy.ended(PROVEN_S) == 0.0
    assert policy.ended(0.3) == 0.5
