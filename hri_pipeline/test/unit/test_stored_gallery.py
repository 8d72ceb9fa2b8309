"""The gallery in the store of people: two recognisers and a person manager on one file."""

import sqlite3
import threading

import numpy as np
import pytest

from benchmarks.recognition import SIZE
from benchmarks.recognition import template as face
from benchmarks.store import forget_undone, no_room, write_locked
from hri_pipeline.core.privacy import StoreError
from hri_pipeline.core.recognition.gallery import GalleryError, MemoryGallery
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, StoredPerson
from hri_pipeline.core.recognition.stored_gallery import StoredGallery, open_gallery

CALIBRATION = TemplateCalibration(midpoint=0.38, fair_midpoint=0.40, scale=0.018, near=0.15)


@pytest.fixture
def store(tmp_path):
    store = PersonStore(tmp_path / "private" / "people.sqlite")
    yield store
    store.close()


@pytest.fixture
def other(store):
    other = PersonStore(store.path)
    yield other
    other.close()


def gallery(store, **options):
    return StoredGallery(store, "net", SIZE, CALIBRATION, **dict({"clock": lambda: 100.0}, **options))


def nearest(gallery, number):
    return gallery.match(face(number)[None])[0].candidates[0].person_id


def test_the_same_people_in_another_run(store, other):
    first = gallery(store)
    first.add_person("anna", np.stack([face(1), face(1, 0.3)]), enrolled=True)
    first.add_person("bert", face(2)[None])
    first.flush()
    second = gallery(other)
    assert second.ids() == ["anna", "bert"] and nearest(second, 2) == "bert"
    assert np.array_equal(second.export("anna").templates, first.export("anna").templates)
    assert second.export("anna").enrolled and not second.export("bert").enrolled


def test_two_who_are_apart_are_so_for_all_and_until_one_is_forgotten(store, other):
    first, second = gallery(store), gallery(other)
    for number, name in enumerate(("anna", "bert", "carl")):
        first.add_person(name, face(number)[None])
    first.keep_apart("bert", "anna")
    first.keep_apart("bert", "carl")
    first.flush()
    second.flush()
    assert second.are_apart("anna", "bert") and second.are_apart("carl", "bert")
    assert not second.are_apart("anna", "carl")
    second.remove("carl")
    second.flush()
    first.flush()
    assert store.load_apart() == {frozenset(("anna", "bert"))} and not first.are_apart("bert", "carl")
    first.merge("bert", "anna")
    first.flush()
    second.flush()
    assert store.load_apart() == set() and not second.are_apart("anna", "bert")


def test_each_network_has_templates_of_its_own_and_those_of_the_others_stay(store, other):
    old = gallery(store)
    old.add_person("anna", face(1)[None], enrolled=True)
    old.flush()
    wide = np.zeros((1, 192), np.float32)
    wide[0, 5] = 1.0
    new = StoredGallery(other, "mobilefacenet", 192, CALIBRATION, clock=lambda: 200.0)
    assert new.ids() == [], "nobody is known by this network"
    new.add_person("anna", wide, enrolled=True)
    new.add_person("bert", wide)
    new.flush()
    old.flush()
    assert old.ids() == ["anna"] and np.array_equal(old.export("anna").templates, face(1)[None])
    assert np.array_equal(store.load_templates("mobilefacenet", 192)[0].templates, wide)
    assert [person.id for person in store.load_templates("net", SIZE)] == ["anna"]
    assert [record.first_seen for record in store.load_records()] == [100.0, 200.0]
    old.remove("anna")
    old.flush()
    new.flush()
    assert new.ids() == ["bert"], "who is forgotten is forgotten by every network"


def test_one_learns_what_the_other_has_learnt(store, other):
    first, second = gallery(store), gallery(other)
    first.add_person("anna", face(1)[None])
    first.flush()
    assert second.ids() == []
    second.flush()
    assert nearest(second, 1) == "anna"
    second.add_template("anna", face(1, 0.3))
    second.add_person("bert", face(2)[None])
    second.flush()
    first.flush()
    assert len(first.export("anna").templates) == 2 and nearest(first, 2) == "bert"


def test_who_is_forgotten_by_one_is_forgotten_by_all(store, other):
    first, second = gallery(store), gallery(other)
    for number, name in enumerate(("anna", "bert", "carl")):
        first.add_person(name, face(number)[None])
    first.flush()
    second.flush()
    first.remove("anna")
    first.flush()
    other.remove_record("bert")
    second.flush()
    first.flush()
    assert first.ids() == second.ids() == ["carl"]
    held = b"".join(file.read_bytes() for file in store.path.parent.iterdir())
    assert b"anna" not in held and b"bert" not in held and face(1).tobytes()[:12] not in held
    second.clear()
    second.flush()
    first.flush()
    assert first.ids() == [] and store.load_records() == []


def test_names_stay_when_templates_are_written(store, other):
    first = gallery(store)
    first.add_person("anna", face(1)[None])
    first.flush()
    other.put_record(StoredPerson("anna", "Anna", enrolled=True, first_seen=1.0, last_seen=2.0))
    first.flush()
    assert first.export("anna").enrolled, "what the manager says of consent holds"
    first.add_template("anna", face(1, 0.3))
    first.flush()
    record, = store.load_records()
    assert record == StoredPerson("anna", "Anna", enrolled=True, first_seen=1.0, last_seen=2.0)


def test_merging_moves_the_templates_and_leaves_the_record(store, other):
    first = gallery(store)
    first.add_person("anna", face(1)[None])
    first.add_person("bert", face(2)[None])
    first.flush()
    first.merge("anna", "bert")
    first.flush()
    assert [(person.id, len(person.templates)) for person in store.load_templates("net", SIZE)] == [("bert", 2)]
    assert [record.id for record in store.load_records()] == ["anna", "bert"], "the alias is the manager's to note"
    second = gallery(other)
    assert second.ids() == ["bert"]


def test_who_is_merged_while_another_process_learns_a_view_stays_merged(store, other):
    first, second = gallery(store), gallery(other)
    first.add_person("anna", face(1)[None])
    first.add_person("bert", face(2)[None])
    first.flush()
    second.flush()
    second.add_template("anna", face(1, 0.3))
    second.keep_apart("anna", "bert")
    second.flush()
    first.merge("anna", "bert")
    first.flush()
    second.flush()
    assert first.ids() == second.ids() == ["bert"]
    assert not first.are_apart("anna", "bert") and not second.are_apart("anna", "bert")
    second.add_person("anna", face(3)[None])
    second.flush()
    first.flush()
    assert sorted(first.ids()) == sorted(second.ids()) == ["anna", "bert"], "the id may be given anew"


def test_nothing_is_written_when_nothing_has_changed(store, other):
    first = gallery(store)
    first.add_person("anna", face(1)[None])
    first.flush()
    before = other.version()
    first.flush()
    first.flush()
    assert other.version() == before


def test_what_others_write_of_records_alone_makes_nobody_read_all_templates_again(store, other, monkeypatch):
    """As every 10 s when somebody was seen: 90 ms of the processor with a thousand people."""
    first = gallery(store)
    first.add_person("anna", face(1)[None])
    first.flush()
    reads = []
    monkeypatch.setattr(store, "load_templates", lambda *given: reads.append(given) or [])
    other.put_record(StoredPerson("anna", "Anna", "fr", last_seen=50.0, demographics={"age": 30.0}), is_new=False)
    first.flush()
    first.flush()
    assert not reads and first.ids() == ["anna"]


@pytest.mark.parametrize("change", [
    lambda other: other.put_templates(KnownPerson("anna", np.stack([face(1), face(1, 0.3)]), False), "net", 1.0),
    lambda other: other.put_templates(KnownPerson("carl", face(3)[None], False), "net", 1.0),
    lambda other: other.put_record(StoredPerson("carl")),
    lambda other: other.put_record(StoredPerson("anna", enrolled=True), is_new=False),
    lambda other: other.put_apart([frozenset(("anna", "bert"))]),
    lambda other: other.remove_record("anna"), lambda other: other.remove_all(),
    lambda other: other.expire(1e9, 1.0, 1)])
def test_what_others_change_of_people_is_read_also_where_a_change_of_ours_was_taken_back(store, other, change):
    first = gallery(store)
    for number, name in enumerate(("anna", "bert"), 1):
        first.add_person(name, face(number)[None])
    first.flush()
    with no_room():
        first.add_person("dora", face(4)[None])
        with pytest.raises(StoreError):
            first.flush()
    before = other.version()
    change(other)
    assert store.version() == other.version() != before
    first.flush()
    first.remove("dora")
    first.flush()
    assert sorted(person.id for person in store.load_templates("net", SIZE)) == sorted(first.ids())
    assert all(np.array_equal(person.templates, first.export(person.id).templates)
               and person.enrolled == first.export(person.id).enrolled for person in store.load_templates("net", SIZE))
    assert store.load_apart() == {frozenset((one, two)) for one in first.ids() for two in first.ids()
                                  if one < two and first.are_apart(one, two)}


def test_a_store_that_marks_no_changes_yet_begins_to(store, other):
    """As one of an earlier version, or whose mark was damaged."""
    first = gallery(store)
    with other.change():
        other._database._connection.execute("DELETE FROM facts WHERE name = 'people'")
    first.flush()
    other.put_templates(KnownPerson("carl", face(3)[None], False), "net", 1.0)
    first.flush()
    assert first.ids() == ["carl"]


def backup(source, target):
    """Copy a store onto another file, which may be in use, as `.backup` and `.restore` of the program sqlite3 do."""
    connections = [sqlite3.connect(str(path)) for path in (source, target)]
    connections[0].backup(connections[1])
    for connection in connections:
        connection.close()


def test_another_file_that_is_restored_over_the_store_is_read_also_after_as_many_changes(store, other, tmp_path):
    first, copy = gallery(store), tmp_path / "copy.sqlite"
    backup(store.path, copy)
    other.put_templates(KnownPerson("anna", face(1)[None], False), "net", 1.0)
    first.flush()
    backup(copy, store.path)
    other.put_templates(KnownPerson("bert", face(2)[None], False), "net", 1.0)
    first.flush()
    assert first.ids() == ["bert"]


def test_a_file_of_an_earlier_version_that_is_restored_over_the_store_tells_changes(store, other, tmp_path):
    old = tmp_path / "old.sqlite"
    backup(store.path, old)
    connection = sqlite3.connect(str(old))
    for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall():
        connection.execute("DROP TRIGGER {}".format(name))
    connection.execute("DELETE FROM facts WHERE name = 'people'")
    connection.commit()
    connection.close()
    first = gallery(store)
    backup(old, store.path)
    first.flush()
    first.flush()
    other.put_templates(KnownPerson("anna", face(1)[None], False), "net", 1.0)
    first.flush()
    other.remove_record("anna")
    first.flush()
    assert not first.ids()


@pytest.mark.parametrize("mark", ["9223372036854775807", "9.3e18", "none", "-1", ""])
def test_changes_are_told_whatever_the_mark_of_the_last_one_was(store, other, mark):
    first = gallery(store)
    with other.change():
        other._database._connection.execute("UPDATE facts SET value = ? WHERE name = 'people'", (mark,))
    for number, name in enumerate(("anna", "bert"), 1):
        first.flush()
        other.put_templates(KnownPerson(name, face(number)[None], False), "net", number)
    first.flush()
    assert first.ids() == ["anna", "bert"]


def test_what_was_changed_here_is_not_lost_when_others_change_something(store, other):
    first, second = gallery(store), gallery(other)
    first.add_person("anna", face(1)[None])
    second.add_person("bert", face(2)[None])
    second.flush()
    first.flush()
    second.flush()
    assert sorted(first.ids()) == sorted(second.ids()) == ["anna", "bert"]


def test_consent_is_not_lost_when_a_template_is_learnt_at_the_same_time(store, other):
    first = gallery(store)
    first.add_person("anna", face(1)[None])
    first.flush()
    other.put_record(StoredPerson("anna", "Anna", enrolled=True))
    first.add_template("anna", face(1, 0.3))
    first.flush()
    record, = other.load_records()
    assert record.enrolled and len(other.load_templates("net", SIZE)[0].templates) == 2


def test_who_is_forgotten_while_another_one_writes_stays_forgotten(store, other):
    """Another process forgets after the gallery was read and before it is written, if it can."""
    forgetting = threading.Thread(target=lambda: other.remove_record("anna"))

    def clock():
        if forgetting.ident is None:
            forgetting.start()
        forgetting.join(0.5)
        return 100.0

    setup = gallery(store)
    setup.add_person("anna", face(1)[None])
    setup.flush()
    first = gallery(store, clock=clock)
    first.add_template("anna", face(1, 0.3))
    first.flush()
    forgetting.join(20.0)
    assert not forgetting.is_alive()
    first.flush()
    assert first.ids() == [] and store.load_records() == []


def test_old_views_do_not_come_back_for_somebody_who_is_learnt_anew(store, other):
    first, second = gallery(store), gallery(other)
    first.add_person("anna", face(1)[None])
    first.flush()
    second.flush()
    second.remove("anna")
    second.flush()
    second.add_person("anna", face(7)[None])
    second.flush()
    first.add_template("anna", face(1, 0.3))
    first.flush()
    assert np.array_equal(first.export("anna").templates, face(7)[None])
    assert np.array_equal(store.load_templates("net", SIZE)[0].templates, face(7)[None])


def test_who_is_known_for_longest_stays_so_when_another_process_learns(store, other):
    first, second = gallery(store), gallery(other)
    first.add_person("anna", face(1)[None])
    first.add_person("anni", face(1, 0.25)[None])
    first.flush()
    second.flush()
    before = second.match(face(1, 0.1)[None])[0]
    first.add_template("anna", face(1, 0.3))
    first.flush()
    second.flush()
    after = second.match(face(1, 0.1)[None])[0]
    assert second.ids() == first.ids() == ["anna", "anni"] and len(second.export("anna").templates) == 2
    assert before.same == after.same == (("anna", "anni"),) and after.candidates[0].person_id == "anna"


def test_that_two_are_apart_is_not_lost_when_another_process_learns(store, other):
    first, second = gallery(store), gallery(other)
    first.add_person("anna", face(1)[None])
    first.add_person("bert", face(2)[None])
    first.flush()
    second.flush()
    first.add_template("anna", face(1, 0.3))
    first.flush()
    second.keep_apart("anna", "bert")
    second.flush()
    assert second.are_apart("anna", "bert") and store.load_apart() == {frozenset(("anna", "bert"))}


def test_a_gallery_without_room_takes_nothing_from_the_others(store, other):
    first, second = gallery(store), gallery(other, max_persons=1)
    first.add_person("anna", face(1)[None])
    first.add_person("bert", face(2)[None])
    first.flush()
    second.flush()
    assert len(second) == 1
    second.add_template("anna", face(1, 0.3))
    second.flush()
    first.flush()
    assert sorted(first.ids()) == ["anna", "bert"] and len(first.export("anna").templates) == 2


@pytest.mark.parametrize("forget", [lambda gallery: gallery.remove("anna"), lambda gallery: gallery.clear()])
def test_forgetting_that_finds_no_room_is_done_later(store, other, forget):
    first, second = gallery(store), gallery(other)
    first.add_person("anna", face(1)[None])
    first.flush()
    with no_room():
        forget(first)
        with pytest.raises(StoreError, match="make room"):
            first.flush()
    assert first.ids() == []
    second.add_person("bert", face(2)[None])
    second.flush()
    first.flush()
    second.flush()
    assert "anna" not in first.ids() + second.ids() + [record.id for record in store.load_records()]


def test_that_two_are_apart_outlasts_a_disk_that_was_full(store, other):
    first = gallery(store)
    first.add_person("anna", face(1)[None])
    first.add_person("bert", face(2)[None])
    first.flush()
    first.keep_apart("anna", "bert")
    with no_room():
        with pytest.raises(StoreError, match="make room"):
            first.flush()
    first.flush()
    assert store.load_apart() == {frozenset(("anna", "bert"))}
    other.put_record(StoredPerson("carl"))
    first.flush()
    assert first.are_apart("anna", "bert")


def test_nobody_waits_for_a_store_that_another_process_holds(store):
    first = gallery(store)
    first.add_person("anna", face(1)[None])
    first.flush()
    with write_locked(store.path):
        writer = threading.Thread(target=first.flush)
        first.remove("anna")
        writer.start()
        first.add_person("bert", face(2)[None])
        first.remove("anna")
        assert nearest(first, 2) == "bert"
        assert writer.is_alive(), "it waits"
    writer.join(20.0)
    first.flush()
    assert [record.id for record in store.load_records()] == ["bert"]


@pytest.mark.slow("two processes run for 4 s")
def test_two_processes_that_learn_and_forget_at_random(tmp_path):
    assert forget_undone(4.0, tmp_path) == 0


@pytest.mark.parametrize("name, kind", [("", MemoryGallery), ("faces.gallery", StoredGallery),
                                        ("people.sqlite", StoredGallery)])
def test_the_ending_tells_the_kind_of_file(tmp_path, name, kind):
    path = str(tmp_path / "private" / name) if name else ""
    for known in ([], ["anna"] if name else []):
        opened = open_gallery(path, "net", SIZE, CALIBRATION)
        assert type(opened) is kind and opened.ids() == known
        if not known:
            opened.add_person("anna", face(1)[None])
        opened.close()
        opened.close()


@pytest.fixture
def borrowing(tmp_path):
    """A gallery of its own file, which knows ada (two views) of a read-only store; and another process on that file."""
    shared = PersonStore(tmp_path / "shared" / "people.sqlite")
    shared.put_record(StoredPerson("ada", "Ada"))
    shared.put_templates(KnownPerson("ada", np.stack([face(1), face(1, 0.3)]), False), "net", 1.0)
    shared.close()
    own = tmp_path / "own" / "people.sqlite"
    opened = open_gallery(str(own), "net", SIZE, CALIBRATION, read_only=[str(shared.path)])
    opened.add_person("bert", face(2)[None])
    opened.flush()
    process = PersonStore(own)
    yield opened, process
    process.close()
    opened.close()


def test_views_of_a_person_of_a_read_only_store_stay(borrowing):
    gallery, _ = borrowing
    gallery.drop_views("ada", face(1, 0.3), 0.2)
    assert len(gallery.export("ada").templates) == 2


def test_who_is_two_people_with_one_of_a_read_only_store_stays_so_when_another_process_writes(borrowing):
    gallery, other = borrowing
    gallery.keep_apart("ada", "bert")
    gallery.flush()
    other.put_record(StoredPerson("carl"))
    gallery.flush()
    assert gallery.are_apart("ada", "bert")
    gallery.add_person("dora", face(3)[None])
    gallery.flush()
    assert gallery.are_apart("ada", "bert") and other.load_apart() == set()


def test_who_comes_into_the_own_store_is_no_longer_one_of_the_read_only_store(borrowing):
    gallery, other = borrowing
    other.put_record(StoredPerson("ada", "Ada"))
    other.put_templates(KnownPerson("ada", face(1, 0.1)[None], True), "net", 2.0)
    gallery.flush()
    assert gallery.export("ada").enrolled and len(gallery.export("ada").templates) == 1
    assert gallery.remove("ada")
    gallery.flush()
    assert [record.id for record in other.load_records()] == ["bert"]


def test_people_of_a_read_only_store_are_known_and_never_changed(tmp_path):
    shared, own = tmp_path / "shared" / "people.sqlite", tmp_path / "own" / "people.sqlite"
    store = PersonStore(shared)
    store.put_record(StoredPerson("ada", "Ada", enrolled=True))
    store.put_templates(KnownPerson("ada", face(1)[None], True), "net", 1.0)
    store.close()
    before = {file.name: file.read_bytes() for file in shared.parent.iterdir()}
    gallery = open_gallery(str(own), "net", SIZE, CALIBRATION, read_only=[str(shared)])
    assert gallery.match(face(1)[None])[0].candidates[0].person_id == "ada"
    gallery.add_person("bert", face(2)[None])
    assert not gallery.add_template("ada", face(1, 0.3))
    for change in (lambda: gallery.remove("ada"), lambda: gallery.enrol("ada", False),
                   lambda: gallery.merge("ada", "bert"), lambda: gallery.merge("bert", "ada")):
        with pytest.raises(GalleryError, match="read-only store"):
            change()
    gallery.close()
    assert {file.name: file.read_bytes() for file in shared.parent.iterdir()} == before
    mine = PersonStore(own)
    assert [record.id for record in mine.load_records()] == ["bert"]
    mine.close()
    with pytest.raises(StoreError, match="read-only store"):
        open_gallery("", "net", SIZE, CALIBRATION, read_only=[str(tmp_path / "absent.sqlite")])
