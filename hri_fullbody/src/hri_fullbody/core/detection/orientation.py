"""Whether images stand upright: the networks find people only where they do, and put others at wrong places."""

from __future__ import annotations

import math
from typing import Callable, Optional, Tuple

import numpy as np

# A person who is so clear in one orientation of the image is far less so in all others: of five photographs .50 to .76
# upright, .43 at most turned.
_CLEAR = 0.5
_CHECK_S = 10.0     # one more run of the detector, until somebody was seen upright
_NEEDED = 2
_TURNS = (2, 1, 3)
_LEAST_TILT = 0.5   # sine of the angle between the view and the vertical, below which no turn of the image is told

Detect = Callable[[np.ndarray], Tuple[np.ndarray, np.ndarray]]


def quarter_turns(up: np.ndarray) -> Optional[int]:
    """Return by how many quarter turns anticlockwise an image stands upright (0 to 3); None where the camera looks
    steeply up or down. up: (3,) unit vector against gravity in the optical frame."""
    if math.hypot(up[0], up[1]) < _LEAST_TILT:
        return None
    return int(round(math.atan2(up[0], -up[1]) / (0.5 * math.pi))) % 4


class ImageOrientation:
    """Finds out whether the images of a camera come turned, as of one that is mounted upside down.

    turn: quarter turns anticlockwise by which people stand upright in them; None while nobody was seen clearly.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all images."""
        self.turn: Optional[int] = None
        self._next: Optional[float] = None
        self._asked = self._seen = 0

    def update(self, image: np.ndarray, scores: np.ndarray, stamp: float, detect: Detect) -> None:
        """Take an image of `stamp` (s) in which `detect` gave people with `scores`; at times `detect` is asked about
        the image as it stands after a turn. Once people were seen upright, the camera is."""
        if self.turn == 0:
            return
        if len(scores) and float(np.max(scores)) >= _CLEAR:
            self.turn = 0
            return
        if self._next is None or stamp < self._next:
            self._next = stamp + _CHECK_S if self._next is None else self._next
            return
        self._next = stamp + _CHECK_S
        turn = _TURNS[self._asked % len(_TURNS)]
        found = detect(np.ascontiguousarray(np.rot90(image, turn)))[1]
        if not len(found) or float(np.max(found)) < _CLEAR:
            self._asked, self._seen = self._asked + 1, 0
            return
        self._seen += 1
        if self._seen >= _NEEDED:
            self.turn = turn
