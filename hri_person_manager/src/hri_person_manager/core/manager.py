"""The person manager without ROS: tracked features, matches and places go in, persons come out.

All times are seconds of one clock and are given by the caller. Not thread-safe: the owner holds a lock.
"""

from __future__ import annotations

from collections import OrderedDict
from types import SimpleNamespace
from typing import Callable, Dict, FrozenSet, Iterable, List, Mapping, Optional, Set, Tuple

from hri_person_manager.core.association import FEATURES, Kind, MatchGraph, Node
from hri_person_manager.core.location import Decay, Location, Place, Source
from hri_person_manager.core.match_guard import Match
from hri_person_manager.core.person_book import ANONYMOUS_PREFIX, Person, PersonBook
from hri_person_manager.core.person_state import PersonState, Snapshot
from hri_person_manager.core.presence import Presence
from hri_person_manager.core.unions import Unions
from hri_pipeline.core.ids import IdGenerator

MAX_KNOWN_IDS = 10000         # permanent ids that are remembered in all
MAX_UNSEEN_PERSONS = 32       # permanent persons kept with their topics although nobody sees them
MAX_STRAY_MATCHES = 1000      # matches kept for features that are not tracked (yet)
_KIND_OF_SOURCE = {Source.FACE: Kind.FACE, Source.HEAD: Kind.BODY, Source.BODY: Kind.BODY,
                   Source.VOICE: Kind.VOICE}


class PersonManager:
    """Fuses faces, bodies and voices into persons and knows where they are."""

    def __init__(self, settings: SimpleNamespace, new_id: Optional[Callable[[], str]] = None) -> None:
        """Take the settings of `manager_parameters.PERSON_MANAGER_PARAMETERS`; `new_id` makes ids of 5 characters."""
        self._settings = settings
        self._threshold = settings.match_threshold
        self._decay = Decay(settings.decay, settings.half_life, settings.confidence_floor)
        self._new_id = new_id or IdGenerator().new
        self._presence = Presence()
        self._start_afresh()

    def _start_afresh(self) -> None:
        self._graph = MatchGraph()
        self._groups: Dict[Node, FrozenSet[Node]] = {}
        self._strays: "OrderedDict[FrozenSet[Node], Match]" = OrderedDict()
        self._known: "OrderedDict[str, int]" = OrderedDict()     # with a number that says who was known first
        self._number = 0
        self._unions = Unions(self._threshold)
        self._book = PersonBook(self._new_id, lambda: Location(self._settings.source_timeout, self._settings.coast_time),
                                self._settings.new_person_delay, self._settings.anonymous_persons)
        self.exact = True

    @property
    def refused_ids(self) -> int:
        """How many ids of tracked lists were refused so far."""
        return self._presence.refused

    @property
    def groups(self) -> Tuple[FrozenSet[Node], ...]:
        """Return the current association: every living feature and known person in exactly one group."""
        return tuple(sorted(set(self._groups.values()), key=min))

    def reset(self, now: float) -> None:
        """Start afresh with the features that are tracked; persons and matches are forgotten."""
        self._start_afresh()
        self._solve(self._presence.features())
        self._settle(now)

    def on_tracked(self, kind: Kind, ids: Iterable[str], now: float) -> None:
        """Take the list of features of one kind that are tracked; malformed ids are left out and counted."""
        gone, new, presumed = self._presence.tracked(kind, ids)
        if not gone and not new:
            return
        kept = [match for node in presumed for match in self._graph.matches(node)]
        touched = [node for gone_node in gone for node in self._remove_feature(gone_node)]
        for first, second, likelihood in kept:
            self._keep(Match(first, second, likelihood))
        for match in [self._strays.pop(key) for key in list(self._strays) if key & set(new)]:
            self._keep(match)
        self._solve([node for node in touched + new if self._is_present(node)])
        self._settle(now)

    def on_match(self, match: Match, now: float) -> bool:
        """Take a candidate match; return whether it changed who belongs together."""
        nodes = (match.first, match.second)
        if match.likelihood >= self._threshold:
            for node in nodes:
                if node.kind == Kind.PERSON and not node.id.startswith(ANONYMOUS_PREFIX):
                    self._remember(node.id)
        if nodes[0].kind == nodes[1].kind == Kind.PERSON:
            changed = self._unions.set(nodes[0].id, nodes[1].id, match.likelihood)
            return self._settle_unions(now) and changed
        arrived = self._presume(nodes, now) if match.likelihood > 0.0 else []
        if not self._keep(match):
            return False
        before = set(self._groups.values())
        self._solve(node for node in nodes if self._is_present(node))
        left = self._end_presumptions(nodes)
        if not arrived and not left and set(self._groups.values()) == before:
            return False
        self._settle(now)
        return True

    @property
    def matches(self) -> List[Tuple[Node, Node, float]]:
        """All candidate matches that are kept between features and persons."""
        return self._graph.edges()

    @property
    def unions(self) -> Tuple[Tuple[str, str, float], ...]:
        """All candidate matches that are kept between persons."""
        return self._unions.pairs

    def merge(self, person_id: str, other: str, now: float) -> None:
        """Make `other` an alias of `person_id` or the other way round. ValueError when one of them does not exist."""
        for name in (person_id, other):
            if name not in self._book.persons and name not in self._known:
                raise ValueError("there is no person {!r}".format(name))
        self._unions.set(person_id, other, 1.0)
        self._settle_unions(now)

    def split(self, person_id: str, now: float) -> None:
        """Undo the unions of a person. ValueError when it is joined with nobody."""
        if not self._unions.split(person_id):
            raise ValueError("person {!r} is joined with nobody".format(person_id))
        self._settle_unions(now)

    def expect(self, anonymous: Mapping[str, Iterable[Node]]) -> None:
        """Give anonymous persons of an earlier run their ids again when their features are tracked still."""
        self._book.expect(anonymous)

    def anonymous(self) -> Dict[str, List[Node]]:
        """The anonymous persons with their features, for `expect` after a restart."""
        return {person.id: sorted(person.features) for person in self._book.persons.values()
                if person.anonymous and person.features}

    def on_place(self, source: Source, feature_id: str, place: Place, now: float) -> Optional[str]:
        """Take the pose of a feature's frame in the reference frame.

        Returns the id of the person whose frame moves to that place, None if no person does.
        """
        feature = Node(_KIND_OF_SOURCE[source], feature_id)
        owner = self._book.owner(feature)
        if owner is None:
            return None
        person = self._standing_for(owner)
        if person is not owner:
            owner.location.offer(source, place, now, feature)
        return person.id if person.location.offer(source, place, now, feature) else None

    def tick(self, now: float) -> None:
        """Let time pass: unclaimed features become persons, places fade, forgotten persons go."""
        lapsed = self._presence.lapsed(now)
        for node in lapsed:
            self._presence.drop(node)
        self._solve([other for node in lapsed for other in self._remove_feature(node) if self._is_present(other)])
        waiting = self._book.waiting_until()
        if lapsed or (waiting is not None and now >= waiting):
            self._settle(now)
        gone = []
        for person in list(self._book.persons.values()):
            if self._features(person) or person.features or self._confidence(person, now) > 0.0:
                continue
            person.location.clear()
            if person.anonymous:
                gone.append(person.id)
        gone += self._unseen_too_many()
        for person_id in gone:
            if self._book.persons[person_id].anonymous:
                self._unions.remove(person_id)
            self._book.remove(person_id)
        if gone:
            self._settle_unions(now)

    def silent(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and place of the persons that have a frame although no source speaks now."""
        return [(person.id, person.location.expected(now)) for person in self._book.persons.values()
                if self._standing_for(person) is person
                and person.location.place is not None and self._confidence(person, now) > 0.0
                and (not self._features(person) or person.location.is_silent(now))]

    def snapshot(self, now: float) -> Snapshot:
        """Return the state of all persons at time `now`."""
        persons = [self._state(person, now) for person in self._book.persons.values()]
        persons += [PersonState(id, "", "", "", alias.person.anonymous, 0.0, self._unions.target(alias.target))
                    for id, alias in self._book.aliases.items()]
        tracked = tuple(sorted(state.id for state in persons if state.tracked))
        present = {person.id for person in self._book.persons.values()}
        return Snapshot(tuple(persons), tracked, tuple(sorted(present | set(self._known))))

    def _state(self, person: Person, now: float) -> PersonState:
        target = self._unions.target(person.id)
        if target != person.id:
            return PersonState(person.id, "", "", "", person.anonymous, 0.0, target)
        features = self._features(person)
        return PersonState(person.id, *(features.get(kind, "") for kind in FEATURES), person.anonymous,
                           self._confidence(person, now), "", person.location.place)

    def _members(self, person: Person) -> List[Person]:
        """The persons of a union that this one stands for, itself first; nobody when it is an alias."""
        if self._unions.target(person.id) != person.id:
            return []
        return [self._book.persons[id] for id in self._unions.members(person.id) if id in self._book.persons]

    def _features(self, person: Person) -> Dict[Kind, str]:
        """Ids of the features that are published for a person: its own, else those of the persons joined with it."""
        found: Dict[Kind, str] = {}
        for member in self._members(person):
            for node in sorted(member.features):
                found.setdefault(node.kind, node.id)
        return found

    def _standing_for(self, person: Person) -> Person:
        return self._book.persons.get(self._unions.target(person.id), person)

    def _confidence(self, person: Person, now: float) -> float:
        if person.location.place is None:
            return 0.0
        members = self._members(person) or [person]
        if any(member.features for member in members):
            return 1.0
        return self._decay.confidence(now - max(member.lost_at or 0.0 for member in members))

    def _is_present(self, node: Node) -> bool:
        if node.kind == Kind.PERSON:
            return node.id in self._known
        return node in self._presence

    def _presume(self, nodes: Iterable[Node], now: float) -> List[Node]:
        """Count features as present that a match names before their list does."""
        if not self._settings.features_from_matches:
            return []
        arrived = [node for node in nodes if node.kind != Kind.PERSON and self._presence.presume(node, now)]
        for match in [self._strays.pop(key) for key in list(self._strays) if key & set(arrived)]:
            self._keep(match)
        return arrived

    def _end_presumptions(self, nodes: Iterable[Node]) -> bool:
        """Drop features for which only matches spoke that are withdrawn; returns whether there was one."""
        over = [node for node in nodes if node.kind != Kind.PERSON and self._presence.is_presumed(node)
                and not self._graph.neighbours(node)]
        for node in over:
            self._presence.drop(node)
            self._groups.pop(node, None)
        return bool(over)

    def _settle(self, now: float) -> None:
        self._book.settle(self.groups, now)
        self._settle_unions(now)

    def _settle_unions(self, now: float) -> bool:
        """Choose anew who stands for whom; returns whether that has changed."""
        persons = self._book.persons
        for first, second, likelihood in self._unions.pairs:
            for present, other in ((first, second), (second, first)):
                if likelihood >= self._threshold and present in persons and other in self._known:
                    self._book.permanent(other)
        changed = self._unions.settle(
            persons, lambda id: (persons[id].anonymous, self._known.get(id, persons[id].number), id))
        for person in persons.values():
            target = self._standing_for(person)
            if changed and target is not person:
                target.location.inherit(person.location)
        return changed

    def _remember(self, person_id: str) -> None:
        self._number += 1
        self._known.setdefault(person_id, self._number)
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

    def _unseen_too_many(self) -> List[str]:
        """Ids of the permanent persons that have been unseen for longest, beyond those that keep their topics."""
        unseen = [person for person in self._book.persons.values()
                  if not person.anonymous and not person.features and person.location.place is None
                  and not self._features(person)]
        return [person.id for person in sorted(unseen, key=lambda item: item.lost_at or 0.0)[:-MAX_UNSEEN_PERSONS]]
