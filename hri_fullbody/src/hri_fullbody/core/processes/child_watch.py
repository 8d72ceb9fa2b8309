"""Waits for child processes, for a time, and for another thread, all at once."""

from __future__ import annotations

import os
import selectors

from hri_fullbody.core.processes.child_process import ChildProcess

# The exit code may come a moment after the output is closed.
_CODE_S = 0.05


class ChildWatch:
    """One thread calls wait(); wake() may be called by any. Empties the pipes of the children that were added."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(self._write, False)
        self._selector.register(self._read, selectors.EVENT_READ)

    def add(self, child: ChildProcess) -> None:
        """Watch a child too."""
        self._selector.register(child, selectors.EVENT_READ, child)

    def remove(self, child: ChildProcess) -> None:
        """Read what a child said last and give it back, killed if it still runs."""
        child.drain()
        if child.fileno() in self._selector.get_map():
            self._selector.unregister(child)
        child.close()

    def wait(self, timeout: float) -> None:
        """Return when a child has ended or said something, after wake(), or after `timeout` s."""
        for key, _ in self._selector.select(max(0.0, timeout)):
            if key.data is None:
                os.read(self._read, 4096)
            elif key.data.drain():
                key.data.wait(_CODE_S)
                self._selector.unregister(key.data)

    def wake(self) -> None:
        """Let wait() return."""
        try:
            os.write(self._write, b"x")
        except BlockingIOError:
            pass  # it has been woken often enough

    def close(self) -> None:
        """Give the descriptors back; nobody may wait or wake any more. Idempotent."""
        if self._selector.get_map() is not None:
            self._selector.close()
            os.close(self._read)
            os.close(self._write)
