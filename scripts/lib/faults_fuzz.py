"""Messages of any type with values that nobody should send: not finite, extreme, of wrong sizes, with ids that are none."""

from __future__ import annotations

import random
from typing import Callable, Dict, List, Sequence

import genpy

IDS = ("", " ", "a b", "../../etc", "-", "\u00e4\u00f6", "x" * 5000, "line\nline", "face_/", "/humans", "%s%n", "\x00")
"""None of these is an id."""
_SIZES = (0, 0, 1, 2, 17, 70, 99, 2000)
_FLOATS = (float("nan"), float("inf"), float("-inf"), 0.0, -0.0, 1e-310, 1e38, -1e38, -1.0, 2.0)
_WHOLE = {"int8": (8, True), "uint8": (8, False), "byte": (8, True), "char": (8, False), "int16": (16, True), "uint16": (16, False),
          "int32": (32, True), "uint32": (32, False), "int64": (64, True), "uint64": (64, False)}


class Fuzz:
    """Makes messages. seed: the same seed makes the same ones. known: names that are there, now and then in the place of an id."""

    def __init__(self, seed: int = 0, known: Sequence[str] = ()) -> None:
        self._chance = random.Random(seed)
        self._known = list(known)
        self._makers: Dict[str, Callable[[], object]] = {"string": self._text, "bool": lambda: self._chance.random() < 0.5,
                                                         "float32": self._number, "float64": self._number,
                                                         "time": self._time, "duration": self._duration}

    def message(self, kind: type) -> genpy.Message:
        """Return a message of a class; it can be serialised."""
        made = kind()
        for slot, type_name in zip(made.__slots__, made._slot_types):
            setattr(made, slot, self._field(type_name))
        return made

    def _field(self, type_name: str) -> object:
        base, is_array, length = _parse(type_name)
        if not is_array:
            return self._one(base)
        count = self._chance.choice(_SIZES) if length is None else length
        if base in ("uint8", "char"):
            return bytes(self._chance.randrange(256) for _ in range(count))
        # One value many times: a large message need not take long to make.
        few: List[object] = [self._one(base) for _ in range(min(count, 5))]
        return [few[number % len(few)] for number in range(count)]

    def _one(self, base: str) -> object:
        if base in self._makers:
            return self._makers[base]()
        if base in _WHOLE:
            bits, signed = _WHOLE[base]
            low, high = (-2 ** (bits - 1), 2 ** (bits - 1) - 1) if signed else (0, 2 ** bits - 1)
            return self._chance.choice((low, high, 0, 1, self._chance.randint(low, high)))
        import roslib.message
        return self.message(roslib.message.get_message_class("std_msgs/Header" if base == "Header" else base))

    def _text(self) -> str:
        if self._known and self._chance.random() < 0.2:
            return self._chance.choice(self._known)
        return self._chance.choice(IDS)

    def _number(self) -> float:
        return self._chance.choice(_FLOATS) if self._chance.random() < 0.7 else self._chance.uniform(-10.0, 10.0)

    def _time(self) -> genpy.Time:
        return genpy.Time(self._chance.choice((0, 1, 2 ** 31 - 1, 2 ** 32 - 1, 1_600_000_000)), self._chance.choice((0, 999_999_999)))

    def _duration(self) -> genpy.Duration:
        return genpy.Duration(self._chance.choice((-2 ** 31, -1, 0, 2 ** 31 - 1)), 0)


def _parse(type_name: str) -> tuple:
    """(base type, is it an array, its length or None)."""
    if not type_name.endswith("]"):
        return type_name, False, None
    base, length = type_name[:-1].split("[")
    return base, True, int(length) if length else None
