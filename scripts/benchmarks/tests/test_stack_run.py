"""What a process holds and uses, of this one and of one that has gone."""

from __future__ import annotations

import mmap
import os
import resource
import subprocess
import sys
import threading
import uuid
from pathlib import Path

import numpy as np
import pytest

from benchmarks.stack_run import StackRun, StackRunError, cpu_s, name_of, pid_of_node, processes, usage


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
    mark, command = "unit-" + uuid.uuid4().hex, [sys.executable, "-c", "input('here\\n')", "__name:=listener"]
    marked, other = (subprocess.Popen(command, env=dict(os.environ, ROS4HRI_RUN_MARK=value), stdin=subprocess.PIPE,
                                      stdout=subprocess.PIPE) for value in (mark, mark + "-other"))
    try:
        # While a process begins, the system does not know its arguments yet.
        assert [child.stdout.readline() for child in (marked, other) if child.stdout] == 2 * [b"here\n"]
        assert pid_of_node(mark, "listener") == marked.pid and name_of(other.pid) == "listener"
        assert pid_of_node(mark, "talker") is None
    finally:
        for child in (marked, other):
            child.communicate(b"\n")
    assert pid_of_node(mark, "listener") is None


def test_a_run_ends_what_it_has_started_and_keeps_its_logs_until_they_are_removed() -> None:
    with StackRun() as run:
        run.start("listener", [sys.executable, "-c", "import time; print('here', flush=True); time.sleep(60)",
                               "__name:=listener"])
        log = run.folder / "listener.log"
        assert processes.wait_until(lambda: log.read_text() == "here\n", 20.0)
        assert run.environment["ROS_MASTER_URI"] == run.uri and not run.master_listens()
        times, memory = run.usage_by_name()
        assert run.pids() == [run.pid_of("listener")] and set(times) == {"listener"} and memory["listener"] > 1.0
    assert not run.pids() and log.is_file()
    run.remove_logs()
    assert not run.folder.exists()


def test_a_program_that_fails_tells_its_last_line_and_where_its_log_is(tmp_path: Path) -> None:
    with StackRun(tmp_path) as run:
        with pytest.raises(StackRunError, match="missing: .*No module named .*log: .*missing.log"):
            run.begin("missing", "nowhere")(30.0)
        with pytest.raises(StackRunError, match="silent: it said nothing"):
            run.begin("silent", "report")(30.0)
    run.remove_logs()
    assert tmp_path.is_dir()
