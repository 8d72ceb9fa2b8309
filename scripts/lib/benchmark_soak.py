"""`scripts/benchmark soak`: the stack for hours, while people come and go all the time; what grows, and what is left of those who went."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Dict, List, Optional, Tuple

from soak_figures import FDS, PARAMETERS, RSS_MB_PER_H, THREADS

KEYS = (
    ("flat", "yes: all below", lambda value: value is True),
    ("rss_mb_per_h", "<= {:g}, every process".format(RSS_MB_PER_H), lambda value: value <= RSS_MB_PER_H),
    ("master_mb_per_h", "told: it keeps every topic name", lambda value: True),
    ("fds_growth", "<= {}, every process".format(FDS), lambda value: value <= FDS),
    ("threads_growth", "<= {}, every process".format(THREADS), lambda value: value <= THREADS),
    ("parameters_growth", "<= {}".format(PARAMETERS), lambda value: value <= PARAMETERS),
    ("left_behind", "0", lambda value: value == 0),
    ("restarted", "none", lambda value: not value),
    ("tracebacks", "0", lambda value: value == 0),
    ("errors", "0", lambda value: value == 0))
EVERY_S = 30.0


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    parser = commands.add_parser("soak", help="memory, threads and what is left behind, over hours of people who come and go")
    parser.add_argument("--minutes", type=float, default=120.0, help="how long, from the first person on (default: 120)")
    parser.add_argument("--samples", default="", help="file (CSV) of the samples, taken every {:g} s (default: one in a temporary "
                        "directory, which is told)".format(EVERY_S))
    parser.add_argument("--read", default="", help="measure nothing; tell what such a file says")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when it is not flat or could not be measured. Ctrl-C ends it early, with what was measured; a second one does not wait until everybody has left."""
    if not options.minutes > 0.0:
        print("scripts/benchmark soak: --minutes must be above 0", file=sys.stderr)
        return 2
    from benchmark_report import machine
    from soak_figures import read
    before = machine()
    if options.read:
        try:
            rows, ends = read(Path(options.read)), {}
        except (OSError, ValueError) as error:
            print("scripts/benchmark soak: {}".format(error), file=sys.stderr)
            return 2
        failure = ""
    else:
        rows, ends, failure = _measure(options.minutes, options.samples)
    report = _report(rows, ends, failure, before)
    from benchmark_parts import table_of
    from soak_figures import process_table
    told = {"flat": "yes" if report["flat"] else "no"}
    print(json.dumps(report) if options.json else table_of(report, KEYS, told) + "\n\n" + process_table(rows))
    return 0 if report["flat"] else 1


def _measure(minutes: float, path: str) -> Tuple[List[dict], Dict[str, dict], str]:
    """Return the samples, what each graph left behind at the end, and why it ended early or could not begin (empty: neither)."""
    from soak_figures import Samples
    from soak_worlds import SCENE_S, SPEED, SoakError, World, crowd, pictures
    stop = _stop_on_signals()
    folder = Path(tempfile.mkdtemp(prefix="ros4hri-soak-"))
    models = Path(os.environ.get("ROS4HRI_MODELS") or Path.home() / ".cache/ros4hri/models")
    worlds: List[World] = []
    ends: Dict[str, dict] = {}
    failure = ""
    rows: List[dict] = []
    try:
        with Samples(Path(path) if path else folder / "samples.csv") as samples:
            rows = samples.rows
            print("samples: {}; starting ...".format(path or folder / "samples.csv"), file=sys.stderr, flush=True)
            for start in (lambda: pictures(folder / "pictures", models),
                          lambda: crowd(folder / "crowd", min(SCENE_S, 0.5 * 60.0 * minutes * SPEED))):
                if not stop.is_set():
                    worlds.append(start())
            _sample_all(worlds, samples, minutes, stop)
            for world in worlds:
                ends[world.name] = _end(world)
    except (SoakError, OSError, KeyboardInterrupt) as error:
        failure = str(error) or "interrupted before everybody had left"
        print("scripts/benchmark soak: {}".format(failure), file=sys.stderr)
    finally:
        for world in worlds:
            world.close()
    if not failure and path:
        shutil.rmtree(str(folder), ignore_errors=True)
    return rows, ends, failure


def _stop_on_signals() -> threading.Event:
    """An event that the first signal sets; the second one raises KeyboardInterrupt, for who will not wait until everybody has left."""
    stop = threading.Event()

    def on_signal(*_: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    return stop


def _sample_all(worlds: List, samples: object, minutes: float, stop: threading.Event) -> None:
    began, number = time.monotonic(), 0
    while not stop.is_set():
        passed = (time.monotonic() - began) / 60.0
        for world in worlds:
            samples.add(world.sample(round(passed, 3)))
        print("{:6.1f} min  ".format(passed) + "; ".join(_line(samples.rows, world.name) for world in worlds), file=sys.stderr, flush=True)
        if passed >= minutes:
            return
        number += 1
        stop.wait(max(0.1, min(began + number * EVERY_S, began + 60.0 * minutes) - time.monotonic()))


def _line(rows: List[dict], world: str) -> str:
    """One graph in a few words: who is there, memory of all processes, their use of a core since the last look."""
    last = rows[-1]["minutes"]
    graph = next(row for row in reversed(rows) if row["world"] == world and row["process"] == "graph")
    held = [row for row in rows if row["world"] == world and row["process"] != "graph" and row["minutes"] == last]
    return "{}: {} of {} persons, {} faces, {:.0f} MB, {:.0f} % CPU".format(
        world, graph["persons"], graph["persons_seen"], graph["faces_seen"], sum(row["rss_mb"] for row in held),
        sum(row["cpu_percent"] for row in held))


def _end(world: object) -> dict:
    left = world.left_over()
    told = world.told()
    return {"left": left, "errors": told["errors"], "first_errors": told["first_errors"], "tracebacks": world.tracebacks()}


def _report(rows: List[dict], ends: Dict[str, dict], failure: str, before: dict) -> dict:
    from benchmark_parts import report_of
    from soak_figures import churn, figures, settled
    from soak_worlds import PICTURE_S, SPEED
    values, reasons = figures(rows)
    if ends:
        values["left_behind"] = sum(_count(end["left"]) for end in ends.values())
        values["tracebacks"] = sum(end["tracebacks"] for end in ends.values())
        values["errors"] = sum(end["errors"] for end in ends.values())
    for name in ("left_behind", "tracebacks", "errors"):
        reasons.setdefault(name, failure or "read from samples, which do not say it")
    wanted = [key for key in KEYS if key[0] != "flat" and not (not ends and not failure and key[0] not in values)]
    if "flat" not in reasons:
        values["flat"] = not failure and all(values.get(key) is not None and is_met(values[key]) for key, _, is_met in wanted)
    minutes = max((float(row["minutes"]) for row in rows), default=0.0)
    inputs = {"time": "{:.1f} min, {} looks; slopes over the last {:.1f} min".format(
        minutes, len({row["minutes"] for row in rows}), minutes - min((float(row["minutes"]) for row in settled(rows)), default=0.0)),
        "pictures": "photographs in turn, {:g} s each, spoken commands; all branches, all values listened to".format(PICTURE_S),
        "crowd": "ten simulated people, {:g} times as fast as the clock, with pauses".format(SPEED)}
    details: Dict[str, Optional[object]] = dict(churn(rows))
    for name, end in ends.items():
        details[name + " left"] = end["left"]
        if end["first_errors"]:
            details[name + " errors"] = end["first_errors"]
    return report_of(KEYS, values, reasons, before, inputs, details)


def _count(left: dict) -> int:
    return sum(value if isinstance(value, int) else len(value) if isinstance(value, list) else 1 for value in left.values())
