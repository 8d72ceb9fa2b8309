"""Waits for conditions in tests, in wall time, and looks at what a process holds."""

import os
import time
from collections import namedtuple
from typing import Callable
from xmlrpc.client import ServerProxy

import rosgraph

Held = namedtuple("Held", "descriptors threads rss_mb")


def wait_for(condition: Callable[[], object], timeout: float, what: str) -> object:
    """Return the first true value of condition(); AssertionError after `timeout` s."""
    deadline = time.monotonic() + timeout
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise AssertionError("not within {:g} s: {}".format(timeout, what))
        time.sleep(0.01)


def pid_of(node: str) -> int:
    """Return the process id of a node."""
    master = rosgraph.Master("/waiting")
    return ServerProxy(master.lookupNode(node)).getPid("/waiting")[2]


def held_by(pid: int) -> Held:
    """Return descriptors, threads and resident memory (MB) of a process."""
    with open("/proc/{}/status".format(pid)) as status:
        fields = dict(line.split(":", 1) for line in status)
    return Held(len(os.listdir("/proc/{}/fd".format(pid))), int(fields["Threads"]),
                int(fields["VmRSS"].split()[0]) / 1024.0)
