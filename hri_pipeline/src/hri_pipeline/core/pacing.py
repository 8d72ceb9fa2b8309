"""An even rhythm by the wall clock."""

from __future__ import annotations


class Pacer:
    """Says how long to wait for the next of a row of evenly spaced moments.

    The moments are counted from the first one, so that waiting a little too long each time does not add up.
    After a stall of more than one period the row starts anew: there are no bursts. Raises ValueError for a
    rate that is not above 0.
    """

    def __init__(self, rate: float) -> None:
        if not rate > 0.0:
            raise ValueError("rate is {} Hz, it must be above 0".format(rate))
        self._period = 1.0 / rate
        self._start = 0.0
        self._count = -1

    def wait(self, now: float) -> float:
        """Return the time in s from `now` (s, monotonic) to the next moment; 0 when it is due."""
        if self._count < 0:
            return 0.0
        return max(0.0, self._start + self._count * self._period - now)

    def done(self, now: float) -> None:
        """Tell that the moment has been served at `now` (s)."""
        late = now - (self._start + self._count * self._period)
        if self._count < 0 or late > self._period:
            self._start, self._count = now, 0
        self._count += 1
