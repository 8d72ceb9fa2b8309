"""A gallery on disk: templates and ids, no images, no pickle.

Format: 8 bytes of name, the version of the schema, the length and the SHA-256 of what follows, and then an npz archive
of plain arrays (or what a `transform` has made of it, such as encryption). So a file that is cut off or altered
anywhere is known as damaged. It is replaced as a whole: written beside, synced, renamed; whoever is killed while
writing leaves the old file or the new one. One process at a time holds it.
"""

from __future__ import annotations

import hashlib
import io
import os
import struct
import threading
import time
from pathlib import Path
from typing import Callable, List, Optional, Union

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.private_file import (
    DAMAGED,
    StoreError,
    Transform,
    hold,
    make_private_directory,
    read_private,
    replace_file,
    set_aside,
    wipe,
)
from hri_pipeline.core.recognition.gallery import MAX_PERSONS, MAX_TEMPLATES, GalleryError, KnownPerson, MemoryGallery
from hri_pipeline.core.recognition.likelihood import Calibration

MAGIC = b"R4HFACES"
SCHEMA = 1
_HEADER = struct.Struct("<8sIQ32s")
_ARRAYS = ("model", "ids", "enrolled", "owner", "templates")


class DamagedStore(StoreError):
    """The content of a store is not what was written."""


def pack(persons: List[KnownPerson], model: str, dimension: int, transform: Optional[Transform] = None) -> bytes:
    """Return the content of a file for these persons."""
    owner = np.repeat(np.arange(len(persons), dtype=np.uint32), [len(person.templates) for person in persons])
    templates = [person.templates for person in persons] or [np.empty((0, dimension), np.float32)]
    target = io.BytesIO()
    np.savez(target, model=np.array(model.encode("ascii")),
             ids=np.array([person.id.encode("ascii") for person in persons], dtype="S32"),
             enrolled=np.array([person.enrolled for person in persons], dtype=bool), owner=owner,
             templates=np.concatenate(templates).astype("<f4"))
    content = target.getvalue()
    if transform is not None:
        content = transform.pack(content)
    return _HEADER.pack(MAGIC, SCHEMA, len(content), hashlib.sha256(content).digest()) + content


def unpack(data: bytes, model: str, dimension: int, transform: Optional[Transform] = None) -> List[KnownPerson]:
    """Return the persons of a file's content.

    Raises DamagedStore for anything that `pack` did not write, StoreError for a newer schema, for templates of
    another network, and where the transform refuses (a wrong key).
    """
    if len(data) < _HEADER.size:
        raise DamagedStore("cut off in the header")
    magic, schema, length, digest = _HEADER.unpack_from(data)
    if magic != MAGIC:
        raise DamagedStore("not a gallery of faces")
    if schema > SCHEMA:
        raise StoreError("schema {} is newer than this program's {}; use the newer program, or another file".format(
            schema, SCHEMA))
    content = data[_HEADER.size:]
    if schema < 1 or len(content) != length or hashlib.sha256(content).digest() != digest:
        raise DamagedStore("cut off or altered")
    if transform is not None:
        try:
            content = transform.unpack(content)
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
             and all(is_valid_id(value) for value in names) and np.isfinite(templates).all()
             and np.array_equal(np.unique(owner), np.arange(len(names))))
    if not sound:
        raise DamagedStore("its parts contradict each other")
    return [KnownPerson(value, templates[owner == index], bool(enrolled[index])) for index, value in enumerate(names)]


class FileGallery(MemoryGallery):
    """A MemoryGallery that is read from a file, and written back by `flush` where it has changed.

    `flush` is cheap when nothing has changed: call it every second. To forget somebody is written at once. See
    MemoryGallery for the other arguments. notify: told in one line about a damaged file. Raises StoreError.
    """

    def __init__(self, path: Union[str, Path], model: str, dimension: int, calibration: Calibration,
                 max_templates: int = MAX_TEMPLATES, max_persons: int = MAX_PERSONS,
                 transform: Optional[Transform] = None, notify: Optional[Callable[[str], None]] = None,
                 clock: Callable[[], float] = time.time) -> None:
        super().__init__(model, dimension, calibration, max_templates, max_persons)
        self.path = Path(path).expanduser().absolute()
        self._transform, self._clock = transform, clock
        self._notify = notify or (lambda text: None)
        self._write_lock = threading.Lock()
        self._written = 0
        make_private_directory(self.path.parent)
        self._held: Optional[int] = hold(self.path)
        try:
            self._load()
        except BaseException:
            self._release()
            raise

    def flush(self) -> None:
        """Write the file if something has changed. Raises StoreError when that fails; what was there stays."""
        with self._write_lock:
            if self._held is None or self._written == self.revision:
                return
            with self._lock:
                revision = self.revision
                persons = [self.export(person_id) for person_id in self.ids()]
            content = pack(persons, self.model, self.dimension, self._transform)
            try:
                replace_file(self.path, content)
            except OSError as error:
                raise StoreError("the gallery of faces {} cannot be written ({}); make room, or correct its "
                                 "permissions".format(self.path, error)) from error
            self._written = revision

    def remove(self, person_id: str) -> bool:
        """Forget a person, on disk too. Damaged files set aside go with it: who is in them cannot be told."""
        found = super().remove(person_id)
        self._forget_on_disk()
        return found

    def clear(self) -> None:
        """Forget everybody, on disk too, damaged files set aside included."""
        super().clear()
        self._forget_on_disk()

    def merge(self, source: str, target: str) -> None:
        """Put the templates of `source` with those of `target`, on disk too."""
        super().merge(source, target)
        self.flush()

    def damaged_files(self) -> List[Path]:
        """Return the damaged files that were set aside."""
        return sorted(self.path.parent.glob(self.path.name + DAMAGED + "*"))

    def close(self) -> None:
        """Write what has changed and give the file back. May be called again."""
        try:
            self.flush()
        finally:
            with self._write_lock:
                self._release()

    def _load(self) -> None:
        for leftover in self.path.parent.glob(self.path.name + ".new-*"):
            wipe(leftover)
        try:
            data = read_private(self.path)
        except FileNotFoundError:
            return
        except OSError as error:
            raise StoreError("the gallery of faces {} cannot be read ({}); correct its permissions".format(
                self.path, error)) from error
        try:
            persons = unpack(data, self.model, self.dimension, self._transform)
            for person in persons:
                self.add_person(person.id, person.templates, person.enrolled)
        except (DamagedStore, GalleryError) as error:
            super().clear()
            self._put_aside(error)
        except StoreError as error:
            raise StoreError("the gallery of faces {}: {}".format(self.path, error)) from error
        self._written = self.revision

    def _put_aside(self, reason: Exception) -> None:
        target = set_aside(self.path, self._clock())
        self._notify("the gallery of faces {} is damaged ({}); it is kept as {}, and nobody is known".format(
            self.path, reason, target))

    def _forget_on_disk(self) -> None:
        for path in self.damaged_files():
            wipe(path)
        self.flush()

    def _release(self) -> None:
        if self._held is not None:
            os.close(self._held)
            self._held = None
