"""Commands that end with their parent."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hri_pipeline.core.parent_death_signal import ends_with_parent

SOURCE = str(Path(__file__).resolve().parents[2] / "src")


def test_the_arguments_stay_as_they_are():
    found = subprocess.run(ends_with_parent(["/bin/echo", "$(id)", "a b"]), stdout=subprocess.PIPE, check=True)
    assert found.stdout == b"$(id) a b\n"


def test_without_setpriv_it_is_the_command_itself(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert ends_with_parent(("/bin/sleep", "1")) == ["/bin/sleep", "1"]


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv is not installed")
def test_the_command_ends_when_its_parent_is_killed():
    code = ("import subprocess, sys, time; sys.path.insert(0, {!r});"
            "from hri_pipeline.core.parent_death_signal import ends_with_parent;"
            "print(subprocess.Popen(ends_with_parent(['/bin/sleep', '60'])).pid, flush=True); time.sleep(60)").format(SOURCE)
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    try:
        child = Path("/proc/{}".format(int(parent.stdout.readline())))
        # setpriv asks for the signal, then becomes the command.
        wait_until(lambda: (child / "cmdline").read_bytes().startswith(b"/bin/sleep"))
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()
    wait_until(lambda: has_ended(child))


def has_ended(process):
    """Gone, or a zombie that nobody has waited for."""
    try:
        return (process / "stat").read_bytes().rsplit(b")", 1)[1].split()[0] in (b"Z", b"X")
    except OSError:
        return not os.path.exists(str(process))


def wait_until(condition, seconds=10.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.005)
