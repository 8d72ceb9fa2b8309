"""The robot's own voice: while the robot speaks, only people are heard who are louder and in another direction.

`RobotSpeech` knows when the robot speaks: from messages that say so, and from the sound that it plays. `BargeInFilter`
stands between the separation and the voices: it learns in which direction the robot is heard, drops all sources while
the robot speaks, and keeps those that are louder than the robot and in another direction. Without an array, all sound
is ignored meanwhile. All times are seconds of the stamps of sound.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Deque, Dict, List, Optional, Set, Tuple

import numpy as np

from hri_pipeline.core.audio.level import level_dbfs
from hri_pipeline.core.audio.parameters import OwnVoiceSettings, VoicesSettings
from hri_pipeline.core.audio.pipeline import VoiceObservation, VoicePipeline
from hri_pipeline.core.audio.separation import SoundSeparator, SourceSignal
from hri_pipeline.core.audio.stream import RATE, SoundBlock

QUIET_DBFS = -60.0
"""Played sound below this is a pause of the robot."""
LONG_SPEECH_S = 120.0
"""No robot says so much at a time: a program that repeats "I speak" for ever, or plays music, makes it deaf."""
_HISTORY_S = 30.0
# Stamps of successive pieces err by so much (s).
_OVERLAP_S = 0.05
# A source that was louder than the robot for _LOUDER_S of the last _HELD_S is somebody, and this sound is kept.
_LOUDER_S, _HELD_S = 0.2, 0.5
# Own directions are those in which sound is heard for half of the time in which the robot speaks. Seconds of the
# robot's speech: before anything is known, and time constant of forgetting.
_OWN_SHARE, _LEAST_S, _MEMORY_S = 0.5, 0.3, 30.0
# Directions this close (rad) are one.
_SAME = math.radians(20.0)
# The level of the robot is this percentile of the powers of its last pieces; people who are 6 dB louder pass it.
_PERCENTILE, _PIECES = 70.0, 300


class RobotSpeech:
    """When the robot speaks.

    Parameters
    ----------
    settings : OwnVoiceSettings

    Attributes
    ----------
    problem : str
        Why the last word "I speak" is no longer believed; empty where it is, or was taken back.
    """

    def __init__(self, settings: OwnVoiceSettings) -> None:
        self._settings = settings
        self._since: Optional[float] = None
        self._told = -math.inf
        self._spans: Deque[Tuple[float, float]] = deque()
        self.problem = ""

    def reconfigure(self, settings: OwnVoiceSettings) -> None:
        """Use other settings from now on."""
        self._settings = settings

    def tell(self, speaking: bool, stamp: float) -> None:
        """Note that the robot says at `stamp` (s) whether it speaks; it may say so again and again."""
        self.problem = ""
        if stamp < self._told:
            self.reset()                # time has gone back
        self._told = stamp
        if speaking:
            self._since = stamp if self._since is None else self._since
        else:
            self._end(stamp)

    def play(self, samples: np.ndarray, stamp: float) -> None:
        """Note that the robot plays samples (n,), -1 to 1 at 16 kHz, from `stamp` (s) on."""
        if level_dbfs(samples) <= QUIET_DBFS:
            return
        if self._spans and -_OVERLAP_S <= stamp - self._spans[-1][1] <= self._settings.robot_tail:
            stamp, end = self._spans.pop()[0], stamp + len(samples) / RATE
        else:
            end = stamp + len(samples) / RATE
        self._add(stamp, end)

    def update(self, now: float, connected: bool) -> None:
        """Stop believing a robot that speaks for too long, or whose publisher has gone. now: s."""
        if self._since is None:
            return
        if not connected:
            self._end(max(self._told, now))
            self.problem = "its publisher has gone while it was true; it must say false at the end"
        elif now - self._told > self._settings.robot_speaking_timeout:
            self._end(self._told + self._settings.robot_speaking_timeout)
            self.problem = "it is true for more than {:g} s: say false at the end, or true again meanwhile " \
                           "(~robot_speaking_timeout)".format(self._settings.robot_speaking_timeout)

    def speaks(self, begin: float, end: float) -> bool:
        """Return whether the robot is heard between two times (s)."""
        if self._since is not None and end >= self._since:
            return True
        return any(begin <= until + self._settings.robot_tail and end >= since for since, until in self._spans)

    def long_speech(self, now: float) -> str:
        """Return what is suspicious about a robot that speaks for LONG_SPEECH_S without a pause until `now` (s), empty
        where it does not."""
        since = self._since
        if since is None and self._spans and now <= self._spans[-1][1] + self._settings.robot_tail:
            since = self._spans[-1][0]
        if since is None or now - since <= LONG_SPEECH_S:
            return ""
        return "the robot speaks for {:.0f} s without a pause, and people are hardly heard meanwhile; say false at " \
               "the end, and play no music on ~robot_audio".format(now - since)

    def reset(self) -> None:
        """Forget everything, when time has gone back."""
        self._since = None
        self._told = -math.inf
        self._spans.clear()

    def _end(self, stamp: float) -> None:
        if self._since is not None:
            self._add(self._since, stamp)
        self._since = None

    def _add(self, since: float, until: float) -> None:
        self._spans.append((since, until))
        while self._spans[0][1] < until - _HISTORY_S:
            self._spans.popleft()


@dataclass
class _Place:
    """A direction (3,) from which sound comes while the robot speaks, and for how long (s) it did."""

    direction: np.ndarray
    heard: float = 0.0


class BargeInFilter:
    """A separator that gives the sources which are not the robot, in place of the one that it is given.

    Parameters
    ----------
    array : SoundSeparator
    robot : RobotSpeech
    settings : VoicesSettings

    Attributes
    ----------
    stamp : float
        s, of the first sample that `process` gets next.
    """

    def __init__(self, array: SoundSeparator, robot: RobotSpeech, settings: VoicesSettings) -> None:
        self._array = array
        self._robot = robot
        self._settings = settings
        self.stamp = 0.0
        # These outlive reset(): the robot's loudspeaker stays where it is.
        self._places: List[_Place] = []
        self._spoken = 0.0
        self._powers: Deque[float] = deque(maxlen=_PIECES)
        self._forget_sources()

    @property
    def fitting_order(self) -> Tuple[int, ...]:
        """See SoundSeparator."""
        return self._array.fitting_order

    def reset(self) -> None:
        """Forget the sound so far, after a gap or when time jumps."""
        self._array.reset()
        self._forget_sources()

    def reconfigure(self, settings: VoicesSettings) -> None:
        """Use other settings from now on, in the separator as well."""
        self._settings = settings
        self._array.reconfigure(settings)

    def process(self, samples: np.ndarray) -> List[SourceSignal]:
        """Add samples (N, C), -1 to 1, and return the sources that are somebody. Raises ValueError, see
        SoundSeparator."""
        signals = self._array.process(samples)
        found: List[SourceSignal] = []
        own = [signal for signal in signals if self._robot.speaks(
            self.stamp + signal.offset / RATE, self.stamp + (signal.offset + len(signal.samples)) / RATE)]
        if own:
            self._learn(own)
        elif signals and not self._robot.speaks(self.stamp, self.stamp + len(samples) / RATE):
            self._forget_sources()
        for signal in signals:
            if any(signal is one for one in own):
                found += self._judge(signal)
            else:
                found.append(signal)
        for key, held in self._held.items():
            self._held[key] = [replace(one, offset=one.offset - len(samples)) for one in held]
        return found

    def _forget_sources(self) -> None:
        self._somebody: Set[int] = set()
        self._held: Dict[int, List[SourceSignal]] = {}

    def _learn(self, signals: List[SourceSignal]) -> None:
        """Learn from where, and how loud, the robot is heard."""
        active = [signal for signal in signals if signal.active and signal.direction is not None
                  and signal.key not in self._somebody]
        if not active:
            return
        length = max(len(signal.samples) for signal in active) / RATE
        keep = math.exp(-length / _MEMORY_S)
        self._spoken = self._spoken * keep + length
        for place in self._places:
            place.heard *= keep
        for signal in active:
            self._place_of(signal.direction).heard += length
        self._places = [place for place in self._places if place.heard > 0.01 * self._spoken]
        if not self._somebody and all(self._is_own(signal.direction) for signal in active):
            self._powers.append(max(_power(signal) for signal in active))

    def _place_of(self, direction: Optional[np.ndarray]) -> _Place:
        near = [place for place in self._places if _angle(place.direction, direction) < _SAME]
        if near:
            return min(near, key=lambda place: _angle(place.direction, direction))
        self._places.append(_Place(np.array(direction)))
        return self._places[-1]

    def _is_own(self, direction: Optional[np.ndarray]) -> bool:
        """Return whether the robot is heard from a direction (3,), as far as that is known."""
        return any(place.heard >= _OWN_SHARE * self._spoken
                   and _angle(place.direction, direction) < self._settings.barge_in_angle for place in self._places)

    def _judge(self, signal: SourceSignal) -> List[SourceSignal]:
        """Return what of a source is somebody's, while the robot speaks."""
        key = signal.key
        if key in self._somebody:
            return [signal]
        if signal.direction is None or self._spoken < _LEAST_S or self._is_own(signal.direction):
            self._held.pop(key, None)
            return []
        held = self._held.setdefault(key, [])
        held.append(signal)
        while sum(len(one.samples) for one in held) > _HELD_S * RATE:
            del held[0]
        if not self._powers or sum(len(one.samples) for one in held if self._is_louder(one)) < _LOUDER_S * RATE:
            return []
        self._somebody.add(key)
        return self._held.pop(key)

    def _is_louder(self, signal: SourceSignal) -> bool:
        level = float(np.percentile(list(self._powers), _PERCENTILE))
        return signal.active and _power(signal) > level * 10.0 ** (0.1 * self._settings.barge_in_margin)


def _power(signal: SourceSignal) -> float:
    return float(np.mean(np.square(signal.samples, dtype=np.float64))) if len(signal.samples) else 0.0


def _angle(first: np.ndarray, second: Optional[np.ndarray]) -> float:
    return math.pi if second is None else math.acos(max(-1.0, min(1.0, float(np.dot(first, second)))))


def hear_humans(pipeline: VoicePipeline, robot: RobotSpeech, barge_in: Optional[BargeInFilter],
                block: SoundBlock) -> List[VoiceObservation]:
    """Return the voices in a block, as VoicePipeline.update; without an array there are none while the robot speaks.

    barge_in: the array of the pipeline, None without one.
    """
    end = block.stamp + len(block.samples) / RATE
    if barge_in is not None:
        barge_in.stamp = block.stamp
    elif robot.speaks(block.stamp, end):
        return pipeline.idle(end)
    return pipeline.update(block)
