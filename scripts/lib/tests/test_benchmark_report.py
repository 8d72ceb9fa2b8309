"""Figures of the benchmark out of what its probe saw."""

from __future__ import annotations

import json

import benchmark_report

SEEN = {
    "seconds": 10.0, "tracked": {"persons": 4, "faces": 2, "bodies": 3}, "most_tracked": {},
    "ages": [0.1] * 95 + [0.3] * 5,
    "rates": {"person": [15.0, 12.0, 9.0, 8.0], "face": [15.0, 15.0], "body": []},
    "stages_ms": {"hri_faces": {"mesh": {"median": 3.0, "p95": 4.0}}},
    "cpu_percent": {"hri_faces": 40.0, "rosmaster": 1.0, "image_source": 13.0, "benchmark_probe": 1.0}}
MACHINE = {"cpu": "x", "cores": 2, "system": "y", "load_average": [0.1, 0.2, 0.3], "versions": {"numpy": "1"}}


def test_who_is_missing_counts_as_zero_and_who_is_too_many_does_not_count() -> None:
    row = benchmark_report.figures(3, SEEN)
    assert (row["fps"], row["faces_fps"], row["bodies_fps"]) == (12.0, 10.0, 0.0)
    assert row["found"] == {"persons": 4, "faces": 2, "bodies": 3}
    assert row["age_p50_ms"] == 100.0 and 100.0 <= row["age_p95_ms"] <= 300.0


def test_source_and_probe_are_not_counted_as_the_stack() -> None:
    assert benchmark_report.figures(3, SEEN)["cpu_percent"] == 41.0


def test_without_persons_there_is_no_age() -> None:
    row = benchmark_report.figures(1, dict(SEEN, ages=[]))
    assert row["age_p50_ms"] is None
    assert "-" in benchmark_report.as_table([row], MACHINE, {})


def test_json_has_the_promised_keys() -> None:
    result = benchmark_report.as_json([benchmark_report.figures(3, SEEN)], MACHINE, {})
    assert {"fps_3", "age_p95_ms_3", "cpu_percent_3", "stages_ms"} <= set(result)
    assert json.loads(json.dumps(result))["stages_ms"]["3"]["hri_faces"]["mesh"]["median"] == 3.0
