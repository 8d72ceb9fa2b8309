"""`scripts/benchmark identity`: who bears a wrong name, who stays who they are, across images, bodies and cameras."""

from __future__ import annotations

import argparse
import importlib
import json
from typing import Callable, Dict, Mapping, Sequence, Tuple

from benchmarks.report import chosen, machine, measure_all, report_of, table_of

PARTS: Dict[str, Sequence[str]] = {
    "names": ("stranger_wrong_name", "enrolled_precision", "enrolled_recall", "closed_sets"),
    "tracks": ("name_stays_p95_s",),
    "returns": ("body_returns_right", "body_returns_wrong", "vtest_idf1", "vtest_switches_per_min", "vtest_ids"),
    "cameras": ("cameras", "handover"),
    "false": ("false_per_1000",)}
"""Each part is the module `identity_PART`, whose `figures()` returns `{key: value}` and `details` for the report."""


def _number(is_met: Callable[[float], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, (int, float)) and is_met(float(value))


def _each(is_met: Callable[[Mapping[str, float]], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, dict) and is_met(value)


KEYS: Sequence[Tuple[str, str, Callable[[object], bool]]] = (
    ("stranger_wrong_name", "<= 0.01", _number(lambda value: value <= 0.01)),
    ("enrolled_precision", ">= 0.99", _number(lambda value: value >= 0.99)),
    ("enrolled_recall", ">= 0.80", _number(lambda value: value >= 0.80)),
    ("name_stays_p95_s", "<= 1", _number(lambda value: value <= 1.0)),
    ("closed_sets", "0 wrong, 5 % unknown", _each(
        lambda value: value["wrong"] == 0 and value["unknown"] <= 0.05 * sum(value.values()))),
    ("body_returns_right", ">= 0.5", _number(lambda value: value >= 0.5)),
    ("body_returns_wrong", "0", _number(lambda value: value == 0)),
    ("vtest_idf1", ">= 0.90", _number(lambda value: value >= 0.90)),
    ("vtest_switches_per_min", "<= 4", _number(lambda value: value <= 4)),
    ("vtest_ids", "<= 24", _number(lambda value: value <= 24)),
    ("cameras", "3 %, 0, 0.10 m", _each(
        lambda value: value["extra_time"] <= 0.03 and value["wrong_joins"] == 0 and value["error_m"] <= 0.10)),
    ("handover", ">= 0.90, <= 0.05", _each(lambda value: value["kept"] >= 0.90 and value["wrong"] <= 0.05)),
    ("false_per_1000", "<= 1", _number(lambda value: value <= 1.0)))


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    parser = commands.add_parser("identity", help="wrong names, names that stay, bodies that return, several cameras")
    parser.add_argument("--only", default="", help="parts to measure, of: " + ", ".join(PARTS))
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when something could not be measured, 2 for an unknown part."""
    wanted = chosen("identity", options.only, PARTS)
    if wanted is None:
        return 2
    from hri_pipeline.core.process import one_thread_each

    one_thread_each()
    before = machine()
    inputs: Dict[str, object] = {}
    details: Dict[str, object] = {}

    def measure(part: str) -> Mapping[str, object]:
        found = dict(importlib.import_module("benchmarks.identity_" + part).figures())
        details.update(found.pop("details", {}))
        inputs[part] = found.pop("input", "")
        return found

    values, reasons, failed = measure_all(wanted, PARTS, measure)
    report = report_of(KEYS, values, reasons, before, inputs, details)
    print(json.dumps(report) if options.json else table_of(report, KEYS))
    return 1 if failed else 0
