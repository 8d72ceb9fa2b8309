"""F-formations: who stands together at one time.

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
- A heading errs by the more metres the farther ahead the middle is, so that wide circles would fall apart. All vote a
  second time, for a middle farther ahead: four and more people around an empty space are one circle where that costs
  less than the groups which they are otherwise in.
- Who has somebody of the group between himself and the middle is no member: the space is shared by those who see it
  (the visibility constraint of GCFF).
- It is minimised by joining the two groups that gain most (J. H. Ward, "Hierarchical grouping to optimize an objective
  function", JASA 58, 1963), and then by moving single people, instead of by graph cuts.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
from scipy.special import log_ndtr

from hri_pipeline.core.interactions.parameters import GroupSettings

# A group has a middle (x, y) and a size r, by which its circle is wider than `group_stride`; all three are normal, and
# the information about them adds up over the members. Rows of the tables (12, ...) below: information matrix (xx, xy,
# yy), information vector (x, y), the same of the size (xr, yr, rr, r), squares of the votes in the metric of their
# information, log |covariance|, people. With the squares, log |covariance| and people in one row: (10, ...).
_LEAST_SD = 0.02
"""m; no position of a person is known better."""
_HIDDEN_ANGLE, _HIDDEN_DEPTH = 0.3, 0.6
"""A member hides the middle of the group from who is in the same direction from it (rad; half of the shoulders, at
0.75 m) and so much farther away (m): more than places err."""
_WIDE_STRIDE, _WIDE_SIZE_SD, _WIDE_PEOPLE = 0.4, 0.2, 4
"""Wide circles: how much farther ahead their middle is than that of others, with its standard deviation (m), and the
least people: two and three are found anyhow."""
_OPEN = 0.8
"""The o-space of a wide circle is empty: nobody is nearer to its middle than this part of the mean distance. Of true
ones mostly .8 to .99, of others .3 to .8."""


class FFormation(NamedTuple):
    """members: rows (two at least, rising); o_space: (2,) m, the middle of the space that they share; confidence 0 to
    1."""

    members: List[int]
    o_space: np.ndarray
    confidence: float


class Votes(NamedTuple):
    """Votes of everybody for the middle and the size of the group: table (12, N) as above, relative to `middle` (2,) m.

    stride: distance (m) ahead at which the middle is expected; size: information about the size of any group
    beforehand, 1 / m^2; places: (N, 2) m of the people, relative to `middle`; wide: the votes for wide circles.
    """

    table: np.ndarray
    middle: np.ndarray
    stride: float
    size: float
    places: np.ndarray
    wide: Optional[Votes] = None

    def of(self, rows: Sequence[int]) -> Votes:
        """Return those of some of the people, in this order."""
        return self._replace(table=self.table[:, list(rows)], places=self.places[list(rows)],
                             wide=self.wide and self.wide.of(rows))


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
    votes = Votes(_votes(positions - middle, directions, angles, places, settings), middle, settings.group_stride,
                  1.0 / max(settings.group_size_sd, _LEAST_SD) ** 2, positions - middle)
    farther = replace(settings, group_stride=settings.group_stride + _WIDE_STRIDE)
    return votes._replace(wide=votes._replace(
        table=_votes(votes.places, directions, angles, places, farther), stride=farther.group_stride,
        size=_WIDE_SIZE_SD ** -2))


def find_formations(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: GroupSettings,
                    position_sds: Optional[np.ndarray] = None) -> List[FFormation]:
    """Return the groups of two and more people.

    The arguments and the errors are those of votes_of; settings: `group_room` (m^2) as well.
    """
    return formations_of(votes_of(positions, directions, direction_sds, settings, position_sds), settings)


def formations_of(votes: Votes, settings: GroupSettings) -> List[FFormation]:
    """Return the groups of two and more people. settings: `group_room` (m^2) of the interactions node."""
    per_person = math.log(2.0 * math.pi / settings.group_room)
    rows, circles = list(range(votes.table.shape[1])), []
    groups, cost = _partition(votes, rows, per_person)
    if votes.wide is not None and len(rows) >= _WIDE_PEOPLE:
        for circle in _partition(votes.wide, rows, per_person)[0]:
            if len(circle) < _WIDE_PEOPLE or not _is_open(votes.places[circle]):
                continue
            left = [row for row in rows if row not in circle]
            others, cost_without = _partition(votes, left, per_person)
            if float(_costs_of(votes.wide, [circle], per_person)[0]) + cost_without < cost:
                circles.append(circle)
                rows, groups, cost = left, others, cost_without
    found = _formations(votes, groups, per_person)
    if votes.wide is not None:
        found += _formations(votes.wide, circles, per_person)
    return sorted(found, key=lambda formation: formation.members)


def _partition(votes: Votes, rows: Sequence[int], per_person: float) -> Tuple[List[List[int]], float]:
    """Return the groups of some of the people, as rows of all, and what they cost together.

    per_person: log of 2 pi by `group_room`.
    """
    if len(rows) < 2:
        return [], 0.0
    prior, table = _Prior(per_person, votes.stride, votes.size), _summable(votes, per_person)[:, list(rows)]
    groups = [[rows[row] for row in group] for group in groups_of(_moved(table, _joined(table, prior), prior))]
    return groups, float(_costs_of(votes, groups, per_person).sum())


def _summable(votes: Votes, per_person: float) -> np.ndarray:
    """Return the table (10, N): what adds up to the cost without further ado is one row."""
    table = votes.table
    return np.concatenate([table[:9], (table[9] + table[10] + 2.0 * per_person * table[11])[None]])


def _costs_of(votes: Votes, groups: Sequence[Sequence[int]], per_person: float) -> np.ndarray:
    """Return the cost (G,) of groups, rows of the votes."""
    totals = _summable(votes, per_person) @ membership(groups, votes.table.shape[1])
    return _cost(totals, _Prior(per_person, votes.stride, votes.size))


def _is_open(places: np.ndarray) -> bool:
    """Whether the people at `places` (N, 2) m leave the space between them empty."""
    distances = np.linalg.norm(places - places.mean(axis=0), axis=1)
    return bool(distances.min() > _OPEN * distances.mean())


def _formations(votes: Votes, groups: Sequence[List[int]], per_person: float) -> List[FFormation]:
    """Return the groups (rows of the votes) of those who see the middle, with their middles and confidences."""
    groups = _in_view(groups, votes.places, middles_of(votes, groups) - votes.middle)
    found = zip(groups, middles_of(votes, groups), _costs_of(votes, groups, per_person).tolist())
    return [FFormation(members, centre, 1.0 / (1.0 + math.exp(-min(-cost / (len(members) - 1), 50.0))))
            for members, centre, cost in found]


def _in_view(groups: Sequence[List[int]], places: np.ndarray, centres: np.ndarray) -> List[List[int]]:
    """Return the groups without those from whom another member hides the middle.

    groups: rows of places (N, 2) m; centres: (G, 2) m of their middles.
    """
    found = []
    for group, centre in zip(groups, centres):
        ways = places[group] - centre
        distances, bearings = np.hypot(ways[:, 0], ways[:, 1]), np.arctan2(ways[:, 1], ways[:, 0])
        turns = np.abs((bearings[:, None] - bearings + np.pi) % (2.0 * np.pi) - np.pi)
        hidden = ((turns < _HIDDEN_ANGLE) & (distances[:, None] > distances + _HIDDEN_DEPTH)).any(axis=1)
        found.append([row for row, behind in zip(group, hidden.tolist()) if not behind])
    return [group for group in found if len(group) > 1]


def groups_of(labels: np.ndarray) -> List[List[int]]:
    """Return the rows of each label (N,) that two and more have, rising, in the order of their first rows."""
    rows: Dict[int, List[int]] = {}
    for row, label in enumerate(labels.tolist()):
        rows.setdefault(label, []).append(row)
    return [group for group in rows.values() if len(group) > 1]


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
