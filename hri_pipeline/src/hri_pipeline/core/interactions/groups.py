"""Who stands together over time: groups with stable ids, from the F-formations of each moment (formations.py).

`GroupTracker` joins people who were in one formation for most of the last seconds, and keeps the ids of groups.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Collection, Deque, Dict, List, Optional, Sequence, Set, Tuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.sparse.csgraph import connected_components

from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.interactions.formations import (
    Votes,
    formations_of,
    groups_of,
    membership,
    middles_of,
    votes_of,
)
from hri_pipeline.core.interactions.parameters import GroupSettings
from hri_pipeline.core.interactions.people import ROBOT, GazeTarget, PeopleSnapshot
from hri_pipeline.core.timing import JUMP_BACK_S

_STAMP_S = 1e-3         # stamps that are nearer to each other are taken for the same
_OPPOSITE = math.pi / 2.0
_MAJORITY = 0.5
_PATH_S = 1.05           # over which a velocity is measured: three measurements at least
_WALK_S = 2.1            # over which the velocities of those who walk are measured, which are compared more closely
_WALKING_SPEED = 0.5
_BESIDE, _SAME_PACE = 1.15, 0.25
"""Who walks faster (m/s) than the first is with those who are so near (m) and whose velocity differs by so little
(m/s), and with those who are with these. Groups walk abreast or in a V, some 0.8 m apart (M. Moussaid et al., PLoS ONE
5(4), 2010); walkers within 2.1 m whose speeds differ by less than 0.15 m/s were taken for together by C. McPhail and R.
T. Wohlstein (Sociol. Methods Res. 10, 1982), whose films had less noise."""
_WALKING_CONFIDENCE = 0.8
_APART_WEIGHT = 2.0     # a time at which people walk apart counts so much more
_ATTENTION, _LESS_ATTENTION = 0.15, 0.05
"""Share of the last seconds in which one member at least looks at the robot that joins a group, and that stays in
it."""
_LEVEL_PART = 0.2
_STAY_BONUS = 0.1       # share of the time that speaks for those who are in one group already
_SAME_PLACE = 0.3       # who is new so near (m) to where somebody just ceased to be tracked is the same human


@dataclass(frozen=True)
class Individual:
    """Somebody who stands somewhere, seen from above, in the reference frame.

    position: (2,) m; direction: to which the trunk is turned, rad from the x axis towards y, None where it is not
    known; position_sd: m; direction_sd: rad; looks_at_robot: None where it is not known.
    """

    id: str
    position: np.ndarray
    direction: Optional[float] = None
    position_sd: float = 0.1
    direction_sd: float = 0.35
    looks_at_robot: Optional[bool] = None


def individuals_of(people: PeopleSnapshot, head_turn_sd: float, gazes: Optional[Sequence[GazeTarget]] = None
                   ) -> List[Individual]:
    """Return everybody as the tracker takes them. head_turn_sd: see fuse_directions; gazes: who looks at whom, None:
    not known."""
    watchers = None if gazes is None else {gaze.sender for gaze in gazes if gaze.receiver == ROBOT}
    found = []
    for identity, place, trunk, face, (place_sd, face_sd, _, trunk_sd) in zip(
            people.ids, people.heads[:, :2], people.trunks.tolist(), people.faces.tolist(), people.deviations.tolist()):
        direction, sd = fuse_directions(bearing(trunk), trunk_sd, bearing(face), face_sd, head_turn_sd)
        found.append(Individual(identity, place, direction, place_sd, sd,
                                None if watchers is None else identity in watchers))
    return found


def bearing(direction: Sequence[float]) -> Optional[float]:
    """Bearing (rad) of a direction (3,) in the horizontal plane; None where it has none, or is not known (NaN)."""
    x, y = direction[0], direction[1]
    return math.atan2(y, x) if math.hypot(x, y) >= _LEVEL_PART else None


def group_numbers(ids: Sequence[str], groups: Sequence[Group]) -> np.ndarray:
    """Return (N,) the number of the group of each id, -1 for none."""
    numbers = {member: number for number, group in enumerate(groups) for member in group.members}
    return np.array([numbers.get(identity, -1) for identity in ids], dtype=np.int64)


@dataclass(frozen=True)
class Group:
    """A group: id stays while it lasts; members: ids, two at least, sorted; confidence 0 to 1; o_space: (2,) m."""

    id: str
    members: Tuple[str, ...]
    confidence: float
    o_space: np.ndarray


@dataclass
class _Known:
    """A group that is or was; ended: the stamp, None while it is."""

    id: str
    members: frozenset
    begun: float
    ended: Optional[float] = None


def fuse_directions(trunk: Optional[float], trunk_sd: float, head: Optional[float], head_sd: float,
                    head_turn_sd: float = 0.6
                    ) -> Tuple[Optional[float], float]:
    """Return the direction of the trunk and its deviation (rad), (None, inf) where neither is known.

    trunk, head: rad from the x axis towards y, None or not finite where unknown; trunk_sd, head_sd: their deviations;
    head_turn_sd: deviation of heads from their trunks (parameter `group_head_sd`), by which the head says less. Both
    are weighed by their inverse variances on the circle; a head turned by more than a right angle says nothing.
    """
    beside = math.hypot(head_sd, head_turn_sd)
    seen = [(angle, sd) for angle, sd in ((trunk, trunk_sd), (head, beside))
            if angle is not None and math.isfinite(angle) and math.isfinite(sd)]
    if len(seen) == 2 and abs(math.remainder(seen[0][0] - seen[1][0], 2.0 * math.pi)) > _OPPOSITE:
        seen.pop()
    if not seen:
        return None, math.inf
    weights = [1.0 / max(sd, 1e-3) ** 2 for _, sd in seen]
    sine = sum(weight * math.sin(angle) for weight, (angle, _) in zip(weights, seen))
    cosine = sum(weight * math.cos(angle) for weight, (angle, _) in zip(weights, seen))
    return math.atan2(sine, cosine), 1.0 / math.sqrt(sum(weights))


@lru_cache(maxsize=128)
def _pairs(count: int) -> Tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pairs of so many, each once; numpy takes longer to make them than all that is done with
    them."""
    return np.triu_indices(count, 1)


def _linked(near: np.ndarray) -> np.ndarray:
    """Return the label (N,) of each, by average linkage of the shares (N, N), 0 to 1, cut at one half."""
    joined = near >= _MAJORITY
    joined.reshape(-1)[::len(near) + 1] = True
    labels = joined.argmax(axis=1)
    # Mostly all pairs agree; then the linkage would give the same groups.
    if (joined == (labels[:, None] == labels)).all():
        return labels
    return fcluster(linkage(1.0 - near[_pairs(len(near))], "average"), _MAJORITY, "distance")


def _velocity(path: Sequence[Tuple[float, float, float]]) -> Tuple[float, float]:
    """Return the velocity (m/s) of a line through (stamp s, x, y m): least squares; NaN for less than three."""
    if len(path) < 3:
        return math.nan, math.nan
    # Relative to the first: sums of squares lose nothing there.
    (begin, left, low), count = path[0], len(path)
    times = xs = ys = squares = along_x = along_y = 0.0
    for at, x, y in path:
        at, x, y = at - begin, x - left, y - low
        times, xs, ys = times + at, xs + x, ys + y
        squares, along_x, along_y = squares + at * at, along_x + at * x, along_y + at * y
    square = squares - times * times / count
    return (along_x - times * xs / count) / square, (along_y - times * ys / count) / square


class GroupTracker:
    """Groups over time, from the formations at each time.

    Two people are together when they stood in one formation for most of the last seconds (a mean with the time constant
    `group_time`, over the time that both were seen) and did not walk apart or past each other; groups are the average
    linkage of these shares, cut at one half.
    A group goes on under its id when two of its members at least are in one group again; where it splits, the part with
    the largest share of common members (Jaccard) has the id, of equals the part without the robot, and of groups that
    merge the one with the largest share, the older of equals, gives it. A group that ended less than `group_hold_time`
    ago comes back under its id. Whose id changes (somebody is recognised) stays a member.
    """

    def __init__(self, settings: GroupSettings, seed: Optional[int] = None) -> None:
        self._settings = settings
        self._ids = IdGenerator(seed)
        self.reset()

    def reconfigure(self, settings: GroupSettings) -> None:
        """Take up the values of the live parameters."""
        self._settings = settings

    def reset(self) -> None:
        """Forget everybody; ids are not used again."""
        self._stamp: Optional[float] = None
        self._people: List[str] = []
        self._individuals: Dict[str, Individual] = {}
        self._paths: Dict[str, Deque[Tuple[float, float, float]]] = {}
        self._attention: Dict[str, float] = {}
        self._seen = np.zeros(0)
        # Of each pair: share of the time in one formation, mean confidence in it, time that both were seen (s).
        self._shares, self._confidences, self._times = (np.zeros((0, 0)) for _ in range(3))
        self._known: List[_Known] = []
        self._groups: List[Group] = []
        self._gone: Set[str] = set()

    def retain(self, ids: Collection[str]) -> List[Group]:
        """Take everybody but these persons and the robot out of the groups at once; return those that are left.

        Who comes back within `group_hold_time`, also under another id at the same place, is a member again.
        """
        self._gone = {person for person in self._people if person != ROBOT and person not in ids}
        if any(member in self._gone for group in self._groups for member in group.members):
            left = [replace(group, members=tuple(member for member in group.members if member not in self._gone))
                    for group in self._groups]
            self._groups = [group for group in left if len(group.members) > 1]
        return list(self._groups)

    def update(self, people: Sequence[Individual], stamp: float) -> List[Group]:
        """Return the groups at a time.

        Members who are not seen stay for `group_hold_time`.

        Parameters
        ----------
        people: sequence of Individual
            Everybody who is seen, the robot perhaps included. Those whose position is not finite are left out.
        stamp: float
            Time (s) of the image. Less than `group_period` after the last one that was used nothing changes; one far
            older starts afresh.

        Raises
        ------
        ValueError
            When an id is there twice or the stamp is not finite.
        """
        if not math.isfinite(stamp):
            raise ValueError("the stamp {} is not finite".format(stamp))
        seen = [person for person in people if all(map(math.isfinite, person.position))]
        if len({person.id for person in seen}) < len(seen):
            raise ValueError("an id is there twice: {}".format(", ".join(sorted(person.id for person in seen))))
        if self._stamp is not None and stamp < self._stamp - JUMP_BACK_S:
            self.reset()
        if self._stamp is not None and stamp < self._stamp + max(self._settings.group_period,
                                                                 _STAMP_S) - _STAMP_S / 2.0:
            return list(self._groups)
        step = 0.0 if self._stamp is None else min(stamp - self._stamp, self._settings.group_hold_time)
        self._stamp = stamp
        self._follow(seen, stamp)
        self._attend(seen, step)
        votes = self._votes()
        if seen:
            places = {person: row for row, person in enumerate(self._people)}
            self._learn([places[person.id] for person in seen], votes, step)
        self._groups = self._name(self._members(), votes, stamp)
        return list(self._groups)

    def _follow(self, seen: Sequence[Individual], stamp: float) -> None:
        """Forget those who have not been seen for `group_hold_time`, add the new, and note the seen."""
        stays = stamp - self._seen <= self._settings.group_hold_time + self._settings.group_period
        if not stays.all():
            for identity in (identity for identity, stay in zip(self._people, stays) if not stay):
                del self._individuals[identity], self._paths[identity]
                self._attention.pop(identity, None)
                self._gone.discard(identity)
            self._people = [person for person, stay in zip(self._people, stays) if stay]
            self._seen = self._seen[stays]
            self._shares, self._confidences, self._times = (
                table[np.ix_(stays, stays)] for table in (self._shares, self._confidences, self._times))
        for person in seen:
            if self._gone and person.id not in self._individuals:
                self._take_over(person)
        fresh = [person.id for person in seen if person.id not in self._individuals]
        if fresh:
            self._people += fresh
            self._seen = np.append(self._seen, np.full(len(fresh), stamp))
            self._shares, self._confidences, self._times = (
                np.pad(table, (0, len(fresh))) for table in (self._shares, self._confidences, self._times))
        self._individuals.update((person.id, person) for person in seen)
        for person in seen:
            path = self._paths.setdefault(person.id, deque())
            path.append((stamp, float(person.position[0]), float(person.position[1])))
            while stamp - path[0][0] > _WALK_S:
                path.popleft()
        present = {person.id for person in seen}
        self._gone -= present
        self._seen[[person in present for person in self._people]] = stamp

    def _take_over(self, person: Individual) -> None:
        """Go on under a new id with who stood nearest to there and is not tracked any more, if that was near enough."""
        def apart(name: str) -> float:
            return float(np.linalg.norm(self._individuals[name].position - person.position))

        before = min(self._gone, key=apart)
        if apart(before) > _SAME_PLACE:
            return
        self._gone.remove(before)
        self._people[self._people.index(before)] = person.id
        self._individuals[person.id] = self._individuals.pop(before)
        self._paths[person.id] = self._paths.pop(before)
        self._attention[person.id] = self._attention.pop(before, 0.0)
        for known in self._known:
            known.members = frozenset(person.id if member == before else member for member in known.members)

    def _attend(self, seen: Sequence[Individual], step: float) -> None:
        """Update the share of the time in which each looks at the robot; 1 where it is not known."""
        gain = 1.0 - math.exp(-step / max(self._settings.group_time, 1e-3))
        for person in seen:
            share = self._attention.get(person.id, 0.0)
            known = person.looks_at_robot is not None
            self._attention[person.id] = share + gain * (bool(person.looks_at_robot) - share) if known else 1.0

    def _with_attention(self, groups: List[List[int]]) -> List[List[int]]:
        """Return the groups without the robot where none of the members looks at it: it only stands there."""
        if ROBOT not in self._people:
            return groups
        robot = self._people.index(ROBOT)
        least = _LESS_ATTENTION if any(ROBOT in group.members for group in self._groups) else _ATTENTION
        found = []
        for group in groups:
            if robot in group and all(self._attention.get(self._people[row], 0.0) < least
                                      for row in group if row != robot):
                group = [row for row in group if row != robot]
            if len(group) > 1:
                found.append(group)
        return found

    def _learn(self, rows: Sequence[int], votes: Votes, step: float) -> None:
        """Update the shares of the pairs of people in `rows` with the formations of this time."""
        formations = formations_of(votes.of(rows), self._settings)
        within = membership([formation.members for formation in formations], len(rows))
        together = within @ within.T
        confidence = (within * [formation.confidence for formation in formations]) @ within.T
        pairs: Any = np.ix_(rows, rows)
        if rows == list(range(len(self._people))):
            pairs = (slice(None), slice(None))
        self._walk(rows, together, confidence)
        apart = self._walking_apart(rows)
        together[apart], confidence[apart] = 0.0, 0.0
        before = self._times[pairs]
        times = before + step
        # A plain mean at first, then one that forgets.
        weights = np.where(times > 0.0, step / np.maximum(times, 1e-9), 1.0)
        weights = np.maximum(weights, 1.0 - math.exp(-step / max(self._settings.group_time, 1e-3)))
        weights[before <= 0.0] = 1.0
        weights = np.where(apart, np.minimum(1.0, _APART_WEIGHT * weights), weights)
        self._shares[pairs] += weights * (together - self._shares[pairs])
        self._confidences[pairs] += weights * (confidence - self._confidences[pairs])
        self._times[pairs] = times

    def _walk(self, rows: Sequence[int], together: np.ndarray, confidence: np.ndarray) -> None:
        """Set for those of the people in `rows` who walk with whom they are together: they look ahead, not at each
        other."""
        velocities = self._velocities(rows, _WALK_S)
        walking = np.minimum(np.abs(velocities), np.abs(self._velocities(rows, _PATH_S))) > _WALKING_SPEED
        if walking.sum() < 2:
            return
        places = np.array([complex(*self._paths[self._people[row]][-1][1:]) for row in rows])
        beside = ((np.abs(places[:, None] - places) < _BESIDE) & (np.abs(velocities[:, None] - velocities) < _SAME_PACE)
                  & walking[:, None] & walking)
        _, parts = connected_components(beside, directed=False)
        both = walking[:, None] & walking
        same = (parts[:, None] == parts)[both]
        together[both], confidence[both] = same, _WALKING_CONFIDENCE * same

    def _velocities(self, rows: Sequence[int], seconds: float) -> np.ndarray:
        """Return the velocities (N,) of the people in `rows` over the last seconds, m/s, x + iy; NaN for
        less than three places."""
        paths = (self._paths[self._people[row]] for row in rows)
        return np.array([complex(*_velocity([point for point in path if path[-1][0] - point[0] <= seconds]))
                         for path in paths])

    def _walking_apart(self, rows: Sequence[int]) -> np.ndarray:
        """Return for each pair (N, N) of the people in `rows` whether one moves against the other faster than
        `group_speed`."""
        speeds = self._velocities(rows, _PATH_S)
        return np.abs(speeds[:, None] - speeds) > self._settings.group_speed

    def _votes(self) -> Votes:
        """Return the votes of everybody, in the order of the rows."""
        people = [self._individuals[person] for person in self._people]
        directions = np.array([math.nan if person.direction is None else person.direction for person in people])
        return votes_of(np.array([person.position for person in people], dtype=np.float64).reshape(-1, 2), directions,
                        np.array([max(person.direction_sd, 0.0) for person in people]), self._settings,
                        np.array([person.position_sd for person in people]))

    def _members(self) -> List[List[int]]:
        """Return the groups, as rows: the average linkage of the pairs' shares."""
        if len(self._people) < 2:
            return []
        grouped = np.full(len(self._people), -1)
        rows = {person: row for row, person in enumerate(self._people)}
        for number, group in enumerate(self._groups):
            grouped[[rows[person] for person in group.members if person in rows]] = number
        near = np.where(self._times >= self._settings.group_delay - 1e-9, self._shares, 0.0)
        near = near + _STAY_BONUS * ((grouped[:, None] == grouped) & (grouped >= 0))
        if self._gone:
            gone = np.array([person in self._gone for person in self._people])
            near[gone[:, None] | gone] = 0.0
        return self._with_attention(groups_of(_linked(np.minimum(near, 1.0))))

    def _name(self, groups: Sequence[Sequence[int]], votes: Votes, stamp: float) -> List[Group]:
        """Return the groups with the ids that they had, or new ones, and remember those that end."""
        self._known = [known for known in self._known
                       if known.ended is None or stamp - known.ended <= self._settings.group_hold_time]
        members = [frozenset(self._people[row] for row in group) for group in groups]
        owners = self._owners(members)
        for number, known in enumerate(self._known):
            if number not in owners.values():
                known.ended = stamp if known.ended is None else known.ended
        middles, confidences = middles_of(votes, groups), self._mean_confidences(groups)
        found = []
        for index in range(len(groups)):
            if index in owners:
                known = self._known[owners[index]]
            else:
                known = _Known(self._ids.new(), members[index], stamp)
                self._known.append(known)
            known.members, known.ended = members[index], None
            found.append(Group(known.id, tuple(sorted(members[index])), confidences[index], middles[index]))
        return found

    def _mean_confidences(self, groups: Sequence[Sequence[int]]) -> List[float]:
        """Return the mean over the pairs of each group."""
        if not groups:
            return []
        within = membership(groups, len(self._people))
        sizes = within.sum(axis=0)
        each = ((self._confidences @ within) * within).sum(axis=0) - self._confidences.diagonal() @ within
        return (each / (sizes * (sizes - 1.0))).tolist()

    def _owners(self, members: Sequence[frozenset]) -> Dict[int, int]:
        """Return the number of the known group, of those with two common members at least, that each set goes on:
        the pairs with the largest share of common members first."""
        pairs = []
        for index, ours in enumerate(members):
            for number, known in enumerate(self._known):
                common = len(ours & known.members)
                if common > 1:
                    pairs.append((-common / len(ours | known.members), known.ended is not None, ROBOT in ours,
                                  known.begun, index, number))
        owners: Dict[int, int] = {}
        for *_, index, number in sorted(pairs):
            if index not in owners and number not in owners.values():
                owners[index] = number
        return owners
