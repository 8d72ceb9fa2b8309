"""How long to wait before a process that has ended is started again."""

from __future__ import annotations

FIRST_WAIT_S = 0.5
LONGEST_WAIT_S = 30.0
# A process that ran for so long was well: its end has nothing to do with those before.
PROVEN_S = 10.0


class RestartPolicy:
    """At once after a process that ran well; then 0.5 s, doubled each time, up to 30 s. Times are seconds."""

    def __init__(self) -> None:
        self._wait = 0.0

    def ended(self, uptime: float) -> float:
        """Return how long to wait after a process ended that ran for `uptime` s."""
        if uptime >= PROVEN_S:
            self._wait = 0.0
        wait = self._wait
        self._wait = min(LONGEST_WAIT_S, max(FIRST_WAIT_S, 2.0 * wait))
        return wait
