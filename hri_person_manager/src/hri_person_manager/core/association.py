"""Which face, body, voice and person identifiers belong to the same human: a graph of likelihoods.

Nodes are features and persons, edges are the likelihoods that matchers and recognisers published. A node
is a pair of kind and identifier, so that a face and a body that carry the same text are two things.
Solving the graph parts its nodes into groups that are connected by edges of at least the threshold and
hold at most one node of each kind. Wanted are the fewest groups, then the highest total affinity, the
affinity of two members being the largest product of likelihoods along a path inside their group.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from enum import IntEnum
from typing import Callable, Dict, FrozenSet, Iterable, List, NamedTuple, Optional, Sequence, Set, Tuple

from hri_person_manager.core.partition import best_partition, path_products


class Kind(IntEnum):
    """Kind of an identifier; the values are those of the constants in hri_msgs/IdsMatch."""

    PERSON = 1
    FACE = 2
    BODY = 3
    VOICE = 4


FEATURES = (Kind.FACE, Kind.BODY, Kind.VOICE)


class Node(NamedTuple):
    """One identifier of one kind."""

    kind: Kind
    id: str


@dataclass(frozen=True)
class Solution:
    """Groups of nodes; `exact` is false where the bounded search had to stop early somewhere."""

    groups: Tuple[FrozenSet[Node], ...]
    exact: bool


class MatchGraph:
    """Likelihood edges between nodes, with a bound on their number (the oldest edge goes first)."""

    def __init__(self, max_edges: int = 5000) -> None:
        """Keep at most `max_edges` edges; ValueError if that is less than one."""
        if max_edges < 1:
            raise ValueError("max_edges is %d, must be at least 1" % max_edges)
        self._max_edges = max_edges
        self._edges: "OrderedDict[FrozenSet[Node], float]" = OrderedDict()
        self._neighbours: Dict[Node, Set[Node]] = {}

    def __len__(self) -> int:
        """Return the number of edges kept."""
        return len(self._edges)

    def set(self, first: Node, second: Node, likelihood: float) -> bool:
        """Keep the likelihood (0..1) of one pair, 0 withdraws it; return whether the graph changed."""
        key = frozenset((first, second))
        if len(key) != 2:
            raise ValueError("a match needs two different nodes, got %r twice" % (first,))
        known = self._edges.get(key)
        if likelihood <= 0.0:
            if known is None:
                return False
            self._drop(key)
            return True
        self._edges[key] = likelihood
        self._edges.move_to_end(key)
        self._neighbours.setdefault(first, set()).add(second)
        self._neighbours.setdefault(second, set()).add(first)
        while len(self._edges) > self._max_edges:
            self._drop(next(iter(self._edges)))
        return known != likelihood

    def likelihood(self, first: Node, second: Node) -> Optional[float]:
        """Return the likelihood kept for a pair, None if there is none."""
        return self._edges.get(frozenset((first, second)))

    def edges(self) -> List[Tuple[Node, Node, float]]:
        """Return all edges as (node, node, likelihood)."""
        return [(*sorted(pair), likelihood) for pair, likelihood in self._edges.items()]

    def matches(self, node: Node) -> List[Tuple[Node, Node, float]]:
        """Return the edges of a node as (node, other, likelihood)."""
        return [(node, other, self._edges[frozenset((node, other))]) for other in sorted(self._neighbours.get(node, ()))]

    def neighbours(self, node: Node) -> FrozenSet[Node]:
        """Return the nodes that share an edge with this one."""
        return frozenset(self._neighbours.get(node, ()))

    def remove(self, node: Node) -> None:
        """Take a node away with all its edges."""
        for other in self.neighbours(node):
            self._drop(frozenset((node, other)))

    def carry(self, leaving: Node, group: Iterable[Node], threshold: float) -> None:
        """Keep the members of a group linked when the node in the middle of a chain leaves.

        Where two members were linked only through `leaving`, an edge takes its place. Its likelihood is the
        product along the path, at least the threshold: that evidence was enough when it was given.
        """
        members = sorted(group)
        products = path_products(members, self._likelihoods(members, threshold))
        remaining = [node for node in members if node != leaving]
        parts = {node: {node} for node in remaining}

        def join(first: Node, second: Node) -> None:
            if parts[first] is not parts[second]:
                parts[first] |= parts[second]
                for node in parts[second]:
                    parts[node] = parts[first]

        pairs = [(a, b) for index, a in enumerate(remaining) for b in remaining[index + 1:]]
        for first, second in pairs:
            if (self.likelihood(first, second) or 0.0) >= threshold:
                join(first, second)
        pairs.sort(key=lambda pair: -products.get(frozenset(pair), 0.0))
        for first, second in pairs:
            product = products.get(frozenset((first, second)), 0.0)
            if product > 0.0 and parts[first] is not parts[second]:
                self.set(first, second, max(product, threshold))
                join(first, second)

    def component(self, start: Node, threshold: float, present: Callable[[Node], bool]) -> List[Node]:
        """Return the sorted nodes that edges of at least the threshold connect with `start`."""
        found = {start}
        pending = [start]
        while pending:
            node = pending.pop()
            for other in self._neighbours.get(node, ()):
                if other not in found and present(other) and self.likelihood(node, other) >= threshold:
                    found.add(other)
                    pending.append(other)
        return sorted(found)

    def solve(self, nodes: Iterable[Node], threshold: float) -> Solution:
        """Part the given (present) nodes into groups, each component of the graph on its own."""
        present = set(nodes)
        groups: List[FrozenSet[Node]] = []
        exact = True
        left = set(present)
        for node in sorted(present):
            if node not in left:
                continue
            members = self.component(node, threshold, present.__contains__)
            left.difference_update(members)
            found, found_exact = best_partition(members, self._likelihoods(members, threshold))
            groups.extend(found)
            exact = exact and found_exact
        return Solution(tuple(groups), exact)

    def prune(self, keep: Callable[[Node], bool]) -> None:
        """Drop every edge of which one end is not to be kept."""
        for node in [node for node in self._neighbours if not keep(node)]:
            self.remove(node)

    def clear(self) -> None:
        """Forget everything."""
        self._edges.clear()
        self._neighbours.clear()

    def _likelihoods(self, members: Sequence[Node], threshold: float) -> Dict[FrozenSet[Node], float]:
        inside = set(members)
        return {
            frozenset((node, other)): value
            for node in members
            for other in self._neighbours.get(node, ())
            if other in inside
            for value in (self._edges[frozenset((node, other))],)
            if value >= threshold
        }

    def _drop(self, key: FrozenSet[Node]) -> None:
        del self._edges[key]
        first, second = key
        for node, other in ((first, second), (second, first)):
            self._neighbours[node].discard(other)
            if not self._neighbours[node]:
                del self._neighbours[node]
