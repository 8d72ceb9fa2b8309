"""Groups over time: stable ids, joining and leaving."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Deque, Dict, List, Optional, Sequence, Tuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from hri_pipeline.core.assignment import assign
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.interactions.formations import (
    Votes,
    formations_of,
    groups_of,
    membership,
    middles_of,
    votes_of,
)

ROBOT = ""
"""Id of the robot as a member of a group."""

_JUMP_BACK_S = 0.5
_STAMP_S = 1e-3         # stamps that are nearer to each other are of one moment
_OPPOSITE = math.pi / 2.0
_MAJORITY = 0.5
_WAY_S = 1.05           # over which a velocity is measured: three looks at least
_APART_WEIGHT = 2.0     # a moment in which people walk apart counts so much more
_STAY_BONUS = 0.1       # share of the time that speaks for those who are in one group already


@dataclass(frozen=True)
class Stander:
    """Somebody who stands somewhere, seen from above, in the reference frame.

    position: (2,) m; direction: to which the trunk is turned, rad from the x axis towards y, None where it is not known;
    position_sd: m; direction_sd: rad.
    """

    id: str
    position: np.ndarray
    direction: Optional[float] = None
    position_sd: float = 0.1
    direction_sd: float = 0.35


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


def fuse_directions(trunk: Optional[float], trunk_sd: float, head: Optional[float], head_sd: float, head_turn_sd: float = 0.6
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
    """Rows and columns of the pairs of so many, each once; numpy takes longer to make them than all that is done with them."""
    return np.triu_indices(count, 1)


def _linked(near: np.ndarray) -> np.ndarray:
    """Return the label (N,) of each, by average linkage of the shares (N, N), 0 to 1, cut at one half."""
    joined = near >= _MAJORITY
    joined.reshape(-1)[::len(near) + 1] = True
    labels = joined.argmax(axis=1)
    # Mostly all agree who is with whom; then the linkage would say the same.
    if (joined == (labels[:, None] == labels)).all():
        return labels
    return fcluster(linkage(1.0 - near[_pairs(len(near))], "average"), _MAJORITY, "distance")


def _velocity(way: Sequence[Tuple[float, float, float]]) -> Tuple[float, float]:
    """Return the velocity (m/s) of a line through (stamp s, x, y m): least squares; 0 for less than three."""
    if len(way) < 3:
        return 0.0, 0.0
    # Relative to the first: sums of squares lose nothing there.
    (begin, left, low), count = way[0], len(way)
    times = xs = ys = squares = along_x = along_y = 0.0
    for at, x, y in way:
        at, x, y = at - begin, x - left, y - low
        times, xs, ys = times + at, xs + x, ys + y
        squares, along_x, along_y = squares + at * at, along_x + at * x, along_y + at * y
    square = squares - times * times / count
    return (along_x - times * xs / count) / square, (along_y - times * ys / count) / square


class GroupTracker:
    """Groups over time, from the formations of each moment.

    Two people are together when they stood in one formation for most of the last seconds (a mean with the time constant
    `group_time`, over the time that both were seen) and did not walk apart or past each other; groups are the average
    linkage of these shares, cut at one half.
    A group goes on under its id when two of its members at least are in one group again; where it splits, the part with
    the largest share of common members (Jaccard) has the id, and of groups that merge the one with the largest share,
    the older of equals, gives it. A group that ended less than `group_hold_time` ago comes back under its id.
    settings: the parameters `group_*` of the interactions node.
    """

    def __init__(self, settings: SimpleNamespace, seed: Optional[int] = None) -> None:
        self._settings = settings
        self._ids = IdGenerator(seed)
        self.reset()

    def reset(self) -> None:
        """Forget everybody; ids are not used again."""
        self._stamp: Optional[float] = None
        self._people: List[str] = []
        self._standers: Dict[str, Stander] = {}
        self._ways: Dict[str, Deque[Tuple[float, float, float]]] = {}
        self._seen = np.zeros(0)
        # Of each pair: share of the time in one formation, mean confidence in it, time that both were seen (s).
        self._shares, self._confidences, self._times = (np.zeros((0, 0)) for _ in range(3))
        self._known: List[_Known] = []
        self._groups: List[Group] = []

    def update(self, people: Sequence[Stander], stamp: float) -> List[Group]:
        """Return the groups at `stamp` (s of the images' clock), from everybody who is seen, the robot perhaps included.

        People whose position is not finite are left out; members who are not seen stay for `group_hold_time`. A stamp less
        than `group_period` after the last one that was looked at changes nothing, one far older starts afresh.
        Raises ValueError when an id is there twice or the stamp is not finite.
        """
        if not math.isfinite(stamp):
            raise ValueError("the stamp {} is not finite".format(stamp))
        seen = [person for person in people if all(map(math.isfinite, person.position))]
        if len({person.id for person in seen}) < len(seen):
            raise ValueError("an id is there twice: {}".format(", ".join(sorted(person.id for person in seen))))
        if self._stamp is not None and stamp < self._stamp - _JUMP_BACK_S:
            self.reset()
        if self._stamp is not None and stamp < self._stamp + max(self._settings.group_period, _STAMP_S) - _STAMP_S / 2.0:
            return list(self._groups)
        step = 0.0 if self._stamp is None else min(stamp - self._stamp, self._settings.group_hold_time)
        self._stamp = stamp
        self._follow(seen, stamp)
        votes = self._votes()
        if seen:
            places = {person: row for row, person in enumerate(self._people)}
            self._learn([places[person.id] for person in seen], votes, step)
        self._groups = self._name(self._members(), votes, stamp)
        return list(self._groups)

    def _follow(self, seen: Sequence[Stander], stamp: float) -> None:
        """Forget those who have not been seen for `group_hold_time`, add the new, and note the seen."""
        stays = stamp - self._seen <= self._settings.group_hold_time + self._settings.group_period
        if not stays.all():
            for person in (person for person, stay in zip(self._people, stays) if not stay):
                del self._standers[person], self._ways[person]
            self._people = [person for person, stay in zip(self._people, stays) if stay]
            self._seen = self._seen[stays]
            self._shares, self._confidences, self._times = (
                table[np.ix_(stays, stays)] for table in (self._shares, self._confidences, self._times))
        fresh = [person.id for person in seen if person.id not in self._standers]
        if fresh:
            self._people += fresh
            self._seen = np.append(self._seen, np.full(len(fresh), stamp))
            self._shares, self._confidences, self._times = (
                np.pad(table, (0, len(fresh))) for table in (self._shares, self._confidences, self._times))
        self._standers.update((person.id, person) for person in seen)
        for person in seen:
            way = self._ways.setdefault(person.id, deque())
            way.append((stamp, float(person.position[0]), float(person.position[1])))
            while stamp - way[0][0] > _WAY_S:
                way.popleft()
        present = {person.id for person in seen}
        self._seen[[person in present for person in self._people]] = stamp

    def _learn(self, rows: Sequence[int], votes: Votes, step: float) -> None:
        """Take the formations of this moment, of the people in `rows`, into the shares of their pairs."""
        formations = formations_of(votes.of(rows), self._settings)
        within = membership([formation.members for formation in formations], len(rows))
        together = within @ within.T
        confidence = (within * [formation.confidence for formation in formations]) @ within.T
        pairs = np.ix_(rows, rows) if rows != list(range(len(self._people))) else np.s_[:, :]
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

    def _walking_apart(self, rows: Sequence[int]) -> np.ndarray:
        """Return for each pair (N, N) of the people in `rows` whether one moves against the other faster than `group_speed`."""
        speeds = np.array([complex(*_velocity(self._ways[self._people[row]])) for row in rows])
        return np.abs(speeds[:, None] - speeds) > self._settings.group_speed

    def _votes(self) -> Votes:
        """Return the votes of everybody, in the order of the rows."""
        people = [self._standers[person] for person in self._people]
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
        return groups_of(_linked(np.minimum(near, 1.0)))

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
        """Return the number of the known group, of those with two common members at least, that each set goes on."""
        if not members or not self._known:
            return {}
        # Of equal shares the living and then the older is chosen; no such bonus outweighs a share.
        order = sorted(range(len(self._known)), key=lambda number: (
            self._known[number].ended is not None, self._known[number].begun))
        same = {self._known[number].members: number for number in reversed(order)}
        if all(ours in same for ours in members):
            return {index: same[ours] for index, ours in enumerate(members)}
        rank = {number: 1e-3 * place / len(order) for place, number in enumerate(order)}
        cost = np.array([[1.0 - len(ours & known.members) / len(ours | known.members) + rank[number]
                          if len(ours & known.members) > 1 else np.inf
                          for number, known in enumerate(self._known)] for ours in members])
        return dict(assign(cost, 2.0))
