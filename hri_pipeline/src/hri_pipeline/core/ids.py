"""Identifiers of faces, bodies, voices and persons: their check and their generator."""

from __future__ import annotations

import random
import re
import string
from typing import Optional, Set

ID_PATTERN = r"^[A-Za-z][A-Za-z0-9_]{0,31}$"

# `$` also matches before a final newline, which would then reach a topic name: fullmatch does not.
_ID = re.compile(ID_PATTERN.strip("^$"))
_FIRST = string.ascii_lowercase
_REST = string.ascii_lowercase + string.digits


def is_valid_id(text: object) -> bool:
    """Tell whether `text` may be used in a topic name, a TF frame and a parameter name."""
    return isinstance(text, str) and _ID.fullmatch(text) is not None


class IdGenerator:
    """Random ids that start with a letter; one generator never gives the same id twice.

    With the default length of 5 there are 43.7 million ids.
    """

    def __init__(self, seed: Optional[int] = None, length: int = 5) -> None:
        if not 1 <= length <= 32:
            raise ValueError("length of an id is {}, legal range 1..32".format(length))
        # Without a seed two nodes must not draw the same ids: the operating system's entropy.
        self._random = random.Random(seed) if seed is not None else random.SystemRandom()
        self._length = length
        self._given: Set[str] = set()

    def new(self) -> str:
        """Return an id that this generator has not given before.

        Raises RuntimeError once all ids of this length have been given.
        """
        if len(self._given) >= len(_FIRST) * len(_REST) ** (self._length - 1):
            raise RuntimeError("all ids of {} characters have been given".format(self._length))
        while True:
            text = self._random.choice(_FIRST)
            text += "".join(self._random.choice(_REST) for _ in range(self._length - 1))
            if text not in self._given:
                self._given.add(text)
                return text
