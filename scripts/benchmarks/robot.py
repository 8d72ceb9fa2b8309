"""`scripts/benchmark robot`: what the rest of the robot gets: navigation, presets, the way to ROS 2, pointing, and
people before a robot that moves."""

from __future__ import annotations

import argparse
import importlib
from typing import Callable, Dict, Sequence, Tuple

from benchmarks.report import Keys, Subject, least, most

PROBE_S = 8.0


def _within(value: object) -> bool:
    return isinstance(value, dict) and all(0.90 <= share <= 0.99 for share in value.values())


# Figure, what is asked, and whether a value is that.
KEYS: Keys = (
    ("covariance_95", ".90 to .99 each", _within), ("people_msgs_hz", ">= 10", least(10.0)),
    ("presets_failed", "0", most(0)), ("bridge_fields_failed", "0", most(0)),
    ("calibration_error_m", "<= 0.05", most(0.05)),
    ("calibration_error_deg", "<= 1", most(1.0)), ("web_first_picture_s", "<= 2", most(2.0)),
    ("pointing_error_deg", "<= 8", most(8.0)),
    ("moving_seen", ">= .9", least(0.9)), ("moving_aside_m", "<= 0.03", most(0.03)), ("moving_nods", "0", most(0)),
    ("moving_stack_kept", ">= .9", least(0.9)), ("moving_stack_others", "0", most(0)),
    ("moving_stack_error_m", "<= 0.15", most(0.15)))

PARTS: Dict[str, Sequence[str]] = {
    "covariance": ("covariance_95",), "people": ("people_msgs_hz",), "presets": ("presets_failed",),
    "bridge": ("bridge_fields_failed",),
    "calibration": ("calibration_error_m", "calibration_error_deg"), "web": ("web_first_picture_s",),
    "pointing": ("pointing_error_deg",), "moving": ("moving_seen", "moving_aside_m", "moving_nods"),
    "moving_stack": ("moving_stack_kept", "moving_stack_others", "moving_stack_error_m")}
SOURCES: Dict[str, Tuple[str, str]] = {
    "covariance": ("covariance", "figures"), "people": ("robot", "people_figures"),
    "presets": ("sensor_presets", "figures"), "bridge": ("ros2_bridge", "figures"),
    "calibration": ("calibration", "calibration_figures"),
    "web": ("web_page", "web_figures"), "pointing": ("attitude", "pointing_figures"),
    "moving": ("moving_robot", "moving_figures"), "moving_stack": ("moving_robot", "stack_figures")}
"""Module of the benchmarks and function that measures each part; it returns the keys of the part and more."""
SUBJECT = Subject("robot", "navigation, sensor presets, ROS 2, calibration, pointing, robots that move", KEYS, PARTS, {
    "covariance": "simulated people, seeds that no constant was chosen on; ellipses in the plane",
    "people": "ten people, places at 15 Hz", "presets": "a bag of each driver's topics through bag.launch",
    "bridge": "hri_msgs 2.3.2", "moving": "three people in a photograph; the head pans, the base turns and drives",
    "moving_stack": "the same through all nodes; transforms 50 ms late; the machine has to be quiet"})


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    SUBJECT.register(commands)


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when something could not be measured."""
    return SUBJECT.run(options, lambda part: source_of(part)())


def source_of(part: str) -> Callable[[], Dict[str, object]]:
    """Return the function that measures a part."""
    module, function = SOURCES[part]
    found: Callable[[], Dict[str, object]] = getattr(importlib.import_module("benchmarks." + module), function)
    return found


def people_figures() -> Dict[str, object]:
    """The rate of /people with ten people."""
    from benchmarks.stack_run import measure_alone
    found = measure_alone("people", "people_probe", PROBE_S, patience=120.0, launch=[
        "hri_person_manager", "person_manager.launch", "people_msgs:=true"])
    return {"people_msgs_hz": round(float(found["hz"]), 1)}
