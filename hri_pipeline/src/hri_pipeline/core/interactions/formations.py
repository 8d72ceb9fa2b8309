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


def find_formations(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: SimpleNamespace,
                    position_sds: Optional[np.ndarray] = None) -> List[Formation]:
    """Return the groups of two and more people.

    positions: (N, 2) m, seen from above; directions: (N,) rad of the trunks from the x axis towards y, NaN where it is not
    known; direction_sds: (N,) rad; position_sds: (N,) m, None: exact. settings: `group_stride`, `group_depth`,
    `group_width` (m) and `group_room` (m^2) of the interactions node.
    Raises ValueError for shapes that do not fit, positions that are not finite, and negative deviations.
    """
    positions, directions, angles, places = _checked(positions, directions, direction_sds, position_sds)
    if len(positions) < 2:
        return []
    middle = positions.mean(axis=0)
    votes = _votes(positions - middle, directions, angles, places, settings)
    per_person = math.log(2.0 * math.pi / settings.group_room)
    formations = []
    for members in groups_of(_moved(votes, _joined(votes, per_person), per_person)):
        total = votes[:, members].sum(axis=1)
        gain = -float(_cost(total, per_person)) / (len(members) - 1)
        formations.append(Formation(members, _centre(total) + middle, 1.0 / (1.0 + math.exp(-min(gain, 50.0)))))
    return formations


def groups_of(labels: np.ndarray) -> List[List[int]]:
    """Return the rows of each label (N,) that two and more have, rising, in the order of their first rows."""
    rows: Dict[int, List[int]] = {}
    for row, label in enumerate(labels.tolist()):
        rows.setdefault(label, []).append(row)
    return [group for group in rows.values() if len(group) > 1]


def o_spaces(positions: np.ndarray, directions: np.ndarray, direction_sds: np.ndarray, settings: SimpleNamespace,
             groups: Sequence[Sequence[int]], position_sds: Optional[np.ndarray] = None) -> np.ndarray:
    """Return the middles (G, 2) m of the o-spaces of given groups (rows, one at least each).

    The other arguments and the errors are those of find_formations.
    """
    positions, directions, angles, places = _checked(positions, directions, direction_sds, position_sds)
    if not len(groups):
        return np.zeros((0, 2))
    middle = positions.mean(axis=0)
    votes = _votes(positions - middle, directions, angles, places, settings)
    return np.stack([_centre(votes[:, list(group)].sum(axis=1)) for group in groups]) + middle


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
    """Return the cost (...,) of groups (8, ...): -log of the Bayes factor for one middle against one for each; 0 for one."""
    xx, xy, yy, x, y, squares, logdet, people = sums
    determinant = xx * yy - xy * xy
    explained = (x * (yy * x - 2.0 * xy * y) + xx * y * y) / determinant
    return 0.5 * (squares - explained + np.log(determinant) + logdet) + (people - 1.0) * per_person


def _centre(total: np.ndarray) -> np.ndarray:
    xx, xy, yy, x, y = total[:5]
    return np.array([yy * x - xy * y, xx * y - xy * x]) / (xx * yy - xy * xy)


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
        entered = (sums[:, None] + votes[:, :, None]).reshape(8, -1)
        costs = _cost(np.concatenate([sums, left, entered], axis=1), per_person)
        leaving = costs[groups:groups + count] - costs[labels]
        change = costs[groups + count:].reshape(count, groups) - costs[:groups] + leaving[:, None]
        change[np.arange(count), labels] = leaving       # out of every group: what one alone costs is 0
        person, target = divmod(int(change.argmin()), groups)
        if change[person, target] > -1e-9:
            break
        labels[person] = groups if target == labels[person] else target
    return labels
