"""Sources made of peaks: birth, silence, death, overlap, crossing, ghosts."""

import numpy as np
import pytest

from hri_pipeline.core.sound.direction_tracker import DirectionTracker
from hri_pipeline.core.sound.sound_direction import Peak

STEP = 0.032


def peak(azimuth, strength=0.15):
    a = np.radians(azimuth)
    return Peak(np.array([np.cos(a), np.sin(a), 0.0]), strength)


def azimuth_of(source):
    return float(np.degrees(np.arctan2(source.direction[1], source.direction[0])))


def follow(tracker, moments, start=0.0):
    """Feed lists of peaks STEP apart; returns {key: azimuth} after each."""
    return [{source.key: azimuth_of(source) for source in tracker.update(peaks, start + index * STEP)}
            for index, peaks in enumerate(moments)]


def tracker(birth=0.1, memory=5.0, most=4):
    return DirectionTracker(birth, memory, most)


@pytest.mark.parametrize("arguments", [(-0.1, 1.0, 4), (0.1, 0.0, 4), (0.1, 1.0, 0), (float("nan"), 1.0, 4)])
def test_illegal_constructions(arguments):
    with pytest.raises(ValueError):
        DirectionTracker(*arguments)


@pytest.mark.parametrize("step", [0.01, 0.032, 0.1])
def test_birth_takes_its_time_whatever_the_rate(step):
    sources = tracker(birth=0.3)
    stamps = np.arange(0.0, 1.0, step)
    known = [len(sources.update([peak(30.0)], stamp)) for stamp in stamps]
    born = stamps[known.index(1)]
    assert 0.3 - 1e-9 <= born <= 0.3 + step


def test_one_peak_is_nobody():
    sources = tracker(birth=0.0)
    assert follow(sources, [[peak(10.0, 0.06)]] + [[]] * 50)[-1] == {}


def test_a_still_source_keeps_its_key_and_its_direction_becomes_sure():
    random = np.random.RandomState(0)
    sources = tracker()
    seen = follow(sources, [[peak(random.normal(179.0, 4.0))] for _ in range(500)])
    assert set(seen[-1]) == {1}
    errors = [abs((moment[1] - 179.0 + 180.0) % 360.0 - 180.0) for moment in seen[100:]]
    assert np.mean(errors) < 2.0
    first, last = seen[4:][0], sources.update([peak(179.0)], 500 * STEP)[0]
    assert first and last.sd < np.radians(5.0)


def test_silence_keeps_the_key_until_the_memory_ends():
    sources = tracker(memory=2.0)
    follow(sources, [[peak(40.0)]] * 20)
    quiet = sources.update([], 20 * STEP + 1.0)
    assert [source.active for source in quiet] == [False]
    again = follow(sources, [[peak(43.0)]] * 10, start=2.0)
    assert set(again[-1]) == {1}
    assert sources.update([], 2.0 + 10 * STEP + 2.1) == []
    later = follow(sources, [[peak(43.0)]] * 20, start=6.0)
    assert set(later[-1]) == {2}


def test_two_who_speak_at_once_are_two():
    random = np.random.RandomState(1)
    sources = tracker()
    moments = []
    for _ in range(300):
        both = [peak(random.normal(0.0, 3.0)), peak(random.normal(60.0, 3.0), 0.08)]
        # Now and then only one of them has a peak, and the order says nothing.
        random.shuffle(both)
        moments.append(both[:1 + (random.uniform() < 0.7)])
    seen = follow(sources, moments)
    assert {key for moment in seen for key in moment} == {1, 2}
    assert all(abs(moment[key] - azimuth) < 8.0 for moment in seen[50:]
               for key, azimuth in zip(sorted(moment, key=moment.get), (0.0, 60.0)))


def test_two_who_pass_each_other_keep_their_keys():
    sources = tracker()
    azimuths = [(-60.0 + 30.0 * t, 60.0 - 30.0 * t) for t in np.arange(0.0, 4.0, STEP)]
    moments = []
    for a, b in azimuths:
        # Closer than the array can tell them apart, they are one peak.
        moments.append([peak(a), peak(b)] if abs(a - b) > 25.0 else [peak((a + b) / 2.0)])
    seen = follow(sources, moments)
    early, late = seen[20], seen[-1]
    assert set(early) == set(late) == {1, 2}
    for key in early:
        assert early[key] * late[key] < 0.0


def test_a_peak_between_two_speakers_is_no_third():
    sources = tracker()
    follow(sources, [[peak(0.0), peak(50.0)]] * 30)
    seen = follow(sources, [[peak(25.0, 0.1)]] * 4 + [[peak(0.0), peak(50.0)]] * 30, start=30 * STEP)
    assert set(seen[-1]) == {1, 2}
    assert seen[-1][1] == pytest.approx(0.0, abs=4.0)


def test_when_all_places_are_taken_the_one_silent_longest_goes():
    sources = tracker(most=2)
    follow(sources, [[peak(0.0)]] * 20)
    follow(sources, [[peak(90.0)]] * 40, start=20 * STEP)
    # The third has to wait until somebody was silent for a second.
    seen = follow(sources, [[peak(90.0), peak(-90.0)]] * 20, start=60 * STEP)
    assert set(seen[-1]) == {2, 3}
    full = follow(sources, [[peak(90.0), peak(-90.0), peak(180.0)]] * 60, start=80 * STEP)
    assert all(set(moment) == {2, 3} for moment in full)


def test_reset_forgets_but_gives_no_key_twice():
    sources = tracker()
    follow(sources, [[peak(0.0)]] * 10)
    sources.reset()
    assert set(follow(sources, [[peak(0.0)]] * 10)[-1]) == {2}


def test_time_that_stands_still_does_no_harm():
    sources = tracker(birth=0.0)
    for _ in range(20):
        found = sources.update([peak(12.0)], 5.0)
    assert len(found) == 1 and np.isfinite(found[0].direction).all()


def test_a_direction_that_is_not_sure_is_no_source_until_it_is():
    sources = tracker()
    hiss = [Peak(peak(30.0).direction, 0.15, False), Peak(peak(-31.0).direction, 0.12, False)]
    assert not any(follow(sources, [hiss] * 20))
    known = follow(sources, [[peak(30.0, 0.2)] + hiss[1:]] * 20, start=20 * STEP)
    assert [round(azimuth) for azimuth in known[-1].values()] == [30]
