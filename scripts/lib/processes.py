"""Small process tools for the shell scripts: a free port, and ending what a run has started.

Every process that a run starts carries a mark in its environment (ROS4HRI_RUN_MARK), because
roslaunch gives each node a session of its own and a process group does not reach them.
Only the standard library, only Linux (/proc).
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import socket
import sys
import time
from typing import Callable, List, Optional, Sequence, Set

MARK_NAME = "ROS4HRI_RUN_MARK"
_PR_SET_PDEATHSIG = 1       # prctl(2)


def free_port() -> int:
    """A TCP port of the loopback interface that is free now."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _is_zombie(pid: int) -> bool:
    try:
        with open("/proc/%d/stat" % pid, "rb") as stat:
            return stat.read().rsplit(b")", 1)[1].split()[0] in (b"Z", b"X")
    except (OSError, IndexError):
        return True


def marked(mark: str, spared: Set[int]) -> List[int]:
    """Living processes whose mark begins with the given one, less the spared ones."""
    wanted = ("%s=%s" % (MARK_NAME, mark)).encode()
    found = []
    for entry in os.listdir("/proc"):
        if not entry.isdigit() or int(entry) in spared:
            continue
        try:
            with open("/proc/%s/environ" % entry, "rb") as environ:
                if not any(line.startswith(wanted) for line in environ.read().split(b"\0")):
                    continue
        except OSError:
            continue
        if not _is_zombie(int(entry)):
            found.append(int(entry))
    return found


def _signal_all(pids: List[int], number: int) -> None:
    for pid in pids:
        try:
            os.kill(pid, number)
        except OSError:
            pass


def wait_until(condition: Callable[[], bool], seconds: float) -> bool:
    """True as soon as the condition holds, False after the given time."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def end(mark: str, spared: Set[int], patience: Sequence[float] = (8.0, 4.0, 3.0)) -> int:
    """End all marked processes: SIGINT (ROS nodes unregister), then SIGTERM, then SIGKILL.

    `patience` is the time in seconds after each signal. Returns the number of processes that
    resisted even that.
    """
    for number, seconds in zip((signal.SIGINT, signal.SIGTERM, signal.SIGKILL), patience):
        pids = marked(mark, spared)
        if not pids:
            return 0
        _signal_all(pids, number)
        wait_until(lambda: not marked(mark, spared), seconds)
    return len(marked(mark, spared))


def _threads_of_user(user: int) -> int:
    """Processes and threads of a user (real id), as the kernel counts them for `ulimit -u`."""
    found = 0
    for entry in filter(str.isdigit, os.listdir("/proc")):
        try:
            with open("/proc/%s/status" % entry, encoding="ascii", errors="replace") as status:
                facts = dict(line.split(":", 1) for line in status if ":" in line)
        except OSError:
            continue
        if int(facts["Uid"].split()[0]) == user:
            found += int(facts.get("Threads", 1))
    return found


def threads_left(user: int, groups: Sequence[str] = ("/sys/fs/cgroup", "/sys/fs/cgroup/pids")) -> Optional[int]:
    """How many processes and threads this user may still start here; None where nothing limits them.

    `groups` are the directories of the control group of a container, in versions 2 and 1.
    """
    left = []
    most = resource.getrlimit(resource.RLIMIT_NPROC)[0]
    if most != resource.RLIM_INFINITY and user != 0:
        left.append(most - _threads_of_user(user))
    for group in groups:
        try:
            with open(group + "/pids.max") as limit, open(group + "/pids.current") as current:
                left.append(int(limit.read()) - int(current.read()))
        except (OSError, ValueError):       # there is none, or it is "max"
            continue
    return min(left) if left else None


def display_answers(display: str) -> bool:
    """True if an X server listens on the display (":1", ":1.0", "host:10.0")."""
    host, _, rest = display.rpartition(":")
    number = rest.split(".")[0]
    if not number.isdigit():
        return False
    if host in ("", "unix"):
        addresses = [(socket.AF_UNIX, name + "/tmp/.X11-unix/X" + number) for name in ("\0", "")]
    else:
        addresses = [(socket.AF_INET, (host, 6000 + int(number)))]
    for family, address in addresses:
        try:
            with socket.socket(family, socket.SOCK_STREAM) as probe:
                probe.settimeout(3.0)
                probe.connect(address)
                return True
        except OSError:
            continue
    return False


def detach(command: List[str]) -> None:
    """Become the command, in a new session, with signals as a terminal would give them.

    It gets SIGINT, as from Ctrl-C, when the script that has started it is killed.
    """
    os.setsid()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGINT, 0, 0, 0)
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    os.execvp(command[0], command)


def main(arguments: List[str]) -> int:
    """Command line: free-port | threads-left | end MARK [SPARED_PID...] | display-answers DISPLAY | detach CMD..."""
    if arguments[:1] == ["free-port"]:
        print(free_port())
        return 0
    if arguments[:1] == ["threads-left"]:
        left = threads_left(os.getuid())
        print("" if left is None else left)
        return 0
    if arguments[:1] == ["end"] and len(arguments) >= 2:
        return 1 if end(arguments[1], {os.getpid()} | {int(a) for a in arguments[2:]}) else 0
    if arguments[:1] == ["display-answers"] and len(arguments) == 2:
        return 0 if display_answers(arguments[1]) else 1
    if arguments[:1] == ["detach"] and len(arguments) >= 2:
        detach(arguments[1:])
    print(main.__doc__, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
