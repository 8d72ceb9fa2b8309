"""Depth images: from messages to metres, and the depth at a point."""

from __future__ import annotations

import warnings
from typing import Tuple, Union

import numpy as np

from hri_pipeline.core.images import MAX_SIDE, ImageError, raw_rows

DEPTH_ENCODINGS: Tuple[str, ...] = ("16UC1", "mono16", "32FC1")
DEPTH_RANGE = (0.15, 30.0)
"""Depths (m) outside of this are no measurement: no depth camera has them, and 65535 mm or 0 mean unknown."""
_LEAST_CELLS = 3


def depth_from_raw(
    data: Union[bytes, bytearray, memoryview, np.ndarray],
    width: int,
    height: int,
    step: int,
    encoding: str,
    is_bigendian: bool = False,
) -> np.ndarray:
    """Return (height, width) float32 m, NaN where nothing is known, of the fields of a sensor_msgs/Image.

    16UC1 (also called mono16) is in mm and 32FC1 in m (REP-118). step is the length of a row in bytes, padding
    included. Raises ImageError for another encoding, a size of zero or more than MAX_SIDE px, a step or data too short.
    """
    if encoding not in DEPTH_ENCODINGS:
        raise ImageError("encoding {!r} is not one of a depth image; publish one of: {}".format(
            encoding[:40], ", ".join(DEPTH_ENCODINGS)))
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise ImageError("size of the depth image is {}x{}, legal range 1 to {} px a side".format(
            width, height, MAX_SIDE))
    kind = np.dtype(np.float32 if encoding == "32FC1" else np.uint16).newbyteorder(">" if is_bigendian else "<")
    metres = raw_rows(data, width, height, step, kind.itemsize, "depth in " + encoding).view(kind).astype(np.float32)
    if encoding != "32FC1":
        metres *= np.float32(1e-3)
    with np.errstate(invalid="ignore"):
        metres[~((metres >= DEPTH_RANGE[0]) & (metres <= DEPTH_RANGE[1]))] = np.nan
    return metres


def sample_depth(depth: np.ndarray, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Depth (N,) m at points of the image that the depth is registered to: the median of 3 x 3 cells.

    depth: (h, w) m, NaN or 0 where unknown; may be of another size than the image. pixels: (N, 2) px of the image of
    width x height. NaN outside the image, or where fewer than three of the nine cells are known.
    """
    rows, columns = depth.shape
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    inside = np.all(np.isfinite(pixels), axis=1)
    scaled = np.where(inside[:, None], pixels, -1.0) * np.array([columns / width, rows / height])
    inside &= np.all((scaled >= 0.0) & (scaled < np.array([columns, rows])), axis=1)
    cells = np.floor(np.where(inside[:, None], scaled, 0.0)).astype(np.int64)
    around = np.arange(-1, 2)
    y = np.clip(cells[:, 1, None, None] + around[None, :, None], 0, rows - 1)
    x = np.clip(cells[:, 0, None, None] + around[None, None, :], 0, columns - 1)
    values = np.asarray(depth[y, x], dtype=np.float64).reshape(len(pixels), 9)
    with np.errstate(invalid="ignore"):
        values[~((values >= DEPTH_RANGE[0]) & (values <= DEPTH_RANGE[1]))] = np.nan
    known = np.isfinite(values).sum(axis=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=RuntimeWarning)    # rows that are all NaN give NaN
        median = np.nanmedian(values, axis=1)
    return np.where(inside & (known >= _LEAST_CELLS), median, np.nan)
