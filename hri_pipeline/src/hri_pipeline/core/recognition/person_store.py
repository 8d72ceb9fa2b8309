"""Everything that is kept of people across runs, in one SQLite file that several processes share.

The person manager keeps the records in it, the recognisers the templates of faces: so templates never travel over ROS.
Write-ahead log and full synchronisation: whoever is killed at any moment leaves all of a change or nothing of it.
Forgetting rewrites the file and empties its journal, so that nothing of the person is left in either.
"""

from __future__ import annotations

import fcntl
import json
import os
import sqlite3
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.private_file import DAMAGED, StoreError, Transform, make_private_directory, set_aside, wipe
from hri_pipeline.core.recognition.gallery import KnownPerson
from hri_pipeline.core.recognition.person_schema import APPLICATION_ID, MIGRATIONS, StoredPerson

_BUSY_S = 10.0
_JOURNALS = ("-wal", "-shm", "-journal")


class PersonStore:
    """The file. Safe from several threads, and together with other processes that use it through this class.

    path: made where it is not there, mode 0600 in a directory of mode 0700; transform: what is done to the templates,
    such as encryption; notify: told in one line about a damaged file, which is set aside; clock: s, for its name.
    Raises StoreError that names the file and the mend, here and from every method when the file cannot be used.
    """

    def __init__(self, path: Union[str, Path], transform: Optional[Transform] = None,
                 notify: Optional[Callable[[str], None]] = None, clock: Callable[[], float] = time.time) -> None:
        self.path = Path(path).expanduser().absolute()
        self._transform, self._clock = transform, clock
        self._notify = notify or (lambda text: None)
        self._lock = threading.RLock()
        self._is_checked = False
        self._is_unerased = False
        self._connection: Optional[sqlite3.Connection] = None
        make_private_directory(self.path.parent)
        self._held: Optional[int] = _share(self.path)
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Give the file back. May be called again."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
                self._connection = None
            if self._held is not None:
                os.close(self._held)
                self._held = None

    def load_records(self) -> List[StoredPerson]:
        """Return everybody, in the order of ids."""
        with self._reading() as database:
            rows = database.execute("SELECT id, name, native_language, enrolled, alias, first_seen, last_seen,"
                                    " demographics FROM persons ORDER BY id").fetchall()
        return [StoredPerson(*row[:3], bool(row[3]), *row[4:7], json.loads(row[7])) for row in rows]

    def put_record(self, person: StoredPerson) -> None:
        """Write all of a person but the templates. Raises ValueError for a malformed id."""
        if not is_valid_id(person.id) or (person.alias and not is_valid_id(person.alias)):
            raise ValueError("{!r} or its alias {!r} is no identifier".format(person.id, person.alias))
        values = (person.name, person.native_language, int(person.enrolled), person.alias, float(person.first_seen),
                  float(person.last_seen), json.dumps(dict(person.demographics)), person.id)
        with self._writing() as database:
            database.execute("INSERT OR IGNORE INTO persons VALUES (?, '', '', 0, '', 0, 0, '{}')", (person.id,))
            database.execute("UPDATE persons SET name = ?, native_language = ?, enrolled = ?, alias = ?,"
                             " first_seen = ?, last_seen = ?, demographics = ? WHERE id = ?", values)

    def remove_record(self, person_id: str) -> None:
        """Remove a person and the templates without a trace; one that is not there is none."""
        with self._writing() as database:
            database.execute("DELETE FROM persons WHERE id = ?", (person_id,))
        self._erase()

    def remove_all(self) -> None:
        """Remove everybody without a trace."""
        with self._writing() as database:
            database.execute("DELETE FROM persons")
        self._erase()

    def expire(self, now: float, max_age: float, max_persons: int) -> List[str]:
        """Remove who was not seen for `max_age` (s; 0: no limit), and of more than `max_persons` (0: no limit) those
        who were not seen for the longest time, without a trace; returns their ids.
        """
        with self._writing() as database:
            rows = database.execute("SELECT id, last_seen FROM persons ORDER BY last_seen DESC, id").fetchall()
            gone = [name for number, (name, seen) in enumerate(rows)
                    if 0 < max_persons <= number or 0.0 < max_age < now - seen]
            database.executemany("DELETE FROM persons WHERE id = ?", [(name,) for name in gone])
        if gone or self._is_unerased:
            self._erase()
        return gone

    def load_templates(self, model: str, dimension: int) -> List[KnownPerson]:
        """Return those who have templates (K, dimension) of a network."""
        self._check_transform()
        with self._reading() as database:
            rows = database.execute(
                "SELECT person, enrolled, template FROM templates JOIN persons ON person = id WHERE model = ?"
                " ORDER BY first_seen, person, number", (model,)).fetchall()
        found: Dict[str, Tuple[bool, List[np.ndarray]]] = {}
        for name, enrolled, blob in rows:
            found.setdefault(name, (bool(enrolled), []))[1].append(self._unpacked(name, blob, dimension))
        return [KnownPerson(name, np.stack(templates), enrolled) for name, (enrolled, templates) in found.items()]

    def put_templates(self, person: KnownPerson, model: str, now: float) -> None:
        """Write the templates of a person, instead of those before; `now` (s): first seen, for somebody new."""
        self._check_transform()
        blobs = [np.asarray(template, dtype="<f4").tobytes() for template in person.templates]
        if self._transform is not None:
            blobs = [self._transform.pack(blob) for blob in blobs]
        with self._writing() as database:
            database.execute("INSERT OR IGNORE INTO persons VALUES (?, '', '', ?, '', ?, ?, '{}')",
                             (person.id, int(person.enrolled), now, now))
            database.execute("UPDATE persons SET enrolled = ? WHERE id = ?", (int(person.enrolled), person.id))
            database.execute("DELETE FROM templates WHERE person = ? AND model = ?", (person.id, model))
            database.executemany("INSERT INTO templates VALUES (?, ?, ?, ?)",
                                 [(person.id, model, number, blob) for number, blob in enumerate(blobs)])

    def version(self) -> int:
        """Return a number that changes when another process has changed the file."""
        with self._reading() as database:
            return int(database.execute("PRAGMA data_version").fetchone()[0])

    def damaged_files(self) -> List[Path]:
        """Return the damaged files that were set aside."""
        return sorted(self.path.parent.glob(self.path.name + DAMAGED + "*"))

    def _unpacked(self, name: str, blob: bytes, dimension: int) -> np.ndarray:
        try:
            content = blob if self._transform is None else self._transform.unpack(blob)
            template = np.frombuffer(content, dtype="<f4").astype(np.float32)
        except ValueError as error:
            raise StoreError("{}: a template of {} cannot be opened ({}); give the key it was written with".format(
                self.path, name, error)) from error
        if template.shape != (dimension,):
            raise StoreError("{}: a template of {} has {} numbers instead of {}; give the key it was written with, or "
                             "forget that person".format(self.path, name, template.size, dimension))
        return template

    def _open(self) -> None:
        if self.path.is_symlink():
            raise StoreError("{} is a link; name the file itself".format(self.path))
        try:
            os.close(os.open(str(self.path), os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600))
            is_new = True
        except FileExistsError:
            is_new = False
            os.chmod(str(self.path), 0o600)
        except OSError as error:
            raise StoreError("{} cannot be made ({}); correct the permissions".format(self.path, error)) from error
        reason = "" if is_new else self._damage()
        if reason:
            self._put_aside(reason)
            self._open()
            return
        try:
            self._connect()
            self._migrate()
        except (sqlite3.Error, StoreError) as error:
            if is_new:
                self._take_back()
            raise error if isinstance(error, StoreError) else StoreError(
                "{} cannot be used ({}); make room, or correct its permissions".format(self.path, error)) from error

    def _take_back(self) -> None:
        """Remove a new file in which nothing is: the next one who opens it would take it for a damaged one."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._is_alone():
            for file in [Path(str(self.path) + ending) for ending in ("", *_JOURNALS)]:
                if file.exists():
                    file.unlink()

    def _damage(self) -> str:
        """Return what is wrong with the file, empty when nothing is. StoreError for what is not ours to judge."""
        # SQLite takes a file of some bytes for a new one, and reads zeros beyond the end of one that is cut off.
        size, is_journal = self.path.stat().st_size, Path(str(self.path) + "-wal").exists()
        if size % _page_size(self.path) or (size == 0 and not is_journal and self._is_alone()):
            return "it is cut off" if size else "it is empty"
        try:
            self._connect()
            assert self._connection is not None
            found = self._connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
            owner = self._connection.execute("PRAGMA application_id").fetchone()[0]
        except sqlite3.OperationalError as error:
            raise StoreError("{} cannot be opened ({}); make room, correct its permissions, or end who holds it".format(
                self.path, error)) from error
        except sqlite3.DatabaseError as error:
            return str(error)
        finally:
            if self._connection is not None:
                self._connection.close()
                self._connection = None
        if found == "ok" and owner not in (0, APPLICATION_ID):
            raise StoreError("{} is a database of another program; name another file".format(self.path))
        return "" if found == "ok" else str(found).replace("\n", " ")[:200]

    def _put_aside(self, reason: str) -> None:
        if not self._is_alone():
            raise StoreError("{} is damaged ({}), and another process holds it; end that one".format(self.path, reason))
        target = set_aside(self.path, self._clock(), [Path(str(self.path) + ending) for ending in _JOURNALS])
        self._notify("the store of people {} is damaged ({}); it is kept as {}, and nobody is known".format(
            self.path, reason, target))

    def _is_alone(self) -> bool:
        """Tell whether no other process holds the store; none can open it until this one has."""
        assert self._held is not None
        try:
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        fcntl.flock(self._held, fcntl.LOCK_SH)
        return True

    def _connect(self) -> None:
        self._connection = sqlite3.connect(str(self.path), timeout=_BUSY_S, isolation_level=None,
                                           check_same_thread=False)
        for line in ("journal_mode = WAL", "synchronous = FULL", "secure_delete = ON", "foreign_keys = ON",
                     "temp_store = MEMORY", "trusted_schema = OFF"):
            self._connection.execute("PRAGMA " + line).fetchall()

    def _migrate(self) -> None:
        with self._writing() as database:
            version = int(database.execute("PRAGMA user_version").fetchone()[0])
            if version > len(MIGRATIONS):
                raise StoreError("{} has the schema {}, newer than this program's {}; use the newer program, or "
                                 "another file".format(self.path, version, len(MIGRATIONS)))
            for statements in MIGRATIONS[version:]:
                for statement in statements:
                    database.execute(statement)
            database.execute("PRAGMA user_version = {}".format(len(MIGRATIONS)))
            database.execute("PRAGMA application_id = {}".format(APPLICATION_ID))

    def _check_transform(self) -> None:
        """See that the templates are read and written as those before. Who uses records only needs no key."""
        if self._is_checked:
            return
        name = self._transform.name if self._transform is not None else "plain"
        with self._writing() as database:
            database.execute("INSERT OR IGNORE INTO facts VALUES ('templates', ?)", (name,))
            found = database.execute("SELECT value FROM facts WHERE name = 'templates'").fetchone()[0]
        if found != name:
            raise StoreError("the templates in {} are {}, and shall be {}; give the key (or none) it was made with, or "
                             "name another file".format(self.path, found, name))
        self._is_checked = True

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            if self._connection is None:
                raise StoreError("{} is closed".format(self.path))
            try:
                yield self._connection
            except sqlite3.Error as error:
                raise StoreError("{} cannot be used ({}); make room, correct its permissions, or set it aside".format(
                    self.path, error)) from error

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        with self._reading() as database:
            database.execute("BEGIN IMMEDIATE")
            try:
                yield database
                database.execute("COMMIT")
            except BaseException:
                if database.in_transaction:
                    database.execute("ROLLBACK")
                raise

    def _erase(self) -> None:
        """Rewrite the file without what was deleted, and empty its journal. Damaged files go too: who is in them cannot
        be told."""
        self._is_unerased = True    # until it has been done: a full disk may prevent it
        with self._reading() as database:
            database.execute("VACUUM")
            busy: Sequence[int] = database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
            if busy[0]:
                raise StoreError("{}: the journal could not be emptied while another process reads; forget "
                                 "again".format(self.path))
        for path in self.damaged_files():
            wipe(path)
        self._is_unerased = False


def _share(path: Path) -> int:
    """Hold a shared lock on a store; returns the descriptor. Raises StoreError."""
    lock = path.parent / (path.name + ".lock")
    try:
        descriptor = os.open(str(lock), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        fcntl.flock(descriptor, fcntl.LOCK_SH)
        return descriptor
    except OSError as error:
        raise StoreError("the lock {} cannot be made ({}); correct the permissions of its directory".format(
            lock, error)) from error


def _page_size(path: Path) -> int:
    """Size of a page (bytes) by the file's header, which stands in bytes 16 and 17; the least there is without one."""
    with open(str(path), "rb") as file:
        header = file.read(18)
    size = int.from_bytes(header[16:18], "big") if header.startswith(b"SQLite format 3\0") else 512
    return 65536 if size == 1 else max(512, size)
