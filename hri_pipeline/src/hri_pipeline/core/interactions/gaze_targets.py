"""Who or what every person looks at: another person, the robot, nobody."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Dict, List, Optional, Sequence, Union

import numpy as np

from hri_pipeline.core.interactions.crowd import Crowd
from hri_pipeline.core.interactions.gaze_evidence import Sights, evidence
from hri_pipeline.core.interactions.gaze_filter import GazeFilter
from hri_pipeline.core.interactions.gaze_people import ROBOT, GazeTarget, Onlooker

__all__ = ["ROBOT", "GazeTarget", "GazeTargets", "Onlooker"]

_BACK_S = 1e-6
_REOPEN_S = 0.1
"""Eyes are open again when they have been seen open for so long: one image in which lids are misread opens none."""
_STILL_S = 0.19
_CLOSED_MEMORY_S = 2.0
"""Eyes that were closed when they were seen last are taken for closed for so long."""


class GazeTargets:
    """Follows who looks at whom, one target for each person at a time.

    The angle between a person's direction and each target counts by the uncertainty of both and the target's apparent
    size; a hidden Markov model per person decides over time. Eyes that are closed look at nobody, at once.
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        """settings: the values of INTERACTION_PARAMETERS."""
        self._settings = settings
        self._filter = GazeFilter(settings)
        self._stamp: Optional[float] = None
        self._closed_at: Dict[str, float] = {}
        self._weighed: List[str] = []
        self._weighed_at = 0.0
        self._latest_weights = np.zeros((0, 1))

    def reset(self) -> None:
        """Forget everything, as after a time jump."""
        self._filter.reset()
        self._closed_at.clear()
        self._weighed = []
        self._stamp = None

    def update(self, people: Union[Crowd, Sequence[Onlooker]], robot: Optional[np.ndarray], stamp: float) -> List[GazeTarget]:
        """Take everybody who is tracked at `stamp` (s), each id once; return the gazes of this time.

        robot: (3,) m, None when nobody knows where it is. Time that goes back begins anew.
        """
        if self._stamp is not None and stamp < self._stamp - _BACK_S:
            self.reset()
        # The first image counts in full.
        dt = self._settings.evidence_time if self._stamp is None else stamp - self._stamp
        self._stamp = stamp
        people = Crowd.of(people)
        if not people.ids:
            self._filter.reset()
            return []
        sights = Sights(people, robot, self._settings.max_distance)
        ratios, times = evidence(sights, self._settings)
        ids = people.ids
        closed = self._closed(people, stamp)
        looked_at = self._filter.update(ids, self._weights(sights, ids, stamp), ratios, times, closed, dt)
        names = ids + [ROBOT]
        return [GazeTarget(ids[sender], names[target], self._filter.probability(sender, target))
                for sender, target in enumerate(looked_at.tolist()) if target >= 0]

    def _weights(self, sights: Sights, ids: List[str], stamp: float) -> np.ndarray:
        """(N, T) weights of the targets; people do not move far in _STILL_S, and to see who hides whom is half of the work."""
        if ids != self._weighed or not 0.0 <= stamp - self._weighed_at < _STILL_S:
            self._weighed, self._weighed_at = ids, stamp
            self._latest_weights = sights.weights(self._settings.head_radius)
        return self._latest_weights

    def _closed(self, people: Crowd, stamp: float) -> np.ndarray:
        """(N,) whose eyes are closed. Eyes that are not seen have not opened, for a while."""
        closed = people.closed >= self._settings.closed_threshold      # False where it is not known
        since, self._closed_at = self._closed_at, {people.ids[row]: stamp for row in np.nonzero(closed)[0].tolist()}
        if since:
            hidden = np.isnan(people.closed) & np.isnan(people.gazes[:, 0])
            for row, identity in enumerate(people.ids):
                before = since.get(identity)
                if before is not None and not closed[row] and stamp - before < (_CLOSED_MEMORY_S if hidden[row] else _REOPEN_S):
                    self._closed_at[identity] = before
                    closed[row] = True
        return closed
