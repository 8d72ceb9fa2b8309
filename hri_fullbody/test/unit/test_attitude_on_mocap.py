"""Attitudes on motion capture: arms of recorded people moved into an attitude, and walking as it is."""

import numpy as np
import pytest

from benchmarks import attitude as clips
from benchmarks import kinect_clips
from benchmarks.attitude import Event, bend_arm, by_class, detect, events_of
from benchmarks.report import ABSENT, data_directory
from hri_fullbody.core.behaviour.attitude import AttitudeClass

needs_recordings = pytest.mark.skipif(data_directory() is None, reason=ABSENT)


@pytest.mark.slow("recorded motion")
@needs_recordings
@pytest.mark.parametrize("noise", (0, "rgbd"))
def test_made_attitudes_are_found_on_recordings_that_nothing_was_tuned_on(noise):
    positives = clips.positive_clips(clips.HELD_OUT, 1, seed=11)
    table = by_class(positives, detect(positives, noise, seed=3), clips.HELD_OUT)
    assert len(table) == len(AttitudeClass) - 1      # all but "other"
    for name, row in table.items():
        assert row["events"] == len(clips.HELD_OUT), name
        # One of six may be missed.
        assert row["recall"] >= 0.8 and row["precision"] >= 0.8, (name, row)


@pytest.mark.slow("recorded motion")
@needs_recordings
@pytest.mark.parametrize("noise", (0, "rgbd"))
def test_nobody_who_walks_or_runs_shows_anything(noise):
    walks = clips.natural_clips(clips.WALKING, 2, seed=12)
    assert walks and all(not clip.truths for clip in walks)
    assert detect(walks, noise, seed=4) == [[] for _ in walks]


@needs_recordings
def test_moved_arms_keep_their_bones_and_all_else_stays():
    clip = clips.positive_clips(["02_01"], 1, seed=13)[1]
    points = clip.motion.points
    for shoulder in (2, 5):
        for joint in (0, 1):
            lengths = np.linalg.norm(points[:, shoulder + joint + 1] - points[:, shoulder + joint], axis=1)
            assert np.ptp(lengths) < 0.002
    assert clip.truths[0].attitude == AttitudeClass.ARMS_CROSSED and np.isfinite(points).all()
    steps = np.linalg.norm(np.diff(points, axis=0), axis=2)
    assert steps.max() < 0.25  # no jumps: 7.5 m/s at 30 Hz


def test_a_bent_arm_reaches_what_is_in_reach():
    shoulder, pole = np.zeros((2, 3)), np.array([[0.0, 0.0, -1.0]] * 2)
    target = np.array([[0.3, 0.1, 0.0], [9.0, 0.0, 0.0]])
    elbow, wrist = bend_arm(shoulder, target, pole, 0.28, 0.26)
    assert wrist[0] == pytest.approx(target[0]) and elbow[0, 2] < -0.05
    assert np.linalg.norm(elbow, axis=1) == pytest.approx([0.28, 0.28])
    assert np.linalg.norm(wrist - elbow, axis=1) == pytest.approx([0.26, 0.26])
    assert wrist[1] == pytest.approx([0.54, 0.0, 0.0], abs=0.001)


def test_runs_close_together_are_one_event():
    attitudes = np.array([0, 3, 3, 0, 3, 3, 0, 0, 0, 0, 0, 3, 0])
    assert events_of(attitudes, np.arange(13) / 10.0) == [
        Event(AttitudeClass.HANDS_RAISED, 0.1, 0.5), Event(AttitudeClass.HANDS_RAISED, 1.1, 1.1)]


def test_recall_and_precision_count_events():
    class Motion:
        points, rate = np.zeros((600, 18, 3)), 10.0

    truth = clips.Truth(AttitudeClass.ARMS_CROSSED, 2.0, 4.0, True)
    scored = [clips.Clip("a", Motion(), (truth,)), clips.Clip("a", Motion(), (truth,)), clips.Clip("a", Motion(), ())]
    crossed = AttitudeClass.ARMS_CROSSED
    found = [[Event(crossed, 2.5, 4.2)], [Event(crossed, 3.5, 4.5)], [Event(crossed, 1.0, 2.0)]]
    row = by_class(scored, found, ["a"])["arms_crossed"]
    assert row == {"recall": 0.5, "precision": 0.5, "false_per_minute": 0.33, "events": 2, "false_events": 1}


@needs_recordings
def test_people_before_a_depth_camera_cross_their_arms_and_others_do_not():
    clips_of_one = [clip for clip in kinect_clips.load_clips([5]) if clip.action in (6, 2, 14, 16)]
    for clip in clips_of_one:
        told = kinect_clips.behaviour(clip.points, clip.stature, 10, seed=5)
        found = any(each.attitude == AttitudeClass.ARMS_CROSSED for each in told)
        assert found == (clip.action == kinect_clips.CROSS_ARMS), clip.action
