"""Everything that is kept of people across runs, in one SQLite file (`database`) that several processes share.

The person manager keeps the records in it, the recognisers the templates of faces: so templates never travel over ROS.
`PersonStore` is that store; the file itself, and the thread that writes, are in `database`.
"""

from __future__ import annotations

import json
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import (
    Any,
    Callable,
    ContextManager,
    Dict,
    FrozenSet,
    Iterable,
    Iterator,
    List,
    Optional,
    Sequence,
    Set,
    Tuple,
    Union,
)

import numpy as np

from hri_pipeline.core.ids import IdGenerator, is_valid_id
from hri_pipeline.core.privacy import StoreError, TemplateCipher
from hri_pipeline.core.recognition.database import PersonDatabase, ReadOnlyDatabase
from hri_pipeline.core.recognition.stored_person import (
    CLOSED,
    COLUMNS,
    ENCRYPTED,
    KnownPerson,
    PersonRow,
    StoreClock,
    StoredPerson,
    as_json,
    by_person,
    is_of_another_network,
    judge_retention,
    read_person,
    template_fault,
)

_INSERT = "INSERT OR IGNORE INTO persons ({}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)".format(COLUMNS)


class PersonStore:
    """Records and templates. Safe from several threads, and from several processes that use this class.

    Parameters
    ----------
    path, notify, clock : see PersonDatabase, also for the errors.
    cipher : of templates, names, languages, demographics and times; None where they are not encrypted. What an earlier
        version has left in plain is encrypted at once.
    """

    def __init__(self, path: Union[str, Path], cipher: Optional[TemplateCipher] = None,
                 notify: Optional[Callable[[str], None]] = None, clock: Callable[[], float] = time.time) -> None:
        self._cipher = cipher
        self._is_checked, self._may_write = False, True
        self._clock = clock
        self._notify: Callable[[str], object] = notify or (lambda text: None)
        self._told: Set[Tuple[str, str]] = set()
        self.clock_problem = ""
        """Why nobody expires, by the last expire(); empty when people do."""
        self._database: Any = PersonDatabase(path, notify, clock)
        try:
            self._check_key()
            self._note_key()
            self._seal_plain()
        except BaseException:
            self._database.close()
            raise

    @property
    def path(self) -> Path:
        """The file."""
        return self._database.path

    def close(self) -> None:
        """Give the file back. May be called again."""
        self._database.close()

    def alone(self) -> ContextManager[bool]:
        """Tell whether no other process uses the store; none can begin to before the end of the block if that is
        so."""
        return self._database.alone()

    def load_records(self) -> List[StoredPerson]:
        """Return everybody, in the order of ids. What is broken of somebody is set aside, and told."""
        return list(self._load_people().values())

    @contextmanager
    def change(self) -> Iterator[None]:
        """Make one change of what is read and written inside of it: all of it is kept, or nothing, and no other process
        writes meanwhile. Who is removed inside of it leaves traces until erase_traces().
        """
        with self._database.writing():
            yield

    def put_record(self, person: StoredPerson, is_new: bool = True) -> bool:
        """Write all of a person but the templates. Raises ValueError for a malformed id.

        is_new: False for somebody who was in the store: who was forgotten since then is not written, and False
        returned.
        """
        if not is_valid_id(person.id) or (person.alias and not is_valid_id(person.alias)):
            raise ValueError("{!r} or its alias {!r} is no identifier".format(person.id, person.alias))
        with self._database.writing() as database:
            if is_new:
                database.execute(_INSERT, self._row_of(StoredPerson(person.id)))
            rows = database.execute("UPDATE persons SET name = ?, native_language = ?, enrolled = ?, alias = ?,"
                                    " first_seen = ?, last_seen = ?, demographics = ?, sealed = ? WHERE id = ?",
                                    (*self._row_of(person)[1:], person.id))
            return rows.rowcount > 0

    def remove_record(self, person_id: str) -> None:
        """Remove a person and the templates without a trace; one that is not there is none."""
        with self._database.writing() as database:
            database.execute("DELETE FROM persons WHERE id = ?", (person_id,))
            self._database.has_traces = True
        self.erase_traces()

    def remove_all(self) -> None:
        """Remove everybody without a trace."""
        with self._database.writing() as database:
            database.execute("DELETE FROM persons")
            self._database.has_traces = True
        self.erase_traces()

    def erase_traces(self) -> None:
        """Erase what is left of persons who were removed; cheap when nothing is. Within change(): later."""
        if self._database.has_traces:
            self._database.erase()

    def expire(self, now: float, max_age: float, max_persons: int, is_synchronised: bool = False) -> List[str]:
        """Remove who was not seen for `max_age` (s; 0: no limit), and of more than `max_persons` (0: no limit) those
        who were not seen for the longest time, without a trace; returns their ids. Of too many, those who have a name
        or a language, or have agreed, go last. Nobody goes by a clock that has jumped (`judge_retention`), unless the
        system says that it is right; `clock_problem` tells.
        """
        with self._database.writing() as database:
            people = {person.id: person for person in self.load_records()}
            told = {one.id for one in people.values() if one.name or one.native_language or one.enrolled}
            told |= {one.alias for one in people.values() if one.id in told}
            told |= {one.id for one in people.values() if one.alias in told and one.alias}    # the same human
            verdict = judge_retention({name: person.last_seen for name, person in people.items()}, self._load_clock(),
                                      now, max_age, max_persons, is_synchronised, told)
            for name in verdict.redated:
                self.put_record(replace(people[name], last_seen=now), is_new=False)
            database.executemany("DELETE FROM persons WHERE id = ?", [(name,) for name in verdict.gone])
            self._put_clock(verdict.clock)
            self._database.has_traces |= bool(verdict.gone)
        self.clock_problem = verdict.problem
        self.erase_traces()
        return verdict.gone

    def _load_clock(self) -> Optional[StoreClock]:
        with self._database.reading() as database:
            row = database.execute("SELECT value FROM facts WHERE name = 'clock'").fetchone()
        try:
            text = str(row[0]) if row is not None else ""
            return StoreClock.from_json(text if self._cipher is None else self._cipher.decrypt(text.encode()).decode())
        except ValueError:
            return None

    def _put_clock(self, clock: StoreClock) -> None:
        text = clock.to_json()
        with self._database.writing() as database:
            database.execute("INSERT OR REPLACE INTO facts VALUES ('clock', ?)", (
                text if self._cipher is None else self._cipher.encrypt(text.encode()).decode(),))

    def load_templates(self, model: str, dimension: int) -> List[KnownPerson]:
        """Return those who have templates (K, dimension) of a network. Broken templates are set aside, and told."""
        self._check_cipher()
        people = self._load_people()
        with self._database.reading() as database:
            rows = database.execute("SELECT person, number, template FROM templates WHERE model = ?"
                                    " ORDER BY person, number", (model,)).fetchall()
        if self._may_write and any(row[0] not in people for row in rows):
            self._settle_orphans([])
            self.erase_traces()
        found: Dict[str, List[np.ndarray]] = {}
        broken: List[Tuple[str, int, Any, str]] = []
        for person_id, number, blob in rows:
            content, fault = self._unpacked(blob, dimension)
            if person_id not in people:
                continue
            if fault:
                broken.append((person_id, number, blob, fault))
            else:
                found.setdefault(person_id, []).append(np.frombuffer(content, dtype="<f4").astype(np.float32))
        if broken:
            self._set_templates_aside(model, broken, bool(found))
        ordered = sorted((people[name] for name in found), key=lambda one: (one.first_seen, one.id))
        return [KnownPerson(one.id, np.stack(found[one.id]), one.enrolled) for one in ordered]

    def put_templates(self, person: KnownPerson, model: str, now: float, is_new: bool = True) -> bool:
        """Write the templates of a person, instead of those before; `now` (s): first seen, for somebody new.

        is_new: as in put_record.
        """
        self._check_cipher()
        blobs = [np.asarray(template, dtype="<f4").tobytes() for template in person.templates]
        if self._cipher is not None:
            blobs = [self._cipher.encrypt(blob) for blob in blobs]
        with self._database.writing() as database:
            if is_new:
                database.execute(_INSERT, self._row_of(StoredPerson(
                    person.id, enrolled=person.enrolled, first_seen=now, last_seen=now)))
            rows = database.execute("UPDATE persons SET enrolled = ? WHERE id = ?", (int(person.enrolled), person.id))
            if rows.rowcount > 0:
                database.execute("DELETE FROM templates WHERE person = ? AND model = ?", (person.id, model))
                database.executemany("INSERT INTO templates VALUES (?, ?, ?, ?)",
                                     [(person.id, model, number, blob) for number, blob in enumerate(blobs)])
            return rows.rowcount > 0

    def load_apart(self) -> Set[FrozenSet[str]]:
        """Return the pairs of ids of persons who are two people for certain."""
        with self._database.reading() as database:
            return {frozenset(row) for row in database.execute("SELECT first, second FROM apart").fetchall()}

    def put_apart(self, new: Iterable[FrozenSet[str]], gone: Iterable[FrozenSet[str]] = ()) -> None:
        """Add pairs of ids of persons who are two people, where both are in the store, and remove others."""
        with self._database.writing() as database:
            for first, second in map(sorted, gone):
                database.execute("DELETE FROM apart WHERE first = ? AND second = ?", (first, second))
            for first, second in map(sorted, new):
                database.execute("INSERT OR IGNORE INTO apart SELECT a.id, b.id FROM persons a, persons b"
                                 " WHERE a.id = ? AND b.id = ?", (first, second))

    def note_once(self, name: str) -> bool:
        """Note that something was done; False where that was noted before."""
        with self._database.writing() as database:
            return database.execute("INSERT OR IGNORE INTO facts VALUES (?, 'done')", (name,)).rowcount > 0

    def version(self) -> int:
        """See PersonDatabase."""
        return self._database.version()

    def damaged_files(self) -> List[Path]:
        """Return the damaged files that were set aside."""
        return self._database.damaged_files()

    def _row_of(self, person: StoredPerson) -> Tuple[object, ...]:
        """The values of COLUMNS: with a key, what tells who somebody is stands in the last one only."""
        told = (person.name, person.native_language, float(person.first_seen), float(person.last_seen),
                dict(person.demographics))
        if self._cipher is None:
            name, language, first, last, demographics = told
            return (person.id, name, language, int(person.enrolled), person.alias, first, last,
                    json.dumps(demographics), None)
        return (person.id, "", "", int(person.enrolled), person.alias, 0.0, 0.0, "{}",
                self._cipher.encrypt(json.dumps(told).encode("utf-8")))

    def _load_people(self) -> Dict[str, StoredPerson]:
        """Everybody by id, in the order of ids. StoreError without the key, or with another one."""
        rows = self._read_rows()
        if self._may_write and any(read.faults for _, read in rows):
            with self._database.writing():
                self._give_ids()
                rows = self._read_rows()        # another process may have been faster
                for row, read in rows:
                    if read.faults:
                        self._set_aside(read.person.id, row)
                        self.put_record(read.person, is_new=False)
        self._tell([(str(read.person.id), fault) for _, read in rows for fault in read.faults])
        return {read.person.id: read.person for _, read in rows if is_valid_id(read.person.id)}

    def _read_rows(self) -> List[Tuple[Sequence[Any], PersonRow]]:
        with self._database.reading() as database:
            rows = database.execute("SELECT {} FROM persons ORDER BY id".format(COLUMNS)).fetchall()
        if self._cipher is None and any(row[-1] is not None for row in rows):
            raise self._keyless()
        decrypt, now = self._cipher.decrypt if self._cipher is not None else None, self._clock()
        read = [(row, read_person(row, decrypt, now)) for row in rows]
        sealed = [one for row, one in read if row[-1] is not None]
        if sealed and all(ENCRYPTED in one.faults for one in sealed) and not self._is_own_key():
            raise StoreError("{}: what is known of {} cannot be opened; give the key it was written with".format(
                self.path, repr(sealed[0].person.id)[:40]))
        return read

    def _give_ids(self) -> None:
        """Give whoever has no legal id a new one, with all that is known; of the old one nothing else can be told, and
        nobody could be asked to be forgotten by it."""
        with self._database.writing() as database:
            ids = [row[0] for row in database.execute("SELECT id FROM persons").fetchall()]
            given_ids: List[str] = []
            for person_id in (one for one in ids if not is_valid_id(one)):
                new = next(name for name in iter(IdGenerator().new, None) if name not in ids)
                # Text that is no UTF-8 has surrogates, which SQLite does not take back.
                is_text = isinstance(person_id, str)
                old = person_id.encode("utf-8", "surrogateescape") if is_text else person_id
                given = "CAST(? AS TEXT)" if is_text else "?"
                database.execute("INSERT INTO persons SELECT ?, {} FROM persons WHERE id = {}".format(
                    COLUMNS.partition(", ")[2], given), (new, old))
                for table, column in self._references():
                    database.execute("UPDATE {0} SET {1} = ? WHERE {1} = {2}".format(table, column, given), (new, old))
                database.execute("DELETE FROM persons WHERE id = {}".format(given), (old,))
                self._database.has_traces = True
                self._notify("{}: the id {} of a person is none, as of a row that was damaged, and is {} now; all that "
                             "is known of the person is kept".format(self.path, repr(person_id)[:40], new))
                given_ids.append(new)
            self._settle_orphans(given_ids)

    def _settle_orphans(self, given: Sequence[str]) -> None:
        """Give templates of an id that nobody has to the one person who has just got a new id; where that is not sure,
        remove them, as nobody could be asked to be forgotten by them."""
        alone = "{} NOT IN (SELECT id FROM persons)"
        with self._database.writing() as database:
            lost = database.execute("SELECT DISTINCT person FROM templates WHERE " + alone.format("person")).fetchall()
            has_own = database.execute("SELECT 1 FROM templates WHERE person = ?", (given or [""])[:1]).fetchone()
            if len(lost) == len(given) == 1 and not has_own:
                for table, column in self._references():
                    database.execute("UPDATE {} SET {} = ? WHERE {}".format(table, column, alone.format(column)), given)
            elif lost:
                database.execute("DELETE FROM templates WHERE " + alone.format("person"))
                self._database.has_traces = True
                self._notify("{}: templates of an id that nobody has are removed, as of rows that were damaged; enrol "
                             "who is not recognised any more".format(self.path))
            # The ids of a pair stand in their order.
            database.execute("UPDATE OR REPLACE apart SET first = second, second = first WHERE first > second")

    def _references(self) -> List[Tuple[str, str]]:
        """The tables and columns that name persons."""
        named = [("templates", "person"), ("apart", "first"), ("apart", "second")]
        with self._database.reading() as database:
            is_there = database.execute("SELECT name FROM sqlite_master WHERE name = 'damaged'").fetchone()
        return named + ([("damaged", "person")] if is_there else [])

    def _set_aside(self, person_id: str, content: Sequence[Any]) -> None:
        """Keep what is broken of a person in a table of its own, from which it goes with the person."""
        with self._database.writing() as database:
            database.execute("CREATE TABLE IF NOT EXISTS damaged (person TEXT NOT NULL REFERENCES persons (id)"
                             " ON DELETE CASCADE, content BLOB NOT NULL)")
            written = as_json(content)
            database.execute("INSERT INTO damaged VALUES (?, ?)", (
                person_id, written if self._cipher is None else self._cipher.encrypt(written)))

    def _tell(self, faults: Sequence[Tuple[str, str]]) -> None:
        """Say what is broken of whom; once for each."""
        for person_id, what in by_person([fault for fault in faults if fault not in self._told]).items():
            self._told.update((person_id, one) for one in what)
            remedy = "Give it anew (people name, people enrol), or people forget {}".format(repr(person_id)[:40])
            self._notify("{}: of the person {}, {} cannot be used and {}; all else is kept. {}".format(
                self.path, repr(person_id)[:40], ", ".join(what),
                "was set aside" if self._may_write else "is left out",
                remedy if self._may_write else "Where it is written that is mended"))

    def _set_templates_aside(self, model: str, broken: Sequence[Tuple[str, int, Any, str]], are_others: bool) -> None:
        """Keep broken templates apart. StoreError where all are, as by another key or network."""
        person_id, _, _, fault = broken[0]
        contents = [] if are_others else [self._unpacked(blob, 0)[0] for _, _, blob, _ in broken]
        if is_of_another_network(contents) or (CLOSED in fault and not self._is_own_key()):
            raise StoreError("{}: a template of {} {}; give the key it was written with, or forget that person".format(
                self.path, person_id, fault))
        if self._may_write:
            with self._database.writing() as database:
                for name, number, blob, _ in broken:
                    gone = database.execute("DELETE FROM templates WHERE person = ? AND model = ? AND number = ? AND"
                                            " template = ?", (name, model, number, blob))
                    if gone.rowcount > 0:
                        self._set_aside(name, (name, model, number, blob))
        self._tell([(name, "a template that " + fault) for name, _, _, fault in broken])

    def _keyless(self) -> StoreError:
        return StoreError("what {} knows of people is encrypted; give the key (store_key) it was made with, or name "
                          "another file".format(self.path))

    def _is_own_key(self) -> bool:
        """Tell whether the store was written with this key: by the mark of that, in a store of an earlier version by
        anything that it opens."""
        with self._database.reading() as database:
            found = database.execute("SELECT value FROM facts WHERE name = 'key'").fetchall()
            found += database.execute("SELECT sealed FROM persons WHERE sealed IS NOT NULL").fetchall()
            found += database.execute("SELECT template FROM templates").fetchall()
        return self._cipher is None or any(not self._opened(row[0])[1] for row in found)

    def _note_key(self) -> None:
        """Mark the store as written with this key, where it is, or where nothing is encrypted in it."""
        if self._cipher is None:
            return
        with self._database.writing() as database:
            mark = database.execute("SELECT value FROM facts WHERE name = 'key'").fetchone()
            is_empty = not database.execute("SELECT 1 FROM persons WHERE sealed IS NOT NULL UNION ALL"
                                            " SELECT 1 FROM templates LIMIT 1").fetchone()
            is_marked = mark is not None and not self._opened(mark[0])[1]
            if not is_marked and (is_empty or self._is_own_key()):
                database.execute("INSERT OR REPLACE INTO facts VALUES ('key', ?)", (
                    self._cipher.encrypt(b"key").decode(),))

    def _opened(self, content: Any) -> Tuple[bytes, str]:
        """The bytes that were encrypted, or that are as they are without a key, and what is wrong with them."""
        try:
            token = content.encode() if isinstance(content, str) else content   # older cryptography takes no text
            return bytes(token) if self._cipher is None else self._cipher.decrypt(token), ""
        except (TypeError, ValueError) as error:
            return b"", "{} ({})".format(CLOSED, error)

    def _check_key(self) -> None:
        """Refuse a store of encrypted templates without the key, also where the records are in plain, as in the first
        two schemas."""
        with self._database.reading() as database:
            found = database.execute("SELECT value FROM facts WHERE name = 'templates'").fetchone()
        if self._cipher is None and found is not None and found[0] != "plain":
            raise self._keyless()

    def _seal_plain(self) -> None:
        """Encrypt what an earlier version, or a process without the key, has written in plain."""
        if self._cipher is None:
            return
        with self._database.writing() as database:
            plain = {row[0] for row in database.execute("SELECT id FROM persons WHERE sealed IS NULL")}
            if plain and self._has_closed_templates():
                raise StoreError("{}: the templates cannot be opened; give the key they were written with".format(
                    self.path))
            for person in self._load_people().values():
                if person.id in plain:
                    self.put_record(person, is_new=False)
            self._seal_damaged()
            clocks = database.execute("DELETE FROM facts WHERE name = 'clock' AND value LIKE '[%'").rowcount
            self._database.has_traces |= bool(plain or clocks)
        self.erase_traces()

    def _has_closed_templates(self) -> bool:
        """Tell whether there are encrypted templates, and the key is not that of the store."""
        with self._database.reading() as database:
            found = database.execute("SELECT 1 FROM templates, facts WHERE name = 'templates' AND value != 'plain'"
                                     " LIMIT 1").fetchone()
        return found is not None and not self._is_own_key()

    def _seal_damaged(self) -> None:
        with self._database.writing() as database:
            if not database.execute("SELECT name FROM sqlite_master WHERE name = 'damaged'").fetchone():
                return
            for (content,) in database.execute("SELECT content FROM damaged").fetchall():
                if content.startswith(b"[") and self._cipher is not None:       # no token of a cipher does
                    database.execute("UPDATE damaged SET content = ? WHERE content = ?",
                                     (self._cipher.encrypt(content), content))

    def _unpacked(self, blob: Any, dimension: int) -> Tuple[bytes, str]:
        """The bytes of a template, and what is wrong with them."""
        if not isinstance(blob, bytes):
            return b"", "is none"
        content, fault = self._opened(blob)
        return content, fault or template_fault(content, dimension)

    def _check_cipher(self) -> None:
        """See that the templates are read and written as those before."""
        if self._is_checked:
            return
        name = self._cipher.name if self._cipher is not None else "plain"
        with self._database.writing() as database:
            database.execute("INSERT OR IGNORE INTO facts VALUES ('templates', ?)", (name,))
            found = database.execute("SELECT value FROM facts WHERE name = 'templates'").fetchone()[0]
        if found != name:
            raise StoreError("the templates in {} are {}, and shall be {}; give the key (or none) it was made with, or "
                             "name another file".format(self.path, found, name))
        self._is_checked = True


def read_store(path: Union[str, Path], cipher: Optional[TemplateCipher] = None, model: str = "", dimension: int = 0,
               notify: Callable[[str], object] = lambda text: None) -> Tuple[List[StoredPerson], List[KnownPerson]]:
    """Return what a store of others tells: all records, and the templates (K, dimension) of a network.

    model: empty for no templates. notify: called with one line about what is broken, and left out. Raises StoreError;
    nothing is written, not even a lock.
    """
    store = PersonStore.__new__(PersonStore)
    store._database, store._is_checked = ReadOnlyDatabase(Path(path).expanduser().absolute()), True
    store._may_write, store._clock, store._notify, store._told = False, time.time, notify, set()
    try:
        with store._database.reading() as database:
            found = database.execute("SELECT value FROM facts WHERE name = 'templates'").fetchone()
        store._cipher = None if found is not None and found[0] == "plain" else cipher
        store._check_key()
        return store.load_records(), store.load_templates(model, dimension) if model else []
    finally:
        store._database.close()
