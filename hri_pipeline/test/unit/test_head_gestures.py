"""Nods and shakes: told while they last, and of nothing else that heads do."""

import math

import numpy as np
import pytest

from hri_pipeline.core.faces.head_gestures import HeadGesture, HeadGestures, swings

RATE = 10.0


def run(yaw, pitch, seconds=4.0, distance=lambda now: 1.5, gestures=None, begin=0.0):
    """Gestures over time of a head whose angles are functions (degrees) of the time (s)."""
    gestures = gestures or HeadGestures()
    rng = np.random.RandomState(3)
    found = []
    for index in range(int(seconds * RATE)):
        now = begin + index / RATE
        noise = np.radians(rng.normal(0.0, 0.3, 2))
        found.append(gestures.update(math.radians(yaw(now)) + noise[0], math.radians(pitch(now)) + noise[1],
                                     distance(now), now))
    return found


def wave(size, frequency, begin=1.0, cycles=3.0):
    """Degrees from peak to peak, Hz, s."""
    return lambda now: (0.5 * size * math.sin(2.0 * math.pi * frequency * (now - begin))
                        if begin <= now <= begin + cycles / frequency else 0.0)


def still(now):
    return 0.0


@pytest.mark.parametrize("frequency", [1.3, 2.0, 2.7])
@pytest.mark.parametrize("size", [9.0, 20.0])
def test_a_nod_is_told_while_it_lasts_and_no_longer(frequency, size):
    found = run(still, wave(size, frequency))
    assert any(gesture.nod > 0.0 for gesture in found) and not any(gesture.shake for gesture in found)
    end = 1.0 + 3.0 / frequency
    assert not any(gesture.nod for gesture in found[int((end + 0.6) * RATE):])
    assert not any(gesture.nod for gesture in found[:int(RATE)])


def test_a_shake_is_no_nod_and_a_larger_one_is_stronger():
    small, large = (run(wave(size, 1.8), still) for size in (10.0, 14.0))
    assert not any(gesture.nod for gesture in small + large)
    assert 0.0 < max(gesture.shake for gesture in small) < max(gesture.shake for gesture in large) <= 1.0


def test_a_head_that_is_turned_nods_as_well():
    assert any(gesture.nod for gesture in run(lambda now: 35.0, wave(14.0, 2.0)))


@pytest.mark.parametrize("yaw,pitch", [
    (still, still),
    (still, wave(15.0, 0.6, cycles=1.0)),                                       # a look at the table and back
    (lambda now: 30.0 if int(now / 1.2) % 2 else -30.0, still),                 # to and fro between two people
    (wave(14.0, 1.7), wave(14.0, 1.7)),                                         # along both axes
    (still, lambda now: 8.0 * now),                                             # slowly up
    (still, wave(4.0, 2.0, cycles=6.0)),                                        # too small
])
def test_other_movements_are_neither(yaw, pitch):
    assert set(run(yaw, pitch)) == {HeadGesture()}


def test_steps_are_no_nods_and_a_nod_of_somebody_who_walks_is_one():
    def away(now):
        return 1.0 + 0.9 * now

    assert set(run(still, wave(7.0, 2.0, 0.0, 8.0), distance=away)) == {HeadGesture()}
    assert any(gesture.nod for gesture in run(still, wave(7.0, 2.0, 0.0, 8.0)))
    assert any(gesture.nod for gesture in run(still, wave(18.0, 2.0), distance=away))


def test_a_gap_a_jump_back_and_what_is_not_finite():
    gestures = HeadGestures()
    run(still, wave(16.0, 2.0, 0.0, 2.5), 1.2, gestures=gestures)
    assert gestures.update(0.0, 0.0, 1.5, 0.5) == HeadGesture()
    assert gestures.update(math.nan, 0.0, 1.5, 0.6) == HeadGesture()
    run(still, wave(16.0, 2.0, 1.0, 2.5), 1.2, gestures=gestures, begin=1.0)
    assert gestures.update(0.0, 0.0, 1.5, 5.0) == HeadGesture()


def test_swings_lie_between_the_turning_points():
    path = list(enumerate([0.0, 0.1, 0.5, 0.45, 0.5, 0.1, 0.0, 0.4]))
    found = swings(path, 0.2)
    assert [(swing.begin, swing.end) for swing in found] == [(0, 4), (4, 6), (6, 7)]
    assert [round(swing.length, 6) for swing in found] == [0.5, 0.5, 0.4]
    assert swings([], 0.2) == [] and swings(path[:2], 0.2) == []
