"""What everybody looks at over time: one hidden Markov model per person, all of them in one matrix."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Dict, List, Sequence

import numpy as np

_MOST_DT = 1.0
"""Longest step (s) between two updates; after a longer gap nothing more is known than after this."""
_NOBODY = -1


class GazeFilter:
    """Probabilities of the targets of each person: the people, the robot, nobody.

    Targets change at a rate of 1 / dwell_time, to any other one by its prior (L. R. Rabiner, Proc. IEEE 77 (1989) 257, for
    the recursion; the rates are those of a process in continuous time, so that the frame rate does not matter).
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        self._settings = settings
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._ids: List[str] = []
        self._probabilities = np.zeros((0, 2))
        self._current = np.zeros(0, dtype=np.int64)
        self._unseen = np.zeros(0)
        self._weights = self._latest_prior = np.zeros((0, 2))

    def update(self, ids: Sequence[str], weights: np.ndarray, ratios: np.ndarray, times: np.ndarray, closed: np.ndarray,
               dt: float) -> np.ndarray:
        """Take the evidence of `dt` s; return what each person looks at (N,): index of a target, -1 for nobody.

        weights (N, T), ratios (N, T) and times (N,): see gaze_evidence; T = N + 1 with the robot last. closed (N,): the eyes
        are closed, whatever else is known.
        """
        prior = self._prior(weights)
        self._follow(list(ids), prior)
        dt = min(max(dt, 0.0), _MOST_DT)
        stay = math.exp(-dt / self._settings.dwell_time)
        belief = stay * self._probabilities + (1.0 - stay) * prior
        seen = np.isfinite(times) & ~closed
        # Images in quick succession share what they say.
        share = np.where(seen, np.minimum(dt / np.maximum(times, 1e-6), 1.0), 0.0)
        scores = np.zeros(belief.shape)
        np.multiply(ratios, share[:, None], out=scores[:, :-1])
        belief *= np.exp(scores - scores.max(axis=1, keepdims=True))
        self._probabilities = belief / np.maximum(belief.sum(axis=1, keepdims=True), 1e-300)
        self._unseen = np.where(seen, 0.0, self._unseen + dt)
        self._decide(closed | (self._unseen > self._settings.gaze_hold))
        return self._current.copy()

    def probability(self, person: int, target: int) -> float:
        """Return how likely a person (index of the last update) looks at a target."""
        return float(self._probabilities[person, target])

    def _prior(self, weights: np.ndarray) -> np.ndarray:
        """(N, T + 1) how often each target is looked at, nobody last. The same weights come several times."""
        if weights is self._weights:
            return self._latest_prior
        total = weights.sum(axis=1, keepdims=True)
        targets = (1.0 - self._settings.nobody_prior) * weights / np.maximum(total, 1.0)
        self._weights = weights
        self._latest_prior = np.concatenate([targets, 1.0 - targets.sum(axis=1, keepdims=True)], axis=1)
        return self._latest_prior

    def _decide(self, none: np.ndarray) -> None:
        count = len(self._current)
        if not count:
            return
        rows, targets = np.arange(count), self._probabilities[:, :-1]
        best = targets.argmax(axis=1)
        sure = targets[rows, best] >= self._settings.gaze_on
        kept = (self._current != _NOBODY) & (targets[rows, np.maximum(self._current, 0)] >= self._settings.gaze_off)
        self._current = np.where(sure, best, np.where(kept, self._current, _NOBODY))
        self._current[none] = _NOBODY

    def _follow(self, ids: List[str], prior: np.ndarray) -> None:
        """Make place for who has come, and let go of who has gone."""
        if ids == self._ids:
            return
        places: Dict[str, int] = {identity: index for index, identity in enumerate(self._ids)}
        before = np.array([places.get(identity, _NOBODY) for identity in ids] + [len(self._ids), len(self._ids) + 1],
                          dtype=np.int64)
        rows = before[:-2]
        stayed = rows != _NOBODY
        known = np.where(before != _NOBODY)[0]
        belief, current, unseen = prior.copy(), np.full(len(ids), _NOBODY, dtype=np.int64), np.zeros(len(ids))
        if stayed.any():
            old = self._probabilities[rows[stayed]]
            kept = np.zeros((len(old), len(ids) + 2))
            kept[:, known] = old[:, before[known]]
            # What was looked at has gone: the rest as by the prior.
            kept += np.maximum(1.0 - kept.sum(axis=1, keepdims=True), 0.0) * prior[stayed]
            belief[stayed] = kept
            unseen[stayed] = self._unseen[rows[stayed]]
            index = {old_place: place for place, old_place in enumerate(before.tolist()) if old_place != _NOBODY}
            current[stayed] = [index.get(target, _NOBODY) for target in self._current[rows[stayed]].tolist()]
        self._ids, self._probabilities, self._current, self._unseen = ids, belief, current, unseen
