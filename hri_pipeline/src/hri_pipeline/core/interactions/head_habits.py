"""How far everybody turns the head to what they look at, learnt from their own looks.

Some people turn the head all of the way and others a third of it (Fuller, J. Vestibular Res. 2, 1992), and the head of
each is measured beside its true direction by about the same angle all the time: the bearing of a head beside the trunk
is a share of that of the target, and an offset. Both are followed for each person by a Kalman filter, by what the first
pass of the judge says that person looks at. Where the head then ought to be for each target tells targets apart.
"""

from __future__ import annotations

import math
from typing import Dict, List, Sequence

import numpy as np

from hri_pipeline.core.interactions.people import PeopleSnapshot

TIMES = (0.4, 1.0)
"""Time constants (s) of the means of how far heads are from where they ought to be."""
_SHARE, _SHARE_SD, _SHARE_DRIFT = 0.65, 0.2, 0.01
"""Of all people, and by how much the share of one may change in the root of a second."""
_OFFSET_SD, _OFFSET_DRIFT = 0.15, 0.02
"""The same of the offset (rad)."""
_HEAD_SD, _LASTS_S = 0.06, 1.0
"""Error of a head's direction (rad), and how long it stays the same."""
_COMPARED_SD = 0.07
_TRUNK_S, _HEAD_S, _NO_TRUNK_SD = 2.5, 5.0, 0.1
"""Trunks are averaged over this time. Somebody without one is taken to face where the head is on average; by how much
(rad) that is wrong beside an offset."""
_FAR = 9.0
"""Standard deviations of heads of whom nothing is known, and at most."""
_LEAST_CHANCE, _WILD = 0.6, 9.0
"""Looks count from this probability on, unless they are beyond this squared deviation over its variance."""


class HeadHabits:
    """Share and offset of everybody, and how far each head is from where it ought to be for each target."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everybody."""
        self._ids: List[str] = []
        self._people = np.zeros((0, 8))
        self._means = np.full((len(TIMES), 0, 1), np.nan)
        self._aside = self._targets = self._extents = np.zeros((0, 1))
        self._shares, self._heads, self._dt = np.zeros(0), np.zeros(0), 0.0

    def compare(self, people: PeopleSnapshot, heads_aside: np.ndarray, extents: np.ndarray, dt: float) -> None:
        """Take one image: heads_aside (N, T), by how much (rad) each target is left of the head; extents (N, T), the
        variance (rad^2) of where it is seen, to the sides; dt (s) since the last image."""
        self._follow(people.ids)
        trunks, heads = self._people[:, :2], self._people[:, 2]
        _approach(trunks, people.trunks[:, :2] / np.maximum(np.hypot(*people.trunks[:, :2].T), 1e-9)[:, None],
                  dt / _TRUNK_S)
        bearings = np.arctan2(people.faces[:, 1], people.faces[:, 0])
        np.copyto(heads, bearings, where=np.isnan(heads))
        heads += (1.0 - math.exp(-dt / _HEAD_S)) * np.nan_to_num(_wrapped(bearings - heads))
        ahead = np.arctan2(trunks[:, 1], trunks[:, 0])
        alone = np.isnan(ahead)
        ahead = np.where(alone, heads, ahead)
        self._targets, self._heads = _wrapped((bearings - ahead)[:, None] + heads_aside), _wrapped(bearings - ahead)
        share, offset, of_share, both, of_offset = self._people[:, 3:].T
        np.minimum(of_share + dt * _SHARE_DRIFT ** 2, _SHARE_SD ** 2, out=of_share)
        np.minimum(of_offset + dt * _OFFSET_DRIFT ** 2, _OFFSET_SD ** 2, out=of_offset)
        self._shares, self._extents, self._dt = share.copy(), extents, dt
        known = of_offset + alone * _NO_TRUNK_SD ** 2
        variances = (_COMPARED_SD ** 2 + of_share[:, None] * self._targets ** 2 + 2.0 * both[:, None] * self._targets
                     + known[:, None] + share[:, None] ** 2 * extents)
        self._aside = (self._heads[:, None] - share[:, None] * self._targets - offset[:, None]) / np.sqrt(variances)
        for time, means in zip(TIMES, self._means):
            _approach(means, self._aside, dt / time)

    def learn(self, chances: np.ndarray) -> None:
        """Take how likely everybody looks at each target (N, T) in the image compared last."""
        everybody = np.arange(len(chances))
        best = chances.argmax(axis=1)
        chance, targets = chances[everybody, best], self._targets[everybody, best]
        share, offset, of_share, both, of_offset = self._people[:, 3:].T
        counts = (chance > _LEAST_CHANCE) & (targets == targets)
        targets, heads = np.where(counts, targets, 0.0), np.where(counts, self._heads, 0.0)
        # An error that lasts, and a place that is wrong for longer, count as one measurement for as long.
        noise = (_HEAD_SD ** 2 / np.maximum(chance * min(self._dt / _LASTS_S, 1.0), 1e-6)
                 + share ** 2 * np.nan_to_num(self._extents[everybody, best]) / max(self._dt, 1e-3))
        error = heads - share * targets - offset
        to_share, to_offset = of_share * targets + both, both * targets + of_offset
        total = noise + to_share * targets + to_offset
        counts &= error ** 2 < _WILD * total
        for_share, for_offset = to_share / total * counts, to_offset / total * counts
        self._people[:, 3:] = np.stack([
            share + for_share * error, offset + for_offset * error, of_share - for_share * to_share,
            both - for_share * to_offset, of_offset - for_offset * to_offset], axis=1)

    def cues(self, rows: np.ndarray, targets: np.ndarray, possible: np.ndarray) -> np.ndarray:
        """Return of these looks (K, 5): how many standard deviations the head is from where it ought to be, now and on
        the averages of TIMES, the share of the observer, and by how much the head fits the best other target better."""
        aside = np.where(possible & (self._aside == self._aside), np.minimum(np.abs(self._aside), _FAR), _FAR)
        now = np.abs(self._aside[rows, targets])
        best = np.minimum(-rivals(-aside, rows, targets), _FAR)
        return np.stack([now, *np.abs(self._means[:, rows, targets]), self._shares[rows], now - best], axis=1)

    def _follow(self, ids: Sequence[str]) -> None:
        if list(ids) == self._ids:
            return
        places: Dict[str, int] = {identity: row for row, identity in enumerate(self._ids)}
        count = len(self._ids)
        before = np.array([places.get(identity, count) for identity in ids], dtype=np.int64)
        new = [math.nan, math.nan, math.nan, _SHARE, 0.0, _SHARE_SD ** 2, 0.0, _OFFSET_SD ** 2]
        self._people = np.append(self._people, [new], axis=0)[before]
        padded = np.full((len(TIMES), count + 1, count + 2), np.nan)
        padded[:, :-1, :-1] = self._means
        targets = np.append(np.where(before < count, before, count + 1), count)
        self._means = padded[:, before][:, :, targets]
        self._ids = list(ids)


def _wrapped(angles: np.ndarray) -> np.ndarray:
    return angles - 2.0 * math.pi * np.rint(angles / (2.0 * math.pi))


def _approach(means: np.ndarray, now: np.ndarray, part: float) -> None:
    """Move averages towards what is known now, by an exponential law; begin with it."""
    np.copyto(means, now, where=np.isnan(means))
    steps = now - means
    steps[np.isnan(steps)] = 0.0
    means += (1.0 - math.exp(-part)) * steps


def rivals(chances: np.ndarray, rows: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Return the largest of chances (N, T) among the other targets of these looks (K,)."""
    others = chances.copy()
    best, everybody = others.argmax(axis=1), np.arange(len(others))
    highest = others[everybody, best]
    others[everybody, best] = -math.inf
    return np.where(targets == best[rows], others.max(axis=1)[rows], highest[rows])
