"""Nods and shakes of one head, from its pose over time.

A nod turns the head down and up again and again, a shake to one side and the other. Both are told by their swings: the
ways between the turning points of pitch and of yaw. Swings of a gesture come one directly after the other, are about
equally long and equally fast, lead nowhere, and go along one axis much more than along the other. What else moves
heads fails one of these: a look at something else leads away and stays there, speech moves the head to all sides and
unequally, and steps let it pitch by less than a nod does.

Figures of the movements: U. Hadar, T. J. Steiner, F. Clifford Rose, "Head movement during listening turns in
conversation", J. Nonverbal Behavior 9, 1985 (nods and shakes: symmetrical and cyclic, mostly 1 to 4 Hz), and
"Kinematics of head movements accompanying speech during conversation", Human Movement Science 2, 1983; E. Hirasaki et
al., "Effects of walking velocity on vertical head and body movements during locomotion", Exp. Brain Res. 127, 1999
(pitch of some 4 degrees from peak to peak at the frequency of the steps).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Deque, List, NamedTuple, Sequence, Tuple

WINDOW_S = 2.0
"""Time (s) that is looked at."""
LEAST_SWING = math.radians(3.0)
"""Least swing (rad). Poses of still faces on moved photographs have a standard deviation of 0.2 to 0.4 degrees."""
LEAST_MEAN_SWING = math.radians(6.0)
_WALKING_SWING = math.radians(8.0)
_WALKING_SPEED = 0.3
"""Mean swings (rad) of somebody who comes or goes at this speed (m/s) must be at least so large."""
FULL_SWING = math.radians(15.0)
LEAST_SWINGS, SMALL_SWING, LEAST_SMALL_SWINGS = 3, math.radians(8.0), 4
"""Down, up and down again: less cannot be told from a look at something and back. One more where they are smaller
(rad) on average, as those of speech are."""
SHORTEST_S, LONGEST_S = 0.07, 0.65
"""Time (s) of one swing: half a period of 7 and of 0.8 Hz."""
UNLIKE, UNEVEN = 0.45, 0.4
"""Least ratio of the lengths, and of the times, of two swings that follow each other; largest way from the first
turning point to the last, beyond one swing, in mean swings."""
IMAGE_S = 0.12
"""Time (s) by which that of a swing may be wrong: the turning points lie in one image or the next."""
SPEECH_SWING, SPEECH_SPREAD = math.radians(6.1), math.radians(0.83)
"""Mean swing (rad) of which half of the seeming nods are speech, since the jaw pitches the head, and the spread of its
logistic distribution: simulated heads, a quarter of which talk (`benchmark interactions --only nods`, heads 0 to 19
and 500 to 579)."""
OTHER_AXIS = 0.4
"""Largest swing of the other axis over that of the gesture."""
LAST_S = 0.35
"""A gesture ends this long (s) after its last turning point."""
_GAP_S = 0.5


@dataclass(frozen=True)
class HeadGesture:
    """Strength of a nod and of a shake, 0 to 1 by the mean swing of 0 to 15 degrees; 0: none. One of them at most."""

    nod: float = 0.0
    shake: float = 0.0


class Swing(NamedTuple):
    """Way between two turning points: times (s) and angles (rad)."""

    begin: float
    end: float
    start: float
    stop: float

    @property
    def length(self) -> float:
        return abs(self.stop - self.start)


_Pose = Tuple[float, float, float, float]


class HeadGestures:
    """Finds the nods and shakes of one head. Not thread-safe."""

    def __init__(self) -> None:
        self._poses: Deque[_Pose] = deque()

    def reset(self) -> None:
        """Forget the past."""
        self._poses.clear()

    def update(self, yaw: float, pitch: float, distance: float, stamp: float) -> HeadGesture:
        """Return the gesture of this moment.

        Parameters
        ----------
        yaw, pitch: float
            Turn of the head (rad) against the line of sight. What is not finite is left out.
        distance: float
            From the camera to the head (m).
        stamp: float
            Time of the image (s); one that goes back, or comes after a gap of half a second, is a new start.
        """
        if not all(map(math.isfinite, (yaw, pitch, distance, stamp))):
            return HeadGesture()
        if self._poses and not 0.0 < stamp - self._poses[-1][0] <= _GAP_S:
            self.reset()
        if self._poses:
            yaw = self._poses[-1][1] + math.remainder(yaw - self._poses[-1][1], 2.0 * math.pi)
        self._poses.append((stamp, yaw, pitch, distance))
        while stamp - self._poses[0][0] > WINDOW_S:
            self._poses.popleft()
        yaws, pitches = (swings([(pose[0], pose[axis]) for pose in self._poses], LEAST_SWING) for axis in (1, 2))
        least = _WALKING_SWING if self._speed() > _WALKING_SPEED else LEAST_MEAN_SWING
        return HeadGesture(self._strength(pitches, 1, stamp, least), self._strength(yaws, 2, stamp, least))

    def _speed(self) -> float:
        """Speed (m/s) to or from the camera: the faster half of the window."""
        poses, half = list(self._poses), len(self._poses) // 2
        if half < 2:
            return 0.0
        return max(abs(last[3] - first[3]) / (last[0] - first[0])
                   for first, last in ((poses[0], poses[half]), (poses[half], poses[-1])))

    def _strength(self, found: Sequence[Swing], other: int, stamp: float, least: float) -> float:
        """Strength of the gesture out of the swings of its axis; other: row of the other axis in the poses."""
        gesture = _last_run(found)
        if len(gesture) < LEAST_SWINGS or stamp - gesture[-1].end > LAST_S:
            return 0.0
        mean = sum(swing.length for swing in gesture) / len(gesture)
        if mean < SMALL_SWING and len(gesture) < LEAST_SMALL_SWINGS:
            return 0.0
        led = abs(gesture[-1].stop - gesture[0].start) - (mean if len(gesture) % 2 else 0.0)
        if mean < least or led > UNEVEN * mean:
            return 0.0
        begin, end = gesture[0].begin, gesture[-1].end
        # Slow drifts of the other axis are no part of it.
        beside = [swing.length for swing in swings([(pose[0], pose[other]) for pose in self._poses
                                                    if begin <= pose[0] <= end], 0.5 * LEAST_SWING)]
        if beside and sum(beside) > OTHER_AXIS * mean * len(gesture):
            return 0.0
        return min(mean / FULL_SWING, 1.0)


def nod_confidence(strength: float) -> float:
    """Return how often a nod of this strength, as of `HeadGesture`, is one: 0 to 1; 1 of none."""
    if strength <= 0.0:
        return 1.0
    return 1.0 / (1.0 + math.exp((SPEECH_SWING - strength * FULL_SWING) / SPEECH_SPREAD))


def swings(path: Sequence[Tuple[float, float]], least: float) -> List[Swing]:
    """Return the ways between the turning points of a path of (s, rad), of `least` rad and more; the last one is that
    up to the farthest point so far."""
    found: List[Swing] = []
    values = [value for _, value in path]
    if not values or max(values) - min(values) < least:
        return found    # most heads, most of the time
    low = high = turning = path[0]
    direction = 0
    for at, value in path[1:]:
        if direction == 0:
            low = (at, value) if value < low[1] else low
            high = (at, value) if value > high[1] else high
            if high[1] - low[1] >= least:
                turning, direction = (low, 1) if high[0] > low[0] else (high, -1)
        elif direction > 0:
            high = (at, value) if value >= high[1] else high
            if high[1] - value >= least:
                found.append(Swing(turning[0], high[0], turning[1], high[1]))
                turning, low, direction = high, (at, value), -1
        else:
            low = (at, value) if value <= low[1] else low
            if value - low[1] >= least:
                found.append(Swing(turning[0], low[0], turning[1], low[1]))
                turning, high, direction = low, (at, value), 1
    if direction:
        last = high if direction > 0 else low
        found.append(Swing(turning[0], last[0], turning[1], last[1]))
    return found


def _last_run(found: Sequence[Swing]) -> List[Swing]:
    """Return the swings, up to the last one, that are alike in length and of the time that a gesture's take."""
    run: List[Swing] = []
    for swing in reversed(found):
        if not SHORTEST_S <= swing.end - swing.begin <= LONGEST_S:
            break
        if run and not (_alike(swing.length, run[-1].length)
                        and _alike(swing.end - swing.begin, run[-1].end - run[-1].begin, IMAGE_S)):
            break
        run.append(swing)
    return run[::-1]


def _alike(one: float, other: float, slack: float = 0.0) -> bool:
    return max(one, other) * UNLIKE <= min(one, other) + UNLIKE * slack
