"""People in a room with several cameras, and what each camera tells of them, with the errors that were measured on real
cameras: 12 % of the distance along the ray, 2 % across.

The error along the ray has three parts: one of the person, which all cameras share (a child is not so far away as an
adult of the same size in the image), one of the person for this camera, and one that changes within a second. So it
does not average out while somebody stands. No floor is used.

Clothes are those of `identity_worlds`, half of the pieces dark, seen in another light, and from another side, by each
camera: so much so that one human's differ by .5 at most in 82 % of the pairs of cameras, as was measured. (Those of
two people did in no pair that was measured; here they do in one of ten.) How much of the light all parts share was not
measured: most of it here.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace
from typing import Callable, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from benchmarks.identity_worlds import PARTS, human, seen_clothes

OF_PERSON, OF_VIEW, OF_MOMENT = 0.08, 0.06, 0.066      # along the ray, share of the distance; together 0.12
ALONG_TIME_S, ACROSS_TIME_S = 1.0, 0.5                  # correlation times
ACROSS_VIEW, ACROSS_MOMENT, ACROSS_WHITE = 0.012, 0.012, 0.01       # share of the distance; together 0.02
CALIBRATION_M, CALIBRATION_RAD = 0.02, 0.006            # of the cameras' poses
HEAD_BELOW_TOP = 0.12                                   # m, of the sellion
HALF_WIDTH = 0.22                                       # m, of somebody who hides others
FARTHEST = 9.0                                          # m
LOST_S = 0.5                                            # a track that is not seen for longer ends
CAMERA_LIGHT, CAMERA_TINT, SIDE_LIGHT, SIDE_TINT = 20.0, 6.2, 8.5, 1.7      # L*a*b* of 8 bits
DARK = 0.5                                              # of the clothes
FACE_TURN = math.radians(70.0)                          # farther turned away, the face is not seen


class Sighting(NamedTuple):
    """What a camera tells of one person: kind "face" or "body", the id of the track, place (3,) m in map."""

    kind: str
    track: str
    person: int
    camera: str
    place: np.ndarray
    stamp: float


@dataclass
class Camera:
    """A camera at `position` (3,) m that looks along `yaw` (rad), level; fov: half angles (rad)."""

    name: str
    position: np.ndarray
    yaw: float
    fov: Tuple[float, float] = (math.radians(37.0), math.radians(28.0))
    period: float = 1.0 / 12.0
    delay: float = 0.1
    phase: float = 0.0
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    turn: float = 0.0

    def sees(self, point: np.ndarray) -> bool:
        """Tell whether a point (3,) m is within the image."""
        offset = point - self.position
        level = math.hypot(offset[0], offset[1])
        angle = math.atan2(offset[1], offset[0]) - self.yaw
        return (0.4 < level < FARTHEST and abs(math.remainder(angle, 2.0 * math.pi)) < self.fov[0]
                and abs(math.atan2(offset[2], level)) < self.fov[1])

    def hides(self, point: np.ndarray, others: Sequence[np.ndarray]) -> bool:
        """Tell whether somebody with the top at one of `others` (3,) m stands before a point."""
        ray = point - self.position
        length = math.hypot(ray[0], ray[1])
        for top in others:
            way = top - self.position
            along = (way[0] * ray[0] + way[1] * ray[1]) / length
            across = abs(way[0] * ray[1] - way[1] * ray[0]) / length
            if 0.2 < along < length - 0.2 and across < HALF_WIDTH and (
                    self.position[2] + ray[2] * along / length < top[2]):
                return True
        return False


class Walker:
    """Somebody of a stature (m) who goes from place to place at a pace (m/s), and stands for a while at each."""

    def __init__(self, stature: float, places: Iterator[Tuple[np.ndarray, float]], pace: float,
                 start: np.ndarray) -> None:
        """places: (2,) m and how long (s) the person stands there."""
        self.stature, self._places, self._pace = stature, places, pace
        self.point, self.heading = np.array(start, float), 0.0
        self._target, self._stay = next(places)
        self._velocity = np.zeros(2)

    @property
    def head(self) -> np.ndarray:
        """Where the sellion is, (3,) m."""
        return np.array([*self.point, self.stature - HEAD_BELOW_TOP])

    @property
    def top(self) -> np.ndarray:
        """The top of the head, (3,) m."""
        return np.array([*self.point, self.stature])

    def step(self, time: float, others: Sequence["Walker"]) -> None:
        """Go on for `time` s, around the others."""
        way = self._target - self.point
        left = float(np.hypot(*way))
        wanted = np.zeros(2)
        if left > 0.08:
            wanted = way / left * min(self._pace, left / 0.4)
            for other in others:
                apart = self.point - other.point
                distance = float(np.hypot(*apart))
                if 1e-6 < distance < 0.55:
                    side = np.array([-apart[1], apart[0]]) / distance
                    wanted += (0.55 - distance) * (4.0 * apart / distance + 2.0 * side)
        else:
            self._stay -= time
            if self._stay <= 0.0:
                self._target, self._stay = next(self._places)
        self._velocity += (1.0 - math.exp(-time / 0.25)) * (wanted - self._velocity)
        self.point = self.point + time * self._velocity
        if np.hypot(*self._velocity) > 0.15:
            turn = math.remainder(math.atan2(self._velocity[1], self._velocity[0]) - self.heading, 2.0 * math.pi)
            self.heading += (1.0 - math.exp(-time / 0.3)) * turn


class _Error:
    """Errors of one feature of one person for one camera."""

    def __init__(self, of_person: float, rng: np.random.Generator) -> None:
        self._rng = rng
        self._along = of_person + OF_VIEW * rng.normal()
        self._across = ACROSS_VIEW * rng.normal(size=2)
        self._slow, self._side, self._stamp = rng.normal(), rng.normal(size=2), -math.inf

    def place(self, camera: Camera, point: np.ndarray, stamp: float) -> np.ndarray:
        """Where the camera takes a point (3,) m for."""
        rng, gone = self._rng, stamp - self._stamp
        kept = math.exp(-gone / ALONG_TIME_S)
        self._slow = kept * self._slow + math.sqrt(1.0 - kept ** 2) * rng.normal()
        kept = math.exp(-gone / ACROSS_TIME_S)
        self._side = kept * self._side + math.sqrt(1.0 - kept ** 2) * rng.normal(size=2)
        self._stamp = stamp
        ray = point - camera.position
        distance = float(np.linalg.norm(ray))
        ray = ray / distance
        side = np.cross(ray, (0.0, 0.0, 1.0))
        side /= np.linalg.norm(side)
        across = self._across + ACROSS_MOMENT * self._side + ACROSS_WHITE * rng.normal(size=2)
        along = max(0.4, 1.0 + self._along + OF_MOMENT * self._slow)
        seen = distance * (along * ray + across[0] * side + across[1] * np.cross(side, ray))
        turn = np.array([[math.cos(camera.turn), -math.sin(camera.turn), 0.0],
                         [math.sin(camera.turn), math.cos(camera.turn), 0.0], [0.0, 0.0, 1.0]])
        return camera.position + camera.shift + turn @ seen


@dataclass
class _Track:
    id: str
    seen: float
    blind_until: float = -math.inf


class Room:
    """Lets people walk and the cameras look; `step` returns what arrives in between.

    gaps: mean time (s) between two drop-outs of a track. hidden: people hide those behind them.
    """

    def __init__(self, cameras: Sequence[Camera], people: Sequence[Walker], rng: np.random.Generator,
                 gaps: float = 10.0, hidden: bool = False) -> None:
        self.cameras, self.people, self._rng, self._gaps = cameras, list(people), rng, gaps
        self._hidden = hidden
        self.now = 0.0
        self._ids = itertools.count()
        self._of_person = [{"face": OF_PERSON * rng.normal(), "body": OF_PERSON * rng.normal()} for _ in people]
        self._errors: Dict[Tuple[str, int, str], _Error] = {}
        self.tracks: Dict[Tuple[str, int, str], _Track] = {}
        self._due = {camera.name: camera.phase for camera in cameras}
        self._pending: List[Tuple[float, List[Sighting]]] = []
        self.truth: List[Tuple[float, np.ndarray]] = []
        self.present: Callable[[int], bool] = lambda number: True
        # Of their own, so that they change nothing else.
        self._dress = np.random.default_rng(int(1e6 * people[0].stature) + len(cameras))
        self._clothes = [human(self._dress, dark=DARK) for _ in people]
        self._tints = {camera.name: np.append(CAMERA_LIGHT * self._dress.normal(), CAMERA_TINT * self._dress.normal(
            size=2)) for camera in cameras}
        self._sides: Dict[Tuple[str, int], np.ndarray] = {}

    def clothes(self, camera: str, person: int) -> np.ndarray:
        """What a camera takes the colours of somebody's clothes for, see `reidentification.describe`."""
        side = self._sides.setdefault((camera, person), self._dress.normal(size=(PARTS, 1)) * (
            SIDE_LIGHT, SIDE_TINT, SIDE_TINT))
        worn = self._clothes[person]
        return seen_clothes(replace(worn, colours=worn.colours + self._tints[camera] + side), self._dress)

    def step(self, time: float) -> List[Sighting]:
        """Go on for `time` s; returns what has arrived, in order."""
        self.now += time
        for walker in self.people:
            walker.step(time, [other for other in self.people if other is not walker])
        self.truth.append((self.now, np.array([walker.head for walker in self.people])))
        for camera in self.cameras:
            if self.now >= self._due[camera.name]:
                self._due[camera.name] += camera.period * self._rng.uniform(0.9, 1.1)
                late = camera.delay + self._rng.exponential(0.015)
                self._pending.append((self.now + late, self._look(camera)))
        arrived = sorted((item for item in self._pending if item[0] <= self.now), key=lambda item: item[0])
        self._pending = [item for item in self._pending if item[0] > self.now]
        for key in [key for key, track in self.tracks.items() if self.now - track.seen > LOST_S]:
            if self.tracks[key].blind_until <= self.now:
                del self.tracks[key]
        return [sighting for _, found in arrived for sighting in found]

    def head_at(self, person: int, stamp: float) -> np.ndarray:
        """Where somebody's sellion was at `stamp` (s), (3,) m."""
        times = [time for time, _ in self.truth[-60:]]
        found = int(np.argmin(np.abs(np.array(times) - stamp)))
        return self.truth[-60:][found][1][person]

    def listed(self, kind: str) -> List[str]:
        """Ids of the tracks that are listed now."""
        return [track.id for (_, _, of), track in sorted(self.tracks.items())
                if of == kind and track.id and self.now - track.seen <= LOST_S]

    def _look(self, camera: Camera) -> List[Sighting]:
        found = []
        for number, walker in enumerate(self.people):
            if not self.present(number):
                continue
            head = walker.head
            others = [other.top for index, other in enumerate(self.people)
                      if self._hidden and other is not walker and self.present(index)]
            if not camera.sees(head) or camera.hides(head, others):
                continue
            bearing = math.atan2(camera.position[1] - head[1], camera.position[0] - head[0])
            turned = abs(math.remainder(bearing - walker.heading, 2.0 * math.pi))
            for kind in ("body", "face") if turned < FACE_TURN else ("body",):
                sighting = self._find(camera, number, kind, head)
                if sighting is not None:
                    found.append(sighting)
        return found

    def _find(self, camera: Camera, number: int, kind: str, head: np.ndarray) -> Optional[Sighting]:
        key = (camera.name, number, kind)
        track = self.tracks.get(key)
        if track is None or self.now - track.seen > LOST_S and track.blind_until <= self.now:
            track = self.tracks[key] = _Track("{}{:04d}".format(kind[0], next(self._ids)), self.now)
        if track.blind_until > self.now:
            return None
        if self._rng.uniform() < camera.period / self._gaps:
            track.blind_until = self.now + self._rng.uniform(0.1, 2.0)
            return None
        track.seen = self.now
        if key not in self._errors:
            self._errors[key] = _Error(self._of_person[number][kind], self._rng)
        return Sighting(kind, track.id, number, camera.name, self._errors[key].place(camera, head, self.now), self.now)


def wandering(rng: np.random.Generator, size: Tuple[float, float], company: Optional[Callable[[], np.ndarray]] = None
              ) -> Iterator[Tuple[np.ndarray, float]]:
    """Places all over a room of `size` (m), now and then 0.6 m beside somebody."""
    while True:
        if company is not None and rng.uniform() < 0.4:
            angle = rng.uniform(0.0, 2.0 * math.pi)
            place = company() + 0.6 * np.array([math.cos(angle), math.sin(angle)])
            yield np.clip(place, 0.4, np.array(size) - 0.4), rng.uniform(3.0, 8.0)
        else:
            yield rng.uniform(0.4, np.array(size) - 0.4), rng.choice([0.0, 0.0, 2.0, 5.0])


def shared_room(seed: int, cameras: int, people: int, hidden: bool = False) -> Room:
    """A room of 4.4 x 3.8 m into which `cameras` look from its corners; people walk, cross, and stand together.

    Its people are some 2.5 m from the cameras, as those of the real cameras were of which the errors are known.
    """
    rng = np.random.default_rng(seed)
    size = (4.4, 3.8)
    corners = [np.array(corner) for corner in ((-0.4, -0.4), (4.8, -0.4), (4.8, 4.2), (-0.4, 4.2))]
    first = int(rng.integers(4))
    # Neighbours first: two that look at each other cannot triangulate.
    order = [(first + number) % 4 for number in range(4)]
    eyes = []
    for number, corner in enumerate(order[:cameras]):
        position = corners[corner] + rng.uniform(-0.2, 0.2, 2)
        middle = 0.5 * np.array(size) - position
        eyes.append(Camera("camera{}".format(number), np.array([*position, rng.uniform(1.2, 2.1)]),
                           math.atan2(middle[1], middle[0]) + rng.uniform(-0.05, 0.05),
                           period=1.0 / rng.uniform(10.0, 15.0), delay=rng.uniform(0.05, 0.25),
                           phase=rng.uniform(0.0, 0.1), shift=CALIBRATION_M * rng.normal(size=3),
                           turn=CALIBRATION_RAD * rng.normal()))
    walkers: List[Walker] = []
    for number in range(people):
        def company(own: int = number) -> np.ndarray:
            others = [walker for index, walker in enumerate(walkers) if index != own]
            return others[int(rng.integers(len(others)))].point
        walkers.append(Walker(rng.uniform(1.2, 1.9), wandering(rng, size, company if number else None),
                              rng.uniform(0.6, 1.3), rng.uniform(0.4, np.array(size) - 0.4)))
    return Room(eyes, walkers, rng, hidden=hidden)


class _Way:
    """Somebody who walks along points (N, 2) m at a pace (m/s), with a stop (s) before the last; there from `since` s
    on."""

    def __init__(self, stature: float, points: Sequence[Sequence[float]], pace: float, since: float = 0.0) -> None:
        steps = [(np.array(point, float), 0.0) for point in points[1:]]
        self.walker = Walker(stature, iter([*steps, (np.array(points[-1], float), math.inf)]), pace,
                             np.array(points[0], float))
        self.since = since


def two_views(seed: int, comes_back: bool) -> Tuple[Room, float]:
    """Two cameras side by side whose views end 0 to 2 s of walking apart; returns the room, and when somebody leaves.

    Person 0 walks out of the left view. comes_back: it goes on into the right one, and in half of the rooms somebody
    else comes up there shortly before or after, from elsewhere. Else it turns off between the views, and somebody else
    enters the right view within 1.2 m of where person 0 would have, within 2 s, in its own direction.
    """
    rng = np.random.default_rng((seed, 3))
    pace, unseen = rng.uniform(0.6, 1.3), rng.uniform(0.0, 2.0)
    gap = pace * unseen
    depth, half = rng.uniform(2.0, 3.5), math.radians(32.0)
    reach = depth * math.tan(half)
    eyes = [Camera(name, np.array([x, 0.0, rng.uniform(1.3, 1.9)]), math.pi / 2.0, (half, math.radians(28.0)),
                   period=1.0 / rng.uniform(10.0, 15.0), delay=rng.uniform(0.05, 0.25), phase=rng.uniform(0.0, 0.1),
                   shift=CALIBRATION_M * rng.normal(size=3), turn=CALIBRATION_RAD * rng.normal())
            for name, x in (("left", 0.0), ("right", 2.0 * reach + gap))]
    start = reach - 2.5 * pace
    leaves, enters = 2.5, 2.5 + unseen
    far = reach + gap + rng.uniform(1.5, 2.5)
    slope = rng.uniform(-0.2, 0.2)
    ways = [_Way(rng.uniform(1.2, 1.9), [(start, depth), (reach, depth), (far, depth + slope)], pace)]
    entry = np.array([reach + gap, depth])
    if comes_back and rng.uniform() < 0.5:
        side = rng.choice([-1.0, 1.0])
        at = entry + (rng.uniform(1.0, 2.0), side * rng.uniform(0.8, 1.2))
        ways.append(_Way(rng.uniform(1.2, 1.9), [at, at + (-0.5, 0.0)], rng.uniform(0.5, 1.2),
                         enters + rng.uniform(-1.0, 1.0)))
    if not comes_back:
        out = (reach + 0.3, depth + rng.choice([-1.0, 1.0]) * 9.0)
        ways[0] = _Way(ways[0].walker.stature, [(start, depth), (reach + 0.1, depth), out], pace)
        at = entry + (-0.15, rng.uniform(-1.2, 1.2))
        angle = rng.uniform(-1.0, 1.0)
        other = rng.uniform(0.6, 1.3)
        ways.append(_Way(rng.uniform(1.2, 1.9), [at, at + 3.0 * np.array([math.cos(angle), math.sin(angle)])], other,
                         leaves + rng.uniform(0.0, 2.0)))
    room = Room(eyes, [way.walker for way in ways], rng, gaps=30.0)
    for way in ways:
        _wait(way.walker, way.since, room)
    room.present = lambda number: room.now >= ways[number].since
    return room, leaves


def _wait(walker: Walker, since: float, room: Room) -> None:
    """Let somebody stand still until `since` (s)."""
    step = walker.step
    walker.step = lambda time, others: step(time, []) if room.now >= since else None  # type: ignore[method-assign]
