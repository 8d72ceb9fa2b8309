"""What the benchmarks have in common: the choice of the parts, measuring one after the other, the machine, the report
as table and JSON."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

Parts = Mapping[str, Sequence[str]]
"""Names of the parts, with the keys of the figures that each gives."""


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
            values.update(measure(name))
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


Keys = Sequence[Tuple[str, str, Callable[[object], bool]]]
"""Name of each figure, what is asked, and whether a value meets that."""


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
