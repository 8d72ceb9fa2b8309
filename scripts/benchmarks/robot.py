"""`scripts/benchmark robot`: what the rest of the robot gets: navigation, presets, the way to ROS 2, and gestures."""

from __future__ import annotations

import argparse
import importlib
import json
from typing import Callable, Dict, Sequence, Tuple

from benchmarks.report import chosen, machine, measure_all, report_of, table_of

PROBE_S = 8.0


def _within(value: object) -> bool:
    return isinstance(value, dict) and all(0.90 <= share <= 0.99 for share in value.values())


def _most(limit: float) -> Callable[[object], bool]:
    return lambda value: isinstance(value, (int, float)) and value <= limit


def _least(limit: float) -> Callable[[object], bool]:
    return lambda value: isinstance(value, (int, float)) and value >= limit


def _both(value: object) -> bool:
    return isinstance(value, dict) and min(value["precision"], value["recall"]) >= 0.9


# Figure, what is asked, and whether a value is that.
KEYS: Sequence[Tuple[str, str, Callable[[object], bool]]] = (
    ("covariance_95", ".90 to .99 each", _within), ("people_msgs_hz", ">= 10", _least(10.0)),
    ("presets_failed", "0", _most(0)), ("bridge_fields_failed", "0", _most(0)),
    ("respeaker6_doa_error_deg", "<= 3", _most(3.0)), ("calibration_error_m", "<= 0.05", _most(0.05)),
    ("calibration_error_deg", "<= 1", _most(1.0)), ("web_first_picture_s", "<= 2", _most(2.0)),
    ("nod", "both >= .9", _both), ("shake", "both >= .9", _both), ("pointing_error_deg", "<= 8", _most(8.0)))

PARTS: Dict[str, Sequence[str]] = {
    "covariance": ("covariance_95",), "people": ("people_msgs_hz",), "presets": ("presets_failed",),
    "bridge": ("bridge_fields_failed",), "respeaker": ("respeaker6_doa_error_deg",),
    "calibration": ("calibration_error_m", "calibration_error_deg"), "web": ("web_first_picture_s",),
    "nod": ("nod", "shake"), "pointing": ("pointing_error_deg",)}
SOURCES: Dict[str, Tuple[str, str]] = {
    "covariance": ("covariance", "figures"), "people": ("robot", "people_figures"),
    "presets": ("sensor_presets", "figures"), "bridge": ("ros2_bridge", "figures"),
    "respeaker": ("respeaker", "figures"), "calibration": ("calibration", "calibration_figures"),
    "web": ("web_page", "web_figures"), "nod": ("nods", "nod_figures"),
    "pointing": ("bodies", "pointing_figures")}
"""Module of the benchmarks and function that measures each part; it returns the keys of the part and more."""
RENAMED = {"doa_error_deg_six_channels": "respeaker6_doa_error_deg"}
"""Keys that have another name where they are measured."""


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    parser = commands.add_parser("robot", help="navigation, sensor presets, ROS 2, calibration, nods and pointing")
    parser.add_argument("--only", default="", help="parts to measure, of: " + ", ".join(PARTS))
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when something that is there could not be measured."""
    wanted = chosen("robot", options.only, PARTS)
    if wanted is None:
        return 2
    before = machine()
    absent = {name: reason for name, reason in ((name, why_absent(name)) for name in wanted) if reason}
    values, reasons, failed = measure_all([name for name in wanted if name not in absent], PARTS,
                                          lambda name: {RENAMED.get(key, key): value
                                                        for key, value in source_of(name)().items()})
    reasons.update({key: absent[name] for name in absent for key in PARTS[name]})
    report = make_report(values, reasons, before)
    print(json.dumps(report) if options.json else table_of(report, KEYS, {}))
    return 1 if failed else 0


def make_report(values: Dict[str, object], reasons: Dict[str, str], before: dict) -> dict:
    """Return the JSON object: every figure, null with a reason where there is none."""
    asked = {key for key, _, _ in KEYS}
    return report_of(KEYS, values, reasons, before, {
        "covariance": "simulated people, seeds that no constant was chosen on; ellipses in the plane",
        "people": "ten people, places at 15 Hz", "presets": "a bag of each driver's topics through bag.launch",
        "bridge": "hri_msgs 2.3.2"}, {key: value for key, value in values.items() if key not in asked})


def source_of(part: str) -> Callable[[], Dict[str, object]]:
    """Return the function that measures a part. Raises ImportError or AttributeError where there is none."""
    module, function = SOURCES[part]
    found: Callable[[], Dict[str, object]] = getattr(importlib.import_module("benchmarks." + module), function)
    return found


def why_absent(part: str) -> str:
    """Return why a part cannot be measured, empty when it can."""
    try:
        source_of(part)
    except (ImportError, AttributeError) as error:
        return "not in this tree: {}".format(error)
    return ""


def people_figures() -> Dict[str, object]:
    """The rate of /people with ten people."""
    from benchmarks.stack_run import measure_alone
    found = measure_alone("people", "people_probe", PROBE_S, patience=120.0, launch=[
        "hri_person_manager", "person_manager.launch", "people_msgs:=true"])
    return {"people_msgs_hz": round(float(found["hz"]), 1)}
