"""People as the interactions see them at one time, and who looks at whom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional

import numpy as np

ROBOT = ""
"""The robot among the ids of persons, as in the messages."""


@dataclass(frozen=True)
class Onlooker:
    """One tracked person at one time. Places and directions are those of the reference frame (z up, m).

    What is not known is None. Directions are unit vectors, `_sd` is their standard deviation (rad) on each axis.
    """

    id: str
    head: Optional[np.ndarray] = None
    """(3,) m: where the person is, at the height of the eyes as far as it is known; None: place unknown."""
    head_sd: float = 0.1
    """Standard deviation (m) of `head` on each axis."""
    head_direction: Optional[np.ndarray] = None
    """(3,): where the face points."""
    head_direction_sd: float = 0.09
    gaze_direction: Optional[np.ndarray] = None
    """(3,): where the eyes look."""
    gaze_direction_sd: float = 0.14
    eyes_closed: Optional[float] = None
    """0 open to 1 closed."""
    body_direction: Optional[np.ndarray] = None
    """(3,), about horizontal: where the trunk points."""
    body_direction_sd: float = 0.35


@dataclass(frozen=True)
class GazeTarget:
    """One looks at another: ids of persons, `ROBOT` for the robot. confidence: probability, 0 to 1."""

    sender: str
    receiver: str
    confidence: float
