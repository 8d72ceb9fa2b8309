"""The association as it is now: matches between features that are present, solved where they change."""

from __future__ import annotations

from collections import OrderedDict
from typing import Callable, Dict, FrozenSet, Iterable, List, Optional, Set, Tuple

from hri_person_manager.core.association import Kind, MatchGraph, Node
from hri_person_manager.core.match_guard import Match

MAX_STRAY_MATCHES = 1000      # matches kept for features that are not tracked (yet)
Group = FrozenSet[Node]


class LiveAssociation:
    """Keeps every match, and the groups of those whose features are present."""

    def __init__(self, threshold: float, is_present: Callable[[Node], bool], on_lonely: Callable[[str], None]) -> None:
        """Matches count from likelihood `threshold` on, which may be changed before solve(); on_lonely(id) is told of a named person without any feature."""
        self.threshold = threshold
        self._is_present = is_present
        self._on_lonely = on_lonely
        self._graph = MatchGraph()
        self._groups: Dict[Node, Group] = {}
        self._strays: "OrderedDict[FrozenSet[Node], Match]" = OrderedDict()
        self.exact = True

    @property
    def groups(self) -> Tuple[Group, ...]:
        """Every living feature and known person with features, in exactly one group."""
        return tuple(sorted(set(self._groups.values()), key=min))

    @property
    def claimants(self) -> List[Group]:
        """The groups that are somebody: all but the second voices of those who have a voice.

        A person has one voice at a time, the one that speaks for it best. Who says that another is of the same human,
        such as its last turn, says that it is nobody else's.
        """
        return [group for group in self.groups
                if len(group) > 1 or not any(node.kind == Kind.VOICE and self._is_second(node) for node in group)]

    @property
    def matches(self) -> List[Tuple[Node, Node, float]]:
        """All matches that are kept between features and persons."""
        return self._graph.edges()

    def neighbours(self, node: Node) -> FrozenSet[Node]:
        """Return the nodes that share a match with this one."""
        return self._graph.neighbours(node)

    def named(self, feature: Node) -> Set[str]:
        """Ids of the persons that recognisers see in a feature, whoever got it in the end."""
        return {node.id for node in self._graph.neighbours(feature) if node.kind == Kind.PERSON
                and (self._graph.likelihood(feature, node) or 0.0) >= self.threshold}

    def keep(self, match: Match) -> bool:
        """Put a match into the graph, or aside while one of its features is not tracked.

        Returns whether the groups may change by it.
        """
        first, second, likelihood = match.first, match.second, match.likelihood
        if all(node.kind == Kind.PERSON or self._is_present(node) for node in (first, second)):
            before = self._graph.likelihood(first, second) or 0.0
            if not self._graph.set(first, second, likelihood) or max(before, likelihood) < self.threshold:
                return False
            return min(before, likelihood) < self.threshold or not self._is_alone(self._groups.get(first), second)
        nodes = frozenset((first, second))
        self._strays.pop(nodes, None)
        if likelihood > 0.0:
            self._strays[nodes] = match
            while len(self._strays) > MAX_STRAY_MATCHES:
                self._strays.popitem(last=False)
        return False

    def arrive(self, nodes: Iterable[Node]) -> None:
        """Take up the matches that have waited for these features."""
        arrived = set(nodes)
        for match in [self._strays.pop(key) for key in list(self._strays) if key & arrived]:
            self.keep(match)

    def leave(self, node: Node) -> List[Node]:
        """Take a feature out of the graph; returns the nodes that have to be solved again."""
        group = self._groups.get(node, frozenset((node,)))
        touched = set(self._graph.neighbours(node)) | set(group)
        self._graph.carry(node, group, self.threshold)
        self._graph.remove(node)
        self._groups.pop(node, None)
        return sorted(touched - {node})

    def set_aside(self, nodes: Iterable[Node]) -> List[Match]:
        """The matches of these nodes, to keep() them again after they have left."""
        return [Match(*edge) for node in nodes for edge in self._graph.matches(node)]

    def drop(self, node: Node) -> None:
        """Forget the group of a node for which no match speaks any more."""
        self._groups.pop(node, None)

    def forget(self, node: Node) -> List[Node]:
        """Forget a node with all its matches; returns the nodes that have to be solved again."""
        touched = list(self._graph.neighbours(node))
        self._graph.remove(node)
        for key in [key for key in self._strays if node in key]:
            del self._strays[key]
        self._groups.pop(node, None)
        return touched

    def solve(self, nodes: Iterable[Node]) -> bool:
        """Solve the components of these nodes again, as far as they are present; returns whether a group has changed."""
        touched: Set[Node] = set()
        for node in nodes:
            if node not in touched and self._is_present(node):
                touched.update(self._graph.component(node, self.threshold, self._is_present))
        solution = self._graph.solve(touched, self.threshold)
        self.exact = solution.exact
        return any([self._take(group) for group in solution.groups])

    def _is_alone(self, group: Optional[Group], other: Node) -> bool:
        """Tell whether a group with this member has no choice: nobody outside is linked with it.

        As long as its links count, their strength changes nothing then.
        """
        return group is not None and other in group and not any(
            neighbour not in group and self._is_present(neighbour)
            and (self._graph.likelihood(node, neighbour) or 0.0) >= self.threshold
            for node in group for neighbour in self._graph.neighbours(node))

    def _is_second(self, voice: Node) -> bool:
        """Tell whether a voice that is alone is linked with a group that holds another one."""
        return any((self._graph.likelihood(voice, other) or 0.0) >= self.threshold
                   and any(node.kind == Kind.VOICE and node != voice for node in self._groups.get(other, ()))
                   for other in self._graph.neighbours(voice))

    def _take(self, group: Group) -> bool:
        if len(group) == 1:
            (node,) = group
            if node.kind == Kind.PERSON:      # known, yet no part of the association
                self._on_lonely(node.id)
                return self._groups.pop(node, None) is not None
        changed = False
        for node in group:
            if self._groups.get(node) != group:
                self._groups[node] = group
                changed = True
        return changed
