"""What `scripts/benchmark bodies` prints: every figure asked for, or the reason why it is not there."""

from __future__ import annotations

import json

from benchmarks import bodies

ASKED = {
    "mpjpe_height_only_mm", "mpjpe_limbs_mm", "wave_lag_ms", "ik_ms_1", "ik_ms_10", "stature_bias_mm", "stature_sd_mm",
    "stature_no_legs_sd_mm", "attitude", "waving_false", "photographs", "posture", "stature"}
MACHINE = {"cpu": "x", "cores": 2, "system": "y", "load_average": [0.1, 0.2, 0.3], "versions": {}}


def test_every_figure_is_measured_by_one_part() -> None:
    measured = [key for keys in bodies.PARTS.values() for key in keys]
    assert sorted(measured) == sorted(ASKED) == sorted(key for key, _, _ in bodies.KEYS)


def test_what_was_not_measured_is_null_with_its_reason() -> None:
    report = json.loads(json.dumps(bodies.SUBJECT.report({"ik_ms_1": 0.9}, {"photographs": "no pictures"}, MACHINE)))
    assert set(report) == ASKED | {"reasons", "details", "machine", "load", "input"}
    assert report["ik_ms_1"] == 0.9 and "ik_ms_1" not in report["reasons"]
    assert set(report["reasons"]) == ASKED - {"ik_ms_1"}
    assert all(report[key] is None for key in report["reasons"])
    assert report["reasons"]["photographs"] == "no pictures"
    assert "no pictures" in bodies.SUBJECT.table(report)


def test_the_table_tells_what_falls_short() -> None:
    good = {"10": 1.0, "20": 1.0, "30": 1.0, "rgbd": 1.0}
    values = {"mpjpe_limbs_mm": good, "mpjpe_height_only_mm": dict(good, rgbd=50.0), "stature_bias_mm": -40.0,
              "wave_lag_ms": 12.0}
    lines = {line.split()[0]: line for line in bodies.SUBJECT.table(
        bodies.SUBJECT.report(values, {}, MACHINE)).splitlines() if line.strip()}
    assert {key: " NO " in lines[key] for key in values} == {
        "mpjpe_limbs_mm": False, "mpjpe_height_only_mm": True, "stature_bias_mm": True, "wave_lag_ms": False}
