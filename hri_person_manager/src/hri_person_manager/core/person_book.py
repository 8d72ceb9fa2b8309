"""Which persons exist: anonymous ones made from features, permanent ones named by recognisers.

A feature that nobody has claimed for a while becomes an anonymous person. That person keeps its id while
any of its features lives. When two persons turn out to be one, the older stays and the other becomes an
alias of it; when they turn out to be two again, the alias comes back as the person it was.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Callable, Dict, FrozenSet, Iterable, List, Mapping, Optional, Tuple

from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.location import Location, Source

ANONYMOUS_PREFIX = "anonymous_person_"
Group = FrozenSet[Node]
_SOURCES = {Kind.FACE: (Source.FACE,), Kind.BODY: (Source.HEAD, Source.BODY), Kind.VOICE: (Source.VOICE,)}


@dataclass
class Person:
    """One person: `number` counts in order of appearance, `lost_at` is the time (s) the last feature left.

    `features` maps each feature to the time (s) since when it belongs to this person.
    """

    id: str
    number: int
    anonymous: bool
    location: Location
    features: Dict[Node, float] = field(default_factory=dict)
    lost_at: Optional[float] = None

    def feature(self, kind: Kind) -> str:
        """Return the id of this person's feature of one kind, empty if there is none."""
        return next((node.id for node in self.features if node.kind == kind), "")


@dataclass
class Alias:
    """A person that was merged into `target`; `person` is kept to come back if they are parted again."""

    person: Person
    target: str


class PersonBook:
    """All persons that exist, and what has become of merged ones."""

    def __init__(self, new_id: Callable[[], str], new_location: Callable[[], Location],
                 new_person_delay: float, anonymous_persons: bool, voice_person_delay: float = 0.0) -> None:
        """Make ids with `new_id` (5 characters); a feature waits `new_person_delay` seconds for a claim.

        voice_person_delay: s that a voice alone waits, if that is longer.
        """
        self._new_id = new_id
        self._new_location = new_location
        self.set_delays(new_person_delay, voice_person_delay)
        self._anonymous_persons = anonymous_persons
        self._count = 0
        self._unclaimed: Dict[Node, float] = {}
        self._of_feature: Dict[Node, Person] = {}
        self._expected: Dict[Node, str] = {}
        self.persons: Dict[str, Person] = {}
        self.aliases: Dict[str, Alias] = {}

    def permanent(self, person_id: str) -> Person:
        """Return the permanent person with this id, made if it is new."""
        person = self.persons.get(person_id)
        if person is None:
            alias = self.aliases.pop(person_id, None)
            person = alias.person if alias is not None else self._make(person_id)
            self.persons[person_id] = person
        person.anonymous = False
        return person

    def expect(self, anonymous: Mapping[str, Iterable[Node]]) -> None:
        """Take these ids for the anonymous persons that are made of these features (those of an earlier run)."""
        self._expected = {node: person_id for person_id, nodes in anonymous.items() for node in nodes}

    def claim(self, feature: Node, person_id: str) -> None:
        """Let a feature without a person be, at the next settle(), that of an anonymous person who has lost all features."""
        self._expected[feature] = person_id

    def owner(self, feature: Node) -> Optional[Person]:
        """Return the person that a feature belongs to, None if nobody has claimed it."""
        return self._of_feature.get(feature)

    def settle(self, groups: Iterable[Group], now: float) -> None:
        """Give every group of features its person; `groups` hold each living feature at most once.

        A feature that is in none of them belongs to nobody.
        """
        owners: Dict[Group, Person] = {}
        nameless: List[Group] = []
        for group in groups:
            named = next((node for node in group if node.kind == Kind.PERSON), None)
            if named is None:
                nameless.append(group)
            else:
                owners[group] = self.permanent(named.id)
        merged = self._place_anonymous(owners, nameless)
        self._revive(owners, nameless)
        self._make_new(owners, nameless, now)
        for person, target in merged:
            self._merge(person, target)
        self._write_features(owners, now)
        self._drop_dead_aliases()

    def set_delays(self, new_person_delay: float, voice_person_delay: float) -> None:
        """Set how long features wait (s), as in the constructor, from now on."""
        self._delay = new_person_delay
        self._voice_delay = max(new_person_delay, voice_person_delay)

    def waiting_until(self) -> Optional[float]:
        """Return the time (s) at which the next unclaimed feature becomes a person, None if none waits."""
        if not self._unclaimed or not self._anonymous_persons:
            return None
        return min(since + self._delay_of((node,)) for node, since in self._unclaimed.items())

    def remove(self, person_id: str) -> None:
        """Forget a person and those merged into it."""
        person = self.persons.pop(person_id, None)
        if person is not None:
            for node in person.features:
                self._of_feature.pop(node, None)
        for alias_id in [key for key, alias in self.aliases.items() if alias.target == person_id]:
            del self.aliases[alias_id]

    def _make(self, person_id: str) -> Person:
        self._count += 1
        return Person(person_id, self._count, True, self._new_location())

    def _place_anonymous(self, owners: Dict[Group, Person],
                         nameless: List[Group]) -> List[Tuple[Person, Person]]:
        """Let each anonymous person, oldest first, keep one group that has a feature of it."""
        group_of = {node: group for groups in (owners, nameless) for group in groups for node in group}
        merged = []
        for person in sorted(self.persons.values(), key=lambda item: item.number):
            if not person.anonymous:
                continue
            own = sorted({group_of[node] for node in person.features if node in group_of},
                         key=lambda group: _claim(person, group))
            free = [group for group in own if group not in owners]
            if free:
                owners[free[0]] = person
            elif own:
                merged.append((person, owners[own[0]]))
        return merged

    def _revive(self, owners: Dict[Group, Person], nameless: List[Group]) -> None:
        for alias_id, alias in sorted(self.aliases.items(), key=lambda item: item[1].person.number):
            free = [group for group in nameless if group not in owners and group & set(alias.person.features)]
            if free:
                del self.aliases[alias_id]
                self.persons[alias_id] = owners[free[0]] = alias.person

    def _make_new(self, owners: Dict[Group, Person], nameless: List[Group], now: float) -> None:
        unclaimed: Dict[Node, float] = {}
        for group in nameless:
            if group in owners:
                continue
            since = min(self._unclaimed.get(node, now) for node in group)
            expected = self._expected_id(group)
            lost = self.persons.get(expected)
            if lost is not None and lost.anonymous and all(owner is not lost for owner in owners.values()):
                owners[group] = lost
            elif self._anonymous_persons and (expected or now - since >= self._delay_of(group) - 1e-9):
                free = expected and expected not in self.persons and expected not in self.aliases
                person = self._make(expected if free else ANONYMOUS_PREFIX + self._new_id())
                self.persons[person.id] = owners[group] = person
            else:
                unclaimed.update((node, self._unclaimed.get(node, now)) for node in group)
        self._unclaimed = unclaimed

    def _delay_of(self, features: Iterable[Node]) -> float:
        """How long (s) features wait for a claim."""
        return self._voice_delay if all(node.kind == Kind.VOICE for node in features) else self._delay

    def _expected_id(self, group: Group) -> str:
        """Id that an earlier run or a claim gave to the features of a group, empty if none; it is given once."""
        found = next((self._expected[node] for node in sorted(group) if node in self._expected), "")
        if found:
            self._expected = {node: id for node, id in self._expected.items() if id != found}
        return found

    def _write_features(self, owners: Dict[Group, Person], now: float) -> None:
        features = {person.id: {node for node in group if node.kind != Kind.PERSON}
                    for group, person in owners.items()}
        self._of_feature = {}
        for person in self.persons.values():
            held = {node: person.features.get(node, now) for node in features.get(person.id, ())}
            if not held and person.features:
                person.lost_at = now
            for node in set(person.features) - set(held):
                for source in _SOURCES[node.kind]:
                    person.location.forget_source(source)
            person.features = held
            for node in held:
                self._of_feature[node] = person

    def _merge(self, person: Person, target: Person) -> None:
        del self.persons[person.id]
        target.location.inherit(person.location)
        for alias in self.aliases.values():
            if alias.target == person.id:
                alias.target = target.id
        self.aliases[person.id] = Alias(person, target.id)

    def _drop_dead_aliases(self) -> None:
        for alias_id, alias in list(self.aliases.items()):
            alive = any(node in self._of_feature or node in self._unclaimed
                        for node in alias.person.features)
            if not alive or alias.target not in self.persons:
                del self.aliases[alias_id]


def _claim(person: Person, group: Group) -> Tuple:
    """Sort key of the groups a person may keep: most of its features, then the one it held longest."""
    held = [since for node, since in person.features.items() if node in group]
    return -len(held), min(held), min(group)
