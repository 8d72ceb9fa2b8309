import numpy as np
import pytest

from hri_pipeline.core.timing import (
    ALL_STALE_S,
    ClockWatch,
    Pacer,
    StageTimes,
    StaleStampFilter,
    StampPacer,
    clock_fault,
    clock_went_back,
)


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


@pytest.mark.parametrize("count", [1, 2, 3, 20, 99, 100])
def test_times_of_a_stage_have_the_percentiles_of_numpy(count):
    seconds = np.random.default_rng(count).uniform(size=count)
    times = StageTimes()
    for value in seconds.tolist():
        times.add("mesh", value)
    assert times.summary()["mesh"] == pytest.approx(np.percentile(1e3 * seconds, (50, 95)).tolist())


def test_a_clock_that_goes_back_is_told_with_the_remedy():
    text = clock_went_back(12.34, simulated=True)
    assert text.startswith("/clock went back by 12.3 s") and "one program only publish /clock" in text
    text = clock_went_back(300.0, simulated=False)
    assert text.startswith("the clock of this machine was set back by 300.0 s") and "/clock" not in text


def test_the_parts_of_a_stage_are_one_time():
    ticks = iter([0.0, 0.010, 1.0, 1.030, 5.0, 5.002])
    times = StageTimes(clock=lambda: next(ticks))
    with times.in_parts("poses") as part:
        with part():
            pass
        with part():
            pass
        assert times.summary() == {}
    with times.in_parts("poses"):
        pass
    assert times.summary()["poses"] == (pytest.approx(40.0), pytest.approx(40.0)), "no time where nothing was done"
    with pytest.raises(KeyError):
        with times.in_parts("more") as part, part():
            raise KeyError("counted all the same")
    assert times.summary()["more"] == (pytest.approx(2.0), pytest.approx(2.0))


@pytest.mark.parametrize("given, wanted, expected", [
    (30.0, 15.0, 15.0), (20.0, 15.0, 15.0), (10.0, 15.0, 10.0), (60.0, 15.0, 15.0), (25.0, 0.0, 25.0),
    (16.0, 15.0, 15.0)])
def test_the_rate_is_that_asked_for_on_average(given, wanted, expected):
    pacer = StampPacer(wanted)
    stamps = 1e9 + np.arange(0.0, 40.0, 1.0 / given)
    taken = [stamp for stamp in stamps if pacer.is_due(stamp)]
    assert len(taken) / 40.0 == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("given, wanted, expected", [
    (30.0, 30.0, 30.0), (30.0, 15.0, 15.0), (60.0, 30.0, 30.0), (31.0, 30.0, 30.0), (20.0, 15.0, 15.0),
    (25.0, 30.0, 25.0), (30.0, 0.0, 30.0)])
def test_images_whose_arrival_trembles_are_taken_as_they_come(given, wanted, expected):
    rng = np.random.default_rng(3)
    pacer = StampPacer(wanted, 0.4)
    arrivals = 1e3 + np.cumsum(np.full(4000, 1.0 / given)) + rng.uniform(0.0, 0.3 / given, 4000)
    taken = np.array([arrival for arrival in arrivals if pacer.is_due(arrival)])
    assert len(taken) * given / 4000.0 == pytest.approx(expected, rel=0.02)
    for start in taken:
        assert np.sum((taken >= start) & (taken < start + 1.0)) <= expected + 2


def test_of_twice_as_many_images_every_second_one_is_taken():
    rng = np.random.default_rng(4)
    pacer = StampPacer(15.0, 0.4)
    arrivals = np.arange(600) / 30.0 + rng.uniform(0.0, 0.006, 600)
    taken = [number for number, arrival in enumerate(arrivals) if pacer.is_due(arrival)]
    assert taken == list(range(0, 600, 2))


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


def test_a_clock_that_stands_still_is_told_until_it_goes_on_in_either_direction():
    watch = ClockWatch()
    steps = [(0.0, 100.0), (0.0, 103.0), (5.0, 104.0), (5.0, 104.5), (5.0, 120.0), (4.0, 121.0), (4.0, 122.0)]
    assert [watch.stood_still(*step) for step in steps] == [0.0, 3.0, 0.0, 0.5, 16.0, 0.0, 1.0]


def test_another_rate_of_joint_states():
    pacer = StampPacer(10.0)
    stamps = np.arange(0.0, 1.0, 0.05)
    assert sum(pacer.is_due(stamp) for stamp in stamps) == 10
    pacer.set_rate(5.0)
    assert sum(pacer.is_due(stamp) for stamp in stamps + 1.0) == 5
    pacer.set_rate(0.0)
    assert sum(pacer.is_due(stamp) for stamp in stamps + 2.0) == 20


def test_what_was_on_its_way_when_a_bag_began_anew_is_of_the_stale_stamps():
    old = StaleStampFilter()
    assert not old.is_stale(120.0, 100.0, 0.0), "a camera whose clock is ahead"
    old.went_back(20.0, 5.0)
    assert old.is_stale(119.9, 100.1, 5.1) and old.is_stale(118.0, 103.0, 8.0)
    assert not old.is_stale(100.05, 100.1, 5.1), "what is new"
    assert not old.is_stale(101.0, 100.1, 5.1), "a camera whose clock is a little ahead"
    assert not old.is_stale(111.5, 111.6, 6.0), "what is new when the bag is played faster"
    assert not old.is_stale(119.9, 100.1, 5.0 + ALL_STALE_S), "not for ever"


WALL = 1795709036.0     # 2026-11-26


@pytest.mark.parametrize("stamp, now, simulated, what, remedy", [
    (WALL - 3.0, WALL, False, "3.0 s old when they arrive", "clocks of the machines"),
    (WALL - 7200.0, WALL, False, "7200.0 s old when they arrive", "--clock and /use_sim_time true"),
    (WALL + 60.0, WALL, False, "60.0 s in the future", "clocks of the machines"),
    (50.0, 42.5, True, "7.5 s in the future", "publish /clock"),
    (0.1, WALL, False, "simulated time (0.1 s)", "rosparam set /use_sim_time true"),
    (WALL - 400 * 86400.0, WALL, False, "2025-10-22", "--clock"),
    (WALL - 0.2, 42.5, True, "wall clock", "rosparam set /use_sim_time false"),
    (WALL - 400 * 86400.0, 42.5, True, "2025-10-22", "/clock"),
    (40.0, 42.5, True, "2.5 s old when they arrive", "faster than"),
    (1.0, WALL - 400 * 86400.0, True, "simulated time (1.0 s)", "/clock"),
])
def test_stamps_of_another_clock_are_told_with_that_clock(stamp, now, simulated, what, remedy):
    told, mend = clock_fault(now - stamp, now, WALL, simulated)
    assert what in told and remedy in mend
    assert "17957090" not in told and len(told) < 120 and len(mend) < 200
