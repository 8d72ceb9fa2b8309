"""What a scene consists of: people, where they go, how they stand, what they look at; and people at random, the crowd.

SI units, frame `map`, z up.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Dict, List, Optional, Sequence, Set, Tuple

if TYPE_CHECKING:
    from hri_pipeline.core.simulation.scene_file import Fields

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


CROWD_KEYS = ("people", "stay", "meet", "area", "group", "approach")
SPACING = 2.4
"""Distance of two places, m: a circle of four is 1.3 m wide, and its neighbour has to be another group."""
CLEAR = 2.2
"""Distance, m, that places keep from the robot."""
CIRCLE_SIZE = 1.1
WALK = 1.0
_OUTSIDE = 1.5
_PATIENCE = 15.0
"""How long (s) somebody who is alone waits for company."""
_ROBOT_PLACES = ((1.2, 0.0), (1.3, 0.7), (1.3, -0.7))


@dataclass
class _Visitor:
    """Somebody of the crowd while the schedule is made."""

    name: str
    stature: float
    enter: float
    until: float
    origin: Point
    here: Point
    goals: List[Goal] = field(default_factory=list)
    orders: List[Order] = field(default_factory=list)
    busy: float = 0.0
    alone: bool = False
    place: Optional[int] = None


@dataclass
class _Schedule:
    """What has been decided so far. here: who is there now; first: number of the first formation."""

    places: List[Point]
    first: int
    here: List[_Visitor] = field(default_factory=list)
    formations: List[Formation] = field(default_factory=list)
    done: List[PersonScript] = field(default_factory=list)

    @property
    def taken(self) -> Set[Optional[int]]:
        """Places where somebody stands or goes to."""
        return {visitor.place for visitor in self.here}


def make_crowd(fields: Fields, duration: float, seed: int, robot: Robot, names: Sequence[str],
               formations: int) -> Tuple[List[PersonScript], List[Formation]]:
    """Return people and formations of the section `crowd`; the same for the same seed.

    names: those already in use; formations: how many there are. Raises SceneError for an area that is too small.
    """
    people = fields.integer("people", None, 1, 100)
    stay = fields.number("stay", 120.0, 5.0, 86400.0, "s")
    meet = fields.number("meet", 30.0, 5.0, 3600.0, "s")
    approach = fields.number("approach", 0.15, 0.0, 1.0)
    least, most = fields.numbers("group", (2.0, 4.0), 2.0, 6.0)
    x0, y0, x1, y1 = fields.numbers("area", (2.5, -4.9, 9.8, 4.9), -100.0, 100.0, "m")
    places = _crowd_places(x0, y0, x1, y1, robot)
    if len(places) < people:
        raise fields.error("area", [x0, y0, x1, y1], "room for {} people: it has {} places {:g} m apart".format(
            people, len(places), SPACING))
    rng = random.Random("crowd {}".format(seed))
    schedule = _Schedule(places, formations)
    here = schedule.here
    numbers = (number for number in range(1, 10 ** 6) if "p{:04d}".format(number) not in names)
    arrivals = [0.0] * people
    for second in range(int(duration)):
        now = float(second)
        for when in [when for when in arrivals if when <= now]:
            arrivals.remove(when)
            here.append(_arrive("p{:04d}".format(next(numbers)), now, stay, (x1, y0, y1), places, rng))
        for visitor in [visitor for visitor in here if visitor.busy <= now and visitor.until <= now]:
            here.remove(visitor)
            schedule.done.append(_leave(visitor, now, duration, (x1, y0, y1), rng))
            arrivals.append(now + rng.expovariate(1.0 / 5.0))
        free = [visitor for visitor in here if visitor.busy <= now]
        rng.shuffle(free)
        while free:
            _occupy(free, now, duration, schedule, (meet, approach, int(least), int(most)), robot, rng)
    schedule.done += [_script(visitor, duration) for visitor in here]
    return sorted(schedule.done, key=lambda person: (person.enter, person.name)), schedule.formations


def _crowd_places(x0: float, y0: float, x1: float, y1: float, robot: Robot) -> List[Point]:
    """Middles of cells of SPACING m in the area, less those next to the robot."""
    columns, rows = int(max(x1 - x0, 0.0) / SPACING), int(max(y1 - y0, 0.0) / SPACING)
    found = [(x0 + (column + 0.5) * SPACING, y0 + (row + 0.5) * SPACING) for column in range(columns)
             for row in range(rows)]
    return [(x, y) for x, y in found if math.hypot(x - robot.position[0], y - robot.position[1]) > CLEAR]


def _arrive(name: str, now: float, stay: float, edge: Tuple[float, float, float], places: Sequence[Point],
            rng: random.Random) -> _Visitor:
    """Somebody new: those of the first moment are inside already, later ones come over the far edge of the area."""
    origin, place = (edge[0] + _OUTSIDE, rng.uniform(edge[1], edge[2])), None
    if now == 0.0:
        place = int(name[1:]) % len(places)
        x, y = places[place]
        origin = (x + rng.uniform(-0.3, 0.3), y + rng.uniform(-0.3, 0.3))
    stature = min(max(rng.gauss(1.70, 0.09), 1.45), 1.98)
    return _Visitor(name, stature, now, now + max(10.0, rng.expovariate(1.0 / stay)), origin, origin,
                    place=place)


def _leave(visitor: _Visitor, now: float, duration: float, edge: Tuple[float, float, float],
           rng: random.Random) -> PersonScript:
    out = (edge[0] + _OUTSIDE, rng.uniform(edge[1], edge[2]))
    visitor.goals.append(Goal(out, WALK, now))
    return _script(visitor, min(duration,
                                now + math.hypot(out[0] - visitor.here[0], out[1] - visitor.here[1]) / WALK + 2.0))


def _script(visitor: _Visitor, leave: float) -> PersonScript:
    return PersonScript(visitor.name, visitor.stature, visitor.enter, leave, visitor.origin, math.pi,
                        tuple(visitor.goals), tuple(visitor.orders))


def _occupy(free: List[_Visitor], now: float, duration: float, schedule: _Schedule,
            how: Tuple[float, float, int, int], robot: Robot, rng: random.Random) -> None:
    """Give the first of the free people, or several of them, something to do."""
    meet, approach, least, most = how
    end = min(duration, now + max(8.0, rng.expovariate(1.0 / meet)))
    taken = schedule.taken
    at_robot = [-1 - index for index in range(len(_ROBOT_PLACES)) if -1 - index not in taken]
    places = [index for index in range(len(schedule.places)) if index not in taken]
    if at_robot and (rng.random() < approach or not places):
        _visit_robot(free.pop(), now, end, rng.choice(at_robot), schedule, robot)
    elif len(free) < least and free[-1].alone and now - free[-1].busy < _PATIENCE:
        free.pop()      # stays where it is: company may come
    elif places and len(free) >= least and rng.random() < 0.75:
        size = min(len(free), rng.randint(least, max(least, most)))
        members = [free.pop() for _ in range(size)]
        _meet(members, now, end, rng.choice(places), rng.uniform(-math.pi, math.pi), schedule, robot)
    elif places:
        visitor, place = free.pop(), rng.choice(places)
        visitor.here, visitor.place, visitor.busy, visitor.alone = schedule.places[place], place, end, True
        visitor.goals.append(Goal(visitor.here, WALK, now, rng.uniform(-math.pi, math.pi)))
    else:
        free.pop().busy = now + 1.0     # no room: stays where it is for now


def _visit_robot(visitor: _Visitor, now: float, end: float, place: int, schedule: _Schedule, robot: Robot) -> None:
    forward, left = _ROBOT_PLACES[-1 - place]
    cosine, sine = math.cos(robot.yaw), math.sin(robot.yaw)
    spot = (robot.position[0] + forward * cosine - left * sine, robot.position[1] + forward * sine + left * cosine)
    visitor.place, visitor.busy, visitor.alone = place, end, True
    number = schedule.first + len(schedule.formations)
    middle = ((robot.position[0] + spot[0]) / 2.0, (robot.position[1] + spot[1]) / 2.0)
    towards = math.atan2(robot.position[1] - spot[1], robot.position[0] - spot[0])
    schedule.formations.append(Formation("visit{}".format(number), VIS_A_VIS, middle, forward, towards,
                                         (ROBOT, visitor.name),
                                         now, end))
    visitor.goals.append(Goal(spot, WALK, now, towards, number))
    arrival = now + math.hypot(spot[0] - visitor.here[0], spot[1] - visitor.here[1]) / WALK
    if end > arrival + 1.0:
        visitor.orders += [Order(LOOK_AT, arrival, end - 1.0, ROBOT), Order(FACE, arrival, end, ROBOT)]
    visitor.here = spot


def _meet(members: List[_Visitor], now: float, end: float, place: int, yaw: float, schedule: _Schedule,
          robot: Robot) -> None:
    number = schedule.first + len(schedule.formations)
    formation = Formation("meeting{}".format(number), CIRCLE, schedule.places[place], CIRCLE_SIZE, yaw,
                          tuple(visitor.name for visitor in members), now, end)
    schedule.formations.append(formation)
    for visitor in members:
        spot, heading = slots(formation, robot.position)[visitor.name]
        visitor.goals.append(Goal(spot, WALK, now, heading, number))
        visitor.here, visitor.place, visitor.busy, visitor.alone = spot, place, end, False
