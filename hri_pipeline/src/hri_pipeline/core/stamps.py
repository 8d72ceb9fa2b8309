"""Stamps of several sources, each in its own order: what is newer, what only lags, and where time has jumped back."""

from __future__ import annotations

from collections import OrderedDict
from enum import Enum
from typing import Hashable, List, Tuple

Stamp = Tuple[int, int]
"""Seconds and nanoseconds."""

JUMP_BACK_S = 0.5
STALE_S = 0.5       # of a source without a newer stamp: late messages of a moment ago have come by then
ALL_STALE_S = 10.0  # no source lags by so much: who was seen before the jump may never come again
MAX_SOURCES = 500


class Order(Enum):
    """How a stamp stands to the earlier ones."""

    NEWER = "newer than all of its source"
    LATE = "not newer"
    BACK = "time has jumped back"


class SourceStamps:
    """The newest stamp of each source.

    Sources lag behind each other, by seconds on a machine that is too slow; that is no jump of time. Time has jumped
    back when a source gives stamps far older than its own, or no source anything newer for ALL_STALE_S.
    """

    def __init__(self) -> None:
        self._newest: "OrderedDict[Hashable, List]" = OrderedDict()     # stamp, and when it came
        self._latest: Stamp = (0, 0)
        self._latest_at = 0.0

    def note(self, source: Hashable, stamp: Stamp, now: float) -> Order:
        """Take a stamp that arrives at `now` (s, of a clock that never jumps). After BACK only this one is known."""
        known = self._newest.get(source)
        order = Order.NEWER
        if known is not None and stamp <= known[0]:
            order = Order.BACK if is_back(stamp, known[0]) and now - known[1] > STALE_S else Order.LATE
        if stamp > self._latest:
            self._latest, self._latest_at = stamp, now
        elif is_back(stamp, self._latest) and now - self._latest_at > ALL_STALE_S:
            order = Order.BACK
        if order == Order.BACK:
            self.clear()
            self._latest, self._latest_at = stamp, now
        if order != Order.LATE:
            self._newest[source] = [stamp, now]
            self._newest.move_to_end(source)
            while len(self._newest) > MAX_SOURCES:
                self._newest.popitem(last=False)
        return order

    def clear(self) -> None:
        """Forget all sources: time has jumped."""
        self._newest.clear()
        self._latest, self._latest_at = (0, 0), 0.0


def is_back(stamp: Stamp, before: Stamp) -> bool:
    """Tell whether a stamp is by more than JUMP_BACK_S older than the one before."""
    return before[0] - stamp[0] + 1e-9 * (before[1] - stamp[1]) > JUMP_BACK_S
