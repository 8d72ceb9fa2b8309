"""The person manager without ROS: tracked features, matches and places go in, persons come out.

All times are seconds of one clock and are given by the caller. Not thread-safe: the owner holds a lock.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Callable, Dict, FrozenSet, Iterable, List, Optional, Set, Tuple

from hri_person_manager.core.association import FEATURES, Kind, MatchGraph, Node
from hri_person_manager.core.location import Decay, Location, Place, Source
from hri_person_manager.core.match_guard import Match
from hri_person_manager.core.person_book import Person, PersonBook
from hri_pipeline.core.ids import IdGenerator, is_valid_id

MAX_FEATURES = 200            # per kind; a list with more is cut, and said
MAX_KNOWN_IDS = 10000         # permanent ids that are remembered in all
MAX_UNSEEN_PERSONS = 32       # permanent persons kept with their topics although nobody sees them
MAX_STRAY_MATCHES = 1000      # matches kept for features that are not tracked (yet)
_KIND_OF_SOURCE = {Source.FACE: Kind.FACE, Source.HEAD: Kind.BODY, Source.BODY: Kind.BODY,
                   Source.VOICE: Kind.VOICE}


@dataclass(frozen=True)
class PersonState:
    """What is published about one person; `alias` names the person that this one was merged into."""

    id: str
    face: str
    body: str
    voice: str
    anonymous: bool
    confidence: float
    alias: str = ""
    place: Optional[Place] = None

    @property
    def tracked(self) -> bool:
        """Tell whether a feature of this person is tracked now."""
        return bool(self.face or self.body or self.voice)


@dataclass(frozen=True)
class Snapshot:
    """All persons at one time: those with topics, and the ids of the tracked and the known ones."""

    persons: Tuple[PersonState, ...]
    tracked: Tuple[str, ...]
    known: Tuple[str, ...]


class PersonManager:
    """Fuses faces, bodies and voices into persons and knows where they are."""

    def __init__(self, settings: SimpleNamespace, new_id: Optional[Callable[[], str]] = None) -> None:
        """Take the settings of `manager_parameters.PERSON_MANAGER_PARAMETERS`; `new_id` makes ids of 5 characters."""
        self._settings = settings
        self._threshold = settings.match_threshold
        self._decay = Decay(settings.decay, settings.half_life, settings.confidence_floor)
        self._new_id = new_id or IdGenerator().new
        self._living: Dict[Kind, Set[str]] = {kind: set() for kind in FEATURES}
        self.refused_ids = 0
        self._start_afresh()

    def _start_afresh(self) -> None:
        self._graph = MatchGraph()
        self._groups: Dict[Node, FrozenSet[Node]] = {}
        self._strays: "OrderedDict[FrozenSet[Node], Match]" = OrderedDict()
        self._known: "OrderedDict[str, None]" = OrderedDict()
        self._book = PersonBook(self._new_id, lambda: Location(self._settings.source_timeout),
                                self._settings.new_person_delay, self._settings.anonymous_persons)
        self.exact = True

    @property
    def groups(self) -> Tuple[FrozenSet[Node], ...]:
        """Return the current association: every living feature and known person in exactly one group."""
        return tuple(sorted(set(self._groups.values()), key=min))

    def reset(self, now: float) -> None:
        """Start afresh with the features that are tracked; persons and matches are forgotten."""
        self._start_afresh()
        self._solve(Node(kind, id) for kind in FEATURES for id in sorted(self._living[kind]))
        self._book.settle(self.groups, now)

    def on_tracked(self, kind: Kind, ids: Iterable[str], now: float) -> None:
        """Take the list of features of one kind that are tracked; malformed ids are left out and counted."""
        ids = list(ids)
        valid = [id for id in ids if is_valid_id(id)]
        self.refused_ids += len(ids) - len(valid) + max(0, len(valid) - MAX_FEATURES)
        listed = set(valid[:MAX_FEATURES])
        gone, new = self._living[kind] - listed, listed - self._living[kind]
        if not gone and not new:
            return
        self._living[kind] = listed
        touched = [node for id in sorted(gone) for node in self._remove_feature(Node(kind, id))]
        added = [Node(kind, id) for id in sorted(new)]
        for match in [self._strays.pop(key) for key in list(self._strays) if key & set(added)]:
            self._keep(match)
        self._solve([node for node in touched + added if self._is_present(node)])
        self._book.settle(self.groups, now)

    def on_match(self, match: Match, now: float) -> bool:
        """Take a candidate match; return whether it changed who belongs together."""
        for node in (match.first, match.second):
            if node.kind == Kind.PERSON and match.likelihood >= self._threshold:
                self._remember(node.id)
        if not self._keep(match):
            return False
        before = set(self._groups.values())
        self._solve(node for node in (match.first, match.second) if self._is_present(node))
        if set(self._groups.values()) == before:
            return False
        self._book.settle(self.groups, now)
        return True

    def on_place(self, source: Source, feature_id: str, place: Place, now: float) -> Optional[str]:
        """Take the pose of a feature's frame in the reference frame.

        Returns the id of the person whose frame moves to that place, None if no person does.
        """
        person = self._book.owner(Node(_KIND_OF_SOURCE[source], feature_id))
        if person is None or not person.location.offer(source, place, now):
            return None
        return person.id

    def tick(self, now: float) -> None:
        """Let time pass: unclaimed features become persons, places fade, forgotten persons go."""
        waiting = self._book.waiting_until()
        if waiting is not None and now >= waiting:
            self._book.settle(self.groups, now)
        for person in list(self._book.persons.values()):
            if person.features or self._confidence(person, now) > 0.0:
                continue
            person.location.clear()
            if person.anonymous:
                self._book.remove(person.id)
        self._forget_unseen()

    def silent(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and last place of the persons that have a frame although no source speaks now."""
        return [(person.id, person.location.place) for person in self._book.persons.values()
                if person.location.place is not None and self._confidence(person, now) > 0.0
                and (not person.features or person.location.is_silent(now))]

    def snapshot(self, now: float) -> Snapshot:
        """Return the state of all persons at time `now`."""
        persons = [PersonState(person.id, person.feature(Kind.FACE), person.feature(Kind.BODY),
                               person.feature(Kind.VOICE), person.anonymous,
                               self._confidence(person, now), "", person.location.place)
                   for person in self._book.persons.values()]
        persons += [PersonState(id, "", "", "", alias.person.anonymous, 0.0, alias.target)
                    for id, alias in self._book.aliases.items()]
        tracked = tuple(sorted(state.id for state in persons if state.tracked))
        present = {person.id for person in self._book.persons.values()}
        return Snapshot(tuple(persons), tracked, tuple(sorted(present | set(self._known))))

    def _confidence(self, person: Person, now: float) -> float:
        if person.location.place is None:
            return 0.0
        if person.features:
            return 1.0
        return self._decay.confidence(now - person.lost_at)

    def _is_present(self, node: Node) -> bool:
        if node.kind == Kind.PERSON:
            return node.id in self._known
        return node.id in self._living[node.kind]

    def _remember(self, person_id: str) -> None:
        self._known[person_id] = None
        self._known.move_to_end(person_id)
        while len(self._known) > MAX_KNOWN_IDS:
            self._known.popitem(last=False)

    def _keep(self, match: Match) -> bool:
        """Put a match into the graph, or aside while one of its features is not tracked."""
        nodes = frozenset((match.first, match.second))
        if all(node.kind == Kind.PERSON or self._is_present(node) for node in nodes):
            return self._graph.set(match.first, match.second, match.likelihood)
        self._strays.pop(nodes, None)
        if match.likelihood > 0.0:
            self._strays[nodes] = match
            while len(self._strays) > MAX_STRAY_MATCHES:
                self._strays.popitem(last=False)
        return False

    def _remove_feature(self, node: Node) -> List[Node]:
        """Take a feature out of the graph; returns the nodes that have to be solved again."""
        group = self._groups.get(node, frozenset((node,)))
        touched = set(self._graph.neighbours(node)) | set(group)
        self._graph.carry(node, group, self._threshold)
        self._graph.remove(node)
        self._groups.pop(node, None)
        return sorted(touched - {node})

    def _solve(self, nodes: Iterable[Node]) -> None:
        """Solve the components of these nodes again; the rest of the graph is as it was."""
        nodes = list(nodes)
        touched: Set[Node] = set()
        for node in nodes:
            if node not in touched:
                touched.update(self._graph.component(node, self._threshold, self._is_present))
        solution = self._graph.solve(touched, self._threshold)
        self.exact = solution.exact
        for group in solution.groups:
            for node in group:
                self._groups[node] = group
        self._forget_lonely_persons(touched)

    def _forget_lonely_persons(self, nodes: Iterable[Node]) -> None:
        """A person with no feature at all is known, yet no part of the association."""
        for node in nodes:
            if node.kind == Kind.PERSON and self._groups.get(node) == frozenset((node,)):
                self._book.permanent(node.id)
                del self._groups[node]

    def _forget_unseen(self) -> None:
        unseen = [person for person in self._book.persons.values()
                  if not person.anonymous and not person.features and person.location.place is None]
        for person in sorted(unseen, key=lambda item: item.lost_at or 0.0)[:-MAX_UNSEEN_PERSONS]:
            self._book.remove(person.id)
