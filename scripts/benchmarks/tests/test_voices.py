"""What `scripts/benchmark voices` prints: every figure asked for, or the reason why it is not there."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import voices

ASKED = {
    "vad", "wer_grammar", "wer_dictation", "wer_far", "hallucinated_words", "text_p95_s", "first_partial_s",
    "cpu_percent_speaking", "cpu_percent_idle", "onset_p95_ms", "cpu_percent_1ch", "cpu_percent_4ch", "doa_error_deg_1",
    "robot_words", "doa_error_deg_six_channels", "own_voice", "right_number_3", "turns_mixed", "off_p95_ms", "speaker",
    "doa_error_deg_2", "kept_apart", "si_sdr_gain_db", "f0_error_percent", "hnr_error_db", "turns", "whose_voice"}
MACHINE = {"cpu": "x", "cores": 2, "system": "y", "load_average": [0.1, 0.2, 0.3], "versions": {}}
GOOD_VAD = {"clean": {"tpr": 0.97, "fpr": 0.07}, "10": {"tpr": 0.94, "fpr": 0.1}, "0": {"tpr": 0.8, "fpr": 0.05}}
FLAT = {"fds_growth": 0, "threads_growth": 0, "rss_mb_growth": 1.5}
GOOD = {"vad": GOOD_VAD, "wer_grammar": 0.02, "wer_dictation": 0.12, "wer_far": 0.45,
        "hallucinated_words": 5, "text_p95_s": 0.8, "first_partial_s": 1.0, "cpu_percent_speaking": 15.0,
        "cpu_percent_idle": 2.0, "robot_words": 0, "doa_error_deg_six_channels": 3.0,
        "own_voice": {"1": 0.95, "2": 0.92, "3": 0.85}, "right_number_3": 0.6, "turns_mixed": 0.2, "off_p95_ms": 250.0,
        "speaker": {"precision": 0.98, "recall": 0.5}, "onset_p95_ms": 150.0, "cpu_percent_1ch": 5.0,
        "cpu_percent_4ch": 15.0, "doa_error_deg_1": 5.0, "doa_error_deg_2": 10.0, "kept_apart": 0.9,
        "si_sdr_gain_db": 5.0,
        "f0_error_percent": 3.0, "hnr_error_db": 1.0, "turns": FLAT}
BAD = {"vad": dict(GOOD_VAD, clean={"tpr": 0.99, "fpr": 0.11}), "wer_grammar": 0.03,
       "wer_dictation": 0.13, "wer_far": 0.46, "hallucinated_words": 6, "text_p95_s": 0.9, "first_partial_s": 1.1,
       "cpu_percent_speaking": 15.1, "cpu_percent_idle": 2.1, "robot_words": 1, "doa_error_deg_six_channels": 3.1,
       "own_voice": {"1": 0.95, "2": 0.91, "3": 0.85}, "right_number_3": 0.5, "turns_mixed": 0.3, "off_p95_ms": 251.0,
       "speaker": {"precision": 0.97, "recall": 0.5}, "onset_p95_ms": 151.0,
       "cpu_percent_1ch": 5.1, "cpu_percent_4ch": 16.0, "doa_error_deg_1": 5.1, "doa_error_deg_2": 11.0,
       "kept_apart": 0.89,
       "si_sdr_gain_db": 4.9, "f0_error_percent": 3.1, "hnr_error_db": -1.1, "turns": dict(FLAT, threads_growth=1)}


def test_every_figure_is_measured_by_one_part() -> None:
    measured = [key for keys in voices.PARTS.values() for key in keys]
    assert sorted(ASKED) == sorted(key for key, _, _ in voices.KEYS)
    assert len(measured) == len(set(measured)) and set(measured) == ASKED


def test_what_was_not_measured_is_null_with_its_reason() -> None:
    report = json.loads(json.dumps(voices.SUBJECT.report({"kept_apart": 0.95}, {"turns": "no ROS"}, MACHINE)))
    assert set(report) == ASKED | {"reasons", "details", "machine", "load", "input"}
    assert report["kept_apart"] == 0.95 and set(report["reasons"]) == ASKED - {"kept_apart"}
    assert all(report[key] is None for key in report["reasons"])
    assert report["reasons"]["turns"] == "no ROS" and "no ROS" in voices.SUBJECT.table(report)


@pytest.mark.parametrize("values, word", [(GOOD, " yes "), (BAD, " NO ")], ids=["good", "bad"])
def test_the_table_says_what_is_met(values, word) -> None:
    lines = {line.split()[0]: line for line in voices.SUBJECT.table(
        voices.SUBJECT.report(values, {}, MACHINE)).splitlines() if line.strip()}
    assert all(word in lines[key] for key in values), lines


@pytest.mark.parametrize("vad", [{}, {"clean": GOOD_VAD["clean"]}, dict(GOOD_VAD, **{"0": {"tpr": 0.79, "fpr": 0.0}})])
def test_half_a_figure_is_not_met(vad) -> None:
    table = voices.SUBJECT.table(voices.SUBJECT.report({"vad": vad}, {}, MACHINE))
    assert " NO " in [line for line in table.splitlines() if line.startswith("vad ")][0]


def test_a_part_that_lacks_a_figure_is_told(monkeypatch, capsys) -> None:
    monkeypatch.setattr(voices, "_measure", lambda part, turns: {"f0_error_percent": 1.0})
    status = voices.run(argparse.Namespace(only="features", turns=1, json=True))
    report = json.loads(capsys.readouterr().out)
    assert status == 1 and report["f0_error_percent"] == 1.0 and "hnr_error_db" in report["reasons"]["hnr_error_db"]
    assert report["reasons"]["vad"] == "not asked for (--only)"


def test_unknown_parts_are_named(capsys) -> None:
    assert voices.run(argparse.Namespace(only="vat", turns=1, json=True)) == 2
    assert "vat" in capsys.readouterr().err


def test_the_command_line_needs_no_package_but_the_standard_library() -> None:
    code = "import sys; sys.path.insert(0, {!r}); import benchmarks.voices; print('numpy' in sys.modules)".format(
        str(Path(voices.__file__).parents[1]))
    assert subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, check=True).stdout.strip() == b"False"
