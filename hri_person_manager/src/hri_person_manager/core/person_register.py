"""What is known of the permanent persons beyond the present: names, languages, demographics, when they were seen."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, replace
from typing import Dict, Iterable, List, Optional, Protocol, Sequence, Set, Tuple

from hri_person_manager.core.demographics import Demographics, DemographicsEstimate
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.private_file import StoreError
from hri_pipeline.core.recognition.person_schema import PersonFacts

LONGEST_NAME = 64
# RFC 5646, section 2.1, as far as names of languages go: language, script, region, variants.
_LANGUAGE = re.compile(r"[A-Za-z]{2,8}(-[A-Za-z]{4})?(-([A-Za-z]{2}|[0-9]{3}))?(-([A-Za-z0-9]{5,8}|[0-9][A-Za-z0-9]{3}))*")
SEEN_STEP_S = 10.0       # last_seen is written to the store in steps of so many seconds


class RegisterError(ValueError):
    """A wish that cannot be met; the text says why."""


@dataclass(frozen=True)
class PersonRecord(PersonFacts):
    """One permanent person as the register knows it."""

    demographics: Optional[DemographicsEstimate] = None


class RecordStore(Protocol):
    """Where records outlive the process."""

    def load_records(self) -> Sequence[PersonRecord]:
        """Return all records."""

    def put_record(self, record: PersonRecord) -> None:
        """Write one record, whether it is new or not."""

    def remove_record(self, person_id: str) -> None:
        """Remove one person without a trace."""

    def remove_all(self) -> None:
        """Remove everybody without a trace."""


class PersonRegister:
    """All permanent persons by id, written through to a store if there is one.

    What the store does not take (the disk is full) is known here all the same, and waits for write_pending(); `problem`
    says why, empty when nothing waits. Who has wished for it gets the StoreError as well.
    """

    def __init__(self, store: Optional[RecordStore] = None) -> None:
        self._store = store
        self._unwritten: Set[str] = set()
        self.problem = ""
        self._records: Dict[str, PersonRecord] = {}
        self._demographics: Dict[str, Demographics] = {}
        for record in store.load_records() if store is not None else ():
            self._records[record.id] = record
            self._demographics[record.id] = Demographics(record.demographics)

    def __contains__(self, person_id: str) -> bool:
        """Tell whether somebody is known."""
        return person_id in self._records

    @property
    def records(self) -> List[PersonRecord]:
        """All records, sorted by id."""
        return [self._records[key] for key in sorted(self._records)]

    def get(self, person_id: str) -> Optional[PersonRecord]:
        """Return the record of a person, None of a stranger."""
        return self._records.get(person_id)

    def seen(self, person_ids: Iterable[str], now: float) -> None:
        """Note that these permanent persons are seen at `now` (s); the unknown are known from now on."""
        for person_id in person_ids:
            record = self._records.get(person_id)
            if record is None:
                self._note(PersonRecord(person_id, first_seen=now, last_seen=now))
            elif now - record.last_seen >= SEEN_STEP_S or now < record.last_seen:
                self._note(replace(record, last_seen=now))

    def write_pending(self) -> None:
        """Write what the store did not take, as far as it does now; cheap when nothing waits."""
        for person_id in sorted(self._unwritten):
            try:
                self._put(self._records[person_id])
            except StoreError:
                return

    def set_name(self, person_id: str, name: str) -> None:
        """Give a person a name; an empty one takes it away. RegisterError for a stranger or an illegal name."""
        name = name.strip()
        if len(name) > LONGEST_NAME or not all(letter.isprintable() for letter in name):
            raise RegisterError("a name has at most {} printable characters".format(LONGEST_NAME))
        self._write(replace(self._known(person_id), name=name))

    def set_native_language(self, person_id: str, language: str) -> None:
        """Set an IETF language tag; an empty one takes it away. RegisterError for a stranger or what is no tag."""
        if language and not (_LANGUAGE.fullmatch(language) and len(language) <= 35):
            raise RegisterError("{!r} is no IETF language tag, such as fr or pt-BR".format(language[:40]))
        self._write(replace(self._known(person_id), native_language=language))

    def set_enrolled(self, person_id: str, enrolled: bool, now: float) -> None:
        """Note that a person has agreed to be recognised, or does no more."""
        self.seen([person_id], now)
        self._write(replace(self._known(person_id), enrolled=enrolled))

    def set_alias(self, person_id: str, target: str) -> None:
        """Note that a person was merged into another, empty: is a person of its own again."""
        if target:
            self._known(target)
        self._write(replace(self._known(person_id), alias=target))

    def observe(self, person_id: str, face_id: str, age: float, age_confidence: float, gender: int,
                gender_confidence: float, stamp: float) -> bool:
        """Fuse what one face shows into a person's demographics; False when it was not used."""
        demographics = self._demographics.setdefault(person_id, Demographics())
        if not demographics.observe(face_id, age, age_confidence, gender, gender_confidence, stamp):
            return False
        record, estimate = self._records.get(person_id), demographics.estimate()
        if record is not None and _worth_writing(record.demographics, estimate):
            self._note(replace(record, demographics=estimate))
        return True

    def demographics(self, person_id: str) -> Optional[DemographicsEstimate]:
        """Return apparent age and gender of a person, anonymous or not."""
        found = self._demographics.get(person_id)
        return found.estimate() if found is not None else None

    def keep_demographics(self, person_ids: Iterable[str]) -> None:
        """Forget the demographics of anonymous persons that have gone."""
        kept = set(person_ids) | set(self._records)
        self._demographics = {key: value for key, value in self._demographics.items() if key in kept}

    def forget(self, person_id: str) -> bool:
        """Remove everything about a person; False for a stranger. Also those merged into it go: they are the same.

        Whom the store does not let go (StoreError) is known still, so that the wish can be repeated.
        """
        gone = [key for key, record in self._records.items() if key == person_id or record.alias == person_id]
        for key in gone:
            if self._store is not None:
                self._store.remove_record(key)
            self.drop(key)
        self._demographics.pop(person_id, None)
        return bool(gone)

    def drop(self, person_id: str) -> None:
        """Take a person out whom the store has removed by itself."""
        self._records.pop(person_id, None)
        self._demographics.pop(person_id, None)
        self._has_written(person_id)

    def forget_all(self) -> int:
        """Remove everybody; returns how many there were. StoreError: as in forget()."""
        count = len(self._records)
        if self._store is not None:
            self._store.remove_all()
        for person_id in list(self._records):
            self.drop(person_id)
        self._demographics.clear()
        return count

    def export(self, person_id: str = "") -> List[dict]:
        """Everything about one person, or about all, as data for JSON. RegisterError for a stranger."""
        records = [self._known(person_id)] if person_id else self.records
        return [asdict(record) for record in records]

    def _known(self, person_id: str) -> PersonRecord:
        record = self._records.get(person_id)
        if record is None:
            shown = person_id if is_valid_id(person_id) else repr(person_id)[:40]
            raise RegisterError("there is no known person {}; `people list` shows them; who is anonymous cannot be named".format(shown))
        return record

    def _note(self, record: PersonRecord) -> None:
        """Write what nobody has wished for: nobody waits for an answer."""
        try:
            self._write(record)
        except StoreError:
            pass    # it waits, and `problem` says why

    def _write(self, record: PersonRecord) -> None:
        if self._records.get(record.id) == record and record.id not in self._unwritten:
            return
        self._records[record.id] = record
        self._put(record)

    def _put(self, record: PersonRecord) -> None:
        if self._store is None:
            return
        self._unwritten.add(record.id)
        try:
            self._store.put_record(record)
        except StoreError as error:
            self.problem = "{} persons are not kept: {}".format(len(self._unwritten), error)
            raise
        self._has_written(record.id)

    def _has_written(self, person_id: str) -> None:
        self._unwritten.discard(person_id)
        if not self._unwritten:
            self.problem = ""


def _worth_writing(before: Optional[DemographicsEstimate], now: Optional[DemographicsEstimate]) -> bool:
    """Tell whether an estimate has changed by so much that the store should know."""
    if before is None or now is None:
        return before is not now
    changes: Tuple[float, ...] = (abs(before.age - now.age) / 2.0, abs(before.age_confidence - now.age_confidence) / 0.1,
                                  abs(before.gender_confidence - now.gender_confidence) / 0.1)
    return before.gender != now.gender or max(changes) >= 1.0
