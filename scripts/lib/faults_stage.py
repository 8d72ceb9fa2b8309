"""A master and launch files, for the fault tests: nodes to kill, sources to unplug, and what is left of the processes."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections import Counter
from pathlib import Path
from typing import BinaryIO, Dict, List, Optional, Set, Union

import processes
import rosgraph

ROOT = Path(__file__).resolve().parents[2]
BAG_TESTS = ROOT / "rosbag_tests"
sys.path.insert(0, str(BAG_TESTS))
import fault_graph  # noqa: E402

PATIENCE_S = 60.0
RECOGNISER = b"speech_worker"
_END_S = 15.0


class Stage:
    """A master of its own, and launch files by name; close() ends all of it.

    place: where logs and temporary files are made, a new folder when None. Raises RuntimeError when no master comes.
    """

    def __init__(self, place: Optional[Path] = None) -> None:
        self._output = tempfile.TemporaryFile()     # not on a disk that is to be filled
        self._owned = None if place is not None else tempfile.mkdtemp(prefix="ros4hri-faults-")
        self.folder = Path(place or self._owned)
        self._mark, self._port = "faults-" + uuid.uuid4().hex, processes.free_port()
        os.environ.update({"ROS_MASTER_URI": "http://127.0.0.1:{}".format(self._port), "ROS_IP": "127.0.0.1",
                           "ROS_LOG_DIR": str(self.folder / "ros"), "TMPDIR": str(self.folder), processes.MARK_NAME: self._mark})
        os.environ.pop("ROS_HOSTNAME", None)
        self._launched: Dict[str, subprocess.Popen] = {}
        # Not the master of roslaunch, which ends everything with its master.
        self._start_master()
        if not processes.wait_until(rosgraph.is_master_online, PATIENCE_S):
            self.close()
            raise RuntimeError("no master")

    def launch(self, name: str, text: str) -> None:
        """Start a launch file with these lines in it."""
        master = rosgraph.Master("/faults")
        if not master.hasParam("/run_id"):
            # Each roslaunch makes one otherwise, and two that start together refuse each other's.
            master.setParam("/run_id", str(uuid.uuid4()))
        path = self.folder / (name + ".launch")
        path.write_text("<launch>\n{}\n</launch>\n".format(text), encoding="utf-8")
        self._launched[name] = _start(["roslaunch", str(path)], self._output)

    def end(self, name: str) -> None:
        """End a launch file as Ctrl-C does, and wait for it."""
        process = self._launched.pop(name, None)
        if process is not None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def kill_node(self, node: str) -> Optional[int]:
        """Kill a node without mercy; returns the process id that it had, None where it does not answer."""
        pid = fault_graph.pid_of(node)
        if pid is not None:
            os.kill(pid, signal.SIGKILL)
        return pid

    def restart_master(self) -> None:
        """Kill the master, and start another at the same place."""
        for pid in self.pids_of(b"rosmaster"):
            os.kill(pid, signal.SIGKILL)
        processes.wait_until(lambda: not rosgraph.is_master_online(), PATIENCE_S)
        self._start_master()

    def pids(self) -> List[int]:
        """All processes of this run but this one."""
        return processes.marked(self._mark, {os.getpid()})

    def pids_of(self, word: bytes) -> List[int]:
        """The processes of this run with this in their command line."""
        return [pid for pid in self.pids() if word in _command(pid)]

    def running(self) -> "Counter[str]":
        """How many processes there are of each name of a node, or program; recognisers whose node lives are as many as it needs."""
        pids = self.pids()
        names = [_name(pid) for pid in pids if RECOGNISER not in _command(pid) or _parent(pid) not in pids]
        return Counter(filter(None, names))     # one that ends at this moment has none

    def said(self) -> str:
        """All that the launch files have printed."""
        self._output.flush()
        return Path("/proc/self/fd/{}".format(self._output.fileno())).read_text(encoding="utf-8", errors="replace")

    def last_lines(self, count: int = 12) -> str:
        """The last lines of said(), in one."""
        return " | ".join(self.said().strip().splitlines()[-count:])

    def close(self) -> None:
        """End everything. Idempotent."""
        for name in list(self._launched):
            self.end(name)
        processes.end(self._mark, {os.getpid()})
        self._output.close()
        if self._owned:
            shutil.rmtree(self._owned, ignore_errors=True)

    def _start_master(self) -> None:
        _start(["rosmaster", "--core", "-p", str(self._port)], subprocess.DEVNULL)


def _start(command: List[str], output: Union[int, BinaryIO]) -> subprocess.Popen:
    """Start a process that ends with the run, by its mark."""
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=output)


def _command(pid: int) -> bytes:
    try:
        return Path("/proc/{}/cmdline".format(pid)).read_bytes()
    except OSError:
        return b""


def _parent(pid: int) -> int:
    """Process id of the parent, 0 for a process that has gone."""
    try:
        return int(Path("/proc/{}/stat".format(pid)).read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[1])
    except (OSError, IndexError, ValueError):
        return 0


def _name(pid: int) -> str:
    """What tells a process of this run from the others: its node name, or its program."""
    words = _command(pid).decode(errors="replace").split("\0")
    return next((word for word in words if word.startswith("__name:=")), " ".join(words[:3]))


def odd_processes(now: "Counter[str]", before: "Counter[str]", bodies: Set[str]) -> List[str]:
    """Names of processes that there are more of, or fewer, than before; those of a body are right while it is there."""
    prefix = "__name:=rsp_"
    orphans = {name for name in now if name.startswith(prefix) and name[len(prefix):] not in bodies}
    return sorted(orphans | {name for name in set(now) | set(before) if not name.startswith(prefix) and now[name] != before[name]})


def unplugged_for(seconds: float) -> None:
    """Let so much time (s) pass."""
    deadline = time.monotonic() + seconds
    processes.wait_until(lambda: time.monotonic() > deadline, seconds + 1.0)
