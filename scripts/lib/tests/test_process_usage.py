"""What a process holds and uses, of this one and of one that has gone."""

from __future__ import annotations

import mmap
import os
import resource
import subprocess
import sys
import threading
import uuid

import numpy as np
import pytest
from process_usage import cpu_s, name_of, pid_of_node, usage


def test_this_process() -> None:
    before = usage(os.getpid())
    assert before is not None
    # Not of malloc, which may still have it from before.
    block, stop = mmap.mmap(-1, 40_000_000), threading.Event()
    np.frombuffer(block, dtype=np.uint8)[:] = 1
    thread = threading.Thread(target=stop.wait)
    thread.start()
    with open(os.devnull, "rb"):
        after = usage(os.getpid())
    stop.set()
    thread.join()
    assert after is not None
    block.close()
    assert after.rss_mb - before.rss_mb == pytest.approx(40.0, abs=2.0)
    assert (after.threads - before.threads, after.fds - before.fds) == (1, 1)
    used = resource.getrusage(resource.RUSAGE_SELF)
    assert cpu_s(os.getpid()) == pytest.approx(used.ru_utime + used.ru_stime, abs=0.05)
    assert before.cpu_s <= after.cpu_s <= cpu_s(os.getpid())


def test_one_that_has_gone_holds_nothing() -> None:
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    assert usage(child.pid) is None and cpu_s(child.pid) == 0.0 and name_of(child.pid) == "?"


def test_nodes_are_found_by_their_names_among_those_with_the_mark() -> None:
    mark, command = "unit-" + uuid.uuid4().hex, [sys.executable, "-c", "input()", "__name:=listener"]
    marked, other = (subprocess.Popen(command, env=dict(os.environ, ROS4HRI_RUN_MARK=value), stdin=subprocess.PIPE)
                     for value in (mark, mark + "-other"))
    try:
        assert pid_of_node(mark, "listener") == marked.pid and name_of(other.pid) == "listener"
        assert pid_of_node(mark, "talker") is None
    finally:
        for child in (marked, other):
            child.communicate(b"\n")
    assert pid_of_node(mark, "listener") is None
