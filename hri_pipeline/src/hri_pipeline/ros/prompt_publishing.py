"""Publishing that does not make a busy loop give up the processor."""

from __future__ import annotations

import time
from types import ModuleType
from typing import Any

from rospy.impl import tcpros_pubsub


class _NoYield:
    """The module `time`, whose sleep(0) returns at once.

    rospy hands a message to the thread of a connection and then sleeps for 0 s, for each connection. That is a real
    sleep: 0.14 ms with an idle processor, and the end of the turn with a busy one. With ten people it took a seventh of
    the time of each image. Threads of connections need no such help: they wait on a condition.
    """

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)

    def sleep(self, seconds: float) -> None:
        """Sleep, but not for nothing."""
        if seconds > 0.0:
            self._module.sleep(seconds)


def publish_without_yielding() -> None:
    """Let publish() of this process return as soon as its message is queued. Idempotent."""
    if not isinstance(tcpros_pubsub.time, _NoYield):
        tcpros_pubsub.time = _NoYield(time)
