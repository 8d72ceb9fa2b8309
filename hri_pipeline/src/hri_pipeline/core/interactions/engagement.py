"""How far each person is engaged with the robot, from distance and mutual gaze over time (REP-155)."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Dict, FrozenSet, List, Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.interactions.parameters import EngagementSettings
from hri_pipeline.core.interactions.people import ROBOT, GazeTarget, Observer, PeopleSnapshot


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


def check_levels(settings: EngagementSettings) -> None:
    """Raise ValueError when the levels of engagement are in the wrong order."""
    if not (settings.disengaged_level < settings.engaging_level < settings.engaged_level
            and settings.disengaged_level < settings.disengaging_level < settings.engaged_level):
        raise ValueError(
            "disengaged_level {:g}, engaging_level {:g}, disengaging_level {:g}, engaged_level {:g}: the first has to "
            "be the lowest and the last the highest".format(settings.disengaged_level, settings.engaging_level,
                                                            settings.disengaging_level, settings.engaged_level))


class EngagementEstimator:
    """Smooths mutual gaze into an attention of 0 to 1 and moves each person from level to level, one step per
    update."""

    def __init__(self, settings: EngagementSettings) -> None:
        """Raises ValueError for levels in the wrong order."""
        check_levels(settings)
        self._settings = settings
        self._persons: Dict[str, _Person] = {}

    def reconfigure(self, settings: EngagementSettings) -> None:
        """Take up the values of the live parameters. Raises ValueError for levels in the wrong order."""
        check_levels(settings)
        self._settings = settings

    def reset(self) -> None:
        """Forget everybody, as after a time jump."""
        self._persons.clear()

    def update(self, people: Union[PeopleSnapshot, Sequence[Observer]], gazes: Sequence[GazeTarget],
               robot: Optional[np.ndarray],
               stamp: float, heading: Optional[np.ndarray] = None, unplaced: Sequence[str] = ()) -> Dict[str, Level]:
        """Return the level of everybody, by id.

        Parameters
        ----------
        people: PeopleSnapshot or sequence of Observer
            Everybody who has a place.
        gazes: sequence of GazeTarget
            Who looks at whom now.
        robot: (3,) array or None
            Place of the robot in the reference frame (m).
        stamp: float
            Time (s) of the image.
        heading: (3,) array or None
            Unit vector to where the robot looks; None: it is taken to look at everybody.
        unplaced: sequence of str
            Ids of those who are tracked, but have no place.
        """
        people = PeopleSnapshot.of(people)
        attentive = {gaze.sender for gaze in gazes if gaze.receiver == ROBOT}
        gain = _Gain(self._settings.engagement_time)
        persons: Dict[str, _Person] = {}
        for identity, seen, distance, ahead in zip(people.ids, *self._places(people, robot, heading)):
            person = persons[identity] = self._person(identity, stamp)
            if seen:
                person.seen_at = stamp
            near = identity in attentive and self._is_near(person, distance)
            self._step(person, near and ahead, stamp, gain)
        for identity in unplaced:
            person = persons[identity] = self._person(identity, stamp)
            self._step(person, False, stamp, gain)
        self._persons = persons
        return {identity: person.level for identity, person in persons.items()}

    def _person(self, identity: str, stamp: float) -> _Person:
        """Return what is known of a person. An image that is a little older than the time until which nobody was seen
        came late; it is no jump of time."""
        person = self._persons.get(identity)
        if person is None or stamp < person.stamp - self._settings.engagement_lost_time:
            return _Person(stamp)
        return person

    def _places(self, people: PeopleSnapshot, robot: Optional[np.ndarray], heading: Optional[np.ndarray]
                ) -> Tuple[List[bool], List[float], List[bool]]:
        """Of each: whether place and direction are known, the distance (m) from the robot, and whether the robot looks
        there."""
        count = len(people)
        if robot is None or not count:
            return [False] * count, [math.inf] * count, [True] * count
        ways = people.heads - robot
        unknown = np.isnan(people.heads[:, 0]) | (
            np.isnan(people.closed)
            & np.isnan(people.gazes[:, 0])
            & np.isnan(people.faces[:, 0])
            & np.isnan(people.trunks[:, 0])
        )
        # Over the floor: a child and a low robot are as near as they stand.
        distances = np.sqrt(ways[:, 0] ** 2 + ways[:, 1] ** 2)
        ahead = [True] * count
        if heading is not None:
            lengths = np.sqrt((ways * ways).sum(axis=1))
            ahead = ((lengths < 1e-6) | ~(ways @ heading < lengths * math.cos(self._settings.engagement_view))).tolist()
        return (~unknown).tolist(), distances.tolist(), ahead

    def _step(self, person: _Person, mutual: bool, stamp: float, gain: _Gain) -> None:
        dt, person.stamp = max(0.0, stamp - person.stamp), max(stamp, person.stamp)
        if person.stamp - person.seen_at > self._settings.engagement_lost_time:
            person.level, person.attention, person.near = Level.UNKNOWN, 0.0, False
            return
        person.attention += gain.at(dt) * (float(mutual) - person.attention)
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

    def _is_near(self, person: _Person, distance: float) -> bool:
        if not math.isfinite(distance):
            return False
        border = self._settings.engagement_distance + (self._settings.engagement_distance_margin if person.near
                                                       else 0.0)
        person.near = distance < border
        return person.near


class _Gain:
    """Gain of a first-order low-pass over a step of time; nearly everybody's is the same."""

    def __init__(self, time_constant: float) -> None:
        self._time_constant, self._dt, self._gain = time_constant, 0.0, 0.0

    def at(self, dt: float) -> float:
        if dt != self._dt:
            self._dt, self._gain = dt, 1.0 - math.exp(-dt / self._time_constant)
        return self._gain
