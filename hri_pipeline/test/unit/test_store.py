"""The store of people: private, whole, forgetting without a trace, shared by two processes; and the thread that
writes."""

import base64
import fcntl
import os
import resource
import signal
import sqlite3
import stat
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.recognition import SIZE
from benchmarks.recognition import template as face
from benchmarks.store import no_room
from hri_pipeline.core.privacy import StoreError, TemplateCipher, make_key_file
from hri_pipeline.core.recognition import database as database_module
from hri_pipeline.core.recognition import store as store_module
from hri_pipeline.core.recognition.database import StoreWriter
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, StoredPerson, read_store

LONG_S = 60.0
ANNA = StoredPerson("anna", "Anna Example", "pt-BR", True, "", 10.0, 20.0, {"age": 33.5, "gender": 1})


@pytest.fixture
def path(tmp_path):
    return tmp_path / "private" / "people.sqlite"


def filled(path, count=3, **options):
    store = PersonStore(path, **options)
    store.put_record(ANNA)
    for number in range(count):
        name = "person{}".format(number)
        store.put_templates(KnownPerson(name, np.stack([face(number), face(number, 0.3)]), number == 1), "net", 100.0)
    return store


def everything(directory):
    return b"".join(file.read_bytes() for file in directory.iterdir())


def test_what_is_written_is_read_in_another_run(path):
    filled(path).close()
    store = PersonStore(path)
    records = {record.id: record for record in store.load_records()}
    assert records["anna"] == ANNA
    assert records["person0"] == StoredPerson("person0", first_seen=100.0, last_seen=100.0)
    known = store.load_templates("net", SIZE)
    assert [(one.id, one.enrolled) for one in known] == [("person0", False), ("person1", True), ("person2", False)]
    assert np.array_equal(known[2].templates, np.stack([face(2), face(2, 0.3)]))
    assert store.load_templates("other", SIZE) == []
    store.close()
    store.close()
    with pytest.raises(StoreError, match="closed"):
        store.load_records()


def test_records_and_templates_do_not_overwrite_each_other(path):
    store = filled(path)
    store.put_record(StoredPerson("person1", "Bert", enrolled=True, last_seen=300.0))
    assert len(store.load_templates("net", SIZE)) == 3
    store.put_templates(KnownPerson("person1", face(9)[None], True), "net", 999.0)
    record = {one.id: one for one in store.load_records()}["person1"]
    assert (record.name, record.last_seen) == ("Bert", 300.0)
    assert store.load_templates("net", SIZE)[0].id == "person1"
    store.close()


def test_nobody_else_can_read_it(path):
    mask = os.umask(0)
    try:
        store = filled(path)
        modes = {file.name: stat.S_IMODE(file.stat().st_mode) for file in path.parent.iterdir()}
    finally:
        os.umask(mask)
    store.close()
    assert "people.sqlite-wal" in modes and set(modes.values()) == {0o600}
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_forgetting_leaves_no_trace_in_file_or_journal(path):
    store = filled(path, 40)
    names = [b"Anna Example", b"pt-BR", b"anna", b"person7", face(7).tobytes()[:12], face(7, 0.3).tobytes()[:12]]
    assert all(name in everything(path.parent) for name in names)
    store.remove_record("anna")
    store.remove_record("person7")
    store.remove_record("nobody")
    left = everything(path.parent)
    assert not [name for name in names if name in left]
    assert b"person8" in left and face(8).tobytes()[:12] in left and len(store.load_records()) == 39
    store.remove_all()
    left = everything(path.parent)
    assert b"person" + b"8" not in left and face(8).tobytes()[:12] not in left and store.load_records() == []
    store.close()


def test_retention_by_age_and_number(path):
    store = PersonStore(path)
    for number in range(10):
        store.put_record(StoredPerson("p{}".format(number), last_seen=100.0 * number))
    assert store.expire(900.0, 0.0, 0) == []
    assert sorted(store.expire(900.0, 750.0, 0)) == ["p0", "p1"]
    assert sorted(store.expire(900.0, 0.0, 5)) == ["p2", "p3", "p4"]
    assert [record.id for record in store.load_records()] == ["p5", "p6", "p7", "p8", "p9"]
    assert b"p3" not in path.read_bytes()
    store.close()


@pytest.mark.parametrize("damage", [
    lambda data: b"", lambda data: data[:1], lambda data: data[:50], lambda data: data[:100], lambda data: data[:4096],
    lambda data: data[:5000], lambda data: data[:-1], lambda data: data[:-4096],
    lambda data: b"x" * len(data), lambda data: data[:4096] + b"\xff" * 4096 + data[8192:]])
def test_a_damaged_store_is_set_aside_and_said(path, damage):
    filled(path, 30).close()
    broken = damage(path.read_bytes())
    path.write_bytes(broken)
    said = []
    store = PersonStore(path, notify=said.append, clock=lambda: 1.7e9)
    assert store.load_records() == []
    aside = path.parent / "people.sqlite.damaged-20231114T221320Z"
    assert aside.read_bytes() == broken
    assert len(said) == 1 and str(path) in said[0] and str(aside) in said[0]
    store.put_record(ANNA)
    store.close()
    assert [record.id for record in PersonStore(path).load_records()] == ["anna"]


@pytest.mark.parametrize("name", ["people.sqlite", "people[1].sqlite"])
def test_who_is_forgotten_is_not_kept_in_a_damaged_file(path, name):
    path = path.with_name(name)
    filled(path).close()
    path.write_bytes(path.read_bytes()[:-1])
    store = PersonStore(path)
    assert b"person1" in everything(path.parent)
    store.remove_record("person1")
    assert b"person1" not in everything(path.parent) and store.damaged_files() == []
    store.close()


def test_cut_off_anywhere_it_is_whole_or_set_aside(path):
    filled(path, 5).close()
    whole = path.read_bytes()
    for length in range(0, len(whole), 2039):
        path.write_bytes(whole[:length])
        said = []
        store = PersonStore(path, notify=said.append)
        assert len(said) == 1 and store.load_records() == []
        store.close()
        for file in path.parent.iterdir():
            file.unlink()


def test_a_new_store_without_room_leaves_nothing_that_looks_damaged(path):
    for _ in range(2):
        with no_room(), pytest.raises(StoreError, match="make room"):
            PersonStore(path)
    store = PersonStore(path)
    assert store.damaged_files() == [] and store.load_records() == []
    store.close()


def test_without_room_nothing_is_lost_and_nothing_set_aside(path):
    store = filled(path)
    with no_room():
        with pytest.raises(StoreError, match="make room"):
            store.put_record(StoredPerson("later"))
        with pytest.raises(StoreError, match="make room"):
            store.remove_record("anna")
    store.put_record(StoredPerson("later"))
    store.close()
    with no_room(), pytest.raises(StoreError, match="make room"):
        PersonStore(path)
    store = PersonStore(path)
    assert [record.id for record in store.load_records()] == ["anna", "later", "person0", "person1", "person2"]
    assert store.damaged_files() == []
    store.close()


def test_traces_that_a_full_disk_has_left_are_erased_later(path, monkeypatch):
    store = filled(path)
    # A file system that has room for the deletion, and none for the file to be written anew.
    whole = store._database.erase
    monkeypatch.setattr(store._database, "erase", lambda: _without_room(whole))
    with pytest.raises(StoreError, match="make room"):
        store.expire(150.0, max_age=120.0, max_persons=0)
    monkeypatch.undo()
    assert "anna" not in [record.id for record in store.load_records()]
    assert store.expire(150.0, max_age=120.0, max_persons=0) == []
    assert b"Anna Example" not in everything(path.parent)
    store.close()


def _without_room(erase):
    with no_room():
        erase()


def test_a_damaged_store_that_another_one_holds_is_left_alone(path):
    first = filled(path)
    first.remove_record("nobody")
    path.write_bytes(b"x" * 8192)
    with pytest.raises(StoreError, match="another process"):
        PersonStore(path)
    assert path.read_bytes() == b"x" * 8192
    first.close()


def test_a_newer_schema_is_refused_and_left_alone(path, monkeypatch):
    newer = database_module.MIGRATIONS + (("ALTER TABLE persons ADD COLUMN shoe_size REAL",),)
    filled(path).close()
    with monkeypatch.context() as patched:
        patched.setattr(database_module, "MIGRATIONS", newer)
        store = PersonStore(path)
        assert len(store.load_records()) == 4, "an older one is brought to the newer schema, with all that is in it"
        store.close()
    with pytest.raises(StoreError, match="newer"):
        PersonStore(path)
    assert not list(path.parent.glob("*.damaged-*"))


def test_a_store_of_the_first_schema_is_read_and_brought_to_the_newest(path):
    path.parent.mkdir(mode=0o700)
    with sqlite3.connect(str(path)) as first:
        for statement in database_module.MIGRATIONS[0]:
            first.execute(statement)
        for name in ("anna", "person0", "person1", "person2"):
            first.execute("INSERT INTO persons VALUES (?, ?, '', 0, '', 1, 2, '{}')", (name, name.upper()))
        first.execute("PRAGMA user_version = 1")
        first.execute("PRAGMA application_id = {}".format(database_module.APPLICATION_ID))
    first.close()
    store = PersonStore(path)
    assert [record.name for record in store.load_records()][0] == "ANNA"
    ids = [record.id for record in store.load_records()]
    assert len(ids) == 4 and store.load_apart() == set()
    store.put_apart([frozenset(ids[:2]), frozenset((ids[0], "nobody"))])
    assert store.load_apart() == {frozenset(ids[:2])}, "of those who are known only"
    store.remove_record(ids[0])
    assert store.load_apart() == set()
    store.close()


@pytest.mark.parametrize("schema", [1, 2, 3])
def test_a_store_with_encrypted_templates_is_refused_without_the_key(path, tmp_path, schema):
    """Names and times were in plain in the first two schemas: it opened, and new people were written in plain."""
    key = TemplateCipher(make_key_file(tmp_path / "key"))
    path.parent.mkdir(mode=0o700)
    with sqlite3.connect(str(path)) as old:
        for statement in (line for lines in database_module.MIGRATIONS[:schema] for line in lines):
            old.execute(statement)
        old.execute("INSERT INTO facts VALUES ('templates', 'fernet')")
        old.execute("INSERT INTO persons VALUES ('anna', 'ANNA', '', 0, '', 1, 2, '{}'%s)" % (
            ", NULL" if schema > 2 else ""))
        old.execute("INSERT INTO templates VALUES ('anna', 'net', 0, ?)", (key.encrypt(face(1).tobytes()),))
        old.execute("PRAGMA user_version = {}".format(schema))
        old.execute("PRAGMA application_id = {}".format(database_module.APPLICATION_ID))
    old.close()
    with pytest.raises(StoreError, match="give the key .store_key. it was made with"):
        PersonStore(path)
    if schema == len(database_module.MIGRATIONS):
        with pytest.raises(StoreError, match="store_key"):
            read_store(path)
    store = PersonStore(path, key)
    assert [record.name for record in store.load_records()] == ["ANNA"]
    assert np.array_equal(store.load_templates("net", SIZE)[0].templates, face(1)[None])
    store.close()
    assert b"ANNA" not in everything(path.parent)


def test_a_database_of_another_program_is_left_alone(path):
    path.parent.mkdir(mode=0o700)
    other = sqlite3.connect(str(path))
    other.execute("PRAGMA application_id = 77")
    other.execute("CREATE TABLE letters (text TEXT)")
    other.commit()
    other.close()
    before = path.read_bytes()
    with pytest.raises(StoreError, match="another program"):
        PersonStore(path)
    assert b"letters" in path.read_bytes() and len(before) == len(path.read_bytes())


def test_two_processes_share_it(path):
    first, second = filled(path), PersonStore(path)
    before = second.version()
    assert second.version() == before
    first.put_record(StoredPerson("bert"))
    assert second.version() != before
    assert "bert" in [record.id for record in second.load_records()]
    second.remove_record("anna")
    assert "anna" not in [record.id for record in first.load_records()]
    assert b"Anna Example" not in everything(path.parent)
    first.close()
    second.close()


@pytest.mark.parametrize("room", [0, 20])
def test_no_half_key_is_left_where_the_disk_is_full(room, tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(StoreError, match="key: File too large"):
            make_key_file(tmp_path / "key")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []
    TemplateCipher(make_key_file(tmp_path / "key"))


def test_templates_can_be_encrypted(path, tmp_path):
    cipher = TemplateCipher(make_key_file(tmp_path / "key"))
    plain = PersonStore(path)       # it was there before anything was encrypted
    filled(path, cipher=cipher).close()
    assert face(1).tobytes()[:8] not in path.read_bytes()
    store = PersonStore(path, cipher=cipher)
    assert np.array_equal(store.load_templates("net", SIZE)[1].templates[0], face(1))
    store.close()
    with pytest.raises(StoreError, match="store_key"):
        PersonStore(path)
    with pytest.raises(StoreError, match="store_key"):
        plain.load_records()
    with pytest.raises(StoreError, match="give the key"):
        plain.load_templates("net", SIZE)
    with pytest.raises(StoreError, match="give the key"):
        plain.put_templates(KnownPerson("bert", face(2)[None]), "net", 1.0)
    plain.close()


@pytest.mark.parametrize("record", [StoredPerson("../x"), StoredPerson(""), StoredPerson("anna", alias="a b")])
def test_ids_are_checked(path, record):
    store = PersonStore(path)
    with pytest.raises(ValueError, match="identifier"):
        store.put_record(record)
    store.close()


def test_a_link_in_its_place_is_refused(path, tmp_path):
    filled(path).close()
    os.rename(str(path), str(tmp_path / "elsewhere"))
    os.symlink(str(tmp_path / "elsewhere"), str(path))
    with pytest.raises(StoreError, match="link"):
        PersonStore(path)


WRITER = """
import sys
import threading
import time
import numpy as np
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, StoredPerson
store = PersonStore(sys.argv[1])
vectors = np.eye(128, dtype=np.float32)
print("ready", flush=True)
while True:
    for count in range(40):
        store.put_templates(KnownPerson("p{}".format(count), vectors[count:count + 2]), "net", 1.0)
        store.put_record(StoredPerson("p{}".format(count), name="name {}".format(count)))
        print(count, flush=True)
    store.remove_all()
"""


def test_killed_while_writing(path):
    """Never damaged, never half a person."""
    random = np.random.RandomState(0)
    source = Path(store_module.__file__).resolve().parents[3]
    environment = dict(os.environ, PYTHONPATH=str(source), OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    for _ in range(3):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, env=environment)
        try:
            assert writer.stdout.readline() == b"ready\n"
            for _ in range(random.randint(1, 50)):
                writer.stdout.readline()
        finally:
            writer.send_signal(signal.SIGKILL)
            writer.wait()
            writer.stdout.close()
        said = []
        store = PersonStore(path, notify=said.append)
        assert said == []
        for person in store.load_templates("net", 128):
            assert np.array_equal(person.templates, np.eye(128)[int(person.id[1:]):int(person.id[1:]) + 2])
        assert all(record.name in ("", "name " + record.id[1:]) for record in store.load_records())
        store.close()


def test_who_finds_another_one_on_a_new_store_holds_it_all_the_same(path):
    """Two that start at once: the second sees an empty file, and asks whether it is alone."""
    path.parent.mkdir(mode=0o700)
    path.touch(mode=0o600)
    first = open(str(path) + ".lock", "w")
    fcntl.flock(first, fcntl.LOCK_SH)
    second = PersonStore(path)
    first.close()
    with open(str(path) + ".lock", "w") as third, pytest.raises(BlockingIOError):
        fcntl.flock(third, fcntl.LOCK_EX | fcntl.LOCK_NB)
    second.close()


def test_a_lock_that_is_not_given_costs_no_descriptor(path, monkeypatch):
    def refused(descriptor, operation):
        raise OSError(37, "No locks available")

    monkeypatch.setattr(database_module.fcntl, "flock", refused)
    before = os.listdir("/proc/self/fd")
    for _ in range(3):
        with pytest.raises(StoreError, match="No locks"):
            PersonStore(path)
    assert len(os.listdir("/proc/self/fd")) == len(before)


# -- the thread that writes


class Disk:
    """Takes what is waiting, unless it is full; `gate` lets it."""

    def __init__(self):
        self.waiting, self.kept, self.is_full, self.calls = [], [], False, 0
        self.gate, self.is_writing = threading.Event(), threading.Event()
        self.gate.set()

    def write(self):
        taken = list(self.waiting)
        self.calls += 1
        self.is_writing.set()
        assert self.gate.wait(LONG_S)
        if self.is_full:
            raise StoreError("full; make room")
        self.kept += taken
        self.waiting = self.waiting[len(taken):]


@pytest.fixture
def disk():
    return Disk()


def test_who_waits_gets_what_was_changed_before_also_while_a_write_is_under_way(disk):
    writer = StoreWriter(disk.write, period=LONG_S)
    disk.waiting.append(1)
    disk.gate.clear()
    early = threading.Thread(target=writer.wait)
    early.start()
    assert disk.is_writing.wait(LONG_S)
    disk.waiting.append(2)
    late = threading.Thread(target=writer.wait)
    late.start()
    assert disk.kept == []
    disk.gate.set()
    late.join(LONG_S)
    early.join(LONG_S)
    assert disk.kept == [1, 2]
    assert writer.close() == ""


def test_it_writes_by_itself(disk):
    writer = StoreWriter(disk.write, period=0.01)
    disk.waiting.append(1)
    end = time.monotonic() + LONG_S
    while disk.kept != [1]:
        assert time.monotonic() < end
        disk.is_writing.clear()
        disk.is_writing.wait(1.0)
    writer.close()


def test_what_fails_is_told_to_who_waits_and_tried_again(disk, monkeypatch):
    monkeypatch.setattr(database_module, "RETRY_S", 0.01)
    said = []
    writer = StoreWriter(disk.write, period=0.01, notify=said.append)
    disk.is_full = True
    disk.waiting.append(1)
    with pytest.raises(StoreError, match="make room"):
        writer.wait()
    assert "make room" in writer.problem and "full; make room" in said
    disk.is_full = False
    writer.wait()
    assert disk.kept == [1] and writer.problem == ""
    writer.close()


def test_the_end_writes_what_is_left_and_can_be_repeated(disk):
    writer = StoreWriter(disk.write, period=LONG_S)
    disk.waiting += [1, 2, 3]
    assert writer.close() == "" and disk.kept == [1, 2, 3]
    assert writer.close() == ""
    with pytest.raises(StoreError, match="closed"):
        writer.wait()


def test_the_end_says_what_could_not_be_written(disk):
    writer = StoreWriter(disk.write, period=LONG_S)
    disk.is_full = True
    disk.waiting.append(1)
    assert "make room" in writer.close()


def test_neither_the_end_nor_who_waits_waits_for_ever(disk):
    writer = StoreWriter(disk.write, period=LONG_S)
    disk.gate.clear()
    with pytest.raises(StoreError, match="another process"):
        writer.wait(0.05)
    assert "another process" in writer.close(0.05)
    disk.gate.set()
    assert writer.close() == ""


@pytest.mark.parametrize("away", ["its file", "its directory", "another in its place"])
def test_a_file_that_goes_while_it_is_used_is_told(path, tmp_path, away):
    """Cleaned up by somebody, or restored from elsewhere: what is written goes nowhere then."""
    store = PersonStore(path)
    store.put_record(StoredPerson("anna"))
    source, target = (path.parent if away == "its directory" else path), tmp_path / "elsewhere"
    source.rename(target)
    if away == "another in its place":
        path.write_bytes(target.read_bytes())
    for use in (lambda: store.put_record(StoredPerson("bert")), store.version, store.load_records,
                lambda: store.expire(0.0, 0.0, 1)):
        with pytest.raises(StoreError, match="put it back"):
            use()
    if away == "another in its place":
        path.unlink()
    target.rename(source)
    store.put_record(StoredPerson("carl"))
    assert [one.id for one in store.load_records()] == ["anna", "carl"], "as if nothing had been"
    store.close()


def test_with_a_key_nothing_tells_who_or_when(path, tmp_path):
    key = TemplateCipher(make_key_file(tmp_path / "key"))
    store = PersonStore(path)       # an earlier version, or a process without the key, wrote this in plain
    anna = StoredPerson("anna", "Anna Example", "pt-BR", True, "", 1234567.0, 2345678.0, {"age": 41.5})
    store.put_record(anna)
    store.close()
    assert b"Anna Example" in everything(path.parent)
    store = PersonStore(path, key)
    assert store.load_records() == [anna] and b"Anna Example" not in everything(path.parent)
    store.put_record(StoredPerson("bert", "Bert Example", "en", False, "anna", 3456789.0, 4567890.0))
    store.put_templates(KnownPerson("carl", face(3)[None]), "net", 5678901.0)
    told = {one.id: one for one in store.load_records()}
    assert (told["bert"].name, told["bert"].alias, told["carl"].first_seen) == ("Bert Example", "anna", 5678901.0)
    store.close()
    left = everything(path.parent)
    words = [b"Example", b"pt-BR", b"41.5"] + [struct.pack(">d", when) for when in (1234567.0, 2345678.0, 5678901.0)]
    assert not [word for word in words if word in left]
    with sqlite3.connect(str(path)) as database:
        # Fernet writes the time of encryption in plain: bytes 1 to 8 of a token.
        tokens = [row[0] for row in database.execute("SELECT sealed FROM persons UNION SELECT template FROM templates")]
    assert {base64.urlsafe_b64decode(token)[1:9] for token in tokens} == {bytes(8)}
    with pytest.raises(StoreError, match="store_key"):
        PersonStore(path).load_records()
    with pytest.raises(StoreError, match="give the key"):
        PersonStore(path, TemplateCipher(make_key_file(tmp_path / "other"))).load_records()
    store = PersonStore(path, key)
    assert store.expire(5678910.0, 2000000.0, 0) == ["anna"] and len(store.load_records()) == 2
    assert store.expire(5678910.0, 0.0, 1) == ["carl"]
    assert b"5678910" not in everything(path.parent), "the times at which the store was used"
    store.close()
