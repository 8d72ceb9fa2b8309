"""The person manager without ROS: tracked features, matches and places go in, persons come out.

All times are seconds of one clock and are given by the caller. Not thread-safe: the owner holds a lock.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Callable, Dict, FrozenSet, Iterable, List, Mapping, Optional, Tuple

from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.camera_unions import CameraUnions
from hri_person_manager.core.known_ids import KnownIds
from hri_person_manager.core.live_association import LiveAssociation
from hri_person_manager.core.location import Decay, Location, Place, Source
from hri_person_manager.core.match_guard import Match
from hri_person_manager.core.person_book import ANONYMOUS_PREFIX, PersonBook
from hri_person_manager.core.person_state import Snapshot
from hri_person_manager.core.person_view import PersonView
from hri_person_manager.core.presence import Presence
from hri_person_manager.core.presumptions import Presumptions
from hri_person_manager.core.unions import Unions
from hri_pipeline.core.ids import IdGenerator

MAX_UNSEEN_PERSONS = 32       # permanent persons kept with their topics although nobody sees them
_KIND_OF_SOURCE = {Source.FACE: Kind.FACE, Source.HEAD: Kind.BODY, Source.BODY: Kind.BODY, Source.VOICE: Kind.VOICE}
# Likelihood of a match that an earlier run has left; the recogniser's own takes its place.
_AS_SURE_AS_BEFORE = 0.9


class PersonManager:
    """Fuses faces, bodies and voices into persons and knows where they are."""

    def __init__(self, settings: SimpleNamespace, new_id: Optional[Callable[[], str]] = None) -> None:
        """Take the settings of `manager_parameters.PERSON_MANAGER_PARAMETERS`; `new_id` makes ids of 5 characters."""
        self._settings = settings
        self._threshold = settings.match_threshold
        self._decay = Decay(settings.decay, settings.half_life, settings.confidence_floor)
        self._new_id = new_id or IdGenerator().new
        self._presence = Presence()
        self._start_afresh(KnownIds(), Unions(self._threshold))

    def _start_afresh(self, known: KnownIds, unions: Unions) -> None:
        self._known, self._unions = known, unions
        self._book = PersonBook(self._new_id, lambda: Location(self._settings.source_timeout, self._settings.coast_time),
                                self._settings.new_person_delay, self._settings.anonymous_persons,
                                self._settings.voice_person_delay)
        self._view = PersonView(self._book, self._unions, self._decay)
        self._association = LiveAssociation(self._threshold, self._is_present, self._make_permanent)
        self._presumptions = Presumptions(self._presence, self._association, self._settings.features_from_matches)
        self._cameras = CameraUnions(self._settings, self._book, self._association, self._unions)

    def reconfigure(self, settings: SimpleNamespace, now: float) -> None:
        """Take up the values of the live parameters at `now` (s): persons and matches stay, who belongs together is solved anew."""
        self._settings = settings
        self._threshold = self._association.threshold = self._unions.threshold = settings.match_threshold
        self._decay = self._view.decay = Decay(settings.decay, settings.half_life, settings.confidence_floor)
        self._book.set_delays(settings.new_person_delay, settings.voice_person_delay)
        self._cameras.reconfigure(settings)
        self._association.solve(self._presence.features())
        self._settle(now)

    @property
    def refused_ids(self) -> int:
        """How many ids of tracked lists were refused so far."""
        return self._presence.refused

    @property
    def groups(self) -> Tuple[FrozenSet[Node], ...]:
        """Return the current association: every living feature and known person in exactly one group."""
        return self._association.groups

    @property
    def exact(self) -> bool:
        """Tell whether the last association was proved to be the best."""
        return self._association.exact

    def reset(self, now: float) -> None:
        """Start afresh with the features that are tracked; persons and matches are forgotten."""
        self._start_afresh(KnownIds(), Unions(self._threshold))
        self._association.solve(self._presence.features())
        self._settle(now)

    def rewind(self, now: float) -> None:
        """Go on after time has jumped back to `now` (s): the same persons and matches; places and delays start anew."""
        anonymous, matches = self.anonymous(), self.matches
        self._start_afresh(self._known, self._unions)
        self._presence.rewind(now)
        self.expect(anonymous)
        for edge in matches:
            self._association.keep(Match(*edge))
        self._association.solve(self._presence.features())
        self._settle(now)

    def on_tracked(self, kind: Kind, ids: Iterable[str], now: float) -> None:
        """Take the list of features of one kind that are tracked; malformed ids are left out and counted."""
        gone, new, presumed = self._presence.tracked(kind, ids)
        if not gone and not new:
            return
        kept = self._association.set_aside(presumed)
        touched = [node for gone_node in gone for node in self._association.leave(gone_node)]
        for match in kept:
            self._association.keep(match)
        self._association.arrive(new)
        self._association.solve(touched + new)
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
        for feature, person in (nodes, nodes[::-1]):
            if person.kind == Kind.PERSON and person.id.startswith(ANONYMOUS_PREFIX):
                return self._claim(feature, person.id, match.likelihood, now)
        arrived = self._presumptions.begin(nodes, now) if match.likelihood > 0.0 else []
        worth = self._association.keep(match)
        changed = self._association.solve(nodes) if worth or arrived else False
        if self._presumptions.end(nodes) or arrived or changed or (worth and Kind.VOICE in {node.kind for node in nodes}):
            self._settle(now)
            return True
        return False

    @property
    def matches(self) -> List[Tuple[Node, Node, float]]:
        """All candidate matches that are kept between features and persons."""
        return self._association.matches

    @property
    def unions(self) -> Tuple[Tuple[str, str, float], ...]:
        """All candidate matches that are kept between persons, and those whom several cameras see at one place."""
        return self._unions.pairs + self._unions.seen

    def merge(self, person_id: str, other: str, now: float) -> Tuple[str, str]:
        """Join two persons for good, until they are split; returns the one that stays and its alias.

        `person_id` stays, unless it is anonymous and the other is not. ValueError when one of them does not exist.
        """
        for name in (person_id, other):
            if name not in self._book.persons and name not in self._known:
                raise ValueError("there is no person {!r}".format(name))
        if not self.is_permanent(person_id) and self.is_permanent(other):
            person_id, other = other, person_id
        self._unions.set(person_id, other, 1.0)
        self._unions.prefer(person_id, other)
        self._settle_unions(now)
        return person_id, other

    def is_permanent(self, person_id: str) -> bool:
        """Tell whether a person is known by more than its present features."""
        return person_id in self._known

    def person_of(self, feature: Node) -> Optional[str]:
        """Return the id of the person that a feature is published for, None if nobody has claimed it."""
        owner = self._book.owner(feature)
        return self._view.standing_for(owner).id if owner is not None else None

    def split(self, person_id: str, now: float) -> None:
        """Undo the unions of a person. ValueError when it is joined with nobody."""
        if not self._unions.split(person_id):
            raise ValueError("person {!r} is joined with nobody".format(person_id))
        self._settle_unions(now)

    def forget(self, person_id: str, now: float) -> bool:
        """Forget a person with all its matches; its features, while they are tracked, are strangers again.

        Returns False for somebody who does not exist.
        """
        members = {person_id} | {id for id, alias in self._book.aliases.items() if alias.target == person_id}
        if not members & (set(self._book.persons) | set(self._known) | set(self._book.aliases)):
            return False
        touched = self._association.forget(Node(Kind.PERSON, person_id))
        self._known.remove(person_id)
        self._unions.remove(person_id)
        self._book.remove(person_id)
        self._association.solve(touched)
        self._settle(now)
        return True

    def know(self, person_ids: Iterable[str]) -> None:
        """Take over the permanent persons that a store remembers, those known first first."""
        for person_id in person_ids:
            self._remember(person_id)

    def expect(self, anonymous: Mapping[str, Iterable[Node]]) -> None:
        """Give anonymous persons of an earlier run their ids again when their features are tracked still."""
        self._book.expect(anonymous)

    def anonymous(self) -> Dict[str, List[Node]]:
        """The anonymous persons with their features, for `expect` after a restart."""
        return self._view.anonymous()

    def identified(self) -> Dict[str, List[Node]]:
        """The permanent persons with their faces, or other features, for `recall` after a restart."""
        return self._view.identified()

    def recall(self, identified: Mapping[str, Iterable[Node]], now: float) -> None:
        """Take it that features of an earlier run are those of permanent persons still, until a recogniser says otherwise."""
        for person_id, nodes in identified.items():
            for node in nodes:
                self.on_match(Match(node, Node(Kind.PERSON, person_id), max(self._threshold, _AS_SURE_AS_BEFORE)), now)

    def on_place(self, source: Source, feature_id: str, place: Place, now: float, sensor: str = "") -> Optional[str]:
        """Take the pose of a feature's frame in the reference frame; sensor: the frame of the camera that sees it.

        Returns the id of the person whose frame moves by it, to its place(), None if no person's does.
        """
        feature = Node(_KIND_OF_SOURCE[source], feature_id)
        owner = self._book.owner(feature)
        if owner is None:
            return None
        self._cameras.saw(owner, source, place, sensor)
        person = self._view.standing_for(owner)
        if person is not owner:
            owner.location.offer(source, place, now, feature)
        return person.id if person.location.offer(source, place, now, feature) else None

    def place(self, person_id: str) -> Optional[Place]:
        """Return where a person was seen last, in the reference frame; None where nobody has."""
        return self._book.persons[person_id].location.place

    def tick(self, now: float) -> None:
        """Let time pass: unclaimed features become persons, places fade, forgotten persons go."""
        lapsed = self._presumptions.lapse(now)
        waiting = self._book.waiting_until()
        if lapsed or (waiting is not None and now >= waiting):
            self._settle(now)
        gone = self._view.fade(now) + self._view.long_unseen()[:-MAX_UNSEEN_PERSONS]
        for person_id in gone:
            if self._book.persons[person_id].anonymous:
                self._unions.remove(person_id)
            self._book.remove(person_id)
        if self._cameras.update() or gone:
            self._settle_unions(now)

    def silent(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and place of the persons that have a frame although no source speaks now."""
        return self._view.silent(now)

    def snapshot(self, now: float) -> Snapshot:
        """Return the state of all persons at time `now`."""
        return self._view.snapshot(self._known, now)

    def _is_present(self, node: Node) -> bool:
        return node.id in self._known if node.kind == Kind.PERSON else node in self._presence

    def _claim(self, feature: Node, person_id: str, likelihood: float, now: float) -> bool:
        """Take a match with an anonymous person: one without features gets this one, else its person is joined with it."""
        if person_id not in self._book.persons:
            return False
        seen = sorted(node for node in self._book.persons[person_id].features if node.kind != Kind.VOICE)
        if seen and feature.kind == Kind.VOICE:
            # To what is seen of the person: the voice needs no person of its own in between.
            return any([self.on_match(Match(feature, node, likelihood), now) for node in (seen[:1] if likelihood else seen)])
        if self._book.owner(feature) is None and likelihood >= self._threshold:
            self._presumptions.begin((feature,), now)
            if not self._is_present(feature):
                return False
            self._association.solve((feature,))
            self._book.claim(feature, person_id)
            self._settle(now)
        owner = self._book.owner(feature)
        if owner is None:
            return False
        if owner.id != person_id:
            self._unions.set(owner.id, person_id, likelihood)
        self._settle_unions(now)
        return True

    def _settle(self, now: float) -> None:
        self._book.settle(self._association.claimants, now)
        self._settle_unions(now)

    def _settle_unions(self, now: float) -> bool:
        """Choose anew who stands for whom; returns whether that has changed."""
        persons = self._book.persons
        for first, second, likelihood in self._unions.pairs:
            for present, other in ((first, second), (second, first)):
                if likelihood >= self._threshold and present in persons and other in self._known:
                    self._book.permanent(other)
        changed = self._unions.settle(
            persons, lambda id: (persons[id].anonymous, not self._unions.is_preferred(id),
                                 self._known.number(id, persons[id].number), id))
        self._view.stale()
        if changed:
            self._view.inherit_places()
        return changed

    def _make_permanent(self, person_id: str) -> None:
        self._book.permanent(person_id)
        self._view.stale()

    def _remember(self, person_id: str) -> None:
        if self._known.add(person_id):
            self._view.stale()
