"""The SQLite file of people, which several processes share: opened, migrated, locked, checked, erased;
and the thread that writes (`StoreWriter`), so that nobody who sees, hears or decides waits for a disk.

Write-ahead log and full synchronisation: whoever is killed at any moment leaves all of a change or nothing of it.
Forgetting rewrites the file and empties its journal, so that nothing of the person is left in either.
"""

from __future__ import annotations

import fcntl
import os
import sqlite3
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, Iterator, List, Optional, Tuple, Union

from hri_pipeline.core.privacy import DAMAGED, StoreError, files_beside, make_private_directory, set_aside, wipe

APPLICATION_ID = 0x52344850
"""Tells the file from the databases of other programs."""
MIGRATIONS: Tuple[Tuple[str, ...], ...] = (
    ("CREATE TABLE persons (id TEXT PRIMARY KEY, name TEXT NOT NULL, native_language TEXT NOT NULL,"
     " enrolled INTEGER NOT NULL, alias TEXT NOT NULL, first_seen REAL NOT NULL, last_seen REAL NOT NULL,"
     " demographics TEXT NOT NULL) WITHOUT ROWID",
     "CREATE TABLE templates (person TEXT NOT NULL REFERENCES persons (id) ON DELETE CASCADE, model TEXT NOT NULL,"
     " number INTEGER NOT NULL, template BLOB NOT NULL, PRIMARY KEY (person, model, number)) WITHOUT ROWID",
     "CREATE TABLE facts (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID"),
    ("CREATE TABLE apart (first TEXT NOT NULL REFERENCES persons (id) ON DELETE CASCADE,"
     " second TEXT NOT NULL REFERENCES persons (id) ON DELETE CASCADE, PRIMARY KEY (first, second)) WITHOUT ROWID",),
    # With a key: name, language, demographics and times, encrypted; then the columns of these are empty.
    ("ALTER TABLE persons ADD COLUMN sealed BLOB",),
)
"""The statements that lead from each version of the schema to the next."""
_MARK = "abs(random() / 2)"
_MARKED = ("INSERT OR IGNORE INTO facts VALUES ('people', {})".format(_MARK), *(
    "CREATE TRIGGER IF NOT EXISTS {0}_{1} AFTER {1} ON {0}{2}"
    " BEGIN UPDATE facts SET value = {3} WHERE name = 'people'; END".format(table, event, (
        " WHEN OLD.id IS NOT NEW.id OR OLD.enrolled IS NOT NEW.enrolled" if (table, event) == ("persons", "UPDATE")
        else ""), _MARK) for table in ("persons", "templates", "apart") for event in ("INSERT", "DELETE", "UPDATE")))
"""What marks all changes of people but those of their records, whoever makes them; files of all schemas have it. By
chance, not by a count: that of another file, as of a backup that is restored, may be the same."""
_BUSY_S = 5.0      # longest wait for another process that writes
_PAUSE_S = 0.02
_JOURNALS = ("-wal", "-shm", "-journal")
PERIOD_S, RETRY_S = 1.0, 1.0
WAIT_S, CLOSE_S = 30.0, 8.0
"""Times (s) of the StoreWriter: between two writings, after one that failed; for who waits, at the end."""


class PersonDatabase:
    """The file, with the newest schema. Safe from several threads, and from several processes that use this class.

    Parameters
    ----------
    path : made where there is no such file, mode 0600 in a directory of mode 0700.
    notify : called with one line about a damaged file, which is set aside.
    clock : time (s), for the name of a damaged file.

    Raises
    ------
    StoreError
        The file cannot be used, here and in every method; the text names the file and what to do.
    """

    def __init__(self, path: Union[str, Path], notify: Optional[Callable[[str], None]] = None,
                 clock: Callable[[], float] = time.time) -> None:
        self.path = Path(path).expanduser().absolute()
        self.has_traces = False
        """Something was deleted that erase() has not removed yet."""
        self._clock = clock
        self._notify = notify or (lambda text: None)
        self._lock = threading.RLock()
        self._connection: Optional[sqlite3.Connection] = None
        self._file: Optional[os.stat_result] = None
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

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Give the connection. Errors of SQLite become StoreErrors."""
        with self._lock:
            if self._connection is None:
                raise StoreError("{} is closed".format(self.path))
            if not self._is_there():
                raise StoreError("{} was removed or replaced while it is used, and nothing is kept since; put it back, "
                                 "or end all nodes that use it before they are started anew".format(self.path))
            try:
                yield self._connection
            except sqlite3.Error as error:
                raise StoreError("{} cannot be used ({}); make room, correct its permissions, or set it aside".format(
                    self.path, error)) from error

    def _is_there(self) -> bool:
        """Tell whether the file that is used can be found: SQLite goes on writing where nobody will ever read."""
        try:
            return self._file is not None and os.path.samestat(self._file, os.stat(str(self.path)))
        except OSError:
            return False

    @contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """Give the connection for one change: all of it is kept, or nothing. One inside of another is a part of it."""
        with self.reading() as database:
            if database.in_transaction:
                yield database
                return
            database.execute("BEGIN IMMEDIATE")
            try:
                yield database
                database.execute("COMMIT")
            except BaseException:
                if database.in_transaction:
                    database.execute("ROLLBACK")
                raise

    def version(self) -> int:
        """Return a number that changes with who is known, templates, consents and pairs, whichever process changes
        them; not with what else records say, as that somebody was seen, which is written all the time."""
        with self.reading() as database:
            found = database.execute("SELECT CAST(value AS INTEGER) FROM facts WHERE name = 'people'").fetchone()
            if found is None:       # damaged, or an older file was restored: what has changed is not known
                self._mark_changes()
                return -1
            return int(found[0])

    def erase(self) -> None:
        """Rewrite the file without what was deleted, and empty its journal. Damaged files go too: who is in them cannot
        be told. Inside of writing() that is left to a later call."""
        self.has_traces = True    # until it has been done: a full disk may prevent it
        with self.reading() as database:
            if database.in_transaction:
                return
            database.execute("VACUUM")
            self._empty_journal(database)
        for path in self.damaged_files():
            wipe(path)
        self.has_traces = False

    def _empty_journal(self, database: sqlite3.Connection) -> None:
        # SQLite does not wait for another process that empties the journal at the same time.
        end = time.monotonic() + _BUSY_S
        while database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]:
            if time.monotonic() >= end:
                raise StoreError("{}: the journal could not be emptied while another process reads; forget "
                                 "again".format(self.path))
            time.sleep(_PAUSE_S)

    def damaged_files(self) -> List[Path]:
        """Return the damaged files that were set aside."""
        return files_beside(self.path, DAMAGED)

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
        if reason or not self.path.exists():
            # Set aside by this process, or by another one while this one looked at it.
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
        with self.alone() as is_alone:
            for file in [Path(str(self.path) + ending) for ending in ("", *_JOURNALS)]:
                if is_alone and file.exists():
                    file.unlink()

    def _damage(self) -> str:
        """Return what is wrong with the file, empty when nothing is. StoreError for what is not ours to judge."""
        # SQLite takes a file of some bytes for a new one, and reads zeros beyond the end of one that is cut off.
        size, is_journal = self.path.stat().st_size, Path(str(self.path) + "-wal").exists()
        if size % _page_size(self.path):
            return "it is cut off"
        if size == 0 and not is_journal:
            with self.alone() as is_alone:
                if is_alone:
                    return "it is empty"
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
        with self.alone() as is_alone:
            if not is_alone:
                raise StoreError("{} is damaged ({}), and another process holds it; end that one".format(
                    self.path, reason))
            target = set_aside(self.path, self._clock(), [Path(str(self.path) + ending) for ending in _JOURNALS])
        self._notify("the store of people {} is damaged ({}); it is kept as {}, and nobody is known".format(
            self.path, reason, target))

    @contextmanager
    def alone(self) -> Iterator[bool]:
        """Tell whether no other process holds the store; none can open it before the end of the block if that is so."""
        assert self._held is not None
        try:
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_alone = True
        except OSError:
            is_alone = False
            # Linux gives the shared lock up before it refuses the other one.
            fcntl.flock(self._held, fcntl.LOCK_SH)
        try:
            yield is_alone
        finally:
            if is_alone:
                fcntl.flock(self._held, fcntl.LOCK_SH)

    def _connect(self) -> None:
        self._connection = sqlite3.connect(str(self.path), timeout=_BUSY_S, isolation_level=None,
                                           check_same_thread=False)
        self._connection.text_factory = _text
        self._file = os.stat(str(self.path))
        for line in ("journal_mode = WAL", "synchronous = FULL", "secure_delete = ON", "foreign_keys = ON",
                     "temp_store = MEMORY", "trusted_schema = OFF"):
            self._connection.execute("PRAGMA " + line).fetchall()

    def _migrate(self) -> None:
        with self.writing() as database:
            version = int(database.execute("PRAGMA user_version").fetchone()[0])
            if version > len(MIGRATIONS):
                raise StoreError("{} has the schema {}, newer than this program's {}; use the newer program, or "
                                 "another file".format(self.path, version, len(MIGRATIONS)))
            for statements in MIGRATIONS[version:]:
                for statement in statements:
                    database.execute(statement)
            self._mark_changes()
            database.execute("PRAGMA user_version = {}".format(len(MIGRATIONS)))
            database.execute("PRAGMA application_id = {}".format(APPLICATION_ID))

    def _mark_changes(self) -> None:
        with self.writing() as database:
            for statement in _MARKED:
                database.execute(statement)


def _share(path: Path) -> int:
    """Hold a shared lock on a store; returns the descriptor. Raises StoreError."""
    lock = path.parent / (path.name + ".lock")
    try:
        descriptor = os.open(str(lock), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH)
        except BaseException:
            os.close(descriptor)
            raise
        return descriptor
    except OSError as error:
        raise StoreError("the lock {} cannot be made ({}); correct the permissions of its directory".format(
            lock, error)) from error


def _text(content: bytes) -> str:
    """The text of a column; what is no UTF-8, as in a damaged row, becomes surrogates."""
    return content.decode("utf-8", "surrogateescape")


def _page_size(path: Path) -> int:
    """Size of a page (bytes) by the file's header, which stands in bytes 16 and 17; the least there is without one."""
    with open(str(path), "rb") as file:
        header = file.read(18)
    size = int.from_bytes(header[16:18], "big") if header.startswith(b"SQLite format 3\0") else 512
    return 65536 if size == 1 else max(512, size)


class ReadOnlyDatabase:
    """A file that is only read: nothing is made beside it, and a medium without write access will do."""

    def __init__(self, path: Path) -> None:
        self.path = path
        is_used = Path(str(path) + "-wal").exists() and Path(str(path) + "-wal").stat().st_size > 0
        how = "mode=ro" if is_used else "immutable=1"
        try:
            self._connection = sqlite3.connect("{}?{}".format(path.as_uri(), how), uri=True, timeout=_BUSY_S,
                                               check_same_thread=False)
            self._connection.text_factory = _text
            owner, version = (int(self._connection.execute("PRAGMA " + name).fetchone()[0])
                              for name in ("application_id", "user_version"))
        except sqlite3.Error as error:
            raise StoreError("the read-only store {} cannot be read ({})".format(path, error)) from error
        if owner != APPLICATION_ID or version != len(MIGRATIONS):
            self.close()
            raise StoreError("the read-only store {} is {}".format(path, "no store of people" if owner != APPLICATION_ID
                             else "of another version; let this program use it once as its own"))

    def close(self) -> None:
        """Let go of the file."""
        self._connection.close()

    @contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """Give the connection. Errors of SQLite become StoreErrors."""
        try:
            yield self._connection
        except sqlite3.Error as error:
            raise StoreError("the read-only store {} cannot be read ({})".format(self.path, error)) from error


class StoreWriter:
    """Calls `write` in a thread of its own: periodically, at once when somebody waits, and once more at the end.

    `problem` says why something is not written; it is empty when all is.

    Parameters
    ----------
    write : puts on the disk all that has changed, in order, and is cheap when nothing has. Where it raises, its owner
        keeps what was not written, and the next call tries again.
    period : time (s) between two calls.
    notify : called with one line each time that `write` raises.
    """

    def __init__(self, write: Callable[[], object], period: float = PERIOD_S,
                 notify: Callable[[str], object] = lambda text: None) -> None:
        self.problem = ""
        self._write, self._period, self._notify = write, period, notify
        self._state = threading.Condition()
        self._is_asked = self._is_closing = False
        self._begun = self._ended = 0     # how many calls of write()
        self._thread = threading.Thread(target=self._run, name="store writer", daemon=True)
        self._thread.start()

    def wait(self, patience: float = WAIT_S) -> None:
        """Return when all that was changed before is on the disk.

        Raises StoreError when it is not within `patience` (s).
        """
        with self._state:
            wanted = self._begun + 1    # a call that has begun already may have missed the change
            self._is_asked = True
            self._state.notify_all()
            self._state.wait_for(lambda: self._ended >= wanted or not self._thread.is_alive(), patience)
            if self._ended < wanted:
                raise StoreError("the store is closed" if self._is_closing else "not written after {:.0f} s; another "
                                 "process holds the store, or the disk is busy: it is tried again".format(patience))
            if self.problem:
                raise StoreError(self.problem)

    def close(self, patience: float = CLOSE_S) -> str:
        """Write what is left and end the thread; returns why something is not written, empty when all is.

        May be called again. patience: s for which a write that is under way is waited for.
        """
        with self._state:
            self._is_closing = True
            self._state.notify_all()
        self._thread.join(patience)
        if self._thread.is_alive():
            return "not written after {:.0f} s; another process holds the store, or the disk is busy".format(patience)
        return self.problem

    def _run(self) -> None:
        is_last = False
        while not is_last:
            with self._state:
                self._state.wait_for(lambda: self._is_asked or self._is_closing, self._period)
                self._is_asked, is_last = False, self._is_closing
                self._begun += 1
            problem = self._attempt()
            with self._state:
                self._ended, self.problem = self._begun, problem
                self._state.notify_all()
                if problem:
                    self._state.wait_for(lambda: self._is_closing, RETRY_S)

    def _attempt(self) -> str:
        try:
            self._write()
            return ""
        except Exception as error:  # a full disk must not end the thread: the next second may be better
            text = str(error) or type(error).__name__
            self._notify(text)
            return text
