import numpy as np
import pytest

from hri_pipeline.core.one_euro import OneEuro


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
