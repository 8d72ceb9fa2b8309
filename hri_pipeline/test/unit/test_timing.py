import pytest

from hri_pipeline.core.timing import Pacer, StageTimes


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
