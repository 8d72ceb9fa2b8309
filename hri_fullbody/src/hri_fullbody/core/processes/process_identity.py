"""How to know a process again, also after another one has got its number."""

from __future__ import annotations

import os
import socket
from typing import Dict, Mapping, Optional


def identity_of(pid: Optional[int] = None) -> Dict[str, str]:
    """Return what tells a process from all others, also from a later one with the same id: host, space, pid, start.

    space: boot and process-id namespace, since containers on one host have equal ids. pid None: this process.
    All values are text: the start, in clock ticks since boot, outgrows the 32 bits of an XML-RPC integer.
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
    """Start time of a process, clock ticks since boot (field 22 of /proc/PID/stat, proc(5)); empty when it has ended."""
    try:
        with open("/proc/{}/stat".format(pid), "rb") as file:
            fields = file.read().rsplit(b")", 1)[1].split()
    except (OSError, IndexError):
        return ""
    return "" if fields[0] in (b"Z", b"X") else fields[19].decode("ascii")
