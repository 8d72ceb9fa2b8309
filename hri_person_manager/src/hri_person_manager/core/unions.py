"""Which persons are one human: likelihoods between persons, kept apart from those between features.

A union joins persons without touching what belongs to each of them, so that it can be undone: the persons of a
union are published as one, the *target*, and the others as aliases of it.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Callable, Dict, FrozenSet, Iterable, List, Set, Tuple

MAX_UNIONS = 1000


class Unions:
    """Likelihoods (0..1) that two persons are the same; the oldest goes first when there are too many."""

    def __init__(self, threshold: float) -> None:
        """Join persons from likelihood `threshold` on; a lower one is kept, as it may rise again."""
        self._threshold = threshold
        self._pairs: "OrderedDict[FrozenSet[str], float]" = OrderedDict()
        self._target: Dict[str, str] = {}

    @property
    def pairs(self) -> Tuple[Tuple[str, str, float], ...]:
        """All pairs with their likelihoods."""
        return tuple((*sorted(pair), likelihood) for pair, likelihood in self._pairs.items())

    def set(self, first: str, second: str, likelihood: float) -> bool:
        """Keep a likelihood, 0 withdraws it; return whether who is joined with whom may have changed.

        Raises ValueError for a person and itself.
        """
        if first == second:
            raise ValueError("a union needs two persons, got {!r} twice".format(first))
        pair = frozenset((first, second))
        before = self._pairs.pop(pair, 0.0)
        if likelihood > 0.0:
            self._pairs[pair] = likelihood
        while len(self._pairs) > MAX_UNIONS:
            before = max(before, self._pairs.popitem(last=False)[1])
        return (before >= self._threshold) != (likelihood >= self._threshold)

    def remove(self, person_id: str) -> None:
        """Forget a person."""
        for pair in [pair for pair in self._pairs if person_id in pair]:
            del self._pairs[pair]
        self._target.pop(person_id, None)

    def split(self, person_id: str) -> bool:
        """Withdraw everything that joins a person with others; return whether there was anything."""
        joined = [pair for pair, likelihood in self._pairs.items()
                  if person_id in pair and likelihood >= self._threshold]
        for pair in joined:
            del self._pairs[pair]
        return bool(joined)

    def settle(self, persons: Iterable[str], rank: Callable[[str], Tuple]) -> bool:
        """Choose the target of every union of the present `persons`: the one of least `rank`.

        Returns whether a target has changed.
        """
        neighbours: Dict[str, Set[str]] = {}
        present = set(persons)
        for pair, likelihood in self._pairs.items():
            if likelihood >= self._threshold and pair <= present:
                first, second = pair
                neighbours.setdefault(first, set()).add(second)
                neighbours.setdefault(second, set()).add(first)
        target: Dict[str, str] = {}
        for start in neighbours:
            if start not in target:
                members = _reachable(start, neighbours)
                chosen = min(members, key=rank)
                target.update((member, chosen) for member in members)
        changed = target != self._target
        self._target = target
        return changed

    def target(self, person_id: str) -> str:
        """The person that stands for this one: itself unless it is an alias."""
        return self._target.get(person_id, person_id)

    def members(self, person_id: str) -> List[str]:
        """All persons for which this one stands, itself first."""
        others = sorted(member for member, target in self._target.items()
                        if target == person_id and member != person_id)
        return [person_id] + others


def _reachable(start: str, neighbours: Dict[str, Set[str]]) -> Set[str]:
    found, pending = {start}, [start]
    while pending:
        for other in neighbours[pending.pop()]:
            if other not in found:
                found.add(other)
                pending.append(other)
    return found
