"""The person table: which persons exist, and what is published of them.

There are anonymous persons, made from features, and permanent ones, named by recognisers. A feature that is assigned to
nobody for a while becomes an anonymous person. That person keeps its id while any of its features is tracked. When two
persons turn out to be one, the older stays and the other becomes an alias of it; when they turn out to be two again,
the alias is restored as the person that it was.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import (
    Callable,
    Container,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)

from hri_person_manager.core.features import FEATURES, Kind, MatchNode
from hri_person_manager.core.location import Decay, PersonLocation, Place, aged_place
from hri_person_manager.core.merges import Merges

ANONYMOUS_PREFIX = "anonymous_person_"
MAX_KNOWN_IDS = 10000
Group = FrozenSet[MatchNode]


@dataclass
class PersonEntry:
    """One person: `number` counts in order of appearance, `lost_at` is the time (s) the last feature left.

    `features` maps each feature to the time (s) since when it belongs to this person; `doubted` are those of which it
    was said since that they do not.
    """

    id: str
    number: int
    anonymous: bool
    location: PersonLocation
    features: Dict[MatchNode, float] = field(default_factory=dict)
    lost_at: Optional[float] = None
    doubted: Set[MatchNode] = field(default_factory=set)


@dataclass
class Alias:
    """A person that was merged into `target`; `person` is kept to come back if they are parted again."""

    person: PersonEntry
    target: str


class PersonTable:
    """All persons that exist, and what has become of merged ones."""

    def __init__(self, new_id: Callable[[], str], new_location: Callable[[], PersonLocation],
                 new_person_delay: float, anonymous_persons: bool, voice_person_delay: float = 0.0) -> None:
        """Make ids with `new_id` (5 characters); a feature waits `new_person_delay` seconds for an assignment.

        voice_person_delay: s that a voice alone waits, if that is longer.
        """
        self._new_id = new_id
        self._new_location = new_location
        self.set_delays(new_person_delay, voice_person_delay)
        self._anonymous_persons = anonymous_persons
        self._count = 0
        self._unassigned: Dict[MatchNode, float] = {}
        self._of_feature: Dict[MatchNode, PersonEntry] = {}
        self._expected: Dict[MatchNode, str] = {}
        self._held: FrozenSet[MatchNode] = frozenset()
        self._due: FrozenSet[MatchNode] = frozenset()
        self.persons: Dict[str, PersonEntry] = {}
        self.aliases: Dict[str, Alias] = {}

    def permanent(self, person_id: str) -> PersonEntry:
        """Return the permanent person with this id, made if it is new."""
        person = self.persons.get(person_id)
        if person is None:
            alias = self.aliases.pop(person_id, None)
            person = alias.person if alias is not None else self._make(person_id)
            self.persons[person_id] = person
        person.anonymous = False
        return person

    def expect(self, anonymous: Mapping[str, Iterable[MatchNode]]) -> None:
        """Take these ids for the anonymous persons that are made of these features (those of an earlier run)."""
        self._expected = {node: person_id for person_id, nodes in anonymous.items() for node in nodes}

    def expect_feature(self, feature: MatchNode, person_id: str) -> None:
        """Assign a feature without a person, in the next associate(), to an anonymous person that has lost all
        features."""
        self._expected[feature] = person_id

    def doubt(self, feature: MatchNode, is_doubted: bool) -> None:
        """Note whether the owner of a feature still is who a match gave it to: else it goes, alone, to whoever has been
        seen for longer when they turn out to be of one human."""
        owner = self._of_feature[feature]
        (owner.doubted.add if is_doubted else owner.doubted.discard)(feature)

    def hold(self, held: FrozenSet[MatchNode], due: FrozenSet[MatchNode]) -> None:
        """Make no anonymous person of the features `held`, however long they wait; make one of those `due` at once."""
        self._held, self._due = held, due

    @property
    def unassigned(self) -> Mapping[MatchNode, float]:
        """Features that are assigned to nobody, and since when (s)."""
        return self._unassigned

    def owner(self, feature: MatchNode) -> Optional[PersonEntry]:
        """Return the person that a feature belongs to, None if it is assigned to nobody."""
        return self._of_feature.get(feature)

    def associate(self, groups: Iterable[Group], now: float) -> List[MatchNode]:
        """Give every group of features its person; `groups` hold each living feature at most once.

        A feature that is in none of them belongs to nobody. Returns the features that belong to somebody else now.
        """
        owners: Dict[Group, PersonEntry] = {}
        nameless: List[Group] = []
        for group in groups:
            named = next((node for node in group if node.kind == Kind.PERSON), None)
            if named is None:
                nameless.append(group)
            else:
                owners[group] = self.permanent(named.id)
        merged = self._place_anonymous(owners, nameless, now)
        others = self._restore_aliases(owners, nameless)
        self._make_new(owners, nameless, now, self._due | others)
        for person, target in merged:
            self._merge(person, target)
        before = self._of_feature
        self._write_features(owners, now)
        self._drop_dead_aliases()
        return [node for node, person in self._of_feature.items() if before.get(node) is not person]

    def set_delays(self, new_person_delay: float, voice_person_delay: float) -> None:
        """Set how long features wait (s), as in the constructor, from now on."""
        self._delay = new_person_delay
        self._voice_delay = max(new_person_delay, voice_person_delay)

    def waiting_until(self) -> Optional[float]:
        """Return the time (s) at which the next unassigned feature becomes a person, None if none waits."""
        if not self._anonymous_persons:
            return None
        return min((since + self._delay_of((node,)) for node, since in self._unassigned.items()
                    if node not in self._held), default=None)

    def remove(self, person_id: str) -> None:
        """Forget a person, or an alias, and those merged into it."""
        self.aliases.pop(person_id, None)
        person = self.persons.pop(person_id, None)
        if person is not None:
            for node in person.features:
                self._of_feature.pop(node, None)
        for alias_id in [key for key, alias in self.aliases.items() if alias.target == person_id]:
            del self.aliases[alias_id]

    def _make(self, person_id: str) -> PersonEntry:
        self._count += 1
        return PersonEntry(person_id, self._count, True, self._new_location())

    def _place_anonymous(self, owners: Dict[Group, PersonEntry], nameless: List[Group],
                         now: float) -> List[Tuple[PersonEntry, PersonEntry]]:
        """Let each anonymous person, oldest first, keep one group that has a feature of it."""
        group_of = {node: group for groups in (owners, nameless) for group in groups for node in group}
        merged = []
        for person in sorted(self.persons.values(), key=lambda item: item.number):
            if not person.anonymous:
                continue
            own = sorted({group_of[node] for node in person.features if node in group_of and not (
                node in person.doubted and self._is_of_another(node, person, group_of[node]))},
                key=lambda group: _preference(person, group, now))
            free = [group for group in own if group not in owners]
            if free:
                owners[free[0]] = person
            elif own:
                merged.append((person, owners[own[0]]))
        return merged

    def _is_of_another(self, feature: MatchNode, person: PersonEntry, group: Group) -> bool:
        """Tell whether a group holds what has been seen of another person since before this one had the feature."""
        return any(owner is not person and node.kind != Kind.VOICE and owner.features[node] <= person.features[feature]
                   for node, owner in ((node, self._of_feature.get(node)) for node in group) if owner is not None)

    def _restore_aliases(self, owners: Dict[Group, PersonEntry], nameless: List[Group]) -> FrozenSet[MatchNode]:
        """Give merged persons back what was theirs and is nobody's now; returns what was so and is of somebody else."""
        others: FrozenSet[MatchNode] = frozenset()
        for alias_id, alias in sorted(self.aliases.items(), key=lambda item: item[1].person.number):
            found = [group for group in nameless if group not in owners and group & set(alias.person.features)]
            free = [group for group in found if not self._has_another_face(group, alias)]
            others = others.union(*(group for group in found if group not in free))
            if free:
                del self.aliases[alias_id]
                self.persons[alias_id] = owners[free[0]] = alias.person
        return others

    def _has_another_face(self, group: Group, alias: Alias) -> bool:
        """Tell whether an id stands for somebody named, and a group shares something with it, but not the face: then it
        is of somebody else, as after a cut of the picture, and the id stays the named one's."""
        target = self.persons.get(alias.target)
        known, faces = ({node for node in nodes if node.kind == Kind.FACE} for nodes in (alias.person.features, group))
        return target is not None and not target.anonymous and bool(known and faces) and not known & faces

    def _make_new(self, owners: Dict[Group, PersonEntry], nameless: List[Group], now: float,
                  due: FrozenSet[MatchNode]) -> None:
        unassigned: Dict[MatchNode, float] = {}
        for group in nameless:
            if group in owners:
                continue
            since = min(self._unassigned.get(node, now) for node in group)
            expected = self._expected_id(group)
            lost = self.persons.get(expected)
            if lost is not None and lost.anonymous and all(owner is not lost for owner in owners.values()):
                owners[group] = lost
            elif self._anonymous_persons and (expected or due & group or not self._held & group and (
                    now - since >= self._delay_of(group) - 1e-9)):
                free = expected and expected not in self.persons and expected not in self.aliases
                person = self._make(expected if free else ANONYMOUS_PREFIX + self._new_id())
                self.persons[person.id] = owners[group] = person
            else:
                unassigned.update((node, self._unassigned.get(node, now)) for node in group)
        self._unassigned = unassigned

    def _delay_of(self, features: Iterable[MatchNode]) -> float:
        """How long (s) features wait for an assignment."""
        return self._voice_delay if all(node.kind == Kind.VOICE for node in features) else self._delay

    def _expected_id(self, group: Group) -> str:
        """Id that an earlier run or a match gave to the features of a group, empty if none; it is given once."""
        found = next((self._expected[node] for node in sorted(group) if node in self._expected), "")
        if found:
            self._expected = {node: id for node, id in self._expected.items() if id != found}
        return found

    def _write_features(self, owners: Dict[Group, PersonEntry], now: float) -> None:
        features = {person.id: {node for node in group if node.kind != Kind.PERSON}
                    for group, person in owners.items()}
        self._of_feature = {}
        for person in self.persons.values():
            held = {node: person.features.get(node, now) for node in features.get(person.id, ())}
            if not held and person.features:
                person.lost_at = now
            person.features = held
            person.doubted &= held.keys()
            for node in held:
                self._of_feature[node] = person

    def _merge(self, person: PersonEntry, target: PersonEntry) -> None:
        del self.persons[person.id]
        target.location.inherit(person.location)
        for alias in self.aliases.values():
            if alias.target == person.id:
                alias.target = target.id
        self.aliases[person.id] = Alias(person, target.id)

    def _drop_dead_aliases(self) -> None:
        for alias_id, alias in list(self.aliases.items()):
            if not any(node in self._of_feature for node in alias.person.features):
                del self.aliases[alias_id]


def _preference(person: PersonEntry, group: Group, now: float) -> Tuple:
    """Sort key of the groups a person may keep at `now` (s): the features that it has held for the longest time
    together, then most of them. What a wrong match has brought for a moment is not who somebody is."""
    held = [since for node, since in person.features.items() if node in group]
    return -sum(now - since for since in held), -len(held), min(held), min(group)


class KnownIds:
    """LRU set of permanent ids that remembers the order in which they became known, and which recognisers name them.

    outdated: those whom only recognisers named that have begun anew since, so that nobody will ever be named so again.
    """

    def __init__(self) -> None:
        self._numbers: "OrderedDict[str, int]" = OrderedDict()
        self._senders: Dict[str, Set[str]] = {}
        self._count = 0
        self.outdated: Set[str] = set()

    def __contains__(self, person_id: object) -> bool:
        """Tell whether a person is known."""
        return person_id in self._numbers

    def __iter__(self) -> Iterator[str]:
        """All ids."""
        return iter(self._numbers)

    def add(self, person_id: str) -> bool:
        """Note that somebody named a person; returns whether it is new."""
        new = person_id not in self._numbers
        self._count += 1
        self._numbers.setdefault(person_id, self._count)
        self._numbers.move_to_end(person_id)
        self.outdated.discard(person_id)
        while len(self._numbers) > MAX_KNOWN_IDS:
            self.remove(next(iter(self._numbers)))
        return new

    def note_name(self, person_id: str, sender: str) -> None:
        """Note that a recogniser names a person who is known."""
        if person_id in self._numbers:
            self._senders.setdefault(person_id, set()).add(sender)

    def renew(self, sender: str, kept: Container[str]) -> None:
        """Note that a recogniser has begun anew; kept: persons whom it knows still, or who stay known without it."""
        for person_id, senders in list(self._senders.items()):
            if sender in senders and person_id not in kept:
                senders.remove(sender)
                if not senders:
                    del self._senders[person_id]
                    self.outdated.add(person_id)

    def number(self, person_id: str, otherwise: int) -> int:
        """Less for those who were known earlier; `otherwise` for the unknown."""
        return self._numbers.get(person_id, otherwise)

    def remove(self, person_id: str) -> None:
        """Forget a person."""
        self._numbers.pop(person_id, None)
        self._senders.pop(person_id, None)
        self.outdated.discard(person_id)


class PersonState(NamedTuple):
    """What is published about one person; `alias` names the person that this one was merged into.

    place_age: s since the place came, in which its covariance has not grown.
    """

    id: str
    face: str
    body: str
    voice: str
    anonymous: bool
    confidence: float
    alias: str = ""
    place: Optional[Place] = None
    place_age: float = 0.0

    @property
    def tracked(self) -> bool:
        """Tell whether a feature of this person is tracked now."""
        return bool(self.face or self.body or self.voice)

    @property
    def place_now(self) -> Optional[Place]:
        """The place with the covariance of now: people walk on from one image to the next."""
        return None if self.place is None else aged_place(self.place, self.place_age)


class Snapshot(NamedTuple):
    """All persons at one time: those with topics, and the ids of the tracked and the known ones."""

    persons: Tuple[PersonState, ...]
    tracked: Tuple[str, ...]
    known: Tuple[str, ...]

    def merged(self) -> Dict[str, List[str]]:
        """Return the ids that were merged, by the person who stands for them."""
        found: Dict[str, List[str]] = {}
        for state in self.persons:
            if state.alias:
                found.setdefault(state.alias, []).append(state.id)
        return found


class _PublishedEntry(NamedTuple):
    """One person of the table: who stands for it, and whom it stands for, itself first; nobody when it is an alias."""

    person: PersonEntry
    target: str
    members: Tuple[PersonEntry, ...]
    features: Dict[Kind, str]


class PublishedPersons:
    """The persons as they are published, from the table and the merges; call invalidate() after changes of these."""

    def __init__(self, table: PersonTable, merges: Merges, decay: Decay) -> None:
        self._table = table
        self._merges = merges
        self.decay = decay
        self._shown: Optional[Dict[str, _PublishedEntry]] = None
        self._aliases: Tuple[PersonState, ...] = ()
        self._tracked: Tuple[str, ...] = ()
        self._known: Optional[Tuple[str, ...]] = None

    def invalidate(self) -> None:
        """Note that persons, their features or the merges have changed."""
        self._shown = None
        self._known = None

    def placed(self, now: float) -> List[PersonEntry]:
        """Return the persons that have a frame."""
        return [shown.person for shown in self._all().values()
                if shown.members and shown.person.location.confidence(now, self.decay) > 0.0]

    def silent(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and place of the persons that have a frame although no source is active now."""
        silent = [(person.id, person.location.expected(now)) for person in self.placed(now)
                  if person.location.is_silent(now)]
        return [(person_id, place) for person_id, place in silent if place is not None]

    def active(self, now: float) -> List[Tuple[str, Place]]:
        """Return id and place of the persons that a source places now."""
        return [(person.id, person.location.place) for person in self.placed(now)
                if person.location.place is not None and not person.location.is_silent(now)]

    def snapshot(self, known: Iterable[str], now: float) -> Snapshot:
        """Return the state of all persons at time `now`; `known`: ids of the permanent persons, seen or not."""
        persons = [self._state(shown, now) for shown in self._all().values()]
        if self._known is None:
            self._known = tuple(sorted(set(self._table.persons) | set(known)))
        return Snapshot((*persons, *self._aliases), self._tracked, self._known)

    def anonymous(self) -> Dict[str, List[MatchNode]]:
        """Return the anonymous persons that have features, with those."""
        found: Dict[str, List[MatchNode]] = {}
        for person in self._table.persons.values():
            target = self.representative(person)
            # The oldest id of merged persons outlives the feature that it was given for.
            named = target if target.anonymous and not target.features else person
            if named.anonymous and person.features:
                found.setdefault(named.id, []).extend(sorted(person.features))
        return found

    def identified(self) -> Dict[str, List[MatchNode]]:
        """Return the permanent persons that have features, with their faces, or with the others where there is no
        face."""
        found: Dict[str, List[MatchNode]] = {}
        for person in self._table.persons.values():
            target = self.representative(person)
            if not target.anonymous and person.features:
                found.setdefault(target.id, []).extend(sorted(person.features))
        faces = {name: [node for node in nodes if node.kind == Kind.FACE] for name, nodes in found.items()}
        return {name: faces[name] or nodes for name, nodes in found.items()}

    def fade(self, now: float) -> List[str]:
        """Let go of the places that are not to be trusted any more at time `now` (s); returns the anonymous persons
        without a place."""
        gone = []
        for person in self._table.persons.values():
            if person.location.confidence(now, self.decay) <= 0.0:
                if person.location.place is not None:
                    person.location.clear()
                if person.anonymous and not self.features(person) and not person.features:
                    gone.append(person.id)
        return gone

    def long_unseen(self) -> List[str]:
        """Ids of the permanent persons without features and place, who was lost first first."""
        unseen = [shown.person for shown in self._all().values() if not shown.person.anonymous and not shown.features
                  and not shown.person.features and shown.person.location.place is None]
        return [person.id for person in sorted(unseen, key=lambda item: item.lost_at or 0.0)]

    def inherit_places(self) -> None:
        """Give each representative the newest place of its merged persons."""
        for person in self._table.persons.values():
            target = self.representative(person)
            if target is not person:
                target.location.inherit(person.location)

    def retain_sources(self, now: float) -> None:
        """Let all places go on without the features that have left, or belong to others, at `now` (s)."""
        for shown in self._all().values():
            members = shown.members or (shown.person,)
            shown.person.location.retain({node for member in members for node in member.features}, now)

    def members(self, person: PersonEntry) -> Tuple[PersonEntry, ...]:
        """The merged persons that this one represents, itself first; nobody when it is an alias."""
        return self._all()[person.id].members

    def features(self, person: PersonEntry) -> Dict[Kind, str]:
        """Ids of the features that are published for a person: its own, else those of the persons joined with it."""
        return self._all()[person.id].features

    def representative(self, person: PersonEntry) -> PersonEntry:
        """Return the representative: the person that all features of the merged persons are published for."""
        return self._table.persons.get(self._merges.representative(person.id), person)

    def _all(self) -> Dict[str, _PublishedEntry]:
        """All persons, looked up anew after a change."""
        if self._shown is None:
            self._shown = {person.id: self._show(person) for person in self._table.persons.values()}
            self._aliases = tuple(
                PersonState(id, "", "", "", alias.person.anonymous, 0.0, self._merges.representative(alias.target))
                for id, alias in self._table.aliases.items())
            self._tracked = tuple(sorted(shown.person.id for shown in self._shown.values() if shown.features))
        return self._shown

    def _show(self, person: PersonEntry) -> _PublishedEntry:
        target = self._merges.representative(person.id)
        if target != person.id:
            return _PublishedEntry(person, target, (), {})
        members = tuple(self._table.persons[id] for id in self._merges.members(person.id) if id in self._table.persons)
        features: Dict[Kind, str] = {}
        for member in members:
            for node in sorted(member.features):
                features.setdefault(node.kind, node.id)
        return _PublishedEntry(person, target, members, features)

    def _state(self, shown: _PublishedEntry, now: float) -> PersonState:
        person = shown.person
        if not shown.members:
            return PersonState(person.id, "", "", "", person.anonymous, 0.0, shown.target)
        face, body, voice = (shown.features.get(kind, "") for kind in FEATURES)
        location = person.location
        silent = location.is_silent(now)
        return PersonState(person.id, face, body, voice, person.anonymous, location.confidence(now, self.decay), "",
                           *(location.expected(now), 0.0) if silent else (location.place, now - location.updated))
