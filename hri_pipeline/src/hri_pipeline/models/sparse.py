"""Unpacking of sparse TFLite constants.

The layout is a tree of dimensions in "traversal order", each dense or compressed (segments and indices), with
optional inner blocks: the format of Kjolstad et al., "The Tensor Algebra Compiler" (2017), as in the TFLite
schema.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence

import numpy as np


@dataclass
class SparseDimension:
    """One level of the tree: dense with `size` entries, or compressed with `segments` and `indices`."""

    size: int = 0
    segments: Optional[np.ndarray] = None
    indices: Optional[np.ndarray] = None


def densify(
    values: np.ndarray,
    shape: Sequence[int],
    order: Sequence[int],
    blocks: Sequence[int],
    dimensions: Sequence[SparseDimension],
) -> np.ndarray:
    """The dense array of `shape`.

    `values` are the stored entries (flat); `order` names, level by level, the dimension that a level walks
    through (numbers from len(shape) on are the inner dimensions of blocks); `blocks` gives for each inner
    dimension the outer one that it divides.
    """
    # Level by level: `parents` numbers the stored entries so far, `coordinates[k]` their position at level k.
    parents = np.zeros(1, np.int64)
    coordinates: List[np.ndarray] = []
    for dimension in dimensions:
        if dimension.segments is None or dimension.indices is None:
            repeats = np.full(len(parents), dimension.size)
            position = np.tile(np.arange(dimension.size), len(parents))
            children = np.repeat(parents * dimension.size, repeats) + position
        else:
            starts = dimension.segments.astype(np.int64)[parents]
            repeats = dimension.segments.astype(np.int64)[parents + 1] - starts
            offsets = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
            children = np.repeat(starts, repeats) + offsets
            position = dimension.indices.astype(np.int64)[children]
        coordinates = [np.repeat(c, repeats) for c in coordinates] + [position]
        parents = children
    rank = len(shape)
    by_dimension = {dimension: coordinates[level] for level, dimension in enumerate(order)}
    index = [by_dimension[axis] for axis in range(rank)]
    for number, axis in enumerate(blocks):
        block_size = dimensions[list(order).index(rank + number)].size
        index[axis] = index[axis] * block_size + by_dimension[rank + number]
    dense = np.zeros(tuple(shape), values.dtype)
    dense[tuple(index)] = values[parents]
    return dense
