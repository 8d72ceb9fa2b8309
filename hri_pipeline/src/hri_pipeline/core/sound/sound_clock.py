"""When a sound was heard, from the times at which its pieces arrived."""

from __future__ import annotations

from collections import deque
from typing import Deque, Tuple

WINDOW_S = 10.0
"""Over how long the quickest delivery is looked for: 100 ppm of drift between two clocks are 1 ms of it."""
CONFIRM_S = 0.25
"""How long deliveries must stay late before sound is missing, and not only on its way."""
STALL_S = 1.0
"""A delivery later than this begins anew at once."""
_SLEW = 0.02
_FIRST_SLEW = 0.1
_FIRST_S = 2.0
# Behind the clock, more than 20 ms between two blocks is a gap.
_MOST_STEP_S = 0.005
_RATE_STEP_S = 0.25
_RATE_LEAST_S = 2.0


class SampleClock:
    """Counts samples, and keeps the offset between their count and the time of arrival.

    A delivery is never early: sound comes at its own time plus a delay that varies. The offset is the least of
    arrival - count over WINDOW_S; jitter does not move it, a drift between the sound card's clock and ours does. It
    changes by 2 % of the time that passes at most (10 % in the first 2 s), so that stamps run on evenly. Deliveries that stay late
    by more than `tolerance` s for CONFIRM_S are a gap. Stream time: s of sound counted, with the gaps that were
    told by skip(). Raises ValueError for a tolerance that is not above 0.
    """

    def __init__(self, tolerance: float = 0.08) -> None:
        if not tolerance > 0.0:
            raise ValueError("gap tolerance is {} s, legal range above 0".format(tolerance))
        self._tolerance = tolerance
        self._least: Deque[Tuple[float, float]] = deque()
        self._marks: Deque[Tuple[float, float]] = deque()
        self._late: Tuple[float, float] = (0.0, 0.0)
        self._is_late = False
        self._begun = 0.0
        self._counted = 0.0
        self._arrival = 0.0
        self.offset = 0.0
        self.set_back = 0
        self.is_running = False

    def add(self, end: float, arrival: float) -> float:
        """Take note that the sound up to stream time `end` arrived at `arrival` (s); return the s of sound found missing."""
        offset = arrival - end
        if not self.is_running:
            self._anchor(offset, end, arrival)
            return 0.0
        passed, self._arrival = max(0.0, arrival - self._arrival), arrival
        self._count(end, arrival)
        lateness = offset - self.offset
        if lateness > STALL_S or self._stays_late(lateness, arrival):
            gap = lateness if lateness > STALL_S else min(lateness, self._late[1])
            self._reanchor(self.offset + gap, end, arrival, forget=lateness > STALL_S)
            return gap
        if lateness < -self._tolerance:
            # More sound than time: a late delivery was taken for a gap, or the rate is not what it is said to be.
            self.set_back += 1
            self._reanchor(offset, end, arrival, forget=False)
            return 0.0
        self._follow(offset, end, arrival, passed)
        return 0.0

    def time(self, stream: float) -> float:
        """Return when the sound of stream time `stream` (s) was heard, in the time of the arrivals."""
        return stream + self.offset

    def speed(self) -> float:
        """Return how much sound comes per second of arrivals, 1 for a true rate; 0 while too little has come to tell."""
        if len(self._marks) < 2:
            return 0.0
        (first, begun), (last, ended) = self._marks[0], self._marks[-1]
        span = ended - begun
        return (last - first) / span if span >= _RATE_LEAST_S else 0.0

    def _anchor(self, offset: float, end: float, arrival: float) -> None:
        self.is_running = True
        self._begun = self._arrival = arrival
        self._reanchor(offset, end, arrival, forget=True)

    def _reanchor(self, offset: float, end: float, arrival: float, forget: bool) -> None:
        self.offset = offset
        self._is_late = False
        self._least.clear()
        self._least.append((arrival, offset))
        if forget:
            self._marks.clear()
            self._marks.append((end, arrival))

    def _stays_late(self, lateness: float, arrival: float) -> bool:
        """Tell whether deliveries have been late for CONFIRM_S; the least lateness is kept beside."""
        if lateness <= self._tolerance:
            self._is_late = False
            return False
        since, least = self._late if self._is_late else (arrival, lateness)
        self._is_late, self._late = True, (since, min(least, lateness))
        return arrival - since >= CONFIRM_S

    def _follow(self, offset: float, end: float, arrival: float, passed: float) -> None:
        """Move the offset towards the least of the window."""
        while self._least and self._least[-1][1] >= offset:
            self._least.pop()
        self._least.append((arrival, offset))
        while self._least[0][0] < arrival - WINDOW_S:
            self._least.popleft()
        most = min(_MOST_STEP_S, (_FIRST_SLEW if arrival - self._begun < _FIRST_S else _SLEW) * passed)
        self.offset += min(most, max(-most, self._least[0][1] - self.offset))

    def _count(self, end: float, arrival: float) -> None:
        """Keep marks of how much had come when, for the rate."""
        if not self._marks or arrival - self._marks[-1][1] >= _RATE_STEP_S:
            self._marks.append((end, arrival))
        while self._marks[0][1] < arrival - WINDOW_S:
            self._marks.popleft()
