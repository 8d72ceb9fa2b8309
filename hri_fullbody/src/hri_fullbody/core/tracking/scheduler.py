"""Which bodies get the pose network in an image when time is short, and which images give joint states."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, List, Optional, Sequence

from hri_fullbody.core.tracking.track import BodyTrack

_FAST = 1.0             # body sizes per second from which a body counts as fast
_NEWBORN_WEIGHT = 3.0
_HIDDEN_WEIGHT = 0.4
_LONGEST_ROUND = 64     # turns whose waits are kept: the most bodies there can be
_PAUSE_S = 3.0          # without any image bodies wait for the camera, not for their turn


class PoseScheduler:
    """Distributes the inferences of the pose network over bodies and images.

    Every body earns `rate` inferences a second, into one account: two bodies at half of the image rate take turns
    instead of both having theirs in every other image. The most urgent come first:
    those that have waited longest, counted more for the fast and the newly born, less for the hidden.
    """

    def __init__(self, rate: float = 0.0, budget: int = 0) -> None:
        """rate, budget and errors: see limit."""
        self.limit(rate, budget)
        self._earned = 0.0
        self._last: Optional[float] = None
        self._turns = 0
        self._waits: Deque[float] = deque(maxlen=_LONGEST_ROUND)
        self._resumed = -math.inf

    def limit(self, rate: float, budget: int) -> None:
        """rate: Hz for each body, 0 for every image.

        budget: most windows per image, 0 for no limit. ValueError if < 0.
        """
        if rate < 0.0 or budget < 0:
            raise ValueError("rate is {} Hz and budget {} windows, legal range 0 and more".format(rate, budget))
        self._rate = rate
        self._budget = budget

    def reset(self) -> None:
        """Forget what was earned."""
        self._earned, self._last = 0.0, None
        self._waits.clear()
        self._resumed = -math.inf

    def choose(self, tracks: Sequence[BodyTrack], stamp: float, reserved: int = 0) -> List[BodyTrack]:
        """Return the bodies whose turn it is in the image of `stamp` (s), most urgent first.

        reserved: windows of the budget that are left to others; one at least is not.
        """
        step = 0.0 if self._last is None else max(0.0, stamp - self._last)
        self._last = stamp
        self._resumed = stamp if step > _PAUSE_S else self._resumed
        count = len(tracks)
        if self._rate > 0.0:
            # A hair more than earned: 0.1 s at 10 Hz is a whole inference.
            self._earned = min(self._earned + count * self._rate * step, float(count))
            newborn = sum(not track.life.confirmed for track in tracks)
            count = max(int(self._earned + 1e-6), min(newborn, 1))
            self._earned = max(0.0, self._earned - count)
        if self._budget:
            count = min(count, max(1, self._budget - reserved))
        waiting = sorted(tracks, key=lambda track: (-urgency(track, stamp), track.turn))
        chosen = [track for track in waiting[:count] if stamp > track.inferred_at]
        for track in chosen:
            self._turns += 1
            track.turn = self._turns
            self._waits.append(stamp - max(track.inferred_at, self._resumed))
        wait = max(list(self._waits)[-len(tracks):], default=0.0)
        for track in tracks:
            track.wait = wait
        return chosen


def urgency(track: BodyTrack, stamp: float) -> float:
    """Time since the last inference (s), weighted by how much may have happened since."""
    weight = 1.0 + min(track.motion.speed() / _FAST, 1.0)
    if not track.life.confirmed:
        weight = _NEWBORN_WEIGHT
    elif not track.visible:
        weight = _HIDDEN_WEIGHT
    return weight * (stamp - track.inferred_at)


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
