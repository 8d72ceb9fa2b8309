"""What `scripts/benchmark SUBJECT` prints: every figure asked for, whether it is met, or the reason why it is not
there."""

from __future__ import annotations

import argparse
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import benchmarks

MACHINE = {"cpu": "x", "cores": 2, "system": "y", "load_average": [0.1, 0.2, 0.3], "versions": {}}
FIGURES = {
    "faces": "cpu_ms_1 cpu_ms_3 cpu_ms_10 pose_mae_deg pose_position_percent turned_heads face_body_depth_ratio_median "
             "eyes_closed expression recognition",
    "bodies": "mpjpe_height_only_mm mpjpe_limbs_mm wave_lag_ms ik_ms_1 ik_ms_10 stature_bias_mm stature_sd_mm "
              "stature_no_legs_sd_mm attitude waving_false posture photographs stature",
    "voices": "vad onset_p95_ms off_p95_ms cpu_percent_1ch cpu_percent_4ch wer_dictation wer_far wer_grammar "
              "text_p95_s first_partial_s cpu_percent_speaking cpu_percent_idle hallucinated_words own_voice "
              "right_number_3 turns_mixed robot_words doa_error_deg_six_channels speaker doa_error_deg_1 "
              "doa_error_deg_2 kept_apart si_sdr_gain_db f0_error_percent hnr_error_db turns whose_voice",
    "interactions": "gaze_3 gaze_6 gaze_without_closed_eyes_rule photographs gaze_real gaze_independent gaze_no_face "
                    "robot_groups eyes groups_f1 engagement cpu_percent_10 cpu_percent_30 nod shake",
    "persons": "latency_p50_ms latency_p99_ms latency_p50_ms_300 latency_p99_ms_300 latency_p50_ms_1800 "
               "latency_p99_ms_1800 persons_10 persons_30 dropped cpu_percent_10 cpu_percent_30 linked_7x7_ms "
               "chain_12_ms churn_rss_mb rest_rss_mb confidence_curve recover_s kill_damaged who_wins persons_200 "
               "linked_15_ms late_body_taken forget_undone",
    "identity": "stranger_wrong_name enrolled_precision enrolled_recall name_stays_p95_s closed_sets "
                "body_returns_right body_returns_wrong vtest_idf1 vtest_switches_per_min vtest_ids cameras handover "
                "false_per_1000 filmed_cameras",
    "robot": "covariance_95 people_msgs_hz presets_failed bridge_fields_failed calibration_error_m "
             "calibration_error_deg web_first_picture_s pointing_error_deg moving_seen moving_aside_m moving_nods "
             "moving_stack_kept moving_stack_others moving_stack_error_m"}
"""Figures that users of the JSON objects count on."""
VAD = {"clean": {"tpr": 0.97, "fpr": 0.07}, "10": {"tpr": 0.94, "fpr": 0.1}, "0": {"tpr": 0.8, "fpr": 0.05}}
FLAT = {"fds_growth": 0, "threads_growth": 0, "rss_mb_growth": 1.5}
NOISES = {"10": 1.0, "20": 1.0, "30": 1.0, "rgbd": 1.0}
GAZE = {"precision": 0.95, "recall": 0.91, "closed_gazes": 0}
GESTURE = {"precision": 0.9, "recall": 0.9}
GROUPS = {"CoffeeBreak": 0.87, "Synth": 0.95, "CoffeeBreak_noisy": 0.81, "radii": 0.94, "walkers": 0.88}
INDEPENDENT = {"4": {"precision": 0.92, "recall": 0.85}, "8": {"precision": 0.90, "recall": 0.82},
               "12": {"precision": 0.88, "recall": 0.80}}
RECOGNISED = {"right": 56, "wrong": 0, "unknown": 0}
CAMERAS = {"extra_time": 0.03, "wrong_joins": 0, "error_m": 0.1}
VALUES = (  # subject, figure, values that meet what is asked, values that do not
    ("faces", "cpu_ms_1", [9.9], [10.1]),
    ("faces", "pose_mae_deg", [{"yaw": 1.0, "pitch": 2.0, "roll": 0.1}], [{"yaw": 1.0, "pitch": 2.1, "roll": 0.1}]),
    ("faces", "recognition", [RECOGNISED], [dict(RECOGNISED, unknown=1), dict(RECOGNISED, wrong=1)]),
    ("faces", "face_body_depth_ratio_median", [0.9], [0.8]),
    ("bodies", "mpjpe_limbs_mm", [NOISES], [dict(NOISES, rgbd=50.0)]), ("bodies", "wave_lag_ms", [12.0], [31.0]),
    ("bodies", "stature_bias_mm", [-20.0], [-40.0]),
    ("interactions", "gaze_3", [GAZE], [dict(GAZE, recall=0.89), dict(GAZE, closed_gazes=1)]),
    ("interactions", "cpu_percent_10", [2.9], [3.1]), ("interactions", "cpu_percent_30", [9.9], [10.1]),
    ("interactions", "groups_f1", [GROUPS], [dict(GROUPS, walkers=0.87)]),
    ("interactions", "nod", [GESTURE], [dict(GESTURE, recall=0.89)]),
    ("interactions", "engagement", [{"illegal": 0, "levels": ["engaged"]}], [{"illegal": 1, "levels": ["engaged"]}]),
    ("interactions", "gaze_independent", [INDEPENDENT],
     [dict(INDEPENDENT, **{"12": {"precision": 0.9, "recall": .79}})]),
    ("interactions", "gaze_no_face", [{"precision": 0.7, "recall": 0.0, "told": 10}, {"precision": 0.0, "told": 0}],
     [{"precision": 0.69, "recall": 0.0, "told": 10}]),
    ("interactions", "robot_groups", [{"4": 0.2, "8": 0.05, "12": 0.2}], [{"4": 0.2, "8": 0.06, "12": 0.2}]),
    ("interactions", "eyes", [{"open_told_shut": 0.03, "shut_told_open": 0.05}],
     [{"open_told_shut": 0.031, "shut_told_open": 0.0}, {"open_told_shut": 0.0, "shut_told_open": 0.06}]),
    ("persons", "confidence_curve", [[[0.0, 1.0], [1.0, 0.5], [2.0, 0.0]]], [[[0.0, 1.0], [1.0, 0.5]]]),
    ("identity", "closed_sets", [{"right": 95, "wrong": 0, "unknown": 5}], [{"right": 95, "wrong": 1, "unknown": 0}]),
    ("identity", "cameras", [CAMERAS], [dict(CAMERAS, error_m=0.11), dict(CAMERAS, wrong_joins=1)]),
    ("identity", "handover", [{"kept": 0.9, "wrong": 0.05}], [{"kept": 0.9, "wrong": 0.06}]),
    ("robot", "covariance_95", [{"monocular": 0.95}], [{"monocular": 0.95, "voice": 1.0}]),
    ("robot", "people_msgs_hz", [10.0], [9.9]), ("robot", "moving_seen", [0.9], [0.89]),
    ("robot", "moving_aside_m", [0.03], [0.04]), ("robot", "moving_nods", [0], [1]),
    ("robot", "moving_stack_kept", [0.9], [0.89]), ("robot", "moving_stack_others", [0], [1]),
    ("robot", "moving_stack_error_m", [0.15], [0.16]),
    ("voices", "vad", [VAD], [{}, {"clean": VAD["clean"]}, dict(VAD, clean={"tpr": 0.99, "fpr": 0.11}),
                              dict(VAD, **{"0": {"tpr": 0.79, "fpr": 0.0}})]),
    ("voices", "own_voice", [{"1": 0.95, "2": 0.92, "3": 0.85}], [{"1": 0.95, "2": 0.91, "3": 0.85}]),
    ("voices", "speaker", [{"precision": 0.98, "recall": 0.5}], [{"precision": 0.97, "recall": 0.5}]),
    ("voices", "turns", [FLAT], [dict(FLAT, threads_growth=1)]),
    *(("voices", name, [good], [bad]) for name, good, bad in (
        ("wer_grammar", 0.02, 0.03), ("wer_dictation", 0.12, 0.13), ("wer_far", 0.45, 0.46), ("text_p95_s", 0.8, 0.9),
        ("hallucinated_words", 5, 6), ("first_partial_s", 1.0, 1.1), ("cpu_percent_speaking", 15.0, 15.1),
        ("cpu_percent_idle", 2.0, 2.1), ("robot_words", 0, 1), ("doa_error_deg_six_channels", 3.0, 3.1),
        ("right_number_3", 0.6, 0.5), ("turns_mixed", 0.2, 0.3), ("off_p95_ms", 250.0, 251.0),
        ("hnr_error_db", 1.0, -1.1), ("onset_p95_ms", 150.0, 151.0), ("cpu_percent_1ch", 5.0, 5.1),
        ("cpu_percent_4ch", 15.0, 16.0),
        ("doa_error_deg_1", 5.0, 5.1), ("doa_error_deg_2", 10.0, 11.0), ("kept_apart", 0.9, 0.89),
        ("si_sdr_gain_db", 5.0, 4.9), ("f0_error_percent", 3.0, 3.1))))


def module_of(subject):
    return importlib.import_module("benchmarks." + subject)


@pytest.fixture(params=FIGURES)
def module(request):
    return module_of(request.param)


def test_every_figure_is_measured_by_one_part(module):
    measured = [key for keys in module.PARTS.values() for key in keys]
    assert sorted(measured) == sorted(FIGURES[module.SUBJECT.name].split()) == sorted(key for key, _, _ in module.KEYS)


@pytest.mark.parametrize("subject, key, good, bad", VALUES, ids=["{}-{}".format(*row) for row in VALUES])
def test_the_table_tells_what_is_met(subject, key, good, bad):
    told = module_of(subject).SUBJECT
    for value in good + bad:
        table = told.table(told.report({key: value}, {}, MACHINE)).splitlines()
        line, = [line for line in table if line.startswith(key + " ")]
        assert re.search(r" (yes|NO|-)  ", line)[1] == ("yes" if value in good else "NO"), value
        assert sum("not measured" in line for line in table) == len(told.keys) - 1


def test_one_part_that_is_measured_and_one_that_fails(module, monkeypatch, capsys):
    """One JSON object with null and the reason, and a status that says it."""
    keys, names = FIGURES[module.SUBJECT.name].split(), list(module.PARTS)
    first, second = names[0], names[1]

    def measure(part, *_):
        if part == second:
            raise FileNotFoundError("no pictures")
        return {name: 0.5 for name in module.PARTS[part]}

    monkeypatch.setattr(module.SUBJECT, "_words", lambda report: {})
    options = argparse.Namespace(only=first + "," + second, json=True)
    assert module.SUBJECT.run(options, measure) == 1
    written = capsys.readouterr()
    report = json.loads(written.out)
    assert set(report) == {*keys, "machine", "input", "load", "reasons", "details"}
    assert set(report["reasons"]) == set(keys) - set(module.PARTS[first])
    for key in keys:
        reason = "no pictures" if key in module.PARTS[second] else "--only"
        assert report[key] == 0.5 if key in module.PARTS[first] else report[key] is None and reason in report[
            "reasons"][key]
    assert first + " ..." in written.err and "no pictures" in module.SUBJECT.table(report)
    assert module.SUBJECT.run(argparse.Namespace(only=first, json=False), measure) == 0
    assert module.SUBJECT.run(argparse.Namespace(only="galery", json=False), measure) == 2
    assert "galery" in capsys.readouterr().err


def test_a_part_that_lacks_a_figure_is_told(monkeypatch, capsys):
    voices = module_of("voices")
    monkeypatch.setattr(voices, "_measure", lambda part, turns: {"f0_error_percent": 1.0})
    assert voices.run(argparse.Namespace(only="features", turns=1, json=True)) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["f0_error_percent"] == 1.0 and "hnr_error_db" in report["reasons"]["hnr_error_db"]


def test_the_confusion_table_is_a_table():
    told = module_of("interactions").SUBJECT
    table = {truth: {"camera": 1, "nobody": 20} for truth in ("camera", "closed")}
    lines = told.table(told.report({"photographs": table}, {}, MACHINE)).splitlines()
    assert ["closed", "1", "20"] in [line.split() for line in lines]


def test_the_command_line_needs_no_package_but_the_standard_library():
    code = "import sys; sys.path.insert(0, {!r})\n{}\nprint(*sys.modules)".format(
        str(Path(benchmarks.__path__[0]).parent), "\n".join("import benchmarks." + name for name in FIGURES))
    loaded = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True).stdout.decode().split()
    assert not {"numpy", "cv2", "onnxruntime", "hri_pipeline"} & set(loaded)
