"""Templates of people who do not exist, for tests and timing."""

from __future__ import annotations

import numpy as np

SIZE = 128
"""Numbers in a template."""


def template(person: int, distance: float = 0.0, view: int = 0) -> np.ndarray:
    """Return a unit vector (SIZE,) float32: a person's own, or one at a distance (0 to 2) from it, in the direction
    that `view` picks. Those of two persons are about sqrt(2) apart.
    """
    base = np.random.RandomState(person).randn(SIZE)
    base /= np.linalg.norm(base)
    across = np.random.RandomState(1000 * person + view + 7).randn(SIZE)
    across -= (across @ base) * base
    across /= np.linalg.norm(across)
    angle = 2.0 * np.arcsin(distance / 2.0)
    return (np.cos(angle) * base + np.sin(angle) * across).astype(np.float32)
