"""How bodies move: constant velocity, in the image and in metres."""

from __future__ import annotations

import math
from typing import Optional, Tuple

import numpy as np

# Standard deviations of the model, measured in body sizes (px) where the image is meant.
_IMAGE_ACCELERATION = 1.5      # 1/s2
_IMAGE_SPEED = 0.8             # 1/s, of a body seen for the first time
_IMAGE_NOISE = 0.02
_SPACE_ACCELERATION = 2.0      # m/s2: a person who starts to walk
_SPACE_SPEED = 1.0             # m/s
_SPACE_NOISE = 0.03            # m, across the view
_DEPTH_NOISE = 0.06            # of the depth: statures and the network's error
_LARGEST_GAP = 2.0             # s: after a longer one the velocity says nothing any more


class ConstantVelocity:
    """Kalman filter of points that move with a constant velocity but for random accelerations, each axis alone.

    value: (D,). sd: (D,) or a number, its standard deviation. speed_sd: that of the unknown velocity at the start.
    R. E. Kalman, "A New Approach to Linear Filtering and Prediction Problems", 1960.
    """

    def __init__(self, value: np.ndarray, sd: np.ndarray, speed_sd: float, stamp: float) -> None:
        self.value = np.array(value, dtype=np.float64)
        self.velocity = np.zeros_like(self.value)
        self.stamp = float(stamp)
        self._pp = np.broadcast_to(np.square(sd), self.value.shape).astype(np.float64)
        self._pv = np.zeros_like(self.value)
        self._vv = np.full_like(self.value, speed_sd ** 2)

    def predict(self, stamp: float, acceleration: float) -> Tuple[np.ndarray, np.ndarray]:
        """Return value (D,) and standard deviation (D,) at `stamp` (s); nothing changes.

        acceleration: standard deviation of the random acceleration, unit/s2.
        """
        step = min(max(0.0, stamp - self.stamp), _LARGEST_GAP)
        pp, _, _ = self._grown(step, acceleration)
        return self.value + self.velocity * step, np.sqrt(pp)

    def update(self, value: np.ndarray, sd: np.ndarray, stamp: float, acceleration: float) -> None:
        """Take a measurement of `stamp` (s); one that is not newer than the last changes nothing."""
        step = min(stamp - self.stamp, _LARGEST_GAP)
        if step <= 0.0:
            return
        pp, pv, vv = self._grown(step, acceleration)
        error = np.asarray(value, dtype=np.float64) - (self.value + self.velocity * step)
        gain_p, gain_v = pp / (pp + np.square(sd)), pv / (pp + np.square(sd))
        self.value = self.value + self.velocity * step + gain_p * error
        self.velocity = self.velocity + gain_v * error
        self._pp, self._pv, self._vv = (1.0 - gain_p) * pp, (1.0 - gain_p) * pv, vv - gain_v * pv
        self.stamp = float(stamp)

    def _grown(self, step: float, acceleration: float) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Variance of value, covariance with the velocity, variance of the velocity after `step` s."""
        noise = acceleration ** 2
        pp = self._pp + 2.0 * step * self._pv + step ** 2 * self._vv + noise * step ** 4 / 4.0
        pv = self._pv + step * self._vv + noise * step ** 3 / 2.0
        return pp, pv, self._vv + noise * step ** 2


class BodyMotion:
    """Where one body is and will be: the middle of its trunk (px) and its root (m, optical frame) where it is known."""

    def __init__(self, centre: np.ndarray, size: float, root: Optional[np.ndarray], stamp: float) -> None:
        """centre: (2,) px. size: px, that of the body in the image. root: (3,) m or None. stamp: s."""
        self.size = float(size)
        self._image = ConstantVelocity(centre, _IMAGE_NOISE * size, _IMAGE_SPEED * size, stamp)
        self._space: Optional[ConstantVelocity] = None
        self._locate(root, stamp)

    def update(self, centre: np.ndarray, size: float, root: Optional[np.ndarray], stamp: float,
               noise: float = 1.0) -> None:
        """Take over a sight of the body at `stamp` (s). noise: how many times less it is to be trusted than others."""
        self.size = float(size)
        self._image.update(centre, noise * _IMAGE_NOISE * size, stamp, _IMAGE_ACCELERATION * size)
        self._locate(root, stamp)

    def predicted_centre(self, stamp: float) -> np.ndarray:
        """Middle of the trunk (2,) px at `stamp`."""
        return self._image.predict(stamp, _IMAGE_ACCELERATION * self.size)[0]

    def predicted_root(self, stamp: float) -> Optional[np.ndarray]:
        """Root (3,) m at `stamp`, None when it was never known."""
        return None if self._space is None else self._space.predict(stamp, _SPACE_ACCELERATION)[0]

    @property
    def velocity(self) -> Optional[np.ndarray]:
        """Velocity (3,) m/s in the optical frame, None when the root was never known."""
        return None if self._space is None else self._space.velocity.copy()

    def speed(self) -> float:
        """Speed in the image, body sizes per second."""
        return float(np.hypot(*self._image.velocity)) / max(self.size, 1.0)

    def image_distance(self, centre: np.ndarray, stamp: float, noise: float) -> float:
        """How far `centre` (2,) px is from the prediction, in standard deviations.

        noise: standard deviation of the measurement in body sizes.
        """
        value, sd = self._image.predict(stamp, _IMAGE_ACCELERATION * self.size)
        return float(np.linalg.norm((np.asarray(centre) - value) / np.hypot(sd, noise * self.size)))

    def depth_distance(self, root: Optional[np.ndarray], stamp: float) -> float:
        """How far the depth of `root` (3,) m is from the prediction, in standard deviations; 0 when one is not known."""
        if root is None or self._space is None:
            return 0.0
        value, sd = self._space.predict(stamp, _SPACE_ACCELERATION)
        return float(abs(root[2] - value[2]) / math.hypot(sd[2], 2.0 * _DEPTH_NOISE * max(abs(value[2]), 0.5)))

    def _locate(self, root: Optional[np.ndarray], stamp: float) -> None:
        if root is None:
            return
        sd = np.array([_SPACE_NOISE, _SPACE_NOISE, _DEPTH_NOISE * max(abs(float(root[2])), 0.5)])
        if self._space is None or stamp - self._space.stamp > _LARGEST_GAP:
            self._space = ConstantVelocity(root, sd, _SPACE_SPEED, stamp)
        else:
            self._space.update(root, sd, stamp, _SPACE_ACCELERATION)
