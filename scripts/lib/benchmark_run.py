"""Runs the stack on one scene and measures it from outside."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
import uuid
from pathlib import Path
from typing import Dict, List, Optional

import processes
from process_usage import cpu_s, name_of, usage

LIB = Path(__file__).resolve().parent
PATIENCE_S = 60.0


class BenchmarkError(RuntimeError):
    """The stack could not be measured; the text says why and where its log is."""


class Run:
    """One roscore, the stack and the probe, all with one mark, so that all of them are ended."""

    def __init__(self, scene: Path, logs: Path, arguments: List[str]) -> None:
        self._mark = "benchmark-" + uuid.uuid4().hex
        self._logs = logs
        port = processes.free_port()
        self._environment = dict(os.environ, ROS_MASTER_URI="http://127.0.0.1:{}".format(port), ROS_IP="127.0.0.1",
                                 ROS_LOG_DIR=str(logs / "ros"))
        self._environment.pop("ROS_HOSTNAME", None)
        self._environment[processes.MARK_NAME] = self._mark
        self._start("roscore", ["roscore", "-p", str(port)])
        if not processes.wait_until(lambda: _listens(port), 30.0):
            self.close()
            raise BenchmarkError("roscore does not answer; its log: {}".format(logs / "roscore.log"))
        self._stack = self._start("roslaunch", ["roslaunch", "ros4hri", "demo.launch", "rviz:=false",
                                                "source:={}".format(scene)] + arguments)

    def _start(self, name: str, command: List[str], output: Optional[int] = None) -> subprocess.Popen:
        with open(str(self._logs / (name + ".log")), "wb") as log:
            return subprocess.Popen(command, env=self._environment, stdin=subprocess.DEVNULL,
                                    stdout=log if output is None else output, stderr=log)

    def measure(self, people: int, seconds: float) -> dict:
        """Return what the probe saw, the use of the processor (% of one core) and the memory (MB) by name of process."""
        result = self._logs / "probe.json"
        probe = self._start("probe", [sys.executable, str(LIB / "benchmark_probe.py"), str(people), str(seconds),
                                      str(PATIENCE_S), str(result)], subprocess.PIPE)
        assert probe.stdout is not None
        self._expect(probe, b"begin\n")
        before, began = self._processor_times(), time.monotonic()
        self._expect(probe, b"end\n")
        after, passed = self._processor_times(), time.monotonic() - began
        memory: Dict[str, float] = {}
        for pid in processes.marked(self._mark, {os.getpid()}):
            name, held = name_of(pid), usage(pid)
            memory[name] = memory.get(name, 0.0) + (held.rss_mb if held is not None else 0.0)
        probe.wait(timeout=30.0)
        seen = json.loads(result.read_text(encoding="utf-8"))
        seen["cpu_percent"] = {name: round(100.0 * (used - before.get(name, 0.0)) / passed, 1)
                               for name, used in sorted(after.items(), key=lambda item: -item[1])}
        seen["rss_mb"] = {name: round(memory.get(name, 0.0), 1) for name in seen["cpu_percent"]}
        return seen

    def _expect(self, probe: subprocess.Popen, line: bytes) -> None:
        assert probe.stdout is not None
        if probe.stdout.readline() != line or self._stack.poll() is not None:
            raise BenchmarkError("the stack or the probe has ended; logs: {}".format(self._logs))

    def _processor_times(self) -> Dict[str, float]:
        times: Dict[str, float] = {}
        for pid in processes.marked(self._mark, {os.getpid()}):
            name = name_of(pid)
            times[name] = times.get(name, 0.0) + cpu_s(pid)
        return times

    def close(self) -> None:
        """End everything that was started. May be called again."""
        processes.end(self._mark, {os.getpid()})


def _listens(port: int) -> bool:
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=1.0):
            return True
    except OSError:
        return False
