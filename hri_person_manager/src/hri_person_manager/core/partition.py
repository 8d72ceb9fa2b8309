"""Part the nodes of one connected component into groups with at most one node of each kind.

Wanted are the fewest groups, then the highest total affinity. The affinity of a group is the sum of the likelihoods
over its maximum spanning tree: each piece of evidence counts once, and what follows from others counts no more. So the
groups of a partition are the trees of a forest, and the best forest has most edges first, then most likelihood.

With two kinds of nodes this is a bipartite matching, solved exactly in polynomial time. With three or four kinds it is
multidimensional matching, which is NP-hard. A greedy forest is improved by matchings: all groups are cut between
the kinds, and the halves are joined anew in the best way. Then all groups that are possible are listed, prices of the
nodes bound what any partition can reach (Lagrangian relaxation; Fisher 1981, Management Science 27), and a
search among the groups within the bound finds the best partition or proves that there is no better one.

Each step costs units of work, of which a call has so many and no more; a component for which they do not suffice has a
good partition, and `exact` is false. Time is not looked at, so the same matches make the same groups on every machine.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, Dict, FrozenSet, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from scipy.optimize import linear_sum_assignment

WORK_UNITS = 40000            # of one change of the matches, each about a microsecond at most
_MOST_NODES = 800             # of a component with more, only the greedy forest is made
_MOST_GROUPS = 5000           # that are listed for the exact search
_MOST_DEPTH = 200             # nodes of a component for the exact search, which is recursive
_PRICE_ROUNDS = 150
_SAME = 1e-9
_KINDS = 4
Edges = Mapping[FrozenSet, float]
Group = FrozenSet[Any]             # of pairs (kind, id)


class Work:
    """Units of work that are left; a step that costs more is not made."""

    def __init__(self, units: float = WORK_UNITS) -> None:
        self.left = units

    def spend(self, units: float) -> bool:
        """Take units away if there are as many; returns whether there were."""
        if units > self.left:
            return False
        self.left -= units
        return True


def best_partition(nodes: Sequence, edges: Edges, work: Optional[Work] = None) -> Tuple[List[Group], bool]:
    """Return the groups and whether they are proved to be the best.

    `nodes` are pairs of (kind, id), of at most four kinds; `edges` maps frozenset({a, b}) to a likelihood in (0, 1].
    Fewest groups come first, then the highest total affinity. work: what it may cost.
    """
    kinds = sorted({node[0] for node in nodes})
    if len(kinds) == len(nodes):
        return [frozenset(nodes)], True      # a component without two nodes of one kind is one group
    component = _Component(nodes, kinds, edges)
    work = work if work is not None else Work()
    if len(kinds) <= 2:
        return component.named(_bipartite(component)), True
    rows = _greedy(component)
    exact = component.is_best(rows)
    if not exact and len(nodes) <= _MOST_NODES:
        rows = _Rematching(component, work).best(rows)
        exact = component.is_best(rows)
        listed, values = _list_groups(component, work) if not exact else _no_groups(component)
        if len(listed):
            search = _Search(component, listed, values, rows, work)
            exact = search.run()
            rows = search.best
    return component.named(rows), exact


class _Component:
    """The nodes by number, in order; a group is a list of numbers, or a row of four, one of each kind, `size` for none.

    The value of an edge is its likelihood plus `unit`, which no sum of likelihoods reaches: the highest total value
    has the most edges, so the fewest groups, and then the highest affinity.
    """

    def __init__(self, nodes: Sequence, kinds: Sequence, edges: Edges) -> None:
        self.nodes = sorted(nodes)
        self.size = len(self.nodes)
        self.kind = [kinds.index(node[0]) for node in self.nodes]
        self.unit = float(self.size)
        number = {node: index for index, node in enumerate(self.nodes)}
        self.edges: List[Tuple[int, int, float]] = []
        self.links: List[Dict[int, float]] = [{} for _ in self.nodes]
        for (one, other), likelihood in edges.items():
            first, second = number[one], number[other]
            if self.kind[first] != self.kind[second]:
                value = likelihood + self.unit
                self.edges.append((first, second, value) if first < second else (second, first, value))
                self.links[first][second] = self.links[second][first] = value

    def matrix(self) -> np.ndarray:
        """Values of the edges, 0 where there is none, with a row and a column for no node."""
        values = np.zeros((self.size + 1, self.size + 1))
        first, second, value = zip(*self.edges)
        values[first, second] = values[second, first] = value
        return values

    def rows(self, groups: Sequence[Sequence[int]]) -> np.ndarray:
        """Groups as rows (N, 4)."""
        rows = np.full((len(groups), _KINDS), self.size)
        for row, members in zip(rows, groups):
            for index in members:
                row[self.kind[index]] = index
        return rows

    def value(self, group: Sequence[int]) -> float:
        """Value of the maximum spanning tree of a group, by Prim's algorithm."""
        total, reached, left = 0.0, group[:1], list(group[1:])
        while left:
            value, chosen = max((self.links[index].get(other, 0.0), other) for index in reached for other in left)
            total += value
            reached = [*reached, chosen]
            left.remove(chosen)
        return total

    def is_best(self, groups: Sequence[Sequence[int]]) -> bool:
        """Tell whether every node has its best edge, but for those of one kind: then nothing is better."""
        total = sum(self.value(group) for group in groups)
        best = [max(links.values()) for links in self.links]
        return any(total >= sum(value for value, own in zip(best, self.kind) if own != kind) - _SAME
                   for kind in set(self.kind))

    def named(self, groups: Sequence[Sequence[int]]) -> List[Group]:
        """Return groups of numbers as groups of nodes."""
        return [frozenset(self.nodes[index] for index in group) for group in groups]


def _bipartite(component: _Component) -> List[List[int]]:
    """The best pairs of two kinds of nodes."""
    sides = [[index for index in range(component.size) if component.kind[index] == kind] for kind in (0, 1)]
    place = {index: position for side in sides for position, index in enumerate(side)}
    value = np.zeros((len(sides[0]), len(sides[1])))
    for first, second, edge in component.edges:
        first, second = (first, second) if component.kind[first] == 0 else (second, first)
        value[place[first], place[second]] = edge
    rows = [[sides[0][row], sides[1][column]] for row, column in zip(*linear_sum_assignment(value, maximize=True))
            if value[row, column] > 0.0]
    taken = {index for row in rows for index in row}
    return rows + [[index] for index in range(component.size) if index not in taken]


def _greedy(component: _Component) -> List[List[int]]:
    """Join by the strongest edges first, where no kind comes twice."""
    group = [[index] for index in range(component.size)]
    held = [1 << kind for kind in component.kind]        # kinds in the group of a node
    for first, second, _ in sorted(component.edges, key=lambda edge: (-edge[2], edge[0], edge[1])):
        if held[first] & held[second]:
            continue
        joined, kinds = group[first] + group[second], held[first] | held[second]
        for index in joined:
            group[index], held[index] = joined, kinds
    return [row for index, row in enumerate(group) if min(row) == index]


class _Rematching:
    """Makes groups by matchings, in which all of them are cut between the kinds and the parts are joined anew."""

    def __init__(self, component: _Component, work: Work) -> None:
        self._component, self._work = component, work
        self._none = component.size
        self._value = component.matrix()

    def best(self, groups: Sequence[Sequence[int]]) -> List[List[int]]:
        """Return what comes of these groups, or of one kind joined after the other, whichever is better."""
        starts = [self._component.rows(groups), self._kind_by_kind()]
        ends = [self._improve(start) for start in starts if start is not None]
        chosen = max(ends, key=lambda rows: float(self._values(rows).sum()))
        return [[int(index) for index in row if index != self._none] for row in chosen]

    def _kind_by_kind(self) -> Optional[np.ndarray]:
        """Join one kind after the other to the groups so far; None when it would cost too much."""
        rows: Optional[np.ndarray] = np.full((0, _KINDS), self._none)
        for kind in range(_KINDS):
            added = self._component.rows(
                [[index] for index in range(self._none) if self._component.kind[index] == kind])
            rows = self._join(rows, added, np.arange(_KINDS) != kind) if rows is not None else None
        return rows

    def _improve(self, rows: np.ndarray) -> np.ndarray:
        """Cut and join until nothing changes."""
        cuts = [np.isin(np.arange(_KINDS), part) for part in ((3,), (2,), (1,), (0,), (0, 1), (0, 2), (0, 3))]
        since = turn = 0
        while since < len(cuts):
            cut = cuts[turn % len(cuts)]
            joined = self._join(self._parts(np.where(cut, rows, self._none)),
                                self._parts(np.where(cut, self._none, rows)), cut)
            if joined is None:
                break
            better = float(self._values(joined).sum()) > float(self._values(rows).sum()) + _SAME
            rows, since, turn = (self._connected(joined), 0, turn + 1) if better else (rows, since + 1, turn + 1)
        return rows

    def _join(self, left: np.ndarray, right: np.ndarray, cut: np.ndarray) -> Optional[np.ndarray]:
        """Match rows that hold the kinds of `cut` with rows that hold the others; None when it would cost too much."""
        if not self._work.spend(300 + 0.2 * len(left) * len(right)):
            return None
        gain = (self._values(np.where(cut, left[:, None, :], right[None, :, :]))
                - self._values(left)[:, None] - self._values(right))
        row, column = linear_sum_assignment(gain, maximize=True)
        row, column = row[gain[row, column] > 0.0], column[gain[row, column] > 0.0]
        return np.concatenate([np.where(cut, left[row], right[column]), np.delete(left, row, axis=0),
                               np.delete(right, column, axis=0)])

    def _parts(self, rows: np.ndarray) -> np.ndarray:
        """The rows that hold a node."""
        return rows[(rows != self._none).any(axis=1)]

    def _connected(self, rows: np.ndarray) -> np.ndarray:
        """Divide the rows that are not connected."""
        edges = np.floor(self._values(rows) / self._component.unit + 0.5 / self._component.unit)
        broken = edges < (rows != self._none).sum(axis=1) - 1
        divided = []
        for row in rows[broken]:
            left = [int(index) for index in row if index != self._none]
            while left:
                part = [left.pop(0)]
                for index in part:
                    reached = [other for other in left if other in self._component.links[index]]
                    part.extend(reached)
                    left = [other for other in left if other not in reached]
                divided.append([next((index for index in part if self._component.kind[index] == kind), self._none)
                                for kind in range(_KINDS)])
        return np.concatenate([rows[~broken], np.array(divided, dtype=int).reshape(-1, _KINDS)])

    def _values(self, rows: np.ndarray) -> np.ndarray:
        """Value of the best forest in each row (..., 4), by Prim's algorithm: a missing edge has value 0."""
        pairs = {(a, b): self._value[rows[..., a], rows[..., b]] for a, b in combinations(range(_KINDS), 2)}
        first, second, third = pairs[0, 1], pairs[0, 2], pairs[0, 3]
        best = np.maximum(np.maximum(first, second), third)
        # Name the node that was reached "one", and the two others by what reaches them now.
        is_one, is_two = first >= best, second >= best
        other = np.where(is_one, np.maximum(second, pairs[1, 2]),
                         np.where(is_two, np.maximum(first, pairs[1, 2]), np.maximum(first, pairs[1, 3])))
        last = np.where(is_one, np.maximum(third, pairs[1, 3]),
                        np.where(is_two, np.maximum(third, pairs[2, 3]), np.maximum(second, pairs[2, 3])))
        between = np.where(is_one, pairs[2, 3], np.where(is_two, pairs[1, 3], pairs[1, 2]))
        total = other + last + between - np.minimum(np.minimum(other, last), between)
        return best + total


def _list_groups(component: _Component, work: Work) -> Tuple[np.ndarray, np.ndarray]:
    """Return all groups of two nodes and more that are connected, as rows (N, 4), and their values (N,).

    There are none when there are too many. A tree has a leaf: the best one of a group is that of the group without some
    node, and the best edge to that node.
    """
    none = _no_groups(component)
    if component.size > _MOST_DEPTH:
        return none
    edge = component.matrix()
    kinds = np.array([*component.kind, -1])
    columns = [np.flatnonzero(kinds == kind) for kind in range(_KINDS)]
    found = [(component.rows([pair[:2] for pair in component.edges]), np.array([pair[2] for pair in component.edges]))]
    while len(found[-1][0]):
        rows, values = found[-1]
        if sum(len(listed) for listed, _ in found) > _MOST_GROUPS or not work.spend(
                300 + 0.03 * len(rows) * component.size):
            return none
        grown = [(np.full((0, _KINDS), component.size), np.zeros(0))]
        for kind in range(_KINDS):
            free = rows[:, kind] == component.size
            best = edge[rows[free]][:, :, columns[kind]].max(axis=1)
            row, column = np.nonzero(best)
            if not work.spend(0.3 * len(row)):
                return none
            joined = rows[free][row]
            joined[:, kind] = columns[kind][column]
            grown.append((joined, values[free][row] + best[row, column]))
        found.append(_once(np.concatenate([rows for rows, _ in grown]), np.concatenate([one for _, one in grown])))
    return np.concatenate([rows for rows, _ in found]), np.concatenate([values for _, values in found])


def _no_groups(component: _Component) -> Tuple[np.ndarray, np.ndarray]:
    return np.full((0, _KINDS), component.size), np.zeros(0)


def _once(rows: np.ndarray, values: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Each row once, with the highest of its values."""
    key = rows @ (int(rows.max(initial=0)) + 1) ** np.arange(_KINDS)
    order = np.lexsort((-values, key))
    kept = order[np.diff(key[order], prepend=-1) != 0]
    return rows[kept], values[kept]


class _Prices:
    """Prices of the nodes such that no group is worth more than the prices of its members, the sum as low as possible.

    The nodes of the most frequent kind own the groups that hold one; another group is its first node's. Given the
    prices of the others, those of the owners follow at once; the others are found by subgradients.
    """

    def __init__(self, component: _Component, members: np.ndarray, work: Work) -> None:
        """members: (N, 4) of the groups, the number of nodes where there is none."""
        self._work = work
        kinds = component.kind
        frequent = max(set(kinds), key=kinds.count)
        self._is_owner = np.array([kind == frequent for kind in kinds] + [True])
        owns = self._is_owner[members] & (members < component.size)
        owner = np.where(owns.any(axis=1), members[np.arange(len(members)), owns.argmax(axis=1)], members.min(axis=1))
        self._order = np.argsort(owner, kind="stable")
        self._members, owner = members[self._order], owner[self._order]
        self._starts = np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]])
        self._lengths = np.diff(np.r_[self._starts, len(owner)])
        self._owners = owner[self._starts]

    def lowest(self, values: np.ndarray, reached: float, enough: float) -> np.ndarray:
        """Return the prices of all nodes, and 0 for no node.

        values: (N,) of the groups. reached: what some partition has. enough: a sum that is low enough.
        """
        values = values[self._order]
        prices = np.zeros(len(self._is_owner))
        pairs = (self._members < len(prices) - 1).sum(axis=1) == 2
        for ends in self._members[pairs].T:
            np.maximum.at(prices, ends, values[pairs])      # a node adds no more than its best edge
        prices[self._is_owner] = 0.0
        lowest, found, step, since = np.inf, prices, 1.0, 0
        for _ in range(_PRICE_ROUNDS):
            excess = values - prices[self._members].sum(axis=1)
            most = np.maximum.reduceat(excess, self._starts)
            whole = prices.copy()
            whole[self._owners] += np.maximum(most, 0.0)
            total = float(whole.sum())
            since = 0 if total < lowest - 0.01 * (total - reached) else since + 1
            lowest, found = (total, whole) if total < lowest else (lowest, found)
            step *= 0.5 if since and since % 5 == 0 else 1.0
            slope = self._slope(prices, excess, most)
            length = float(slope @ slope)
            if lowest <= enough or since >= 20 or length == 0.0 or not self._work.spend(60 + 0.05 * len(values)):
                break
            prices = np.maximum(0.0, prices - slope * (step * (total - reached) / length))
        return found

    def _slope(self, prices: np.ndarray, excess: np.ndarray, most: np.ndarray) -> np.ndarray:
        """How the sum grows with each price: by one, less the best groups of owners that hold the node."""
        hits = np.flatnonzero(excess >= np.repeat(most, self._lengths))
        owners = np.searchsorted(self._starts, hits, side="right")
        hits = hits[np.r_[True, owners[1:] != owners[:-1]]]
        chosen = self._members[hits[excess[hits] > 0.0]]
        slope = 1.0 - np.bincount(chosen.ravel(), minlength=len(prices))
        slope[self._is_owner | ((prices <= 0.0) & (slope > 0.0))] = 0.0
        return slope


class _Search:
    """Finds the best choice among the groups that are possible, or proves that the one at hand is the best.

    The prices of the members of a group are together at least its value. So the sum of all prices is more than any
    partition reaches, and each group that is chosen takes its slack, prices less value, off that sum.
    """

    def __init__(self, component: _Component, rows: np.ndarray, values: np.ndarray, groups: List[List[int]],
                 work: Work) -> None:
        """rows: (N, 4) of all groups that are possible, values: (N,); groups: those at hand."""
        self._component, self._members, self._values, self._work = component, rows, values, work
        self.best = groups
        self._gap = 0.0
        self._options: List[Tuple[List[Tuple[float, int, Tuple[int, ...]]], int]] = []

    def run(self) -> bool:
        """Search; returns whether `best` is proved to be the best."""
        component, values = self._component, self._values
        best = sum(component.value(group) for group in self.best)
        edges = (self._members < component.size).sum(axis=1) - 1.0
        most_edges = component.size - len(self.best)
        prices = _Prices(component, self._members, self._work)
        lowest = prices.lowest(values, best, best + _SAME)
        more = most_edges + 1.0 - _SAME
        if lowest.sum() > best + 1.0 and (lowest.sum() < component.unit * more
                                          or prices.lowest(edges, most_edges, more).sum() < more):
            # No partition has fewer groups. Where edges weigh less, the prices bound the affinity more closely.
            values = values - edges * (component.unit - 1.0)
            best -= most_edges * (component.unit - 1.0)
            lowest = prices.lowest(values, best, best + _SAME)
        self._gap = float(lowest.sum()) - best
        if self._gap <= _SAME:
            return True
        slack = lowest[self._members].sum(axis=1) - values
        if not self._work.spend(3 * int((slack < self._gap).sum())):
            return False
        self._list_options(lowest, slack)
        return self._descend(0, 0, 0.0, [])

    def _list_options(self, prices: np.ndarray, slack: np.ndarray) -> None:
        """List for each node by how much less can be reached with each group that it may be in, the least first."""
        options: List[List[Tuple[float, int, Tuple[int, ...]]]] = [
            [(float(prices[index]), 1 << index, (index,))] for index in range(self._component.size)]
        near = slack < self._gap
        for row, less in zip(self._members[near].tolist(), slack[near].tolist()):
            members = tuple(index for index in row if index < self._component.size)
            option = (max(0.0, less), sum(1 << index for index in members), members)
            for index in members:
                options[index].append(option)
        self._options = sorted(((sorted(option), 1 << index) for index, option in enumerate(options)),
                               key=lambda item: (len(item[0]), item[1]))

    def _descend(self, position: int, covered: int, spent: float, chosen: List[Tuple[int, ...]]) -> bool:
        """Choose a group for the next node that has none; returns False when the work is used up."""
        while position < len(self._options) and self._options[position][1] & covered:
            position += 1
        if position == len(self._options):
            self._gap = spent
            self.best = [list(members) for members in chosen]
            return True
        if len(chosen) == len(self.best):
            return True
        for slack, mask, members in self._options[position][0]:
            if spent + slack >= self._gap - _SAME:
                break
            if mask & covered:
                continue
            if not self._work.spend(2):
                return False
            chosen.append(members)
            ended = self._descend(position + 1, covered | mask, spent + slack, chosen)
            chosen.pop()
            if not ended:
                return False
        return True
