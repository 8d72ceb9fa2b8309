"""Lets unions of persons come and go by what several cameras see."""

from __future__ import annotations

from types import SimpleNamespace

from hri_person_manager.core.cross_camera import CrossCamera, PersonFacts
from hri_person_manager.core.live_association import LiveAssociation
from hri_person_manager.core.location import Place, Source
from hri_person_manager.core.person_book import Person, PersonBook
from hri_person_manager.core.unions import Unions


class CameraUnions:
    """Tells CrossCamera of the persons of the book, and the unions what it finds."""

    def __init__(self, settings: SimpleNamespace, book: PersonBook, association: LiveAssociation,
                 unions: Unions) -> None:
        self._book, self._association, self._unions = book, association, unions
        self._settings = settings
        self._cross = CrossCamera(settings.cross_camera_distance, settings.cross_camera_time,
                                  settings.cross_camera_handover)

    def reconfigure(self, settings: SimpleNamespace) -> None:
        """Take up the values of the live parameters; what was seen stays."""
        self._settings = settings
        self._cross.limit(settings.cross_camera_distance, settings.cross_camera_time, settings.cross_camera_handover)

    def saw(self, person: Person, source: Source, place: Place, sensor: str) -> None:
        """Take the place of a feature of a person, seen by a sensor; only places in the reference frame can be compared."""
        if self._settings.cross_camera and source != Source.VOICE and place.frame == self._settings.reference_frame:
            self._cross.saw(person.id, int(source), sensor, place.horizontal, place.stamp)

    def update(self) -> bool:
        """Join and part; returns whether any union may have changed."""
        if self._cross.is_idle:
            self._cross.keep(self._book.persons)
            return False
        merged = {id: alias.target for id, alias in self._book.aliases.items()}
        changed = False
        for link in self._cross.update([self._facts(person) for person in self._book.persons.values()], merged):
            likelihood = max(link.likelihood, self._settings.match_threshold) if link.likelihood > 0.0 else 0.0
            changed |= self._unions.see(link.first, link.second, likelihood)
        return changed

    def _facts(self, person: Person) -> PersonFacts:
        names = {name for feature in person.features for name in self._association.named(feature)}
        return PersonFacts(person.id, self._unions.target(person.id), bool(person.features), person.anonymous,
                           frozenset(names if person.anonymous else names | {person.id}))
