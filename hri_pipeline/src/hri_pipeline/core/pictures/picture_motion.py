"""A still picture shown as a slowly moving camera would see it.

The picture is scaled once; each image is then cut out of it at a position between pixels by two weighted
sums of shifted views, which costs a quarter of a general warp. Only a zoom needs the warp.
"""

from __future__ import annotations

import math
from typing import Tuple

import cv2
import numpy as np

from hri_pipeline.core.pictures.image_fit import CROP, LETTERBOX, NATIVE, fit_image, paste_centred, scaled

# The vertical swing is slower than the horizontal one, by a ratio that is not a simple fraction: the path
# is a Lissajous figure, smooth everywhere, which takes long to repeat.
VERTICAL_PERIOD_RATIO = 1.37
ZOOM_PERIOD_RATIO = 1.91


class PictureMotion:
    """Pan and zoom over one picture.

    picture: (H, W, 3) BGR uint8. width, height: size of the images, px (ignored for fit `native`).
    fit: as in image_fit; with `letterbox` the whole picture stays in view during the pan, with `crop` and
    `native` the images are always filled.
    pan: swing to each side as a fraction of the image's width and height, 0 to 0.25.
    zoom: largest enlargement minus one, 0 to 1. period: of the horizontal swing, s.
    Raises ValueError for values outside these ranges.
    """

    def __init__(self, picture: np.ndarray, width: int, height: int, fit: str = LETTERBOX,
                 pan: float = 0.03, zoom: float = 0.0, period: float = 12.0) -> None:
        if not 0.0 <= pan <= 0.25:
            raise ValueError("pan is {}, legal range 0..0.25".format(pan))
        if not 0.0 <= zoom <= 1.0:
            raise ValueError("zoom is {}, legal range 0..1".format(zoom))
        if not period > 0.0:
            raise ValueError("period is {} s, it must be above 0".format(period))
        if fit == NATIVE:
            width, height, fit = picture.shape[1], picture.shape[0], CROP
        self._size = (width, height)
        self._swing = (pan * width, pan * height)
        self._zoom = zoom
        self._period = period
        self._canvas = self._scale_once(picture, fit)

    def _scale_once(self, picture: np.ndarray, fit: str) -> np.ndarray:
        """Return the canvas: the images' size, plus the swing and one pixel on each side."""
        width, height = self._size
        canvas_width, canvas_height = (side + 2 * (int(math.ceil(swing)) + 1)
                                       for side, swing in zip(self._size, self._swing))
        if fit != LETTERBOX:
            return fit_image(picture, canvas_width, canvas_height, fit)
        room = (width - 2 * self._swing[0], height - 2 * self._swing[1])
        scale = min(room[0] / picture.shape[1], room[1] / picture.shape[0])
        size = [max(1, int(side * scale)) for side in (picture.shape[1], picture.shape[0])]
        return paste_centred(scaled(picture, size[0], size[1]), canvas_width, canvas_height)

    def window(self, elapsed: float) -> Tuple[float, float, float]:
        """Return left and top edge (px of the canvas) and the enlargement (1 or more) after `elapsed` s."""
        phase = 2.0 * math.pi * elapsed / self._period
        enlargement = 1.0 + self._zoom * 0.5 * (1.0 - math.cos(phase / ZOOM_PERIOD_RATIO))
        swing = (math.sin(phase), math.sin(phase / VERTICAL_PERIOD_RATIO))
        centre = [side / 2.0 + reach * part
                  for side, reach, part in zip(self._canvas.shape[1::-1], self._swing, swing)]
        return (centre[0] - self._size[0] / enlargement / 2.0,
                centre[1] - self._size[1] / enlargement / 2.0, enlargement)

    def view(self, elapsed: float) -> np.ndarray:
        """Return the (height, width, 3) BGR image after `elapsed` s of showing this picture."""
        left, top, enlargement = self.window(elapsed)
        if enlargement == 1.0:
            return self._shifted(left, top)
        matrix = np.array([[1.0 / enlargement, 0.0, left], [0.0, 1.0 / enlargement, top]])
        return cv2.warpAffine(self._canvas, matrix, self._size,
                              flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE)

    def _shifted(self, left: float, top: float) -> np.ndarray:
        """Bilinear interpolation of a window of the canvas whose corner is between four pixels."""
        width, height = self._size
        column, row = int(math.floor(left)), int(math.floor(top))
        right_weight, lower_weight = left - column, top - row
        rows = self._canvas[row:row + height + 1]
        across = cv2.addWeighted(rows[:, column:column + width], 1.0 - right_weight,
                                 rows[:, column + 1:column + 1 + width], right_weight, 0.0)
        return cv2.addWeighted(across[:height], 1.0 - lower_weight, across[1:], lower_weight, 0.0)
