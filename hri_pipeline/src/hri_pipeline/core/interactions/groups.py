"""Who stands together: F-formations at one time, and groups with stable ids over time.

People who talk stand so that each has the same space ahead, the o-space (A. Kendon, Conducting Interaction, 1990). Each
vote for where its middle is; a group is a set of people whose votes agree better than votes of strangers do.

- The votes are those of Hough voting: Gaussians ahead of each person, as wide as position and orientation are uncertain
  (M. Cristani et al., "Social interaction discovery by statistical analysis of F-formations", BMVC 2011). They are kept
  as Gaussians, not as samples.
- What is minimised is the cost of GCFF: squared distances from the votes to the middle of the group, and a constant for
  each group, as in a description of minimum length (F. Setti et al., "F-formation detection: individuating
  free-standing conversational groups in images", PLoS ONE 10(5), 2015). With Gaussians it is the logarithm of a Bayes
  factor: the density with which the votes share one middle, against middles that lie anywhere in `group_room` square
  metres.
- A group has a size, too: its members have the middle at the same distance ahead, more or less. So circles of any size
  are found without taking strangers for members of small ones.
- It is minimised by joining the two groups that gain most (J. H. Ward, "Hierarchical grouping to optimize an objective
  function", JASA 58, 1963), and then by moving single people, instead of by graph cuts.
- `GroupTracker` joins people who were in one formation for most of the last seconds, and keeps the ids of groups.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Deque, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.special import log_ndtr

from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.interactions.parameters import GroupSettings
from hri_pipeline.core.tracks import assign

ROBOT = ""
"""Id of the robot as a member of a group."""

_JUMP_BACK_S = 0.5
_STAMP_S = 1e-3         # stamps that are nearer to each other are taken for the same
_OPPOSITE = math.pi / 2.0
_MAJORITY = 0.5
_PATH_S = 1.05           # over which a velocity is measured: three measurements at least
_APART_WEIGHT = 2.0     # a time at which people walk apart counts so much more
_STAY_BONUS = 0.1       # share of the time that speaks for those who are in one group already


@dataclass(frozen=True)
class Individual:
    """Somebody who stands somewhere, seen from above, in the reference frame.

    position: (2,) m; direction: to which the trunk is turned, rad from the x axis towards y, None where it is not
    known; position_sd: m; direction_sd: rad.
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
    """Return the velocity (m/s) of a line through (stamp s, x, y m): least squares; 0 for less than three."""
    if len(path) < 3:
        return 0.0, 0.0
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
    the largest share of common members (Jaccard) has the id, and of groups that merge the one with the largest share,
    the older of equals, gives it. A group that ended less than `group_hold_time` ago comes back under its id.
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
        self._seen = np.zeros(0)
        # Of each pair: share of the time in one formation, mean confidence in it, time that both were seen (s).
        self._shares, self._confidences, self._times = (np.zeros((0, 0)) for _ in range(3))
        self._known: List[_Known] = []
        self._groups: List[Group] = []

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
        if self._stamp is not None and stamp < self._stamp - _JUMP_BACK_S:
            self.reset()
        if self._stamp is not None and stamp < self._stamp + max(self._settings.group_period,
                                                                 _STAMP_S) - _STAMP_S / 2.0:
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

    def _follow(self, seen: Sequence[Individual], stamp: float) -> None:
        """Forget those who have not been seen for `group_hold_time`, add the new, and note the seen."""
        stays = stamp - self._seen <= self._settings.group_hold_time + self._settings.group_period
        if not stays.all():
            for identity in (identity for identity, stay in zip(self._people, stays) if not stay):
                del self._individuals[identity], self._paths[identity]
            self._people = [person for person, stay in zip(self._people, stays) if stay]
            self._seen = self._seen[stays]
            self._shares, self._confidences, self._times = (
                table[np.ix_(stays, stays)] for table in (self._shares, self._confidences, self._times))
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
            while stamp - path[0][0] > _PATH_S:
                path.popleft()
        present = {person.id for person in seen}
        self._seen[[person in present for person in self._people]] = stamp

    def _learn(self, rows: Sequence[int], votes: Votes, step: float) -> None:
        """Update the shares of the pairs of people in `rows` with the formations of this time."""
        formations = formations_of(votes.of(rows), self._settings)
        within = membership([formation.members for formation in formations], len(rows))
        together = within @ within.T
        confidence = (within * [formation.confidence for formation in formations]) @ within.T
        pairs: Any = np.ix_(rows, rows)
        if rows == list(range(len(self._people))):
            pairs = (slice(None), slice(None))
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
        """Return for each pair (N, N) of the people in `rows` whether one moves against the other faster than
        `group_speed`."""
        speeds = np.array([complex(*_velocity(self._paths[self._people[row]])) for row in rows])
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


# A group has a middle (x, y) and a size r, by which its circle is wider than `group_stride`; all three are normal, and
# the information about them adds up over the members. Rows of the tables (12, ...) below: information matrix (xx, xy,
# yy), information vector (x, y), the same of the size (xr, yr, rr, r), squares of the votes in the metric of their
# information, log |covariance|, people. With the squares, log |covariance| and people in one row: (10, ...).
_LEAST_SD = 0.02
"""m; no position of a person is known better."""


class FFormation(NamedTuple):
    """members: rows (two at least, rising); o_space: (2,) m, the middle of the space that they share; confidence 0 to
    1."""

    members: List[int]
    o_space: np.ndarray
    confidence: float


class Votes(NamedTuple):
    """Votes of everybody for the middle and the size of the group: table (12, N) as above, relative to `middle` (2,) m.

    size: information about the size of any group beforehand, 1 / m^2.
    """

    table: np.ndarray
    middle: np.ndarray
    size: float

    def of(self, rows: Sequence[int]) -> Votes:
        """Return those of some of the people, in this order."""
        return Votes(self.table[:, list(rows)], self.middle, self.size)


def votes_of(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: GroupSettings,
             position_sds: Optional[np.ndarray] = None) -> Votes:
    """Return the votes of everybody, for formations_of and middles_of.

    Parameters
    ----------
    positions: (N, 2) array
        Places (m) seen from above.
    directions: (N,) array
        Directions (rad) of the trunks from the x axis towards y, NaN where not known.
    direction_sds: (N,) array
        Their standard deviations (rad).
    settings: GroupSettings
        `group_stride`, `group_size_sd`, `group_depth` and `group_width` (m) of the interactions node.
    position_sds: (N,) array or None
        Standard deviations (m) of the places; None: exact.

    Raises
    ------
    ValueError
        For shapes that do not fit, positions that are not finite, and negative deviations.
    """
    positions, directions, angles, places = _checked(positions, directions, direction_sds, position_sds)
    middle = positions.mean(axis=0) if len(positions) else np.zeros(2)
    return Votes(_votes(positions - middle, directions, angles, places, settings), middle,
                 1.0 / max(settings.group_size_sd, _LEAST_SD) ** 2)


def find_formations(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: GroupSettings,
                    position_sds: Optional[np.ndarray] = None) -> List[FFormation]:
    """Return the groups of two and more people.

    The arguments and the errors are those of votes_of; settings: `group_room` (m^2) as well.
    """
    return formations_of(votes_of(positions, directions, direction_sds, settings, position_sds), settings)


def formations_of(votes: Votes, settings: GroupSettings) -> List[FFormation]:
    """Return the groups of two and more people. settings: `group_room` (m^2) of the interactions node."""
    table = votes.table
    if table.shape[1] < 2:
        return []
    prior = _Prior(math.log(2.0 * math.pi / settings.group_room), settings.group_stride, votes.size)
    # What adds up to the cost without further ado is one row.
    table = np.concatenate([table[:9], (table[9] + table[10] + 2.0 * prior.per_person * table[11])[None]])
    groups = groups_of(_moved(table, _joined(table, prior), prior))
    if not groups:
        return []
    totals = table @ membership(groups, table.shape[1])
    found = zip(groups, _centres(totals, prior.size) + votes.middle, _cost(totals, prior).tolist())
    return [FFormation(members, centre, 1.0 / (1.0 + math.exp(-min(-cost / (len(members) - 1), 50.0))))
            for members, centre, cost in found]


def groups_of(labels: np.ndarray) -> List[List[int]]:
    """Return the rows of each label (N,) that two and more have, rising, in the order of their first rows."""
    rows: Dict[int, List[int]] = {}
    for row, label in enumerate(labels.tolist()):
        rows.setdefault(label, []).append(row)
    return [group for group in rows.values() if len(group) > 1]


def o_spaces(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: GroupSettings,
             groups: Sequence[Sequence[int]], position_sds: Optional[np.ndarray] = None) -> np.ndarray:
    """Return the middles (G, 2) m of the o-spaces of given groups (rows, one at least each).

    The other arguments and the errors are those of votes_of.
    """
    return middles_of(votes_of(positions, directions, direction_sds, settings, position_sds), groups)


def middles_of(votes: Votes, groups: Sequence[Sequence[int]]) -> np.ndarray:
    """Return the middles (G, 2) m of the o-spaces of given groups (rows, one at least each)."""
    if not len(groups):
        return np.zeros((0, 2))
    return _centres(votes.table[:9] @ membership(groups, votes.table.shape[1]), votes.size) + votes.middle


def _checked(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray,
             position_sds: Optional[np.ndarray]
             ) -> Tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    positions = np.asarray(positions, dtype=np.float64).reshape(-1, 2)
    count = len(positions)
    directions, angles = (np.asarray(values, dtype=np.float64).reshape(-1) for values in (directions, direction_sds))
    places = np.zeros(count) if position_sds is None else np.asarray(position_sds, dtype=np.float64).reshape(-1)
    if not len(directions) == len(angles) == len(places) == count:
        raise ValueError("{} positions, {} directions, {} and {} deviations".format(
            count, len(directions), len(angles), len(places)))
    if not np.isfinite(positions).all() or not np.isfinite(places).all():
        raise ValueError("a position or its standard deviation is not finite")
    known = np.isfinite(directions) & np.isfinite(angles)
    if (places < 0.0).any() or (angles[known] < 0.0).any():
        raise ValueError("a standard deviation is negative")
    return positions, np.where(known, directions, 0.0), np.where(known, angles, np.inf), places


def _votes(positions: np.ndarray, directions: np.ndarray, angles: np.ndarray, places: np.ndarray,
           settings: GroupSettings) -> np.ndarray:
    """Return (12, N): the vote of each person for the middle and the size of the group.

    The vote lies `group_stride` and the size of the group ahead, with the deviations `group_depth` along and
    `group_width` across the direction.
    Its moments under a direction that is normal around the circle: E cos = exp(-sd^2 / 2), E cos^2 = (1 + exp(-2 sd^2))
    / 2 (K. V. Mardia, P. E. Jupp, Directional Statistics, 2000, section 3.5.7); without a direction it is round.
    """
    stride, depth, width = settings.group_stride, settings.group_depth ** 2, settings.group_width ** 2
    once, twice = np.exp(-angles ** 2 / 2.0), np.exp(-2.0 * angles ** 2)
    same, other = (1.0 + twice) / 2.0, (1.0 - twice) / 2.0
    noise = np.maximum(places, _LEAST_SD) ** 2
    along = depth * same + width * other + stride ** 2 * (same - once ** 2) + noise
    across = depth * other + width * same + stride ** 2 * other + noise
    cosine, sine = np.cos(directions), np.sin(directions)
    right, left = once * cosine, once * sine
    x, y = positions[:, 0] + stride * right, positions[:, 1] + stride * left
    xx, yy = cosine ** 2 / along + sine ** 2 / across, sine ** 2 / along + cosine ** 2 / across
    xy = cosine * sine * (1.0 / along - 1.0 / across)
    info_x, info_y = xx * x + xy * y, xy * x + yy * y
    sized_x, sized_y = xx * right + xy * left, xy * right + yy * left
    return np.stack([xx, xy, yy, info_x, info_y,
                     sized_x, sized_y, right * sized_x + left * sized_y, right * info_x + left * info_y,
                     info_x * x + info_y * y, np.log(along * across), np.ones(len(x))])


class _Prior(NamedTuple):
    """What is known of a group beforehand.

    per_person: log of 2 pi by `group_room`; stride: distance (m) ahead at which the middle is expected; size:
    information about the size, 1 / m^2.
    """

    per_person: float
    stride: float
    size: float


def _cost(sums: np.ndarray, prior: _Prior) -> np.ndarray:
    """Return the cost (...,) of groups (10, ...): -log of the Bayes factor for one middle and one size against one for
    each; 0 for one.

    The middle lies ahead, not behind: the size is a normal variable above -`stride` only. The last row: squares, log
    |covariance| and twice `per_person` for each of the people.
    """
    xx, xy, yy, x, y, sized = _without_size(sums, prior.size)
    determinant = xx * yy - xy * xy
    centre_x, centre_y = (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant
    explained = x * centre_x + y * centre_y + sums[8] * sums[8] / sized
    # The posterior of the size, of which the vote is the negative, and its variance by the partitioned inverse.
    along_x, along_y = sums[5] / sized, sums[6] / sized
    smaller = sums[8] / sized - along_x * centre_x - along_y * centre_y
    variance = 1.0 / sized + (yy * along_x ** 2 - 2.0 * xy * along_x * along_y + xx * along_y ** 2) / determinant
    ahead = log_ndtr((prior.stride - smaller) / np.sqrt(variance)) - log_ndtr(prior.stride * math.sqrt(prior.size))
    return 0.5 * (sums[9] - explained + np.log(determinant * sized / prior.size)) - prior.per_person - ahead


def _without_size(sums: np.ndarray, size: float) -> Tuple[np.ndarray, ...]:
    """Return the information about the middles (xx, xy, yy, x, y) whatever the sizes, and that about the sizes."""
    xx, xy, yy, x, y, along_x, along_y, sized, moved = sums[:9]
    sized = sized + size
    share_x, share_y = along_x / sized, along_y / sized
    return (xx - along_x * share_x, xy - along_x * share_y, yy - along_y * share_y,
            x - share_x * moved, y - share_y * moved, sized)


def membership(groups: Sequence[Sequence[int]], count: int) -> np.ndarray:
    """Return (count, G) 1 where a row belongs to a group, else 0."""
    within = np.zeros((count, len(groups)))
    for number, group in enumerate(groups):
        within[group, number] = 1.0
    return within


def _centres(totals: np.ndarray, size: float) -> np.ndarray:
    """Return the middles (G, 2) m of groups (9 and more, G)."""
    xx, xy, yy, x, y, _ = _without_size(totals, size)
    return (np.stack([yy * x - xy * y, xx * y - xy * x]) / (xx * yy - xy * xy)).T


def _joined(votes: np.ndarray, prior: _Prior) -> np.ndarray:
    """Return the group (N,) of each person after joining, pair by pair, the groups that gain most."""
    count = votes.shape[1]
    sums, costs, labels, alive = votes.copy(), np.zeros(count), np.arange(count), np.ones(count, dtype=bool)
    gains = _cost(sums[:, :, None] + sums[:, None], prior)
    gains[np.diag_indices(count)] = np.inf
    while True:
        first, second = divmod(int(gains.argmin()), count)
        if not gains[first, second] < 0.0:
            return labels
        costs[first] += costs[second] + gains[first, second]
        sums[:, first] += sums[:, second]
        labels[labels == second] = first
        alive[second] = False
        fresh = np.where(alive, _cost(sums + sums[:, first:first + 1], prior) - costs - costs[first], np.inf)
        fresh[first] = np.inf
        gains[first], gains[:, first] = fresh, fresh
        gains[second], gains[:, second] = np.inf, np.inf


def _moved(votes: np.ndarray, labels: np.ndarray, prior: _Prior) -> np.ndarray:
    """Return the groups (N,) after moving one person at a time to where the cost is least, or out of every group."""
    count = votes.shape[1]
    for _ in range(2 * count):
        names, labels, sizes = np.unique(labels, return_inverse=True, return_counts=True)
        groups = len(names)
        sums = votes @ (labels[:, None] == np.arange(groups))
        alone = sizes[labels] == 1
        left = np.where(alone, votes, sums[:, labels] - votes)
        entered = (sums[:, None] + votes[:, :, None]).reshape(len(votes), -1)
        costs = _cost(np.concatenate([sums, left, entered], axis=1), prior)
        leaving = costs[groups:groups + count] - costs[labels]
        change = costs[groups + count:].reshape(count, groups) - costs[:groups] + leaving[:, None]
        change[np.arange(count), labels] = leaving       # out of every group: what one alone costs is 0
        person, target = divmod(int(change.argmin()), groups)
        if change[person, target] > -1e-9:
            break
        labels[person] = groups if target == labels[person] else target
    return labels
