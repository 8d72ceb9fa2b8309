"""A random crowd for long runs: people come, stand together in changing groups, go to the robot, and leave."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, List, Optional, Sequence, Set, Tuple

from hri_pipeline.core.simulation.scene import (
    CIRCLE,
    FACE,
    LOOK_AT,
    ROBOT,
    VIS_A_VIS,
    Formation,
    Goal,
    Order,
    PersonScript,
    Point,
    Robot,
    slots,
)

if TYPE_CHECKING:
    from hri_pipeline.core.simulation.scene_file import Fields

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
    places = _places(x0, y0, x1, y1, robot)
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


def _places(x0: float, y0: float, x1: float, y1: float, robot: Robot) -> List[Point]:
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
