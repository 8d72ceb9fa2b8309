"""Who is looked at in an image when there is not time enough for everybody."""

from __future__ import annotations

import math
from collections import deque
from typing import Deque, List, Optional, Sequence

from hri_fullbody.core.tracking.body_track import BodyTrack

_FAST = 1.0             # body sizes per second from which a body counts as fast
_NEWBORN_WEIGHT = 3.0
_HIDDEN_WEIGHT = 0.6
_LONGEST_ROUND = 64     # looks of which the waits are known: the most bodies there can be
_PAUSE_S = 3.0          # without any image nobody waits for a look, but for the camera


class PoseSchedule:
    """Spreads the looks over bodies and images.

    Every body earns `rate` looks a second; the bodies share what they have earned, so that two bodies at half of
    the image rate take turns instead of both being looked at in every other image. The most urgent come first:
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
        """rate: Hz for each body, 0 for every image. budget: most windows per image, 0 for no limit. ValueError if < 0."""
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
        """Return the bodies to look at in the image of `stamp` (s), most urgent first.

        reserved: windows of the budget that are left to others; one look at least is not.
        """
        step = 0.0 if self._last is None else max(0.0, stamp - self._last)
        self._last = stamp
        self._resumed = stamp if step > _PAUSE_S else self._resumed
        count = len(tracks)
        if self._rate > 0.0:
            # A hair more than earned: 0.1 s at 10 Hz is a whole look.
            self._earned = min(self._earned + count * self._rate * step, float(count))
            newborn = sum(not track.life.confirmed for track in tracks)
            count = max(int(self._earned + 1e-6), min(newborn, 1))
            self._earned = max(0.0, self._earned - count)
        if self._budget:
            count = min(count, max(1, self._budget - reserved))
        waiting = sorted(tracks, key=lambda track: (-urgency(track, stamp), track.turn))
        chosen = [track for track in waiting[:count] if stamp > track.looked_at]
        for track in chosen:
            self._turns += 1
            track.turn = self._turns
            self._waits.append(stamp - max(track.looked_at, self._resumed))
        wait = max(list(self._waits)[-len(tracks):], default=0.0)
        for track in tracks:
            track.wait = wait
        return chosen


def urgency(track: BodyTrack, stamp: float) -> float:
    """Time since the last look (s), weighted by how much may have happened since."""
    weight = 1.0 + min(track.motion.speed() / _FAST, 1.0)
    if not track.life.confirmed:
        weight = _NEWBORN_WEIGHT
    elif not track.visible:
        weight = _HIDDEN_WEIGHT
    return weight * (stamp - track.looked_at)
