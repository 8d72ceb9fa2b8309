"""The report of `scripts/benchmark faces`: every figure is there, as a number or as null with a reason."""

import argparse
import json
import re
import subprocess
import sys

import pytest

from benchmarks import faces

WANTED = ["cpu_ms_1", "cpu_ms_3", "cpu_ms_10", "pose_mae_deg", "pose_position_percent",
          "face_body_depth_ratio_median", "eyes_closed", "expression", "recognition"]


def options(*arguments):
    parser = argparse.ArgumentParser()
    faces.register(parser.add_subparsers())
    return parser.parse_args(["faces", *arguments])


def test_every_part_and_every_figure_once():
    assert [key for key, _, _ in faces.KEYS] == WANTED
    assert sorted(key for keys in faces.PARTS.values() for key in keys) == sorted(WANTED)


def test_json_is_one_object_with_null_and_reason(monkeypatch, capsys):
    def measure(part):
        if part == "depth":
            return {"face_body_depth_ratio_median": 0.9}
        raise FileNotFoundError("no pictures")

    monkeypatch.setattr(faces, "_measure", measure)
    assert faces.run(options("--json", "--only", "depth,recognition")) == 1
    written = capsys.readouterr()
    report = json.loads(written.out)
    assert set(report) == set(WANTED) | {"machine", "input", "load", "reasons", "details"}
    assert report["face_body_depth_ratio_median"] == 0.9
    assert "face_body_depth_ratio_median" not in report["reasons"]
    assert report["recognition"] is None and "no pictures" in report["reasons"]["recognition"]
    assert "--only" in report["reasons"]["cpu_ms_1"]
    assert "depth ..." in written.err


def test_the_exit_status_is_good_when_all_that_was_asked_for_is_measured(monkeypatch, capsys):
    monkeypatch.setattr(faces, "_measure", lambda part: {"face_body_depth_ratio_median": 0.9})
    assert faces.run(options("--only", "depth")) == 0
    assert faces.run(options("--only", "dept")) == 2
    assert "dept" in capsys.readouterr().err


@pytest.mark.parametrize("key, value, met", [
    ("cpu_ms_1", 9.9, "yes"), ("cpu_ms_1", 10.1, "NO"), ("pose_mae_deg", {"yaw": 1.0, "pitch": 2.1, "roll": 0.1}, "NO"),
    ("recognition", {"right": 56, "wrong": 0, "unknown": 0}, "yes"),
    ("recognition", {"right": 55, "wrong": 0, "unknown": 1}, "NO"), ("face_body_depth_ratio_median", 0.8, "NO")])
def test_the_table_says_what_is_met(key, value, met):
    report = faces.SUBJECT.report({key: value}, {}, {
        "cpu": "some", "cores": 2, "system": "here", "load_average": [0.1, 0.2, 0.3]})
    line, = [line for line in faces.SUBJECT.table(report).splitlines() if line.startswith(key + " ")]
    assert re.search(r" (yes|NO|-)  ", line)[1] == met
    others = [line for line in faces.SUBJECT.table(report).splitlines() if "not measured" in line]
    assert len(others) == len(WANTED) - 1


def test_the_command_line_needs_no_package_but_the_standard_library():
    packages = {"numpy", "cv2", "onnxruntime", "hri_pipeline"}
    code = "import sys; sys.path.insert(0, {!r}); import benchmarks.faces; print(*sys.modules)".format(
        str(faces.Path(faces.__file__).parents[1]))
    loaded = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True).stdout.decode().split()
    assert not packages & set(loaded)
