"""Tracks: their birth and death, counted in seconds so that the frame rate does not matter, and their one-to-one
assignment to detections: the cheapest one, and how much worse every assignment without one of its pairs is."""

from __future__ import annotations

import math
from typing import Dict, List, Tuple

import numpy as np
from scipy.optimize import linear_sum_assignment

COLOUR_BINS = np.array([[0.0, 30.0, 60.0, 90.0, 130.0, 180.0, 255.0],
                        *2 * [[-40.0, -20.0, -8.0, 0.0, 8.0, 20.0, 40.0]]])
"""Middles of the bins of lightness and of both axes of colour (CIE 1976 L*a*b*, 8 bits) of the histograms of clothes.
Narrow where clothes are: most are dark and of little colour."""
_FORBIDDEN = 2.0 ** 11     # cost of what is never chosen, far above all others
_GRID = 2.0 ** 30          # costs are rounded to a 1/_GRID, so that all sums of them are exact


class TrackLife:
    """Life of one track: a candidate until it is confirmed, and dead when it has not been detected for long.

    Parameters
    ----------
    stamp : float
        First detection, s, by the clock of the images.
    birth_delay : float
        The track is confirmed by a detection at least so long after the first one, s; at once for 0.
    death_time : float
        The track is dead after so long without a detection, s.

    Raises
    ------
    ValueError
        For a negative birth_delay, and a death_time that is not positive.
    """

    def __init__(self, stamp: float, birth_delay: float, death_time: float) -> None:
        self.first_seen = float(stamp)
        self.last_seen = float(stamp)
        self.confirmed = birth_delay == 0.0
        self.limit(birth_delay, death_time)

    def limit(self, birth_delay: float, death_time: float) -> None:
        """Set birth_delay and death_time (s) from now on. Raises ValueError for illegal ones."""
        if not (math.isfinite(birth_delay) and birth_delay >= 0.0):
            raise ValueError("birth_delay is {} s, legal range 0 and more".format(birth_delay))
        if not (math.isfinite(death_time) and death_time > 0.0):
            raise ValueError("death_time is {} s, legal range more than 0".format(death_time))
        self._birth_delay = float(birth_delay)
        self._death_time = float(death_time)

    def seen(self, stamp: float) -> None:
        """Note a detection at `stamp`; an older stamp than the last changes nothing."""
        self.last_seen = max(self.last_seen, float(stamp))
        # A stamp is a multiple of a nanosecond: allow that much, or 0.1 + 0.2 is not 0.3.
        if self.last_seen - self.first_seen >= self._birth_delay - 1e-9:
            self.confirmed = True

    def dead(self, stamp: float) -> bool:
        """Return whether there was no detection for longer than death_time at `stamp`."""
        return stamp - self.last_seen > self._death_time


def assign(cost: np.ndarray, max_cost: float) -> List[Tuple[int, int]]:
    """Pair rows with columns so that as many legal pairs as possible have the least total cost.

    cost: (T, D). A pair above `max_cost`, or whose cost is not finite, is illegal and never returned.
    Returns (row, column) pairs in ascending order of row.
    Hungarian method, H. W. Kuhn, Naval Research Logistics Quarterly 2 (1955), in scipy's variant.
    """
    cost = np.asarray(cost, dtype=np.float64)
    if cost.ndim != 2:
        raise ValueError("a cost matrix has two dimensions, not {}".format(cost.ndim))
    if not np.isfinite(max_cost):
        raise ValueError("max_cost must be finite, not {}".format(max_cost))
    if cost.size == 0:
        return []
    legal = np.isfinite(cost) & (np.where(np.isfinite(cost), cost, np.inf) <= max_cost)
    if not legal.any():
        return []
    # An illegal pair costs more than all legal ones together, so it never displaces a legal pair.
    spread = float(cost[legal].max() - cost[legal].min())
    illegal = cost[legal].max() + (spread + 1.0) * min(cost.shape)
    rows, columns = linear_sum_assignment(np.where(legal, cost, illegal))
    return [(int(row), int(column)) for row, column in zip(rows, columns) if legal[row, column]]


def mean_colours(appearance: np.ndarray) -> np.ndarray:
    """Return the mean colours (P, 3), L*a*b* of 8 bits, of the histograms (P, 21) of the parts of one human; NaN where
    a part is not shown."""
    parts = appearance.reshape(len(appearance), 3, -1)
    with np.errstate(invalid="ignore"):
        colours: np.ndarray = (parts * COLOUR_BINS).sum(axis=2) / parts.sum(axis=2)
    return colours


def appearance_distances(one: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the mean Hellinger distances (...), 0 to 1, of the histograms (P, B) of the parts of one human from those
    of others (..., P, B), over the parts that both show; NaN where there are none.

    Rows sum to 1, or to 0 for a part that is not shown. E. Hellinger, "Neue Begruendung der Theorie quadratischer
    Formen", 1909.
    """
    shown = (one.sum(axis=-1) > 0.0) & (others.sum(axis=-1) > 0.0)
    alike = np.clip(np.sqrt(one * others).sum(axis=-1), 0.0, 1.0)
    parts = shown.sum(axis=-1)
    return np.sqrt(np.where(parts > 0, 1.0 - (alike * shown).sum(axis=-1) / np.maximum(parts, 1), np.nan))


def best_pairs(costs: np.ndarray, unpaired: float) -> Dict[Tuple[int, int], float]:
    """Pair up rows and columns at the least sum of costs (H. Kuhn, Naval Research Logistics Quarterly 2, 1955).

    Parameters
    ----------
    costs : numpy.ndarray, shape (R, C)
        Of each pair; infinite where it is out of the question.
    unpaired : float
        What a row and a column cost that both stay alone, half of it each: costs from there on are never chosen.

    Returns
    -------
    dict
        (row, column) of each pair -> by how much the best pairing without it costs more. To give a pair up is to shift
        along the shortest cycle of exchanges through it; all of these are found at once (R. Floyd, Communications of
        the ACM 5, 1962).
    """
    rows, columns = (np.flatnonzero((costs < unpaired).any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return {}
    table = _with_nobody(costs[np.ix_(rows, columns)], unpaired)
    _, taken = linear_sum_assignment(table)
    exchanges = table[:, taken]
    exchanges -= exchanges.diagonal()[:, None].copy()       # row i takes the column of row j
    paths = exchanges.copy()
    for middle in range(len(paths)):
        np.minimum(paths, paths[:, middle, None] + paths[middle], out=paths)
    np.fill_diagonal(exchanges, np.inf)
    margins = (exchanges + paths.T).min(axis=1)
    return {(int(rows[row]), int(columns[taken[row]])): float(margins[row])
            for row in range(rows.size) if taken[row] < columns.size}


def _with_nobody(costs: np.ndarray, unpaired: float) -> np.ndarray:
    """Costs (R + C, R + C) with a column for each row that stays alone, and a row for each column."""
    rows, columns = costs.shape
    table = np.zeros((rows + columns, rows + columns))
    table[:rows, :columns] = np.where(costs < unpaired, np.round(costs * _GRID) / _GRID, _FORBIDDEN)
    table[:rows, columns:] = np.where(np.eye(rows, dtype=bool), unpaired / 2.0, _FORBIDDEN)
    table[rows:, :columns] = np.where(np.eye(columns, dtype=bool), unpaired / 2.0, _FORBIDDEN)
    return table
