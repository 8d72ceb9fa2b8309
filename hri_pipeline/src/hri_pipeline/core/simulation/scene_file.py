"""Reads a scene file (YAML) into a Scene; the schema stands in docs/nodes/scene_simulator.md.

Every error names the file, the path of the key, and what is legal there.
"""

from __future__ import annotations

import difflib
import math
from pathlib import Path
from typing import List, Mapping, Optional, Sequence, Tuple, Union

import yaml

from hri_pipeline.core.ids import ID_PATTERN, is_valid_id
from hri_pipeline.core.simulation.scene import (
    AWAY,
    CLOSE_EYES,
    CROWD_KEYS,
    FACE,
    L_SHAPE,
    LOOK_AT,
    ROBOT,
    SHAPES,
    TALK,
    VIS_A_VIS,
    Behaviour,
    Formation,
    Goal,
    Order,
    PersonScript,
    Point,
    Robot,
    Scene,
    make_crowd,
    slots,
)


class SceneError(ValueError):
    """A scene file that says something which is not legal."""


class Fields:
    """The keys of one mapping of a scene file.

    source: name of the file. path: way to the mapping, such as `people[2]`. known: its legal keys.
    Raises SceneError for what is no mapping and for unknown keys.
    """

    def __init__(self, data: object, source: str, path: str, known: Sequence[str]) -> None:
        self._source, self._path = source, path
        if not isinstance(data, Mapping):
            raise SceneError("{}: {} is {}; legal: a mapping with the keys {}".format(
                source, path or "the file", _short(data), ", ".join(known)))
        self._data = data
        for key in data:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1)
                raise SceneError("{}: there is no key {}{}; legal: {}".format(
                    source, self._key(str(key)), " (did you mean {}?)".format(near[0]) if near else "",
                    ", ".join(known)))

    def error(self, key: str, value: object, legal: str) -> SceneError:
        """Return the error of one value."""
        return SceneError("{}: {} is {}; legal: {}".format(self._source, self._key(key), _short(value), legal))

    def has(self, key: str) -> bool:
        """Tell whether the key is there."""
        return self._data.get(key) is not None

    def raw(self, key: str) -> object:
        """Return the value as it stands there."""
        return self._data.get(key)

    def number(self, key: str, default: Optional[float], low: float, high: float, unit: str = "") -> float:
        """Return a finite number from `low` to `high`; without a default the key has to be there."""
        value = self._given(key, default)
        legal = "a number from {:g} to {:g}{}".format(low, high, " " + unit if unit else "")
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.error(key, value, legal)
        if not low <= value <= high:
            raise self.error(key, value, legal)
        return float(value)

    def integer(self, key: str, default: Optional[int], low: int, high: int) -> int:
        """Return a whole number from `low` to `high`."""
        value = self._given(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.error(key, value, "a whole number from {} to {}".format(low, high))
        return value

    def boolean(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self._given(key, default)
        if not isinstance(value, bool):
            raise self.error(key, value, "true or false")
        return value

    def text(self, key: str, default: Optional[str]) -> str:
        """Return a text of 100 characters at most."""
        value = self._given(key, default)
        if not isinstance(value, str) or not 0 < len(value) <= 100:
            raise self.error(key, value, "a text of 1 to 100 characters")
        return value

    def choice(self, key: str, choices: Sequence[str]) -> str:
        """Return one of the choices."""
        value = self._given(key, None)
        if value not in choices:
            raise self.error(key, value, "one of " + ", ".join(choices))
        return str(value)

    def point(self, key: str, default: Optional[Tuple[float, float]]) -> Tuple[float, float]:
        """Return a place on the floor, m: a list of two numbers from -100 to 100."""
        if default is None and not self.has(key):
            raise SceneError("{}: {} is missing".format(self._source, self._key(key)))
        x, y = self.numbers(key, default if default is not None else (0.0, 0.0), -100.0, 100.0, "m")
        return x, y

    def numbers(self, key: str, default: Tuple[float, ...], low: float, high: float,
                unit: str = "") -> Tuple[float, ...]:
        """Return as many numbers from `low` to `high` as the default has."""
        values = self._given(key, list(default))
        if not isinstance(values, list) or len(values) != len(default) or not all(
                isinstance(value, (int, float)) and not isinstance(value, bool) and low <= value <= high
                for value in values):
            raise self.error(key, values, "a list of {} numbers from {:g} to {:g}{}".format(
                len(default), low, high, " " + unit if unit else ""))
        return tuple(float(value) for value in values)

    def items(self, key: str, least: int, most: int) -> List[object]:
        """Return a list of `least` to `most` items."""
        value = self._given(key, [])
        if not isinstance(value, list) or not least <= len(value) <= most:
            raise self.error(key, value, "a list of {} to {}".format(least, most))
        return list(value)

    def section(self, key: str, known: Sequence[str]) -> Optional["Fields"]:
        """Return the mapping below a key, None where it is not there."""
        return Fields(self._data[key], self._source, self._key(key), known) if self.has(key) else None

    def entries(self, key: str, known: Sequence[str], most: int) -> List["Fields"]:
        """Return the mappings in the list below a key, none where it is not there."""
        if not self.has(key):
            return []
        return [Fields(item, self._source, "{}[{}]".format(self._key(key), index), known)
                for index, item in enumerate(self.items(key, 0, most))]

    def _given(self, key: str, default: object) -> object:
        value = self._data.get(key)
        if value is not None:
            return value
        if default is None:
            raise SceneError("{}: {} is missing".format(self._source, self._key(key)))
        return default

    def _key(self, key: str) -> str:
        return "{}.{}".format(self._path, key) if self._path and key else (key or self._path)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


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


def _habits(top: Fields) -> Behaviour:
    names = ("look_robot", "look_away", "dwell", "closed", "closed_length", "turn", "pause", "head_share")
    fields = top.section("habits", names)
    if fields is None:
        return Behaviour()
    legal = {"look_robot": (0.0, 1.0, ""), "look_away": (0.0, 1.0, ""), "dwell": (0.0, 600.0, "s"),
             "closed": (0.0, 0.9, ""), "closed_length": (0.1, 600.0, "s"), "turn": (0.0, 600.0, "s"),
             "pause": (0.0, 600.0, "s"), "head_share": (0.0, 1.0, "")}
    default = Behaviour()
    habits = Behaviour(**{name: fields.number(name, getattr(default, name), *legal[name]) for name in names})
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
        fields.text("name", "formation"), shape, fields.point("centre", None),
        fields.number("size", 1.2, 0.3, 20.0, "m"),
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
    return PersonScript(name, fields.number("stature", STATURE, 0.8, 2.3, "m"), enter, leave, origin, yaw, ordered,
                        orders)


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
