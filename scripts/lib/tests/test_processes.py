"""Marked processes are found and ended, whatever session they are in and whatever they ignore."""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import processes
import pytest

STUBBORN = (
    "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print('ready', flush=True); time.sleep(600)"
)


def _start(mark: str) -> "subprocess.Popen[bytes]":
    child = subprocess.Popen(
        [sys.executable, "-c", STUBBORN], env=dict(os.environ, ROS4HRI_RUN_MARK=mark), stdout=subprocess.PIPE,
        start_new_session=True)
    assert child.stdout is not None and child.stdout.readline() == b"ready\n"
    return child


def test_end_reaches_other_sessions_and_spares_others() -> None:
    mine, inner, other = (_start(mark % os.getpid()) for mark in ("unit-%d", "unit-%d-inner", "other-%d"))
    try:
        assert processes.end("unit-%d" % os.getpid(), {os.getpid()}, patience=(0.5, 5.0, 5.0)) == 0
        assert mine.wait(5) == -signal.SIGTERM and inner.wait(5) == -signal.SIGTERM
        assert other.poll() is None
    finally:
        for child in (mine, inner, other):
            child.kill()
            child.wait()
            if child.stdout is not None:
                child.stdout.close()


def test_free_port_can_be_bound() -> None:
    with socket.socket() as server:
        server.bind(("127.0.0.1", processes.free_port()))


def test_silent_display_is_noticed() -> None:
    assert not processes.display_answers(":987")
    assert not processes.display_answers("nonsense")


def test_the_least_limit_of_processes_and_threads_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    groups = [str(tmp_path / "2"), str(tmp_path / "1")]
    for name, most, current in (("2", "max", 7), ("1", "100", 60)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "pids.max").write_text(most + "\n")
        (tmp_path / name / "pids.current").write_text("%d\n" % current)
    monkeypatch.setattr(processes.resource, "getrlimit", lambda which: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    assert processes.threads_left(1000, groups[:1]) is None
    assert processes.threads_left(1000, groups) == 40
    monkeypatch.setattr(processes.resource, "getrlimit", lambda which: (50, 90))
    monkeypatch.setattr(processes, "_threads_of_user", lambda user: 20)
    assert processes.threads_left(1000, groups) == 30
    assert processes.threads_left(0, groups) == 40, "no limit of the user for root"


def test_threads_of_a_user_are_counted_as_they_start() -> None:
    end = threading.Event()
    before = processes._threads_of_user(os.getuid())
    started = [threading.Thread(target=end.wait, daemon=True) for _ in range(60)]
    for thread in started:
        thread.start()
    try:
        assert processes._threads_of_user(os.getuid()) > before + 30, "others start and end meanwhile"
    finally:
        end.set()
        for thread in started:
            thread.join()


def _script(body: str) -> str:
    """A script as demo and test begin, that starts a sleeping child and says its process id."""
    return """set -euo pipefail
R4H_NAME=unit R4H_STEPS=1
. '{0}/common.sh'
. '{0}/stack.sh'
install_traps
R4H_LOGS=$1 R4H_TMP=$1/tmp
mkdir "$R4H_TMP"
export ROS4HRI_RUN_MARK=$R4H_MARK
in_background child {1} -c 'import time; print("there", flush=True); time.sleep(600)'
R4H_STACK=$R4H_STARTED
wait_for 30 grep -qs there "$R4H_LOGS/child.log"
echo "$R4H_STARTED"
{2}
""".format(os.path.dirname(processes.__file__), sys.executable, body)


def _has_ended(pid: int) -> bool:
    return processes.wait_until(lambda: not os.path.exists("/proc/%d" % pid) or processes._is_zombie(pid), 30.0)


def test_all_ends_where_nothing_can_be_written_any_more(tmp_path: Path) -> None:
    """As where the terminal was closed."""
    script = subprocess.Popen(["bash", "-c", _script("exec >&- 2>&-; read -r _; exit 129"), "x", str(tmp_path)],
                              stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert script.stdin is not None and script.stdout is not None
    child = int(script.stdout.readline())
    script.communicate(b"\n", 60)
    has_ended = not processes.marked("ros4hri-%d-" % script.pid, set())
    processes.end("ros4hri-%d-" % script.pid, {os.getpid()})
    assert script.returncode == 129 and has_ended and _has_ended(child) and not (tmp_path / "tmp").exists()


def test_what_a_script_has_started_ends_with_it_also_where_it_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen(["bash", "-c", _script("sleep 600 & wait"), "x", str(tmp_path)],
                          stdout=subprocess.PIPE, start_new_session=True) as script:
        assert script.stdout is not None
        child = int(script.stdout.readline())
        script.kill()
        has_ended = _has_ended(child)
        os.killpg(script.pid, signal.SIGKILL)
        processes.end("ros4hri-%d-" % script.pid, {os.getpid()})
    assert has_ended


def test_who_ignores_interrupts_is_known(tmp_path: Path) -> None:
    ask = ". '%s/common.sh'; ignores_interrupts $1" % os.path.dirname(processes.__file__)
    for action, expected in ((signal.SIG_IGN, 0), (signal.SIG_DFL, 1)):
        with subprocess.Popen(["sleep", "600"], preexec_fn=partial(signal.signal, signal.SIGINT, action)) as sleeping:
            found = subprocess.call(["bash", "-c", ask, "x", str(sleeping.pid)])
            sleeping.kill()
        assert found == expected
    assert subprocess.call(["bash", "-c", ask, "x", str(sleeping.pid)]) != 0, "it has ended"
