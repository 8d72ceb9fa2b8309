"""How long the stages of a pipeline take, a constant rate by the wall clock or by the stamps of images, and stamps of
several sources, each in its own order: what is newer, what only lags, and where time has jumped back."""

from __future__ import annotations

import math
import statistics
import threading
import time
from collections import OrderedDict, deque
from contextlib import contextmanager
from enum import Enum
from typing import Callable, ContextManager, Deque, Dict, Hashable, Iterator, List, Tuple

Stamp = Tuple[int, int]
"""Seconds and nanoseconds."""

JUMP_BACK_S = 0.5
STALE_S = 0.5       # of a source without a newer stamp: late messages of a moment ago have come by then
OTHER_CLOCK_S = 86400.0     # stamps that differ by more are of another clock, not late
_FIRST_DATE_S = 1e9         # earlier times are of a simulation, or of a clock that was never set
ALL_STALE_S = 10.0  # no source lags by so much: who was seen before the jump may never come again
MAX_SOURCES = 500


class StageTimes:
    """Wall time of named stages over the last `window` runs of each.

        times = StageTimes()
        with times("mesh"):
            ...
        times.summary()    # {"mesh": (median ms, 95th percentile ms)}

    Safe to read from another thread.
    """

    def __init__(self, window: int = 100, clock: Callable[[], float] = time.perf_counter) -> None:
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

    @contextmanager
    def in_parts(self, stage: str) -> Iterator[Callable[[], ContextManager[None]]]:
        """Measure parts of the body of a `with` statement, which gets what measures one: their sum is one time of the
        stage; none where no part ran."""
        parts: List[float] = []

        @contextmanager
        def part() -> Iterator[None]:
            start = self._clock()
            try:
                yield
            finally:
                parts.append(self._clock() - start)

        try:
            yield part
        finally:
            if parts:
                self.add(stage, sum(parts))

    def add(self, stage: str, seconds: float) -> None:
        """Add one time of `stage`, in seconds."""
        with self._lock:
            self._times.setdefault(stage, deque(maxlen=self._window)).append(seconds)

    def summary(self) -> Dict[str, Tuple[float, float]]:
        """Return {stage: (median, 95th percentile)} in ms, in the order in which the stages first ran."""
        with self._lock:
            times = {stage: list(values) for stage, values in self._times.items()}
        return {stage: _middle_and_high([1e3 * value for value in values]) for stage, values in times.items()}

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


def _middle_and_high(values: List[float]) -> Tuple[float, float]:
    """Return the median and the 95th percentile, linear between two values; numpy takes 20 times as long for both."""
    ordered = sorted(values)
    place = 0.95 * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return statistics.median(ordered), ordered[below] + (place - below) * (ordered[above] - ordered[below])


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


EARLY = 0.4
"""Part of a period by which the images of a camera may come before they are due. Below a half: of twice as many as
wanted every second one is taken."""


class StampPacer:
    """Picks images so that `rate` of them per second are taken on average, whatever their own rate.

    rate: Hz; 0 takes all. early: part of a period, 0 to 1, by which an image may come before it is due: times of
    arrival tremble, and of images that come at the wanted rate none is to be left out. Counting goes on from where an
    image was due, not from where it came: images at 20 Hz give 15 Hz and not 10. Raises ValueError for a rate below 0.
    """

    def __init__(self, rate: float, early: float = 0.0) -> None:
        self._last, self._early = float("-inf"), early
        self.set_rate(rate)

    def set_rate(self, rate: float) -> None:
        """Set the rate, Hz; the row starts anew. ValueError below 0."""
        if not rate >= 0.0:
            raise ValueError("rate is {} Hz, legal range 0 and more".format(rate))
        self.period = 1.0 / rate if rate > 0.0 else 0.0
        """Time (s) between two images at that rate."""
        self._due = float("-inf")

    def is_due(self, stamp: float) -> bool:
        """Tell whether the image of `stamp` (s) is taken. One that is not newer than the last taken one never is."""
        if stamp <= self._last or stamp < self._due - self._early * self.period - 1e-6:
            return False
        self._last = stamp
        # After a pause of more than one period the row starts anew: there are no bursts.
        self._due = (self._due if stamp - self._due < self.period else stamp) + self.period
        return True

    def reset(self) -> None:
        """Start anew: time has jumped back."""
        self._due = self._last = float("-inf")


class Order(Enum):
    """How a stamp stands to the earlier ones."""

    NEWER = "newer than all of its source"
    LATE = "not newer"
    BACK = "time has jumped back"


class ClockWatch:
    """Tells for how long a clock, such as that of a recording, has stood still."""

    def __init__(self) -> None:
        self._now = -1.0
        self._since = 0.0

    def stood_still(self, now: float, wall: float) -> float:
        """Return for how long (s of wall time) the clock has shown `now` (s); wall: s, monotonic."""
        if now != self._now:
            self._now, self._since = now, wall
        return wall - self._since


def clock_fault(age: float, now: float, wall: float, simulated: bool) -> Tuple[str, str]:
    """Return what is wrong with stamps of another clock, to be read after "images are" or "sound is", and the remedy.

    Parameters
    ----------
    age : by how much a stamp is before now, s.
    now : time of ROS, s.
    wall : time of the machine, s.
    simulated : whether the time of ROS is that of /clock (/use_sim_time).
    """
    stamp = now - age
    if abs(age) < OTHER_CLOCK_S:
        if age <= 0.0:
            return "{:.1f} s in the future".format(-age), (
                "let one program only, that of the images, publish /clock (a bag: --clock)" if simulated else
                "set the clocks of the machines (chrony, ntpdate)")
        return "{:.1f} s old when they arrive".format(age), (
            "play the bag no faster than this machine computes" if simulated else
            "set the clocks of the machines (chrony, ntpdate); over a network take image_transport:=compressed; play a "
            "bag with --clock and /use_sim_time true")
    if simulated and abs(stamp - wall) < OTHER_CLOCK_S:
        return "stamped by the wall clock, and /use_sim_time is true: {:.1f} s on /clock".format(now), (
            "let the driver stamp by the time of ROS; without a simulator or bag: rosparam set /use_sim_time "
            "false, and start the nodes again")
    text = ("stamped by simulated time ({:.1f} s)".format(stamp) if stamp < _FIRST_DATE_S else
            "of " + time.strftime("%Y-%m-%d %H:%M", time.gmtime(stamp)))
    if simulated:
        return "{}, and /clock is another time".format(text), (
            "let one program only, that of the images, publish /clock (a bag: --clock)")
    return "{}, and /use_sim_time is not true".format(text), (
        "of a simulator or bag: rosparam set /use_sim_time true, play the bag with --clock, and start the nodes again; "
        "of a device: set its clock")


def clock_went_back(seconds: float, simulated: bool) -> str:
    """Return what to say where the time of ROS has gone back by so much (s), with the remedy where it does so again.

    simulated : whether it is that of /clock (/use_sim_time).
    """
    if not simulated:
        return ("the clock of this machine was set back by {:.1f} s (where this goes on, let one program only set it, "
                "such as chrony)".format(seconds))
    return ("/clock went back by {:.1f} s (a bag that loops? Where this goes on, let one program only publish /clock; "
            "check.launch names them)".format(seconds))


class SourceStamps:
    """The newest stamp of each source.

    Sources lag behind each other, by seconds on a machine that is too slow; that is no jump of time. Time has jumped
    back when a source gives stamps far older than its own, or no source anything newer for ALL_STALE_S; but not where
    one whose clock is ahead has ended, and another one goes on as before.
    """

    def __init__(self) -> None:
        self._newest: "OrderedDict[Hashable, List]" = OrderedDict()     # stamp, when it came, when the first one came
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
            if known is None or known[2] >= self._latest_at:
                order = Order.BACK
        if order == Order.BACK:
            self.clear()
            self._latest, self._latest_at = stamp, now
        if order != Order.LATE:
            self._newest[source] = [stamp, now, now if known is None or order == Order.BACK else known[2]]
            self._newest.move_to_end(source)
            while len(self._newest) > MAX_SOURCES:
                self._newest.popitem(last=False)
        return order

    def clear(self) -> None:
        """Forget all sources: time has jumped."""
        self._newest.clear()
        self._latest, self._latest_at = (0, 0), 0.0


class StaleStampFilter:
    """Knows what is stamped by the time from before the clock went back, as of a bag that loops, and comes after it.

    It was on its way. Taken for new, it would hide all that follows until the clock is there again.
    """

    def __init__(self) -> None:
        self._margin, self._until = math.inf, -math.inf

    def went_back(self, seconds: float, now: float) -> None:
        """Note that the clock has gone back by so much, at `now` (s, of a clock that never jumps)."""
        self._margin, self._until = 0.5 * seconds, now + ALL_STALE_S

    def is_stale(self, stamp: float, clock: float, now: float) -> bool:
        """Tell whether a stamp (s) that comes at `clock` (s) and `now` (as above) is nearer to the time of before."""
        return now < self._until and stamp > clock + self._margin


class ClockSynchroniser:
    """One time for sensors whose clocks differ, or whose images come late by different times.

    It is the stamp. A sensor whose stamps lie further than a tolerance from what the others give at the same moment has
    its own shift (s) to the time of the others, as long as that is so. Where nothing else is heard, time may pass
    faster or slower than the clock, as of a bag that is played.
    """

    def __init__(self) -> None:
        self._shifts: Dict[Hashable, float] = {}
        self._latest: "OrderedDict[Hashable, Tuple[float, float]]" = OrderedDict()  # common time, and when it came

    @property
    def shifts(self) -> Dict[Hashable, float]:
        """Return what is added to the stamps of the sensors that have a shift (s)."""
        return dict(self._shifts)

    def note(self, sensor: Hashable, stamp: float, now: float, tolerance: float) -> float:
        """Take a stamp (s) of a sensor that arrives at `now` (s, of a clock that never jumps); return its shift (s).

        One that is not newer changes nothing, as of bodies that come after the faces of later images.
        tolerance: s, also the time for which a sensor is one of the others after its last stamp.
        """
        others = [latest for name, latest in self._latest.items() if name != sensor]
        shift = self._shifts.get(sensor, 0.0)
        if sensor in self._latest and stamp + shift <= self._latest[sensor][0]:
            return shift
        self._shifts.pop(sensor, None)
        if others:
            shift = self._shift(stamp, shift, now, max(others), tolerance)
        if shift:
            self._shifts[sensor] = shift
        self._latest[sensor] = stamp + shift, now
        self._latest.move_to_end(sensor)
        if shift < 0.0:
            self._lift(now, tolerance)
            shift = self._shifts.get(sensor, 0.0)
        while len(self._latest) > MAX_SOURCES:
            self._shifts.pop(self._latest.popitem(last=False)[0], None)
        return shift

    def clear(self) -> None:
        """Forget all sensors: time has jumped."""
        self._shifts.clear()
        self._latest.clear()

    def _lift(self, now: float, tolerance: float) -> None:
        """Shift less where all who are heard are shifted back, as after a stall of which one's stamps came first."""
        heard = [name for name, (_, at) in self._latest.items() if now - at <= tolerance]
        least = max(self._shifts.get(name, 0.0) for name in heard)
        if least < 0.0 and len(heard) > 1:
            for name in heard:
                newest, at = self._latest[name]
                self._latest[name] = newest - least, at
                self._shifts[name] -= least
                if not self._shifts[name]:
                    del self._shifts[name]

    @staticmethod
    def _shift(stamp: float, shift: float, now: float, latest: Tuple[float, float], tolerance: float) -> float:
        newest, at = latest
        if abs(stamp - newest) <= tolerance:
            return 0.0
        is_heard = now - at <= tolerance
        apart = stamp + shift - newest
        if abs(apart) <= tolerance or (apart > 0.0 and not is_heard):
            return shift
        return newest - stamp if is_heard else newest + (now - at) - stamp


def is_back(stamp: Stamp, before: Stamp) -> bool:
    """Tell whether a stamp is by more than JUMP_BACK_S older than the one before."""
    return before[0] - stamp[0] + 1e-9 * (before[1] - stamp[1]) > JUMP_BACK_S
