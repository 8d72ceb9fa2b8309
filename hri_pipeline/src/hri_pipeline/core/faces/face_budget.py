"""Which faces are looked at in which image when there are too many for all of them."""

from __future__ import annotations

import math
from typing import Dict, Iterable, List, Optional, Sequence

_COST_MEMORY = 0.9
"""Part of the estimated cost of a look that is kept when a new one is measured."""
_NEARLY_DUE = 0.45
"""Credit from which a face is looked at early, when another one is due."""
_MOST_OWED = 2.0
"""Looks that every face may have to its credit at most: after a busy time there is no long catching up."""
_SLOW_STEP = 0.2
"""Time between two images (s) from which the budget grows with it: a face left out for seconds would count as gone."""
_USUAL_STEP = 1.0 / 12.0
"""Time between two images (s) from which a share grows with it: fewer images leave more time for each."""
_LONGEST_STEP = 1.0
"""Time between two images (s) above which no more credit is given."""


class TimeShare:
    """Lets work that costs more than one image can spare be done now and then: `share` s per image at most, over time.

    saved: s that may be saved up in images that need nothing, and are there at the beginning: who has just come is then
    known at once, and only a crowd has to wait.
    """

    def __init__(self, share: float, saved: float = 0.0) -> None:
        """Raises ValueError when the share is not positive, or saved is negative."""
        if not saved >= 0.0:
            raise ValueError("{} s to be saved up; it must be 0 or more".format(saved))
        self._saved, self._owed = saved, -saved
        self.change(share)

    def change(self, share: float) -> None:
        """Set the time (s) per image. Raises ValueError when it is not positive."""
        if not share > 0.0:
            raise ValueError("a share of {} s per image; it must be above 0".format(share))
        self._share = share

    def next_image(self, step: float = 0.0) -> bool:
        """Tell, once for each image, `step` s after the last, whether all that was spent is paid."""
        self._owed = max(-self._saved, self._owed - self._share * max(1.0, step / _USUAL_STEP))
        return self._owed < 1e-9

    @property
    def ample(self) -> bool:
        """Whether more than half of what may be saved up is there."""
        return self._owed < -0.5 * self._saved

    def spent(self, seconds: float) -> None:
        """Take what the work has cost."""
        if math.isfinite(seconds):
            self._owed += max(0.0, seconds)


class FaceBudget:
    """Shares looks out among faces: each gets `rate` per second, as far as `budget` seconds per image allow.

    A face earns credit with time and pays one for a look; those with most credit are served first, so that under a
    tight budget all take turns. What a look costs is measured (`spent`), so the same budget means more looks on a
    faster machine. At least one face is looked at in every image that has a due one.
    """

    def __init__(self, rate: float, budget: float, cost: float = 0.005) -> None:
        """rate, budget: see share; cost: first guess of a look, s.

        Raises ValueError for a negative rate, or a budget or cost that is not positive.
        """
        self._cost = cost
        self.share(rate, budget)
        self._credit: Dict[str, float] = {}
        self._left = 0.0
        self._stamp: Optional[float] = None

    def share(self, rate: float, budget: float) -> None:
        """rate: Hz for each face, 0 for every image; budget: s per image. Raises ValueError as the constructor does."""
        if not (math.isfinite(rate) and rate >= 0.0 and budget > 0.0 and self._cost > 0.0):
            raise ValueError("rate {} Hz, budget {} s, cost {} s of looks: rate from 0, the others above 0".format(
                rate, budget, self._cost))
        self._rate = rate
        self._budget = budget

    @property
    def cost(self) -> float:
        """What one look costs, s."""
        return self._cost

    @property
    def limit(self) -> int:
        """How many looks the budget allows per image."""
        return max(1, int(self._budget / self._cost + 1e-9))

    def choose(self, faces: Sequence[str], stamp: float, urgent: Iterable[str] = ()) -> List[str]:
        """Return the faces to look at in the image of `stamp` (s), in the order of `faces`.

        faces: all that could be looked at; a new one is due at once. urgent: those that come first, such as faces that
        pass each other.
        """
        step = 0.0 if self._stamp is None else min(max(stamp - self._stamp, 0.0), _LONGEST_STEP)
        self._stamp = stamp
        gain = 1.0 if self._rate == 0.0 else min(1.0, self._rate * step)
        # Rounding must not cost a face its turn: at 15 Hz from images at 15 Hz every image is due.
        self._earn(faces, gain)
        due = [face for face in faces if self._credit[face] > 1.0 - 1e-3]
        if due:
            # A batch costs the network half of what single looks do: faces that are nearly due come along.
            due = [face for face in faces if self._credit[face] > _NEARLY_DUE]
        first = set(urgent)
        due.sort(key=lambda face: (face not in first, -self._credit[face]))
        chosen = set(due[:self._looks(len(due), step)])
        for face in chosen:
            self._credit[face] -= 1.0
        return [face for face in faces if face in chosen]

    def _looks(self, due: int, step: float) -> int:
        """How many of the due faces this image can pay for, `step` s after the last; what is left goes to the next one."""
        time = self._budget * max(1.0, step / _SLOW_STEP) + self._left
        looks = max(1, int(time / self._cost + 1e-9))
        self._left = max(0.0, time - looks * self._cost) if due > looks else 0.0
        return looks

    def _earn(self, faces: Sequence[str], gain: float) -> None:
        """Give credit to all; a new face has a little more than the one that waits longest."""
        most = max([1.0] + [self._credit[face] + gain for face in faces if face in self._credit])
        self._credit = {face: self._credit[face] + gain if face in self._credit else most + 1e-6 for face in faces}
        # Under a tight budget the debts to all grow: what is owed to everybody is dropped, the order stays.
        surplus = min(self._credit.values(), default=1.0) - _MOST_OWED
        if surplus > 0.0:
            self._credit = {face: credit - surplus for face, credit in self._credit.items()}

    def spent(self, seconds: float, looks: int) -> None:
        """Take what `looks` looks have cost together."""
        if looks > 0 and math.isfinite(seconds) and seconds > 0.0:
            self._cost = _COST_MEMORY * self._cost + (1.0 - _COST_MEMORY) * seconds / looks

    def reset(self) -> None:
        """Forget all faces; what a look costs is kept."""
        self._credit = {}
        self._left = 0.0
        self._stamp = None
