"""Reads a scene file (YAML) into a Scene; the schema stands in docs/nodes/scene_simulator.md."""

from __future__ import annotations

import math
from pathlib import Path
from typing import List, Optional, Sequence, Tuple, Union

import yaml

from hri_pipeline.core.ids import ID_PATTERN, is_valid_id
from hri_pipeline.core.scene.scene_crowd import CROWD_KEYS, make_crowd
from hri_pipeline.core.scene.scene_fields import Fields, SceneError
from hri_pipeline.core.scene.scene_formations import slots
from hri_pipeline.core.scene.scene_model import (
    AWAY,
    CLOSE_EYES,
    FACE,
    L_SHAPE,
    LOOK_AT,
    ROBOT,
    SHAPES,
    TALK,
    VIS_A_VIS,
    Formation,
    Goal,
    Habits,
    Order,
    PersonScript,
    Point,
    Robot,
    Scene,
)

__all__ = ["Scene", "SceneError", "load_scene", "parse_scene"]

MAX_BYTES = 1000000
MAX_PEOPLE = 200
MAX_DURATION = 86400.0
WALK, FASTEST = 1.0, 2.5
"""Speed, m/s, of somebody who is told none, and the highest that may be asked for."""
STATURE = 1.70
ROBOT_NAME = "robot"
_FAR = 100.0
_ORDERS = (LOOK_AT, FACE, CLOSE_EYES, TALK)


def load_scene(path: Union[str, Path]) -> Scene:
    """Read a scene file. Raises SceneError that names the file, the key and what is legal there."""
    source = str(path)
    try:
        raw = Path(path).expanduser().read_bytes()
    except OSError as error:
        raise SceneError("{}: the scene file cannot be read: {}".format(source, error.strerror)) from error
    if len(raw) > MAX_BYTES:
        raise SceneError("{}: a scene file has {} bytes at most, not {}".format(source, MAX_BYTES, len(raw)))
    try:
        text = raw.decode("utf-8")
        data = yaml.safe_load(text)
    except UnicodeDecodeError as error:
        raise SceneError("{}: the scene file is not UTF-8".format(source)) from error
    except (yaml.YAMLError, RecursionError) as error:
        raise SceneError("{}: no YAML: {}".format(source, " ".join(str(error).split()))) from error
    return parse_scene(data, source, text)


def parse_scene(data: object, source: str = "scene", text: str = "") -> Scene:
    """Make a scene of what YAML gives. Raises SceneError that names `source`, the key and what is legal there."""
    top = Fields(data, source, "", ("name", "duration", "seed", "robot", "habits", "people", "formations", "crowd"))
    duration = top.number("duration", None, 1.0, MAX_DURATION, "s")
    robot = _robot(top)
    habits = _habits(top)
    seed = top.integer("seed", 0, 0, 2 ** 31 - 1)
    entries = top.entries("people", ("name", "stature", "enter", "leave", "at", "yaw", "path", "orders"), MAX_PEOPLE)
    names = _names(entries)
    formations = [_formation(fields, names, duration) for fields in top.entries(
        "formations", ("name", "shape", "centre", "size", "yaw", "members", "from", "until", "group"), 1000)]
    people = [_person(fields, names, duration, formations, robot) for fields in entries]
    crowd = top.section("crowd", CROWD_KEYS)
    if crowd is not None:
        more, meetings = make_crowd(crowd, duration, seed, robot, names, len(formations))
        people += more
        formations += meetings
    if not people:
        raise SceneError("{}: nobody is in the scene; give `people` or `crowd`".format(source))
    name = top.text("name", Path(source).stem)
    return Scene(name, duration, tuple(people), tuple(formations), habits, robot, seed, text)


def _robot(top: Fields) -> Robot:
    fields = top.section("robot", ("at", "yaw", "height"))
    if fields is None:
        return Robot()
    return Robot(fields.point("at", (0.0, 0.0)), math.radians(fields.number("yaw", 0.0, -360.0, 360.0, "deg")),
                 fields.number("height", 1.3, 0.1, 3.0, "m"))


def _habits(top: Fields) -> Habits:
    names = ("look_robot", "look_away", "dwell", "closed", "closed_length", "turn", "pause", "head_share")
    fields = top.section("habits", names)
    if fields is None:
        return Habits()
    legal = {"look_robot": (0.0, 1.0, ""), "look_away": (0.0, 1.0, ""), "dwell": (0.0, 600.0, "s"),
             "closed": (0.0, 0.9, ""), "closed_length": (0.1, 600.0, "s"), "turn": (0.0, 600.0, "s"),
             "pause": (0.0, 600.0, "s"), "head_share": (0.0, 1.0, "")}
    default = Habits()
    habits = Habits(**{name: fields.number(name, getattr(default, name), *legal[name]) for name in names})
    if habits.look_robot + habits.look_away > 1.0:
        raise fields.error("look_away", habits.look_away, "look_robot and look_away are 1 together at most")
    return habits


def _names(entries: Sequence[Fields]) -> Tuple[str, ...]:
    names: List[str] = []
    for fields in entries:
        name = fields.text("name", None)
        if not is_valid_id(name) or name in (ROBOT_NAME, AWAY):
            raise fields.error("name", name, "an id ({}), but {} and {}".format(ID_PATTERN, ROBOT_NAME, AWAY))
        if name in names:
            raise fields.error("name", name, "a name that nobody else has")
        names.append(name)
    return tuple(names)


def _who(fields: Fields, key: str, name: object, names: Sequence[str], others: Sequence[str] = ()) -> str:
    if name == ROBOT_NAME:
        return ROBOT
    if not isinstance(name, str) or (name not in names and name not in others):
        raise fields.error(key, name, "one of " + ", ".join([*names, ROBOT_NAME, *others]))
    return name


def _formation(fields: Fields, names: Sequence[str], duration: float) -> Formation:
    members = tuple(_who(fields, "members", name, names) for name in fields.items("members", 2, MAX_PEOPLE))
    if len(set(members)) != len(members):
        raise fields.error("members", list(members), "each once")
    shape = fields.choice("shape", SHAPES)
    if shape in (VIS_A_VIS, L_SHAPE) and len(members) != 2:
        raise fields.error("members", list(members), "two for the shape {}".format(shape))
    start = fields.number("from", 0.0, 0.0, duration, "s")
    return Formation(
        fields.text("name", "formation"), shape, fields.point("centre", None), fields.number("size", 1.2, 0.3, 20.0, "m"),
        math.radians(fields.number("yaw", 0.0, -360.0, 360.0, "deg")), members, start,
        fields.number("until", duration, start, duration, "s"), fields.boolean("group", True))


def _person(fields: Fields, names: Sequence[str], duration: float, formations: Sequence[Formation],
            robot: Robot) -> PersonScript:
    name = fields.text("name", None)
    enter = fields.number("enter", 0.0, 0.0, duration, "s")
    leave = fields.number("leave", duration, enter, duration, "s")
    stands = _stands(name, formations, robot)
    origin = fields.point("at", stands[0].position if stands else None)
    yaw = math.radians(fields.number("yaw", 0.0, -360.0, 360.0, "deg"))
    if stands and not fields.has("at") and stands[0].yaw is not None:
        yaw = stands[0].yaw
    goals = _path(fields, origin, enter, duration) + stands
    # Stable: way points without a time stay behind the one before.
    starts: List[float] = []
    for goal in goals:
        starts.append(goal.start if goal.start is not None else (starts[-1] if starts else enter))
    ordered = tuple(goal for _, goal in sorted(zip(starts, goals), key=lambda pair: pair[0]))
    orders = tuple(_order(order, names, duration) for order in fields.entries(
        "orders", ("at", "for", *_ORDERS), 10000))
    return PersonScript(name, fields.number("stature", STATURE, 0.8, 2.3, "m"), enter, leave, origin, yaw, ordered, orders)


def _stands(name: str, formations: Sequence[Formation], robot: Robot) -> List[Goal]:
    found = []
    for index, formation in enumerate(formations):
        place: Optional[Tuple[Point, float]] = slots(formation, robot.position).get(name)
        if place is not None:
            found.append(Goal(place[0], WALK, formation.start, place[1], index))
    return sorted(found, key=lambda goal: goal.start or 0.0)


def _path(fields: Fields, origin: Point, enter: float, duration: float) -> List[Goal]:
    """Way points. One with `by` is reached at that time: the speed is that of the way from the point before."""
    goals: List[Goal] = []
    last, when = origin, enter
    for step in fields.entries("path", ("to", "start", "by", "speed", "yaw"), 10000):
        place = step.point("to", None)
        start = step.number("start", None, enter, duration, "s") if step.has("start") else None
        speed = step.number("speed", WALK, 0.05, FASTEST, "m/s")
        if step.has("by"):
            begin = start if start is not None else when
            when = step.number("by", None, begin, duration, "s")
            speed = math.hypot(place[0] - last[0], place[1] - last[1]) / max(when - begin, 1e-6)
            if speed > FASTEST:
                raise step.error("by", when, "late enough for {:g} m/s at most, not {:.1f}".format(FASTEST, speed))
            start, speed = begin, max(speed, 0.05)
        elif start is not None:
            when = start
        yaw = math.radians(step.number("yaw", 0.0, -360.0, 360.0, "deg")) if step.has("yaw") else None
        goals.append(Goal(place, speed, start, yaw))
        last = place
    return goals


def _order(fields: Fields, names: Sequence[str], duration: float) -> Order:
    given = [kind for kind in _ORDERS if fields.has(kind)]
    if len(given) != 1:
        raise fields.error("", given, "one of {} in each order".format(", ".join(_ORDERS)))
    kind = given[0]
    start = fields.number("at", 0.0, 0.0, duration, "s")
    if kind in (CLOSE_EYES, TALK):
        length = fields.number(kind, None, 0.01, MAX_DURATION, "s")
        return Order(kind, start, start + length)
    length = fields.number("for", duration - start, 0.0, MAX_DURATION, "s")
    target = _who(fields, kind, fields.raw(kind), names, (AWAY,) if kind == LOOK_AT else ())
    return Order(kind, start, start + length, target)
