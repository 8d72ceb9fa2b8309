"""The gallery files of earlier versions: their people are moved to the store once, and nothing of them stays behind."""

import hashlib
import io
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recognition import SIZE
from benchmarks.recognition import template as face
from hri_pipeline.core.privacy import StoreError, TemplateCipher, make_key_file
from hri_pipeline.core.recognition import stored_gallery
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, StoredPerson
from hri_pipeline.core.recognition.stored_gallery import (
    HEADER,
    MAGIC,
    SCHEMA,
    DamagedStore,
    StoredGallery,
    open_gallery,
    read_persons,
    store_path,
)

CALIBRATION = TemplateCalibration(midpoint=0.36, fair_midpoint=0.40, scale=0.018, near=0.15)


def packed(persons, cipher=None, schema=SCHEMA):
    """Return the content of a gallery file, as earlier versions wrote it."""
    owner = np.repeat(np.arange(len(persons), dtype=np.uint32), [len(person.templates) for person in persons])
    target = io.BytesIO()
    np.savez(target, model=np.array(b"synthetic"),
             ids=np.array([person.id.encode() for person in persons], dtype="S32"),
             enrolled=np.array([person.enrolled for person in persons], dtype=bool), owner=owner,
             templates=np.concatenate([person.templates for person in persons]).astype("<f4"))
    content = target.getvalue()
    if cipher is not None:
        content = cipher.encrypt(content)
    return HEADER.pack(MAGIC, schema, len(content), hashlib.sha256(content).digest()) + content


def people(count=3):
    return [KnownPerson("person{}".format(seed), np.stack([face(seed), face(seed, 0.3)]), seed == 1)
            for seed in reversed(range(count))]


def write(path, content):
    path.parent.mkdir(mode=0o700, exist_ok=True)
    path.write_bytes(content)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "private" / "faces.npz"


def opened(path, cipher=None, notify=None, model="synthetic"):
    return open_gallery(str(path), model, SIZE, CALIBRATION, cipher, notify)


def held(path):
    return b"".join(file.read_bytes() for file in path.parent.iterdir())


@pytest.mark.parametrize("name, store", [("faces.npz", "faces.sqlite"), ("faces", "faces.sqlite"),
                                         ("faces.gallery", "faces.gallery.sqlite"), ("faces.db", "faces.db"),
                                         ("faces.sqlite3", "faces.sqlite3")])
def test_where_the_store_of_a_gallery_is(tmp_path, name, store):
    assert store_path(tmp_path / name) == tmp_path / store


@pytest.mark.parametrize("name", ["faces.npz", "faces.gallery"])
def test_the_people_of_an_old_file_are_in_the_store_from_now_on(path, name):
    path = path.with_name(name)
    write(path, packed(people()))
    said = []
    gallery = opened(path, notify=said.append)
    assert isinstance(gallery, StoredGallery)
    assert gallery.ids() == ["person2", "person1", "person0"], "in the order of the file"
    assert gallery.match(face(1, 0.1)[None])[0].candidates[0].person_id == "person1"
    assert gallery.export("person1").enrolled and not gallery.export("person0").enrolled
    assert np.array_equal(gallery.export("person2").templates, np.stack([face(2), face(2, 0.3)]))
    gallery.close()
    moved, kept = said
    assert "3 persons" in moved and str(path) in moved and str(store_path(path)) in moved and "removed" in moved
    assert str(store_path(path)) in kept
    assert not path.exists() and stat.S_IMODE(store_path(path).stat().st_mode) == 0o600
    said.clear()
    again = opened(path, notify=said.append)
    assert again.ids() == ["person2", "person1", "person0"] and said == [kept]
    again.close()
    shared = opened(store_path(path), notify=said.append)
    assert shared.ids() == ["person2", "person1", "person0"] and said == [kept]
    shared.close()


def test_an_encrypted_file_stays_encrypted(path, tmp_path):
    key = TemplateCipher(make_key_file(tmp_path / "key"))
    write(path, packed(people(), key))
    gallery = opened(path, key)
    assert len(gallery) == 3
    gallery.close()
    assert face(1).tobytes()[:16] not in held(path) and not path.exists()
    with pytest.raises(StoreError, match="key"):
        opened(path)


@pytest.mark.parametrize("written, read", [(False, True), (True, False)])
def test_a_file_of_another_key_is_refused_and_left_alone(path, tmp_path, written, read):
    key = TemplateCipher(make_key_file(tmp_path / "key"))
    content = packed(people(), key if written else None)
    write(path, content)
    with pytest.raises(StoreError, match="key") as error:
        opened(path, key if read else None)
    assert str(path) in str(error.value) and path.read_bytes() == content
    gallery = opened(path, key if written else None)
    assert len(gallery) == 3
    gallery.close()


def test_who_is_forgotten_is_nowhere_any_more(path):
    write(path, packed(people()))
    write(path.with_name("faces.npz.new-17"), packed(people()))
    write(path.with_name("faces.npz.damaged-20231114T221320Z"), packed(people())[:-1])
    gallery = opened(path)
    assert not path.with_name("faces.npz.new-17").exists()
    assert path.with_name("faces.sqlite.damaged-20231114T221320Z").exists()
    gallery.remove("person1")
    gallery.flush()
    assert b"person1" not in held(path) and face(1).tobytes()[:16] not in held(path)
    gallery.close()


def test_what_the_old_file_held_is_overwritten(path):
    write(path, packed(people()))
    old = open(str(path), "rb")
    opened(path).close()
    assert not any(old.read())
    old.close()


def test_who_is_forgotten_before_the_old_file_is_removed_does_not_come_back(path, monkeypatch):
    write(path, packed(people()))

    def killed(*paths):
        raise KeyboardInterrupt

    monkeypatch.setattr(stored_gallery.os, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        opened(path)
    monkeypatch.undo()
    assert path.exists()
    store = PersonStore(store_path(path))
    store.remove_record("person1")
    store.close()
    gallery = opened(path)
    assert gallery.ids() == ["person2", "person0"] and b"person1" not in held(path)
    gallery.close()


def test_an_old_file_that_was_removed_in_part_is_removed_at_the_next_start(path, monkeypatch):
    write(path, packed(people()))

    def killed(path):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(stored_gallery, "wipe", killed)
    with pytest.raises(KeyboardInterrupt):
        opened(path)
    monkeypatch.undo()
    said = []
    gallery = opened(path, notify=said.append)
    assert len(gallery) == 3 and len(said) == 1 and b"half" not in held(path)
    gallery.close()


def test_what_the_store_knows_already_stays(path):
    write(path, packed(people()))
    store = PersonStore(store_path(path))
    store.put_templates(KnownPerson("person0", face(7)[None]), "synthetic", 100.0)
    store.put_record(StoredPerson("person2", "Carla", enrolled=True, first_seen=1.0, last_seen=2.0))
    store.close()
    gallery = opened(path)
    assert np.array_equal(gallery.export("person0").templates, face(7)[None])
    assert gallery.export("person2").enrolled and len(gallery.export("person2").templates) == 2
    gallery.close()
    store = PersonStore(store_path(path))
    assert store.load_records()[2] == StoredPerson("person2", "Carla", enrolled=True, first_seen=1.0, last_seen=2.0)
    store.close()


@pytest.mark.parametrize("part", [0, 1, 7, 30, 52, 53, 400, -1])
def test_a_damaged_file_is_set_aside_and_said(path, part):
    whole = packed(people())
    broken = whole[:part] if part in (0, 1, 30) else bytearray(whole)
    if part not in (0, 1, 30):
        broken[part] ^= 0x40
    write(path, broken)
    said = []
    gallery = opened(path, notify=said.append)
    assert gallery.ids() == [] and not path.exists()
    aside, = path.parent.glob("faces.sqlite.damaged-*")
    assert aside.read_bytes() == bytes(broken), "kept, not overwritten"
    assert "damaged" in said[0] and str(path) in said[0] and str(aside) in said[0]
    gallery.add_person("newby", face(9)[None])
    gallery.remove("newby")
    gallery.flush()
    assert not aside.exists(), "who is in it cannot be told"
    gallery.close()


def test_cut_off_at_every_byte():
    whole = packed(people())
    for length in range(len(whole)):
        with pytest.raises(DamagedStore):
            read_persons(whole[:length], "synthetic", SIZE)
    assert len(read_persons(whole, "synthetic", SIZE)) == 3


@pytest.mark.parametrize("persons", [
    [KnownPerson("anna", face(1)[None]), KnownPerson("anna", face(2)[None])],
    [KnownPerson("../x", face(1)[None])],
    [KnownPerson("anna", 3.0 * face(1)[None])],
    [KnownPerson("anna", np.full((1, SIZE), np.nan, np.float32))]])
def test_contradictions_are_damage(persons):
    with pytest.raises(DamagedStore, match="contradict"):
        read_persons(packed(persons), "synthetic", SIZE)


def test_a_newer_schema_is_refused_and_left_alone(path):
    content = packed(people(), schema=SCHEMA + 1)
    write(path, content)
    with pytest.raises(StoreError, match="newer") as error:
        opened(path)
    assert str(path) in str(error.value) and path.read_bytes() == content


def test_templates_of_another_network_are_refused_and_left_alone(path):
    write(path, packed(people()))
    with pytest.raises(StoreError, match="'synthetic', this is 'other'"):
        opened(path, model="other")
    gallery = opened(path)
    assert len(gallery) == 3, "and nothing is locked"
    gallery.close()


def test_a_link_in_the_place_of_the_file_is_not_followed(path, tmp_path):
    other = tmp_path / "other"
    other.write_bytes(packed(people()))
    path.parent.mkdir(mode=0o700)
    path.symlink_to(other)
    with pytest.raises(StoreError, match="cannot be read"):
        opened(path)
    assert other.exists()


def test_a_directory_that_others_can_read_is_refused(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    os.chmod(str(shared), 0o755)
    (shared / "faces.npz").write_bytes(packed(people()))
    with pytest.raises(StoreError, match="chmod 700"):
        opened(shared / "faces.npz")
    assert (shared / "faces.npz").exists()


def test_a_file_that_another_process_holds_is_refused_and_left_alone(path, monkeypatch):
    write(path, packed(people()))
    descriptor = stored_gallery.hold(path)
    monkeypatch.setattr(stored_gallery, "hold", lambda path, hold=stored_gallery.hold: hold(path, 0.1))
    with pytest.raises(StoreError, match="in use"):
        opened(path)
    os.close(descriptor)
    gallery = opened(path)
    assert len(gallery) == 3
    gallery.close()


IMPORTER = """
import sys
from hri_pipeline.core.recognition.stored_gallery import open_gallery
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
print("ready", flush=True)
open_gallery(sys.argv[1], "synthetic", {}, TemplateCalibration(0.36, 0.40, 0.018, 0.15)).close()
""".format(SIZE)


@pytest.mark.slow("starts eight processes")
def test_killed_while_the_people_are_moved(path):
    """Whoever is killed at any moment leaves the people in the old file, in the store, or in both; two at once lose
    none."""
    random = np.random.RandomState(0)
    source = Path(stored_gallery.__file__).resolve().parents[3]
    environment = dict(os.environ, PYTHONPATH=str(source), OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    for attempt in range(4):
        target = path.parent / str(attempt) / path.name
        target.parent.mkdir(mode=0o700, parents=True)
        os.chmod(str(path.parent), 0o700)
        target.write_bytes(packed(people(100)))
        writers = [subprocess.Popen([sys.executable, "-c", IMPORTER, str(target)], stdout=subprocess.PIPE,
                                    env=environment)
                   for _ in range(2)]
        for writer in writers:
            assert writer.stdout.readline() == b"ready\n"
            writer.stdout.close()
        time.sleep(random.uniform(0.0, 0.08))
        for writer in writers:
            writer.send_signal(signal.SIGKILL)
            writer.wait()
        said = []
        gallery = opened(target, notify=said.append)
        assert len(gallery) == 100 and not any("damaged" in line for line in said)
        assert not list(target.parent.glob("faces.npz*[!k]")), "only the lock is left"
        gallery.close()
