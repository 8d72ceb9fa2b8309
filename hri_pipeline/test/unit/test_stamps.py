"""Stamps of several sources: one that lags is no jump of time, one that goes back is."""

from __future__ import annotations

import numpy as np
import pytest

from hri_pipeline.core.timing import ALL_STALE_S, MAX_SOURCES, ClockSynchroniser, Order, SourceStamps

FACES, BODIES = ("face_", b"camera"), ("body_", b"camera")


def at(seconds):
    return int(seconds), round((seconds - int(seconds)) * 1e9)


@pytest.mark.parametrize("lag", [0.6, 1.0, 4.0])
@pytest.mark.parametrize("gap", [0.1, 0.6, 1.5])
def test_a_source_that_lags_is_no_jump_even_while_the_other_one_pauses(lag, gap):
    stamps = SourceStamps()
    found = []
    for step in range(40):
        now = 100.0 + gap * step
        found += [stamps.note(FACES, at(now), now), stamps.note(BODIES, at(now - lag), now + 0.9 * gap)]
    assert set(found) == {Order.NEWER}


def test_a_source_whose_own_stamps_go_back_is_a_jump_and_the_others_follow_it():
    stamps = SourceStamps()
    for source, lag in ((FACES, 0.0), (BODIES, 2.0)):
        stamps.note(source, at(100.0 - lag), 50.0)
    assert stamps.note(FACES, at(80.0), 50.3) == Order.LATE, "it may have come late"
    assert stamps.note(FACES, at(80.3), 50.6) == Order.BACK
    assert stamps.note(BODIES, at(78.4), 50.7) == Order.NEWER, "the same jump is not told twice"
    assert stamps.note(FACES, at(80.4), 50.7) == Order.NEWER


def test_a_little_back_is_late_however_long_nothing_has_come():
    stamps = SourceStamps()
    stamps.note(FACES, at(100.0), 50.0)
    assert stamps.note(FACES, at(99.6), 60.5) == Order.LATE
    assert stamps.note(FACES, at(100.0), 60.5) == Order.LATE


def test_unknown_sources_alone_tell_a_jump_after_a_while():
    stamps = SourceStamps()
    stamps.note("person_a", at(100.0), 50.0)
    assert stamps.note("person_b", at(20.0), 50.0 + 0.9 * ALL_STALE_S) == Order.NEWER
    assert stamps.note("person_b", at(21.5), 50.0 + 1.1 * ALL_STALE_S) == Order.BACK
    assert stamps.note("person_b", at(21.6), 50.1 + 1.1 * ALL_STALE_S) == Order.NEWER


def test_the_number_of_sources_is_bounded():
    stamps = SourceStamps()
    for number in range(3 * MAX_SOURCES):
        stamps.note(number, at(number), float(number))
    assert len(stamps._newest) == MAX_SOURCES


def test_who_goes_on_as_before_is_no_jump_when_a_source_with_a_clock_ahead_has_ended():
    stamps, found = SourceStamps(), []
    for step in range(40):
        now = 100.0 + 0.5 * step
        if step < 4:
            found.append(stamps.note("ahead", at(now + 30.0), now + 0.1))
        found.append(stamps.note("other", at(now), now))
    assert set(found) == {Order.NEWER}


TOLERANCE = 0.5


@pytest.mark.parametrize("ahead", [-12.0, -0.7, 0.7, 12.0])
@pytest.mark.parametrize("first", [0, 1])
def test_sensors_whose_clocks_differ_have_one_common_time(ahead, first):
    common, offsets = ClockSynchroniser(), {"a": 0.0, "b": ahead}
    order = ["a", "b"] if first == 0 else ["b", "a"]
    times = []
    for step in range(60):
        now = 100.0 + 0.1 * step
        for sensor in order:
            if sensor == "b" and 20 <= step < 35:      # nobody is seen by it
                continue
            stamp = now + offsets[sensor]
            times.append(stamp + common.note(sensor, stamp, now, TOLERANCE))
    steps = [after - before for before, after in zip(times, times[1:])]
    assert min(steps) >= -TOLERANCE - 0.11 and max(steps) <= TOLERANCE + 0.11
    assert times[-1] - times[0] == pytest.approx(5.9, abs=2.0 * TOLERANCE)


def test_sensors_of_one_clock_are_not_shifted_by_pauses_of_any_length_or_speed():
    common = ClockSynchroniser()
    for stamp, now in ((10.0, 0.0), (10.1, 0.1), (15.0, 5.0), (35.0, 6.0), (35.1, 60.0), (35.5, 60.1)):
        assert common.note("a", stamp, now, TOLERANCE) == common.note("b", stamp + 0.05, now, TOLERANCE) == 0.0


def test_bodies_that_come_after_later_faces_do_not_shift_their_camera():
    common = ClockSynchroniser()
    for step in range(20):
        now = 100.0 + 0.1 * step
        assert common.note("a", now, now, TOLERANCE) == common.note("b", now, now, TOLERANCE) == 0.0
        assert common.note("b", now - 3.0, now, TOLERANCE) == 0.0


def test_a_camera_that_lags_for_a_while_has_its_own_stamps_again_afterwards():
    common = ClockSynchroniser()
    shifts = []
    for step in range(30):
        now = 100.0 + 0.5 * step
        common.note("a", now, now, TOLERANCE)
        shifts.append(common.note("b", now - (2.0 if 10 <= step < 20 else 0.0), now, TOLERANCE))
    assert shifts[9] == shifts[-1] == 0.0 and shifts[15] == pytest.approx(2.0, abs=TOLERANCE)


def test_a_stall_after_which_the_stamps_of_one_sensor_come_first_leaves_no_shift():
    common = ClockSynchroniser()
    for step in range(40):
        now = 100.0 + 0.1 * step
        late = 0.9 if 10 <= step < 19 else 0.0     # what came during the stall is told at once afterwards
        if not late:
            common.note("a", now, now, TOLERANCE)
            common.note("b", now, now + 0.01, TOLERANCE)
        elif step == 18:
            for stamp in np.arange(101.0, 101.8, 0.1):
                common.note("a", stamp, 101.8, TOLERANCE)
            common.note("b", 100.95, 101.8, TOLERANCE)
            common.note("a", 101.8, 101.8, TOLERANCE)
            common.note("b", 101.8, 101.81, TOLERANCE)
    assert common.shifts == {}


def test_the_number_of_sensors_is_bounded():
    common = ClockSynchroniser()
    for number in range(2 * MAX_SOURCES):
        common.note(number, 3.0 * number, 0.1 * number, TOLERANCE)
    assert len(common._latest) == MAX_SOURCES >= len(common.shifts)
