"""Whether images stand upright: the networks find people only where they do, and put others at wrong places."""

from __future__ import annotations

import math
from typing import Callable, Optional, Tuple

import numpy as np

# A person who is so clear in one orientation of the image is far less so in all others: of five photographs .50 to .76
# upright, .43 at most turned.
_CLEAR = 0.5
# Faces are clear turned, too, but less: of 40 photographs 35 had .82 and more upright, .02 and more above all others.
_CLEAR_FACE, _BETTER = 0.82, 0.02
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

    def images_turn(self) -> None:
        """Take note that images are turned otherwise from now on: of turned people nothing is known any more, and
        upright ones stay so, as it is gravity that turns the images."""
        if self.turn != 0:
            self.reset()

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


class FaceOrientation:
    """The same by faces alone: all four orientations are compared at times, until the upright one was best twice.

    turn: as of ImageOrientation.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all images."""
        self.turn: Optional[int] = None
        self._next = -math.inf
        self._last: Optional[int] = None

    def images_turn(self) -> None:
        """Take note that images are turned otherwise from now on: of turned people nothing is known any more, and
        upright ones stay so, as it is gravity that turns the images."""
        if self.turn != 0:
            self.reset()

    def update(self, image: np.ndarray, stamp: float, detect: Detect) -> None:
        """Take an image of `stamp` (s); every 10 s `detect` is asked about its four orientations."""
        if self.turn == 0 or stamp < self._next:
            return
        self._next = stamp + _CHECK_S
        best = [float(np.max(detect(np.ascontiguousarray(np.rot90(image, turn)))[1], initial=0.0)) for turn in range(4)]
        turn = int(np.argmax(best))
        _, second, first = sorted(best)[-3:]
        if first < _CLEAR_FACE or first - second < _BETTER:
            return
        if turn == self._last:
            self.turn = turn
        self._last = turn


_WORDS = ("upright", "a quarter turn anticlockwise", "half a turn", "a quarter turn clockwise")


def turned_problem(seen: Optional[int], transform: Optional[int], rotation: int = 0, by_gravity: bool = False) -> str:
    """Return what is wrong with the camera's mounting, and the mend; empty when all is well or not known.

    seen, transform: quarter turns anticlockwise by which images stand upright that were turned by `rotation` (degrees
    clockwise), as the people in them and the transform to ~up_frame tell; None: not known. by_gravity: the rotation is
    that of the transform.
    """
    transform = None if by_gravity else transform
    if seen == 0 and transform:
        return ("people stand upright in the images, but the transform to ~up_frame says that these are turned: they "
                "would be upright after {}. Mend: correct the transform of the camera".format(_WORDS[transform]))
    if not (seen or transform):
        return ""
    turned = ", which are turned by {} degrees clockwise already".format(rotation) if rotation else ""
    return ("the images come turned: {} after {}{}, so that bodies and faces are missed or at wrong places. Mend: {}set"
            " image_rotation:={}{}".format(
                "people are clear in them only" if seen else "by the transform to ~up_frame they would be upright",
                _WORDS[seen or transform or 0], turned,
                "correct the transform of the camera to ~up_frame, or " if by_gravity else "",
                (rotation - 90 * (seen or transform or 0)) % 360,
                "" if by_gravity else ", or up_frame with image_rotation:=auto"))
