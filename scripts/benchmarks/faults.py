"""`scripts/benchmark faults`: what the stack does when something breaks, with five people in view.

Each node is killed, the sources of people stop and come back, every input is flooded with garbage, the master is
restarted: once with simulated people, and with photographed people and recorded speech, faces and bodies in two
processes and in one. Told are the times (s) until the same persons are there again, at places of now, with features and
gazes of now; until nobody else is; and what is left behind. Then the disk is filled under the store of people.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional, Sequence

SOON_S = 5.0        # what is asked
WORLDS = {"simulated": "five simulated people", "real": "five photographed people, faces and bodies in two processes, "
                                                        "and speech",
          "vision": "five photographed people, faces and bodies in one process",
          "disk": "a full disk under the store, the logs and TMPDIR"}
_KEYS = {"real": "real_people", "vision": "real_people_one_process", "disk": "full_disk"}
_LEFT = {"parameters_left": "parameter ", "processes_left": "process ", "topics_left": "topic ", "nodes_left": "node "}
_WRONG = (*_LEFT, "nodes_ended_by_garbage", "lost_from_store", "error")
Found = Dict[str, object]


class Recovery(NamedTuple):
    """Times (s) after a fault; None: not within a minute. there: everybody is there again; alone: and nobody else."""

    there: Optional[float]
    alone: Optional[float]


NEVER = Recovery(None, None)


def faults(worlds: Sequence[str] = tuple(WORLDS), only: str = "") -> Found:
    """Run the worlds, each in a process and on a master of its own; only: a part of the names of the faults that are
    wanted.

    Returns what was found with the simulated people, and under keys of their own the others.
    """
    found: Found = {"load_before": round(os.getloadavg()[0], 2)}
    for world in worlds:
        print("{} ...".format(WORLDS[world]), file=sys.stderr, flush=True)
        result = _world(world, only)
        if world in _KEYS:
            found[_KEYS[world]] = result
        else:
            found.update(result)
    return found


def _world(name: str, only: str) -> Found:
    with tempfile.TemporaryDirectory(prefix="ros4hri-faults-") as folder:
        path = Path(folder) / "found.json"
        scripts = str(Path(__file__).resolve().parents[1])
        environment = dict(os.environ, PYTHONPATH=os.pathsep.join(filter(None,
                                                                         [scripts, os.environ.get("PYTHONPATH")])))
        process = subprocess.Popen([sys.executable, "-m", "benchmarks.fault_runs", name, str(path), only],
                                   env=environment,
                                   stdin=subprocess.DEVNULL, stdout=sys.stderr)
        try:
            code = process.wait()
        finally:
            if process.poll() is None:      # interrupted: it ends what it has started, and takes its disk away
                process.terminate()
                process.wait()
        if not path.is_file():
            return {"error": "the run has ended with code {}".format(code)}
        return told(json.loads(path.read_text(encoding="utf-8")))


def told(found: Found) -> Found:
    """Return what a world has written, with recoveries for pairs of times, and what was left behind by its kind."""
    if "recovery_s" in found:
        found["recovery_s"] = {name: Recovery(*times) for name, times in found["recovery_s"].items()}
        things = sorted({thing for left in found["left_after"].values() for thing in left})
        for key, kind in _LEFT.items():
            found[key] = [thing[len(kind):] for thing in things if thing.startswith(kind)]
    return found


def _parts(found: Found) -> Dict[str, Found]:
    """The findings of each world that was run, by its name."""
    keys = {key: name for name, key in _KEYS.items()}
    parts = {keys[key]: value for key, value in found.items() if key in keys}
    own = {key: value for key, value in found.items() if key not in keys and key != "load_before"}
    return dict({"simulated": own} if own else {}, **parts)


def as_table(found: Found) -> str:
    """Return the figures for a person to read."""
    lines: List[str] = []
    for world, part in _parts(found).items():
        lines += ["", WORLDS[world], ""] if lines else []
        if "recovery_s" in part:
            lines.append("{:48} {:>12} {:>12}  {}".format("fault", "all there, s", "alone, s",
                                                          "within {:g} s".format(SOON_S)))
        for name, recovery in part.get("recovery_s", {}).items():
            lines.append(
                "{:48} {:>12} {:>12}  {}".format(
                    name,
                    *("never" if seconds is None else "{:.2f}".format(seconds) for seconds in recovery),
                    "yes" if recovery.there is not None and recovery.there <= SOON_S else "NO",
                )
            )
        lines += ["{:48} {}".format(name.replace("_", " "), value if value or value is False else "none") for name,
                  value in part.items()
                  if name not in ("recovery_s", "problems_told")]
    return "\n".join(lines)


def went_wrong(found: Found) -> bool:
    """Tell whether something did not come back, was left behind, or was lost."""
    return any(any(recovery.there is None for recovery in part.get("recovery_s", {}).values())
               or any(part.get(name) for name in _WRONG)
               or (world == "disk" and any(value is False or value is None for value in part.values()))
               for world, part in _parts(found).items())


def as_json(found: Found) -> str:
    """Return the figures as one JSON object."""
    return json.dumps({key: _plain(value) if isinstance(value, dict) else value for key,
                       value in _plain(found).items()})


def _plain(part: Found) -> Found:
    if "recovery_s" not in part:
        return part
    return dict(part, recovery_s={name: recovery._asdict() for name, recovery in part["recovery_s"].items()})


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    parser = commands.add_parser("faults", help="how soon people are there again after something broke, and what is "
                                                "left behind")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--worlds", default=",".join(WORLDS),
                        help="of: {}".format("; ".join("{}: {}".format(*item) for item in WORLDS.items())))
    parser.add_argument("--only", default="", help="only faults with this in their names, such as `kill` or `/tf`")


def run(options: argparse.Namespace) -> int:
    """Break things and print; 1 when something did not come back, was left behind, or nothing could be measured."""
    worlds = options.worlds.split(",")
    if not set(worlds) <= set(WORLDS):
        print("scripts/benchmark faults: --worlds is {!r}, legal: {}".format(options.worlds, ", ".join(WORLDS)),
              file=sys.stderr)
        return 2
    found = faults(worlds, options.only)
    print(as_json(found) if options.json else as_table(found))
    return int(went_wrong(found))
