"""What the store keeps of one person, and reading it back from a row in which anything may be broken."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.recognition.likelihood import UNIT_TOLERANCE
from hri_pipeline.core.recognition.retention import LATEST_S

ENCRYPTED = "what is encrypted"
"""The fault of a row that the key does not open."""
CLOSED = "cannot be opened"
"""The same of a template."""
_STEP = 32      # of the lengths of the templates of networks


@dataclass(frozen=True)
class PermanentPerson:
    """What is kept of one permanent person.

    Times: s of wall time; alias: id of the person that this one was merged into.
    """

    id: str
    name: str = ""
    native_language: str = ""
    enrolled: bool = False
    alias: str = ""
    first_seen: float = 0.0
    last_seen: float = 0.0


@dataclass(frozen=True)
class StoredPerson(PermanentPerson):
    """One person as a row of the store. demographics: plain data, empty if unknown."""

    demographics: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class KnownPerson:
    """The face templates of one person. templates: (K, D) float32 unit vectors; enrolled: agreed to be recognised."""

    id: str
    templates: np.ndarray
    enrolled: bool = False


COLUMNS = "id, name, native_language, enrolled, alias, first_seen, last_seen, demographics, sealed"


@dataclass(frozen=True)
class PersonRow:
    """A row as it was read. person: what of it is sound; faults: what is not, in words, none where all is."""

    person: StoredPerson
    faults: Tuple[str, ...]


def read_person(row: Sequence[Any], decrypt: Optional[Callable[[bytes], bytes]], now: float) -> PersonRow:
    """Read a row of COLUMNS.

    Parameters
    ----------
    row : values; text that is no UTF-8 has surrogates.
    decrypt : opens the last column, ValueError where it cannot; None without a key, then that column is not looked at.
    now : time (s), for times that cannot be read: so nobody expires by them.
    """
    person_id, name, language, enrolled, alias, first, last, demographics, sealed = row
    faults: List[str] = []
    told: Tuple[Any, ...] = (name, language, first, last, _parsed(demographics))
    if sealed is not None and decrypt is not None:
        told, fault = _unsealed(sealed, decrypt)
        faults += [fault] if fault else []
    name, language, first, last, demographics = told if not faults else ("", "", None, None, {})
    if not faults:
        sound = {"the name": _is_text(name), "the language": _is_text(language), "the times": _is_time(first, last),
                 "age and gender": _is_plain(demographics)}
        faults += [what for what, is_sound in sound.items() if not is_sound]
    is_consent, is_alias = enrolled in (0, 1), isinstance(alias, str) and (not alias or is_valid_id(alias))
    faults += ["the consent"] * (not is_consent) + ["the alias"] * (not is_alias)
    faults += ["the id, and with it the rest"] * (not is_valid_id(person_id))
    times = [float(when) for when in (first, last) if _is_time(when)] or [now]
    return PersonRow(StoredPerson(
        person_id, name if _is_text(name) else "", language if _is_text(language) else "",
        is_consent and bool(enrolled), alias if is_alias else "", times[0], times[-1],
        demographics if _is_plain(demographics) else {}), tuple(faults))


def _unsealed(sealed: Any, decrypt: Callable[[bytes], bytes]) -> Tuple[Tuple[Any, ...], str]:
    """What an encrypted column tells, and what is wrong with it."""
    try:
        content = decrypt(sealed)
    except (TypeError, ValueError):
        return (), ENCRYPTED
    told = _parsed(content)
    return (tuple(told), "") if isinstance(told, list) and len(told) == 5 else ((), "what was encrypted")


def _parsed(content: Any) -> Any:
    """The data of JSON; None for what is none."""
    try:
        return json.loads(content)
    except (TypeError, ValueError, RecursionError):
        return None


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and not any(0xD800 <= ord(letter) < 0xE000 for letter in value)


def _is_time(*values: Any) -> bool:
    return all(_is_number(value) and abs(value) < LATEST_S for value in values)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _is_plain(value: Any) -> bool:
    return isinstance(value, dict) and all(map(_is_number, value.values()))


def template_fault(content: bytes, dimension: int) -> str:
    """Return what is wrong with the bytes of a template of `dimension` numbers, empty when nothing is."""
    if len(content) != 4 * dimension:
        return "has {:g} numbers instead of {}".format(len(content) / 4, dimension)
    length = float(np.linalg.norm(np.frombuffer(content, dtype="<f4")))
    # Also false for what is no number.
    return "" if abs(length - 1.0) <= UNIT_TOLERANCE else "is no unit vector"


def is_of_another_network(contents: Sequence[bytes]) -> bool:
    """Tell whether the bytes of templates of a wrong length are sound ones of another network."""
    numbers = {len(content) // 4 for content in contents}
    return len(numbers) == 1 and all(
        len(content) % (4 * _STEP) == 0 and not template_fault(content, len(content) // 4) for content in contents)


def as_json(values: Sequence[Any]) -> bytes:
    """Return values of a row as JSON, bytes in hexadecimal digits."""
    plain: List[Any] = [{"hex": value.hex()} if isinstance(value, bytes) else value for value in values]
    return json.dumps(plain).encode("ascii")


def by_person(faults: Sequence[Tuple[str, str]]) -> Dict[str, List[str]]:
    """Return the faults of each person once, of pairs of id and fault."""
    found: Dict[str, List[str]] = {}
    for person_id, fault in faults:
        if fault not in found.setdefault(person_id, []):
            found[person_id].append(fault)
    return found
