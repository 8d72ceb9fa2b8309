"""What the benchmarks have in common: the command line, measuring one part after the other, the machine, the report
as table and JSON, and where the large test data lies: motion capture, groups. That is no part of the project."""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
import traceback
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

Parts = Mapping[str, Sequence[str]]
"""Names of the parts, with the keys of the figures that each gives."""
IsMet = Callable[[Any], bool]
Keys = Sequence[Tuple[str, str, IsMet]]
"""Name of each figure, what is asked, and whether a value meets that."""
DATA_VARIABLE = "ROS4HRI_TEST_DATA"
# A skipped test says this: scripts/test looks for the variable's name, and counts the skip as a failure in CI.
ABSENT = "the test data is absent: {} is not set, and there is no shared/data beside the checkout".format(DATA_VARIABLE)


def most(limit: float) -> IsMet:
    """Return what tells whether a value is a number of at most this size, of either sign."""
    return lambda value: isinstance(value, (int, float)) and abs(value) <= limit


def least(limit: float) -> IsMet:
    """Return what tells whether a value is a number of at least this size."""
    return lambda value: isinstance(value, (int, float)) and value >= limit


def each_most(limits: Mapping[str, float]) -> IsMet:
    """Return what tells whether a value has all of these numbers, none above its limit."""
    return lambda value: isinstance(value, dict) and all(
        isinstance(value.get(name), (int, float)) and value[name] <= limit for name, limit in limits.items())


def least_cost(call: Callable[[], object], repeats: int) -> float:
    """Return the processor time (s) of `repeats` calls, the least of five times."""
    times = []
    for _ in range(5):
        began = time.process_time()
        for _ in range(repeats):
            call()
        times.append(time.process_time() - began)
    return min(times)


def told(value: object) -> bool:
    """Tell whether there is a value; nothing is asked of it."""
    return value is not None


def rounded(value: Any, digits: int = 4) -> Any:
    """Return a number, or the numbers of a dictionary, rounded."""
    if isinstance(value, dict):
        return {name: rounded(number, digits) for name, number in value.items()}
    return round(value, digits) if isinstance(value, float) else value


class Subject:
    """One subject of scripts/benchmark.

    Parameters
    ----------
    name, text
        Of the command, and its line of help.
    keys, parts
        Figures, and which part measures which.
    inputs
        What was measured on, for the report.
    words
        Called with a report; other texts for the values of some figures in the table.
    """

    def __init__(self, name: str, text: str, keys: Keys, parts: Parts, inputs: Mapping[str, object],
                 words: Callable[[dict], Mapping[str, str]] = lambda report: {}) -> None:
        self.name, self.text, self.keys, self.parts, self._words = name, text, keys, parts, words
        self._inputs = dict(inputs)

    def register(self, commands: argparse._SubParsersAction) -> argparse.ArgumentParser:
        """Add the command line; returns its parser."""
        parser: argparse.ArgumentParser = commands.add_parser(self.name, help=self.text)
        parser.add_argument("--only", default="", help="parts to measure, of: " + ", ".join(self.parts))
        parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
        return parser

    def run(self, options: argparse.Namespace, measure: Callable[[str], Mapping[str, object]]) -> int:
        """Measure and print; 1 when something could not be measured, 2 for a wrong command line.

        measure: called with each part, returns its figures; others, and those of its `details`, are told beside them,
        and its `input` among the inputs.
        """
        wanted = chosen(self.name, options.only, self.parts)
        if wanted is None:
            return 2
        before = machine()

        def one(part: str) -> Mapping[str, object]:
            found = dict(measure(part))
            self._inputs.update({part: found.pop("input")} if "input" in found else {})
            return found

        values, reasons, failed = measure_all(wanted, self.parts, one)
        report = self.report(values, reasons, before)
        print(json.dumps(report) if options.json else self.table(report))
        return 1 if failed else 0

    def report(self, values: Mapping[str, object], reasons: Mapping[str, str], before: dict) -> dict:
        """Return the JSON object: every figure, null with a reason where there is none. before: `machine()` of before
        the start."""
        asked = {key for key, _, _ in self.keys}
        return report_of(self.keys, values, reasons, before, self._inputs,
                         {key: value for key, value in values.items() if key not in asked})

    def table(self, report: dict) -> str:
        """Return the same for a person to read."""
        return table_of(report, self.keys, self._words(report))


def chosen(subject: str, only: str, parts: Parts) -> Optional[List[str]]:
    """Return the parts that `--only` names, all without it; None, and a line on standard error, for unknown ones."""
    wanted = [name for name in only.split(",") if name] or list(parts)
    unknown = sorted(set(wanted) - set(parts))
    if unknown:
        print("scripts/benchmark {}: --only knows {}, not {}".format(subject, ", ".join(parts), ", ".join(unknown)),
              file=sys.stderr)
        return None
    return [name for name in parts if name in wanted]


def measure_all(wanted: Sequence[str], parts: Parts,
                measure: Callable[[str], Mapping[str, object]]) -> Tuple[Dict[str, object], Dict[str, str], bool]:
    """Measure the wanted parts; one that fails does not hide the others.

    Returns the values, the reason of each figure that is missing, and whether a part has failed.
    """
    values: Dict[str, object] = {}
    reasons = {key: "not asked for (--only)" for name, keys in parts.items() if name not in wanted for key in keys}
    failed = False
    for name in wanted:
        print("{} ...".format(name), file=sys.stderr, flush=True)
        try:
            found = dict(measure(name))
            values.update(found.pop("details", {}))  # type: ignore[call-overload]
            values.update(found)
            missing = [key for key in parts[name] if key not in found]
            if missing:
                raise KeyError("the figures of {} have no {}".format(name, ", ".join(missing)))
        except Exception as error:
            failed = True
            traceback.print_exc(file=sys.stderr)
            reasons.update({key: "{}: {}".format(type(error).__name__, error) for key in parts[name]})
    return values, reasons, failed


def models_directory() -> Path:
    """Return the directory of the models and pictures."""
    return Path(os.environ.get("ROS4HRI_MODELS") or Path.home() / ".cache/ros4hri/models")


def machine() -> dict:
    """Return what the figures depend on: processor, cores, load, versions."""
    model = "unknown"
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
        if line.lower().startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    versions = {"python": platform.python_version(), "rospy": _output(["rosversion", "rospy"])}
    for name in ("numpy", "cv2", "onnxruntime"):
        try:
            versions[name] = str(getattr(__import__(name), "__version__", "?"))
        except ImportError:
            versions[name] = "missing"
    return {"cpu": model, "cores": len(os.sched_getaffinity(0)), "system": platform.platform(),
            "load_average": [round(load, 2) for load in os.getloadavg()], "versions": versions}


def _output(command: List[str]) -> str:
    try:
        return subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                              check=True).stdout.decode().strip()
    except (OSError, subprocess.CalledProcessError):
        return "?"


def report_of(keys: Keys, values: Mapping[str, object], reasons: Mapping[str, str], before: dict,
              inputs: Mapping[str, object], details: Optional[Mapping[str, object]] = None) -> dict:
    """Return the JSON object: every figure, null with a reason where there is none. before: `machine()` of before the
    start."""
    report: Dict[str, object] = {key: values.get(key) for key, _, _ in keys}
    report["reasons"] = {key: reasons.get(key, "not measured") for key, _, _ in keys if report[key] is None}
    if details is not None:
        report["details"] = dict(details)
    report["machine"] = before
    report["load"] = {"before": before["load_average"], "after": [round(load, 2) for load in os.getloadavg()]}
    report["input"] = dict(inputs)
    return report


def table_of(report: dict, keys: Keys, told: Optional[Mapping[str, str]] = None) -> str:
    """Return the same for a person to read. told: another text for the value of a figure; it may have several lines."""
    wide, asked_wide = (max(len(row[column]) for row in keys) for column in (0, 1))
    row = "{:%d} {:>%d}  {:>3}  {}" % (wide, asked_wide)
    lines: List[str] = [
        "Machine   {cpu}, {cores} cores, {system}".format(**report["machine"]),
        "Load      {} before, {} after".format(*(" ".join(str(load) for load in report["load"][when])
                                                 for when in ("before", "after"))),
        "Input     " + "\n          ".join("{}: {}".format(*item) for item in report["input"].items()), "",
        row.format("figure", "asked", "ok", "measured")]
    for key, asked, is_met in keys:
        value = report[key]
        text = "not measured: " + report["reasons"][key] if value is None else (told or {}).get(key) or short(value)
        lines.append(row.format(key, asked, "-" if value is None else "yes" if is_met(value) else "NO", text))
    if report.get("details"):
        lines += ["", "Beside them"]
        lines += ["  {:28} {}".format(name, short(value)) for name, value in report["details"].items()]
    return "\n".join(lines)


def short(value: object) -> str:
    """Return a value of a report as a short text."""
    if isinstance(value, dict):
        return ", ".join("{} {}".format(name, "({})".format(short(item)) if isinstance(item, dict) else short(item))
                         for name, item in value.items())
    if isinstance(value, (list, tuple)):
        return " ".join(short(item) for item in value)
    return "{:.3g}".format(value) if isinstance(value, float) else str(value)


def data_directory() -> Optional[Path]:
    """Return the directory of the test data, None where there is none.

    It is $ROS4HRI_TEST_DATA, and without that `shared/data` in or beside the checkout.
    Raises NotADirectoryError when the variable names something that is no directory.
    """
    named = os.environ.get(DATA_VARIABLE)
    if named:
        directory = Path(named).expanduser()
        if not directory.is_dir():
            raise NotADirectoryError("{} is {}, which is no directory".format(DATA_VARIABLE, directory))
        return directory
    # <checkout>/scripts/benchmarks/report.py
    parents = list(Path(__file__).resolve().parents)
    for place in parents[2:4]:
        if (place / "shared" / "data").is_dir():
            return place / "shared" / "data"
    return None
