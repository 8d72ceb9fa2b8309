"""What `scripts/benchmark interactions` prints: every figure asked for, or the reason why it is not there."""

from __future__ import annotations

import argparse
import json

from benchmarks import interactions

ASKED = {"gaze_3", "gaze_6", "gaze_without_closed_eyes_rule", "groups_f1", "cpu_percent_10", "cpu_percent_30",
         "photographs", "gaze_real", "eyes", "gaze_independent", "gaze_no_face", "robot_groups",
         "engagement", "nod", "shake"}
MACHINE = {"cpu": "x", "cores": 2, "system": "y", "load_average": [0.1, 0.2, 0.3], "versions": {}}


def lines(values: dict) -> dict:
    table = interactions.SUBJECT.table(interactions.SUBJECT.report(values, {}, MACHINE))
    return {line.split()[0]: line for line in table.splitlines() if line.strip()}


def test_every_figure_is_measured_by_one_part() -> None:
    measured = [key for keys in interactions.PARTS.values() for key in keys]
    assert sorted(measured) == sorted(ASKED) == sorted(key for key, _, _ in interactions.KEYS)


def test_what_was_not_measured_is_null_with_its_reason() -> None:
    found = interactions.SUBJECT.report({"cpu_percent_10": 0.9}, {"engagement": "no scene"}, MACHINE)
    report = json.loads(json.dumps(found))
    assert set(report) == ASKED | {"reasons", "details", "machine", "load", "input"}
    assert set(report["reasons"]) == ASKED - {"cpu_percent_10"}
    assert all(report[key] is None for key in report["reasons"])
    assert report["reasons"]["engagement"] == "no scene"
    assert "no scene" in interactions.SUBJECT.table(report)


def test_the_table_tells_what_falls_short() -> None:
    good = {"precision": 0.95, "recall": 0.91, "closed_gazes": 0}
    groups = {"CoffeeBreak": 0.87, "Synth": 0.95, "CoffeeBreak_noisy": 0.81, "radii": 0.94, "walkers": 0.88}
    found = lines({
        "gaze_3": good, "gaze_6": dict(good, recall=0.89), "cpu_percent_10": 2.9, "cpu_percent_30": 10.1,
        "groups_f1": groups, "nod": {"precision": 0.9, "recall": 0.9}, "shake": {"precision": 0.9, "recall": 0.89},
        "engagement": {"illegal": 1, "levels": ["engaged"]}})
    assert {key: " NO " in found[key] for key in (
        "gaze_3", "gaze_6", "cpu_percent_10", "cpu_percent_30", "groups_f1", "engagement", "nod", "shake")} == {
        "gaze_3": False, "gaze_6": True, "cpu_percent_10": False, "cpu_percent_30": True, "groups_f1": False,
        "engagement": True, "nod": False, "shake": True}
    assert " NO " in lines({"gaze_3": dict(good, closed_gazes=1)})["gaze_3"]
    assert " NO " in lines({"groups_f1": dict(groups, walkers=0.87)})["groups_f1"]


def test_independent_figures_are_asked_for_by_number_of_people() -> None:
    good = {"4": {"precision": 0.92, "recall": 0.85}, "8": {"precision": 0.90, "recall": 0.82},
            "12": {"precision": 0.88, "recall": 0.80}}
    assert " NO " not in lines({"gaze_independent": good})["gaze_independent"]
    assert " NO " in lines({"gaze_independent": dict(good, **{"12": {"precision": 0.88, "recall": 0.79}})})[
        "gaze_independent"]
    for precision, told, short in ((0.7, 10, False), (0.69, 10, True), (0.0, 0, False)):
        value = {"precision": precision, "recall": 0.0, "told": told}
        assert (" NO " in lines({"gaze_no_face": value})["gaze_no_face"]) is short


def test_the_robot_is_in_few_groups_of_eight_people() -> None:
    for wrong, short in ((0.05, False), (0.06, True)):
        assert (" NO " in lines({"robot_groups": {"4": 0.2, "8": wrong, "12": 0.2}})["robot_groups"]) is short


def test_eyes_fall_short_above_three_and_five_percent() -> None:
    for errors, short in (((0.03, 0.05), False), ((0.031, 0.0), True), ((0.0, 0.06), True)):
        value = dict(zip(("open_told_shut", "shut_told_open"), errors))
        assert (" NO " in lines({"eyes": value})["eyes"]) is short


def test_the_confusion_table_is_a_table() -> None:
    table = {truth: {"camera": 1, "nobody": 20} for truth in ("camera", "closed")}
    found = lines({"photographs": table})
    assert found["closed"].split() == ["closed", "1", "20"]


def test_an_unknown_part_is_refused() -> None:
    parser = argparse.ArgumentParser()
    interactions.register(parser.add_subparsers())
    assert interactions.run(parser.parse_args(["interactions", "--only", "walls"])) == 2
