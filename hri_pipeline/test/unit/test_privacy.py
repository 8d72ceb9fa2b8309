"""The notice of what is computed and kept of people; and files with personal data: encrypted templates, locks."""

import os

import numpy as np
import pytest

from hri_pipeline.core.privacy import (
    DataUse,
    StoreError,
    TemplateCipher,
    hold,
    joined,
    make_key_file,
    make_private_directory,
    notice,
    read_private,
)
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore


def test_one_process_with_two_parts_says_both():
    use = joined([DataUse(("boxes", "landmarks"), "/data/p.sqlite", ("templates",), 30.0, True),
                  DataUse(("boxes", "skeletons"))])
    assert use == DataUse(("boxes", "landmarks", "skeletons"), "/data/p.sqlite", ("templates",), 30.0, True)
    assert joined([]) == DataUse(())


def test_the_text_says_what_where_how_long_and_who_agreed():
    text = notice([("/b", DataUse(())),
                   ("/a", DataUse(("names",), "/data/p.sqlite", ("names", "times"), 30.0, True, ("ada", "bob")))])
    assert text.splitlines() == [
        "/a computes: names",
        "    keeps in /data/p.sqlite, encrypted: names, times; removed 30 days after the last time",
        "    agreed to be recognised: ada, bob", "/b computes: nothing of people", "    keeps nothing beyond the run"]
    plain = notice([("/a", DataUse(("names",), "/p", ("names",)))])
    assert "not encrypted" in plain and "without a limit" in plain


def test_only_who_has_the_key_reads_the_templates(tmp_path):
    key, other = make_key_file(tmp_path / "key"), make_key_file(tmp_path / "other")
    template = np.linspace(0.0, 1.0, 8, dtype=np.float32)[None]
    template /= np.linalg.norm(template)
    path = tmp_path / "store" / "people.sqlite"
    store = PersonStore(path, TemplateCipher(key))
    store.put_templates(KnownPerson("ann", template, True), "net", 1.0)
    store.close()
    assert template.astype("<f4").tobytes() not in b"".join(file.read_bytes() for file in path.parent.iterdir())
    with_key = PersonStore(path, TemplateCipher(key))
    np.testing.assert_array_equal(with_key.load_templates("net", 8)[0].templates, template)
    with_key.close()
    with pytest.raises((StoreError, ValueError)):
        stranger = PersonStore(path, TemplateCipher(other))
        try:
            stranger.load_templates("net", 8)
        finally:
            stranger.close()


def test_what_was_changed_is_not_read(tmp_path):
    cipher = TemplateCipher(make_key_file(tmp_path / "key"))
    packed = cipher.encrypt(b"template")
    assert cipher.decrypt(packed) == b"template" and packed != cipher.encrypt(b"template")
    for index in range(0, len(packed), 7):
        changed = bytearray(packed)
        changed[index] ^= 1
        with pytest.raises(ValueError):
            cipher.decrypt(bytes(changed))


def test_key_files_that_are_none_say_so(tmp_path):
    with pytest.raises(StoreError, match="make-key"):
        TemplateCipher(tmp_path / "absent")
    key = make_key_file(tmp_path / "key")
    with pytest.raises(StoreError, match="never overwritten"):
        make_key_file(key)
    assert os.stat(str(key)).st_mode & 0o777 == 0o600
    key.chmod(0o644)
    with pytest.raises(StoreError, match="chmod 600"):
        TemplateCipher(key)
    key.chmod(0o600)
    key.write_bytes(b"no key")
    with pytest.raises(StoreError, match="holds no key"):
        TemplateCipher(key)


def test_what_is_no_plain_file_costs_no_descriptor(tmp_path):
    (tmp_path / "store").mkdir()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        with pytest.raises(OSError):
            read_private(tmp_path / "store")
    assert len(os.listdir("/proc/self/fd")) == before


def test_two_processes_may_make_the_directory_at_once(tmp_path, monkeypatch):
    directory = tmp_path / "private"
    is_dir, asked = type(directory).is_dir, []

    def before_the_other_made_it(path):
        asked.append(path)
        return is_dir(path) and len(asked) > 1
    directory.mkdir(mode=0o700)
    monkeypatch.setattr(type(directory), "is_dir", before_the_other_made_it)
    make_private_directory(directory)
    assert asked[0] == directory


def test_a_lock_is_given_to_one_at_a_time(tmp_path):
    first = hold(tmp_path / "store", 0.0)
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(StoreError, match="in use"):
        hold(tmp_path / "store", 0.05)
    assert len(os.listdir("/proc/self/fd")) == before
    os.close(first)
    os.close(hold(tmp_path / "store", 0.0))
