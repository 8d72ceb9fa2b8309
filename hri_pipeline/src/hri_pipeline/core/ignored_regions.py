"""Parts of the image in which nobody begins: posters, screens, mirrors."""

from __future__ import annotations

import math
from typing import Sequence, Tuple

import numpy as np

from hri_pipeline.core.parameters import ParameterError

_ROUNDING = 1e-6


class IgnoredRegions:
    """The parameter `ignored_regions`.

    rows: a text "x y width height" for each region, as shares of the image's width and height from its upper left
    corner. Raises ParameterError that says what to give. boxes: left, top, right, bottom of each, as such shares.
    """

    def __init__(self, rows: Sequence[str] = ()) -> None:
        self.boxes = [_region(row) for row in rows]

    def turn(self, quarters: int) -> None:
        """Turn the regions with the images, by so many quarter turns clockwise."""
        for _ in range(quarters % 4):
            self.boxes = [(1.0 - bottom, left, 1.0 - top, right) for left, top, right, bottom in self.boxes]

    def contain(self, box: np.ndarray, size: Tuple[int, int]) -> bool:
        """Tell whether the middle of a box (4,) px is in a region of an image of `size` (width, height), px."""
        x, y = (float(box[axis] + box[axis + 2]) / 2.0 / size[axis] for axis in (0, 1))
        return any(left <= x <= right and top <= y <= bottom for left, top, right, bottom in self.boxes)


def _region(row: str) -> Tuple[float, float, float, float]:
    """Left, top, right and bottom of a region, shares of the image."""
    try:
        x, y, width, height = (float(word) for word in row.split())
    except ValueError:
        x = y = width = height = math.nan
    if not (0.0 <= x and 0.0 <= y and 0.0 < width <= 1.0 - x + _ROUNDING and 0.0 < height <= 1.0 - y + _ROUNDING):
        raise ParameterError("ignored_regions has {!r}; give a list with one text \"x y width height\" per region, "
                             "each 0 to 1 of the image's width or height".format(row))
    return x, y, x + width, y + height
