"""A gallery in the store of people: several recognisers and the person manager share what is known."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Callable, Dict, Optional

import numpy as np

from hri_pipeline.core.private_file import Transform
from hri_pipeline.core.recognition.gallery import MAX_PERSONS, MAX_TEMPLATES, GalleryError, KnownPerson, MemoryGallery
from hri_pipeline.core.recognition.gallery_file import FileGallery
from hri_pipeline.core.recognition.likelihood import Calibration
from hri_pipeline.core.recognition.person_store import PersonStore

SHARED_ENDINGS = (".sqlite", ".sqlite3", ".db")
"""A gallery whose file ends so is in the store that the person manager and other recognisers use, too."""


class StoredGallery(MemoryGallery):
    """A MemoryGallery that `flush` brings in line with a PersonStore, in both directions.

    What was changed here is written; who was learnt by another process is taken over; who was forgotten by another
    process is forgotten here. To forget somebody here is written at once. `close` closes the store, too. See
    MemoryGallery for the other arguments; clock: s, when somebody new was first seen. Raises StoreError.
    """

    def __init__(self, store: PersonStore, model: str, dimension: int, calibration: Calibration,
                 max_templates: int = MAX_TEMPLATES, max_persons: int = MAX_PERSONS,
                 clock: Callable[[], float] = time.time) -> None:
        super().__init__(model, dimension, calibration, max_templates, max_persons)
        self._store, self._clock = store, clock
        self._in_step = threading.RLock()
        self._stored: Dict[str, KnownPerson] = {}
        self._version = -1
        self._written = -1
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
        """Take over what others have changed, and write what has changed here; cheap when nothing has."""
        with self._in_step:
            version = self._store.version()
            if version != self._version:
                self._version = version
                stored = self._store.load_templates(self.model, self.dimension)
                self._take_over({person.id: person for person in stored})
            if self._written != self.revision:
                self._write()

    def remove(self, person_id: str) -> bool:
        """Forget a person, in the store too: the record, the name and all."""
        with self._in_step:
            found = super().remove(person_id)
            self._stored.pop(person_id, None)
            self._store.remove_record(person_id)
            return found

    def clear(self) -> None:
        """Forget everybody, in the store too."""
        with self._in_step:
            super().clear()
            self._stored = {}
            self._store.remove_all()

    def merge(self, source: str, target: str) -> None:
        """Put the templates of `source` with those of `target`, in the store too; the record of `source` stays."""
        with self._in_step:
            super().merge(source, target)
            self.flush()

    def _take_over(self, stored: Dict[str, KnownPerson]) -> None:
        with self._lock:
            for person_id in [name for name in self._stored if name not in stored and name in self]:
                super().remove(person_id)
            for person_id, person in stored.items():
                if person_id in self and _same(self.export(person_id), person):
                    continue
                # What was changed here since the last time is the newer one, and will be written; but for the consent.
                before = self._stored.get(person_id)
                if person_id in self and not _same(self.export(person_id), before):
                    if before is None or before.enrolled != person.enrolled:
                        self.enrol(person_id, person.enrolled)
                    continue
                self._replace(person)
            self._stored = stored

    def _replace(self, person: KnownPerson) -> None:
        super().remove(person.id)
        try:
            self.add_person(person.id, person.templates, person.enrolled)
        except GalleryError:
            # Not more than max_persons, and no template that is none: the others are of use all the same.
            self._stored.pop(person.id, None)

    def _write(self) -> None:
        with self._lock:
            revision = self.revision
            present = {person_id: self.export(person_id) for person_id in self.ids()}
        for person_id, person in present.items():
            if not _same(person, self._stored.get(person_id)):
                self._store.put_templates(person, self.model, self._clock())
        for person_id in [name for name in self._stored if name not in present]:
            # Merged or renamed: the templates have gone elsewhere.
            self._store.put_templates(KnownPerson(person_id, np.empty((0, self.dimension), np.float32),
                                                  self._stored[person_id].enrolled), self.model, self._clock())
        self._stored, self._written = present, revision


def _same(person: KnownPerson, other: object) -> bool:
    return (isinstance(other, KnownPerson) and person.enrolled == other.enrolled
            and np.array_equal(person.templates, other.templates))


def open_gallery(path: str, model: str, dimension: int, calibration: Calibration,
                 transform: Optional[Transform] = None,
                 notify: Optional[Callable[[str], None]] = None) -> MemoryGallery:
    """Return the gallery in a file: a FileGallery, or a StoredGallery where it ends as SHARED_ENDINGS; empty: memory.

    See there for the arguments. Raises StoreError that names the file and the mend.
    """
    if not path:
        return MemoryGallery(model, dimension, calibration)
    if Path(path).suffix not in SHARED_ENDINGS:
        return FileGallery(path, model, dimension, calibration, transform=transform, notify=notify)
    store = PersonStore(path, transform, notify)
    try:
        return StoredGallery(store, model, dimension, calibration)
    except BaseException:
        store.close()
        raise
