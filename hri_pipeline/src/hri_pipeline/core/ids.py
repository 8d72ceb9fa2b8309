"""Identifiers of faces, bodies, voices and persons: their check and their generator."""

from __future__ import annotations

import hashlib
import itertools
import random
import re
import string
from typing import Optional

ID_PATTERN = r"^[A-Za-z][A-Za-z0-9_]{0,31}$"

# `$` also matches before a final newline, which would then reach a topic name: fullmatch does not.
_ID = re.compile(ID_PATTERN.strip("^$"))
_FIRST = string.ascii_lowercase
_REST = string.ascii_lowercase + string.digits
_TURNS = 4


def is_valid_id(text: object) -> bool:
    """Tell whether `text` may be used in a topic name, a TF frame and a parameter name."""
    return isinstance(text, str) and _ID.fullmatch(text) is not None


class IdGenerator:
    """Random ids that start with a letter; one generator never gives the same id twice, and keeps no list of them.

    With the default length of 5 there are 43.7 million ids. The n-th id is the n-th number of a random permutation,
    computed by a generalised Feistel network (Black and Rogaway, Ciphers with arbitrary finite domains, CT-RSA 2002).
    Ids that follow each other are as unlike as any two, so that people who come together are not mistaken for each
    other.

    Parameters
    ----------
    seed : int, optional
        For tests; without one, the system's random source is used.
    length : int
        Characters of an id, 1 to 32.

    Raises
    ------
    ValueError
        For another length.
    """

    def __init__(self, seed: Optional[int] = None, length: int = 5) -> None:
        if not 1 <= length <= 32:
            raise ValueError("length of an id is {}, legal range 1..32".format(length))
        # Without a seed two nodes must not draw the same ids: the operating system's entropy.
        source = random.Random(seed) if seed is not None else random.SystemRandom()
        self._key = source.getrandbits(128).to_bytes(16, "big")
        self._length = length
        right = length // 2
        self._left, self._right = len(_FIRST) * len(_REST) ** (length - right - 1), len(_REST) ** right
        self._given = itertools.count()

    def new(self) -> str:
        """Return an id that this generator has not given before.

        Raises RuntimeError once all ids of this length have been given.
        """
        left, right = divmod(next(self._given), self._right)
        if left >= self._left:
            raise RuntimeError("all ids of {} characters have been given".format(self._length))
        for turn in range(_TURNS):
            left = (left + self._mixed(turn, b"l", right)) % self._left
            right = (right + self._mixed(turn, b"r", left)) % self._right
        return self._text(left * self._right + right)

    def _mixed(self, turn: int, side: bytes, number: int) -> int:
        """A number of 128 bits that this generator alone makes of these."""
        return int.from_bytes(hashlib.blake2s(b"%d%s%d" % (turn, side, number), key=self._key, digest_size=16).digest(),
                              "big")

    def _text(self, number: int) -> str:
        letters = []
        for _ in range(self._length - 1):
            number, rest = divmod(number, len(_REST))
            letters.append(_REST[rest])
        return _FIRST[number] + "".join(letters)
