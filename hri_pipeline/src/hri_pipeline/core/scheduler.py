"""Who gets the network in an image: earliest deadline first, within a budget that grows into what the machine leaves
idle.

`IdleShare` measures the idle time of the cores and says how much more than the least budget may be spent.
`InferenceScheduler` gives everybody a rate out of it, and keeps a deadline for each: C. L. Liu and J. W. Layland,
"Scheduling Algorithms for Multiprogramming in a Hard-Real-Time Environment", 1973. Under overload all deadlines pass;
the one that is late for longest comes first, so that nobody waits for ever.
"""

from __future__ import annotations

import math
import time
from collections import deque
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Callable, Deque, Dict, Iterator, List, Optional, Sequence, Tuple

from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.resources import Cores, CoreTime

_SAMPLE_S = 0.25
"""Time (s) between two measurements of the idle time: 25 clock ticks of a core."""
_GAIN = 0.3
"""Part of the idle time that a node takes more at each measurement, or of what is lacking that it gives up: two nodes
share what there is. The same both ways, as others use a little more and less all the time: a node that gave up all at
once, and took it slowly, had less than its share on average."""
_SCARCE = 0.5
"""Part of the time that is to stay idle. When less than that is idle, all that is lacking is given up at once."""
_LEAST_IDLE = 0.05
"""Part of the time that is to stay idle whatever the share: where none is, nobody can be seen to need it."""
_COST_MEMORY = 0.9
"""Weight of the old estimate of the cost of one inference when a new one is measured."""
_NEARLY_DUE = 0.55
"""Part of its period by which an item comes early, in one batch with one that is due."""
_MOST_LATE = 2.0
"""Most periods that all may be late: after a busy time there is no long catching up."""
_SLOW_STEP = 0.2
"""Time between two images (s) from which the budget grows with it: who is not measured for seconds would be lost."""
_LONGEST_WAIT = 0.5
"""Time (s) after which everybody gets an inference although the image is old: who is not seen for longer is lost."""
_TOGETHER = 0.5
"""Part of the images in which a graphics card, on which all come together, gets work beyond the least rate."""
_LONGEST_STEP = 1.0
"""Time between two images (s) above which no more is earned."""
_FIRST_STEP = 1.0 / 30.0
"""Time (s) between two images while only one is known."""
_PAUSE_S = 3.0
"""Without any image for so long (s), nobody waits for a turn, but for the camera."""
_LONGEST_ROUND = 64
"""Turns whose waits are kept: the most items there can be."""
_OF_INTERVAL = 0.8
"""Part of the time between two images that work may take when the budget grows: none is to be left out."""
_INTERVAL_LEAK = 1.01
"""Growth of the estimated interval per image: it is the least of the last ones, as some are left out."""
_TIE_S = 1e-4
"""Deadlines (s) that differ by less are equal: who waits for longer comes first."""
_UP, _DOWN = 0.5, 0.05
"""Weight of a longer, and of a shorter time of an image, in the estimate for the age: the slow images give it. The
mean, which says how much time is free, has the second weight for both."""


class IdleShare:
    """How many cores' time a node may spend beyond its least budget, so that `share` of the machine is used in all, and
    of each quota that the node is under.

    Follows the idle time slowly, but gives up what is too much at the next measurement where others need it.
    """

    def __init__(self, share: float, idle: Optional[Callable[[], Sequence[CoreTime]]] = None,
                 clock: Callable[[], float] = time.monotonic) -> None:
        """share: 0 (nothing beyond the least budget) to 1, of the time of all cores, for all processes together; from
        0.95 on it is 0.95.

        idle: by default Cores.times of this process; clock: s. Raises ValueError for another share.
        """
        self._idle, self._clock = idle or Cores().times, clock
        self._last: Optional[Tuple[float, Sequence[CoreTime]]] = None
        self.cores = 0.0
        self.set_share(share)

    def set_share(self, share: float) -> None:
        """See the constructor."""
        if not 0.0 <= share <= 1.0:
            raise ValueError("a share of {} of the cores' time, legal range 0 to 1".format(share))
        self._share = share

    def update(self, usable: float, threads: int = 1) -> float:
        """Return the time, in cores; usable: the most (cores) that could be used now, by so many threads."""
        usable = min(max(usable, 0.0), float(threads))
        if self._share == 0.0 or usable == 0.0:
            self.cores, self._last = 0.0, None
            return 0.0
        now = self._clock()
        if self._last is None or now < self._last[0]:
            self._last = self._read(now)
        elif now - self._last[0] >= _SAMPLE_S:
            fresh = self._read(now)
            if fresh is not None:
                self.cores = max(0.0, self.cores + self._change(self._last[1], fresh[1], now - self._last[0]))
            self._last = fresh
        self.cores = min(self.cores, usable)
        return self.cores

    def _change(self, before: Sequence[CoreTime], after: Sequence[CoreTime], seconds: float) -> float:
        """How many cores more are used from now on: the least of what the machine and the quotas leave; 0 when these
        have changed."""
        if [one.cores for one in before] != [one.cores for one in after]:
            return 0.0
        changes = []
        for old, new in zip(before, after):
            idle, kept = (new.idle - old.idle) / seconds, max(1.0 - self._share, _LEAST_IDLE) * new.cores
            changes.append((_GAIN if idle > _SCARCE * kept else 1.0) * (idle - kept))
        return min(changes)

    def _read(self, now: float) -> Optional[Tuple[float, Sequence[CoreTime]]]:
        """Time of the measurement (s) and what is idle; None, and nothing beyond the least budget, where it is
        unknown."""
        try:
            return now, self._idle()
        except (OSError, ValueError):
            self.cores = 0.0
            return None


@dataclass(frozen=True)
class Request:
    """Somebody who could get an inference. weight: how much more often than others of 1; first: before all others."""

    id: str
    weight: float = 1.0
    first: bool = False


class InferenceScheduler:
    """Chooses who gets an inference of a network in each image.

    Everybody gets `rate` inferences a second, as far as the budget allows; with idle time, more, up to every image.
    At least one that is due is chosen for each image. The cost of an inference is measured (`spent`): the same budget
    means more of them on a faster machine.
    """

    def __init__(self, rate: float = 0.0, budget: float = math.inf, most: int = 0, cost: float = 0.005,
                 batches: bool = True, idle: Optional[IdleShare] = None, max_age: float = math.inf,
                 threads: Threads = ONE_THREAD, clock: Optional[Callable[[], float]] = None) -> None:
        """rate, budget, most, max_age and errors: see limit.

        cost: first guess of the processor time of one inference, s. batches: who is due soon comes along with who is
        due; else the images get an even load. idle: what may be spent beyond the budget. threads: share the inferences
        of an image, so that it gets older by those of one of them only; budgets are of the time of all. clock:
        processor time, s; by default that of these threads.
        """
        self._cost, self._batches, self._idle, self._threads = cost, batches, idle, threads
        self._together = 0
        self._clock = clock or threads.time
        self.limit(rate, budget, most, max_age)
        self.reset()
        self._rest = self._mean_rest = self._took = 0.0
        self._stretch = 1.0

    def limit(self, rate: float, budget: float = math.inf, most: int = 0, max_age: float = math.inf,
              max_rate: float = 0.0) -> None:
        """Set the limits.

        Parameters
        ----------
        rate
            Least rate (Hz) for each that the budget is for, 0 for every image.
        budget
            Time (s) per image.
        most
            Inferences per image, 0 for no limit.
        max_age
            Age (s) of an image that the work on it may not exceed; one inference, and two a second for each, are
            made all the same (on average, where all come together).
        max_rate
            Rate (Hz) at which images are taken at most, 0 for all: two that follow each other sooner by chance do not
            mean that there is less time for each.

        Raises
        ------
        ValueError
            For a negative or infinite rate, a negative number, or a budget, cost or age that is not above 0.
        """
        if not (math.isfinite(rate) and rate >= 0.0 and budget > 0.0 and most >= 0 and self._cost > 0.0
                and max_age > 0.0):
            raise ValueError("rate {} Hz, budget {} s, {} per image, cost {} s, age {} s: rate and number from 0, the "
                             "others above 0".format(rate, budget, most, self._cost, max_age))
        self._rate, self._budget, self._most, self._max_age = rate, budget, most, max_age
        self._least_interval = 1.0 / max_rate if max_rate > 0.0 else 0.0

    def set_share(self, share: float) -> None:
        """Set the share of the cores' time (see IdleShare). Raises ValueError out of 0 to 1."""
        if self._idle is not None:
            self._idle.set_share(share)

    def reset(self) -> None:
        """Forget everybody; the estimated cost is kept."""
        self._deadlines: Dict[str, float] = {}
        self._served: Dict[str, float] = {}
        self._waits: Deque[float] = deque(maxlen=_LONGEST_ROUND)
        self._stamp: Optional[float] = None
        self._resumed = self._worked = -math.inf
        self._left = 0.0
        self._age: Optional[float] = None
        self._interval = math.inf

    @property
    def cost(self) -> float:
        """Estimated time of one inference, s."""
        return self._cost

    @property
    def threads(self) -> int:
        """How many threads share the inferences of an image."""
        return self._threads.count

    def share_among(self, threads: Threads, together: int = 0) -> None:
        """Let other threads share the inferences of an image from now on, as where a graphics card has failed.

        together: so many take hardly longer than a few, as on a card; 0: each takes as long. As many as these get
        theirs in the same image then, the others in the next one, and beyond the least rate each in every second one
        at most: where all come together the next goes without, and is published the sooner.
        """
        self._threads, self._together = threads, together

    @property
    def is_live(self) -> bool:
        """Whether the ages of the images are told (see note_timing): they come from a camera, which does not wait."""
        return self._age is not None

    @property
    def spare(self) -> float:
        """What is spent beyond the least budget, in cores."""
        return 0.0 if self._idle is None else self._idle.cores

    def wait(self, count: int) -> float:
        """Longest time (s) between two turns in the last `count` of them."""
        return max(list(self._waits)[-count:], default=0.0) if count else 0.0

    def note_timing(self, age: float, took: float) -> None:
        """Note, before choose, the age (s) of the new image, and the time (s) that the last one took in all.

        Who works on recorded images, and does not call it, gets the least budget, however old they are.
        """
        rest = max(0.0, took - self._took)
        self._rest += (_UP if rest > self._rest else _DOWN) * (rest - self._rest)
        self._mean_rest += _DOWN * (rest - self._mean_rest)
        self._age, self._took = max(0.0, age), 0.0

    def choose(self, requests: Sequence[Request], stamp: float, reserved: int = 0) -> List[str]:
        """Return the ids of those who get an inference in the image of `stamp` (s), most urgent first.

        requests: all that could; somebody new is due at once. reserved: inferences of `most` that are left to others;
        one at least is not.
        """
        step = 0.0 if self._stamp is None else min(max(stamp - self._stamp, 0.0), _LONGEST_STEP)
        if self._stamp is not None and stamp - self._stamp > _PAUSE_S:
            self._resumed = stamp
        self._stamp = stamp
        if step > 0.0:
            self._interval = min(self._interval * _INTERVAL_LEAK, max(step, self._least_interval))
        extra = self._extra(len(requests))
        periods = self._periods(requests, step, extra)
        self._admit(requests, stamp, periods)
        due = self._due(requests, stamp, periods)
        least = int(math.ceil(len(requests) * step / _LONGEST_WAIT - 1e-6))
        chosen = due[:self._all_or_none(min(len(due), self._together), stamp, step, extra) if self._together else
                     self._affordable(len(due), step, extra, reserved, least)]
        for name in chosen:
            begin = self._deadlines[name]
            if self._together:      # who came early with the others, or late, neither pays for it later nor gains
                begin = min(max(begin, stamp - periods[name]), stamp)
            self._deadlines[name] = begin + periods[name]
            self._waits.append(stamp - max(self._served[name], self._resumed))
            self._served[name] = self._worked = stamp
        return chosen

    def renew(self, name: str) -> None:
        """Let somebody be due at once, as if new."""
        self._deadlines.pop(name, None)

    def spent(self, seconds: float, count: int) -> None:
        """Update the estimated cost by the processor time of `count` inferences."""
        if count > 0 and math.isfinite(seconds) and seconds > 0.0:
            self._cost = _COST_MEMORY * self._cost + (1.0 - _COST_MEMORY) * seconds / count

    @contextmanager
    def measure(self) -> Iterator[Callable[[int], None]]:
        """Measure the inferences in the body of a `with` statement, which says how many there were."""
        counts: List[int] = []
        began, wall = self._clock(), time.perf_counter()
        yield counts.append
        used, wall = self._clock() - began, time.perf_counter() - wall
        self.spent(used, sum(counts))
        self._took += wall
        if used > 1e-4:
            self._stretch += 0.1 * (max(1.0, wall / (used * self._of_one_thread(sum(counts)))) - self._stretch)

    def _of_one_thread(self, count: int) -> float:
        """Part of `count` inferences that the thread with the most of them makes."""
        return math.ceil(count / self._threads.count) / count if count else 1.0

    def _extra(self, count: int) -> float:
        """Time (s) per image beyond the least budget."""
        if self._idle is None or self._age is None or self._rate == 0.0 or not math.isfinite(self._interval):
            return 0.0
        missing = count * self._cost - self._least(count)
        room = (_OF_INTERVAL * self._interval - self._mean_rest) * self._threads.count
        usable = min(missing, (room - self._least(count) * self._stretch) / self._stretch) / self._interval
        return self._idle.update(usable, self._threads.count) * self._interval

    def _least(self, count: int) -> float:
        """Time (s) per image that `count` items at the least rate take of the least budget."""
        budget = min(self._budget, self._most * self._cost if self._most else math.inf)
        return min(budget, count * self._cost * min(1.0, self._rate * self._interval))

    def _periods(self, requests: Sequence[Request], step: float, extra: float) -> Dict[str, float]:
        """Time (s) between two inferences of each."""
        least = (step or _FIRST_STEP) if self._rate == 0.0 else max(1.0 / self._rate, step)
        if not requests or self._rate == 0.0 or not math.isfinite(self._interval):
            return {request.id: least / request.weight for request in requests}
        needed = len(requests) * self._cost * self._rate * self._interval
        if needed > self._least(len(requests)) + extra + 1e-9:      # nobody gets the least rate: by weight alone
            return {request.id: least / request.weight for request in requests}
        if extra <= 0.0:
            return {request.id: least for request in requests}
        fair = (self._least(len(requests)) + extra) / self._cost / sum(request.weight for request in requests)
        most = _TOGETHER if self._together else 1.0
        return {request.id: min(least, self._interval / min(most, max(fair * request.weight, 1e-6)))
                for request in requests}

    def _admit(self, requests: Sequence[Request], stamp: float, periods: Dict[str, float]) -> None:
        """Keep the deadlines of all; somebody new is a little earlier than all others."""
        known = [self._deadlines[request.id] for request in requests if request.id in self._deadlines]
        first = min(known + [stamp]) - _TIE_S
        self._deadlines = {request.id: self._deadlines.get(request.id, first) for request in requests}
        self._served = {request.id: self._served.get(request.id, stamp) for request in requests}
        if requests:
            # Under a tight budget all are late: what all are late is dropped, the order stays.
            late = min(stamp - self._deadlines[request.id] - _MOST_LATE * periods[request.id] for request in requests)
            if late > 0.0:
                self._deadlines = {name: deadline + late for name, deadline in self._deadlines.items()}

    def _due(self, requests: Sequence[Request], stamp: float, periods: Dict[str, float]) -> List[str]:
        """Those whose turn it is, the earliest deadline first."""
        order = sorted(requests, key=lambda request: (
            not request.first, round(self._deadlines[request.id] / _TIE_S), self._served[request.id]))
        if self._rate == 0.0:
            return [request.id for request in order]
        # Rounding must not cost anybody a turn: at 15 Hz from images at 15 Hz every image is due.
        early = {request.id: self._deadlines[request.id] - stamp - 1e-3 * periods[request.id] for request in requests}
        if self._batches:
            if any(value <= 0.0 for value in early.values()):
                if len(requests) <= self._together:
                    return [request.id for request in order]
                return [request.id for request in order if early[request.id] <= _NEARLY_DUE * periods[request.id]]
            return []
        earned = sum(1.0 - early[request.id] / periods[request.id] for request in requests)
        return [request.id for request in order][:max(0, int(earned + 1e-6))]

    def _all_or_none(self, due: int, stamp: float, step: float, extra: float) -> int:
        """All that are due and come together, or 0 while there is not the time for them; it is saved up.

        Nor while images are too old, but one for each of those on average, and two a second for each: all, after as
        many images as they are.
        """
        earned = self._budget * max(1.0, step / _SLOW_STEP) + extra
        spendable, needed = earned + self._left, due * self._cost
        wait = due * min(step, _LONGEST_WAIT / max(1, len(self._served))) - 0.5 * step
        is_late = self._age is not None and self._max_age - self._age - self._rest < needed * self._stretch
        if spendable < needed or is_late and stamp - self._worked < wait:
            self._left = min(spendable, needed)
            return 0
        self._left = min(spendable - needed, earned) if self._left else 0.0
        return due

    def _most_of(self, step: float) -> int:
        """Most inferences for the image `step` s after the last: of slow images more, where the time between them is
        not needed for the rest."""
        if self._age is None or step <= _SLOW_STEP:
            return self._most
        room = (_OF_INTERVAL * step - self._mean_rest) * self._threads.count / (self._cost * self._stretch)
        return max(self._most, min(int(self._most * step / _SLOW_STEP), int(room)))

    def _affordable(self, due: int, step: float, extra: float, reserved: int, least: int) -> int:
        """Number of inferences for the image `step` s after the last; the time that is left goes to the next image.

        least: how many the age of the image does not prevent.
        """
        count = due
        if math.isfinite(self._budget):
            spendable = self._budget * max(1.0, step / _SLOW_STEP) + extra + self._left
            count = max(1, int(spendable / self._cost + 1e-9))
            self._left = max(0.0, spendable - count * self._cost) if due > count else 0.0
        if self._most:
            count = min(count, max(1, self._most_of(step) + int(extra / self._cost + 1e-6) - reserved))
        if self._age is not None:
            left = (self._max_age - self._age - self._rest) / self._stretch
            count = min(count, max(1, least, int(left / self._cost) * self._threads.count))
        return count
