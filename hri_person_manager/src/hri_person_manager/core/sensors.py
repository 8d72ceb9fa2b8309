"""The sensors that see people: how late their sources are, how often their images come, how a camera moves in the
reference frame, and where it jumps because the localisation has corrected itself.

The clock of a camera may be another one than that of the robot, by any time; but faces and bodies of one camera have
the same stamps, and what came with the least delay lately tells how far the clocks are apart. In `map` all that a
camera sees jumps with it (REP-105), and nobody has walked.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from typing import Deque, Dict, Hashable, List, Optional, Tuple

import numpy as np

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.timing import JUMP_BACK_S

MEMORY_S = 60.0         # a minimum lasts for half as long at least
LONGEST_LAG_S = 10.0    # s; more is a pause of a bag, or a clock that was set
LONGEST_PERIOD_S = 10.0     # what comes less often is no sequence of images
_PERIODS = 5
_MOST_SENSORS = 100
SMOOTHING_S = 0.5      # of the camera's velocity
JUMP_SPEED = 1.0       # m/s by which a camera's velocity differs from before where it jumps; robots need some 0.5 s
LASTS_S = 0.15         # of a jump that tf spreads from one correction to the next
JUMP_TURN = math.radians(150.0)    # the same of its turning, rad/s; quick heads turn by 90 degrees per second


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


class CameraMotion:
    """The motion of the camera that sees one person."""

    def __init__(self) -> None:
        self._last: Optional[Pose] = None
        self._velocity: Optional[np.ndarray] = None
        self._turn = self._jumping = 0.0

    def see(self, pose: Optional[Pose], step: float) -> Optional[Pose]:
        """Take where the camera is (it maps camera coordinates to the reference frame), `step` s after the last time.
        With a step of 0 it begins anew.

        Returns what maps a place before to where it is if it has jumped with the camera, None without a jump.
        """
        last, self._last = self._last, pose
        if last is None or pose is None or step <= 0.0:
            self._velocity, self._jumping = None, 0.0
            return None
        change = pose.compose(last.inverse())
        velocity = (pose.translation - last.translation) / step
        turn = math.acos(min(1.0, max(-1.0, (float(np.trace(change.rotation)) - 1.0) / 2.0))) / step
        if self._velocity is None:
            self._velocity, self._turn = velocity, turn
            return None
        off, more = velocity - self._velocity, turn - self._turn
        speed = float(np.linalg.norm(off))
        gain = 1.0 - math.exp(-step / SMOOTHING_S)
        # A jump says little of how the camera goes on.
        self._velocity = self._velocity + gain * min(1.0, JUMP_SPEED / max(speed, 1e-9)) * off
        self._turn += gain * min(JUMP_TURN, more)
        self._jumping = LASTS_S if speed > JUMP_SPEED or more > JUMP_TURN else self._jumping - step
        return change if self._jumping > 0.0 else None
