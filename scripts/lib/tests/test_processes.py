"""Marked processes are found and ended, whatever session they are in and whatever they ignore."""

from __future__ import annotations

import os
import resource
import signal
import socket
import subprocess
import sys
import threading
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
