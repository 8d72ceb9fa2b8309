"""What the crops of one tracked face tell of its identity, gathered over time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Deque, List, Optional

import numpy as np

MAX_CROPS = 8
"""Templates that are kept of one face: the newest ones."""
SWAP_CROPS = 3
"""So many templates in a row that contradict the earlier ones mean that the tracker has gone on to another face."""


@dataclass(frozen=True)
class Sight:
    """One crop of a face: unit vector (D,), quality 0..1, time s."""

    template: np.ndarray
    quality: float
    stamp: float


class FaceEvidence:
    """Templates of one face, in order. contradiction: distance from their mean above which one is of somebody else."""

    def __init__(self, contradiction: float) -> None:
        self._contradiction = contradiction
        self._sights: Deque[Sight] = deque(maxlen=MAX_CROPS)
        self._strangers: List[Sight] = []
        self._mean: Optional[np.ndarray] = None
        self.swaps = 0

    def __len__(self) -> int:
        return len(self._sights)

    @property
    def duration(self) -> float:
        """Time (s) between the first and the last crop that is kept."""
        return self._sights[-1].stamp - self._sights[0].stamp if self._sights else 0.0

    @property
    def best_quality(self) -> float:
        """Quality of the best crop, 0 without any."""
        return max((sight.quality for sight in self._sights), default=0.0)

    def good(self, quality: float) -> int:
        """How many crops are at least this good."""
        return sum(sight.quality >= quality for sight in self._sights)

    def add(self, sight: Sight) -> bool:
        """Take a crop in; False when it contradicts the others: it then waits until others agree with it."""
        if self._mean is not None and len(self._sights) > 1 and self._distance(sight) > self._contradiction:
            self._strangers.append(sight)
            if len(self._strangers) < SWAP_CROPS:
                return False
            # Somebody else by now: what was known before is of no use.
            self._sights = deque(self._strangers, maxlen=MAX_CROPS)
            self.swaps += 1
        else:
            self._sights.append(sight)
        self._strangers = []
        weighted = np.sum([one.quality * one.template for one in self._sights], axis=0)
        length = float(np.linalg.norm(weighted))
        self._mean = (weighted / length).astype(np.float32) if length > 0.0 else self._sights[-1].template
        return True

    def mean(self) -> Optional[np.ndarray]:
        """Return the unit vector (D,) in the middle of the crops, the better ones counting more; None without any."""
        return self._mean

    def spread(self) -> float:
        """Return the largest distance of a crop from the middle."""
        return max((self._distance(sight) for sight in self._sights), default=0.0)

    def clear(self) -> None:
        """Forget every crop."""
        self._sights.clear()
        self._strangers, self._mean = [], None

    def _distance(self, sight: Sight) -> float:
        assert self._mean is not None
        return float(np.linalg.norm(sight.template - self._mean))
