"""Part the nodes of one connected component into groups with at most one node of each kind.

With two kinds of nodes this is a bipartite matching, solved exactly in polynomial time. With three or four
kinds it is multidimensional matching, which is NP-hard: small components are searched exhaustively
(branch and bound), larger ones start from a chain of bipartite matchings, kind by kind, and the search
improves it for a bounded number of steps.
"""

from __future__ import annotations

from itertools import combinations
from typing import Dict, FrozenSet, Hashable, List, Mapping, Sequence, Tuple

import numpy as np
from scipy.optimize import linear_sum_assignment

SEARCH_STEPS = 4000
Edges = Mapping[FrozenSet, float]
Group = FrozenSet[Hashable]
_MORE_THAN_ANY_AFFINITY = 100.0


def path_products(members: Sequence, edges: Edges) -> Dict[FrozenSet, float]:
    """Return, per pair of members, the largest product of likelihoods along a path among the members.

    Floyd-Warshall on the products; pairs that no path connects are left out.
    """
    pairs = (frozenset(pair) for pair in combinations(members, 2))
    best = {pair: edges[pair] for pair in pairs if pair in edges}
    for middle in members:
        for first, second in combinations([node for node in members if node != middle], 2):
            left = best.get(frozenset((first, middle)), 0.0)
            right = best.get(frozenset((middle, second)), 0.0)
            key = frozenset((first, second))
            if left * right > best.get(key, 0.0):
                best[key] = left * right
    return best


def best_partition(nodes: Sequence, edges: Edges, max_steps: int = SEARCH_STEPS) -> Tuple[List[Group], bool]:
    """Return the groups and whether they are proved to be the best.

    `nodes` are pairs of (kind, id); `edges` maps frozenset({a, b}) to a likelihood in (0, 1]. Fewest groups
    come first, then the highest total affinity. At most `max_steps` partial solutions are looked at.
    """
    kinds = sorted({node[0] for node in nodes})
    if len(kinds) == len(nodes):
        return [frozenset(nodes)], True      # a component without two nodes of one kind is one group
    start = _kind_by_kind(nodes, kinds, edges)
    if len(kinds) <= 2:
        return start, True
    search = _Search(nodes, edges, start, max_steps)
    return search.run()


def _affinity(group: Sequence, edges: Edges) -> float:
    """Total of the pairwise affinities inside one group; -1 if the group is not connected."""
    size = len(group)
    if size == 1:
        return 0.0
    if size == 2:
        return edges.get(frozenset(group), -1.0)
    products = path_products(group, edges)
    if len(products) < size * (size - 1) // 2:
        return -1.0
    return sum(products.values())


def _kind_by_kind(nodes: Sequence, kinds: Sequence, edges: Edges) -> List[Group]:
    """Join one kind after the other to the groups so far, each time by an optimal bipartite matching."""
    groups = [frozenset((node,)) for node in nodes if node[0] == kinds[0]]
    for kind in kinds[1:]:
        added = [node for node in nodes if node[0] == kind]
        gain = np.full((len(groups), len(added)), -_MORE_THAN_ANY_AFFINITY)
        for row, group in enumerate(groups):
            before = _affinity(sorted(group), edges)
            for column, node in enumerate(added):
                if any(frozenset((node, member)) in edges for member in group):
                    joined = _affinity(sorted(group | {node}), edges)
                    gain[row, column] = _MORE_THAN_ANY_AFFINITY + joined - before
        taken = set()
        if groups:
            for row, column in zip(*linear_sum_assignment(gain, maximize=True)):
                if gain[row, column] > 0.0:
                    groups[row] = groups[row] | {added[column]}
                    taken.add(column)
        groups.extend(frozenset((node,)) for column, node in enumerate(added) if column not in taken)
    return groups


class _Search:
    """Depth-first branch and bound over the nodes; each joins an open group or opens one."""

    def __init__(self, nodes: Sequence, edges: Edges, start: List[Group], max_steps: int) -> None:
        self._nodes = _connected_order(nodes, edges)
        self._edges = edges
        self._best = start
        self._best_score = self._score(start)
        self._steps_left = max_steps
        self._known: Dict[FrozenSet, float] = {}

    def run(self) -> Tuple[List[Group], bool]:
        """Search and return the best groups with True if the search ended by itself."""
        self._descend(0, [])
        return self._best, self._steps_left > 0

    def _score(self, groups: Sequence) -> Tuple[int, float]:
        return -len(groups), sum(_affinity(sorted(group), self._edges) for group in groups)

    def _descend(self, index: int, groups: List[List]) -> None:
        if self._steps_left <= 0 or -len(groups) < self._best_score[0]:
            return
        self._steps_left -= 1
        if index == len(self._nodes):
            self._judge(groups)
            return
        node = self._nodes[index]
        for group in groups:
            if self._may_join(node, group):
                group.append(node)
                self._descend(index + 1, groups)
                group.pop()
        groups.append([node])
        self._descend(index + 1, groups)
        groups.pop()

    @staticmethod
    def _may_join(node: Tuple, group: Sequence) -> bool:
        return all(member[0] != node[0] for member in group)

    def _judge(self, groups: List[List]) -> None:
        total = 0.0
        for group in groups:
            key = frozenset(group)
            if key not in self._known:
                self._known[key] = _affinity(sorted(group), self._edges)
            if self._known[key] < 0.0:
                return
            total += self._known[key]
        score = (-len(groups), total)
        if score[0] > self._best_score[0] or (score[0] == self._best_score[0]
                                              and score[1] > self._best_score[1] + 1e-9):
            self._best_score = score
            self._best = [frozenset(group) for group in groups]


def _connected_order(nodes: Sequence, edges: Edges) -> List:
    """Order the nodes so that each but the first has an edge to an earlier one."""
    order = [nodes[0]]
    left = list(nodes[1:])
    while left:
        chosen = next((node for node in left
                       if any(frozenset((node, other)) in edges for other in order)), left[0])
        order.append(chosen)
        left.remove(chosen)
    return order
