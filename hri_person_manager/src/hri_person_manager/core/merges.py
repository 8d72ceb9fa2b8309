"""Which persons are one human: likelihoods between persons, kept apart from those between features.

A merge leaves what belongs to each person untouched, so that it can be undone: merged persons are published as one, the
*representative*, and the others as aliases of it. Merges that are reported from outside and those that the manager has
observed itself, with several cameras, are kept apart: reports have priority, and pairs that a user has split are never
merged again by observation. `ChangeLimit` says how often reports that contradict each other may change anything.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import AbstractSet, Any, Callable, Dict, FrozenSet, Hashable, Iterable, List, Optional, Set, Tuple

MAX_MERGES = 1000
MOST_CHANGES, CHANGES_PER_S = 8.0, 0.5      # of who belongs to a feature, by matches: at once, and in the long run
UNDISPUTED_S, MORE_CHANGES = 1.0, 4.0       # what nothing has contradicted for so long has so many more
Pair = FrozenSet[str]
Keys = Tuple[Any, ...]       # hashable


class ChangeLimit:
    """Lets matches change who belongs together MOST_CHANGES times at once, then CHANGES_PER_S: of matches that
    contradict each other, as of two matchers, those that come often would change it with each message. What nothing
    contradicts for UNDISPUTED_S, as when a recogniser takes two names back, is let through MORE_CHANGES times sooner.

    Keys are features, each with a kind to which it is linked, or pairs of persons.
    """

    def __init__(self) -> None:
        self._spent: Dict[Hashable, Tuple[float, float]] = {}      # changes that count still, and when (s)
        self._waiting: Dict[Keys, Tuple[Optional[Hashable], float]] = {}     # what is said, and since when (s)
        self._sooner: Set[Hashable] = set()     # of those spent, let through sooner

    def note(self, keys: Iterable[Hashable], now: float) -> None:
        """Note that a match about these has changed who belongs together, at `now` (s); of more than MOST_CHANGES only
        one counts, unless they were let through sooner: a name that is withdrawn after that counts, too."""
        for key in keys:
            count, most = self._count(key, now), MOST_CHANGES + (MORE_CHANGES if key in self._sooner else 0.0)
            self._spent[key] = min(count, most) + 1.0, now

    def holds(self, keys: Keys, now: float) -> bool:
        """Tell whether a match about these may change nothing at `now` (s); due() names them when it may."""
        if not self._is_spent(keys, now):
            return False
        self._waiting.setdefault(keys, (None, now))
        return True

    def hear(self, keys: Keys, said: Optional[Hashable], now: float) -> None:
        """Take what all matches together say of these since a match at `now` (s); None: they contradict each other."""
        if self._waiting[keys][0] != said:
            self._waiting[keys] = said, now

    def due(self, now: float, said: Callable[[Keys], Optional[Hashable]] = lambda keys: None) -> List:
        """Return, once each, what held matches are about that may change something at `now` (s); said: see hear()."""
        for keys in self._waiting:
            self.hear(keys, said(keys), now)
        found = [keys for keys, (words, since) in self._waiting.items() if not self._is_spent(keys, now)
                 or words is not None and now - since >= UNDISPUTED_S and not self._is_spent(keys, now, MORE_CHANGES)]
        for keys in found:
            del self._waiting[keys]
        self._sooner.update(key for keys in found for key in keys)
        self._sooner = {key for key in self._sooner if self._is_spent((key,), now)}
        self._spent = {key: spent for key, spent in self._spent.items() if self._count(key, now) > 0.0}
        return list(dict.fromkeys(key for keys in found for key in keys))

    def _is_spent(self, keys: Iterable[Hashable], now: float, more: float = 0.0) -> bool:
        return any(self._count(key, now) > MOST_CHANGES + more - 1.0 for key in keys)

    def _count(self, key: Hashable, now: float) -> float:
        count, at = self._spent.get(key, (0.0, now))
        return max(0.0, count - CHANGES_PER_S * (now - at)) if now >= at else 0.0       # else time has gone back


class Merges:
    """Likelihoods (0..1) that two persons are the same; the oldest goes first when there are too many."""

    def __init__(self, threshold: float) -> None:
        """Join persons from likelihood `threshold` on; a lower one is kept, as it may rise again. It may be changed
        before update()."""
        self.threshold = threshold
        self._pairs: "OrderedDict[Pair, float]" = OrderedDict()
        self._observed: "OrderedDict[Pair, float]" = OrderedDict()
        self._split: "OrderedDict[Pair, None]" = OrderedDict()
        self._limit = ChangeLimit()
        self._held: Dict[Pair, float] = {}      # likelihoods that wait
        self._representative: Dict[str, str] = {}
        self._members: Dict[str, List[str]] = {}
        self._preferred: "OrderedDict[str, None]" = OrderedDict()

    @property
    def pairs(self) -> Tuple[Tuple[str, str, float], ...]:
        """All pairs with the likelihoods that were reported from outside."""
        return tuple((min(pair), max(pair), likelihood) for pair, likelihood in self._pairs.items())

    @property
    def observed(self) -> Tuple[Tuple[str, str, float], ...]:
        """All pairs that are merged by observation, with their likelihoods, from the threshold on."""
        return tuple((min(pair), max(pair), max(likelihood, self.threshold))
                     for pair, likelihood in self._observed.items() if self._is_joined(pair))

    def set(self, first: str, second: str, likelihood: float) -> bool:
        """Keep a likelihood, 0 withdraws it; return whether who is joined with whom may have changed.

        This is the word of a user: it ends that they are parted. Raises ValueError for a person and itself.
        """
        changed = self._put(first, second, likelihood)
        if likelihood >= self.threshold:
            self._split.pop(_pair(first, second), None)
        return changed

    def _put(self, first: str, second: str, likelihood: float) -> bool:
        pair = _pair(first, second)
        before = self._is_joined(pair)
        self._held.pop(pair, None)
        self._pairs.pop(pair, None)
        if likelihood > 0.0:
            self._pairs[pair] = likelihood
        changed = before != self._is_joined(pair)
        while len(self._pairs) > MAX_MERGES:
            changed |= self._pairs.popitem(last=False)[1] >= self.threshold
        return changed

    def report(self, first: str, second: str, likelihood: float, now: float) -> bool:
        """Do as set() for what a match says at `now` (s), but those whom a user has parted are parted again after it.
        It waits where matches join and part too often, unless it parts."""
        pair = _pair(first, second)
        if likelihood >= self.threshold and not self._is_joined(pair) and self._limit.holds((pair,), now):
            self._held[pair] = likelihood
            return False
        changed = self._put(first, second, likelihood)
        if changed:
            self._limit.note((pair,), now)
        return changed

    def report_held(self, now: float) -> bool:
        """Take what has waited for long enough at `now` (s); return whether who is joined with whom may have changed.
        """
        changed = False
        for pair in self._limit.due(now):
            if pair in self._held:
                first, second = sorted(pair)
                changed |= self.report(first, second, self._held[pair], now)
        return changed

    def set_observed(self, first: str, second: str, likelihood: float) -> bool:
        """Keep an observed likelihood, 0 withdraws it; return whether who is joined with whom may have changed.

        What is observed joins, whatever the threshold is; what was reported of the pair has priority. Raises ValueError
        for a person and itself.
        """
        pair = _pair(first, second)
        before = self._is_joined(pair)
        self._observed.pop(pair, None)
        if likelihood > 0.0:
            self._observed[pair] = likelihood
        changed = before != self._is_joined(pair)
        while len(self._observed) > MAX_MERGES:
            self._observed.popitem(last=False)
            changed = True
        return changed

    def prefer(self, person_id: str) -> None:
        """Note that somebody wants `person_id` to stand for all with whom it is joined."""
        for other in _reachable(person_id, self._neighbours()):
            self._preferred.pop(other, None)
        self._preferred[person_id] = None
        while len(self._preferred) > MAX_MERGES:
            self._preferred.popitem(last=False)

    def is_preferred(self, person_id: str) -> bool:
        """Tell whether somebody wants this person to stand for others."""
        return person_id in self._preferred

    def remove(self, person_id: str) -> None:
        """Forget a person."""
        self._preferred.pop(person_id, None)
        for kept in (self._pairs, self._observed, self._split, self._held):
            for pair in [pair for pair in kept if person_id in pair]:
                del kept[pair]
        self._representative.pop(person_id, None)
        self._members = _by_representative(self._representative)

    def split(self, person_id: str) -> bool:
        """Withdraw everything that joins a person with others; return whether there was anything.

        Observation does not merge it with any of them again.
        """
        neighbours = self._neighbours()
        if person_id not in neighbours:
            return False
        for other in _reachable(person_id, neighbours) - {person_id}:
            pair = _pair(person_id, other)
            self._observed.pop(pair, None)
            self._held.pop(pair, None)
            if self._pairs.get(pair, 0.0) >= self.threshold:
                del self._pairs[pair]
            self._split[pair] = None
        while len(self._split) > MAX_MERGES:
            self._split.popitem(last=False)
        return True

    @property
    def parted(self) -> AbstractSet[Pair]:
        """Pairs of persons whom a user has parted, so that observation does not merge them."""
        return self._split.keys()

    def update(self, persons: Iterable[str], rank: Callable[[str], Tuple]) -> bool:
        """Choose the representative of all merged persons among the present `persons`: the one of least `rank`.

        Returns whether a representative has changed.
        """
        if not self._pairs and not self._observed and not self._representative:
            return False
        present = set(persons)
        neighbours = self._neighbours(present)
        target: Dict[str, str] = {}
        for start in neighbours:
            if start not in target:
                members = _reachable(start, neighbours)
                chosen = min(members, key=rank)
                target.update((member, chosen) for member in members)
        changed = target != self._representative
        self._representative, self._members = target, _by_representative(target)
        return changed

    def representative_of_all(self, person_id: str, rank: Callable[[str], Tuple]) -> str:
        """The person of least `rank` of all that this one is joined with, present or not."""
        return min(self.joined(person_id), key=rank)

    def joined(self, person_id: str) -> Set[str]:
        """Return a person and all with whom it is joined, present or not, also by way of others."""
        return _reachable(person_id, self._neighbours())

    def representative(self, person_id: str) -> str:
        """The person that stands for this one: itself unless it is an alias."""
        return self._representative.get(person_id, person_id)

    def members(self, person_id: str) -> List[str]:
        """All persons for which this one stands, itself first."""
        return self._members.get(person_id) or [person_id]

    def _is_joined(self, pair: Pair) -> bool:
        if pair in self._pairs:
            return self._pairs[pair] >= self.threshold
        return pair not in self._split and pair in self._observed

    def _neighbours(self, present: Optional[Set[str]] = None) -> Dict[str, Set[str]]:
        """With whom each of the present persons (None: all) is joined."""
        neighbours: Dict[str, Set[str]] = {}
        for pair in (*self._pairs, *self._observed):
            if self._is_joined(pair) and (present is None or pair <= present):
                first, second = pair
                neighbours.setdefault(first, set()).add(second)
                neighbours.setdefault(second, set()).add(first)
        return neighbours


def _pair(first: str, second: str) -> Pair:
    if first == second:
        raise ValueError("a merge needs two persons, got {!r} twice".format(first))
    return frozenset((first, second))


def _by_representative(target: Dict[str, str]) -> Dict[str, List[str]]:
    members: Dict[str, List[str]] = {}
    for member, chosen in sorted(target.items()):
        found = members.setdefault(chosen, [chosen])
        if member != chosen:
            found.append(member)
    return members


def _reachable(start: str, neighbours: Dict[str, Set[str]]) -> Set[str]:
    found, pending = {start}, [start]
    while pending:
        for other in neighbours.get(pending.pop(), ()):
            if other not in found:
                found.add(other)
                pending.append(other)
    return found
