"""When a voice spoke: intervals out of the messages that say that it begins and that it ends."""

from __future__ import annotations

from typing import List

import numpy as np

KEEP_S = 20.0
BRIDGE_S = 0.5
"""Pauses up to this long are no silence: between two words a mouth moves on."""
MARGIN_S = 0.4
"""So long before and after speech a mouth may move or not: lips part before the first sound."""


class SpeakingTimes:
    """Intervals (s) in which one voice spoke.

    onset_delay: s from the first sound to the arrival of the message that says so; hangover: s from the last sound to
    the arrival of the message that says that it is over.
    """

    def __init__(self, onset_delay: float, hangover: float) -> None:
        self._onset_delay, self._hangover = onset_delay, hangover
        self._intervals: List[List[float]] = []
        self.speaking = False

    @property
    def first(self) -> float:
        """Start (s) of the first interval that is kept, infinity when the voice has not spoken."""
        return self._intervals[0][0] if self._intervals else float("inf")

    @property
    def last(self) -> float:
        """End (s) of the last interval, infinity while the voice speaks, minus infinity when it never did."""
        return self._intervals[-1][1] if self._intervals else float("-inf")

    def say(self, speaking: bool, arrival: float) -> bool:
        """Take a message that arrived at `arrival` (s); returns whether it changes anything."""
        if speaking == self.speaking:
            return False
        self.speaking = speaking
        if not speaking:
            self._intervals[-1][1] = max(self._intervals[-1][0], arrival - self._hangover)
        elif arrival - self._onset_delay <= self.last + BRIDGE_S:
            self._intervals[-1][1] = float("inf")
        else:
            self._intervals.append([arrival - self._onset_delay, float("inf")])
        self._intervals = [interval for interval in self._intervals if interval[1] >= arrival - KEEP_S]
        return True

    def at(self, times: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Tell for each of the times (T,) s whether the voice spoke, up to `margin` s before or after."""
        spoke = np.zeros(len(times), dtype=bool)
        for start, end in self._intervals:
            spoke |= (times >= start - margin) & (times <= end + margin)
        return spoke
