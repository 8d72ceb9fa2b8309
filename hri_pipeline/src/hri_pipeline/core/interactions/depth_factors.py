"""How wrong the distance of each person from the camera is, learnt from where everybody looks.

One camera tells the distance of a face by its size, and heads differ: a person is seen too near or too far by about the
same factor all the time. Where the eyes of several people go, their lines of sight cross at whom they look at: the
factors that make them cross there are the likely ones (a calibration by the scene itself). Looks along the camera's
ray tell nothing.
"""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, Dict, List, Sequence

import numpy as np

from hri_pipeline.core.interactions.people import DEPTH_PART, PeopleSnapshot

if TYPE_CHECKING:
    from hri_pipeline.core.interactions.gaze import SightLines

_LEAST_BELIEF = 0.5
"""A look counts from this probability of its target on: most looks at others would only pull the places about."""
_AIM_SD = 0.05
"""Standard deviation (rad) of where on a head, and how steadily, people look."""
_WILD = 2.0
"""Squared deviations, over their variance, at which a look counts half: its target may be another one."""
_LEAST_LEVEL = 0.5
_MEMORY_S = 60.0
"""Time constant (s) of forgetting: the error goes with the pose of the head, too."""


class DepthFactors:
    """Normal distribution of the logarithms of the factors by which everybody is seen too far.

    Kept as information (inverse covariance) beside the prior, independent with DEPTH_PART, so that people who come and
    go add and remove rows. Each look that is believed is one linear measurement of the factors of two people, as an
    extended Kalman filter takes it; beliefs and factors are found in turns, image by image (online expectation
    maximization).
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._ids: List[str] = []
        self._information, self._vector = np.zeros((0, 0)), np.zeros(0)
        self._logs = np.zeros(0)

    def corrected(self, people: PeopleSnapshot) -> PeopleSnapshot:
        """Return the people where they most likely are; those without a ray from the camera stay where they are."""
        self._follow(people.ids)
        if not self._vector.any():
            return people
        covariance = np.linalg.inv(self._information + np.eye(len(self._ids)) / DEPTH_PART ** 2)
        self._logs = covariance @ self._vector
        moved = copy.copy(people)
        scales = np.exp(-self._logs)[:, None]
        moved.heads, moved.rays = people.heads + (scales - 1.0) * people.rays, scales * people.rays
        moved.depths = people.depths * (np.sqrt(np.diag(covariance)) / DEPTH_PART)[:, None]
        return moved

    def learn(self, people: PeopleSnapshot, lines: SightLines, beliefs: np.ndarray, shares: np.ndarray, dt: float
              ) -> None:
        """Take the looks of one image.

        Parameters
        ----------
        people: PeopleSnapshot
            As `corrected` returned them.
        lines: SightLines
            Of these people.
        beliefs: (N, N) array
            How likely each one looks at each other one.
        shares: (N,) array
            Which share of a measurement the eyes of each one are; 0 of closed ones.
        dt: float
            Time (s) since the last image.
        """
        count, rays = len(people), np.nan_to_num(people.rays)
        if count < 2 or not rays.any():
            return
        kept = math.exp(-max(dt, 0.0) / _MEMORY_S)
        self._information *= kept
        self._vector *= kept
        units, distances = lines.units[:, :count], lines.distances[:, :count]
        sideways = np.stack([-units[..., 1], units[..., 0]], axis=2)
        level = np.sqrt((sideways * sideways).sum(axis=2))
        sideways /= (np.maximum(level, _LEAST_LEVEL) * distances)[..., None]
        # How far the bearing of a target turns (rad) with the logarithm of the observer's and of the target's factor.
        own = (sideways @ rays[:, :2, None])[..., 0]
        others = (sideways * rays[:, :2]).sum(axis=2)
        turns = np.arctan2(people.gazes[:, 1], people.gazes[:, 0])[:, None] - np.arctan2(units[..., 1], units[..., 0])
        turns -= 2.0 * math.pi * np.rint(turns / (2.0 * math.pi))
        variances = np.broadcast_to(people.deviations[:, 2:3] ** 2 + _AIM_SD ** 2, turns.shape)
        wild = turns * turns / (variances + DEPTH_PART ** 2 * (own * own + others * others))
        counts = (beliefs >= _LEAST_BELIEF) & lines.possible[:, :count] & (level > _LEAST_LEVEL) & (turns == turns)
        weights = np.where(counts, beliefs * shares[:, None] / (variances * (1.0 + wild / _WILD)), 0.0)
        self._add(weights, own, others, np.where(counts, turns, 0.0))

    def _add(self, weights: np.ndarray, own: np.ndarray, others: np.ndarray, turns: np.ndarray) -> None:
        """Add measurements, each of own log times `own` less other's log times `others`; all (N, N)."""
        measured = weights * (turns + own * self._logs[:, None] - others * self._logs)
        both = weights * own * others
        self._information += np.diag((weights * own * own).sum(axis=1) + (weights * others * others).sum(axis=0))
        self._information -= both + both.T
        self._vector += (measured * own).sum(axis=1) - (measured * others).sum(axis=0)

    def _follow(self, ids: Sequence[str]) -> None:
        """Let the rows be those of `ids`; somebody new has the prior alone."""
        if list(ids) == self._ids:
            return
        rows: Dict[str, int] = {identity: row for row, identity in enumerate(self._ids)}
        stayed = [row for row, identity in enumerate(ids) if identity in rows]
        before = [rows[ids[row]] for row in stayed]
        gone = sorted(set(rows.values()) - set(before))
        # The distribution of those who stay, whatever the factors of those who leave are.
        leaving = self._information[np.ix_(gone, gone)] + np.eye(len(gone)) / DEPTH_PART ** 2
        shared = np.linalg.solve(leaving, self._information[np.ix_(gone, before)]).T
        information, vector, logs = np.zeros((len(ids), len(ids))), np.zeros(len(ids)), np.zeros(len(ids))
        information[np.ix_(stayed, stayed)] = (self._information[np.ix_(before, before)]
                                               - shared @ self._information[np.ix_(gone, before)])
        vector[stayed] = self._vector[before] - shared @ self._vector[gone]
        logs[stayed] = self._logs[before]
        self._ids, self._information, self._vector, self._logs = list(ids), information, vector, logs
