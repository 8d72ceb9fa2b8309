"""What is known of the permanent persons beyond the present: names, languages, demographics, when they were seen.

`PersonRegister` keeps the records in memory and writes changes to a `RecordStore`, which in the node is the SQLite file
that the recognisers use as well. Age and gender of a person are fused over all faces that the person has had.
"""

from __future__ import annotations

import math
import re
import threading
import unicodedata
from collections import OrderedDict
from dataclasses import asdict, dataclass, field, replace
from statistics import NormalDist
from typing import Any, Callable, Container, Dict, Iterable, List, Mapping, Optional, Protocol, Sequence, Set, Tuple

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.privacy import StoreError
from hri_pipeline.core.recognition.store import PersonStore
from hri_pipeline.core.recognition.stored_person import PermanentPerson, StoredPerson

UNDEFINED, FEMALE, MALE, OTHER = range(4)      # the constants of hri_msgs/AgeAndGender and SoftBiometrics
AGE_TOLERANCE = 10.0       # years: age_confidence is the probability that the age is right within them
_LEAST_WITHIN = 0.1        # of an age of which nothing is known: a deviation of 100 years
_LEAST_GENDER_CONFIDENCE = 0.6
_MAX_FACES = 20
LONGEST_NAME = 64
SEEN_STEP_S = 10.0       # last_seen is written to the store in steps of so many seconds
DAY_S = 86400.0
_BORROWED = "{} is in a read-only store; change it there"


@dataclass(frozen=True)
class DemographicsEstimate:
    """age and age_deviation in years, confidences 0 to 1, gender one of the constants; `stamp` s, of the newest
    image."""

    age: float
    age_deviation: float
    age_confidence: float
    gender: int
    gender_confidence: float
    stamp: float


@dataclass(frozen=True)
class _Face:
    age: float
    age_confidence: float
    female: float
    gender_confidence: float
    stamp: float


class DemographicsFusion:
    """What is known of one person. Each face counts once, with its newest estimate, as that is fused itself."""

    def __init__(self, earlier: Optional[DemographicsEstimate] = None) -> None:
        """Start with the estimate of an earlier run, if there is one; it counts as one face."""
        self._faces: "OrderedDict[str, _Face]" = OrderedDict()
        self._estimate: Optional[DemographicsEstimate] = None
        if earlier is not None:
            self.observe("", earlier.age, earlier.age_confidence, earlier.gender, earlier.gender_confidence,
                         earlier.stamp)

    def observe(self, face_id: str, age: float, age_confidence: float, gender: int, gender_confidence: float,
                stamp: float) -> bool:
        """Take the estimate of one face; returns whether it was sound and used.

        age: years; confidences: 0 (not known) to 1; stamp: s. The face that has been quiet longest goes first.
        """
        numbers = (age, age_confidence, gender_confidence, stamp)
        if not all(math.isfinite(number) for number in numbers) or not 0.0 <= age <= 130.0 or not (
                0.0 <= age_confidence <= 1.0 and 0.0 <= gender_confidence <= 1.0):
            return False
        female = {FEMALE: gender_confidence, MALE: 1.0 - gender_confidence}.get(gender, 0.5)
        known = gender_confidence if gender in (FEMALE, MALE) else 0.0
        self._faces.pop(face_id, None)
        if age_confidence > 0.0 or known > 0.0:
            self._faces[face_id] = _Face(age, age_confidence, female, known, stamp)
        while len(self._faces) > _MAX_FACES:
            self._faces.popitem(last=False)
        self._estimate = self._fuse()
        return True

    def estimate(self) -> Optional[DemographicsEstimate]:
        """Return the fused estimate, None while nothing is known."""
        return self._estimate

    def _fuse(self) -> Optional[DemographicsEstimate]:
        """The faces are one human's, so their errors go together: confidences are averaged, not multiplied."""
        faces = self._faces.values()
        if not faces:
            return None
        weight = sum(face.age_confidence for face in faces)
        age = sum(face.age_confidence * face.age for face in faces) / weight if weight else 0.0
        spread = sum(face.age_confidence * (face.age - age) ** 2 for face in faces) / weight if weight else 0.0
        sure = sum(face.gender_confidence for face in faces)
        female = sum(face.gender_confidence * face.female for face in faces) / sure if sure else 0.5
        likely = max(female, 1.0 - female)
        gender = UNDEFINED if likely < _LEAST_GENDER_CONFIDENCE else FEMALE if female > 0.5 else MALE
        confidence = _age_confidence(weight / len(faces), spread / max(1, len(faces) - 1))
        return DemographicsEstimate(
            age, AGE_TOLERANCE / max(_within(confidence), _LEAST_WITHIN) if weight else 0.0, confidence, gender,
            likely if gender != UNDEFINED else 0.0, max(face.stamp for face in faces))


def _within(confidence: float) -> float:
    """Return AGE_TOLERANCE in standard deviations of an age that is right within it with this probability."""
    return NormalDist().inv_cdf(0.5 + 0.5 * min(confidence, 0.999))


def _age_confidence(confidence: float, variance: float) -> float:
    """Return the probability that a mean age is right within AGE_TOLERANCE, of faces that each have a `confidence` and
    differ, so that their mean has this variance (years^2) besides."""
    if not variance > 0.0:
        return confidence
    within = _within(confidence)
    return math.erf(AGE_TOLERANCE * within / math.sqrt(2.0 * (AGE_TOLERANCE ** 2 + variance * within ** 2)))


class RegisterError(ValueError):
    """A request that cannot be carried out; the text says why."""


@dataclass(frozen=True)
class PersonRecord(PermanentPerson):
    """One permanent person as the register knows it."""

    demographics: Optional[DemographicsEstimate] = None


@dataclass
class RecordChange:
    """What a store has to do, in this order: remove everybody, remove these ids, write these records."""

    everybody: bool = False
    removed: Set[str] = field(default_factory=set)
    records: Dict[str, PersonRecord] = field(default_factory=dict)

    def __len__(self) -> int:
        return self.everybody + len(self.removed) + len(self.records)

    def remove(self, person_id: str) -> None:
        """Also remove a person."""
        self.records.pop(person_id, None)
        self.removed.add(person_id)

    def after(self, earlier: RecordChange) -> RecordChange:
        """Return both in one, this one being the later one."""
        if self.everybody:
            return self
        kept = {key: record for key, record in earlier.records.items() if key not in self.removed}
        return RecordChange(earlier.everybody, earlier.removed | self.removed, {**kept, **self.records})


class RecordStore(Protocol):
    """Where records outlive the process."""

    def load_records(self) -> Sequence[PersonRecord]:
        """Return all records."""

    def write(self, change: RecordChange) -> List[str]:
        """Carry out a change, all of it or nothing (StoreError), without a trace of who goes.

        Returns whom another process has removed since they were read or written here: they are not written again.
        """

    def expire(self, now: float) -> List[str]:
        """Remove whom the limits of the store do not let stay, `now` in s; returns their ids."""


class PersonRegister:
    """All permanent persons by id. What changes is known at once, and in the store, if there is one, after flush().

    flush() and expire() may take as long as a disk does: they belong in a thread of their own. The other methods never
    wait for them; they are called by one thread at a time, but said_of() and demographics() by any.
    """

    def __init__(self, store: Optional[RecordStore] = None, borrowed: Sequence[PersonRecord] = ()) -> None:
        """borrowed: records of read-only stores; they are known, and neither written nor changed."""
        self._store = store
        self._lock = threading.Lock()      # of what follows, for flush(), expire() and said_of()
        self._change = RecordChange()
        self._gone: List[str] = []
        self._records: Dict[str, PersonRecord] = {}
        self._demographics: Dict[str, DemographicsFusion] = {}
        self._merged: Optional[Dict[str, List[str]]] = None      # ids by the person they were merged into
        for record in store.load_records() if store is not None else ():
            self._records[record.id] = record
            self._demographics[record.id] = DemographicsFusion(record.demographics)
        self._borrowed = {record.id for record in borrowed} - set(self._records)
        self._records.update((record.id, record) for record in borrowed if record.id in self._borrowed)

    def __contains__(self, person_id: str) -> bool:
        """Tell whether somebody is known."""
        return person_id in self._records

    @property
    def records(self) -> List[PersonRecord]:
        """All records, sorted by id."""
        return [self._records[key] for key in sorted(self._records)]

    def get(self, person_id: str) -> Optional[PersonRecord]:
        """Return the record of a person, None for an unknown id."""
        return self._records.get(person_id)

    def seen(self, person_ids: Iterable[str], now: float) -> None:
        """Note that these permanent persons, and those merged into them, are seen at `now` (s); the unknown are known
        from now on."""
        for person_id in person_ids:
            record = self._records.get(person_id)
            if record is None:
                self._write(PersonRecord(person_id, first_seen=now, last_seen=now))
            elif now - record.last_seen >= SEEN_STEP_S or now < record.last_seen:
                same = [other for other in self._records.values() if other.alias == person_id]
                for one in (record, *same):
                    self._write(replace(one, last_seen=now))

    def flush(self) -> None:
        """Write what has changed; cheap when nothing has. StoreError: it is not written, and waits for the next
        call."""
        with self._lock:
            change, self._change = self._change, RecordChange()
            for person_id in self._gone:
                change.records.pop(person_id, None)
        if self._store is None or not change:
            return
        try:
            gone = self._store.write(change)
        except BaseException as error:
            with self._lock:
                self._change = self._change.after(change)
            if isinstance(error, StoreError):
                raise StoreError("{} persons are not kept, or not forgotten: {}".format(len(change), error)) from error
            raise
        with self._lock:
            self._gone += gone

    def expire(self, now: float) -> None:
        """Remove whom the limits of the store do not let stay, `now` in s. StoreError: not all are removed yet."""
        gone = self._store.expire(now) if self._store is not None else []
        with self._lock:
            self._gone += gone

    def take_gone(self) -> List[str]:
        """Return whom another process has forgotten, and who has expired, since the last call; nothing is known of
        them."""
        with self._lock:
            gone, self._gone = self._gone, []
            for person_id in gone:
                self._change.records.pop(person_id, None)
        for person_id in gone:
            self._drop(person_id)
        return gone

    def said_of(self, person_id: str, merged: Iterable[str] = ()) -> Tuple[str, str]:
        """Return name and native language of a person, empty where nobody has told them; what is not told of the person
        itself is that of those merged into it, by the register or as `merged` names them."""
        with self._lock:
            if self._merged is None:
                self._merged = {}
                for record in self._records.values():
                    if record.alias:
                        self._merged.setdefault(record.alias, []).append(record.id)
            ids = (person_id, *sorted({*merged, *self._merged.get(person_id, ())}))
            said = [self._records[one] for one in ids if one in self._records]
        return (next((record.name for record in said if record.name), ""),
                next((record.native_language for record in said if record.native_language), ""))

    def set_name(self, person_id: str, name: str) -> None:
        """Give a person a name; an empty one takes it away. RegisterError for an unknown id or an illegal name."""
        self._write(replace(self._known(person_id), name=legal_name(name)))

    def set_native_language(self, person_id: str, language: str) -> None:
        """Set an IETF language tag; an empty one takes it away. RegisterError for an unknown id or what is no tag.

        What is kept is the tag in the form of BCP 47.
        """
        try:
            tag = normal_language_tag(language) if language else ""
        except ValueError as error:
            raise RegisterError(str(error)) from error
        self._write(replace(self._known(person_id), native_language=tag))

    def set_enrolled(self, person_id: str, enrolled: bool, now: float) -> None:
        """Note that a person has agreed to be recognised, or does no more."""
        self.seen([person_id], now)
        self._write(replace(self._known(person_id), enrolled=enrolled))

    def set_alias(self, person_id: str, target: str) -> None:
        """Note that a person was merged into another, empty: is a person of its own again."""
        if target:
            self._known(target)
        self._write(replace(self._known(person_id), alias=target))

    def keep_aliases(self, changed: Iterable[str], stands_for: Callable[[str], str], now: float) -> None:
        """Note who stands for the permanent persons whom a user has joined or parted, and for all merged with them.

        stands_for(id): the person that does, itself where nobody else does. now: s.
        """
        merged: Dict[str, Set[str]] = {}
        for record in self._records.values():
            if record.alias:
                merged.setdefault(record.id, set()).add(record.alias)
                merged.setdefault(record.alias, set()).add(record.id)
        human: Set[str] = set()
        new = set(changed)
        while new:                              # links of links, too
            human |= new
            new = set().union(*(merged.get(person_id, ()) for person_id in new)) - human
        kept = {person_id: stands_for(person_id) for person_id in sorted(human)}
        self.seen(sorted({*kept, *kept.values()} - set(self._records)), now)
        for person_id, target in kept.items():
            self.set_alias(person_id, target if target != person_id else "")

    def observe(self, person_id: str, face_id: str, age: float, age_confidence: float, gender: int,
                gender_confidence: float, stamp: float) -> bool:
        """Fuse what one face shows into a person's demographics; False when it was not used."""
        demographics = self._demographics.setdefault(person_id, DemographicsFusion())
        if not demographics.observe(face_id, age, age_confidence, gender, gender_confidence, stamp):
            return False
        record, estimate = self._records.get(person_id), demographics.estimate()
        if record is not None and _worth_writing(record.demographics, estimate):
            self._write(replace(record, demographics=estimate))
        return True

    def demographics(self, person_id: str) -> Optional[DemographicsEstimate]:
        """Return apparent age and gender of a person, anonymous or not."""
        found = self._demographics.get(person_id)
        return found.estimate() if found is not None else None

    def keep_demographics(self, person_ids: Iterable[str]) -> None:
        """Forget the demographics of anonymous persons that have gone."""
        kept = set(person_ids) | set(self._records)
        self._demographics = {key: value for key, value in self._demographics.items() if key in kept}

    def keep_known(self, person_ids: Container[str]) -> None:
        """Without a store: drop who is none of these and of whom nobody has said anything, as whom a recogniser named
        that has begun anew since. A store keeps everybody, within its limits."""
        if self._store is not None:
            return
        joined = {record.alias for record in self._records.values()}
        for record in [record for record in self._records.values() if not (
                record.id in person_ids or record.id in self._borrowed or record.id in joined or record.name
                or record.native_language or record.enrolled or record.alias)]:
            self._drop(record.id)

    def forget(self, person_id: str) -> bool:
        """Remove everything about a person; False for an unknown id. Those merged into it are removed, too: they are
        the same human.

        An id that is forgotten here but still in the store counts as known, so that the request can be repeated.
        """
        self.check_own(person_id)
        # The empty id is the alias of whoever has none, and nobody's.
        gone = [key for key, record in self._records.items()
                if person_id and person_id in (key, record.alias)]
        with self._lock:
            is_known = bool(gone) or self._change.everybody or person_id in self._change.removed
            for key in gone:
                self._change.remove(key)
        for key in gone:
            self._drop(key)
        self._demographics.pop(person_id, None)
        return is_known

    def check_own(self, person_id: str) -> None:
        """Raise RegisterError for somebody of a read-only store."""
        if person_id in self._borrowed:
            raise RegisterError(_BORROWED.format(person_id))

    def forget_all(self) -> int:
        """Remove everybody; returns how many there were."""
        count = len(self._records)
        with self._lock:
            self._change = RecordChange(everybody=True)
            self._records.clear()
            self._merged = None
        self._demographics.clear()
        self._borrowed.clear()
        return count

    def restart(self) -> None:
        """Forget whom no store keeps; those of stores stay, as after a restart of the process."""
        for person_id in [key for key in self._records if self._store is None and key not in self._borrowed]:
            self._drop(person_id)

    def export(self, person_id: str = "") -> List[dict]:
        """Everything about one person, or about all, as data for JSON. RegisterError for an unknown id."""
        records = [self._known(person_id, "of who is anonymous nothing is kept")] if person_id else self.records
        return [asdict(record) for record in records]

    def _known(self, person_id: str, others: str = "who is anonymous cannot be named") -> PersonRecord:
        record = self._records.get(person_id)
        if record is None:
            shown = person_id if is_valid_id(person_id) else repr(person_id)[:40]
            raise RegisterError("there is no known person {}; `people list` shows them; {}".format(
                shown, others))
        return record

    def _drop(self, person_id: str) -> None:
        with self._lock:
            self._merged = None
            self._records.pop(person_id, None)
        self._demographics.pop(person_id, None)

    def _write(self, record: PersonRecord) -> None:
        before = self._records.get(record.id)
        if before == record:
            return
        if record.id in self._borrowed and before is not None:
            if replace(record, last_seen=before.last_seen, demographics=before.demographics) != before:
                raise RegisterError(_BORROWED.format(record.id))
            return
        with self._lock:
            self._records[record.id] = record
            if record.alias != (before.alias if before is not None else ""):
                self._merged = None
            self._change.records[record.id] = record


def _worth_writing(before: Optional[DemographicsEstimate], now: Optional[DemographicsEstimate]) -> bool:
    """Tell whether an estimate has changed by so much that the store should know."""
    if before is None or now is None:
        return before is not now
    changes: Tuple[float, ...] = (abs(before.age - now.age) / 2.0,
                                  abs(before.age_confidence - now.age_confidence) / 0.1,
                                  abs(before.gender_confidence - now.gender_confidence) / 0.1)
    return before.gender != now.gender or max(changes) >= 1.0


class SqliteRecordStore:
    """A RecordStore in a PersonStore's file, with the limits of how long and how many persons are kept."""

    def __init__(self, store: PersonStore, max_age_days: float = 0.0, max_persons: int = 0,
                 is_synchronised: Callable[[], bool] = lambda: False) -> None:
        """max_age_days, max_persons: 0 for no limit. is_synchronised: tells whether the clock is right for certain."""
        self._store, self._is_synchronised = store, is_synchronised
        self._stored: Set[str] = set()      # who was read or written here
        self._gone: List[str] = []          # who is to be told of by the next write() or expire() that returns
        self._max_age = max_age_days * DAY_S
        self._max_persons = max_persons

    def load_records(self) -> List[PersonRecord]:
        """Return all records."""
        rows = self._store.load_records()
        self._stored = {row.id for row in rows}
        return [record_of(row) for row in rows]

    def write(self, change: RecordChange) -> List[str]:
        """See RecordStore. Templates go with who goes, and stay with who stays."""
        stored = set() if change.everybody else self._stored - change.removed
        gone = []
        with self._store.change():
            if change.everybody:
                self._store.remove_all()
            for person_id in change.removed:
                self._store.remove_record(person_id)
            for record in change.records.values():
                # Whoever is not told of yet is tried again, and not somebody new.
                if record.id in self._gone or not self._store.put_record(_row(record), record.id not in stored):
                    gone.append(record.id)
        self._stored = stored | set(change.records)
        return self._without_traces(gone)

    @property
    def clock_problem(self) -> str:
        """Why nobody expires, by the last expire(); empty when people do."""
        return self._store.clock_problem

    def expire(self, now: float) -> List[str]:
        """Remove who was not seen for too long (`now`: s), and the oldest of too many; returns their ids."""
        if not self._max_age and not self._max_persons:
            return []
        with self._store.change():
            gone = self._store.expire(now, self._max_age, self._max_persons, self._is_synchronised())
        return self._without_traces(gone)

    def _without_traces(self, gone: Sequence[str]) -> List[str]:
        """Erase the traces of who was removed; returns all who are gone, also those before a StoreError."""
        self._stored -= set(gone)
        self._gone += [person_id for person_id in gone if person_id not in self._gone]
        self._store.erase_traces()
        told, self._gone = self._gone, []
        return told

    def close(self) -> None:
        """Give the file back. May be called again."""
        self._store.close()


def record_of(row: StoredPerson) -> PersonRecord:
    """Return the record that a row of a store is."""
    return PersonRecord(**dict(vars(row), demographics=_estimate(row.demographics)))


def _row(record: PersonRecord) -> StoredPerson:
    demographics = asdict(record.demographics) if record.demographics is not None else {}
    return StoredPerson(**dict(vars(record), demographics=demographics))


def _estimate(mapping: Mapping[str, Any]) -> Optional[DemographicsEstimate]:
    """The estimate that was stored; None for none, or one of another version."""
    try:
        return DemographicsEstimate(**mapping)
    except TypeError:
        return None


LONGEST_TAG = 64
_JOINERS = "\u200c\u200d"
_JOINED = ("Lo", "Mn", "Mc", "So")
_LANGUAGE = re.compile(r"(?P<language>[a-z]{2,3})(-(?P<extended>[a-z]{3}))?(-(?P<script>[a-z]{4}))?"
                       r"(-(?P<region>[a-z]{2}|[0-9]{3}))?(?P<variants>(-([a-z0-9]{5,8}|[0-9][a-z0-9]{3}))*)"
                       r"(?P<extensions>(-[0-9a-wy-z](-[a-z0-9]{2,8})+)*)(?P<private>-x(-[a-z0-9]{1,8})+)?", re.ASCII)
_PRIVATE = re.compile(r"x(-[a-z0-9]{1,8})+", re.ASCII)


def legal_name(name: str) -> str:
    """Return a name without spaces around it; RegisterError for one that cannot be kept."""
    name = name.strip()
    if len(name) > LONGEST_NAME or not all(_is_printable(name, index) for index in range(len(name))):
        raise RegisterError("a name has at most {} printable characters".format(LONGEST_NAME))
    return name


def _is_printable(name: str, index: int) -> bool:
    """Tell whether the letter at `index` shows: spaces of all scripts do, and joiners of no width where two letters of
    a script without capitals (Persian, Hindi) or two parts of a sign are beside them."""
    if name[index] in _JOINERS:
        return all(unicodedata.category(beside) in _JOINED for beside in (name[index - 1:index] or " ",
                                                                          name[index + 1:index + 2] or " "))
    return name[index].isprintable() or unicodedata.category(name[index]) == "Zs"


def is_storable(text: str) -> bool:
    """Tell whether a text can be written as UTF-8; half a UTF-16 pair, as JSON and odd locales bring it, cannot."""
    return not any(0xD800 <= ord(letter) < 0xE000 for letter in text)


def normal_language_tag(text: str) -> str:
    """Return a language tag in the form of BCP 47; ValueError for what is none."""
    tag = text.replace("_", "-").lower()
    found = _LANGUAGE.fullmatch(tag)
    if len(text) > LONGEST_TAG or not text.isascii() or (found is None and not _PRIVATE.fullmatch(tag)):
        raise ValueError("{!r} is no IETF language tag, such as fr, pt-BR or zh-Hant-TW".format(text[:40]))
    if found is None:
        return tag
    variants = found["variants"].split("-")[1:]
    extensions = _extensions(found["extensions"])
    if len(set(variants)) < len(variants) or len({parts[0] for parts in extensions}) < len(extensions):
        raise ValueError("{!r} is no IETF language tag: a part comes twice".format(text[:40]))
    parts = [found["extended"] or found["language"], (found["script"] or "").title(), (found["region"] or "").upper(),
             *variants, *("-".join(parts) for parts in sorted(extensions))]
    return "-".join(part for part in parts if part) + (found["private"] or "")


def _extensions(text: str) -> List[List[str]]:
    """The extensions of a tag, each a letter or digit and its subtags."""
    found: List[List[str]] = []
    for part in text.split("-")[1:]:
        if len(part) == 1:
            found.append([part])
        else:
            found[-1].append(part)
    return found
