"""What a process holds and uses, and what it is called, from /proc."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple, Optional

import processes

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Usage(NamedTuple):
    """Resident memory (MB), threads, file descriptors, and processor time so far (s)."""

    rss_mb: float
    threads: int
    fds: int
    cpu_s: float


def usage(pid: int) -> Optional[Usage]:
    """Return what a process holds now; None when it has gone."""
    folder = Path("/proc/{}".format(pid))
    try:
        status = dict(line.split(":", 1) for line in (folder / "status").read_text().splitlines())
        return Usage(1024.0 * int(status["VmRSS"].split()[0]) / 1e6, int(status["Threads"]), len(os.listdir(str(folder / "fd"))), cpu_s(pid))
    except (OSError, KeyError, ValueError):
        return None


def cpu_s(pid: int) -> float:
    """Processor time (s) of a process so far, of user and system together (proc(5), stat); 0 when it has gone."""
    try:
        fields = Path("/proc/{}/stat".format(pid)).read_bytes().rsplit(b")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
    except (OSError, IndexError):
        return 0.0


def name_of(pid: int) -> str:
    """Name of the node, or of the program, that a process runs; "?" when it has gone."""
    try:
        words = Path("/proc/{}/cmdline".format(pid)).read_bytes().decode(errors="replace").split("\0")
    except OSError:
        return "?"
    for word in words:
        if word.startswith("__name:="):
            return word[len("__name:="):]
    programs = [Path(word).name for word in words if word and not word.startswith("-")]
    if programs and programs[0].startswith("python") and len(programs) > 1:
        programs = programs[1:]
    return programs[0].replace(".py", "") if programs else "?"


def pid_of_node(mark: str, node: str) -> Optional[int]:
    """The process of a node, of those that have a mark (see processes.py); None when there is none."""
    return next((pid for pid in processes.marked(mark, {os.getpid()}) if name_of(pid) == node), None)


def program_of(pid: int) -> str:
    """File name of the program that a process runs; empty when it has gone."""
    try:
        return Path(Path("/proc/{}/cmdline".format(pid)).read_bytes().decode(errors="replace").split("\0")[0]).name
    except OSError:
        return ""
