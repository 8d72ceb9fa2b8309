"""The gate and the low pass of key points: what passes, what does not, what time does to them."""

from __future__ import annotations

import numpy as np
import pytest

from hri_fullbody.core.filtering import FilterSettings, KeypointFilter
from hri_pipeline.core.image_rotation import ImageRotation

RATE = 30.0
WRIST = 4


@pytest.fixture
def still() -> np.ndarray:
    """Key points (18, 3) m of something that stands 2 m away."""
    return np.random.default_rng(1).uniform(-0.5, 0.5, (18, 3)) + [0.0, 0.0, 2.0]


def run(points: np.ndarray, keypoint_filter: KeypointFilter, start: float = 0.0) -> np.ndarray:
    """Filter (T, 18, 3) of one body at 30 Hz."""
    return np.stack([keypoint_filter.update(["a"], frame[None], start + n / RATE).smooth[0]
                     for n, frame in enumerate(points)])


@pytest.mark.parametrize("name, value", [
    ("process_noise_scale", 0.0), ("process_noise_scale", -1.0), ("process_noise_scale", float("nan")), ("gate", 0.0),
    ("gate_speed", -1.0), ("memory", 0.0)])
def test_illegal_settings_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        FilterSettings(**{name: value})


@pytest.mark.parametrize("points, stamp", [
    (np.zeros((1, 17, 3)), 0.0), (np.zeros((2, 18, 3)), 0.0), (np.zeros((1, 18, 3)), float("nan"))])
def test_wrong_input_is_refused(points: np.ndarray, stamp: float) -> None:
    with pytest.raises(ValueError, match="shape"):
        KeypointFilter().update(["a"], points, stamp)


def test_the_first_points_come_out_as_they_are(still: np.ndarray) -> None:
    assert np.array_equal(run(still[None], KeypointFilter())[0], still)


def test_noise_at_rest_becomes_less(still: np.ndarray) -> None:
    noise = np.random.default_rng(2).normal(size=(90, 18, 3)) * 0.02
    filtered = run(still + noise, KeypointFilter())
    assert (filtered[30:] - still).std() < 0.35 * noise.std()


def test_the_noise_is_told_for_each_axis(still: np.ndarray) -> None:
    noise, keypoint_filter = np.random.default_rng(3).normal(size=(120, 18, 3)) * [0.01, 0.01, 0.04], KeypointFilter()
    for n, frame in enumerate(still + noise):
        told = keypoint_filter.update(["a"], frame[None], n / RATE).noise[0]
    assert told == pytest.approx([0.01, 0.01, 0.04], rel=0.35)


def test_a_wave_keeps_amplitude_and_time(still: np.ndarray) -> None:
    stamps = np.arange(150) / RATE
    moving = np.tile(still, (150, 1, 1))
    moving[:, WRIST, 0] += 0.15 * np.sin(2.0 * np.pi * 1.5 * stamps)
    moving += np.random.default_rng(4).normal(size=moving.shape) * 0.01
    wrist = run(moving, KeypointFilter())[30:, WRIST, 0] - still[WRIST, 0]
    angle = 2.0 * np.pi * 1.5 * stamps[30:]
    sine, cosine = 2.0 * np.mean(wrist * np.sin(angle)), 2.0 * np.mean(wrist * np.cos(angle))
    assert np.hypot(sine, cosine) > 0.95 * 0.15
    assert np.arctan2(-cosine, sine) / (2.0 * np.pi * 1.5) < 0.030


def test_an_outlier_is_taken_for_missing_and_the_next_point_is_believed(still: np.ndarray) -> None:
    points = np.tile(still, (30, 1, 1))
    points[20, WRIST, 2] += 0.6
    filtered = run(points, KeypointFilter())
    assert np.isnan(filtered[20, WRIST]).all()
    assert np.allclose(np.delete(filtered[20], WRIST, axis=0), np.delete(still, WRIST, axis=0))
    assert np.allclose(filtered[21, WRIST], still[WRIST])


def test_a_point_that_stays_elsewhere_is_believed_at_once_it_is_sure(still: np.ndarray) -> None:
    points = np.tile(still, (60, 1, 1))
    points[30:, WRIST, 2] += 0.6
    filtered = run(points, KeypointFilter())
    believed = np.flatnonzero(~np.isnan(filtered[30:, WRIST, 0]))[0]
    assert 2 <= believed <= 6
    assert np.allclose(filtered[30 + believed, WRIST], points[40, WRIST])


def test_outliers_at_ever_other_places_are_not_believed(still: np.ndarray) -> None:
    points = np.tile(still, (40, 1, 1))
    points[30:36, WRIST, 2] += [1.5, 0.5, 1.0, 2.0, 0.5, 1.5]
    assert np.isnan(run(points, KeypointFilter())[30:36, WRIST]).all()


def test_a_body_that_jumps_as_a_whole_keeps_its_points(still: np.ndarray) -> None:
    points = np.tile(still, (40, 1, 1))
    points[30:] += [0.0, 0.0, 0.7]
    assert not np.isnan(run(points, KeypointFilter())).any()


def test_missing_points_stay_missing_and_come_back_without_delay(still: np.ndarray) -> None:
    points = np.tile(still, (60, 1, 1))
    points[20:40, WRIST] = np.nan
    points[40:, WRIST] += [0.5, 0.0, 0.0]
    filtered = run(points, KeypointFilter())
    assert np.isnan(filtered[20:40, WRIST]).all()
    assert np.allclose(filtered[40, WRIST], points[40, WRIST])
    assert not np.isnan(np.delete(filtered, WRIST, axis=1)).any()


@pytest.mark.parametrize("start", [-5.0, 5.0])
def test_time_that_jumps_starts_a_body_anew(still: np.ndarray, start: float) -> None:
    keypoint_filter = KeypointFilter()
    run(np.tile(still, (30, 1, 1)), keypoint_filter)
    assert np.array_equal(run(still[None] + 1.0, keypoint_filter, start)[0], still + 1.0)


def test_the_same_stamp_returns_the_last_result(still: np.ndarray) -> None:
    keypoint_filter = KeypointFilter()
    run(np.tile(still, (5, 1, 1)), keypoint_filter)
    again = keypoint_filter.update(["a"], still[None] + 0.05, 4 / RATE)
    assert np.allclose(again.smooth[0], still)


def test_bodies_do_not_touch_each_other(still: np.ndarray) -> None:
    noisy = still + np.random.default_rng(5).normal(size=(30, 18, 3)) * 0.02
    alone, together = KeypointFilter(), KeypointFilter()
    for n, frame in enumerate(noisy):
        one = alone.update(["a"], frame[None], n / RATE)
        others = np.stack([np.full((18, 3), np.nan), frame, frame + 3.0 * (n % 2)])
        names = ["x", "a", "y"]
        if n % 3 == 0:
            names, others = names[::-1], others[::-1]
        all_of_them = together.update(names, others, n / RATE)
        assert np.array_equal(all_of_them.smooth[1], one.smooth[0])
    together.retain(["a"])
    assert np.array_equal(together.update(["a"], still[None], 1.0).smooth, alone.update(["a"], still[None], 1.0).smooth)


def test_numbers_that_are_none_count_as_missing(still: np.ndarray) -> None:
    points = still.copy()
    points[3], points[5], points[7] = np.inf, [1e9, 0.0, 0.0], [np.nan, 0.0, 1.0]
    filtered = run(np.tile(points, (5, 1, 1)), KeypointFilter())
    assert np.isnan(filtered[:, [3, 5, 7]]).all()
    assert np.isfinite(np.delete(filtered, [3, 5, 7], axis=1)).all()


def test_a_steady_motion_is_followed_with_little_lag(still: np.ndarray) -> None:
    moving = still + np.arange(90)[:, None, None] / RATE * np.array([1.0, 0.0, 0.0])
    noisy = moving + np.random.default_rng(6).normal(size=moving.shape) * 0.01
    apart = (run(noisy, KeypointFilter()) - moving)[30:, :, 0]
    assert abs(apart.mean()) < 0.008 and apart.std() < 0.008  # 8 ms


def test_more_agility_trembles_more(still: np.ndarray) -> None:
    noisy = still + np.random.default_rng(7).normal(size=(90, 18, 3)) * 0.02
    calm, agile = (
        run(noisy, KeypointFilter(FilterSettings(process_noise_scale=process_noise_scale)))[30:].std(axis=0).mean()
        for process_noise_scale in (0.3, 10.0)
    )
    assert calm < 0.6 * agile


def test_who_walks_out_from_behind_a_counter_keeps_the_points_that_were_seen(still: np.ndarray) -> None:
    """What was hidden is seen again far from where it was: that is no common motion of the body."""
    points = still + np.linspace([0.0, 0.0, 0.0], [2.0, 0.0, 0.0], 60)[:, None]
    points[5:50, [3, 4, *range(6, 14)]] = np.nan
    filtered = run(points, KeypointFilter())
    assert np.isfinite(filtered[50:]).all()


def test_who_leaves_is_forgotten_and_nobody_else(still: np.ndarray) -> None:
    keypoint_filter, away = KeypointFilter(), still + [0.0, 0.0, 1.0]
    away[WRIST, 0] += 0.6
    for number in range(10):
        keypoint_filter.update(["a", "b"], np.stack([still, still]), number / RATE)
    keypoint_filter.update(["c"], still[None], 9.5 / RATE)
    keypoint_filter.retain(["b", "c"])
    smooth = keypoint_filter.update(["a", "b", "c"], np.stack([away, away, away]), 10.0 / RATE).smooth
    assert np.allclose(smooth[0], away), "somebody new"
    assert np.isnan(smooth[1:, WRIST]).all() and np.isfinite(np.delete(smooth[1:], WRIST, axis=1)).all()


def test_a_body_of_an_image_that_is_known_changes_no_other_one(still: np.ndarray) -> None:
    keypoint_filter = KeypointFilter()
    for number in range(10):
        first = keypoint_filter.update(["a"], still[None] + 0.01 * number, number / RATE).smooth
    both = keypoint_filter.update(["a", "b"], np.stack([still + 0.5, still]), 9.0 / RATE).smooth
    assert np.array_equal(both[0], first[0]) and np.array_equal(both[1], still)
    assert np.array_equal(keypoint_filter.update(["b"], still[None] + 0.5, 9.0 / RATE).smooth[0], still)


def test_an_outlier_that_comes_again_is_no_place_where_it_stayed(still: np.ndarray) -> None:
    points = np.tile(still, (50, 1, 1))
    points[10::10, WRIST, 2] += 0.6
    assert np.isnan(run(points, KeypointFilter())[10::10, WRIST]).all()


def test_who_was_away_for_a_while_is_no_noise(still: np.ndarray) -> None:
    noise = np.random.default_rng(5).normal(size=(80, 18, 3)) * 0.01
    points, keypoint_filter, told = still + noise, KeypointFilter(), []
    points[40:] += 1.0
    for number, frame in enumerate(points):
        stamp = number / RATE + (1.0 if number >= 40 else 0.0)
        told.append(keypoint_filter.update(["a"], frame[None], stamp).noise[0])
    assert np.max(told[30:]) < 0.015


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_turned_frame_is_no_motion(still: np.ndarray, quarters: int) -> None:
    points = np.tile(still, (40, 1, 1)) + np.random.default_rng(6).normal(size=(40, 18, 3)) * [0.002, 0.02, 0.01]
    keypoint_filter, rotation = KeypointFilter(), ImageRotation(quarters, 640, 480)
    run(points, keypoint_filter)
    before = keypoint_filter.update(["a"], still[None], 40.0 / RATE).noise[0]
    keypoint_filter.turn(rotation)
    found = keypoint_filter.update(["a"], rotation.vectors(still)[None], 41.0 / RATE)
    assert np.abs(found.smooth[0] - rotation.vectors(still)).max() < 0.02
    assert (found.noise[0][0] > found.noise[0][1]) == (quarters != 2) and before[0] < before[1]
