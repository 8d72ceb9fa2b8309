"""Templates encrypted at rest."""

from __future__ import annotations

import os

import numpy as np
import pytest

from hri_pipeline.core.encryption import KeyFileTransform, make_key_file
from hri_pipeline.core.private_file import StoreError
from hri_pipeline.core.recognition.gallery import KnownPerson
from hri_pipeline.core.recognition.person_store import PersonStore


def test_only_who_has_the_key_reads_the_templates(tmp_path):
    key, other = make_key_file(tmp_path / "key"), make_key_file(tmp_path / "other")
    template = np.linspace(0.0, 1.0, 8, dtype=np.float32)[None] / 2.0
    path = tmp_path / "store" / "people.sqlite"
    store = PersonStore(path, KeyFileTransform(key))
    store.put_templates(KnownPerson("ann", template, True), "net", 1.0)
    store.close()
    assert template.astype("<f4").tobytes() not in b"".join(file.read_bytes() for file in path.parent.iterdir())
    with_key = PersonStore(path, KeyFileTransform(key))
    np.testing.assert_array_equal(with_key.load_templates("net", 8)[0].templates, template)
    with_key.close()
    with pytest.raises((StoreError, ValueError)):
        stranger = PersonStore(path, KeyFileTransform(other))
        try:
            stranger.load_templates("net", 8)
        finally:
            stranger.close()


def test_what_was_changed_is_not_read(tmp_path):
    transform = KeyFileTransform(make_key_file(tmp_path / "key"))
    packed = transform.pack(b"template")
    assert transform.unpack(packed) == b"template" and packed != transform.pack(b"template")
    for index in range(0, len(packed), 7):
        changed = bytearray(packed)
        changed[index] ^= 1
        with pytest.raises(ValueError):
            transform.unpack(bytes(changed))


def test_key_files_that_are_none_say_so(tmp_path):
    with pytest.raises(StoreError, match="make-key"):
        KeyFileTransform(tmp_path / "absent")
    key = make_key_file(tmp_path / "key")
    with pytest.raises(StoreError, match="never overwritten"):
        make_key_file(key)
    assert os.stat(str(key)).st_mode & 0o777 == 0o600
    key.chmod(0o644)
    with pytest.raises(StoreError, match="chmod 600"):
        KeyFileTransform(key)
    key.chmod(0o600)
    key.write_bytes(b"no key")
    with pytest.raises(StoreError, match="holds no key"):
        KeyFileTransform(key)
