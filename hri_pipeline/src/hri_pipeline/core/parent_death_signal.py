"""Commands that end with their parent."""

from __future__ import annotations

import shutil
from typing import List, Sequence


def ends_with_parent(arguments: Sequence[str]) -> List[str]:
    """Return the command that runs `arguments` and gets SIGINT when the thread that started it ends.

    setpriv (util-linux 2.33, part of every Debian and Ubuntu from 2019 on) sets prctl(PR_SET_PDEATHSIG) and becomes the
    command, with the same process id, about 1 ms after the start: a parent killed sooner leaves an orphan. A preexec_fn
    would run Python between fork and exec, which may hang in a process with threads. Where setpriv is missing the
    command comes back as it is.
    """
    wrapper = shutil.which("setpriv")
    return ([wrapper, "--pdeathsig", "INT", "--"] if wrapper else []) + list(arguments)
