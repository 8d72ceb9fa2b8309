"""How a camera moves in the reference frame, and where it jumps because the localisation has corrected itself.

In `map` all that a camera sees jumps with it (REP-105), and nobody has walked.
"""

from __future__ import annotations

import math
from typing import Optional

import numpy as np

from hri_pipeline.core.geometry import Pose

SMOOTHING_S = 0.5      # of the camera's velocity
JUMP_SPEED = 1.0       # m/s by which a camera's velocity differs from before where it jumps; robots need some 0.5 s
LASTS_S = 0.15         # of a jump that tf spreads from one correction to the next
JUMP_TURN = math.radians(150.0)    # the same of its turning, rad/s; quick heads turn by 90 degrees per second


class CameraMotion:
    """The motion of the camera that sees one person."""

    def __init__(self) -> None:
        self._last: Optional[Pose] = None
        self._velocity: Optional[np.ndarray] = None
        self._turn = self._jumping = 0.0

    def see(self, pose: Optional[Pose], step: float) -> Optional[Pose]:
        """Take where the camera is (it maps camera coordinates to the reference frame), `step` s after the last time.
        With a step of 0 it begins anew.

        Returns what maps a place before to where it is if it has jumped with the camera, None without a jump.
        """
        last, self._last = self._last, pose
        if last is None or pose is None or step <= 0.0:
            self._velocity, self._jumping = None, 0.0
            return None
        change = pose.compose(last.inverse())
        velocity = (pose.translation - last.translation) / step
        turn = math.acos(min(1.0, max(-1.0, (float(np.trace(change.rotation)) - 1.0) / 2.0))) / step
        if self._velocity is None:
            self._velocity, self._turn = velocity, turn
            return None
        off, more = velocity - self._velocity, turn - self._turn
        speed = float(np.linalg.norm(off))
        gain = 1.0 - math.exp(-step / SMOOTHING_S)
        # A jump says little of how the camera goes on.
        self._velocity = self._velocity + gain * min(1.0, JUMP_SPEED / max(speed, 1e-9)) * off
        self._turn += gain * min(JUMP_TURN, more)
        self._jumping = LASTS_S if speed > JUMP_SPEED or more > JUMP_TURN else self._jumping - step
        return change if self._jumping > 0.0 else None
