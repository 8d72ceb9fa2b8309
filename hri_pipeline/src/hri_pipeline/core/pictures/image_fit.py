"""How a picture of any size becomes an image of the size that was asked for."""

from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np

LETTERBOX = "letterbox"
CROP = "crop"
NATIVE = "native"
FIT_CHOICES: Tuple[str, ...] = (LETTERBOX, CROP, NATIVE)

# Bars of a letterbox: dark and flat, so that no detector finds anything in them.
BAR_GREY = 40


def scaled(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return `image` resized to width x height px, with the filter that suits the direction."""
    if image.shape[1] == width and image.shape[0] == height:
        return image
    shrinking = width * height < image.shape[0] * image.shape[1]
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinking else cv2.INTER_LINEAR)


def paste_centred(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return a (height, width, 3) canvas with `image` in its middle.

    What is larger than the canvas is cut off equally on both sides; what is smaller gets bars.
    """
    canvas = np.full((height, width, 3), BAR_GREY, np.uint8)
    rows, columns = min(height, image.shape[0]), min(width, image.shape[1])
    top, left = (height - rows) // 2, (width - columns) // 2
    from_top, from_left = (image.shape[0] - rows) // 2, (image.shape[1] - columns) // 2
    canvas[top:top + rows, left:left + columns] = image[from_top:from_top + rows, from_left:from_left + columns]
    return canvas


def fit_image(image: np.ndarray, width: int, height: int, fit: str) -> np.ndarray:
    """Return `image` (BGR, uint8) brought to width x height px; its proportions are always kept.

    letterbox: all of it is shown, with dark bars on two sides where the proportions differ.
    crop: the output is filled, and what does not fit is cut off equally on two sides.
    native: unchanged; width and height are ignored.
    Raises ValueError for another `fit`.
    """
    if fit not in FIT_CHOICES:
        raise ValueError("fit is {!r}, legal values: {}".format(fit, ", ".join(FIT_CHOICES)))
    if fit == NATIVE or image.shape[:2] == (height, width):
        return image
    choose = min if fit == LETTERBOX else max
    scale = choose(width / image.shape[1], height / image.shape[0])
    size = [max(1, int(round(side * scale))) for side in (image.shape[1], image.shape[0])]
    return paste_centred(scaled(image, size[0], size[1]), width, height)
