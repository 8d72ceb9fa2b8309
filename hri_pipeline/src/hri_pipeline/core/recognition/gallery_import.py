"""The gallery files of earlier versions: their people are moved to the store of people, once.

Format: 8 bytes of name, the version of the schema, the length and the SHA-256 of what follows, and then an npz archive
of plain arrays (or what a TemplateCipher has made of it). So a file that is cut off or altered
anywhere is known as damaged.
"""

from __future__ import annotations

import hashlib
import io
import os
import struct
import time
from pathlib import Path
from typing import Callable, List, Optional

import numpy as np

from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.private_file import (
    DAMAGED,
    StoreError,
    TemplateCipher,
    files_beside,
    hold,
    read_private,
    set_aside,
    wipe,
)
from hri_pipeline.core.recognition.likelihood import UNIT_TOLERANCE
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore

MAGIC = b"R4HFACES"
SCHEMA = 1
HEADER = struct.Struct("<8sIQ32s")
"""MAGIC, SCHEMA, number of bytes that follow, their SHA-256."""
_LEFTOVER = ".new-"
"""In the names of files of a process that was killed while it wrote or removed a gallery."""
_ARRAYS = ("model", "ids", "enrolled", "owner", "templates")


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
