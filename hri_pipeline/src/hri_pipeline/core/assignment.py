"""One-to-one assignment of tracks to detections."""

from __future__ import annotations

from typing import List, Tuple

import numpy as np
from scipy.optimize import linear_sum_assignment


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
