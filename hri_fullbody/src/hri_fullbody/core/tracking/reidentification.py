"""Re-identification: which lost body comes back under a new id, by appearance and place.

For people who turn away, leave the image, or are hidden for a while.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Dict, Iterable, List, NamedTuple, Optional

import numpy as np

from hri_fullbody.core.tracking.appearance import difference
from hri_pipeline.core.assignment import assign

# Hellinger distance of the colours, of the people of six photographs: one human in another light, place and mirrored
# 0.14 (median; 0.30 in the 95th percentile), two people 0.53 (0.28 in the 5th). The place has to fit too.
SAME_APPEARANCE = 0.25
CLEARER_BY = 0.1           # anybody else has to be farther away by so much
NEAR_M = 0.8               # from where a body was lost,
INEXACT = 0.1              # and such a part of its distance, which one camera tells inexactly,
WALK_MPS = 1.0             # and so much farther for each second
# appearance and place are no proof: a face that is recognised goes before them
MOST_LIKELY, LEAST_LIKELY = 0.75, 0.55
MAX_LOST = 50


class TrackAppearance(NamedTuple):
    """One body now: histograms of `appearance.describe`, place (3,) m of its root in the optical frame; None:
    unknown."""

    id: str
    appearance: Optional[np.ndarray]
    place: Optional[np.ndarray]


class Reidentification(NamedTuple):
    """A new body that is an earlier one with some likelihood (0 to 1)."""

    id: str
    earlier: str
    likelihood: float


@dataclass
class _Body:
    appearance: Optional[np.ndarray]
    place: Optional[np.ndarray]
    stamp: float


class BodyReidentifier:
    """Remembers the bodies of the last seconds; each is found again once at most."""

    def __init__(self, memory: float) -> None:
        """Remember a body for `memory` s after it was lost; 0: not at all. ValueError for less."""
        if not memory >= 0.0:
            raise ValueError("memory is {} s, must not be negative".format(memory))
        self._memory = memory
        self._living: Dict[str, _Body] = {}
        self._lost: "OrderedDict[str, _Body]" = OrderedDict()
        self._untold: Dict[str, float] = {}

    def reset(self) -> None:
        """Forget all."""
        self._living.clear()
        self._lost.clear()
        self._untold.clear()

    def update(self, bodies: Iterable[TrackAppearance], stamp: float) -> List[Reidentification]:
        """Take all confirmed bodies at `stamp` (s); returns the new ones that are known."""
        seen = {body.id: body for body in bodies}
        for gone in [key for key in self._living if key not in seen]:
            self._lost[gone] = self._living.pop(gone)
            self._untold.pop(gone, None)
        while self._lost and (len(self._lost) > MAX_LOST or self._age(stamp) > self._memory):
            self._lost.popitem(last=False)
        for body in seen.values():
            if body.id not in self._living:
                self._untold[body.id] = stamp
            known = self._living.get(body.id)
            self._living[body.id] = _Body(
                body.appearance if body.appearance is not None or known is None else known.appearance,
                body.place if body.place is not None or known is None else known.place, stamp)
        return self._find(stamp)

    def _age(self, stamp: float) -> float:
        return stamp - next(iter(self._lost.values())).stamp

    def _find(self, stamp: float) -> List[Reidentification]:
        """Assign new bodies with a known appearance to lost ones, each only when no other fits as well."""
        new = [key for key in self._untold if self._living[key].appearance is not None]
        lost = list(self._lost)
        if not new or not lost:
            return []
        apart = np.array([[self._apart(self._living[a], self._lost[b], self._untold[a]) for b in lost] for a in new])
        found = []
        for row, column in assign(apart, SAME_APPEARANCE):
            rivals = np.concatenate([np.delete(apart[row], column), np.delete(apart[:, column], row)])
            if min(rivals, default=math.inf) >= apart[row, column] + CLEARER_BY:
                share = float(apart[row, column]) / SAME_APPEARANCE
                found.append(Reidentification(new[row], lost[column],
                                              MOST_LIKELY - share * (MOST_LIKELY - LEAST_LIKELY)))
        for item in found:
            del self._lost[item.earlier]
        # Each new body is compared once, as soon as its appearance is known.
        for key in new:
            del self._untold[key]
        return found

    @staticmethod
    def _apart(new: _Body, lost: _Body, began: float) -> float:
        """Appearance distance; infinite where the way is too far, or an appearance is not known."""
        apart = difference(new.appearance, lost.appearance)
        if apart is None or began < lost.stamp:
            return math.inf
        if new.place is not None and lost.place is not None:
            way, far = float(np.linalg.norm(new.place - lost.place)), float(np.linalg.norm(lost.place))
            if way > NEAR_M + INEXACT * far + WALK_MPS * (began - lost.stamp):
                return math.inf
        return apart
