"""`scripts/benchmark identity`: who bears a wrong name, who stays who they are, across images, bodies and cameras."""

from __future__ import annotations

import argparse
import importlib
from typing import Callable, Dict, Mapping, Sequence

from benchmarks.report import Keys, Subject, least, most

PARTS: Dict[str, Sequence[str]] = {
    "names": ("stranger_wrong_name", "enrolled_precision", "enrolled_recall", "closed_sets"),
    "tracks": ("name_stays_p95_s",),
    "returns": ("body_returns_right", "body_returns_wrong", "vtest_idf1", "vtest_switches_per_min", "vtest_ids"),
    "cameras": ("cameras", "handover"),
    "false": ("false_per_1000",),
    "filmed": ("filmed_cameras",)}
"""Each part is the module `identity_PART`, whose `figures()` returns `{key: value}` and `details` for the report."""


def _each(is_met: Callable[[Mapping[str, float]], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, dict) and is_met(value)


def _is_one_person_each(value: Mapping[str, float]) -> bool:
    return value["extra_time"] <= 0.03 and value["wrong_joins"] == 0 and value["error_m"] <= 0.10


KEYS: Keys = (
    ("stranger_wrong_name", "<= 0.01", most(0.01)),
    ("enrolled_precision", ">= 0.99", least(0.99)),
    ("enrolled_recall", ">= 0.80", least(0.80)),
    ("name_stays_p95_s", "<= 1", most(1.0)),
    ("closed_sets", "0 wrong, 5 % unknown", _each(
        lambda value: value["wrong"] == 0 and value["unknown"] <= 0.05 * sum(value.values()))),
    ("body_returns_right", ">= 0.5", least(0.5)),
    ("body_returns_wrong", "0", most(0)),
    ("vtest_idf1", ">= 0.90", least(0.90)),
    ("vtest_switches_per_min", "<= 4", most(4)),
    ("vtest_ids", "<= 24", most(24)),
    ("cameras", "3 %, 0, 0.10 m", _each(_is_one_person_each)),
    ("handover", ">= 0.90, <= 0.05", _each(lambda value: value["kept"] >= 0.90 and value["wrong"] <= 0.05)),
    ("false_per_1000", "<= 1", most(1.0)),
    ("filmed_cameras", "3 %, 0, 0.10 m", _each(_is_one_person_each)))
SUBJECT = Subject("identity", "wrong names, names that stay, bodies that return, several cameras", KEYS, PARTS, {})


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    SUBJECT.register(commands)


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when something could not be measured, 2 for an unknown part."""
    from hri_pipeline.core.process import one_thread_each

    one_thread_each()
    return SUBJECT.run(options, lambda part: importlib.import_module("benchmarks.identity_" + part).figures())
