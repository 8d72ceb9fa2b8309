"""What the store keeps of one person, reading it back from a row in which anything may be broken, and for how long it
stays, although the clock may be wrong.

A computer without a battery for its clock starts in 1970, or years ahead, until it hears the time from a network. So
nobody expires by a time that the store has not seen come: `StoreClock` remembers the span over which the clock went on
without a jump, and `judge_retention` compares the times of that span only, unless the system says that its clock is
synchronised.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass, field
from typing import Any, Callable, Container, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.recognition.likelihood import UNIT_TOLERANCE

ENCRYPTED = "what is encrypted"
"""The fault of a row that the key does not open."""
CLOSED = "cannot be opened"
"""The same of a template."""
_STEP = 32      # of the lengths of the templates of networks
DAY_S = 86400.0
LATEST_S = 1e11
"""Later times (s) are none."""
LARGEST_STEP_S = 30.0 * DAY_S
"""A clock that is ahead by more than this, or by half of the greatest age, since the store was used has jumped."""
BACK_S = DAY_S
"""A clock may be behind by this: local time instead of UTC is."""


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


@dataclass(frozen=True)
class Span:
    """Times (s) between which a clock has gone on without a jump."""

    start: float
    end: float

    def goes_on(self, now: float, largest_step: float) -> bool:
        """Tell whether `now` is no jump, forward by more than `largest_step` (s) or back."""
        return self.end - BACK_S <= now <= self.end + largest_step

    def until(self, now: float) -> Span:
        """Return the span when it is `now`."""
        return Span(self.start, max(self.end, now))

    def __contains__(self, when: float) -> bool:
        return self.start - BACK_S <= when <= self.end + BACK_S


@dataclass(frozen=True)
class StoreClock:
    """What a store knows of the clock. trusted: the times that count; doubted: those since a jump, None without one."""

    trusted: Span
    doubted: Optional[Span] = None

    def to_json(self) -> str:
        """Return it as text."""
        spans = [span for span in (self.trusted, self.doubted) if span is not None]
        return json.dumps([[span.start, span.end] for span in spans])

    @staticmethod
    def from_json(text: str) -> Optional[StoreClock]:
        """Return what `to_json` was given, None for anything else."""
        try:
            spans = [Span(float(start), float(end)) for start, end in json.loads(text)]
            if all(abs(span.start) < LATEST_S and abs(span.end) < LATEST_S for span in spans):
                return StoreClock(*spans)
        except (TypeError, ValueError):
            pass
        return None


@dataclass(frozen=True)
class RetentionVerdict:
    """What becomes of the people of a store.

    gone: ids of who is to be removed; redated: of who was seen by a clock that was wrong, and is taken for seen now;
    clock: what the store knows of the clock from now on; problem: what is wrong with the clock, empty when nothing is.
    """

    gone: List[str]
    redated: List[str]
    clock: StoreClock
    problem: str


def judge_retention(last_seen: Mapping[str, float], clock: Optional[StoreClock], now: float, max_age: float,
                    max_persons: int, is_synchronised: bool = False, told: Container[str] = ()) -> RetentionVerdict:
    """Decide who stays.

    While the clock is doubted nobody expires by age. It is trusted again when it is synchronised, is back at the time
    of before, or has gone on for `max_age` since it jumped: who was not seen in all that time has expired by any clock.

    Parameters
    ----------
    last_seen : times (s) at which people were seen last, by id.
    clock : what the store knew, None for a store of an earlier version.
    now : time (s).
    max_age : greatest time (s) unseen; 0: no limit.
    max_persons : most people; 0: no limit.
    is_synchronised : whether the system says that its clock is right, as by NTP.
    told : of whom somebody has said something: of too many they go last.
    """
    if clock is None:
        known = list(last_seen.values()) or [now]
        clock = StoreClock(Span(min(known), max(known)))
    before = clock
    clock = _at(clock, now, max_age, is_synchronised)
    ages = {person: _age(when, before, clock, now) for person, when in last_seen.items()}
    # Who was seen since the clock jumped has no age while it is doubted, and was seen last.
    order = sorted(last_seen, key=lambda person: (person not in told,
                                                  ages[person] is not None or clock.doubted is None,
                                                  ages[person] or 0.0, -last_seen[person]))
    is_old = {person: clock.doubted is None and 0.0 < max_age < (ages[person] or 0.0) for person in order}
    gone = [person for number, person in enumerate(order) if is_old[person] or 0 < max_persons <= number]
    redated = [person for person in order if clock.doubted is None and ages[person] is None and person not in set(gone)]
    return RetentionVerdict(gone, redated, clock, _problem(clock, max_age))


def _at(clock: StoreClock, now: float, max_age: float, is_synchronised: bool) -> StoreClock:
    step = min(LARGEST_STEP_S, max_age / 2.0) if max_age else LARGEST_STEP_S
    if clock.trusted.goes_on(now, step):
        return StoreClock(clock.trusted.until(now))
    if is_synchronised and now > clock.trusted.end:
        return StoreClock(clock.trusted.until(now))
    doubted = clock.doubted
    doubted = doubted.until(now) if doubted is not None and doubted.goes_on(now, step) else Span(now, now)
    if is_synchronised or doubted.end - doubted.start > (max_age or LARGEST_STEP_S):
        return StoreClock(doubted)
    return StoreClock(clock.trusted, doubted)


def _age(when: float, before: StoreClock, clock: StoreClock, now: float) -> Optional[float]:
    """Time (s) since somebody was seen; None where no clock that was trusted has told that."""
    wrong = before.doubted if clock.trusted.start == before.trusted.start else None
    if wrong is not None and wrong.end + LARGEST_STEP_S < now and when in wrong and when not in before.trusted:
        return None
    if when in clock.trusted:
        return max(0.0, now - when)
    if clock.doubted is None and clock.trusted.start != before.trusted.start and when in before.trusted:
        return max(0.0, now - clock.trusted.start) + before.trusted.end - when
    return None


def _problem(clock: StoreClock, max_age: float) -> str:
    if clock.doubted is None or not max_age:
        return ""
    now, last = (time.strftime("%Y-%m-%d", time.gmtime(span.end)) for span in (clock.doubted, clock.trusted))
    return ("the clock says {}, and the store was used last on {}: nobody expires before it is synchronised (NTP), "
            "goes on from there, or has gone on without a jump for {:g} days (store_max_age); set it if it is "
            "wrong".format(now, last, max_age / DAY_S))
