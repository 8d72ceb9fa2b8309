"""Child processes and their last words."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from typing import Mapping, Optional, Sequence

from hri_pipeline.core.parent_death_signal import ends_with_parent

_KEPT_CHARACTERS = 2000
_CHUNK = 4096
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class ChildProcess:
    """A running command with what it said last; its output never fills a pipe as long as drain() is called.

    arguments: a list, no shell sees it. The child has a session of its own, so that neither Ctrl-C in a terminal
    nor a signal to the parent's group reaches it: the parent decides. The thread that makes this object must
    live as long as the child shall (see ends_with_parent). Raises OSError when the command cannot be started.
    """

    def __init__(self, arguments: Sequence[str], environment: Optional[Mapping[str, str]] = None) -> None:
        self._process = subprocess.Popen(
            ends_with_parent(arguments), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            start_new_session=True, env=None if environment is None else dict(environment))
        assert self._process.stdout is not None
        self._output = self._process.stdout
        os.set_blocking(self._output.fileno(), False)
        self._said = ""
        self.started = time.monotonic()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def last_words(self) -> str:
        """The last line that the child has said, without colours; empty when it was silent."""
        lines = [line for line in _COLOUR.sub("", self._said).splitlines() if line.strip()]
        return lines[-1].strip() if lines else ""

    def fileno(self) -> int:
        """Descriptor that becomes readable when the child says something or ends."""
        return self._output.fileno()

    def drain(self) -> bool:
        """Read what the child has said, without waiting; only the end of it is kept. Tells whether it has closed its end."""
        while True:
            try:
                chunk = os.read(self._output.fileno(), _CHUNK)
            except BlockingIOError:
                return False
            if not chunk:
                return True
            self._said = (self._said + chunk.decode("utf-8", "replace"))[-_KEPT_CHARACTERS:]

    def wait(self, timeout: float) -> Optional[int]:
        """Wait for the end, `timeout` s at most; return the exit code, None when the child still runs."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def poll(self) -> Optional[int]:
        """Return the exit code, negative for a signal, None while the child runs."""
        return self._process.poll()

    def send(self, number: int = signal.SIGINT) -> None:
        """Send a signal; nothing happens when the child has ended."""
        if self._process.poll() is None:
            self._process.send_signal(number)

    def close(self) -> None:
        """Kill the child if it still runs, wait for it and close the pipe. Idempotent."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._output.close()
