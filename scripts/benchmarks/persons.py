"""`scripts/benchmark persons`: the person manager against faces and bodies made by the benchmark."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Callable, Dict, Sequence

from benchmarks.report import Keys, Subject, most

if TYPE_CHECKING:
    from benchmarks.stack_run import StackRun


def _falls(value: object) -> bool:
    """Tell whether a confidence stays at 1, and falls to 0 at last."""
    return isinstance(value, list) and value[0][1] == 1.0 and value[-1][1] == 0.0


KEYS: Keys = (
    *(("latency_p{}_ms{}".format(part, seconds), "<= {}".format(limit), most(limit))
      for seconds in ("", "_300", "_1800") for part, limit in ((50, 5), (99, 20))),
    ("persons_10", "10", lambda value: value == 10), ("persons_30", "30", lambda value: value == 30),
    ("dropped", "0", most(0)), ("cpu_percent_10", "<= 10", most(10)), ("cpu_percent_30", "<= 30", most(30)),
    ("linked_7x7_ms", "<= 50", most(50)), ("chain_12_ms", "<= 50", most(50)), ("churn_rss_mb", "<= 1", most(1)),
    ("rest_rss_mb", "<= 1", most(1)), ("confidence_curve", "1, below 1 at once, falls to 0", _falls),
    ("recover_s", "<= 5", most(5)), ("kill_damaged", "0", most(0)), ("who_wins", "10", lambda value: value == 10),
    ("persons_200", "200", lambda value: value == 200), ("linked_15_ms", "<= 100", most(100)),
    ("late_body_taken", "0", most(0)), ("forget_undone", "0", most(0)))
PARTS: Dict[str, Sequence[str]] = {
    "latency": ("latency_p50_ms", "latency_p99_ms", "latency_p50_ms_300", "latency_p99_ms_300", "latency_p50_ms_1800",
                "latency_p99_ms_1800"),
    "crowd": ("persons_10", "persons_30", "dropped", "cpu_percent_10", "cpu_percent_30"),
    "hard": ("linked_7x7_ms", "chain_12_ms"), "confidence": ("confidence_curve",), "recover": ("recover_s",),
    "kill": ("kill_damaged",), "rules": ("who_wins", "linked_15_ms", "late_body_taken"), "many": ("persons_200",),
    "forget": ("forget_undone",), "soak": ("churn_rss_mb", "rest_rss_mb")}
FORGET_S = 60.0
"""Time (s) in which two processes learn and forget persons in one store."""
USUAL_DESCRIPTORS = 1024
"""Soft limit of open descriptors that most systems give a process."""


def begin(run: StackRun, scenario: str, *numbers: float, descriptors: int = 0) -> Callable[[], dict]:
    """Start a master, the person manager, respawned as in the stack, and a scenario beside them.

    descriptors: soft limit of the manager's open descriptors; 0 leaves it as it is. The returned call waits for the end
    of the scenario and returns what it found.
    """
    from benchmarks.stack_run import ROSMASTER

    # A master of its own, not roslaunch's: one scenario kills it.
    run.start_master(ROSMASTER)
    limit = ["prlimit", "--nofile={}:".format(descriptors)] if descriptors else []
    run.start("roslaunch", [*limit, "roslaunch", "hri_person_manager", "person_manager.launch"])
    return run.begin(scenario, "persons_scenarios", scenario, *numbers)


def _measure(part: str, logs: Path, soak: float) -> dict:
    """Figures of one part."""
    if part == "kill":
        from benchmarks.store import kill_writer
        return kill_writer()
    if part == "forget":
        from benchmarks.store import forget_undone
        return {"forget_undone": forget_undone(FORGET_S, Path(tempfile.mkdtemp(dir=str(logs))))}
    if part == "recover":
        return _recover(logs)
    if part == "rules":
        from benchmarks.persons_rules import rules
        return rules()
    scenarios = [("churn", 300.0 * soak), ("rest", 600.0 * soak)] if part == "soak" else [(part,)]
    from benchmarks.stack_run import StackRun
    found: Dict[str, object] = {}
    with ExitStack() as running:
        finishing = [begin(running.enter_context(StackRun(Path(tempfile.mkdtemp(dir=str(logs))))), name, *numbers,
                           descriptors=USUAL_DESCRIPTORS if part == "many" else 0) for name, *numbers in scenarios]
        for finish in finishing:
            found.update(finish())
    return found


def _recover(logs: Path) -> dict:
    """The longest recovery of all, one after the other."""
    from benchmarks.stack_run import StackRun
    found: Dict[str, object] = {}
    for name in ("recover", "recover_clock", "recover_master"):
        with StackRun(Path(tempfile.mkdtemp(dir=str(logs)))) as run:
            found.update(begin(run, name)())
    found["recover_s"] = max(value for key, value in found.items() if key.startswith("recover_after_"))
    return found


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    SUBJECT.register(commands).add_argument(
        "--soak", type=float, default=1.0,
        help="length of the memory runs, 1 = 5 minutes of coming and going and 10 of rest (default: 1)")


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when something could not be measured, and then the logs stay."""
    if not options.soak > 0.0:
        print("scripts/benchmark persons: --soak must be above 0", file=sys.stderr)
        return 2
    logs = Path(tempfile.mkdtemp(prefix="ros4hri-benchmark-"))
    code = SUBJECT.run(options, lambda part: _measure(part, logs, options.soak))
    if code == 1:
        print("logs: {}".format(logs), file=sys.stderr)
    else:
        shutil.rmtree(str(logs), ignore_errors=True)
    return code


def _words(report: dict) -> Dict[str, str]:
    """The curve of the confidence in a dozen points."""
    curve = report["confidence_curve"] or []
    return {"confidence_curve": ", ".join("{:g} s {:.2f}".format(*pair) for pair in curve[::max(1, len(curve) // 12)])}


SUBJECT = Subject("persons", "latency, processor, memory and recovery of the person manager", KEYS, PARTS, {}, _words)
