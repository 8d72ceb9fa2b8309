"""The same person in the views of several cameras, by place and time.

Persons whose features come from different sensors are one human if they stand at one place of the reference frame for a
while and walk alike. A person who has left one view, and a new person in the view of another camera at the place where
the first one must be by now, are one human, too (camera hand-off). Persons that one sensor has seen at the same time
are two; so are two to whom the recogniser of one sensor gave different names. (Recognisers that do not share a gallery
give one human several names.)
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from dataclasses import dataclass
from itertools import combinations
from typing import Deque, Dict, FrozenSet, Iterable, List, Mapping, NamedTuple, Optional, Set, Tuple

import numpy as np

from hri_pipeline.core.assignment import assign

FRESH_S = 0.5              # who was seen so long ago is seen now
WINDOW_S = 1.0             # of the velocity
SHORTEST_S = 0.3           # of the places that tell a velocity
FASTEST_MPS = 3.0          # a person who runs
SETTLING_S = 0.2           # the first places of a stretch are averaged
Point = Tuple[float, float]
LIKELIHOOD = 0.8
PARTING = 2.0              # a link ends beyond so many times the distance, after so many times the time, of joining
CLEARER_BY_M = 0.15        # another pairing has to be farther apart by so much
ALIKE_MPS = 0.8            # difference of two measured velocities of one human
HANDOVER_M = 1.0           # between where a lost person must be and where one comes up,
HANDOVER_GROWTH_MPS = 0.3  # and so much more for each second out of sight
NEW_S = 2.0                # so long somebody counts as new
MAX_SENSORS = 50
MAX_NAMES = 1000
_NOBODY: FrozenSet[str] = frozenset()
Pair = FrozenSet[str]


class SensorTrack:
    """Places (m, in the horizontal plane of the reference frame) by stamp (s), as one sensor after the other gives
    them.

    began, ended: stamps of the first and the last place of the present stretch, in which `sensor` saw the person
    without a gap. Where two sensors or two features give places at once, those of the better source count.
    """

    def __init__(self) -> None:
        self._reset()

    def _reset(self) -> None:
        self.sensor = ""
        self.began = self.ended = -math.inf
        self._source = 0
        self._points: Deque[Tuple[float, float, float]] = deque()
        self._first = (0, 0.0, 0.0)
        self._seen: Dict[str, Tuple[float, float]] = {}
        self._stamps: Dict[Tuple[int, str], float] = {}
        self._fit: Optional[Tuple[float, float, float, float, float]] = None

    @property
    def length(self) -> float:
        """Length of the present stretch, s."""
        return self.ended - self.began

    @property
    def start(self) -> Point:
        """Mean of the first places of the present stretch, m."""
        count, x, y = self._first
        return x / count, y / count

    @property
    def velocity(self) -> Point:
        """Velocity over the last second, m/s; 0 while too little is known."""
        return self._line()[3:]

    def add(self, source: int, sensor: str, point: Point, stamp: float) -> None:
        """Take a place; one not newer than the last is left out. Where a source goes far back, all starts afresh."""
        if stamp < self._stamps.get((source, sensor), -math.inf) - WINDOW_S:
            self._reset()
        self._stamps[source, sensor] = stamp
        first, last = self._seen.get(sensor, (stamp, stamp))
        self._seen[sensor] = (min(first, stamp), max(last, stamp))
        fresh = stamp - self.ended <= FRESH_S
        if fresh and ((source, sensor) != (self._source, self.sensor) and source >= self._source
                      or stamp <= self.ended):
            return
        if not fresh or sensor != self.sensor:
            self.began, self._first = stamp, (0, 0.0, 0.0)
            self._points.clear()
        self.sensor, self._source, self.ended = sensor, source, stamp
        if stamp - self.began <= SETTLING_S:
            count, x, y = self._first
            self._first = (count + 1, x + point[0], y + point[1])
        self._points.append((stamp, *point))
        while self._points[0][0] < stamp - WINDOW_S:
            self._points.popleft()
        self._fit = None

    def expected(self, stamp: float) -> Point:
        """Where the person is at a time near or after the last place, walking on as it went, m."""
        time, x, y, u, v = self._line()
        return x + u * (stamp - time), y + v * (stamp - time)

    def overlap(self, other: "SensorTrack") -> float:
        """For how long (s) one sensor has seen both at the same time; negative: it has not."""
        return max((min(last, other._seen[sensor][1]) - max(first, other._seen[sensor][0])
                    for sensor, (first, last) in self._seen.items() if sensor in other._seen), default=-math.inf)

    def absorb(self, other: "SensorTrack") -> None:
        """Take over when the sensors saw a person that has turned out to be this one."""
        for sensor, (first, last) in other._seen.items():
            own = self._seen.get(sensor, (first, last))
            self._seen[sensor] = (min(first, own[0]), max(last, own[1]))

    def _line(self) -> Tuple[float, float, float, float, float]:
        """Straight line through the places of the last second: time s, x, y m, velocity m/s."""
        if self._fit is None:
            count = len(self._points)
            time, x, y = (sum(values) / count for values in zip(*self._points))
            square = sum((point[0] - time) ** 2 for point in self._points)
            u = v = 0.0
            if self._points[-1][0] - self._points[0][0] >= SHORTEST_S:
                u = sum((point[0] - time) * point[1] for point in self._points) / square
                v = sum((point[0] - time) * point[2] for point in self._points) / square
                scale = min(1.0, FASTEST_MPS / max(math.hypot(u, v), 1e-9))
                u, v = u * scale, v * scale
            self._fit = (time, x, y, u, v)
        return self._fit


class CameraPerson(NamedTuple):
    """What the manager knows of one person of its table.

    representative: id of the person that stands for it. present: it has features. names: who recognisers say that it
    is.
    """

    id: str
    representative: str
    present: bool
    anonymous: bool
    names: FrozenSet[str] = frozenset()


class CrossCameraLink(NamedTuple):
    """Two persons that are one human as long as the likelihood is above 0."""

    first: str
    second: str
    likelihood: float


@dataclass
class _Nearness:
    """Smoothed distance (m) of a pair, since when (s) it is near or far, and the last time it was compared (s)."""

    distance: float
    since: float
    stamp: float
    near: bool


class CrossCamera:
    """Follows places of persons per sensor and tells who is one human. Times are stamps of the measurements, s."""

    def __init__(self, distance: float, time: float, handover: float) -> None:
        """Take the limits, see limit()."""
        self.limit(distance, time, handover)
        self._tracks: Dict[str, SensorTrack] = {}
        self._near: Dict[Pair, _Nearness] = {}
        self._links: Set[Pair] = set()
        self._sensors: Set[str] = set()
        self._named_by: "OrderedDict[str, Set[str]]" = OrderedDict()
        self._newest = -math.inf

    def limit(self, distance: float, time: float, handover: float) -> None:
        """Join persons nearer than `distance` m for `time` s, and the lost with the new for `handover` s; 0: never."""
        self._distance, self._time, self._handover = distance, time, handover

    @property
    def is_idle(self) -> bool:
        """Tell whether fewer than two sensors have placed anybody so far, so that there is nothing to join."""
        return len(self._sensors) < 2

    def retain(self, person_ids: Iterable[str]) -> None:
        """Forget everybody else; for the time while it is idle."""
        kept = set(person_ids)
        for gone in self._tracks.keys() - kept:
            del self._tracks[gone]

    @property
    def links(self) -> Tuple[Tuple[str, str], ...]:
        """The pairs that are joined now."""
        return tuple((min(pair), max(pair)) for pair in self._links)

    def add_place(self, person_id: str, source: int, sensor: str, point: Point, stamp: float) -> None:
        """Take a place (m, in the horizontal plane) of a person of the table; a lower `source` is a better one."""
        if sensor not in self._sensors:
            if len(self._sensors) >= MAX_SENSORS:
                return
            self._sensors.add(sensor)
        track = self._tracks.get(person_id)
        if track is None:
            track = self._tracks[person_id] = SensorTrack()
        track.add(source, sensor, point, stamp)
        self._newest = max(self._newest, stamp)

    def update(self, persons: Iterable[CameraPerson], merged: Mapping[str, str]) -> List[CrossCameraLink]:
        """Return the links that are new or over; merged: persons of the table that have become others.

        Persons that are in neither are forgotten.
        """
        facts = {person.id: person for person in persons}
        changed = self._follow_merged(facts, merged)
        self._note_names(facts.values())
        changed += self._separate(facts)
        changed += self._join(facts)
        if self._handover > 0.0:
            changed += self._hand_over(facts)
        return changed

    def _follow_merged(self, facts: Mapping[str, CameraPerson], merged: Mapping[str, str]) -> List[CrossCameraLink]:
        """Remove persons that have gone; links with one are moved to the person that it has become, else its neighbours
        are linked."""
        changed = []
        for gone in {end for pair in self._links for end in pair if end not in facts}:
            ends = [end for pair in self._links if gone in pair for end in pair - {gone}]
            ends = [merged.get(gone, "")] + ends
            self._links = {pair for pair in self._links if gone not in pair}
            ends = list(dict.fromkeys(end for end in ends if end in facts))
            for first, second in zip(ends, ends[1:]):
                self._links.add(frozenset((first, second)))
                changed.append(CrossCameraLink(first, second, LIKELIHOOD))
        for gone in [key for key in self._tracks if key not in facts]:
            target = self._tracks.get(merged.get(gone, ""))
            if target is not None:
                target.absorb(self._tracks[gone])
            del self._tracks[gone]
        for pair in [pair for pair in self._near if not pair <= facts.keys()]:
            del self._near[pair]
        return changed

    def _note_names(self, persons: Iterable[CameraPerson]) -> None:
        """Remember at which sensors each name is given."""
        for fact in persons:
            if fact.present and self._is_fresh(fact.id):
                for name in fact.names:
                    self._named_by.setdefault(name, set()).add(self._tracks[fact.id].sensor)
        while len(self._named_by) > MAX_NAMES:
            self._named_by.popitem(last=False)

    def _separate(self, facts: Mapping[str, CameraPerson]) -> List[CrossCameraLink]:
        """End the links of those who are apart, were seen at once by one sensor, or have two names."""
        over = []
        for pair in list(self._links):
            first, second = pair
            nearness = self._compare(first, second) if self._is_fresh(first) and self._is_fresh(second) else None
            apart = nearness is not None and not nearness.near and (
                nearness.stamp - nearness.since >= PARTING * self._time)
            if apart or self._are_two(facts[first], facts[second], FRESH_S):
                self._links.discard(pair)
                self._near.pop(pair, None)
                over.append(CrossCameraLink(min(pair), max(pair), 0.0))
        return over

    def _join(self, facts: Mapping[str, CameraPerson]) -> List[CrossCameraLink]:
        here = sorted((key for key, fact in facts.items() if fact.present and self._is_fresh(key)),
                      key=lambda key: (self._tracks[key].sensor, key))
        views: Dict[Tuple[str, str], Dict[Tuple[str, str], float]] = {}
        for first, second in combinations(here, 2):
            sensors = (self._tracks[first].sensor, self._tracks[second].sensor)
            if sensors[0] != sensors[1] and self._may_join(facts, first, second):
                alike = bool(facts[first].names & facts[second].names)
                views.setdefault(sensors, {})[first, second] = self._compare(first, second, alike).distance
        found = []
        for distances in views.values():
            for first, second in _clear_pairs(distances, PARTING * self._distance, facts):
                nearness = self._near[frozenset((first, second))]
                if nearness.near and nearness.stamp - nearness.since >= self._time and self._walk_alike(first, second):
                    found += self._link(facts, first, second)
        return found

    def _hand_over(self, facts: Mapping[str, CameraPerson]) -> List[CrossCameraLink]:
        present = {fact.representative for fact in facts.values() if fact.present}
        lost: Dict[str, str] = {}
        for key, fact in facts.items():
            if fact.representative not in present and key in self._tracks:
                best = lost.get(fact.representative)
                if best is None or self._tracks[best].ended < self._tracks[key].ended:
                    lost[fact.representative] = key
        new = [key for key, fact in facts.items() if fact.present and fact.anonymous and self._is_new(key)]
        apart = {(old, young): distance for old in lost.values() for young in new
                 for distance in (self._jump(old, young),)
                 if distance is not None and self._may_join(facts, old, young)}
        return [link for old, young in _clear_pairs(apart, HANDOVER_M, facts)
                for link in self._link(facts, facts[old].representative, young)]

    def _jump(self, old: str, young: str) -> Optional[float]:
        """Distance (m) of where somebody new came up from where a lost person must be by then; None if out of the
        question.

        Ways that grow with the time out of sight are taken off.
        """
        before, after = self._tracks[old], self._tracks[young]
        away = after.began - before.ended
        if not -SETTLING_S <= away <= self._handover or after.sensor == before.sensor:
            return None
        distance = math.dist(before.expected(after.began), after.start) - HANDOVER_GROWTH_MPS * max(0.0, away)
        return max(0.0, distance) if distance <= HANDOVER_M else None

    def _compare(self, first: str, second: str, alike: bool = False) -> _Nearness:
        """Smoothed distance of two persons that are both seen now.

        Two that are joined, or that look alike to a recogniser, may be farther apart.
        """
        pair = frozenset((first, second))
        one, other = self._tracks[first], self._tracks[second]
        stamp = min(one.ended, other.ended)
        distance = math.dist(one.expected(stamp), other.expected(stamp))
        limit = self._distance * (PARTING if alike or pair in self._links else 1.0)
        known = self._near.get(pair)
        if known is None or stamp < known.stamp:
            self._near[pair] = _Nearness(distance, stamp, stamp, distance <= limit)
        elif stamp > known.stamp:
            if stamp - known.stamp > FRESH_S:
                known.since = stamp
            known.distance += (1.0 - math.exp(-2.0 * (stamp - known.stamp) / max(self._time, 1e-3))) * (
                distance - known.distance)
            near = known.distance <= limit
            known.since = known.since if near == known.near else stamp
            known.near, known.stamp = near, stamp
        return self._near[pair]

    def _link(self, facts: Mapping[str, CameraPerson], first: str, second: str) -> List[CrossCameraLink]:
        # An earlier link of this round may stand against it.
        if not self._may_join(facts, first, second):
            return []
        pair = frozenset((first, second))
        self._links.add(pair)
        self._near.pop(pair, None)
        return [CrossCameraLink(first, second, LIKELIHOOD)]

    def _may_join(self, facts: Mapping[str, CameraPerson], first: str, second: str) -> bool:
        """Tell whether nobody joined with one of them, now or so far, has been seen beside somebody joined with the
        other."""
        one, other = self._joined(facts, first), self._joined(facts, second)
        return not one & other and not any(self._are_two(facts[a], facts[b]) for a in one for b in other)

    def _joined(self, facts: Mapping[str, CameraPerson], person_id: str) -> Set[str]:
        representative = facts[person_id].representative
        found = {key for key, fact in facts.items() if fact.representative == representative}
        return found | {end for pair in self._links if pair & found for end in pair}

    def _are_two(self, first: CameraPerson, second: CameraPerson, tolerance: float = 0.0) -> bool:
        """Tell whether two persons cannot be one: named differently by one sensor, or seen at once for `tolerance`
        s."""
        if not first.names & second.names and any(
                self._named_by.get(a, _NOBODY) & self._named_by.get(b, _NOBODY) for a in first.names
                for b in second.names):
            return True
        one, other = self._tracks.get(first.id), self._tracks.get(second.id)
        return one is not None and other is not None and one.overlap(other) > tolerance

    def _walk_alike(self, first: str, second: str) -> bool:
        return math.dist(self._tracks[first].velocity, self._tracks[second].velocity) <= ALIKE_MPS

    def _is_fresh(self, person_id: str) -> bool:
        track = self._tracks.get(person_id)
        return track is not None and self._newest - track.ended <= FRESH_S

    def _is_new(self, person_id: str) -> bool:
        return self._is_fresh(person_id) and SETTLING_S <= self._tracks[person_id].length <= NEW_S


def _clear_pairs(distances: Mapping[Tuple[str, str], float], limit: float,
                 facts: Mapping[str, CameraPerson]) -> List[Tuple[str, str]]:
    """Pair up so that all is least, and leave out the pairs that might as well be others.

    distances: m, of the pairs that are possible; none is paired beyond `limit` m.
    """
    rows = sorted({first for first, _ in distances})
    columns = sorted({second for _, second in distances})
    cost = np.full((len(rows), len(columns)), np.inf)
    for (first, second), distance in distances.items():
        cost[rows.index(first), columns.index(second)] = distance
    chosen = []
    for row, column in assign(cost, limit):
        pair = (rows[row], columns[column])
        representatives = {facts[key].representative for key in pair}
        rivals = [value for other, value in distances.items()
                  if len({facts[key].representative for key in other} & representatives) == 1]
        if min(rivals, default=math.inf) >= cost[row, column] + CLEARER_BY_M:
            chosen.append(pair)
    return chosen
