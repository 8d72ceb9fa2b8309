"""Who stands back on a busy processor; in processes of their own, since nobody but root can come forward again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hri_pipeline.core.priority import stand_back

SOURCE = Path(__file__).resolve().parents[2] / "src"
HERE = os.getpriority(os.PRIO_PROCESS, 0)
PROGRAM = """
import os, sys, threading
sys.path.insert(0, sys.argv[1])
from hri_pipeline.core.priority import stand_back
before = threading.Event(), threading.Event(), []
def wait():
    before[0].wait()
    before[2].append(os.getpriority(os.PRIO_PROCESS, 0))
old = threading.Thread(target=wait)
old.start()
print(stand_back(int(sys.argv[2])))
print(os.getpriority(os.PRIO_PROCESS, 0))
before[0].set()
old.join()
print(before[2][0])
if os.path.exists("/proc/self/autogroup"):
    # Empty for a session that is in no such group: it began before they were switched on, or outside of this container.
    print(*open("/proc/self/autogroup").read().split()[-1:])
"""


def run(nice, leads):
    """Return what such a process has said of itself: done, nice value of its thread, of an older one, of its session."""
    return subprocess.run([sys.executable, "-c", PROGRAM, str(SOURCE), str(nice)], check=True, stdout=subprocess.PIPE,
                          universal_newlines=True, start_new_session=leads, timeout=60.0).stdout.split()


def test_the_thread_and_its_session_stand_back():
    done, thread, older, *session = run(5, leads=True)
    assert (done, thread, older) == ("True", str(max(5, HERE)), str(HERE))
    assert session in ([], ["5"])


def test_a_terminal_is_left_alone():
    done, thread, _, *session = run(5, leads=False)
    assert (done, thread) == ("True", str(max(5, HERE)))
    assert session in ([], run(0, leads=False)[3:])


def test_zero_changes_nothing():
    assert run(0, leads=True)[:3] == ["True", str(HERE), str(HERE)]


@pytest.mark.parametrize("nice", [-1, 20])
def test_out_of_range(nice):
    with pytest.raises(ValueError, match="0 to 19"):
        stand_back(nice)
