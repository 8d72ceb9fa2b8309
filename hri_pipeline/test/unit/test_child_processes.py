"""Child processes: their output, their end with the parent, and how a process is known again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hri_pipeline.core.process import (
    LONGEST_WAIT_S,
    PROVEN_S,
    ChildProcess,
    RestartPolicy,
    ends_with_parent,
    identity_of,
    is_alive,
)

SOURCES = [str(Path(__file__).resolve().parents[2] / "src")]


def until(condition, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.fixture
def start():
    children = []

    def make(*arguments):
        children.append(ChildProcess(arguments))
        return children[-1]

    yield make
    for child in children:
        child.close()


def test_the_last_line_without_colours(start):
    child = start("/bin/sh", "-c", "echo one; printf '\\033[31mtwo\\033[0m\\n\\n' >&2; exit 3")
    assert child.wait(10.0) == 3
    assert child.drain() and child.last_line == "two"


def test_a_talkative_child_is_never_stopped_by_its_pipe(start):
    child = start("/bin/sh", "-c", "i=0; while [ $i -lt 5000 ]; do echo 0123456789012345678901234567890123456789; "
                                   "i=$((i+1)); done; echo done")
    until(lambda: child.drain())
    assert child.wait(10.0) == 0 and child.last_line == "done"


def test_no_shell_sees_the_arguments(start):
    child = start("/bin/echo", "$(id); `id` <a> & b")
    assert child.wait(10.0) == 0
    child.drain()
    assert child.last_line == "$(id); `id` <a> & b"


def test_signals_and_codes(start):
    child = start("/bin/sleep", "60")
    assert child.poll() is None and child.wait(0.01) is None
    child.send(signal.SIGINT)
    assert child.wait(10.0) == -signal.SIGINT
    child.send(signal.SIGINT)
    child.close()
    child.close()


def test_what_cannot_be_started_says_so():
    with pytest.raises(OSError):
        subprocess.Popen(["/nowhere/robot_state_publisher"])
    child = ChildProcess(["/nowhere/robot_state_publisher"]) if len(ends_with_parent(["x"])) > 1 else None
    if child is not None:       # setpriv starts, and says that the command is not there
        assert child.wait(10.0) == 127
        child.drain()
        assert "/nowhere/robot_state_publisher" in child.last_line
        child.close()


def test_a_child_has_its_own_session(start):
    child = start("/bin/sleep", "60")
    assert os.getsid(child.pid) == child.pid != os.getsid(0)


@pytest.mark.skipif(len(ends_with_parent(["x"])) == 1, reason="setpriv is not installed")
def test_a_child_ends_when_its_parent_is_killed():
    code = ("import sys, time; sys.path[:0] = {!r}; from hri_pipeline.core.process import ChildProcess; "
            "print(ChildProcess(['/bin/sleep', '60']).pid, flush=True); time.sleep(60)").format(SOURCES)
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    try:
        child = int(parent.stdout.readline())
        identity = identity_of(child)
        assert is_alive(identity)
        # setpriv asks for the signal, then becomes the command.
        until(lambda: Path("/proc/{}/cmdline".format(child)).read_bytes().startswith(b"/bin/sleep"))
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()
    until(lambda: not is_alive(identity))


def test_a_process_is_known_again():
    own = identity_of()
    assert is_alive(own) is True and all(isinstance(value, str) for value in own.values())
    assert is_alive(dict(own, start="1")) is False            # another process with the same number
    assert is_alive(dict(own, host="elsewhere")) is None
    assert is_alive(dict(own, space="another container")) is None
    for hostile in ({}, {"pid": "../1"}, {"pid": None}, dict(own, pid="x")):
        assert is_alive(hostile) is False
    gone = subprocess.Popen(["/bin/true"])
    identity = identity_of(gone.pid)
    gone.wait()
    assert is_alive(identity) is False


def test_descriptors_are_given_back():
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        child = ChildProcess(["/bin/true"])
        until(lambda child=child: child.poll() is not None)
        child.close()
        assert child.drain()
    assert len(os.listdir("/proc/self/fd")) == before


def test_waits_grow_and_end_after_a_good_run():
    policy = RestartPolicy()
    waits = [policy.ended(0.3) for _ in range(12)]
    assert waits[:4] == [0.0, 0.5, 1.0, 2.0] and waits[-1] == LONGEST_WAIT_S
    assert policy.ended(PROVEN_S) == 0.0
    assert policy.ended(0.3) == 0.5
