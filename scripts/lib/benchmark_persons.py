"""`scripts/benchmark persons`: the person manager against faces and bodies made by the benchmark."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path
from typing import Callable, Dict, List, Sequence, Tuple

import processes
from benchmark_parts import chosen, measure_all

LIB = Path(__file__).resolve().parent

KEYS: Sequence[Tuple[str, str]] = (
    ("latency_p50_ms", "<= 5"), ("latency_p99_ms", "<= 20"),
    ("latency_p50_ms_300", "<= 5"), ("latency_p99_ms_300", "<= 20"),
    ("latency_p50_ms_1800", "<= 5"), ("latency_p99_ms_1800", "<= 20"),
    ("persons_10", "10"), ("persons_30", "30"), ("dropped", "0"), ("cpu_percent_10", "<= 10"),
    ("cpu_percent_30", "<= 30"), ("linked_7x7_ms", "<= 50"), ("chain_12_ms", "<= 50"), ("churn_rss_mb", "<= 1"),
    ("rest_rss_mb", "<= 1"), ("confidence_curve", "1, below 1 at once, falls to 0"), ("recover_s", "<= 5"),
    ("kill_damaged", "0"))


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    parser = commands.add_parser("persons", help="latency, processor, memory and recovery of the person manager")
    parser.add_argument("--only", default="", help="parts to measure, of: " + ", ".join(PARTS))
    parser.add_argument("--soak", type=float, default=1.0,
                        help="length of the memory runs, 1 = 5 minutes of coming and going and 10 of rest (default: 1)")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


PARTS: Dict[str, Sequence[str]] = {
    "latency": ("latency_p50_ms", "latency_p99_ms", "latency_p50_ms_300", "latency_p99_ms_300", "latency_p50_ms_1800",
                "latency_p99_ms_1800"),
    "crowd": ("persons_10", "persons_30", "dropped", "cpu_percent_10", "cpu_percent_30"),
    "hard": ("linked_7x7_ms", "chain_12_ms"), "confidence": ("confidence_curve",), "recover": ("recover_s",),
    "kill": ("kill_damaged",), "soak": ("churn_rss_mb", "rest_rss_mb")}


class Stage:
    """A roscore and the person manager, respawned as in the stack, and scenarios beside them."""

    def __init__(self, logs: Path) -> None:
        self._logs = Path(tempfile.mkdtemp(dir=str(logs)))
        self._mark = "benchmark-" + uuid.uuid4().hex
        port = processes.free_port()
        self._environment = dict(os.environ, ROS_MASTER_URI="http://127.0.0.1:{}".format(port), ROS_IP="127.0.0.1",
                                 ROS_LOG_DIR=str(self._logs / "ros"))
        self._environment.pop("ROS_HOSTNAME", None)
        self._environment[processes.MARK_NAME] = self._mark
        # A master of its own, not roslaunch's: one scenario kills it.
        self._start("rosmaster", ["rosmaster", "--core", "-p", str(port)])
        processes.wait_until(lambda: _listens(port), 10.0)
        self._start("roslaunch", ["roslaunch", "hri_person_manager", "person_manager.launch"])

    def begin(self, name: str, *numbers: float) -> Callable[[], dict]:
        """Start a scenario; the returned call waits for its end and returns what it found."""
        result = self._logs / (name + ".json")
        process = self._start(name, [sys.executable, str(LIB / "persons_scenarios.py"), name, str(result)]
                              + [str(number) for number in numbers])

        def finish() -> dict:
            if process.wait() or not result.exists():
                log = (self._logs / (name + ".log")).read_text(encoding="utf-8", errors="replace")
                raise RuntimeError(log.strip().splitlines()[-1] if log.strip() else "ended without a word")
            return json.loads(result.read_text(encoding="utf-8"))
        return finish

    def close(self) -> None:
        """End everything. May be called again."""
        processes.end(self._mark, {os.getpid()})

    def _start(self, name: str, command: List[str]) -> subprocess.Popen:
        with open(str(self._logs / (name + ".log")), "wb") as log:
            return subprocess.Popen(command, env=self._environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log)


def _listens(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _measure(part: str, logs: Path, soak: float) -> dict:
    """Figures of one part."""
    if part == "kill":
        from persons_kill import kill_writer
        return kill_writer()
    if part == "recover":
        return _recover(logs)
    scenarios = [("churn", 300.0 * soak), ("rest", 600.0 * soak)] if part == "soak" else [(part,)]
    stages: List[Stage] = []
    found: Dict[str, object] = {}
    try:
        running = []
        for name, *numbers in scenarios:
            stages.append(Stage(logs))
            running.append(stages[-1].begin(name, *numbers))
        for finish in running:
            found.update(finish())
    finally:
        for stage in stages:
            stage.close()
    return found


def _recover(logs: Path) -> dict:
    """The longest recovery of all, one after the other."""
    found: Dict[str, object] = {}
    for name in ("recover", "recover_clock", "recover_master"):
        stage = Stage(logs)
        try:
            found.update(stage.begin(name)())
        finally:
            stage.close()
    found["recover_s"] = max(value for key, value in found.items() if key.startswith("recover_after_"))
    return found


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when something could not be measured."""
    wanted = chosen("persons", options.only, PARTS)
    if not options.soak > 0.0:
        print("scripts/benchmark persons: --soak must be above 0", file=sys.stderr)
    if wanted is None or not options.soak > 0.0:
        return 2
    from benchmark_report import machine
    before = machine()
    logs = Path(tempfile.mkdtemp(prefix="ros4hri-benchmark-"))
    values, reasons, failed = measure_all(wanted, PARTS, lambda name: _measure(name, logs, options.soak))
    report: Dict[str, object] = {key: values.get(key) for key, _ in KEYS}
    report["reasons"] = {key: reasons.get(key, "not measured") for key, _ in KEYS if report[key] is None}
    report["details"] = {key: value for key, value in values.items() if key not in report}
    report["machine"] = before
    print(json.dumps(report) if options.json else _table(report))
    if failed:
        print("logs: {}".format(logs), file=sys.stderr)
    else:
        shutil.rmtree(str(logs), ignore_errors=True)
    return 1 if failed else 0


def _table(report: dict) -> str:
    lines: List[str] = ["{:22} {:>32}  {}".format("figure", "wanted", "measured")]
    for key, asked in KEYS:
        lines.append("{:22} {:>32}  {}".format(key, asked, _short(report[key])))
    lines += ["{}: {}".format(key, value) for key, value in sorted(report["details"].items())]
    lines += ["not measured, {}: {}".format(key, why) for key, why in report["reasons"].items()]
    lines.append("machine: {cpu}, {cores} cores, load {load_average}".format(**report["machine"]))
    return "\n".join(lines)


def _short(value: object) -> str:
    if isinstance(value, list):
        shown = value[:: max(1, len(value) // 12)]
        return ", ".join("{:g} s {:.2f}".format(*pair) for pair in shown)
    return "-" if value is None else "{:g}".format(value) if isinstance(value, (int, float)) else str(value)

