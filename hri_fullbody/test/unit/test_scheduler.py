"""Who gets the pose network, and which images give joint states."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_people import standing_at

from hri_fullbody.core.detection.pose_estimator import PoseDetection
from hri_fullbody.core.tracking.scheduler import PoseScheduler, StampPacer
from hri_fullbody.core.tracking.track import BodyTrack
from hri_pipeline.core.tracks import TrackLife


@pytest.mark.parametrize("given, wanted, expected", [
    (30.0, 15.0, 15.0), (20.0, 15.0, 15.0), (10.0, 15.0, 10.0), (60.0, 15.0, 15.0), (25.0, 0.0, 25.0),
    (16.0, 15.0, 15.0)])
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


def tracks(count, stamp=0.0):
    made = []
    for index in range(count):
        track = BodyTrack("b{}".format(index), PoseDetection(standing_at(100 + 100 * index, 400)), stamp,
                          TrackLife(stamp, 0.0, 1.0))
        made.append(track)
    return made


@pytest.mark.parametrize("count, rate, fps", [(1, 10.0, 20.0), (3, 10.0, 20.0), (2, 10.0, 15.0), (10, 8.0, 30.0)])
def test_every_body_gets_its_rate_and_the_images_an_even_load(count, rate, fps):
    schedule, known, looks, load = PoseScheduler(rate), tracks(count), {}, []
    for index in range(1, int(10 * fps) + 1):
        stamp = index / fps
        chosen = schedule.choose(known, stamp)
        load.append(len(chosen))
        for track in chosen:
            track.inferred_at = stamp
            looks[track.id] = looks.get(track.id, 0) + 1
    assert list(looks.values()) == pytest.approx([rate * 10] * count, rel=0.05)
    assert max(load[1:]) - min(load[1:]) <= 1


def test_a_rate_above_that_of_the_images_is_every_image():
    schedule, known = PoseScheduler(10.0), tracks(4)
    for index in range(1, 20):
        chosen = schedule.choose(known, index * 0.2)
        for track in chosen:
            track.inferred_at = index * 0.2
        assert index == 1 or len(chosen) == 4


def test_a_budget_is_shared_fairly_and_never_exceeded():
    schedule, known, longest = PoseScheduler(0.0, budget=3), tracks(10), 0.0
    for index in range(1, 100):
        stamp = index * 0.05
        chosen = schedule.choose(known, stamp)
        assert len(chosen) == 3
        for track in chosen:
            longest = max(longest, stamp - track.inferred_at)
            track.inferred_at = stamp
    assert longest <= 0.05 * 4 + 1e-9


def test_what_is_reserved_is_left_but_for_one_look():
    schedule, known = PoseScheduler(0.0, budget=3), tracks(10)
    assert [len(schedule.choose(known, 1.0 + reserved, reserved)) for reserved in range(5)] == [3, 2, 1, 1, 1]


def test_the_newborn_come_first():
    known = tracks(3, 0.0)
    known[1].inferred_at = 0.3
    known[1].life = TrackLife(0.0, 0.1, 1.0)
    schedule = PoseScheduler(0.0, budget=1)
    # It waits for a third of the time of the others, which counts three times as much.
    assert [track.id for track in schedule.choose(known, 0.44)] == ["b0"]
    assert [track.id for track in schedule.choose(known, 0.46)] == ["b1"]
    known[1].inferred_at = 0.0
    assert [track.id for track in schedule.choose(known, 0.5)] == ["b1"]


@pytest.mark.parametrize("rate, budget", [(-1.0, 0), (1.0, -1)])
def test_negative_rates_are_refused(rate, budget):
    with pytest.raises(ValueError):
        PoseScheduler(rate, budget)


def test_another_rate_of_joint_states():
    pacer = StampPacer(10.0)
    stamps = np.arange(0.0, 1.0, 0.05)
    assert sum(pacer.is_due(stamp) for stamp in stamps) == 10
    pacer.set_rate(5.0)
    assert sum(pacer.is_due(stamp) for stamp in stamps + 1.0) == 5
    pacer.set_rate(0.0)
    assert sum(pacer.is_due(stamp) for stamp in stamps + 2.0) == 20
