"""Which process goes first when more is to be done than the processor can do."""

from __future__ import annotations

import os


def stand_back(nice: int) -> bool:
    """Let this thread, those that it starts from now on, and its session go behind others by `nice` (0 to 19, see nice(1)).

    Where the kernel schedules by sessions (sched_autogroup of sched(7), the rule on desktops), the nice value of a thread
    counts within its session only, and roslaunch gives each node one of its own: the session stands back too when this
    process leads it. A node that was started in a terminal leaves the terminal alone. Tells whether both could be done; 0
    changes nothing. Raises ValueError out of that range: nobody but root could go before others.
    """
    if not 0 <= nice <= 19:
        raise ValueError("nice is {}, legal range 0 to 19".format(nice))
    if nice == 0:
        return True
    try:
        if os.getpriority(os.PRIO_PROCESS, 0) < nice:
            os.setpriority(os.PRIO_PROCESS, 0, nice)
        if os.getsid(0) == os.getpid():
            _session_stands_back(nice)
        return True
    except OSError:
        return False


def _session_stands_back(nice: int) -> None:
    """Raises OSError where the kernel refuses it."""
    try:
        with open("/proc/self/autogroup", "w", encoding="ascii") as file:
            file.write(str(nice))
    except FileNotFoundError:
        pass        # a kernel without it: the nice value of the thread counts everywhere
