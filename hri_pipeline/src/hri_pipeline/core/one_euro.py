"""The 1 euro filter: little jitter at rest, little delay in motion."""

from __future__ import annotations

import math
from typing import Optional, TypeVar

import numpy as np

_Number = TypeVar("_Number", float, np.ndarray)


class OneEuro:
    """Low-pass filter whose cutoff grows with speed; every element of the array has its own cutoff.

    Casiez, Roussel, Vogel, "1 Euro Filter", CHI 2012. Elements that are not finite restart their own filter.

    Parameters
    ----------
    min_cutoff : float
        Cutoff at rest, Hz.
    beta : float
        How fast the cutoff grows with speed, Hz per (unit/s).
    d_cutoff : float
        Cutoff for the speed itself, Hz.

    Raises
    ------
    ValueError
        For numbers that are not finite, negative, or 0 where they must be positive.
    """

    def __init__(self, min_cutoff: float = 1.5, beta: float = 6.0, d_cutoff: float = 1.0) -> None:
        for name, value, least in (("min_cutoff", min_cutoff, True), ("beta", beta, False),
                                   ("d_cutoff", d_cutoff, True)):
            if not math.isfinite(value) or value < 0.0 or (least and value == 0.0):
                raise ValueError("{} is {}, legal range {}".format(
                    name, value, "more than 0" if least else "0 and more"))
        self._min_cutoff = min_cutoff
        self._beta = beta
        self._d_cutoff = d_cutoff
        self.reset()

    def reset(self) -> None:
        """Forget the past; the next value comes out unchanged."""
        self._value: Optional[np.ndarray] = None
        self._speed: Optional[np.ndarray] = None
        self._stamp = 0.0

    def __call__(self, value: np.ndarray, stamp: float, beta: Optional[float] = None) -> np.ndarray:
        """Filter one value. A stamp that goes back, or another shape, restarts the filter.

        Parameters
        ----------
        value : numpy.ndarray
            Any shape.
        stamp : float
            When it was measured, s.
        beta : float, optional
            Another beta for this value, such as a larger one for what is measured better than most.

        Returns
        -------
        numpy.ndarray
            Of the same shape, float64; the last result for an equal stamp.
        """
        value = np.asarray(value, dtype=np.float64)
        if self._value is None or self._value.shape != value.shape or stamp < self._stamp:
            self._value, self._speed, self._stamp = value.copy(), np.zeros_like(value), float(stamp)
            return value.copy()
        step = float(stamp) - self._stamp
        if step <= 0.0:
            return self._value.copy()
        assert self._speed is not None      # set together with _value
        smooth = _smoothing(self._d_cutoff, step)
        beta = self._beta if beta is None else beta
        known = np.isfinite(self._value) & np.isfinite(value)
        if known.all():
            difference = value - self._value
            speed = self._speed + smooth * (difference / step - self._speed)
            filtered = value - (1.0 - _smoothing(self._min_cutoff + beta * np.abs(speed), step)) * difference
            self._value, self._speed, self._stamp = filtered, speed, float(stamp)
            return filtered.copy()
        difference = np.where(known, value - np.where(known, self._value, 0.0), 0.0)
        speed = np.where(known, self._speed + smooth * (difference / step - self._speed), 0.0)
        cutoff = self._min_cutoff + beta * np.abs(speed)
        filtered = np.where(known, value - (1.0 - _smoothing(cutoff, step)) * difference, value)
        self._value, self._speed, self._stamp = filtered, speed, float(stamp)
        return filtered.copy()


def _smoothing(cutoff: _Number, step: float) -> _Number:
    """Weight of the new value, 0 to 1, of a first-order low-pass with `cutoff` (Hz) and `step` (s)."""
    ratio = 2.0 * math.pi * cutoff * step
    return ratio / (ratio + 1.0)
