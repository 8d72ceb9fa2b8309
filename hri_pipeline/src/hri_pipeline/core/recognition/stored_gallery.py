"""The people a recogniser knows, in memory and in the store of people, which several recognisers and the person manager
share; `open_gallery` makes the gallery that the parameter `gallery` asks for.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Callable, Dict, FrozenSet, Optional, Sequence, Set, Tuple, Union

import numpy as np

from hri_pipeline.core.private_file import TemplateCipher
from hri_pipeline.core.recognition.gallery import MAX_PERSONS, MAX_TEMPLATES, GalleryError, MemoryGallery
from hri_pipeline.core.recognition.gallery_import import import_gallery
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, read_store

SHARED_ENDINGS = (".sqlite", ".sqlite3", ".db")
"""How the file of a store of people ends, which recognisers and the person manager share."""


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

    def _exchange(self) -> None:
        with self._lock:
            everybody, self._forgets_all = self._forgets_all, False
            forgotten, self._forgotten = self._forgotten, set()
        try:
            with self._store.change():
                self._remove_stored(forgotten, everybody)
                self._read()
                present, apart, revision = self._write()
        except BaseException:
            with self._lock:
                self._forgets_all |= everybody
                self._forgotten |= forgotten
            raise
        # Not before: what was taken back, as on a full disk, is written by the next one.
        self._stored, self._stored_apart, self._written = present, apart, revision

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
        if version != self._version:
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
            # Of somebody who is forgotten here nothing comes back.
            known = {pair for pair in stored if not (self._forgets_all or pair & self._forgotten)}
            self._apart = (self._apart - (self._stored_apart - stored)) | known
            self._stored_apart = stored

    def _take_person(self, person: KnownPerson) -> bool:
        """Let a person be here as in the store; False where there is no room, or a template is none."""
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
        super().remove(person.id)
        try:
            self.add_person(person.id, person.templates, person.enrolled)
        except GalleryError:
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
