"""The persons as they are published: unions as one, places that fade, who stands for whom."""

from __future__ import annotations

from typing import Dict, Iterable, List, NamedTuple, Optional, Tuple

from hri_person_manager.core.association import FEATURES, Kind, Node
from hri_person_manager.core.location import Decay, Place
from hri_person_manager.core.person_book import Person, PersonBook
from hri_person_manager.core.person_state import PersonState, Snapshot
from hri_person_manager.core.unions import Unions


class _Shown(NamedTuple):
    """One person of the book: who stands for it, and whom it stands for, itself first; nobody when it is an alias."""

    person: Person
    target: str
    members: Tuple[Person, ...]
    features: Dict[Kind, str]


class PersonView:
    """Reads book and unions. Whoever changes them calls stale()."""

    def __init__(self, book: PersonBook, unions: Unions, decay: Decay) -> None:
        self._book = book
        self._unions = unions
        self.decay = decay
        self._shown: Optional[Dict[str, _Shown]] = None
        self._aliases: Tuple[PersonState, ...] = ()
        self._tracked: Tuple[str, ...] = ()
        self._known: Optional[Tuple[str, ...]] = None

    def stale(self) -> None:
        """Note that persons, their features or the unions have changed."""
        self._shown = None
        self._known = None

    def silent(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and place of the persons that have a frame although no source speaks now."""
        return [(shown.person.id, shown.person.location.expected(now)) for shown in self._all().values()
                if shown.members and shown.person.location.place is not None
                and (not shown.features or shown.person.location.is_silent(now)) and self._confidence(shown, now) > 0.0]

    def snapshot(self, known: Iterable[str], now: float) -> Snapshot:
        """Return the state of all persons at time `now`; `known`: ids of the permanent persons, seen or not."""
        persons = [self._state(shown, now) for shown in self._all().values()]
        if self._known is None:
            self._known = tuple(sorted(set(self._book.persons) | set(known)))
        return Snapshot((*persons, *self._aliases), self._tracked, self._known)

    def anonymous(self) -> Dict[str, List[Node]]:
        """Return the anonymous persons that have features, with those."""
        found: Dict[str, List[Node]] = {}
        for person in self._book.persons.values():
            target = self.standing_for(person)
            # The oldest id of a union outlives the feature that it was given for.
            named = target if target.anonymous and not target.features else person
            if named.anonymous and person.features:
                found.setdefault(named.id, []).extend(sorted(person.features))
        return found

    def identified(self) -> Dict[str, List[Node]]:
        """Return the permanent persons that have features, with their faces, or with the others where there is no face."""
        found: Dict[str, List[Node]] = {}
        for person in self._book.persons.values():
            target = self.standing_for(person)
            if not target.anonymous and person.features:
                found.setdefault(target.id, []).extend(sorted(person.features))
        faces = {name: [node for node in nodes if node.kind == Kind.FACE] for name, nodes in found.items()}
        return {name: faces[name] or nodes for name, nodes in found.items()}

    def fade(self, now: float) -> List[str]:
        """Let go of the places that are not to be trusted any more at time `now` (s); returns the anonymous persons without a place."""
        gone = []
        for person in self._book.persons.values():
            if not self.features(person) and not person.features and self.confidence(person, now) <= 0.0:
                person.location.clear()
                if person.anonymous:
                    gone.append(person.id)
        return gone

    def long_unseen(self) -> List[str]:
        """Ids of the permanent persons without features and place, who was lost first first."""
        unseen = [shown.person for shown in self._all().values() if not shown.person.anonymous and not shown.features
                  and not shown.person.features and shown.person.location.place is None]
        return [person.id for person in sorted(unseen, key=lambda item: item.lost_at or 0.0)]

    def inherit_places(self) -> None:
        """Give whoever stands for others the newest place that one of them has."""
        for person in self._book.persons.values():
            target = self.standing_for(person)
            if target is not person:
                target.location.inherit(person.location)

    def members(self, person: Person) -> Tuple[Person, ...]:
        """The persons of a union that this one stands for, itself first; nobody when it is an alias."""
        return self._all()[person.id].members

    def features(self, person: Person) -> Dict[Kind, str]:
        """Ids of the features that are published for a person: its own, else those of the persons joined with it."""
        return self._all()[person.id].features

    def standing_for(self, person: Person) -> Person:
        """Return the person of a union that all its features are published for."""
        return self._book.persons.get(self._unions.target(person.id), person)

    def confidence(self, person: Person, now: float) -> float:
        """Return how far the place of a person is to be trusted at time `now` (s): 1 while it is seen."""
        return self._confidence(self._all()[person.id], now)

    def _confidence(self, shown: _Shown, now: float) -> float:
        if shown.person.location.place is None:
            return 0.0
        members = shown.members or (shown.person,)
        if shown.features or any(member.features for member in members):
            return 1.0
        return self.decay.confidence(now - max(member.lost_at or 0.0 for member in members))

    def _all(self) -> Dict[str, _Shown]:
        """All persons, looked up anew after a change."""
        if self._shown is None:
            self._shown = {person.id: self._show(person) for person in self._book.persons.values()}
            self._aliases = tuple(
                PersonState(id, "", "", "", alias.person.anonymous, 0.0, self._unions.target(alias.target))
                for id, alias in self._book.aliases.items())
            self._tracked = tuple(sorted(shown.person.id for shown in self._shown.values() if shown.features))
        return self._shown

    def _show(self, person: Person) -> _Shown:
        target = self._unions.target(person.id)
        if target != person.id:
            return _Shown(person, target, (), {})
        members = tuple(self._book.persons[id] for id in self._unions.members(person.id) if id in self._book.persons)
        features: Dict[Kind, str] = {}
        for member in members:
            for node in sorted(member.features):
                features.setdefault(node.kind, node.id)
        return _Shown(person, target, members, features)

    def _state(self, shown: _Shown, now: float) -> PersonState:
        person = shown.person
        if not shown.members:
            return PersonState(person.id, "", "", "", person.anonymous, 0.0, shown.target)
        face, body, voice = (shown.features.get(kind, "") for kind in FEATURES)
        return PersonState(person.id, face, body, voice, person.anonymous, self._confidence(shown, now), "",
                           person.location.place)
