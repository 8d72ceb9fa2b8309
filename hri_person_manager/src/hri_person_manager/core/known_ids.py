"""The ids of all permanent persons, whether they are seen or not."""

from __future__ import annotations

from collections import OrderedDict
from typing import Iterator

MAX_KNOWN_IDS = 10000


class KnownIds:
    """Permanent ids with a number that says who was known first; who was named longest ago goes first."""

    def __init__(self) -> None:
        self._numbers: "OrderedDict[str, int]" = OrderedDict()
        self._count = 0

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
        while len(self._numbers) > MAX_KNOWN_IDS:
            self._numbers.popitem(last=False)
        return new

    def number(self, person_id: str, otherwise: int) -> int:
        """Less for those who were known earlier; `otherwise` for the unknown."""
        return self._numbers.get(person_id, otherwise)

    def remove(self, person_id: str) -> None:
        """Forget a person."""
        self._numbers.pop(person_id, None)
