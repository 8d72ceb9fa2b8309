"""How late the sources of a sensor are, and how often its images come.

The clock of a camera may be another one than that of the robot, by any time; but faces and bodies of one camera have
the same stamps, and what came with the least delay lately tells how far the clocks are apart.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from typing import Deque, Dict, Hashable, List, Optional, Tuple

from hri_pipeline.core.timing import JUMP_BACK_S

MEMORY_S = 60.0         # a minimum lasts for half as long at least
LONGEST_LAG_S = 10.0    # s; more is a pause of a bag, or a clock that was set
LONGEST_PERIOD_S = 10.0     # what comes less often is no sequence of images
_PERIODS = 5
_MOST_SENSORS = 100


class _RecentMinimum:
    """The least value of the last minute or half."""

    def __init__(self) -> None:
        self._began = -math.inf
        self._values: Tuple[float, float] = (math.inf, math.inf)

    def add(self, value: float, now: float) -> float:
        """Take a value at `now` (s); return the minimum."""
        if not 0.0 <= now - self._began < 0.5 * MEMORY_S:
            older = self._values[1] if now - self._began < MEMORY_S else math.inf
            self._began, self._values = now, (older, math.inf)
        self._values = self._values[0], min(self._values[1], value)
        return min(self._values)


class _Sensor:
    def __init__(self) -> None:
        self.offset, self.shortest = _RecentMinimum(), _RecentMinimum()
        self.stamps: Dict[Hashable, float] = {}
        self.periods: Dict[Hashable, Deque[float]] = {}
        self.period: Optional[float] = None


class SensorTimes:
    """Follows the sources (faces, bodies) of each sensor. All times in s."""

    def __init__(self) -> None:
        self._sensors: "OrderedDict[str, _Sensor]" = OrderedDict()

    def note(self, sensor: str, source: Hashable, stamp: float, now: float) -> float:
        """Take the stamp of a place that arrives at `now`; return how much later it is than the least delayed ones."""
        known = self._sensors.get(sensor)
        if known is None or stamp < known.stamps.get(source, -math.inf) - JUMP_BACK_S:
            known = self._begin(sensor)
        offset = now - stamp
        lag = offset - known.offset.add(offset, now)
        if lag > LONGEST_LAG_S:
            known, lag = self._begin(sensor), 0.0
            known.offset.add(offset, now)
        self._count(known, source, stamp, now)
        return lag

    def period(self, sensor: str) -> Optional[float]:
        """Return the period of the images by the source that told most of them lately; None where it is not known."""
        return self._sensors[sensor].period if sensor in self._sensors else None

    def _begin(self, sensor: str) -> _Sensor:
        self._sensors.pop(sensor, None)
        self._sensors[sensor] = begun = _Sensor()
        while len(self._sensors) > _MOST_SENSORS:
            self._sensors.popitem(last=False)
        return begun

    @staticmethod
    def _count(known: _Sensor, source: Hashable, stamp: float, now: float) -> None:
        since = stamp - known.stamps.get(source, stamp)
        known.stamps[source] = max(stamp, known.stamps.get(source, stamp))
        if 0.0 < since <= LONGEST_PERIOD_S:
            periods: Deque[float] = known.periods.setdefault(source, deque(maxlen=_PERIODS))
            periods.append(since)
            ordered: List[float] = sorted(periods)
            known.period = known.shortest.add(ordered[(len(ordered) - 1) // 2], now)
