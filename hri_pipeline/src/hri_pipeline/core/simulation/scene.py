"""What a scene consists of: people, where they go, how they stand, what they look at. SI units, frame `map`, z up."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, List, Optional, Sequence, Tuple

Point = Tuple[float, float]

ROBOT = ""
"""Id of the robot, as in the messages; scene files write `robot`."""
AWAY = "away"

LOOK_AT, FACE, CLOSE_EYES, TALK = "look_at", "face", "close_eyes", "talk"
CIRCLE, SEMICIRCLE, VIS_A_VIS, L_SHAPE, SIDE_BY_SIDE = "circle", "semicircle", "vis_a_vis", "L", "side_by_side"
SHAPES = (CIRCLE, SEMICIRCLE, VIS_A_VIS, L_SHAPE, SIDE_BY_SIDE)


@dataclass(frozen=True)
class Goal:
    """A place to walk to. start: s at which to set off, None: as soon as the goal before is reached.

    position: m. speed: m/s. yaw: rad, how the trunk stands there; None: as it came, or towards whom `face` names.
    formation: index of the formation whose place this is, None for a way point.
    """

    position: Point
    speed: float
    start: Optional[float] = None
    yaw: Optional[float] = None
    formation: Optional[int] = None


@dataclass(frozen=True)
class Order:
    """What somebody does from `start` until `end`, s. kind: LOOK_AT, FACE, CLOSE_EYES, TALK.

    target: id of a person, ROBOT or AWAY, of LOOK_AT and FACE.
    """

    kind: str
    start: float
    end: float
    target: str = ROBOT


@dataclass(frozen=True)
class PersonScript:
    """One person, there from `enter` until `leave` (s), first at `origin` (m). stature: m."""

    name: str
    stature: float
    enter: float
    leave: float
    origin: Point
    yaw: float = 0.0
    goals: Tuple[Goal, ...] = ()
    orders: Tuple[Order, ...] = ()


@dataclass(frozen=True)
class Formation:
    """People who stand together from `start` until `end`, s; names in `members`, ROBOT among them where the robot takes
    part."""

    name: str
    shape: str
    centre: Point
    size: float
    yaw: float
    members: Tuple[str, ...]
    start: float
    end: float
    is_group: bool = True


@dataclass(frozen=True)
class Behaviour:
    """What people do unasked.

    look_robot, look_away: shares of the time (0 to 1) for which somebody in company looks at the robot or at nobody;
    the rest is for the others in the group, speakers first. dwell: mean time of one look, s; 0: no looks but those
    ordered. closed: share of the time with closed eyes; closed_length: mean time of one closing, s. turn, pause: mean
    time of a turn of talk in a group and of the silence after it, s; turn 0: nobody talks unasked. head_share: part of
    the way to a target that the head turns, 0 to 1; the eyes do the rest.
    """

    look_robot: float = 0.15
    look_away: float = 0.15
    dwell: float = 3.0
    closed: float = 0.0
    closed_length: float = 1.0
    turn: float = 3.0
    pause: float = 0.5
    head_share: float = 0.9


@dataclass(frozen=True)
class Robot:
    """Place on the floor (m), yaw (rad), and height of the head that people look at, which is the camera's, m."""

    position: Point = (0.0, 0.0)
    yaw: float = 0.0
    height: float = 1.3


@dataclass(frozen=True)
class Scene:
    """A whole scene. duration: s. text: the file that it came from, empty where there is none."""

    name: str
    duration: float
    people: Tuple[PersonScript, ...]
    formations: Tuple[Formation, ...] = ()
    habits: Behaviour = field(default_factory=Behaviour)
    robot: Robot = field(default_factory=Robot)
    seed: int = 0
    text: str = ""


NEIGHBOURS = 0.7
"""Least distance, m, of neighbours in a circle or row: elbow to elbow (Hall's personal space, close phase, is 0.45 to
0.75 m)."""

Slot = Tuple[Point, float]


def slots(formation: Formation, robot: Point) -> Dict[str, Slot]:
    """Return place (m) and heading (rad) of each member who walks; the robot stays where it is, at `robot`.

    With the robot as a member, the place nearest to it counts as its own.
    """
    places = _places(formation.shape, formation.centre, formation.size, formation.yaw, len(formation.members))
    if ROBOT in formation.members:
        places.remove(min(places, key=lambda slot: math.hypot(slot[0][0] - robot[0], slot[0][1] - robot[1])))
    return dict(zip((member for member in formation.members if member != ROBOT), places))


def _places(shape: str, centre: Point, size: float, yaw: float, count: int) -> List[Slot]:
    if shape == SIDE_BY_SIDE:
        spacing = max(NEIGHBOURS, size)
        offsets = [(index - (count - 1) / 2.0) * spacing for index in range(count)]
        return [((centre[0] - offset * math.sin(yaw), centre[1] + offset * math.cos(yaw)), yaw) for offset in offsets]
    if shape == CIRCLE:
        angles: Sequence[float] = [2.0 * math.pi * index / count for index in range(count)]
    elif shape == SEMICIRCLE:
        angles = [math.pi * ((index + 0.5) / count - 0.5) for index in range(count)]
    else:
        angles = {VIS_A_VIS: (0.0, math.pi), L_SHAPE: (-math.pi / 4.0, math.pi / 4.0)}[shape]
    gap = min((abs(b - a) for a, b in zip(angles, angles[1:])), default=math.pi)
    radius = max(size / 2.0, NEIGHBOURS / 2.0 / max(math.sin(min(gap, math.pi) / 2.0), 1e-3))
    return [((centre[0] + radius * math.cos(yaw + angle), centre[1] + radius * math.sin(yaw + angle)),
             _wrapped(yaw + angle + math.pi)) for angle in angles]


def _wrapped(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))
