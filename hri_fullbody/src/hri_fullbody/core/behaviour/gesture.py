"""REP-155 gestures: hands on face, arms crossed, left, right or both hands raised, waving."""

from __future__ import annotations

import math
from collections import deque
from enum import IntEnum
from itertools import takewhile
from typing import Deque, List, NamedTuple, Tuple

import numpy as np

from hri_fullbody.core.behaviour.arms import ArmFeatures
from hri_fullbody.core.behaviour.attitude import AttitudeClass, Latch, Rule

# Times in s, lengths in statures. Tuned on motion capture: waves and goodbyes against
# walking, dancing, punching.
_MEMORY_S = 2.0
_UP_S, _UP_SHARE = 0.9, 0.8
_ABOVE_ELBOW, _BELOW_SHOULDER = 0.02, 0.12
_SWING_S = 1.0
_SWING = 0.06
_TURNS = 3
_OVER_VERTICAL, _OVER_FORWARD = 1.3, 0.8
_SMOOTHING_S = 0.04
_MIN_SAMPLES = 5


class GestureClass(IntEnum):
    """Gestures; the numbers are the constants of hri_msgs/Gesture."""

    OTHER = 0
    HANDS_ON_FACE = 1
    ARMS_CROSSED = 2
    LEFT_HAND_RAISED = 3
    RIGHT_HAND_RAISED = 4
    BOTH_HANDS_RAISED = 5
    WAVING = 6


class _Sample(NamedTuple):
    time: float
    lateral: float
    ahead: float
    rise: float
    up: bool


class _ArmHistory:
    """The last two seconds of one forearm's motion."""

    def __init__(self) -> None:
        self._samples: Deque[_Sample] = deque()
        self._time = 0.0

    def add(self, features: ArmFeatures, side: int, elapsed: float, sure: bool) -> None:
        self._time += elapsed
        while self._samples and self._samples[0].time < self._time - _MEMORY_S:
            self._samples.popleft()
        lateral, ahead, rise, above = (
            features.lateral[side], features.ahead[side], features.rise[side], features.above_elbow[side])
        if not (sure and all(map(math.isfinite, (lateral, ahead, rise, above)))):
            return
        up = above > _ABOVE_ELBOW and rise > -_BELOW_SHOULDER
        if self._samples:
            last = self._samples[-1]
            weight = 1.0 - math.exp(-(self._time - last.time) / _SMOOTHING_S)
            lateral = last.lateral + weight * (lateral - last.lateral)
            ahead = last.ahead + weight * (ahead - last.ahead)
            rise = last.rise + weight * (rise - last.rise)
        self._samples.append(_Sample(self._time, lateral, ahead, rise, up))

    def score(self) -> float:
        """0 (still, or hand down) to 1 (waves): the share of the changes of direction that a wave needs."""
        recent = [sample.up for sample in takewhile(
            lambda sample: sample.time >= self._time - _UP_S, reversed(self._samples))]
        if len(recent) < _MIN_SAMPLES - 1 or sum(recent) < _UP_SHARE * len(recent):
            return 0.0
        if self._samples[-1].time - self._samples[0].time < _UP_S or not self._swings_sideways():
            return 0.0
        return min(1.0, turns([sample.lateral for sample in self._samples], _SWING) / _TURNS)

    def _swings_sideways(self) -> bool:
        """Whether the last second's motion, its trend taken off, is more sideways than up, down or forward."""
        table = np.array([sample[:4] for sample in self._samples if sample.time >= self._time - _SWING_S])
        if len(table) < _MIN_SAMPLES:
            return False
        time, motion = table[:, 0] - table[:, 0].mean(), table[:, 1:4] - table[:, 1:4].mean(axis=0)
        motion -= np.outer(time, time @ motion / max(float(time @ time), 1e-9))
        lateral, ahead, vertical = np.sqrt((motion * motion).mean(axis=0)).tolist()
        return lateral > _OVER_VERTICAL * vertical and lateral > _OVER_FORWARD * ahead


class WaveDetector:
    """Says whether one of a body's hands waves: raised forearm, at least three swings to and fro in two seconds."""

    _RULE = Rule(on=0.9, off=0.6, on_time=0.1, off_time=0.5)

    def __init__(self) -> None:
        self._arms = (_ArmHistory(), _ArmHistory())
        self._latch = Latch(self._RULE)

    def update(self, features: ArmFeatures, elapsed: float, sure: Tuple[bool, bool] = (True, True)) -> bool:
        """Take the arms `elapsed` s after the last call; return whether a hand waves.

        sure: whether the left and the right forearm are seen well; a guessed one jumps to and fro, and does not count.
        """
        for side, arm in enumerate(self._arms):
            arm.add(features, side, elapsed, sure[side])
        return self._latch.update(max(arm.score() for arm in self._arms), elapsed)


def turns(values: List[float], swing: float) -> int:
    """Count how often the values go up or down by at least `swing` after they went the other way (or started)."""
    count, direction = 0, 0
    low = high = values[0] if values else 0.0
    for value in values:
        high, low = max(high, value), min(low, value)
        if direction >= 0 and value < high - swing:
            count, direction, low = count + 1, -1, value
        elif direction <= 0 and value > low + swing:
            count, direction, high = count + 1, 1, value
    return count


def gesture_of(attitude: AttitudeClass, raised: Tuple[bool, bool], waving: bool) -> GestureClass:
    """Return the gesture of a body: waving before all, then the attitude, hands raised by side (left, right)."""
    if waving:
        return GestureClass.WAVING
    if attitude == AttitudeClass.HANDS_ON_FACE:
        return GestureClass.HANDS_ON_FACE
    if attitude == AttitudeClass.ARMS_CROSSED:
        return GestureClass.ARMS_CROSSED
    left, right = raised
    if left and right:
        return GestureClass.BOTH_HANDS_RAISED
    if left or right:
        return GestureClass.LEFT_HAND_RAISED if left else GestureClass.RIGHT_HAND_RAISED
    return GestureClass.OTHER
