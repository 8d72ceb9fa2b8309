"""Which face, body, voice and person ids belong to the same human: the graph of candidate matches.

Nodes are features and persons, edges are the likelihoods that matchers and recognisers have published. A node is a pair
of kind and id, so that a face and a body with the same text as id are two nodes. The nodes are divided into groups that
are connected by edges of at least the threshold and hold at most one node of each kind. Wanted are the fewest groups,
then the highest total affinity; the affinity of a group is the sum of the likelihoods over its maximum spanning tree
(see `partition`).

`MatchGuard` checks what comes from outside, `MatchGraph` holds the edges, and `Association` keeps the groups of
the features that are tracked now; it solves only the components that have changed.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from dataclasses import dataclass
from itertools import combinations
from typing import Callable, Container, Dict, FrozenSet, Iterable, List, Mapping, Optional, Sequence, Set, Tuple
from typing import Counter as CounterType

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.partition import WORK_UNITS, Work, best_partition
from hri_pipeline.core.ids import is_valid_id

UNDER_WAY_S = 2.0     # s; matches that were sent just before a person was forgotten have arrived after so long
_NOBODY: Mapping = {}
REFUTED_S = 1.0       # s for which two are told to be two, both being there, before that parts what others link
MAX_REFUTED = 1000
_KINDS = frozenset(kind.value for kind in Kind)
_SHOWN = 40           # characters of an id that a text shows
MAX_CUTS = 6
MAX_PENDING_MATCHES = 1000      # matches kept for features that are not tracked (yet)
MAX_SAID = 1000       # pairs of a feature and a recogniser whose names for it are kept
MAX_SAID_NAMES = 10
Group = FrozenSet[MatchNode]
_NO_GROUP: Group = frozenset()


@dataclass(frozen=True)
class CandidateMatch:
    """Likelihood (0..1, 0 withdraws) that two identifiers belong to the same human."""

    first: MatchNode
    second: MatchNode
    likelihood: float


class RateLimit:
    """Token bucket: at most `per_second` events on average, a burst of one second's worth at once."""

    def __init__(self, per_second: float) -> None:
        """ValueError unless the rate is above zero."""
        self.set_rate(per_second)
        self._tokens = per_second
        self._last: Optional[float] = None

    def set_rate(self, per_second: float) -> None:
        """Set the rate from now on; ValueError unless it is above zero."""
        if not per_second > 0.0:
            raise ValueError("rate is %s per second, must be above 0" % per_second)
        self._rate = per_second

    def allow(self, now: float) -> bool:
        """Tell whether one more event at time `now` (s) is within the limit; time may jump back."""
        elapsed = 0.0 if self._last is None else max(0.0, now - self._last)
        self._last = now
        self._tokens = min(self._rate, self._tokens + elapsed * self._rate)
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


class MatchGuard:
    """Turns raw fields into a `CandidateMatch`, or refuses them and counts why."""

    def __init__(self, max_per_second: float) -> None:
        """Accept at most `max_per_second` matches on average."""
        self.limit = RateLimit(max_per_second)
        self.refused: CounterType[str] = Counter()
        self.problem = ""
        """Which match was refused last, and why; empty while none was."""
        self.accepted = self.late = 0
        self._forgotten: Dict[str, float] = {}

    def forget(self, person_id: str, now: float) -> None:
        """Take no match that names a person for 2 s from `now` (s): it would bring back who has just been forgotten."""
        self._forgotten = {name: since for name, since in self._forgotten.items() if now - since <= UNDER_WAY_S}
        self._forgotten[person_id] = now

    def check(self, id1: str, type1: int, id2: str, type2: int, likelihood: float,
              now: float) -> Optional[CandidateMatch]:
        """Return the match, None if it was refused; `now` (s) drives the rate limit."""
        reason = self._reason(id1, type1, id2, type2, likelihood, now)
        if reason:
            self.refused[reason] += 1
            self.problem = "{!r} (type {}) and {!r} (type {}), likelihood {}: {}".format(
                id1[:_SHOWN], type1, id2[:_SHOWN], type2, likelihood, reason)
            return None
        if self._forgotten and self._is_late(id1, id2, now):
            self.late += 1
            return None
        self.accepted += 1
        return CandidateMatch(MatchNode(Kind(type1), id1), MatchNode(Kind(type2), id2), float(likelihood))

    def _reason(self, id1: str, type1: int, id2: str, type2: int, likelihood: float, now: float) -> str:
        """Return why a match is refused, empty if it is not."""
        if not self.limit.allow(now):
            return "too many per second"
        if type1 not in _KINDS or type2 not in _KINDS:
            return "unknown type"
        if not (is_valid_id(id1) and is_valid_id(id2)):
            return "malformed id"
        if type1 == type2 != Kind.PERSON.value:
            return "two ids of one kind"
        if (id1, type1) == (id2, type2):
            return "an id and itself"
        return "" if 0.0 <= likelihood <= 1.0 else "likelihood outside 0..1"

    def _is_late(self, id1: str, id2: str, now: float) -> bool:
        return any(now - self._forgotten[name] <= UNDER_WAY_S for name in (id1, id2) if name in self._forgotten)


class SaidNames:
    """Which names each recogniser has for each feature: one of them at most is right, as one recogniser does not call
    one person by two names without saying that these are one."""

    def __init__(self) -> None:
        self._said: "OrderedDict[Tuple[MatchNode, str], Dict[str, float]]" = OrderedDict()

    def note(self, sender: str, feature: MatchNode, name: str, likelihood: float) -> None:
        """Take what a node says; 0 withdraws it."""
        said = self._said.pop((feature, sender), {})
        said.pop(name, None)
        if likelihood > 0.0:
            said[name] = likelihood
        if said:
            self._said[feature, sender] = dict(list(said.items())[-MAX_SAID_NAMES:])
        while len(self._said) > MAX_SAID:
            self._said.popitem(last=False)

    def doubted(self, feature: MatchNode) -> Set[str]:
        """Return the names of a feature beside which their recogniser has a better one, or a newer one as good; not
        those that another recogniser prefers."""
        said = [names for (of, _), names in self._said.items() if of == feature]
        best = {max(reversed(list(names)), key=names.__getitem__) for names in said}
        return set().union(*said) - best

    def retain(self, is_tracked: Callable[[MatchNode], bool]) -> None:
        """Forget what was said of features that have gone."""
        for key in [key for key in self._said if not is_tracked(key[0])]:
            del self._said[key]

    def forget(self, name: str) -> None:
        """Forget a name."""
        for names in self._said.values():
            names.pop(name, None)
        self._said = OrderedDict((key, names) for key, names in self._said.items() if names)


@dataclass(frozen=True)
class Grouping:
    """Groups of nodes; `approximate`: the nodes of the components whose groups are not proved to be the best."""

    groups: Tuple[FrozenSet[MatchNode], ...]
    approximate: FrozenSet[MatchNode]


class MatchGraph:
    """Likelihood edges between nodes, with a bound on their number (the oldest edge goes first)."""

    def __init__(self, max_edges: int = 5000) -> None:
        """Keep at most `max_edges` edges."""
        self._max_edges = max_edges
        self._oldest: "OrderedDict[FrozenSet[MatchNode], None]" = OrderedDict()
        self._neighbours: Dict[MatchNode, Dict[MatchNode, float]] = {}

    def __len__(self) -> int:
        """Return the number of edges kept."""
        return len(self._oldest)

    def set(self, first: MatchNode, second: MatchNode, likelihood: float) -> bool:
        """Keep the likelihood (0..1) of one pair, 0 withdraws it; return whether the graph changed."""
        if first == second:
            raise ValueError("a match needs two different nodes, got %r twice" % (first,))
        known = self.likelihood(first, second)
        if likelihood <= 0.0:
            if known is not None:
                self._drop(first, second)
            return known is not None
        key = frozenset((first, second))
        self._oldest[key] = None
        self._oldest.move_to_end(key)
        self._neighbours.setdefault(first, {})[second] = likelihood
        self._neighbours.setdefault(second, {})[first] = likelihood
        while len(self._oldest) > self._max_edges:
            self._drop(*next(iter(self._oldest)))
        return known != likelihood

    def likelihood(self, first: MatchNode, second: MatchNode) -> Optional[float]:
        """Return the likelihood kept for a pair, None if there is none."""
        return self._neighbours.get(first, _NOBODY).get(second)

    def edges(self) -> List[Tuple[MatchNode, MatchNode, float]]:
        """Return all edges as (node, node, likelihood), the one that was updated longest ago first."""
        return [(first, second, self._neighbours[first][second]) for first, second in map(sorted, self._oldest)]

    def matches(self, node: MatchNode) -> List[Tuple[MatchNode, MatchNode, float]]:
        """Return the edges of a node as (node, other, likelihood)."""
        return [(node, other, likelihood) for other, likelihood in sorted(self.neighbours(node).items())]

    def neighbours(self, node: MatchNode) -> Mapping[MatchNode, float]:
        """Return the nodes that share an edge with this one, and its likelihood; to be read only."""
        return self._neighbours.get(node, _NOBODY)

    def remove(self, node: MatchNode) -> None:
        """Take a node away with all its edges."""
        for other in list(self.neighbours(node)):
            self._drop(node, other)

    def keep_linked(self, leaving: MatchNode, group: Iterable[MatchNode], threshold: float,
                    refuted: Container[FrozenSet[MatchNode]] = ()) -> None:
        """Keep transitive links: the members of a group stay linked when the node in the middle of a chain leaves.

        Where two members were linked only through `leaving`, an edge takes its place, the one of the best path. It
        counts just so (`threshold`): what was measured since is better, as after a cut of the picture, when a body has
        borne the name of another one's face for a moment. refuted: pairs that are not linked.
        """
        members = sorted(group)
        products = path_products(members, self._likelihoods(members, threshold))
        remaining = [node for node in members if node != leaving]
        parts = {node: {node} for node in remaining}

        def join(first: MatchNode, second: MatchNode) -> None:
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
            if product > 0.0 and parts[first] is not parts[second] and frozenset((first, second)) not in refuted:
                self._drop_earlier_names(first, second, threshold)
                self.set(first, second, threshold)
                join(first, second)

    def _drop_earlier_names(self, first: MatchNode, second: MatchNode, threshold: float) -> None:
        """Drop the names that a feature has from faces before the one whose name it is given now."""
        for feature, person in ((first, second), (second, first)):
            if person.kind == Kind.PERSON != feature.kind:
                for other, likelihood in list(self.neighbours(feature).items()):
                    if other.kind == Kind.PERSON and likelihood <= threshold:
                        self._drop(feature, other)

    def component(self, start: MatchNode, threshold: float, present: Callable[[MatchNode], bool]) -> List[MatchNode]:
        """Return the sorted nodes that edges of at least the threshold connect with `start`."""
        found = {start}
        pending = [start]
        while pending:
            for other, likelihood in self._neighbours.get(pending.pop(), _NOBODY).items():
                if likelihood >= threshold and other not in found and present(other):
                    found.add(other)
                    pending.append(other)
        return sorted(found)

    def solve(self, nodes: Iterable[MatchNode], threshold: float,
              refuted: Iterable[FrozenSet[MatchNode]] = ()) -> Grouping:
        """Part the given (present) nodes into groups, each component of the graph on its own.

        refuted: pairs that are not in one group, whatever links them. The components share a bounded amount of work;
        what the small ones leave goes to the large ones.
        """
        present = set(nodes)
        components: List[List[MatchNode]] = []
        left = set(present)
        for node in sorted(present):
            if node in left:
                components.append(self.component(node, threshold, present.__contains__))
                left.difference_update(components[-1])
        groups: List[FrozenSet[MatchNode]] = []
        approximate: Set[MatchNode] = set()
        units = float(WORK_UNITS)
        for number, members in enumerate(sorted(components, key=len)):
            work = Work(units / (len(components) - number))
            units -= work.left
            edges = self._likelihoods(members, threshold)
            found, exact = best_partition(members, edges, work)
            for _ in range(MAX_CUTS):
                weakest = _weakest_links(found, edges, refuted)
                if not weakest:
                    break
                edges = {pair: value for pair, value in edges.items() if pair not in weakest}
                found, exact = _parted(members, edges, work)
            units += work.left
            groups.extend(found)
            approximate.update(() if exact else members)
        return Grouping(tuple(groups), frozenset(approximate))

    def _likelihoods(self, members: Sequence[MatchNode], threshold: float) -> Dict[FrozenSet[MatchNode], float]:
        inside = set(members)
        return {frozenset((node, other)): value for node in members
                for other, value in self._neighbours.get(node, _NOBODY).items()
                if value >= threshold and node < other and other in inside}

    def _drop(self, first: MatchNode, second: MatchNode) -> None:
        del self._oldest[frozenset((first, second))]
        for node, other in ((first, second), (second, first)):
            del self._neighbours[node][other]
            if not self._neighbours[node]:
                del self._neighbours[node]


def _weakest_links(groups: Iterable[FrozenSet[MatchNode]], edges: Mapping[FrozenSet[MatchNode], float],
                   refuted: Iterable[FrozenSet[MatchNode]]) -> Set[FrozenSet[MatchNode]]:
    """The weakest edge on the best path between each refuted pair that is in one group."""
    found = set()
    for pair in refuted:
        group = next((group for group in groups if pair <= group), None)
        if group is None:
            continue
        first, second = sorted(pair)
        part = {node: {node} for node in group}
        inside = [edge for edge in edges if edge <= group]
        for edge in sorted(inside, key=lambda edge: (-edges[edge], sorted(edge))):
            one, other = edge
            joined = part[one] | part[other]
            for node in joined:
                part[node] = joined
            if second in part[first]:
                found.add(edge)
                break
    return found


def _parted(members: Sequence[MatchNode], edges: Mapping[FrozenSet[MatchNode], float],
            work: Work) -> Tuple[List[FrozenSet[MatchNode]], bool]:
    """Part nodes that edges may not connect any more."""
    left, groups, exact = list(members), [], True
    while left:
        component = [left.pop(0)]
        for node in component:
            reached = [other for other in left if frozenset((node, other)) in edges]
            component.extend(reached)
            left = [other for other in left if other not in reached]
        inside = {pair: value for pair, value in edges.items() if pair <= set(component)}
        found, proved = best_partition(component, inside, work)
        groups.extend(found)
        exact = exact and proved
    return groups, exact


def path_products(members: Sequence[MatchNode],
                  edges: Mapping[FrozenSet[MatchNode], float]) -> Dict[FrozenSet[MatchNode], float]:
    """Return, per pair of members, the largest product of likelihoods along a path among the members.

    Floyd-Warshall on the products; pairs that no path connects are left out.
    """
    pairs = (frozenset(pair) for pair in combinations(members, 2))
    best = {pair: edges[pair] for pair in pairs if pair in edges}
    for middle in members:
        for first, second in combinations(members, 2):
            product = best.get(frozenset((first, middle)), 0.0) * best.get(frozenset((middle, second)), 0.0)
            if product > best.get(frozenset((first, second)), 0.0):
                best[frozenset((first, second))] = product
    return best


class Association:
    """Keeps every match, and the groups of those whose features are tracked."""

    def __init__(self, threshold: float, is_present: Callable[[MatchNode], bool],
                 on_unassigned: Callable[[str], None]) -> None:
        """Count matches from likelihood `threshold` on; it may be changed before solve().

        on_unassigned(id) is called for a named person that has no feature.
        """
        self.threshold = threshold
        self._is_present = is_present
        self._on_unassigned = on_unassigned
        self._graph = MatchGraph()
        self._groups: Dict[MatchNode, Group] = {}
        self._pending: "OrderedDict[FrozenSet[MatchNode], CandidateMatch]" = OrderedDict()
        self._approximate: Set[MatchNode] = set()
        self._refuted: "OrderedDict[FrozenSet[MatchNode], float]" = OrderedDict()
        self._standing: Set[FrozenSet[MatchNode]] = set()       # of these, for long enough

    @property
    def exact(self) -> bool:
        """Tell whether all groups are proved to be the best."""
        return not self._approximate

    @property
    def groups(self) -> Tuple[Group, ...]:
        """Every living feature and known person with features, in exactly one group."""
        return tuple(sorted(set(self._groups.values()), key=min))

    @property
    def assignable(self) -> List[Group]:
        """The groups that can be assigned to persons: all but the additional voices of persons who have a voice.

        A person has one voice at a time, the one that fits best. Who says that another is of the same human,
        such as its last turn, says that it is nobody else's.
        """
        return [group for group in self.groups
                if len(group) > 1 or not any(node.kind == Kind.VOICE and self._is_second(node) for node in group)]

    @property
    def matches(self) -> List[Tuple[MatchNode, MatchNode, float]]:
        """All matches that are kept between features and persons."""
        return self._graph.edges()

    def neighbours(self, node: MatchNode) -> Mapping[MatchNode, float]:
        """Return the nodes that share a match with this one, and its likelihood; to be read only."""
        return self._graph.neighbours(node)

    def recognised_as(self, feature: MatchNode) -> Set[str]:
        """Ids of the persons that recognisers take a feature for, whether it was assigned to them or not."""
        return {node.id for node, likelihood in self._graph.neighbours(feature).items()
                if node.kind == Kind.PERSON and likelihood >= self.threshold}

    def undisputed(self, wanted: Iterable[Tuple[MatchNode, Kind]]) -> Optional[Tuple[Optional[MatchNode], ...]]:
        """Return with whom of a kind each node is linked best, None for nobody; None for all where somebody else is as
        likely, or that one is linked better with another."""
        found = []
        for node, kind in wanted:
            best = self._best(node, kind)
            if len(best) > 1 or any(self._best(other, node.kind) != [node] for other in best):
                return None
            found.append(best[0] if best else None)
        return tuple(found)

    def refute(self, match: CandidateMatch, now: float) -> None:
        """Note what a match says not to be so at `now` (s): two that are there are two humans, or the recogniser doubts
        a name that it has given. A match that counts takes that back. Before add()."""
        pair = frozenset((match.first, match.second))
        if match.likelihood >= self.threshold:
            self._refuted.pop(pair, None)
        elif pair not in self._refuted and all(self._is_present(node) for node in pair) and (
                match.likelihood <= 0.0
                or (self._graph.likelihood(match.first, match.second) or 0.0) >= self.threshold
                and Kind.PERSON in {node.kind for node in pair}):
            self._refuted[pair] = now
            while len(self._refuted) > MAX_REFUTED:
                self._refuted.popitem(last=False)

    def is_refuted(self, first: MatchNode, second: MatchNode) -> bool:
        """Tell whether the last match of two who are there says that they are two humans."""
        return frozenset((first, second)) in self._refuted

    def refuted_as(self, feature: MatchNode, now: float) -> Set[str]:
        """Ids of the persons that recognisers say a feature is not, for long enough at `now` (s)."""
        return {node.id for pair, since in self._refuted.items() if feature in pair and now - since >= REFUTED_S
                for node in pair if node.kind == Kind.PERSON}

    def solve_refuted(self, now: float) -> bool:
        """Part groups of two who were told to be two for long enough at `now` (s); returns whether one has changed."""
        due = [pair for pair, since in self._refuted.items() if now - since >= REFUTED_S
               and any(pair <= group for group in {self._groups[node] for node in pair if node in self._groups})]
        self._standing = {pair for pair, since in self._refuted.items() if now - since >= REFUTED_S}
        return self.solve([node for pair in due for node in pair]) if due else False

    def add(self, match: CandidateMatch) -> bool:
        """Put a match into the graph; it is pending while one of its features is not tracked.

        Returns whether the groups may change by it.
        """
        first, second, likelihood = match.first, match.second, match.likelihood
        if all(node.kind == Kind.PERSON or self._is_present(node) for node in (first, second)):
            before = self._graph.likelihood(first, second) or 0.0
            if not self._graph.set(first, second, likelihood) or max(before, likelihood) < self.threshold:
                return False
            return min(before, likelihood) < self.threshold or not self._is_closed(self._groups.get(first), second)
        nodes = frozenset((first, second))
        self._pending.pop(nodes, None)
        if likelihood > 0.0:
            self._pending[nodes] = match
            while len(self._pending) > MAX_PENDING_MATCHES:
                self._pending.popitem(last=False)
        return False

    def add_pending(self, nodes: Iterable[MatchNode]) -> None:
        """Put the pending matches of these features into the graph."""
        arrived = set(nodes)
        for match in [self._pending.pop(key) for key in list(self._pending) if key & arrived]:
            self.add(match)

    def remove(self, node: MatchNode) -> List[MatchNode]:
        """Take a feature out of the graph; returns the nodes that have to be solved again."""
        group = self._groups.get(node, frozenset((node,)))
        touched = set(self._graph.neighbours(node)) | set(group)
        self._graph.keep_linked(node, group, self.threshold, self._refuted)
        self._graph.remove(node)
        self._forget_refuted(node)
        self.drop_group(node)
        return sorted(touched - {node})

    def matches_of(self, nodes: Iterable[MatchNode]) -> List[CandidateMatch]:
        """The matches of these nodes, to add() them again after they have left."""
        return [CandidateMatch(*edge) for node in nodes for edge in self._graph.matches(node)]

    def drop_group(self, node: MatchNode) -> None:
        """Forget the group of a node that no match names any more."""
        self._groups.pop(node, None)
        self._approximate.discard(node)

    def forget(self, node: MatchNode) -> List[MatchNode]:
        """Forget a node with all its matches; returns the nodes that have to be solved again."""
        touched = list(self._graph.neighbours(node))
        self._graph.remove(node)
        self._forget_refuted(node)
        for key in [key for key in self._pending if node in key]:
            del self._pending[key]
        self.drop_group(node)
        return touched

    def _forget_refuted(self, node: MatchNode) -> None:
        for pair in [pair for pair in self._refuted if node in pair]:
            del self._refuted[pair]
            self._standing.discard(pair)

    def solve(self, nodes: Iterable[MatchNode]) -> bool:
        """Solve the components of these nodes again, as far as they are present; returns whether a group has
        changed."""
        touched: Set[MatchNode] = set()
        for node in nodes:
            if node not in touched and self._is_present(node):
                touched.update(self._graph.component(node, self.threshold, self._is_present))
        return self._solve_all(touched)

    def part(self, nodes: Iterable[MatchNode]) -> bool:
        """Part the groups of these nodes that nothing links any more, and join nobody; returns whether one has
        changed."""
        groups = {self._groups[node] for node in nodes if node in self._groups}
        return any([self._solve_all(set(group)) for group in groups])

    def _solve_all(self, touched: Set[MatchNode]) -> bool:
        """Group these nodes anew, whatever links them with others."""
        solution = self._graph.solve(touched, self.threshold, self._kept_apart())
        self._approximate = (self._approximate - touched) | solution.approximate
        return any([self._store_group(group) for group in solution.groups])

    def _kept_apart(self) -> Set[FrozenSet[MatchNode]]:
        """Pairs that are in no group: told to be two for long enough, or a name that is new to a feature which is told
        not to bear it. One that it has is not parted so soon."""
        new = {pair for pair in self._refuted.keys() - self._standing if any(node.kind == Kind.PERSON for node in pair)
               and not any(pair <= self._groups.get(node, _NO_GROUP) for node in pair)}
        return (self._standing & self._refuted.keys()) | new

    def _best(self, node: MatchNode, kind: Kind) -> List[MatchNode]:
        """Those of a kind that are linked best with a node."""
        values = {other: likelihood for other, likelihood in self._graph.neighbours(node).items()
                  if other.kind == kind and likelihood >= self.threshold}
        return [other for other, likelihood in values.items() if likelihood == max(values.values())]

    def _is_closed(self, group: Optional[Group], other: MatchNode) -> bool:
        """Tell whether a group with this member has no choice: nobody outside is linked with it.

        As long as its links count, their strength changes nothing then.
        """
        return group is not None and other in group and not any(
            likelihood >= self.threshold and neighbour not in group and self._is_present(neighbour)
            for node in group for neighbour, likelihood in self._graph.neighbours(node).items())

    def _is_second(self, voice: MatchNode) -> bool:
        """Tell whether a voice that is alone is linked with a group that holds another one."""
        return any(likelihood >= self.threshold
                   and any(node.kind == Kind.VOICE and node != voice for node in self._groups.get(other, ()))
                   for other, likelihood in self._graph.neighbours(voice).items())

    def _store_group(self, group: Group) -> bool:
        if len(group) == 1:
            (node,) = group
            if node.kind == Kind.PERSON:      # known, yet no part of the association
                self._on_unassigned(node.id)
                return self._groups.pop(node, None) is not None
        changed = False
        for node in group:
            if self._groups.get(node) != group:
                self._groups[node] = group
                changed = True
        return changed
