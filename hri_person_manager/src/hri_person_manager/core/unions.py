"""Which persons are one human: likelihoods between persons, kept apart from those between features.

A union joins persons without touching what belongs to each of them, so that it can be undone: the persons of a
union are published as one, the *target*, and the others as aliases of it. What is told from outside and what the
manager has seen itself, with several cameras, are kept apart: what is told goes first, and nobody whom a user has
parted is joined by sight.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Callable, Dict, FrozenSet, Iterable, List, Optional, Set, Tuple

MAX_UNIONS = 1000
Pair = FrozenSet[str]


class Unions:
    """Likelihoods (0..1) that two persons are the same; the oldest goes first when there are too many."""

    def __init__(self, threshold: float) -> None:
        """Join persons from likelihood `threshold` on; a lower one is kept, as it may rise again. It may be changed before settle()."""
        self.threshold = threshold
        self._pairs: "OrderedDict[Pair, float]" = OrderedDict()
        self._seen: "OrderedDict[Pair, float]" = OrderedDict()
        self._parted: "OrderedDict[Pair, None]" = OrderedDict()
        self._target: Dict[str, str] = {}
        self._members: Dict[str, List[str]] = {}
        self._preferred: "OrderedDict[str, None]" = OrderedDict()

    @property
    def pairs(self) -> Tuple[Tuple[str, str, float], ...]:
        """All pairs with the likelihoods that were told from outside."""
        return tuple((*sorted(pair), likelihood) for pair, likelihood in self._pairs.items())

    @property
    def seen(self) -> Tuple[Tuple[str, str, float], ...]:
        """All pairs that are joined by sight, with their likelihoods."""
        return tuple((*sorted(pair), likelihood) for pair, likelihood in self._seen.items() if self._is_joined(pair))

    def set(self, first: str, second: str, likelihood: float) -> bool:
        """Keep a likelihood, 0 withdraws it; return whether who is joined with whom may have changed.

        Raises ValueError for a person and itself.
        """
        pair = _pair(first, second)
        before = self._is_joined(pair)
        self._pairs.pop(pair, None)
        if likelihood > 0.0:
            self._pairs[pair] = likelihood
        if likelihood >= self.threshold:
            self._parted.pop(pair, None)
        changed = before != self._is_joined(pair)
        while len(self._pairs) > MAX_UNIONS:
            changed |= self._pairs.popitem(last=False)[1] >= self.threshold
        return changed

    def see(self, first: str, second: str, likelihood: float) -> bool:
        """Keep what was seen, 0 withdraws it; return whether who is joined with whom may have changed.

        What was told of the pair goes before it. Raises ValueError for a person and itself.
        """
        pair = _pair(first, second)
        before = self._is_joined(pair)
        self._seen.pop(pair, None)
        if likelihood > 0.0:
            self._seen[pair] = likelihood
        changed = before != self._is_joined(pair)
        while len(self._seen) > MAX_UNIONS:
            changed |= self._seen.popitem(last=False)[1] >= self.threshold
        return changed

    def may_be_seen(self, first: str, second: str) -> bool:
        """Tell whether sight may join two persons: nobody has told anything of the pair, nor parted it."""
        pair = _pair(first, second)
        return pair not in self._pairs and pair not in self._parted

    def prefer(self, person_id: str, other: str) -> None:
        """Note that somebody wants `person_id` to stand for both."""
        self._preferred.pop(other, None)
        self._preferred[person_id] = None
        while len(self._preferred) > MAX_UNIONS:
            self._preferred.popitem(last=False)

    def is_preferred(self, person_id: str) -> bool:
        """Tell whether somebody wants this person to stand for others."""
        return person_id in self._preferred

    def remove(self, person_id: str) -> None:
        """Forget a person."""
        self._preferred.pop(person_id, None)
        for kept in (self._pairs, self._seen, self._parted):
            for pair in [pair for pair in kept if person_id in pair]:
                del kept[pair]
        self._target.pop(person_id, None)
        self._members = _by_target(self._target)

    def split(self, person_id: str) -> bool:
        """Withdraw everything that joins a person with others; return whether there was anything.

        Sight does not join it with any of them again.
        """
        neighbours = self._neighbours()
        if person_id not in neighbours:
            return False
        for other in _reachable(person_id, neighbours) - {person_id}:
            pair = _pair(person_id, other)
            self._seen.pop(pair, None)
            if self._pairs.get(pair, 0.0) >= self.threshold:
                del self._pairs[pair]
            self._parted[pair] = None
        while len(self._parted) > MAX_UNIONS:
            self._parted.popitem(last=False)
        return True

    def settle(self, persons: Iterable[str], rank: Callable[[str], Tuple]) -> bool:
        """Choose the target of every union of the present `persons`: the one of least `rank`.

        Returns whether a target has changed.
        """
        if not self._pairs and not self._seen and not self._target:
            return False
        present = set(persons)
        neighbours = self._neighbours(present)
        target: Dict[str, str] = {}
        for start in neighbours:
            if start not in target:
                members = _reachable(start, neighbours)
                chosen = min(members, key=rank)
                target.update((member, chosen) for member in members)
        changed = target != self._target
        self._target, self._members = target, _by_target(target)
        return changed

    def target(self, person_id: str) -> str:
        """The person that stands for this one: itself unless it is an alias."""
        return self._target.get(person_id, person_id)

    def members(self, person_id: str) -> List[str]:
        """All persons for which this one stands, itself first."""
        return self._members.get(person_id) or [person_id]

    def _is_joined(self, pair: Pair) -> bool:
        if pair in self._pairs:
            return self._pairs[pair] >= self.threshold
        return pair not in self._parted and self._seen.get(pair, 0.0) >= self.threshold

    def _neighbours(self, present: Optional[Set[str]] = None) -> Dict[str, Set[str]]:
        """With whom each of the present persons (None: all) is joined."""
        neighbours: Dict[str, Set[str]] = {}
        for pair in (*self._pairs, *self._seen):
            if self._is_joined(pair) and (present is None or pair <= present):
                first, second = pair
                neighbours.setdefault(first, set()).add(second)
                neighbours.setdefault(second, set()).add(first)
        return neighbours


def _pair(first: str, second: str) -> Pair:
    if first == second:
        raise ValueError("a union needs two persons, got {!r} twice".format(first))
    return frozenset((first, second))


def _by_target(target: Dict[str, str]) -> Dict[str, List[str]]:
    members: Dict[str, List[str]] = {}
    for member, chosen in sorted(target.items()):
        found = members.setdefault(chosen, [chosen])
        if member != chosen:
            found.append(member)
    return members


def _reachable(start: str, neighbours: Dict[str, Set[str]]) -> Set[str]:
    found, pending = {start}, [start]
    while pending:
        for other in neighbours[pending.pop()]:
            if other not in found:
                found.add(other)
                pending.append(other)
    return found
