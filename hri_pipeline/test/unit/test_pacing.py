import pytest

from hri_pipeline.core.pacing import Pacer


def test_illegal_rate():
    with pytest.raises(ValueError):
        Pacer(0.0)


def test_lateness_does_not_add_up():
    pacer, now, moments = Pacer(10.0), 5.0, []
    for number in range(100):
        now += pacer.wait(now) + 0.01 * (number % 3)
        moments.append(now)
        pacer.done(now)
    assert moments[0] == 5.0
    assert moments[-1] - moments[0] == pytest.approx(9.9, abs=0.021)


def test_no_burst_after_a_stall():
    pacer = Pacer(10.0)
    pacer.done(0.0)
    pacer.done(3.0)
    assert pacer.wait(3.0) == pytest.approx(0.1)
    assert pacer.wait(3.1) == pytest.approx(0.0)
