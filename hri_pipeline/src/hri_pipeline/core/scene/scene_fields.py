"""Checked access to what YAML gives; every error names the file, the way to the key, and what is legal there."""

from __future__ import annotations

import difflib
import math
from typing import List, Mapping, Optional, Sequence, Tuple


class SceneError(ValueError):
    """A scene file that says something which is not legal."""


class Fields:
    """The keys of one mapping of a scene file.

    source: name of the file. path: way to the mapping, such as `people[2]`. known: its legal keys.
    Raises SceneError for what is no mapping and for unknown keys.
    """

    def __init__(self, data: object, source: str, path: str, known: Sequence[str]) -> None:
        self._source, self._path = source, path
        if not isinstance(data, Mapping):
            raise SceneError("{}: {} is {}; legal: a mapping with the keys {}".format(
                source, path or "the file", _short(data), ", ".join(known)))
        self._data = data
        for key in data:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1)
                raise SceneError("{}: there is no key {}{}; legal: {}".format(
                    source, self._key(str(key)), " (did you mean {}?)".format(near[0]) if near else "", ", ".join(known)))

    def error(self, key: str, value: object, legal: str) -> SceneError:
        """Return the error of one value."""
        return SceneError("{}: {} is {}; legal: {}".format(self._source, self._key(key), _short(value), legal))

    def has(self, key: str) -> bool:
        """Tell whether the key is there."""
        return self._data.get(key) is not None

    def raw(self, key: str) -> object:
        """Return the value as it stands there."""
        return self._data.get(key)

    def number(self, key: str, default: Optional[float], low: float, high: float, unit: str = "") -> float:
        """Return a finite number from `low` to `high`; without a default the key has to be there."""
        value = self._given(key, default)
        legal = "a number from {:g} to {:g}{}".format(low, high, " " + unit if unit else "")
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.error(key, value, legal)
        if not low <= value <= high:
            raise self.error(key, value, legal)
        return float(value)

    def integer(self, key: str, default: Optional[int], low: int, high: int) -> int:
        """Return a whole number from `low` to `high`."""
        value = self._given(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.error(key, value, "a whole number from {} to {}".format(low, high))
        return value

    def boolean(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self._given(key, default)
        if not isinstance(value, bool):
            raise self.error(key, value, "true or false")
        return value

    def text(self, key: str, default: Optional[str]) -> str:
        """Return a text of 100 characters at most."""
        value = self._given(key, default)
        if not isinstance(value, str) or not 0 < len(value) <= 100:
            raise self.error(key, value, "a text of 1 to 100 characters")
        return value

    def choice(self, key: str, choices: Sequence[str]) -> str:
        """Return one of the choices."""
        value = self._given(key, None)
        if value not in choices:
            raise self.error(key, value, "one of " + ", ".join(choices))
        return str(value)

    def point(self, key: str, default: Optional[Tuple[float, float]]) -> Tuple[float, float]:
        """Return a place on the floor, m: a list of two numbers from -100 to 100."""
        if default is None and not self.has(key):
            raise SceneError("{}: {} is missing".format(self._source, self._key(key)))
        x, y = self.numbers(key, default if default is not None else (0.0, 0.0), -100.0, 100.0, "m")
        return x, y

    def numbers(self, key: str, default: Tuple[float, ...], low: float, high: float, unit: str = "") -> Tuple[float, ...]:
        """Return as many numbers from `low` to `high` as the default has."""
        values = self._given(key, list(default))
        if not isinstance(values, list) or len(values) != len(default) or not all(
                isinstance(value, (int, float)) and not isinstance(value, bool) and low <= value <= high for value in values):
            raise self.error(key, values, "a list of {} numbers from {:g} to {:g}{}".format(
                len(default), low, high, " " + unit if unit else ""))
        return tuple(float(value) for value in values)

    def items(self, key: str, least: int, most: int) -> List[object]:
        """Return a list of `least` to `most` items."""
        value = self._given(key, [])
        if not isinstance(value, list) or not least <= len(value) <= most:
            raise self.error(key, value, "a list of {} to {}".format(least, most))
        return list(value)

    def section(self, key: str, known: Sequence[str]) -> Optional["Fields"]:
        """Return the mapping below a key, None where it is not there."""
        return Fields(self._data[key], self._source, self._key(key), known) if self.has(key) else None

    def entries(self, key: str, known: Sequence[str], most: int) -> List["Fields"]:
        """Return the mappings in the list below a key, none where it is not there."""
        if not self.has(key):
            return []
        return [Fields(item, self._source, "{}[{}]".format(self._key(key), index), known)
                for index, item in enumerate(self.items(key, 0, most))]

    def _given(self, key: str, default: object) -> object:
        value = self._data.get(key)
        if value is not None:
            return value
        if default is None:
            raise SceneError("{}: {} is missing".format(self._source, self._key(key)))
        return default

    def _key(self, key: str) -> str:
        return "{}.{}".format(self._path, key) if self._path and key else (key or self._path)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
