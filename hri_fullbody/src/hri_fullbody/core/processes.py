"""Child processes: started, read, ended, and recognised again after their process id was reused."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import time
from typing import Dict, Mapping, Optional, Sequence

from hri_pipeline.core.process import ends_with_parent

_KEPT_CHARACTERS = 2000
_CHUNK = 4096
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class ChildProcess:
    """A running command and the end of its output; the pipe never fills as long as drain() is called.

    arguments: a list, no shell interprets it. The child has a session of its own, so that neither Ctrl-C in a terminal
    nor a signal to the parent's group reaches it: the parent decides. The thread that makes this object must
    live as long as the child shall (see ends_with_parent). Raises OSError when the command cannot be started.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            ends_with_parent(arguments), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True)
        assert self._process.stdout is not None
        self._pipe = self._process.stdout
        os.set_blocking(self._pipe.fileno(), False)
        self._output = ""
        self.started = time.monotonic()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def last_line(self) -> str:
        """Last line of the output, without colours; empty when there was none."""
        lines = [line for line in _COLOUR.sub("", self._output).splitlines() if line.strip()]
        return lines[-1].strip() if lines else ""

    def drain(self) -> bool:
        """Read the output without waiting, and keep the end of it. Returns whether the child has closed the pipe."""
        while not self._pipe.closed:
            try:
                chunk = os.read(self._pipe.fileno(), _CHUNK)
            except BlockingIOError:
                return False
            if not chunk:
                break
            self._output = (self._output + chunk.decode("utf-8", "replace"))[-_KEPT_CHARACTERS:]
        return True

    def wait(self, timeout: float) -> Optional[int]:
        """Wait for the end, `timeout` s at most; return the exit code, None when the child still runs."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def poll(self) -> Optional[int]:
        """Return the exit code, negative for a signal, None while the child runs."""
        return self._process.poll()

    def send(self, number: int = signal.SIGINT) -> None:
        """Send a signal; nothing happens when the child has ended."""
        if self._process.poll() is None:
            self._process.send_signal(number)

    def close(self) -> None:
        """Kill the child if it still runs, wait for it, read its last output and close the pipe. Idempotent."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self.drain()
        self._pipe.close()


def identity_of(pid: Optional[int] = None) -> Dict[str, str]:
    """Return what tells a process from all others, also from a later one with the same id: host, space, pid, start.

    space: boot and process-id namespace, since containers on one host have equal ids. pid None: this process.
    All values are text: the start, in clock ticks since boot, outgrows the 32 bits of an XML-RPC integer. (psutil gives
    it as a time of day only, which changes when the clock is set.)
    """
    pid = os.getpid() if pid is None else pid
    return {"host": socket.gethostname(), "space": _space(), "pid": str(pid), "start": _start_of(str(pid))}


def is_alive(identity: Mapping[str, object]) -> Optional[bool]:
    """Tell whether the process of an identity lives; None when it is on another host or in another container.

    An identity without the fields of identity_of, or with a pid that is no number, is that of no living process.
    """
    fields = {name: str(identity.get(name, "")) for name in ("host", "space", "pid", "start")}
    if not fields["pid"].isdigit():
        return False
    if fields["host"] != socket.gethostname() or fields["space"] != _space():
        return None
    return bool(fields["start"]) and _start_of(fields["pid"]) == fields["start"]


def _space() -> str:
    try:
        with open("/proc/sys/kernel/random/boot_id", encoding="ascii") as file:
            boot = file.read().strip()
        return "{} {}".format(boot, os.readlink("/proc/self/ns/pid"))
    except OSError:
        return ""


def _start_of(pid: str) -> str:
    """Start time of a process, clock ticks since boot (field 22 of /proc/PID/stat, proc(5)); empty when it has
    ended."""
    try:
        with open("/proc/{}/stat".format(pid), "rb") as file:
            fields = file.read().rsplit(b")", 1)[1].split()
    except (OSError, IndexError):
        return ""
    return "" if fields[0] in (b"Z", b"X") else fields[19].decode("ascii")
