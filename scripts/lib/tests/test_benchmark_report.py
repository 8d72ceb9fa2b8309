"""Figures of the benchmark out of what its probe saw."""

from __future__ import annotations

import json

import benchmark_report

SEEN = {
    "seconds": 10.0, "tracked": {"persons": 4, "faces": 2, "bodies": 3}, "most_tracked": {},
    "ages": [0.1] * 95 + [0.3] * 5,
    "rates": {"person": [15.0, 12.0, 9.0, 8.0], "face": [15.0, 15.0], "body": []},
    "stages_ms": {"hri_faces": {"mesh": {"median": 3.0, "p95": 4.0}}},
    "rss_mb": {"hri_faces": 200.0, "image_source": 90.0},
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
    assert {"fps_3", "age_p95_ms_3", "cpu_percent_3", "stages_ms", "cpu_percent_by_process_3", "second_run_s"} <= set(result)
    assert result["rss_mb_3"] == 200.0 and result["rss_mb_by_process_3"]["image_source"] == 90.0
    assert result["first_run_s"] is None and set(result["reasons"]) == {"first_run_s", "second_run_s"}
    assert json.loads(json.dumps(result))["stages_ms"]["3"]["hri_faces"]["mesh"]["median"] == 3.0


def test_the_row_of_somebody_who_is_seen() -> None:
    from benchmark_start import shows_a_person
    assert shows_a_person("igkh6                   awkcn  -      -            1.00    1.39  -0.17   1.75   map     351")
    assert shows_a_person("anonymous_person_jfjb0  -      tuih8  -            1.00    2.23  -0.04   1.24   map     263")
    assert not shows_a_person("anonymous_person_wmbx9  -      -      douyj        0.00  -       -          -")
    assert not shows_a_person("person                  face   body   voice  confidence  position x y z (m)")
