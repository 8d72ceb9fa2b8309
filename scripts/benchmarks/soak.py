"""`scripts/benchmark soak`: the stack for hours, while people come and go all the time; what grows, and what is left of
those who went.

Samples of all processes are written to a file; slopes of memory (the least of each half minute), and growth of
descriptors, threads and parameters, say whether that is flat.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from statistics import median
from typing import Dict, Iterable, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from benchmarks.report import machine, models_directory, report_of, table_of

FIELDS = ("minutes", "world", "process", "pid", "count", "rss_mb", "threads", "fds", "cpu_percent", "nodes", "topics",
          "services",
          "parameters", "descriptions", "publishers", "known", "errors", "faces", "bodies", "voices", "persons",
          "faces_seen",
          "bodies_seen", "voices_seen", "persons_seen")
GRAPH = "graph"
MASTER = "rosmaster"
"""Grows by nature: it keeps the type of every topic name that there ever was (rosmaster.master_api, topics_types), and
topics hold ids."""
WARM_UP = 0.5            # share of the time that is left out: caches, pools and the memory of known people fill up
LEAST_MINUTES = 10.0     # of measuring; with less a slope says nothing
RSS_MB_PER_H, FDS, THREADS, PARAMETERS = 5.0, 10, 5, 10
"""Most that counts as flat after the warm-up: memory of each process per hour; descriptors and threads of each process,
from the fewest of the first half to the fewest of the second one; parameters of the graph, from the first fifth to the
last fifth."""
_PRESENT = 0.9           # share of the looks in which a process has to be there, to be one that stays
Row = Mapping[str, object]


class Grown(NamedTuple):
    """One process: memory at the end (MB), its slope and the lower end of the slope's interval (MB/h), growth of
    descriptors and threads, mean use of a core (%)."""

    rss_mb: float
    rss_mb_per_h: float
    rss_mb_per_h_least: float
    fds: float
    threads: float
    cpu_percent: float


class LeastMemory:
    """The least memory of each process since it was last told.

    Nodes hand memory back every 20 s or so: what a look sees of that saw depends on its moment, and a line through
    looks 30 s apart rises or falls for hours though the floor of the saw is level.
    """

    def __init__(self) -> None:
        self._least: Dict[int, float] = {}

    def see(self, pid: int, rss_mb: float) -> None:
        """A process holds so much (MB) now."""
        self._least[pid] = min(rss_mb, self._least.get(pid, rss_mb))

    def take(self, pid: int, rss_mb: float) -> float:
        """Return the least (MB) up to now, when it holds `rss_mb`; the next one is of what is seen from now on."""
        return min(rss_mb, self._least.pop(pid, rss_mb))


def slope(times: Sequence[float], values: Sequence[float]) -> Tuple[float, float]:
    """Return the Theil-Sen slope, the median of the slopes of all pairs, and the lower end of its 95 % interval.

    Up to 29 % of outliers do not move it far. P. K. Sen, "Estimates of the regression coefficient based on Kendall's
    tau", J. Am. Stat. Assoc. 63, 1968. The interval is that of samples which do not depend on each other: of such as
    wander, with a correlation of .9, its end is above 0 in a quarter of the times although nothing grows, not in
    2.5 %. ValueError when there are fewer than two different times.
    """
    from scipy.stats import theilslopes
    if len(set(times)) < 2:
        raise ValueError("a slope needs two different times")
    found = theilslopes(values, times, 0.95)
    return float(found[0]), float(found[2])


def growth(values: Sequence[float]) -> float:
    """Return the median of the last fifth less that of the first fifth."""
    part = max(1, len(values) // 5)
    return median(values[-part:]) - median(values[:part])


def floor_growth(values: Sequence[float]) -> float:
    """Return the least of the second half less that of the first half.

    Everybody who is there holds descriptors and threads, and ten come and go; what is held of those who have gone is
    there too at the emptiest moment.
    """
    half = max(1, len(values) // 2)
    return min(values[-half:]) - min(values[:half])


def settled(rows: Iterable[Row]) -> List[Row]:
    """Return the rows after the warm-up."""
    rows = list(rows)
    end = max((float(row["minutes"]) for row in rows), default=0.0)
    return [row for row in rows if float(row["minutes"]) >= WARM_UP * end]


def grown(rows: Iterable[Row]) -> Dict[Tuple[str, str], Grown]:
    """Return the growth after the warm-up by graph and process, of processes that stay."""
    looks: Dict[Tuple[str, str], List[Row]] = {}
    total: Dict[str, int] = {}
    for row in settled(rows):
        if row["process"] == GRAPH:
            total[str(row["world"])] = total.get(str(row["world"]), 0) + 1
        elif row["pid"] not in (None, ""):
            looks.setdefault((str(row["world"]), str(row["process"])), []).append(row)
    found = {}
    for key, kept in looks.items():
        if len(kept) < 2 or len(kept) < _PRESENT * total.get(key[0], 0):
            continue
        columns = {name: [float(row[name]) for row in kept]
                   for name in ("minutes", "rss_mb", "fds", "threads", "cpu_percent")}
        found[key] = Grown(median(columns["rss_mb"][-max(1, len(kept) // 5):]),
                           *(60.0 * one for one in slope(columns["minutes"], columns["rss_mb"])),
                           floor_growth(columns["fds"]), floor_growth(columns["threads"]),
                           sum(columns["cpu_percent"]) / len(kept))
    return found


def restarted(rows: Iterable[Row]) -> List[str]:
    """Return the processes that stay and that had more than one process number: somebody ended and was started
    again."""
    rows = list(rows)
    staying = set(grown(rows))
    pids: Dict[Tuple[str, str], set] = {}
    for row in rows:
        key = (str(row["world"]), str(row["process"]))
        if key in staying and row["pid"] not in (None, ""):
            pids.setdefault(key, set()).add(int(float(row["pid"])))
    return sorted(" ".join(key) for key, numbers in pids.items() if len(numbers) > 1)


def graph_growth(rows: Iterable[Row], name: str) -> Optional[float]:
    """Return the growth of a number of the graph after the warm-up, the largest of all graphs; None without any
    look."""
    columns: Dict[str, List[float]] = {}
    for row in settled(rows):
        if row["process"] == GRAPH and row.get(name) not in (None, ""):
            columns.setdefault(str(row["world"]), []).append(float(row[name]))
    return max((growth(values) for values in columns.values()), default=None)


def figures(rows: Sequence[Row]) -> Tuple[Dict[str, object], Dict[str, str]]:
    """Return the figures that the samples give, and the reasons of those that they do not."""
    found = grown(rows)
    minutes = max((float(row["minutes"]) for row in rows), default=0.0)
    if minutes < LEAST_MINUTES or not found:
        why = "measured for {:.1f} min; {:g} are needed".format(minutes, LEAST_MINUTES)
        return {}, {name: why for name in ("rss_mb_per_h", "rss_mb_per_h_least", "master_mb_per_h", "fds_growth",
                                           "threads_growth", "parameters_growth", "restarted", "flat")}
    ours, masters = ([one for (_, name), one in found.items() if (name == MASTER) is is_master]
                     for is_master in (False, True))
    return {"rss_mb_per_h": round(max((one.rss_mb_per_h for one in ours), default=0.0), 2),
            "rss_mb_per_h_least": round(max((one.rss_mb_per_h_least for one in ours), default=0.0), 2),
            "master_mb_per_h": round(max((one.rss_mb_per_h for one in masters), default=0.0), 2),
            "fds_growth": max(one.fds for one in found.values()),
            "threads_growth": max(one.threads for one in found.values()),
            "parameters_growth": graph_growth(rows, "parameters"), "restarted": restarted(rows)}, {}


def churn(rows: Sequence[Row]) -> Dict[str, object]:
    """Return how many came in each graph, and how many were there at a time."""
    found: Dict[str, object] = {}
    for world in sorted({str(row["world"]) for row in rows}):
        looks = [row for row in rows if row["world"] == world and row["process"] == GRAPH]
        for kind in ("faces", "bodies", "voices", "persons"):
            seen, now = ([int(float(row[name])) for row in looks if row.get(name) not in (None, "")]
                         for name in (kind + "_seen", kind))
            if seen:
                found["{} {}".format(world, kind)] = "{} came, at most {} at a time".format(max(seen), max(now))
        found[world + " % of a core"] = round(sum(float(row["cpu_percent"]) for row in settled(rows)
                                                  if row["world"] == world and row["process"] != GRAPH)
                                              / max(1, len({row["minutes"] for row in settled(rows)
                                                            if row["world"] == world})), 1)
    return found


def process_table(rows: Sequence[Row]) -> str:
    """Return memory, its slope, descriptors, threads and use of the processor of each process that stays."""
    lines = ["{:10} {:24} {:>9} {:>9} {:>9} {:>8} {:>8} {:>7}".format("graph", "process", "MB at end", "MB per h",
                                                                      "at least", "fds", "threads", "CPU %")]
    for (world, name), one in sorted(grown(rows).items()):
        lines.append("{:10} {:24} {:9.1f} {:+9.2f} {:+9.2f} {:+8.0f} {:+8.0f} {:7.1f}".format(world, name, *one))
    return "\n".join(lines)


class Samples:
    """The file of samples: each row is in it as soon as it has been measured. Use it in a `with`."""

    def __init__(self, path: Path) -> None:
        """Raises OSError when the file cannot be written."""
        self.rows: List[Row] = []
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.DictWriter(self._file, FIELDS, restval="")
        self._writer.writeheader()

    def add(self, rows: Iterable[Row]) -> None:
        """Take some rows."""
        for row in rows:
            self.rows.append(row)
            self._writer.writerow({name: value for name, value in row.items() if value is not None})
        self._file.flush()

    def close(self) -> None:
        """Close the file. Idempotent."""
        self._file.close()

    def __enter__(self) -> "Samples":
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()


def read(path: Path) -> List[Row]:
    """Return the rows of a file of samples. ValueError when it is none."""
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != FIELDS:
            raise ValueError("{} holds no samples of a soak".format(path))
        # A run that was killed leaves half a line.
        return [row for row in reader if row["process"] and row["minutes"] and None not in row.values()]


KEYS = (
    ("flat", "yes: all below", lambda value: value is True),
    ("rss_mb_per_h", "<= {:g}, every process".format(RSS_MB_PER_H), lambda value: value <= RSS_MB_PER_H),
    ("rss_mb_per_h_least", "told: below {:g} it may be chance".format(RSS_MB_PER_H), lambda value: True),
    ("master_mb_per_h", "told: it keeps every topic name", lambda value: True),
    ("fds_growth", "<= {}, every process".format(FDS), lambda value: value <= FDS),
    ("threads_growth", "<= {}, every process".format(THREADS), lambda value: value <= THREADS),
    ("parameters_growth", "<= {}".format(PARAMETERS), lambda value: value <= PARAMETERS),
    ("left_behind", "0", lambda value: value == 0),
    ("restarted", "none", lambda value: not value),
    ("tracebacks", "0", lambda value: value == 0),
    ("errors", "0", lambda value: value == 0))
EVERY_S, WATCH_S = 30.0, 2.0


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    parser = commands.add_parser("soak", help="memory, threads and what is left behind, over hours of people who come "
                                              "and go")
    parser.add_argument("--minutes", type=float, default=120.0, help="how long, from the first person on (default: "
                                                                     "120)")
    parser.add_argument("--samples", default="", help="file (CSV) of the samples, taken every {:g} s (default: one in "
                        "a temporary directory, which is told)".format(EVERY_S))
    parser.add_argument("--read", default="", help="measure nothing; tell what such a file says")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def run(options: argparse.Namespace) -> int:
    """Measure and print; 1 when it is not flat or could not be measured.

    Ctrl-C ends it early, with what was measured; a second one does not wait until everybody has left.
    """
    if not options.minutes > 0.0:
        print("scripts/benchmark soak: --minutes must be above 0", file=sys.stderr)
        return 2
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
    told = {"flat": "yes" if report["flat"] else "no"}
    print(json.dumps(report) if options.json else table_of(report, KEYS, told) + "\n\n" + process_table(rows))
    return 0 if report["flat"] else 1


def _measure(minutes: float, path: str) -> Tuple[List[dict], Dict[str, dict], str]:
    """Return the samples, what each graph left behind at the end, and why it ended early or could not begin (empty:
    neither)."""
    from benchmarks.soak_worlds import SCENE_S, SPEED, SoakError, SoakRun, crowd, pictures
    stop = _stop_on_signals()
    folder = Path(tempfile.mkdtemp(prefix="ros4hri-soak-"))
    models = models_directory()
    worlds: List[SoakRun] = []
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
    """An event that the first signal sets; the second one raises KeyboardInterrupt, for who will not wait until
    everybody has left."""
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
        print("{:6.1f} min  ".format(passed) + "; ".join(_line(samples.rows, world.name) for world in worlds),
              file=sys.stderr, flush=True)
        if passed >= minutes:
            return
        number += 1
        due = min(began + number * EVERY_S, began + 60.0 * minutes)
        while not stop.wait(min(WATCH_S, max(0.1, due - time.monotonic()))) and time.monotonic() < due:
            for world in worlds:
                world.watch()


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
    return {"left": left, "errors": told["errors"], "first_errors": told["first_errors"],
            "tracebacks": world.tracebacks()}


def _report(rows: List[dict], ends: Dict[str, dict], failure: str, before: dict) -> dict:
    from benchmarks.soak_worlds import PICTURE_S, SPEED
    values, reasons = figures(rows)
    if ends:
        values["left_behind"] = sum(_count(end["left"]) for end in ends.values())
        values["tracebacks"] = sum(end["tracebacks"] for end in ends.values())
        values["errors"] = sum(end["errors"] for end in ends.values())
    for name in ("left_behind", "tracebacks", "errors"):
        reasons.setdefault(name, failure or "read from samples, which do not say it")
    wanted = [key for key in KEYS if key[0] != "flat" and not (not ends and not failure and key[0] not in values)]
    if "flat" not in reasons:
        values["flat"] = not failure and all(values.get(key) is not None and is_met(values[key]) for key, _,
                                             is_met in wanted)
    minutes = max((float(row["minutes"]) for row in rows), default=0.0)
    inputs = {
        "time": "{:.1f} min, {} looks; slopes over the last {:.1f} min".format(
            minutes,
            len({row["minutes"] for row in rows}),
            minutes - min((float(row["minutes"]) for row in settled(rows)), default=0.0),
        ),
        "pictures": "photographs in turn, {:g} s each, spoken commands; all branches, all values listened to".format(
            PICTURE_S
        ),
        "crowd": "ten simulated people, {:g} times as fast as the clock, with pauses".format(SPEED),
    }
    details: Dict[str, Optional[object]] = dict(churn(rows))
    for name, end in ends.items():
        details[name + " left"] = end["left"]
        if end["first_errors"]:
            details[name + " errors"] = end["first_errors"]
    return report_of(KEYS, values, reasons, before, inputs, details)


def _count(left: dict) -> int:
    return sum(value if isinstance(value, int) else len(value) if isinstance(value, list) else 1
               for value in left.values())
