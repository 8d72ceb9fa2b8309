import copy

import numpy as np
import pytest
import yaml

from hri_fullbody.core.human.segment_table import STATISTICS, SegmentTable, default_segments_file


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
