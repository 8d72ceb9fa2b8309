"""How far each person is engaged with the robot, from distance and mutual gaze over time (REP-155)."""

from __future__ import annotations

import math
from enum import IntEnum
from types import SimpleNamespace
from typing import Dict, FrozenSet, Optional, Sequence

import numpy as np

from hri_pipeline.core.interactions.gaze_people import ROBOT, GazeTarget, Onlooker


class Level(IntEnum):
    """The constants of hri_msgs/EngagementLevel."""

    UNKNOWN = 0
    DISENGAGED = 1
    ENGAGING = 2
    ENGAGED = 3
    DISENGAGING = 4


LEGAL: Dict[Level, FrozenSet[Level]] = {
    Level.UNKNOWN: frozenset({Level.DISENGAGED}),
    Level.DISENGAGED: frozenset({Level.ENGAGING, Level.UNKNOWN}),
    Level.ENGAGING: frozenset({Level.ENGAGED, Level.DISENGAGED, Level.UNKNOWN}),
    Level.ENGAGED: frozenset({Level.DISENGAGING, Level.UNKNOWN}),
    Level.DISENGAGING: frozenset({Level.ENGAGED, Level.DISENGAGED, Level.UNKNOWN}),
}
"""Where each level may lead."""


class _Person:
    def __init__(self, stamp: float) -> None:
        self.level = Level.UNKNOWN
        self.attention = 0.0
        self.near = False
        self.seen_at = -math.inf
        self.stamp = stamp


class EngagementEstimator:
    """Smooths mutual gaze into an attention of 0 to 1 and moves each person from level to level, one step per update."""

    def __init__(self, settings: SimpleNamespace) -> None:
        """settings: the values of INTERACTION_PARAMETERS; ValueError for levels in the wrong order."""
        if not (settings.disengaged_level < settings.engaging_level < settings.engaged_level
                and settings.disengaged_level < settings.disengaging_level < settings.engaged_level):
            raise ValueError(
                "disengaged_level {:g}, engaging_level {:g}, disengaging_level {:g}, engaged_level {:g}: the first has to be "
                "the lowest and the last the highest".format(settings.disengaged_level, settings.engaging_level,
                                                             settings.disengaging_level, settings.engaged_level))
        self._settings = settings
        self._persons: Dict[str, _Person] = {}

    def reset(self) -> None:
        """Forget everybody, as after a time jump."""
        self._persons.clear()

    def update(self, people: Sequence[Onlooker], gazes: Sequence[GazeTarget], robot: Optional[np.ndarray],
               stamp: float, heading: Optional[np.ndarray] = None) -> Dict[str, Level]:
        """Return the level of everybody at `stamp` (s).

        robot: (3,) m; heading: (3,) unit vector, where the robot looks; None: it is taken to look at everybody.
        """
        attentive = {gaze.sender for gaze in gazes if gaze.receiver == ROBOT}
        listed = {person.id for person in people}
        self._persons = {identity: person for identity, person in self._persons.items() if identity in listed}
        levels: Dict[str, Level] = {}
        for onlooker in people:
            person = self._persons.setdefault(onlooker.id, _Person(stamp))
            if stamp < person.stamp:
                person = self._persons[onlooker.id] = _Person(stamp)
            self._step(person, onlooker, onlooker.id in attentive, robot, stamp, heading)
            levels[onlooker.id] = person.level
        return levels

    def _step(self, person: _Person, onlooker: Onlooker, looks: bool, robot: Optional[np.ndarray], stamp: float,
              heading: Optional[np.ndarray]) -> None:
        settings = self._settings
        if robot is not None and onlooker.head is not None and _has_direction(onlooker):
            person.seen_at = stamp
        dt, person.stamp = stamp - person.stamp, stamp
        if stamp - person.seen_at > settings.engagement_lost_time:
            person.level, person.attention, person.near = Level.UNKNOWN, 0.0, False
            return
        mutual = looks and self._is_near(person, onlooker, robot) and self._is_seen(onlooker, robot, heading)
        gain = 1.0 - math.exp(-dt / settings.engagement_time)
        person.attention += gain * (float(mutual) - person.attention)
        person.level = self._next(person.level, person.attention)

    def _next(self, level: Level, attention: float) -> Level:
        settings = self._settings
        if level == Level.UNKNOWN:
            return Level.DISENGAGED
        if level == Level.DISENGAGED:
            return Level.ENGAGING if attention >= settings.engaging_level else level
        if level == Level.ENGAGED:
            return Level.DISENGAGING if attention < settings.disengaging_level else level
        if attention >= settings.engaged_level:
            return Level.ENGAGED
        return Level.DISENGAGED if attention < settings.disengaged_level else level

    def _is_near(self, person: _Person, onlooker: Onlooker, robot: Optional[np.ndarray]) -> bool:
        if robot is None or onlooker.head is None:
            return False
        border = self._settings.engagement_distance + (self._settings.engagement_distance_margin if person.near else 0.0)
        # Over the floor: a child and a low robot are as near as they stand.
        person.near = math.hypot(*(np.asarray(onlooker.head) - robot)[:2].tolist()) < border
        return person.near

    def _is_seen(self, onlooker: Onlooker, robot: Optional[np.ndarray], heading: Optional[np.ndarray]) -> bool:
        if heading is None or robot is None or onlooker.head is None:
            return True
        way = np.asarray(onlooker.head) - robot
        length = float(np.linalg.norm(way))
        return length < 1e-6 or float(way @ heading) / length >= math.cos(self._settings.engagement_view)


def _has_direction(onlooker: Onlooker) -> bool:
    return onlooker.eyes_closed is not None or any(direction is not None for direction in (
        onlooker.gaze_direction, onlooker.head_direction, onlooker.body_direction))
