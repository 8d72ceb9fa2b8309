"""Where one person was lately, and which sensor saw it from when to when."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, Dict, Optional, Tuple

FRESH_S = 0.5              # who was seen so long ago is seen now
WINDOW_S = 1.0             # of the velocity
SHORTEST_S = 0.3           # of the places that tell a velocity
FASTEST_MPS = 3.0          # a person who runs
SETTLING_S = 0.2           # the first places of a stretch are averaged
Point = Tuple[float, float]


class SensorTrack:
    """Places (m, in the horizontal plane of the reference frame) by stamp (s), as one sensor after the other gives them.

    began, ended: stamps of the first and the last place of the present stretch, in which `sensor` saw the person without
    a gap. Where two sensors or two features give places at once, those of the better source count.
    """

    def __init__(self) -> None:
        self.sensor = ""
        self.began = self.ended = -math.inf
        self._source = 0
        self._points: Deque[Tuple[float, float, float]] = deque()
        self._first = (0, 0.0, 0.0)
        self._seen: Dict[str, Tuple[float, float]] = {}
        self._fit: Optional[Tuple[float, float, float, float, float]] = None

    @property
    def length(self) -> float:
        """Length of the present stretch, s."""
        return self.ended - self.began

    @property
    def start(self) -> Point:
        """Mean of the first places of the present stretch, m."""
        count, x, y = self._first
        return x / count, y / count

    @property
    def velocity(self) -> Point:
        """Velocity over the last second, m/s; 0 while too little is known."""
        return self._line()[3:]

    def add(self, source: int, sensor: str, point: Point, stamp: float) -> None:
        """Take a place; one that is not newer than the last is left out, one from long before starts afresh."""
        if stamp < self.ended - WINDOW_S:
            self.__init__()
        first, _ = self._seen.get(sensor, (stamp, stamp))
        self._seen[sensor] = (first, stamp)
        fresh = stamp - self.ended <= FRESH_S
        if fresh and ((source, sensor) != (self._source, self.sensor) and source >= self._source or stamp <= self.ended):
            return
        if not fresh or sensor != self.sensor:
            self.began, self._first = stamp, (0, 0.0, 0.0)
            self._points.clear()
        self.sensor, self._source, self.ended = sensor, source, stamp
        if stamp - self.began <= SETTLING_S:
            count, x, y = self._first
            self._first = (count + 1, x + point[0], y + point[1])
        self._points.append((stamp, *point))
        while self._points[0][0] < stamp - WINDOW_S:
            self._points.popleft()
        self._fit = None

    def expected(self, stamp: float) -> Point:
        """Where the person is at a time near or after the last place, walking on as it went, m."""
        time, x, y, u, v = self._line()
        return x + u * (stamp - time), y + v * (stamp - time)

    def overlap(self, other: "SensorTrack") -> float:
        """For how long (s) one sensor has seen both at the same time; negative: it has not."""
        return max((min(last, other._seen[sensor][1]) - max(first, other._seen[sensor][0])
                    for sensor, (first, last) in self._seen.items() if sensor in other._seen), default=-math.inf)

    def absorb(self, other: "SensorTrack") -> None:
        """Take over when the sensors saw a person that has turned out to be this one."""
        for sensor, (first, last) in other._seen.items():
            own = self._seen.get(sensor, (first, last))
            self._seen[sensor] = (min(first, own[0]), max(last, own[1]))

    def _line(self) -> Tuple[float, float, float, float, float]:
        """Straight line through the places of the last second: time s, x, y m, velocity m/s."""
        if self._fit is None:
            count = len(self._points)
            time, x, y = (sum(values) / count for values in zip(*self._points))
            square = sum((point[0] - time) ** 2 for point in self._points)
            u = v = 0.0
            if self._points[-1][0] - self._points[0][0] >= SHORTEST_S:
                u = sum((point[0] - time) * point[1] for point in self._points) / square
                v = sum((point[0] - time) * point[2] for point in self._points) / square
                scale = min(1.0, FASTEST_MPS / max(math.hypot(u, v), 1e-9))
                u, v = u * scale, v * scale
            self._fit = (time, x, y, u, v)
        return self._fit
