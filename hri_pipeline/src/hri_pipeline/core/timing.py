"""How long the stages of a pipeline take, and a constant rate by the wall clock or by the stamps of images."""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import contextmanager
from typing import Callable, Deque, Dict, Iterator, Tuple

import numpy as np


class StageTimes:
    """Wall time of named stages over the last `window` runs of each.

        times = StageTimes()
        with times("mesh"):
            ...
        times.summary()    # {"mesh": (median ms, 95th percentile ms)}

    Safe to read from another thread.
    """

    def __init__(self, window: int = 100, clock: Callable[[], float] = time.perf_counter) -> None:
        if window < 1:
            raise ValueError("window is {}, legal range 1 and more".format(window))
        self._window = window
        self._clock = clock
        self._lock = threading.Lock()
        self._times: Dict[str, Deque[float]] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Measure the body of a `with` statement, also when it raises."""
        start = self._clock()
        try:
            yield
        finally:
            self.add(stage, self._clock() - start)

    def add(self, stage: str, seconds: float) -> None:
        """Add one time of `stage`, in seconds."""
        with self._lock:
            self._times.setdefault(stage, deque(maxlen=self._window)).append(seconds)

    def summary(self) -> Dict[str, Tuple[float, float]]:
        """Return {stage: (median, 95th percentile)} in ms, in the order in which the stages first ran."""
        with self._lock:
            times = {stage: np.array(values) * 1e3 for stage, values in self._times.items()}
        return {stage: (float(np.median(values)), float(np.percentile(values, 95)))
                for stage, values in times.items()}

    def values(self) -> Dict[str, float]:
        """Return the summary as {"<stage>_ms_median": ms, "<stage>_ms_p95": ms}, for diagnostics."""
        values: Dict[str, float] = {}
        for stage, (median, high) in self.summary().items():
            name = stage.replace(" ", "_")
            values[name + "_ms_median"], values[name + "_ms_p95"] = median, high
        return values

    def clear(self) -> None:
        """Forget all times."""
        with self._lock:
            self._times.clear()


class Pacer:
    """A constant rate, Hz, by the wall clock, as rospy.Rate: says how long to wait for the next cycle.

    The cycles are counted from the first one, so that delays do not add up. After a delay of more than one period they
    are counted anew, so that there are no bursts. Raises ValueError for a rate that is not above 0.
    """

    def __init__(self, rate: float) -> None:
        if not rate > 0.0:
            raise ValueError("rate is {} Hz, it must be above 0".format(rate))
        self._period = 1.0 / rate
        self._start = 0.0
        self._count = -1

    def wait(self, now: float) -> float:
        """Return the time in s from `now` (s, monotonic) to the next cycle; 0 when it is due."""
        if self._count < 0:
            return 0.0
        return max(0.0, self._start + self._count * self._period - now)

    def done(self, now: float) -> None:
        """Note that a cycle has begun at `now` (s)."""
        late = now - (self._start + self._count * self._period)
        if self._count < 0 or late > self._period:
            self._start, self._count = now, 0
        self._count += 1


class StampPacer:
    """Picks images so that `rate` of them per second are taken on average, whatever their own rate.

    rate: Hz; 0 takes all. Counting goes on from where an image was due, not from where it came: images at 20 Hz
    give 15 Hz and not 10. Raises ValueError for a rate below 0.
    """

    def __init__(self, rate: float) -> None:
        self._last = float("-inf")
        self.set_rate(rate)

    def set_rate(self, rate: float) -> None:
        """Set the rate, Hz; the row starts anew. ValueError below 0."""
        if not rate >= 0.0:
            raise ValueError("rate is {} Hz, legal range 0 and more".format(rate))
        self._period = 1.0 / rate if rate > 0.0 else 0.0
        self._due = float("-inf")

    def is_due(self, stamp: float) -> bool:
        """Tell whether the image of `stamp` (s) is taken. One that is not newer than the last taken one never is."""
        if stamp <= self._last or stamp < self._due - 1e-6:
            return False
        self._last = stamp
        # After a pause of more than one period the row starts anew: there are no bursts.
        self._due = (self._due if stamp - self._due < self._period else stamp) + self._period
        return True

    def reset(self) -> None:
        """Start anew: time has jumped back."""
        self._due = self._last = float("-inf")
