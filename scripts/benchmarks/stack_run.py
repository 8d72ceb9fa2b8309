"""A ROS graph of its own for a measurement: a master, the programs on it, and what their processes use.

All programs of a run carry one mark in their environment (see `processes`), so that all of them are found and ended.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import uuid
from pathlib import Path
from typing import BinaryIO, Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple, Union

import processes
import psutil

SCRIPTS = Path(__file__).resolve().parents[1]
ROOT = SCRIPTS.parent
MASTER_PATIENCE_S = 30.0
ROSCORE = ("roscore",)
ROSMASTER = ("rosmaster", "--core")
"""A master without /rosout; it may be killed and started again."""


class StackRunError(RuntimeError):
    """The graph could not be measured; the text says why and where its log is."""


class Usage(NamedTuple):
    """Resident memory (MB), threads, file descriptors, and processor time so far (s)."""

    rss_mb: float
    threads: int
    fds: int
    cpu_s: float


def usage(pid: int) -> Optional[Usage]:
    """Return what a process holds now; None when it has gone."""
    try:
        process = psutil.Process(pid)
        with process.oneshot():
            if process.status() == psutil.STATUS_ZOMBIE:
                return None
            times = process.cpu_times()
            return Usage(process.memory_info().rss / 1e6, process.num_threads(), process.num_fds(),
                         times.user + times.system)
    except psutil.Error:
        return None


def cpu_s(pid: int) -> float:
    """Return the processor time (s) of a process so far, of user and system together; 0 when it has gone."""
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return 0.0
    return times.user + times.system


def command_of(pid: int) -> List[str]:
    """Return the command line of a process; empty when it has gone."""
    try:
        return psutil.Process(pid).cmdline()
    except psutil.Error:
        return []


def name_of(pid: int) -> str:
    """Return the name of the node, or of the program, that a process runs; "?" when it has gone."""
    words = command_of(pid)
    for word in words:
        if word.startswith("__name:="):
            return word[len("__name:="):]
    programs = [Path(word).name for word in words if word and not word.startswith("-")]
    if programs and programs[0].startswith("python") and len(programs) > 1:
        programs = programs[1:]
    return programs[0].replace(".py", "") if programs else "?"


def program_of(pid: int) -> str:
    """Return the file name of the program that a process runs; empty when it has gone."""
    return Path((command_of(pid) or [""])[0]).name


def pid_of_node(mark: str, node: str) -> Optional[int]:
    """Return the process of a node, of those that have a mark; None when there is none."""
    return next((pid for pid in processes.marked(mark, {os.getpid()}) if name_of(pid) == node), None)


class StackRun:
    """A free port for a master, and programs that use that master. A context manager that ends all of them.

    Attributes: folder of the logs, where each program has NAME.log; port and uri of the master; mark; environment of
    the programs.
    """

    def __init__(self, folder: Optional[Path] = None) -> None:
        """Start nothing yet.

        Parameters
        ----------
        folder
            Of the logs. None: a new one, which `remove_logs` removes.
        """
        self._owned = folder is None
        self.folder = Path(tempfile.mkdtemp(prefix="ros4hri-benchmark-")) if folder is None else folder
        self.mark, self.port = "benchmark-" + uuid.uuid4().hex, processes.free_port()
        self.uri = "http://127.0.0.1:{}".format(self.port)
        places = [str(SCRIPTS), os.environ.get("PYTHONPATH", "")]
        self.environment = dict(os.environ, ROS_MASTER_URI=self.uri, ROS_IP="127.0.0.1",
                                ROS_LOG_DIR=str(self.folder / "ros"),
                                PYTHONPATH=os.pathsep.join(place for place in places if place))
        self.environment.pop("ROS_HOSTNAME", None)
        self.environment[processes.MARK_NAME] = self.mark

    def __enter__(self) -> StackRun:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End everything."""
        self.close()

    def start_master(self, command: Sequence[str] = ROSCORE) -> None:
        """Start a master of its own, and wait for it. command: ROSCORE or ROSMASTER.

        Raises StackRunError when it does not answer.
        """
        name = command[0]
        self.start(name, [*command, "-p", str(self.port)])
        if not processes.wait_until(self.master_listens, MASTER_PATIENCE_S):
            raise StackRunError("{} does not answer; its log: {}".format(name, self.folder / (name + ".log")))

    def master_listens(self) -> bool:
        """Tell whether something listens on the port of the master."""
        try:
            with socket.create_connection(("127.0.0.1", self.port), timeout=1.0):
                return True
        except OSError:
            return False

    def start(self, name: str, command: Sequence[str], output: Union[int, BinaryIO, None] = None,
              session: bool = False) -> subprocess.Popen:
        """Start a program; it writes to NAME.log, or its standard output goes to `output`.

        session: in a session of its own, which Ctrl-C of the terminal does not reach.
        """
        with open(str(self.folder / (name + ".log")), "wb") as log:
            return subprocess.Popen(list(command), env=self.environment, stdin=subprocess.DEVNULL,
                                    stdout=log if output is None else output, stderr=log, start_new_session=session)

    def begin(self, name: str, module: str, *arguments: object) -> Callable[[Optional[float]], dict]:
        """Start `python3 -m benchmarks.MODULE ARGUMENTS... FILE`; the returned call waits and returns the JSON object
        of FILE.

        Its argument is the most time (s) to wait, None for ever. It raises StackRunError, with the last line of the
        log, when the program fails or does not end in time.
        """
        result, log = self.folder / (name + ".json"), self.folder / (name + ".log")
        program = self.start(name, [sys.executable, "-m", "benchmarks." + module, *(str(item) for item in arguments),
                                    str(result)])

        def finish(patience: Optional[float] = None) -> dict:
            try:
                code = program.wait(timeout=patience)
            except subprocess.TimeoutExpired as error:
                raise StackRunError("{}: not done after {:g} s; log: {}".format(name, patience, log)) from error
            if code or not result.is_file():
                raise StackRunError("{}: {}; log: {}".format(name, self.last_line(name), log))
            return dict(json.loads(result.read_text(encoding="utf-8")))
        return finish

    def last_line(self, name: str) -> str:
        """Return the last line of a program's log that is not empty."""
        text = (self.folder / (name + ".log")).read_text(encoding="utf-8", errors="replace")
        return ([line for line in text.splitlines() if line.strip()] or ["it said nothing"])[-1]

    def pids(self) -> List[int]:
        """Return the processes of this run, less this one."""
        return processes.marked(self.mark, {os.getpid()})

    def pid_of(self, node: str) -> Optional[int]:
        """Return the process of a node; None when there is none."""
        return pid_of_node(self.mark, node)

    def usage_by_name(self) -> Tuple[Dict[str, float], Dict[str, float]]:
        """Return processor time so far (s) and resident memory (MB), each by the name of node or program."""
        times: Dict[str, float] = {}
        memory: Dict[str, float] = {}
        for pid in self.pids():
            name, held = name_of(pid), usage(pid)
            times[name] = times.get(name, 0.0) + (held.cpu_s if held is not None else 0.0)
            memory[name] = memory.get(name, 0.0) + (held.rss_mb if held is not None else 0.0)
        return times, memory

    def close(self) -> None:
        """End everything that was started. Idempotent."""
        processes.end(self.mark, {os.getpid()})

    def remove_logs(self) -> None:
        """Remove the folder of the logs, if this run has made it."""
        if self._owned:
            shutil.rmtree(str(self.folder), ignore_errors=True)


def measure_alone(name: str, module: str, *arguments: object, patience: Optional[float] = None,
                  launch: Sequence[str] = ()) -> dict:
    """Run a module of the benchmarks on a master of its own, beside what `launch` (arguments of roslaunch) starts.

    Returns what it has found. Raises StackRunError when there is nothing; then the logs stay, else they are removed.
    """
    with StackRun() as run:
        run.start_master()
        if launch:
            run.start("roslaunch", ["roslaunch", "--wait", *launch])
        found = run.begin(name, module, *arguments)(patience)
    run.remove_logs()
    return found
