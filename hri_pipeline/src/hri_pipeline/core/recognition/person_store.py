"""Everything that is kept of people across runs, in one SQLite file that several processes share.

The person manager keeps the records in it, the recognisers the templates of faces: so templates never travel over ROS.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Callable, Dict, List, Optional, Tuple, Union

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.private_file import StoreError, Transform
from hri_pipeline.core.recognition.gallery import KnownPerson
from hri_pipeline.core.recognition.person_database import PersonDatabase
from hri_pipeline.core.recognition.person_schema import StoredPerson


class PersonStore:
    """Records and templates. Safe from several threads, and together with other processes that use it through this class.

    transform: what is done to the templates, such as encryption. path, notify, clock, errors: see PersonDatabase.
    """

    def __init__(self, path: Union[str, Path], transform: Optional[Transform] = None,
                 notify: Optional[Callable[[str], None]] = None, clock: Callable[[], float] = time.time) -> None:
        self._transform = transform
        self._is_checked = False
        self._database = PersonDatabase(path, notify, clock)

    @property
    def path(self) -> Path:
        """The file."""
        return self._database.path

    def close(self) -> None:
        """Give the file back. May be called again."""
        self._database.close()

    def load_records(self) -> List[StoredPerson]:
        """Return everybody, in the order of ids."""
        with self._database.reading() as database:
            rows = database.execute("SELECT id, name, native_language, enrolled, alias, first_seen, last_seen,"
                                    " demographics FROM persons ORDER BY id").fetchall()
        return [StoredPerson(*row[:3], bool(row[3]), *row[4:7], json.loads(row[7])) for row in rows]

    def put_record(self, person: StoredPerson) -> None:
        """Write all of a person but the templates. Raises ValueError for a malformed id."""
        if not is_valid_id(person.id) or (person.alias and not is_valid_id(person.alias)):
            raise ValueError("{!r} or its alias {!r} is no identifier".format(person.id, person.alias))
        values = (person.name, person.native_language, int(person.enrolled), person.alias, float(person.first_seen),
                  float(person.last_seen), json.dumps(dict(person.demographics)), person.id)
        with self._database.writing() as database:
            database.execute("INSERT OR IGNORE INTO persons VALUES (?, '', '', 0, '', 0, 0, '{}')", (person.id,))
            database.execute("UPDATE persons SET name = ?, native_language = ?, enrolled = ?, alias = ?,"
                             " first_seen = ?, last_seen = ?, demographics = ? WHERE id = ?", values)

    def remove_record(self, person_id: str) -> None:
        """Remove a person and the templates without a trace; one that is not there is none."""
        with self._database.writing() as database:
            database.execute("DELETE FROM persons WHERE id = ?", (person_id,))
        self._database.erase()

    def remove_all(self) -> None:
        """Remove everybody without a trace."""
        with self._database.writing() as database:
            database.execute("DELETE FROM persons")
        self._database.erase()

    def expire(self, now: float, max_age: float, max_persons: int) -> List[str]:
        """Remove who was not seen for `max_age` (s; 0: no limit), and of more than `max_persons` (0: no limit) those
        who were not seen for the longest time, without a trace; returns their ids.
        """
        with self._database.writing() as database:
            rows = database.execute("SELECT id, last_seen FROM persons ORDER BY last_seen DESC, id").fetchall()
            gone = [name for number, (name, seen) in enumerate(rows)
                    if 0 < max_persons <= number or 0.0 < max_age < now - seen]
            database.executemany("DELETE FROM persons WHERE id = ?", [(name,) for name in gone])
        if gone or self._database.has_traces:
            self._database.erase()
        return gone

    def load_templates(self, model: str, dimension: int) -> List[KnownPerson]:
        """Return those who have templates (K, dimension) of a network."""
        self._check_transform()
        with self._database.reading() as database:
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
        with self._database.writing() as database:
            database.execute("INSERT OR IGNORE INTO persons VALUES (?, '', '', ?, '', ?, ?, '{}')",
                             (person.id, int(person.enrolled), now, now))
            database.execute("UPDATE persons SET enrolled = ? WHERE id = ?", (int(person.enrolled), person.id))
            database.execute("DELETE FROM templates WHERE person = ? AND model = ?", (person.id, model))
            database.executemany("INSERT INTO templates VALUES (?, ?, ?, ?)",
                                 [(person.id, model, number, blob) for number, blob in enumerate(blobs)])

    def version(self) -> int:
        """Return a number that changes when another process has changed the file."""
        return self._database.version()

    def damaged_files(self) -> List[Path]:
        """Return the damaged files that were set aside."""
        return self._database.damaged_files()

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

    def _check_transform(self) -> None:
        """See that the templates are read and written as those before. Who uses records only needs no key."""
        if self._is_checked:
            return
        name = self._transform.name if self._transform is not None else "plain"
        with self._database.writing() as database:
            database.execute("INSERT OR IGNORE INTO facts VALUES ('templates', ?)", (name,))
            found = database.execute("SELECT value FROM facts WHERE name = 'templates'").fetchone()[0]
        if found != name:
            raise StoreError("the templates in {} are {}, and shall be {}; give the key (or none) it was made with, or "
                             "name another file".format(self.path, found, name))
        self._is_checked = True
