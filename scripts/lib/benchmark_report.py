"""Figures of the benchmark, as a table and as one JSON object."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence

from benchmark_start import Start

_NOT_ASKED = "not asked for (--start)"
NOT_STACK = ("benchmark_probe", "image_source")


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


def figures(people: int, seen: dict) -> dict:
    """Return the figures of one scene.

    A rate is the number of different image stamps per second at the frame of a person (face, body), averaged
    over the people of the scene; one who is not found counts with 0, one too many does not count.
    """
    import numpy as np  # not above: the command line is read before the environment with numpy is entered

    rates = {kind: round(sum(found[:people]) / people, 2) for kind, found in seen["rates"].items()}
    ages = 1e3 * np.array(seen["ages"] or [np.nan])
    middle, high = (None if np.isnan(value) else round(float(value), 1) for value in np.percentile(ages, [50, 95]))
    cpu: Dict[str, float] = seen["cpu_percent"]
    return {
        "people": people, "fps": rates["person"], "faces_fps": rates["face"], "bodies_fps": rates["body"],
        "found": {kind: seen["tracked"].get(kind, 0) for kind in ("persons", "faces", "bodies")},
        "age_p50_ms": middle, "age_p95_ms": high,
        "cpu_percent": round(sum(value for name, value in cpu.items() if name not in NOT_STACK), 1),
        "cpu_percent_by_process": cpu, "rss_mb_by_process": seen.get("rss_mb", {}),
        "rss_mb": round(sum(value for name, value in seen.get("rss_mb", {}).items() if name not in NOT_STACK), 1),
        "stages_ms": seen["stages_ms"], "seconds": round(seen["seconds"], 2)}


def as_json(rows: Sequence[dict], before: dict, described: dict, starts: Optional[Mapping[str, Start]] = None) -> dict:
    """Return the JSON object of all scenes; starts: what was measured of the "first" and "second" run of scripts/demo."""
    result: dict = {"machine": before, "input": described, "stages_ms": {}, "scenes": list(rows), "reasons": {}}
    for name in ("first", "second"):
        start = (starts or {}).get(name, Start(None, _NOT_ASKED))
        result[name + "_run_s"] = None if start.seconds is None else round(start.seconds, 1)
        result[name + "_run"] = {"steps_s": start.steps, "fresh": start.fresh, "not_fresh": start.not_fresh}
        if start.seconds is None:
            result["reasons"][name + "_run_s"] = start.why_not
    for row in rows:
        number = row["people"]
        for key in ("fps", "faces_fps", "bodies_fps", "age_p50_ms", "age_p95_ms", "cpu_percent", "rss_mb"):
            result["{}_{}".format(key, number)] = row[key]
        for key in ("cpu_percent_by_process", "rss_mb_by_process"):
            result["{}_{}".format(key, number)] = row[key]
        result["stages_ms"][str(number)] = row["stages_ms"]
    return result


def starts_as_text(starts: Mapping[str, Start]) -> str:
    """Return the times from scripts/demo to the first person, for a person to read."""
    lines = [""] + ["from scripts/demo to the first person: not measured; --start does"] * (not starts)
    for name, start in starts.items():
        lines.append("{} run, from scripts/demo to the first person: {}".format(
            name, start.why_not if start.seconds is None else "{:.1f} s".format(start.seconds)))
        lines += ["  {:35s} {:7.1f} s".format(title, seconds) for title, seconds in start.steps.items()]
        lines += ["  {}: {}".format(title, ", ".join(things)) for title, things in (("set up anew", start.fresh), ("there before", start.not_fresh)) if things]
    return "\n".join(lines)


def as_table(rows: Sequence[dict], before: dict, described: dict) -> str:
    """Return the same for a person to read."""
    lines: List[str] = [
        "Machine   {cpu}, {cores} cores, {system}".format(**before),
        "Load      {} before the start".format(" ".join(str(load) for load in before["load_average"])),
        "Versions  " + ", ".join("{} {}".format(*item) for item in before["versions"].items()),
        "Input     " + ", ".join("{} {}".format(*item) for item in described.items()), "",
        "people  persons/s  faces/s  bodies/s  found p/f/b   age p50   age p95  processor"]
    for row in rows:
        lines.append("{people:6d} {fps:10.1f} {faces_fps:8.1f} {bodies_fps:9.1f}  {found:>11}  {p50:>8}  {p95:>8}  "
                     "{cpu_percent:6.0f} %".format(**dict(
                         row, found="{persons}/{faces}/{bodies}".format(**row["found"]),
                         p50=_ms(row["age_p50_ms"]), p95=_ms(row["age_p95_ms"]))))
    for row in rows:
        lines += ["", "{} people: processor, % of one core; memory, MB".format(row["people"])]
        lines += ["  {:28s} {:6.1f} {:7.0f}".format(name, value, row["rss_mb_by_process"].get(name, 0.0))
                  for name, value in row["cpu_percent_by_process"].items() if value >= 0.1]
        lines += ["{} people: ms per stage                 median     p95".format(row["people"])]
        lines += ["  {:35s} {:7.1f} {:7.1f}".format(node + " " + stage, times.get("median", 0.0), times.get("p95", 0.0))
                  for node, stages in sorted(row["stages_ms"].items()) for stage, times in stages.items()]
    return "\n".join(lines)


def _ms(value: object) -> str:
    return "-" if value is None else "{:.0f} ms".format(value)
