"""The fitting chain on motion capture, with the limits that scripts/benchmark tells in full."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.body_fit import fit_errors, motions, stature_errors, wave
from benchmarks.mocap import add_noise, before_camera, load_motion, trial_names, virtual_people
from benchmarks.report import ABSENT, data_directory
from hri_fullbody.core import keypoints as kp
from hri_fullbody.core.model.anthropometry import SegmentTable

TABLE = SegmentTable.load()
with_recordings = pytest.mark.skipif(data_directory() is None, reason=ABSENT)


def test_a_wave_is_followed_without_lag() -> None:
    lag, amplitude = wave(TABLE, 10, people=4)
    assert lag <= 30.0 and amplitude >= 0.95


def test_virtual_people_are_as_the_table_says_and_always_the_same() -> None:
    people = virtual_people(2000, 1, TABLE)
    statures = np.log([person.stature for person in people])
    assert statures.mean() == pytest.approx(TABLE.log_mean[0], abs=0.005)
    assert statures.std() == pytest.approx(np.sqrt(TABLE.log_covariance[0, 0]), rel=0.06)
    assert people[:3] == virtual_people(2000, 1, TABLE)[:3]


@with_recordings
def test_recordings_are_people_before_a_camera() -> None:
    person = virtual_people(1, 3, TABLE)[0]
    motion = before_camera(load_motion("02_01", person), 1, heading=0.0, distance=2.5)
    assert motion.points.shape[1:] == (18, 3) and motion.rate == 30.0 and "02_01" in trial_names()
    assert motion.points[:, :, 2].mean() == pytest.approx(2.6, abs=0.2)
    # Who faces the camera has the left side on the right of the image, and the head above the feet (y is down).
    assert (motion.points[:, kp.LEFT_SHOULDER, 0] > motion.points[:, kp.RIGHT_SHOULDER, 0]).all()
    assert (motion.points[:, kp.LEFT_EYE, 0] > motion.points[:, kp.RIGHT_EYE, 0]).all()
    assert (motion.points[:, kp.NOSE, 1] < motion.points[:, kp.LEFT_ANKLE, 1]).all()
    for length, start, end in ((person.upper_arm, kp.LEFT_SHOULDER, kp.LEFT_ELBOW),
                               (person.forearm, kp.RIGHT_ELBOW, kp.RIGHT_WRIST),
                               (person.thigh, kp.LEFT_HIP, kp.LEFT_KNEE),
                               (person.shank, kp.RIGHT_KNEE, kp.RIGHT_ANKLE)):
        assert np.allclose(np.linalg.norm(motion.points[:, start] - motion.points[:, end], axis=1), length)


@with_recordings
def test_the_noise_of_a_depth_camera_is_as_described() -> None:
    points = before_camera(load_motion("02_05"), 1, heading=0.0, distance=2.0).points
    noisy = add_noise(points, "rgbd", 1)
    assert np.array_equal(noisy, add_noise(points, "rgbd", 1), equal_nan=True)
    error = noisy - points
    assert np.nanmedian(np.abs(error[..., 0])) == pytest.approx(0.67 * 0.010, rel=0.15)
    assert 0.04 < np.isnan(noisy[..., 0]).mean() < 0.15
    assert 0.01 < (error[..., 2] > 0.14).mean() < 0.06
    assert np.std(add_noise(points, 20, 1) - points) == pytest.approx(0.020, rel=0.02)


@pytest.mark.slow("recorded motion, four trials")
@with_recordings
@pytest.mark.parametrize("limb_lengths, limits", [
    (True, {"10": 18.0, "30": 28.8, "rgbd": 38.8}), (False, {"10": 20.1, "30": 30.2, "rgbd": 38.9})])
def test_the_fit_stays_as_exact_as_it_was_measured(limb_lengths: bool, limits: dict) -> None:
    chosen = [motion.cut(0, 200) for motion in motions(TABLE, names=["02_01", "02_05", "02_06", "03_01"])]
    errors = fit_errors(chosen, TABLE, limb_lengths, (10, 30, "rgbd"))
    assert all(errors[level] <= limit for level, limit in limits.items()), errors


@pytest.mark.slow("recorded motion of 22 people")
@with_recordings
def test_the_stature_is_told_after_two_seconds() -> None:
    errors = stature_errors(TABLE, count=22)
    assert abs(errors.mean()) <= 0.025 and errors.std() <= 0.030
    assert stature_errors(TABLE, legs=False, count=22).std() <= 0.040
