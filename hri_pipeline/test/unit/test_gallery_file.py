"""The gallery on disk: private, replaced as a whole, damaged files set aside, one writer."""

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hri_pipeline.core.private_file import StoreError, Transform, replace_file
from hri_pipeline.core.recognition import gallery_file
from hri_pipeline.core.recognition.gallery import KnownPerson
from hri_pipeline.core.recognition.gallery_file import DamagedStore, FileGallery, pack, unpack
from hri_pipeline.core.recognition.likelihood import Calibration
from hri_pipeline.evaluation.synthetic_templates import SIZE
from hri_pipeline.evaluation.synthetic_templates import template as face

CALIBRATION = Calibration(midpoint=0.36, fair_midpoint=0.40, scale=0.018, near=0.15)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "private" / "faces.gallery"


def opened(path, **options):
    return FileGallery(path, "synthetic", SIZE, CALIBRATION, **options)


def stored(path, persons=3):
    gallery = opened(path)
    for seed in range(persons):
        gallery.add_person("person{}".format(seed), np.stack([face(seed), face(seed, 0.3)]), enrolled=seed == 1)
    gallery.close()


def test_the_same_person_in_another_run(path):
    stored(path)
    again = opened(path)
    assert again.ids() == ["person0", "person1", "person2"]
    assert again.match(face(1, 0.1)[None])[0].candidates[0].person_id == "person1"
    assert again.export("person1").enrolled and not again.export("person0").enrolled
    assert np.array_equal(again.export("person2").templates, np.stack([face(2), face(2, 0.3)]))
    again.close()
    again.close()


def test_nobody_else_can_read_it(path):
    mask = os.umask(0)
    try:
        stored(path)
    finally:
        os.umask(mask)
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert {stat.S_IMODE(file.stat().st_mode) for file in path.parent.iterdir()} == {0o600}
    os.chmod(str(path), 0o644)
    opened(path).close()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_directory_that_others_can_read_is_refused(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir(mode=0o755)
    os.chmod(str(shared), 0o755)
    with pytest.raises(StoreError, match="chmod 700"):
        opened(shared / "faces.gallery")


def test_nothing_but_ids_and_templates_is_in_it(path):
    stored(path)
    assert len(path.read_bytes()) < 6 * SIZE * 4 + 2500
    with pytest.raises(ValueError, match="pickle|contains|Cannot|load"):
        np.load(str(path), allow_pickle=False)


def test_cut_off_at_every_byte(path):
    stored(path)
    whole = path.read_bytes()
    for length in range(len(whole)):
        with pytest.raises(DamagedStore):
            unpack(whole[:length], "synthetic", SIZE)
    assert len(unpack(whole, "synthetic", SIZE)) == 3


@pytest.mark.parametrize("part", [0, 1, 7, 30, 52, 53, 400, -1])
def test_a_damaged_file_is_set_aside_and_said(path, part):
    stored(path)
    whole = path.read_bytes()
    broken = whole[:part] if part in (0, 1, 30) else bytearray(whole)
    if part not in (0, 1, 30):
        broken[part] ^= 0x40
    path.write_bytes(broken)
    said = []
    gallery = opened(path, notify=said.append, clock=lambda: 1.7e9)
    assert gallery.ids() == []
    aside = path.parent / "faces.gallery.damaged-20231114T221320Z"
    assert aside.read_bytes() == bytes(broken), "kept, not overwritten"
    assert len(said) == 1 and str(path) in said[0] and str(aside) in said[0]
    gallery.add_person("newby", face(9)[None])
    gallery.close()
    assert opened(path).ids() == ["newby"] and aside.exists()


def test_two_damaged_files_in_one_second_are_both_kept(path):
    stored(path)
    for content in (b"one", b"two"):
        path.write_bytes(content)
        opened(path, clock=lambda: 1.7e9).close()
    kept = {file.read_bytes() for file in path.parent.glob("*.damaged-*")}
    assert kept == {b"one", b"two"}


def test_a_newer_schema_is_refused_and_left_alone(path, monkeypatch):
    monkeypatch.setattr(gallery_file, "SCHEMA", 2)
    stored(path)
    monkeypatch.undo()
    before = path.read_bytes()
    with pytest.raises(StoreError, match="newer") as error:
        opened(path)
    assert str(path) in str(error.value) and path.read_bytes() == before
    monkeypatch.setattr(gallery_file, "SCHEMA", 2)
    assert len(opened(path)) == 3, "and the lock was given back"


def test_templates_of_another_network_are_refused_and_left_alone(path):
    stored(path)
    before = path.read_bytes()
    with pytest.raises(StoreError, match="synthetic"):
        FileGallery(path, "other", SIZE, CALIBRATION)
    assert path.read_bytes() == before


def test_contradictions_are_damage():
    persons = [KnownPerson("anna", face(1)[None]), KnownPerson("anna", face(2)[None])]
    with pytest.raises(DamagedStore, match="contradict"):
        unpack(pack(persons, "synthetic", SIZE), "synthetic", SIZE)


def test_a_template_that_is_none_is_damage(path):
    path.parent.mkdir(mode=0o700)
    path.write_bytes(pack([KnownPerson("anna", 3.0 * face(1)[None])], "synthetic", SIZE))
    assert opened(path).ids() == [] and len(list(path.parent.glob("*.damaged-*"))) == 1


def test_a_second_writer_is_refused(path):
    first = opened(path)
    with pytest.raises(StoreError, match="in use"):
        opened(path)
    first.close()
    opened(path).close()


def test_forgetting_leaves_nothing_on_the_disk(path):
    stored(path)
    path.write_bytes(path.read_bytes()[:-1])
    gallery = opened(path, notify=lambda text: None)
    gallery.add_person("anna", face(1)[None])
    gallery.add_person("bert", face(2)[None])
    gallery.flush()
    assert len(gallery.damaged_files()) == 1
    gallery.remove("anna")
    left = b"".join(file.read_bytes() for file in path.parent.iterdir())
    assert b"anna" not in left and face(1).tobytes()[:16] not in left and b"person1" not in left
    assert b"bert" in left
    gallery.clear()
    left = b"".join(file.read_bytes() for file in path.parent.iterdir())
    assert b"bert" not in left and face(2).tobytes()[:16] not in left
    gallery.close()


def test_what_the_old_file_held_is_overwritten(path):
    stored(path)
    old = open(str(path), "rb")
    replace_file(path, b"new")
    assert not any(old.read()) and path.read_bytes() == b"new"
    old.close()


def test_nothing_is_written_when_nothing_has_changed(path):
    gallery = opened(path)
    gallery.flush()
    assert not path.exists()
    gallery.add_person("anna", face(1)[None])
    gallery.flush()
    before = path.stat().st_ino
    gallery.flush()
    assert path.stat().st_ino == before
    gallery.close()


def test_a_disk_that_cannot_be_written_is_said_and_the_old_file_stays(path, monkeypatch):
    stored(path)
    gallery = opened(path)
    gallery.add_person("anna", face(9)[None])

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match="No space") as error:
        gallery.flush()
    assert str(path) in str(error.value)
    assert len(unpack(path.read_bytes(), "synthetic", SIZE)) == 3
    monkeypatch.undo()
    gallery.close()
    assert len(opened(path)) == 4


class Masked(Transform):
    """Stands for encryption: what is written cannot be read as it is."""

    name = "masked"

    def pack(self, content):
        return b"masked" + bytes(255 - value for value in content)

    def unpack(self, stored):
        if not stored.startswith(b"masked"):
            raise ValueError("not masked")
        return bytes(255 - value for value in stored[6:])


def test_a_transform_changes_what_is_on_the_disk(path):
    gallery = opened(path, transform=Masked())
    gallery.add_person("anna", face(1)[None])
    gallery.close()
    assert b"anna" not in path.read_bytes()
    assert opened(path, transform=Masked()).ids() == ["anna"]


@pytest.mark.parametrize("write, read", [(None, Masked()), (Masked(), None)])
def test_a_file_of_another_key_is_refused_and_left_alone(path, write, read):
    gallery = opened(path, transform=write)
    gallery.add_person("anna", face(1)[None])
    gallery.close()
    before = path.read_bytes()
    with pytest.raises(StoreError, match="key"):
        opened(path, transform=read)
    assert path.read_bytes() == before


def test_a_link_in_the_place_of_the_file_is_not_followed(path, tmp_path):
    stored(path)
    other = tmp_path / "other"
    os.rename(str(path), str(other))
    os.symlink(str(other), str(path))
    with pytest.raises(StoreError, match="cannot be read"):
        opened(path)


WRITER = """
import sys
import numpy as np
from hri_pipeline.core.recognition.gallery_file import FileGallery
from hri_pipeline.core.recognition.likelihood import Calibration
gallery = FileGallery(sys.argv[1], "synthetic", 128, Calibration(0.36, 0.40, 0.018, 0.15))
vectors = np.eye(128, dtype=np.float32)
print("ready", flush=True)
while True:
    for count in range(128):
        gallery.add_person("p{}".format(count), vectors[count:count + 1])
        gallery.flush()
        print(count, flush=True)
    gallery.clear()
"""


def test_killed_while_writing(path):
    """Whoever is killed at any moment leaves the old file or the new one, and the next one can open it."""
    random = np.random.RandomState(0)
    source = Path(gallery_file.__file__).resolve().parents[3]
    environment = dict(os.environ, PYTHONPATH=str(source), OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    for _ in range(3):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, env=environment)
        try:
            assert writer.stdout.readline() == b"ready\n"
            for _ in range(random.randint(1, 60)):
                writer.stdout.readline()
        finally:
            writer.send_signal(signal.SIGKILL)
            writer.wait()
            writer.stdout.close()
        said = []
        gallery = opened(path, notify=said.append)
        assert said == [] and not list(path.parent.glob("*.new-*"))
        persons = [gallery.export(person_id) for person_id in gallery.ids()]
        assert all(np.array_equal(person.templates[0], np.eye(128)[int(person.id[1:])]) for person in persons)
        gallery.close()
