"""Stature and lengths from key points of people whose lengths are known."""

from __future__ import annotations

import numpy as np
import pytest

from hri_fullbody.core.human.human_model import PAPER, Dimensions
from hri_fullbody.core.human.person_dimensions import DimensionSettings, PersonDimensions
from hri_fullbody.core.human.segment_table import SEGMENTS, SegmentTable
from hri_fullbody.core.human.stature import MONOCULAR, StatureEstimator, robust_lengths
from hri_fullbody.core.joints.forward_kinematics import forward

TABLE = SegmentTable.load()
LEGS = [9, 10, 12, 13]


def key_points(stature: float, frames: int, sigma: float, seed: int = 1, **lengths: float) -> np.ndarray:
    """Noisy key points (frames, 18, 3) m of one pose."""
    dimensions = Dimensions.from_segments(stature, lengths, TABLE)
    q = np.zeros((1, len(PAPER.joint_names)))
    q[0, [PAPER.joint_names.index(name) for name in ("l_p_shoulder", "r_elbow", "l_p_hip")]] = 0.6, 0.8, 0.3
    points, _, _ = forward(np.eye(3)[None], np.zeros((1, 3)), q, [dimensions], PAPER)
    return points + np.random.default_rng(seed).normal(size=(frames, 18, 3)) * sigma


def estimated(points: np.ndarray) -> StatureEstimator:
    """Return an estimator that has seen (T, 18, 3) at 30 Hz."""
    estimator = StatureEstimator(TABLE)
    for n, frame in enumerate(points):
        estimator.add(frame, n / 30.0)
    return estimator


@pytest.mark.parametrize("name", ["window", "scale_sd", "max_rate"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_illegal_settings_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        StatureEstimator(TABLE, **{name: value})


def test_without_measurements_it_is_the_tables_adult() -> None:
    estimate = StatureEstimator(TABLE).estimate()
    assert estimate.stature == pytest.approx(float(np.exp(TABLE.log_mean[0])))
    assert estimate.stature_sd > 0.15 and estimate.samples == 0 and estimate.seen == 0


@pytest.mark.parametrize("stature", [1.10, 1.50, 1.70, 1.95])
def test_the_stature_of_mean_proportions_is_found(stature: float) -> None:
    estimate = estimated(key_points(stature, 60, 0.0)).estimate()
    assert estimate.stature == pytest.approx(stature, rel=0.02)
    assert abs(estimate.stature - stature) < 3.0 * estimate.stature_sd


def test_noise_does_not_make_people_taller() -> None:
    errors = [estimated(key_points(1.7, 60, 0.03, seed)).estimate().stature - 1.7 for seed in range(12)]
    assert abs(np.mean(errors)) < 0.012 and np.std(errors) < 0.01


def test_long_forearms_are_seen() -> None:
    estimate = estimated(key_points(1.7, 60, 0.01, forearm=0.30)).estimate()
    assert estimate.lengths["forearm"] == pytest.approx(0.30, abs=0.012)
    assert estimate.stature == pytest.approx(1.7, abs=0.05)


@pytest.mark.parametrize("missing", [LEGS, LEGS + [8, 11], [3, 4, 6, 7], list(range(5)) + list(range(14, 18))])
def test_any_subset_gives_everything_and_is_less_sure(missing: list) -> None:
    points = key_points(1.6, 60, 0.01)
    whole = estimated(points).estimate()
    points[:, missing] = np.nan
    part = estimated(points).estimate()
    assert part.stature == pytest.approx(1.6, abs=0.06)
    assert part.stature_sd > whole.stature_sd and part.seen < whole.seen
    assert set(part.lengths) == set(SEGMENTS) and all(value > 0.0 for value in part.lengths_sd.values())


def test_it_grows_sure_with_time() -> None:
    points = key_points(1.7, 90, 0.03)
    spreads = [estimated(points[:frames]).estimate().stature_sd for frames in (3, 15, 90)]
    assert spreads[0] > spreads[1] > spreads[2]


def test_old_measurements_are_forgotten_and_time_that_goes_back_forgets_all() -> None:
    estimator = estimated(key_points(1.9, 30, 0.0))
    for n, frame in enumerate(key_points(1.5, 60, 0.0)):
        estimator.add(frame, 100.0 + n / 30.0)
    assert estimator.estimate().stature == pytest.approx(1.5, rel=0.02)
    assert estimator.samples == 60
    estimator.add(np.full((18, 3), np.nan), 3.0)
    assert estimator.samples == 1


def test_outliers_do_not_count() -> None:
    points = key_points(1.7, 60, 0.005)
    points[::7, 4, 2] += 0.8
    assert estimated(points).estimate().stature == pytest.approx(1.7, abs=0.02)


def test_robust_lengths_take_the_bias_of_noise_away() -> None:
    noise = np.random.default_rng(1).normal(size=(4000, 3)) * 0.04 + [0.25, 0.0, 0.0]
    length, spread, count = robust_lengths(np.column_stack([np.linalg.norm(noise, axis=1), np.full(4000, np.nan)]))
    assert length[0] == pytest.approx(0.25, abs=0.002) and spread[0] == pytest.approx(0.04, abs=0.003)
    assert count[1] == 0 and np.isnan(length[1])


def revisions(points: np.ndarray, settings: DimensionSettings = DimensionSettings()) -> list:  # noqa: B008
    """Return the revisions after each frame at 30 Hz."""
    person, found = PersonDimensions(TABLE, settings), []
    for n, frame in enumerate(points):
        person.update(frame, n / 30.0)
        found.append(person.revision)
    return found


@pytest.mark.parametrize("name, value", [("tolerance", 0.0), ("window", 0.1), ("delay", -1.0), ("scale_sd", 2.0)])
def test_illegal_dimension_settings_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        DimensionSettings(**{name: value})


@pytest.mark.parametrize("sigma", [0.01, 0.03])
def test_dimensions_settle_early_and_stay_for_noise(sigma: float) -> None:
    found = [revisions(key_points(1.75, 300, sigma, seed)) for seed in range(4)]
    assert all(one[:5] == [0] * 5 and one[8] == 1 for one in found)
    # The first ones rest on 0.2 s: at most once they are mended.
    assert all(one[-1] <= 2 and one[-1] == one[150] for one in found)


def test_another_stature_makes_them_anew_once() -> None:
    found = revisions(np.concatenate([key_points(1.75, 90, 0.01), key_points(1.55, 360, 0.01)]))
    assert found[89] == 1 and 2 <= found[-1] <= 3


def test_someone_of_whom_little_is_seen_settles_after_a_second() -> None:
    points = key_points(1.7, 60, 0.01)
    points[:, [3, 4, 6, 7, 9, 10, 12, 13, 8, 11]] = np.nan
    found = revisions(points)
    assert found[20] == 0 and found[40] == 1


def before_the_camera(stature: float) -> np.ndarray:
    """Key points (18, 3) m of one who stands upright 3 m before the camera, in the optical frame."""
    facing = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    points, _, _ = forward(facing[None], np.array([[0.0, 0.2, 3.0]]), np.zeros((1, len(PAPER.joint_names))),
                           [Dimensions.from_stature(stature, TABLE)], PAPER)
    return points[0]


def test_a_guessed_size_moves_the_stature_little_and_the_lengths_as_they_are() -> None:
    estimates = []
    for systematic in (0.0, MONOCULAR):
        estimator = StatureEstimator(TABLE)
        for n in range(30):
            estimator.add(before_the_camera(1.45), n / 30.0, systematic)
        estimates.append(estimator.estimate())
    measured, guessed = estimates
    assert measured.stature == pytest.approx(1.45, abs=0.03) and 1.60 < guessed.stature < 1.75
    assert guessed.stature_sd > 0.06 and guessed.stature_sd > 1.5 * measured.stature_sd
    assert guessed.lengths["thigh"] == pytest.approx(measured.lengths["thigh"], rel=0.05)


def test_a_guessed_segment_along_the_ray_is_not_believed() -> None:
    points = before_the_camera(1.7)
    ray = points[8] / np.linalg.norm(points[8])
    points[9] = points[8] - 0.15 * ray  # a thigh that points at the camera, and is guessed much too short
    points[12] = points[11] - 0.15 * ray
    points[[10, 13]] = np.nan
    thighs = []
    for systematic in (0.0, MONOCULAR):
        estimator = StatureEstimator(TABLE)
        for n in range(90):
            estimator.add(points, n / 30.0, systematic)
        thighs.append(estimator.estimate().lengths["thigh"])
    usual = 1.7 * TABLE.ratio("thigh")
    assert thighs[0] < 0.85 * usual and thighs[1] == pytest.approx(usual, rel=0.05)
