"""Chance over time: two states that take turns, and noise with a memory."""

from __future__ import annotations

import math
import random
from typing import List, Sequence


class Alternation:
    """On for `share` of the time, `length` s on average each time; both times are exponential, the first is off."""

    def __init__(self, share: float, length: float, chance: random.Random, least: float = 0.0) -> None:
        """share: 0 to below 1. least: shortest time (s) in one state."""
        if not 0.0 <= share < 1.0 or not length > 0.0:
            raise ValueError("share is {} and length {} s; legal: 0 to below 1, above 0 s".format(share, length))
        self._share, self._length, self._chance, self._least = share, length, chance, least
        self._on = False
        self._until = -1.0

    def update(self, now: float) -> bool:
        """Tell whether it is on at `now` (s); times do not go back."""
        if self._share <= 0.0:
            return False
        while now >= self._until:
            first = self._until < 0.0
            # The first time is off or on as it would be later, so that the share holds from the begin.
            self._on = self._chance.random() < self._share if first else not self._on
            mean = self._length if self._on else self._length * (1.0 - self._share) / self._share
            self._until = (now if first else self._until) + max(self._least, self._chance.expovariate(1.0 / mean))
        return self._on


class Noise:
    """Gaussian noise of standard deviation 1 on several axes: a part that is white and one that remembers.

    share: of the variance that is correlated over `time` s (Ornstein-Uhlenbeck process), 0 to 1.
    """

    def __init__(self, axes: int, share: float, time: float, chance: random.Random) -> None:
        self._share, self._time, self._chance = share, time, chance
        self._slow: List[float] = [chance.gauss(0.0, 1.0) for _ in range(axes)]
        self._last = 0.0

    def update(self, now: float) -> Sequence[float]:
        """Return the noise at `now` (s)."""
        keep = math.exp(-max(0.0, now - self._last) / self._time) if self._time > 0.0 else 0.0
        fresh, self._last = math.sqrt(1.0 - keep * keep), now
        self._slow = [keep * value + fresh * self._chance.gauss(0.0, 1.0) for value in self._slow]
        white, slow = math.sqrt(1.0 - self._share), math.sqrt(self._share)
        return [slow * value + white * self._chance.gauss(0.0, 1.0) for value in self._slow]
