"""Marked processes are found and ended, whatever session they are in and whatever they ignore."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import processes

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
