"""The table of proportions; stature and lengths from key points of people whose lengths are known."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
import yaml

from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.model.anthropometry import (
    MONOCULAR,
    SEGMENTS,
    STATISTICS,
    SegmentTable,
    StatureEstimator,
    default_segments_file,
    robust_lengths,
)
from hri_fullbody.core.model.human import PAPER, Dimensions
from hri_fullbody.core.modeller import DimensionSettings, PersonDimensions


@pytest.fixture(scope="module")
def content():
    return yaml.safe_load(default_segments_file().read_text(encoding="utf-8"))


def load(tmp_path, content):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return SegmentTable.load(str(path))


def test_the_own_table_is_that_of_joint_centres():
    table = SegmentTable.load()
    assert table.ratio("upper_arm") == 0.163 and table.ratio("half_hips") == 0.052
    # soles to eyes: the chain of lengths must reach the eye height of the survey, .934 of the stature
    height = sum(table.ratio(name) for name in ("ankle_height", "shank", "thigh", "trunk", "neck"))
    assert height + table.head_points["sellion"][2] / table.reference_stature == pytest.approx(0.934, abs=0.005)
    assert table.names == STATISTICS and table.log_covariance.shape == (10, 10)
    assert np.exp(table.log_mean[0]) == pytest.approx(1.69, abs=0.02)


def test_statistics_agree_with_the_ratios():
    table = SegmentTable.load()
    for name, mean in zip(table.names[1:], table.log_mean[1:]):
        assert np.exp(mean - table.log_mean[0]) == pytest.approx(table.ratio(name), rel=0.05), name


def test_a_users_own_file_is_taken(tmp_path, content):
    content = copy.deepcopy(content)
    content["segments"]["thigh"]["ratio"] = 0.2
    assert load(tmp_path, content).ratio("thigh") == 0.2


@pytest.mark.parametrize("path, value, message", [
    (("segments", "thigh", "ratio"), 24.0, "segments/thigh/ratio is 24.0; legal: a number from 0.005 to 0.6"),
    (("segments", "thigh", "ratio"), True, "segments/thigh/ratio is True"),
    (("segments", "thigh", "ratio"), float("nan"), "segments/thigh/ratio is nan"),
    (("segments", "neck", "cv"), "wide", "segments/neck/cv is 'wide'"),
    (("segments", "neck"), 0.1, "segments/neck is 0.1; legal: a mapping with the keys ratio, cv"),
    (("segments",), [1], "segments is"),
    (("head", "pivot_share"), 1.5, "head/pivot_share is 1.5; legal: a number from 0 to 1"),
    (("head", "points", "nose"), [0.1, 0.0], "head/points/nose is [0.1, 0.0]; legal: a list of 3 numbers"),
    (("head", "points", "nose"), [0.1, 0.0, 4.0], "head/points/nose[2] is 4.0"),
    (("statistics", "names"), ["stature"], "statistics/names"),
    (("statistics", "log_mean"), [0.5], "statistics/log_mean is [0.5]; legal: a list of 10 numbers"),
    (("statistics", "log_covariance"), [[1.0]], "10 rows of 10 numbers"),
    (("statistics", "log_covariance", 2), [0.0] * 10, "not symmetric"),
])
def test_a_wrong_entry_is_told_with_file_key_and_range(tmp_path, content, path, value, message):
    content = copy.deepcopy(content)
    entry = content
    for key in path[:-1]:
        entry = entry[key]
    entry[path[-1]] = value
    with pytest.raises(ValueError) as error:
        load(tmp_path, content)
    assert message in str(error.value) and "mine.yaml" in str(error.value)


def test_a_covariance_that_is_none_is_told(tmp_path, content):
    content = copy.deepcopy(content)
    content["statistics"]["log_covariance"] = (-np.eye(10) * 1e-3).tolist()
    with pytest.raises(ValueError, match="not positive definite"):
        load(tmp_path, content)


def test_missing_and_unknown_keys_are_told(tmp_path, content):
    content = copy.deepcopy(content)
    content["segments"]["tigh"] = content["segments"].pop("thigh")
    with pytest.raises(ValueError, match=r"missing: \['thigh'\]; unknown: \['tigh'\]"):
        load(tmp_path, content)


@pytest.mark.parametrize("text", [b"", b"segments: [", b"\xff\xfe\x00", b"- a"])
def test_a_file_that_is_no_table_is_told(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_bytes(text)
    with pytest.raises(ValueError, match="mine.yaml"):
        SegmentTable.load(str(path))


def test_a_file_that_is_not_there_is_told():
    with pytest.raises(ValueError, match="/nowhere/t.yaml cannot be read"):
        SegmentTable.load("/nowhere/t.yaml")


def test_a_file_that_is_something_else_is_not_quoted_as_a_whole(tmp_path):
    path = tmp_path / "long.txt"
    path.write_text("not a table " * 1000, encoding="utf-8")
    with pytest.raises(ValueError, match="long.txt.*a mapping with the keys segments") as error:
        SegmentTable.load(str(path))
    assert len(str(error.value)) < 600


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


def test_the_least_time_between_two_changes_doubles() -> None:
    """Somebody who grows all the time: more often than that nothing changes, and it does soon after."""
    person, changes = PersonDimensions(TABLE, DimensionSettings(delay=0.0, window=1.0)), []
    for n in range(700):
        points = key_points(1.2 * math.exp(0.02 * n / 20.0), 1, 0.0)[0]
        before = person.revision
        person.update(points, n / 20.0)
        changes += [n / 20.0] * (person.revision - before)
    assert 4 <= len(changes) <= 6
    gaps = np.diff(changes)
    assert np.all(gaps[1:] >= 2.0 * 2.0 ** np.arange(len(gaps) - 1))
    assert np.all(gaps[1:] <= 2.0 * 2.0 ** np.arange(len(gaps) - 1) + 1.6)


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
