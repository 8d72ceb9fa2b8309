"""How long it takes from the command to people: scripts/demo on a machine where nothing is set up yet, and where all
is."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional

ROOT = Path(__file__).resolve().parent.parent.parent
FRESH = ("checkout", "Python environment", "models", "catkin workspace", "caches of pip and npm")
NEEDED_BYTES = 3 * 10 ** 9
# By what this user reaches the package indexes; without them a fresh home directory would reach none behind a proxy.
NETWORK_SETTINGS = (".npmrc", ".netrc", ".pip/pip.conf", ".config/pip/pip.conf")
# A row of the demonstration's table: id, face, body, voice, confidence, with a face or body seen now.
_PERSON = re.compile(r"^\S+ +(?:\w+ +\S+|- +\w+) +\S+ +1\.00 ")
_STEP = re.compile(r"^\[\d+/\d+\] (.+)$")
_DONE = re.compile(r"\((\d+\.\d) s\)$")


class Start(NamedTuple):
    """s from the command to the first person, None with the reason why; s of each step of the set-up; what was set up
    anew, what not."""

    seconds: Optional[float]
    why_not: str
    steps: Dict[str, float] = {}
    fresh: List[str] = []
    not_fresh: List[str] = []


def shows_a_person(line: str) -> bool:
    """Tell whether a line of the demonstration is the row of a person who is seen now."""
    return _PERSON.match(line) is not None


def step_times(lines: List[str]) -> Dict[str, float]:
    """Return what the demonstration says of its own steps, s."""
    steps: Dict[str, float] = {}
    title = ""
    for line in lines:
        begun, done = _STEP.match(line), _DONE.search(line)
        if begun:
            title = begun.group(1)
        elif done and title and title not in steps:
            steps[title] = float(done.group(1))
    return steps


def run_demo(root: Path, limit: float, environment: Optional[Dict[str, str]] = None) -> Start:
    """Run scripts/demo of a checkout until somebody is in its table, `limit` s at most."""
    began = time.monotonic()
    demo = subprocess.Popen([str(root / "scripts" / "demo"), "--no-rviz", "--seconds", str(int(limit))], text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=environment)
    assert demo.stdout is not None
    lines: List[str] = []
    found: Optional[float] = None
    timer = threading.Timer(limit, demo.send_signal, (signal.SIGINT,))
    timer.start()
    try:
        for line in demo.stdout:
            lines.append(line.strip())
            if shows_a_person(line):
                found = time.monotonic() - began
                break
    finally:
        timer.cancel()
        demo.send_signal(signal.SIGINT)
        demo.stdout.read()
        demo.wait(60.0)
    return Start(found, "" if found is not None else "nobody appeared: " + " | ".join(lines[-3:]), step_times(lines))


def second_run(limit: float = 180.0) -> Start:
    """Measure where all is installed and built; what has been changed since the last run is built before."""
    ready = subprocess.run(["bash", str(ROOT / "scripts/lib/in_workspace.sh"), "scripts/benchmark", "true"],
                           stdin=subprocess.DEVNULL,
                           stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if ready.returncode:
        return Start(None, "the set-up failed: " + " | ".join(ready.stdout.splitlines()[-3:]))
    return run_demo(ROOT, limit)


def first_run(limit: float = 1200.0) -> Start:
    """Measure with everything set up anew but the system's packages: a clone of HEAD with an empty home directory.

    Needs the network, git, and 3 GB in the directory of temporary files.
    """
    folder = Path(tempfile.mkdtemp(prefix="ros4hri-first-run-"))
    try:
        if shutil.disk_usage(str(folder)).free < NEEDED_BYTES:
            return Start(None, "less than 3 GB are free in {}; set TMPDIR".format(folder.parent))
        cloned = subprocess.run(["git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(folder / "ros4hri")],
                                stdin=subprocess.DEVNULL,
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
        if cloned.returncode:
            return Start(None, "no clone of this checkout: " + cloned.stdout.strip())
        before = _installed_packages()
        found = run_demo(folder / "ros4hri", limit, fresh_environment(folder / "home"))
        added = len(_installed_packages() - before)
        return found._replace(fresh=list(FRESH) + (["{} system packages".format(added)] if added else []),
                              not_fresh=["system packages that were there before"])
    except OSError as error:
        return Start(None, str(error))
    finally:
        shutil.rmtree(str(folder), ignore_errors=True)


def fresh_environment(home: Path) -> Dict[str, str]:
    """Return the environment of a user with an empty home directory, who reaches the same package indexes."""
    environment = {name: value for name, value in os.environ.items()
                   if not name.startswith(("ROS", "XDG_")) and name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    for name in NETWORK_SETTINGS:
        source = Path.home() / name
        if source.is_file():
            (home / name).parent.mkdir(parents=True, exist_ok=True)
            (home / name).symlink_to(source)
    home.mkdir(parents=True, exist_ok=True)
    # What pip keeps is fresh with the home directory, unless its own settings name another place.
    environment.update(HOME=str(home), PIP_CACHE_DIR=str(home / ".cache/pip"), npm_config_cache=str(home / ".npm"))
    return environment


def _installed_packages() -> set:
    listing = subprocess.run(["dpkg-query", "-W", "-f", "${db:Status-Status} ${Package}\n"], stdout=subprocess.PIPE,
                             text=True, check=False)
    return {line for line in listing.stdout.splitlines() if line.startswith("installed ")}


if __name__ == "__main__":
    print(first_run() if sys.argv[1:] == ["first"] else second_run())
