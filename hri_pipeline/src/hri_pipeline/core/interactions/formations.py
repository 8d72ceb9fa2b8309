"""Who stands together: F-formations from positions and orientations.

People who talk stand so that each has the same space ahead, the o-space (A. Kendon, Conducting Interaction, 1990). Each
vote for where its middle is; a group is a set of people whose votes agree better than votes of strangers do.

- The votes are those of Hough voting: Gaussians ahead of each person, as wide as position and orientation are uncertain
  (M. Cristani et al., "Social interaction discovery by statistical analysis of F-formations", BMVC 2011). They are kept
  as Gaussians, not as samples.
- What is minimised is the cost of GCFF: squared distances from the votes to the middle of the group, and a constant for
  each group, as in a description of minimum length (F. Setti et al., "F-formation detection: individuating free-standing
  conversational groups in images", PLoS ONE 10(5), 2015). With Gaussians it is the logarithm of a Bayes factor: the
  density with which the votes share one middle, against middles that lie anywhere in `group_room` square metres.
- It is minimised by joining the two groups that gain most (J. H. Ward, "Hierarchical grouping to optimize an objective
  function", JASA 58, 1963), and then by moving single people, instead of by graph cuts.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

# What is known of a group's middle adds up over its members. Rows of the tables (8, ...) below: information matrix (xx, xy,
# yy), information vector (x, y), squares of the votes in the metric of their information, log |covariance|, people.
_LEAST_SD = 0.02
"""m; no position of a person is known better."""


class Formation(NamedTuple):
    """members: rows (two at least, rising); o_space: (2,) m, the middle of the space that they share; confidence 0 to 1."""

    members: List[int]
    o_space: np.ndarray
    confidence: float


class Votes(NamedTuple):
    """What everybody tells of the middle of the group: table (8, N) as above, relative to `middle` (2,) m."""

    table: np.ndarray
    middle: np.ndarray

    def of(self, rows: Sequence[int]) -> Votes:
        """Return those of some of the people, in this order."""
        return Votes(self.table[:, list(rows)], self.middle)


def votes_of(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: SimpleNamespace,
             position_sds: Optional[np.ndarray] = None) -> Votes:
    """Return the votes of everybody, for formations_of and middles_of.

    positions: (N, 2) m, seen from above; directions: (N,) rad of the trunks from the x axis towards y, NaN where it is not
    known; direction_sds: (N,) rad; position_sds: (N,) m, None: exact. settings: `group_stride`, `group_depth` and
    `group_width` (m) of the interactions node.
    Raises ValueError for shapes that do not fit, positions that are not finite, and negative deviations.
    """
    positions, directions, angles, places = _checked(positions, directions, direction_sds, position_sds)
    middle = positions.mean(axis=0) if len(positions) else np.zeros(2)
    return Votes(_votes(positions - middle, directions, angles, places, settings), middle)


def find_formations(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: SimpleNamespace,
                    position_sds: Optional[np.ndarray] = None) -> List[Formation]:
    """Return the groups of two and more people.

    The arguments and the errors are those of votes_of; settings: `group_room` (m^2) as well.
    """
    return formations_of(votes_of(positions, directions, direction_sds, settings, position_sds), settings)


def formations_of(votes: Votes, settings: SimpleNamespace) -> List[Formation]:
    """Return the groups of two and more people. settings: `group_room` (m^2) of the interactions node."""
    table = votes.table
    if table.shape[1] < 2:
        return []
    per_person = math.log(2.0 * math.pi / settings.group_room)
    # What adds up to the cost without further ado is one row.
    table = np.concatenate([table[:5], (table[5] + table[6] + 2.0 * per_person * table[7])[None]])
    groups = groups_of(_moved(table, _joined(table, per_person), per_person))
    if not groups:
        return []
    totals = table @ membership(groups, table.shape[1])
    found = zip(groups, _centres(totals) + votes.middle, _cost(totals, per_person).tolist())
    return [Formation(members, centre, 1.0 / (1.0 + math.exp(-min(-cost / (len(members) - 1), 50.0))))
            for members, centre, cost in found]


def groups_of(labels: np.ndarray) -> List[List[int]]:
    """Return the rows of each label (N,) that two and more have, rising, in the order of their first rows."""
    rows: Dict[int, List[int]] = {}
    for row, label in enumerate(labels.tolist()):
        rows.setdefault(label, []).append(row)
    return [group for group in rows.values() if len(group) > 1]


def o_spaces(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: SimpleNamespace,
             groups: Sequence[Sequence[int]], position_sds: Optional[np.ndarray] = None) -> np.ndarray:
    """Return the middles (G, 2) m of the o-spaces of given groups (rows, one at least each).

    The other arguments and the errors are those of votes_of.
    """
    return middles_of(votes_of(positions, directions, direction_sds, settings, position_sds), groups)


def middles_of(votes: Votes, groups: Sequence[Sequence[int]]) -> np.ndarray:
    """Return the middles (G, 2) m of the o-spaces of given groups (rows, one at least each)."""
    if not len(groups):
        return np.zeros((0, 2))
    return _centres(votes.table[:5] @ membership(groups, votes.table.shape[1])) + votes.middle


def _checked(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, position_sds: Optional[np.ndarray]
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
           settings: SimpleNamespace) -> np.ndarray:
    """Return (8, N): what each person tells of the middle of the group.

    The vote lies `group_stride` ahead with the deviations `group_depth` along and `group_width` across the direction. Its
    moments under a direction that is normal around the circle: E cos = exp(-sd^2 / 2), E cos^2 = (1 + exp(-2 sd^2)) / 2
    (K. V. Mardia, P. E. Jupp, Directional Statistics, 2000, section 3.5.7); without a direction it is round.
    """
    stride, depth, width = settings.group_stride, settings.group_depth ** 2, settings.group_width ** 2
    once, twice = np.exp(-angles ** 2 / 2.0), np.exp(-2.0 * angles ** 2)
    same, other = (1.0 + twice) / 2.0, (1.0 - twice) / 2.0
    noise = np.maximum(places, _LEAST_SD) ** 2
    along = depth * same + width * other + stride ** 2 * (same - once ** 2) + noise
    across = depth * other + width * same + stride ** 2 * other + noise
    cosine, sine = np.cos(directions), np.sin(directions)
    x, y = (positions + stride * once[:, None] * np.stack([cosine, sine], axis=1)).T
    xx, yy = cosine ** 2 / along + sine ** 2 / across, sine ** 2 / along + cosine ** 2 / across
    xy = cosine * sine * (1.0 / along - 1.0 / across)
    info_x, info_y = xx * x + xy * y, xy * x + yy * y
    return np.stack([xx, xy, yy, info_x, info_y, info_x * x + info_y * y, np.log(along * across), np.ones(len(x))])


def _cost(sums: np.ndarray, per_person: float) -> np.ndarray:
    """Return the cost (...,) of groups (6, ...): -log of the Bayes factor for one middle against one for each; 0 for one.

    The last row: squares, log |covariance| and twice `per_person` for each of the people.
    """
    xx, xy, yy, x, y, rest = sums
    determinant = xx * yy - xy * xy
    explained = (x * (yy * x - 2.0 * xy * y) + xx * y * y) / determinant
    return 0.5 * (rest - explained + np.log(determinant)) - per_person


def membership(groups: Sequence[Sequence[int]], count: int) -> np.ndarray:
    """Return (count, G) 1 where a row belongs to a group, else 0."""
    within = np.zeros((count, len(groups)))
    for number, group in enumerate(groups):
        within[group, number] = 1.0
    return within


def _centres(totals: np.ndarray) -> np.ndarray:
    """Return the middles (G, 2) m of groups (5 and more, G)."""
    xx, xy, yy, x, y = totals[:5]
    return (np.stack([yy * x - xy * y, xx * y - xy * x]) / (xx * yy - xy * xy)).T


def _joined(votes: np.ndarray, per_person: float) -> np.ndarray:
    """Return the group (N,) of each person after joining, pair by pair, the groups that gain most."""
    count = votes.shape[1]
    sums, costs, labels, alive = votes.copy(), np.zeros(count), np.arange(count), np.ones(count, dtype=bool)
    gains = _cost(sums[:, :, None] + sums[:, None], per_person)
    gains[np.diag_indices(count)] = np.inf
    while True:
        first, second = divmod(int(gains.argmin()), count)
        if not gains[first, second] < 0.0:
            return labels
        costs[first] += costs[second] + gains[first, second]
        sums[:, first] += sums[:, second]
        labels[labels == second] = first
        alive[second] = False
        fresh = np.where(alive, _cost(sums + sums[:, first:first + 1], per_person) - costs - costs[first], np.inf)
        fresh[first] = np.inf
        gains[first], gains[:, first] = fresh, fresh
        gains[second], gains[:, second] = np.inf, np.inf


def _moved(votes: np.ndarray, labels: np.ndarray, per_person: float) -> np.ndarray:
    """Return the groups (N,) after moving one person at a time to where the cost is least, or out of every group."""
    count = votes.shape[1]
    for _ in range(2 * count):
        names, labels, sizes = np.unique(labels, return_inverse=True, return_counts=True)
        groups = len(names)
        sums = votes @ (labels[:, None] == np.arange(groups))
        alone = sizes[labels] == 1
        left = np.where(alone, votes, sums[:, labels] - votes)
        entered = (sums[:, None] + votes[:, :, None]).reshape(len(votes), -1)
        costs = _cost(np.concatenate([sums, left, entered], axis=1), per_person)
        leaving = costs[groups:groups + count] - costs[labels]
        change = costs[groups + count:].reshape(count, groups) - costs[:groups] + leaving[:, None]
        change[np.arange(count), labels] = leaving       # out of every group: what one alone costs is 0
        person, target = divmod(int(change.argmin()), groups)
        if change[person, target] > -1e-9:
            break
        labels[person] = groups if target == labels[person] else target
    return labels
