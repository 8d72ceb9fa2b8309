"""The people a recogniser knows, in memory and in the store of people, which several recognisers and the person manager
share; `open_gallery` makes the gallery that the parameter `gallery` asks for, and moves the people of the gallery files
of earlier versions to the store, once.

Format of those files: 8 bytes of name, the version of the schema, the length and the SHA-256 of what follows, and then
an npz archive of plain arrays (or what a TemplateCipher has made of it). So a file that is cut off or altered anywhere
is known as damaged.
"""

from __future__ import annotations

import hashlib
import io
import os
import struct
import threading
import time
from pathlib import Path
from typing import Callable, Dict, FrozenSet, List, Optional, Sequence, Set, Tuple, Union

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.privacy import (
    DAMAGED,
    StoreError,
    TemplateCipher,
    files_beside,
    hold,
    read_private,
    set_aside,
    wipe,
)
from hri_pipeline.core.recognition.gallery import MAX_PERSONS, MAX_TEMPLATES, GalleryError, MemoryGallery
from hri_pipeline.core.recognition.likelihood import UNIT_TOLERANCE, TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, read_store

SHARED_ENDINGS = (".sqlite", ".sqlite3", ".db")
"""How the file of a store of people ends, which recognisers and the person manager share."""
MAGIC = b"R4HFACES"
SCHEMA = 1
HEADER = struct.Struct("<8sIQ32s")
"""MAGIC, SCHEMA, number of bytes that follow, their SHA-256."""
_LEFTOVER = ".new-"
"""In the names of files of a process that was killed while it wrote or removed a gallery."""
_ARRAYS = ("model", "ids", "enrolled", "owner", "templates")


class StoredGallery(MemoryGallery):
    """A MemoryGallery that `flush` synchronises with a PersonStore, in both directions.

    What was changed here is written, and who was forgotten here is removed; who was learnt by another process is added
    here, and who was forgotten by another process is forgotten here. All of that is one transaction: no other process
    can forget somebody between the reading and the writing. No other method waits for the store or for flush().

    Parameters
    ----------
    store : the store, which close() closes as well.
    clock : time (s) at which somebody new was first seen.
    model, dimension, calibration, max_templates, max_persons : see MemoryGallery.

    Raises
    ------
    StoreError
        The store cannot be used, here and in flush() and close().
    """

    def __init__(self, store: PersonStore, model: str, dimension: int, calibration: TemplateCalibration,
                 max_templates: int = MAX_TEMPLATES, max_persons: int = MAX_PERSONS,
                 clock: Callable[[], float] = time.time) -> None:
        super().__init__(model, dimension, calibration, max_templates, max_persons)
        self._store, self._clock = store, clock
        self._in_step = threading.RLock()       # of flush() and close()
        self._stored: Dict[str, KnownPerson] = {}
        self._stored_apart: Set[FrozenSet[str]] = set()
        self._version = -1
        self._written = self.revision
        self._forgotten: Set[str] = set()       # they are in the store still
        self._merged: Set[str] = set()          # their templates are with another one, and in the store still
        self._forgets_all = False
        self._closed = False
        self.flush()

    def close(self) -> None:
        """Write what has changed and close the store. May be called again."""
        with self._in_step:
            if not self._closed:
                self._closed = True
                try:
                    self.flush()
                finally:
                    self._store.close()

    def flush(self) -> None:
        """Apply what other processes have changed, and write what has changed here; cheap when nothing has."""
        with self._in_step:
            if self._forgotten or self._forgets_all or self._written != self.revision:
                self._exchange()
            else:
                self._read()
            self._store.erase_traces()

    def _dispensable(self) -> str:
        """Nobody: how many a store keeps is for its owner to say, the person manager."""
        return ""

    def remove(self, person_id: str) -> bool:
        """Forget a person, and with the next flush() in the store too: the record, the name and all."""
        self._check_own(person_id)
        with self._lock:
            found = super().remove(person_id) or person_id in self._forgotten
            self._forgotten.add(person_id)
            return found

    def clear(self) -> None:
        """Forget everybody, with the next flush() in the store too."""
        with self._lock:
            super().clear()
            self._forgets_all = True

    def merge(self, source: str, target: str) -> None:
        """See MemoryGallery. What another process learns of `source` before the next flush() is dropped."""
        with self._lock:
            super().merge(source, target)
            self._merged.add(source)

    def _exchange(self) -> None:
        with self._lock:
            everybody, self._forgets_all = self._forgets_all, False
            forgotten, self._forgotten = self._forgotten, set()
            merged = set(self._merged)
        try:
            with self._store.change():
                self._remove_stored(forgotten, everybody)
                self._read()
                present, apart, revision = self._write()
                version = self._store.version()
        except BaseException:
            self._version = -1      # what was read may be what was taken back
            with self._lock:
                self._forgets_all |= everybody
                self._forgotten |= forgotten
            raise
        # Not before: what was taken back, as on a full disk, is written by the next one.
        self._stored, self._stored_apart, self._written, self._version = present, apart, revision, version
        with self._lock:
            self._merged -= merged

    def _remove_stored(self, forgotten: Set[str], everybody: bool) -> None:
        if everybody:
            self._store.remove_all()
            self._stored = {}
        for person_id in forgotten:
            self._store.remove_record(person_id)
            self._stored.pop(person_id, None)

    def _read(self) -> None:
        """Apply what other processes have changed."""
        version = self._store.version()
        if version != self._version or version < 0:
            stored = self._store.load_templates(self.model, self.dimension)
            self._apply({person.id: person for person in stored})
            self._apply_apart(self._store.load_apart())
            self._version = version

    def _apply(self, stored: Dict[str, KnownPerson]) -> None:
        with self._lock:
            is_written = self._written == self.revision
            for person_id in [name for name in self._stored if name not in stored and name in self]:
                super().remove(person_id)
            for person_id, person in list(stored.items()):
                if not (self._forgets_all or person_id in self._forgotten) and not self._take_person(person):
                    del stored[person_id]
            self._stored = stored
            if is_written:
                self._written = self.revision

    def _apply_apart(self, stored: Set[FrozenSet[str]]) -> None:
        with self._lock:
            # Of somebody who is forgotten or merged here nothing comes back.
            gone = self._forgotten | (self._merged - self._row.keys())
            known = {pair for pair in stored if not (self._forgets_all or pair & gone)}
            self._apart = (self._apart - (self._stored_apart - stored)) | known
            self._stored_apart = stored

    def _take_person(self, person: KnownPerson) -> bool:
        """Let a person be here as in the store; False where there is no room, or a template is none."""
        if person.id in self._merged and person.id not in self:
            return True     # _write takes the templates out of the store
        before = self._stored.get(person.id)
        is_own = self._borrowed.pop(person.id, None) is None
        if person.id in self and is_own:
            here = self.export(person.id)
            if _same(here, person):
                return True
            # What was changed here since the last time is the newer one, and will be written; but for the consent.
            if not _same(here, before) and (before is None or _has_same_first_template(before, person)):
                if before is None or before.enrolled != person.enrolled:
                    self.enrol(person.id, person.enrolled)
                return True
        if before is not None and not _has_same_first_template(before, person):
            super().remove(person.id)       # somebody else by now
        try:
            if person.id in self:       # who is known for longest stays so
                self._fill(self._row[person.id], self._checked(person.templates), person.enrolled)
            else:
                self.add_person(person.id, person.templates, person.enrolled)
        except GalleryError:
            super().remove(person.id)
            return False
        return True

    def _write(self) -> Tuple[Dict[str, KnownPerson], Set[FrozenSet[str]], int]:
        """Write what has changed here; returns who is in the store then, who are two people for certain, and the
        revision that this is."""
        with self._lock:
            revision = self.revision
            present = {person_id: self.export(person_id) for person_id in self.ids()
                       if person_id not in self._borrowed}
            apart = {pair for pair in self._apart if pair <= present.keys()}     # others are not in the store
        for person_id, person in present.items():
            if not _same(person, self._stored.get(person_id)):
                self._store.put_templates(person, self.model, self._clock(), is_new=person_id not in self._stored)
        for person_id, person in self._stored.items():
            if person_id not in present:
                # Merged: the templates have gone elsewhere.
                nothing = np.empty((0, self.dimension), np.float32)
                self._store.put_templates(KnownPerson(person_id, nothing, person.enrolled), self.model, self._clock(),
                                          is_new=False)
        if apart != self._stored_apart:
            self._store.put_apart(apart - self._stored_apart, self._stored_apart - apart)
        return present, apart, revision


def _has_same_first_template(before: KnownPerson, now: KnownPerson) -> bool:
    """Tell whether nobody has forgotten a person meanwhile and learnt it anew: the first template stays for life."""
    return np.array_equal(before.templates[0], now.templates[0])


def _same(person: KnownPerson, other: object) -> bool:
    return (isinstance(other, KnownPerson) and person.enrolled == other.enrolled
            and np.array_equal(person.templates, other.templates))


def store_path(path: Union[str, Path]) -> Path:
    """Return the absolute path of the store for the path of a gallery.

    A path that ends as in SHARED_ENDINGS is the store itself. Galleries of earlier versions had a format of their own
    and any other ending: then the store is the file beside it that ends in .sqlite (faces.sqlite for faces.npz and
    faces, faces.bin.sqlite for faces.bin).
    """
    path = Path(path).expanduser().absolute()
    if path.suffix in SHARED_ENDINGS:
        return path
    return path.with_name((path.stem if path.suffix == ".npz" else path.name) + ".sqlite")


def open_gallery(path: str, model: str, dimension: int, calibration: TemplateCalibration,
                 cipher: Optional[TemplateCipher] = None, notify: Optional[Callable[[str], None]] = None,
                 read_only: Sequence[str] = ()) -> MemoryGallery:
    """Return the gallery for the parameter `gallery`: a StoredGallery in store_path(path), or in memory for an empty
    path.

    Parameters
    ----------
    path : of the store, or of a gallery of an earlier version, whose people are moved to the store, once.
    model, dimension, calibration : see MemoryGallery.
    cipher : of the templates in the file; None where they are not.
    notify : called with one line about people who were moved, a store that is not at `path`, and a damaged file.
    read_only : more stores, whose people are known, too, and never changed; plain, or with the same key.

    Raises
    ------
    StoreError
        A file cannot be used; the text names the file and what to do.
    """
    tell = notify or (lambda text: None)
    others = [(source, read_store(source, cipher, model, dimension, tell)[1]) for source in read_only]
    gallery = _own_gallery(path, model, dimension, calibration, cipher, notify)
    for source, people in others:
        gallery.borrow(people, source)
    return gallery


def _own_gallery(path: str, model: str, dimension: int, calibration: TemplateCalibration,
                 cipher: Optional[TemplateCipher], notify: Optional[Callable[[str], None]]) -> MemoryGallery:
    if not path:
        return MemoryGallery(model, dimension, calibration)
    file, named = store_path(path), Path(path).expanduser().absolute()
    store = PersonStore(file, cipher, notify)
    try:
        if file != named:
            tell = notify or (lambda text: None)
            import_gallery(named, store, model, dimension, cipher, tell)
            tell("the gallery of faces is kept in {}; name that file instead of {}".format(file, named))
        return StoredGallery(store, model, dimension, calibration)
    except BaseException:
        store.close()
        raise


class DamagedStore(StoreError):
    """The content of a store is not what was written."""


def import_gallery(path: Path, store: PersonStore, model: str, dimension: int, cipher: Optional[TemplateCipher] = None,
                   notify: Callable[[str], None] = lambda text: None) -> None:
    """Move the people of a gallery file to the store; nothing is done where there is no such file.

    The file is overwritten and removed as soon as its people are in the store: otherwise it would keep those who are
    forgotten later. A damaged file is set aside beside the store, and goes when somebody is forgotten. What the store
    knows of somebody already is the newer and stays.

    Parameters
    ----------
    path : absolute path of the file.
    store : where its people go.
    model, dimension : network that the templates must be of, and how many numbers a template has.
    cipher : of the templates, in the file and in the store; None where they are not.
    notify : called with one line about what was done.

    Raises
    ------
    StoreError
        The file cannot be used (wrong key, another network, in use, permissions); it stays as it is.
    """
    if not (os.path.lexists(str(path)) or files_beside(path, _LEFTOVER) or files_beside(path, DAMAGED)):
        return
    held = hold(path)
    try:
        for leftover in files_beside(path, _LEFTOVER):
            wipe(leftover)
        _move_people(path, store, model, dimension, cipher, notify)
        for damaged in files_beside(path, DAMAGED):
            os.replace(str(damaged), str(_beside_store(damaged, path, store)))
    except OSError as error:
        raise StoreError("the gallery of faces {} cannot be read and removed ({}); correct its permissions".format(
            path, error)) from error
    finally:
        os.close(held)


def _move_people(path: Path, store: PersonStore, model: str, dimension: int, cipher: Optional[TemplateCipher],
                 notify: Callable[[str], None]) -> None:
    try:
        data = read_private(path)
    except FileNotFoundError:
        return    # another process was faster, or only leftovers were there
    try:
        persons = read_persons(data, model, dimension, cipher)
    except DamagedStore as error:
        target = set_aside(path, time.time())
        notify("the gallery of faces {} is damaged ({}); it is kept as {}, and nobody of it is known".format(
            path, error, _beside_store(target, path, store)))
        return
    except StoreError as error:
        raise StoreError("the gallery of faces {}: {}".format(path, error)) from error
    with store.change():
        # Killed between the change and the removal of the file: who is forgotten meanwhile must not come back.
        if store.note_once("imported " + hashlib.sha256(data).hexdigest()):
            _add(persons, store, model, dimension, time.time())
    # Renamed first: a file that is overwritten in part would be taken for a damaged one.
    leftover = path.with_name(path.name + _LEFTOVER + "imported")
    os.replace(str(path), str(leftover))
    wipe(leftover)
    notify("the {} persons of the gallery of faces {} were moved to {}; the old file is removed".format(
        len(persons), path, store.path))


def _add(persons: List[KnownPerson], store: PersonStore, model: str, dimension: int, now: float) -> None:
    known = {person.id for person in store.load_templates(model, dimension)}
    consents = {record.id: record.enrolled for record in store.load_records()}
    for number, person in enumerate(persons):
        if person.id not in known:
            # The order of the gallery is that of the times: who is known for longer comes first.
            store.put_templates(KnownPerson(person.id, person.templates, consents.get(person.id, person.enrolled)),
                                model, now - 1e-3 * (len(persons) - number))


def _beside_store(damaged: Path, path: Path, store: PersonStore) -> Path:
    """Return the name under which a damaged file is one of the store's."""
    return store.path.with_name(store.path.name + damaged.name[len(path.name):])


def read_persons(data: bytes, model: str, dimension: int, cipher: Optional[TemplateCipher] = None) -> List[KnownPerson]:
    """Return the persons of a file's content.

    Raises DamagedStore for a file that is not such a gallery, StoreError for a newer schema, for templates of
    another network, and where the cipher refuses (a wrong key).
    """
    if len(data) < HEADER.size:
        raise DamagedStore("cut off in the header")
    magic, schema, length, digest = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise DamagedStore("not a gallery of faces")
    if schema > SCHEMA:
        raise StoreError("schema {} is newer than this program's {}; use the newer program, or another file".format(
            schema, SCHEMA))
    content = data[HEADER.size:]
    if schema < 1 or len(content) != length or hashlib.sha256(content).digest() != digest:
        raise DamagedStore("cut off or altered")
    if cipher is not None:
        try:
            content = cipher.decrypt(content)
        except ValueError as error:
            raise StoreError("it cannot be opened ({}); give the key it was written with".format(error)) from error
    return _persons(content, model, dimension)


def _persons(content: bytes, model: str, dimension: int) -> List[KnownPerson]:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            name, ids, enrolled, owner, templates = (archive[key] for key in _ARRAYS)
        names = [value.decode("ascii") for value in ids.tolist()]
        found = bytes(name.tolist()).decode("ascii")
    # numpy and zipfile tell of a bad archive in all of these ways.
    except Exception as error:
        raise StoreError("it cannot be read ({}: {}); it may be encrypted: give its key".format(
            type(error).__name__, error)) from error
    if found != model or (len(templates) and templates.shape[1] != dimension):
        raise StoreError("its templates are of the network {!r}, this is {!r}; use that network, or another "
                         "file".format(found, model))
    sound = (len(names) == len(enrolled) and len(owner) == len(templates) and len(set(names)) == len(names)
             and all(is_valid_id(value) for value in names)
             and (np.abs(np.linalg.norm(templates, axis=1) - 1.0) <= UNIT_TOLERANCE).all()
             and np.array_equal(np.unique(owner), np.arange(len(names))))
    if not sound:
        raise DamagedStore("its parts contradict each other")
    return [KnownPerson(value, templates[owner == index], bool(enrolled[index])) for index, value in enumerate(names)]
