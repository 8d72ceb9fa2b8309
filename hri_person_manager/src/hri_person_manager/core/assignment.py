"""The best pairing of two sides of which nobody is twice, and how much worse every pairing without one of its pairs
is."""

from __future__ import annotations

from typing import Dict, Tuple

import numpy as np
from scipy.optimize import linear_sum_assignment

_FORBIDDEN = 2.0 ** 11     # cost of what is never chosen, far above all others
_GRID = 2.0 ** 30          # costs are rounded to a 1/_GRID, so that all sums of them are exact


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
