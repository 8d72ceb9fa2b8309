"""A store that is a sound file with broken rows: told with the person and the mend, the rest kept, nothing lost."""

import json
import sqlite3
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.recognition import SIZE
from benchmarks.recognition import template as face
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.privacy import StoreError, TemplateCipher, make_key_file
from hri_pipeline.core.recognition import store as module
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, StoredPerson, read_store
from hri_pipeline.core.recognition.stored_gallery import StoredGallery

CALIBRATION = TemplateCalibration(midpoint=0.38, fair_midpoint=0.40, scale=0.018, near=0.15)
NOW = 1.8e9
ANNA = StoredPerson("anna", "Anna Example", "pt-BR", True, "", 10.0, 20.0, {"age": 33.5, "gender": 1})
BERT = StoredPerson("bert", "Bert Example", "en", True, "anna", 30.0, 40.0)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "private" / "people.sqlite"


@pytest.fixture
def told():
    return []


@pytest.fixture
def cipher(tmp_path):
    return TemplateCipher(make_key_file(tmp_path / "key"))


def opened(path, told, cipher=None):
    return PersonStore(path, cipher, told.append, lambda: NOW)


def filled(path, cipher=None):
    store = opened(path, [], cipher)
    for person in (ANNA, BERT):
        store.put_record(person)
        store.put_templates(KnownPerson(person.id, np.stack([face(1), face(2), face(3)]), True), "net", 1.0)
    store.close()


def spoil(path, statement, *values):
    with sqlite3.connect(str(path)) as database:
        assert database.execute(statement, values).rowcount > 0
    database.close()


def set_aside(path):
    with sqlite3.connect(str(path)) as database:
        rows = database.execute("SELECT person, content FROM damaged").fetchall()
    database.close()
    return rows


@pytest.mark.parametrize("column, value, kept", [
    ("demographics", "{\"age\": 33", {"demographics": {}}),
    ("demographics", "[1, 2]", {"demographics": {}}),
    ("demographics", "{\"age\": \"old\"}", {"demographics": {}}),
    ("demographics", "{\"age\": NaN}", {"demographics": {}}),
    ("demographics", "[" * 100000, {"demographics": {}}),
    ("demographics", b"\xff\xfe", {"demographics": {}}),
    ("name", b"\x00\x01", {"name": ""}),
    ("native_language", b"pt", {"native_language": ""}),
    ("enrolled", "yes", {"enrolled": False}),
    ("alias", "no id!", {"alias": ""}),
    ("first_seen", "long ago", {"first_seen": 20.0}),
    ("last_seen", float("inf"), {"last_seen": 10.0}),
])
def test_what_is_broken_is_set_aside_and_the_rest_kept(path, told, column, value, kept):
    filled(path)
    spoil(path, "UPDATE persons SET {} = ? WHERE id = 'anna'".format(column), value)
    store = opened(path, told)
    records = store.load_records()
    assert records == [StoredPerson(**dict(vars(ANNA), **kept)), BERT]
    assert len(told) == 1 and str(path) in told[0] and "'anna'" in told[0] and "people forget 'anna'" in told[0]
    assert "Example" not in told[0], "names do not get into the log"
    assert {one.id: len(one.templates) for one in store.load_templates("net", SIZE)} == {"anna": 3, "bert": 3}
    store.close()
    (person, content), = set_aside(path)
    row = json.loads(content)
    was = {"hex": value.hex()} if isinstance(value, bytes) else value
    assert person == "anna" and was in row and len(row) == 9, "nothing is lost"
    again = opened(path, told)
    assert again.load_records() == records and len(told) == 1
    again.remove_record("anna")
    again.close()
    assert set_aside(path) == [] and b"Anna Example" not in path.read_bytes(), "what was set aside goes with the person"


def test_text_that_is_no_utf_8_hinders_nobody(path, told):
    filled(path)
    spoil(path, "UPDATE persons SET name = CAST(x'41ff42' AS TEXT) WHERE id = 'anna'")
    store = opened(path, told)
    assert [record.name for record in store.load_records()] == ["", "Bert Example"] and "the name" in told[0]
    store.close()


@pytest.mark.parametrize("spoilt", ["'no id!'", "x'00ff'", "CAST(x'41ff42' AS TEXT)", "''"])
@pytest.mark.parametrize("is_encrypted", [False, True])
def test_whoever_has_no_legal_id_gets_a_new_one_with_all_that_is_known(path, told, cipher, spoilt, is_encrypted):
    cipher = cipher if is_encrypted else None
    filled(path, cipher)
    with sqlite3.connect(str(path)) as database:
        for table, column in (("templates", "person"), ("persons", "id")):
            database.execute("UPDATE {} SET {} = {} WHERE {} = 'bert'".format(table, column, spoilt, column))
    database.close()
    store = opened(path, told, cipher)
    anna, bert = sorted(store.load_records(), key=lambda one: one.first_seen)
    assert is_valid_id(bert.id) and bert.id not in ("anna", "bert")
    assert (anna, bert) == (ANNA, replace(BERT, id=bert.id))
    assert {one.id: len(one.templates) for one in store.load_templates("net", SIZE)} == {"anna": 3, bert.id: 3}
    assert len(told) == 1 and str(path) in told[0] and bert.id in told[0] and "Example" not in told[0]
    again = opened(path, told, cipher)
    assert [one.id for one in again.load_records()] == sorted(["anna", bert.id]) and len(told) == 1
    again.close()
    store.remove_record(bert.id)
    assert [one.id for one in store.load_records()] == ["anna"]
    store.close()
    assert b"Bert Example" not in b"".join(file.read_bytes() for file in path.parent.iterdir())


@pytest.mark.parametrize("is_encrypted", [False, True])
def test_templates_stay_with_whoever_gets_a_new_id_where_only_the_id_is_damaged(path, told, cipher, is_encrypted):
    cipher = cipher if is_encrypted else None
    filled(path, cipher)
    spoil(path, "UPDATE persons SET id = 'no id!' WHERE id = 'bert'")
    store = opened(path, told, cipher)
    new, = {one.id for one in store.load_records()} - {"anna"}
    assert {one.id: len(one.templates) for one in store.load_templates("net", SIZE)} == {"anna": 3, new: 3}
    store.remove_record(new)
    store.close()
    with sqlite3.connect(str(path)) as database:
        assert {row[0] for row in database.execute("SELECT person FROM templates")} == {"anna"}
    database.close()


@pytest.mark.parametrize("statement", [
    "UPDATE templates SET person = 'nobody' WHERE person = 'bert'",
    "UPDATE templates SET person = 'no id!', template = x'00' WHERE person = 'bert' AND number = 1",
    "UPDATE persons SET id = id || '!'",
    "UPDATE templates SET person = CASE number WHEN 0 THEN 'no id!' ELSE 'nobody' END WHERE person = 'bert'"])
def test_templates_of_nobody_go_and_hinder_nobody(path, told, statement):
    filled(path)
    spoil(path, statement)
    store = opened(path, told)
    assert len(store.load_records()) == 2
    known = {one.id: len(one.templates) for one in store.load_templates("net", SIZE)}
    ids = {one.id for one in store.load_records()}
    assert set(known) <= ids and sum("of an id that nobody has" in line for line in told) == 1
    store.close()
    with sqlite3.connect(str(path)) as database:
        assert {row[0] for row in database.execute("SELECT person FROM templates")} <= ids, "who is forgotten is"
    database.close()
    assert opened(path, told).load_templates("net", SIZE) is not None and len(told) <= 3


def test_whoever_has_no_legal_id_is_left_out_of_a_read_only_store(path, told):
    filled(path)
    spoil(path, "UPDATE persons SET id = 'no id!' WHERE id = 'bert'")
    records, known = read_store(path, None, "net", SIZE, told.append)
    assert [one.id for one in records] == ["anna"] == [one.id for one in known]
    assert len(told) == 1 and "'no id!'" in told[0] and "left out" in told[0] and "people forget" not in told[0]


@pytest.mark.parametrize("content", [b"gAAAAA", b"", None, "[1, 2]", "{", "[\"Ann\", \"\", NaN, 2, {}]",
                                     "[\"Ann\", \"\", 1, 2, {\"age\": \"x\"}]"])
def test_also_where_it_is_encrypted(path, told, cipher, content):
    filled(path, cipher)
    if content is None:
        spoil(path, "UPDATE persons SET sealed = 'text' WHERE id = 'anna'")
    else:
        spoil(path, "UPDATE persons SET sealed = ? WHERE id = 'anna'",
              content if isinstance(content, bytes) else cipher.encrypt(content.encode()))
    store = opened(path, told, cipher)
    anna, bert = store.load_records()
    assert bert == BERT and anna.id == "anna" and anna.enrolled and np.isfinite([anna.first_seen, anna.last_seen]).all()
    assert anna.name == ("Ann" if content and "Ann" in str(content) else "") and anna.demographics == {}
    assert len(told) == 1 and "'anna'" in told[0]
    assert len(store.load_templates("net", SIZE)) == 2
    store.close()
    (_, kept), = set_aside(path)
    assert b"anna" not in kept and json.loads(cipher.decrypt(kept))[0] == "anna"


def test_what_was_set_aside_in_plain_is_encrypted_with_the_rest(path, told, cipher):
    filled(path)
    spoil(path, "UPDATE persons SET demographics = '{' WHERE id = 'anna'")
    store = opened(path, told)
    store.load_records()
    store.close()
    spoil(path, "DELETE FROM facts WHERE name = 'templates'")
    spoil(path, "DELETE FROM templates")
    store = opened(path, told, cipher)
    store.close()
    assert b"Example" not in b"".join(file.read_bytes() for file in path.parent.iterdir())
    assert b"Anna Example" in cipher.decrypt(set_aside(path)[0][1])


def test_another_key_is_no_broken_row(path, told, cipher, tmp_path):
    filled(path, cipher)
    with pytest.raises(StoreError, match="give the key"):
        opened(path, told, TemplateCipher(make_key_file(tmp_path / "other"))).load_records()
    assert not told


def test_the_only_row_that_the_key_does_not_open_is_set_aside(path, told, cipher):
    store = opened(path, [], cipher)
    store.put_record(ANNA)
    store.close()
    spoil(path, "UPDATE persons SET sealed = x'00'")
    store = opened(path, told, cipher)
    assert [(one.id, one.name, one.enrolled) for one in store.load_records()] == [("anna", "", True)]
    assert len(told) == 1 and "'anna'" in told[0] and len(set_aside(path)) == 1
    store.close()


def test_the_mark_of_the_key_is_opened_as_bytes(path, told, cipher, monkeypatch):
    """The library of ROS Noetic's system refuses text."""
    decrypt = cipher.decrypt

    def strict(stored):
        if not isinstance(stored, bytes):
            raise TypeError("token must be bytes")
        return decrypt(stored)

    monkeypatch.setattr(cipher, "decrypt", strict)
    filled(path, cipher)
    spoil(path, "DELETE FROM templates")
    spoil(path, "UPDATE persons SET sealed = x'00'")
    store = opened(path, told, cipher)
    assert len(store.load_records()) == 2 and len(told) == 2
    store.close()


def test_a_row_that_the_key_does_not_open_beside_templates_that_it_does(path, told, cipher):
    """A store of an earlier version has no mark of its key."""
    filled(path, cipher)
    spoil(path, "DELETE FROM facts WHERE name = 'key'")
    spoil(path, "UPDATE persons SET sealed = x'00'")
    store = opened(path, told, cipher)
    assert [one.id for one in store.load_records()] == ["anna", "bert"] and len(told) == 2
    assert len(store.load_templates("net", SIZE)) == 2
    store.close()


@pytest.mark.parametrize("is_marked", [False, True])
def test_another_key_changes_nothing_in_a_store(path, told, cipher, tmp_path, is_marked):
    filled(path, cipher)
    if not is_marked:
        spoil(path, "DELETE FROM facts WHERE name = 'key'")
    other = TemplateCipher(make_key_file(tmp_path / "other"))
    for _ in range(2):
        with pytest.raises(StoreError, match="give the key"):
            opened(path, told, other)
        with pytest.raises(StoreError, match="give the key"):
            read_store(path, other, "net", SIZE, told.append)
    store = opened(path, told, cipher)
    assert store.load_records() == [ANNA, BERT] and len(store.load_templates("net", SIZE)) == 2 and not told
    store.close()


def test_another_key_encrypts_no_records_in_plain_beside_templates_that_it_does_not_open(path, told, cipher, tmp_path):
    """As the first two schemas have left them."""
    filled(path, cipher)
    spoil(path, "DELETE FROM facts WHERE name = 'key'")
    spoil(path, "UPDATE persons SET sealed = NULL, name = 'Plain Example'")
    other = TemplateCipher(make_key_file(tmp_path / "other"))
    for _ in range(2):
        with pytest.raises(StoreError, match="give the key"):
            opened(path, told, other)
    store = opened(path, told, cipher)
    assert [one.name for one in store.load_records()] == ["Plain Example"] * 2
    assert [len(one.templates) for one in store.load_templates("net", SIZE)] == [3, 3] and not told
    store.close()


def test_two_who_are_apart_can_be_joined_after_one_got_a_new_id(path, told, monkeypatch):
    monkeypatch.setattr(module.IdGenerator, "new", lambda generator: "aaaaa")
    filled(path)
    with sqlite3.connect(str(path)) as database:
        database.execute("INSERT INTO apart VALUES ('anna', 'no id!')")
        database.execute("UPDATE persons SET id = 'no id!' WHERE id = 'bert'")
    database.close()
    store, pair = opened(path, told), frozenset(["anna", "aaaaa"])
    store.load_records()
    assert store.load_apart() == {pair}
    store.put_apart([], [pair])
    assert store.load_apart() == set()
    store.close()


def test_an_empty_store_takes_any_key_and_keeps_it(path, told, cipher, tmp_path):
    filled(path, cipher)
    store = opened(path, told, cipher)
    store.remove_all()
    store.close()
    other = TemplateCipher(make_key_file(tmp_path / "other"))
    filled(path, other)
    with pytest.raises(StoreError, match="give the key"):
        opened(path, told, cipher)
    assert opened(path, told, other).load_records() == [ANNA, BERT] and not told


@pytest.mark.parametrize("template", [face(2)[:-1].tobytes(), face(2).tobytes()[:-1], b"", "text",
                                      np.zeros(SIZE, "<f4").tobytes(), np.zeros(SIZE // 2, "<f4").tobytes()])
@pytest.mark.parametrize("is_encrypted", [False, True])
def test_the_only_template_is_set_aside_like_others(path, told, cipher, template, is_encrypted):
    cipher = cipher if is_encrypted else None
    store = opened(path, [], cipher)
    store.put_record(ANNA)
    store.put_templates(KnownPerson("anna", face(1)[None], True), "net", 1.0)
    store.close()
    spoil(path, "UPDATE templates SET template = ?",
          cipher.encrypt(template) if is_encrypted and isinstance(template, bytes) else template)
    store = opened(path, told, cipher)
    gallery = StoredGallery(store, "net", SIZE, CALIBRATION)
    assert gallery.ids() == [] and store.load_records() == [ANNA]
    assert len(told) == 1 and "'anna'" in told[0] and "template" in told[0]
    gallery.close()
    assert [person for person, _ in set_aside(path)] == ["anna"]


def test_the_only_template_that_the_key_does_not_open_is_set_aside(path, told, cipher):
    store = opened(path, [], cipher)
    store.put_templates(KnownPerson("anna", face(1)[None], True), "net", 1.0)
    store.close()
    spoil(path, "UPDATE templates SET template = x'00'")
    store = opened(path, told, cipher)
    assert store.load_templates("net", SIZE) == [] and len(told) == 1 and len(set_aside(path)) == 1
    store.close()


@pytest.mark.parametrize("template", [
    face(2)[:-1].tobytes(), face(2).tobytes()[:-1], b"", np.full(SIZE, np.nan, "<f4").tobytes(),
    (2.0 * face(2)).tobytes(), np.zeros(SIZE, "<f4").tobytes(), "text", 7])
@pytest.mark.parametrize("is_encrypted", [False, True])
def test_a_broken_template_costs_no_other(path, told, cipher, template, is_encrypted):
    cipher = cipher if is_encrypted else None
    filled(path, cipher)
    spoil(path, "UPDATE templates SET template = ? WHERE person = 'anna' AND number = 1",
          cipher.encrypt(template) if is_encrypted and isinstance(template, bytes) else template)
    store = opened(path, told, cipher)
    gallery = StoredGallery(store, "net", SIZE, CALIBRATION)
    assert gallery.ids() == ["anna", "bert"]
    assert np.array_equal(gallery.export("anna").templates, np.stack([face(1), face(3)]))
    assert len(told) == 1 and "'anna'" in told[0] and "template" in told[0]
    gallery.close()
    (person, _), = set_aside(path)
    assert person == "anna"


def test_templates_that_are_all_of_another_length_are_another_networks(path, told):
    filled(path)
    store = opened(path, told)
    with pytest.raises(StoreError, match="anna has {} numbers instead of {}".format(SIZE, SIZE + 1)):
        store.load_templates("net", SIZE + 1)
    assert len(store.load_templates("net", SIZE)) == 2 and not told
    store.close()


def test_a_read_only_store_is_read_as_far_as_it_can_be(path, told):
    filled(path)
    spoil(path, "UPDATE persons SET demographics = '{' WHERE id = 'anna'")
    spoil(path, "UPDATE templates SET template = x'00' WHERE person = 'bert' AND number = 0")
    before = path.read_bytes()
    records, known = read_store(path, None, "net", SIZE, told.append)
    assert [record.name for record in records] == ["Anna Example", "Bert Example"]
    assert [len(one.templates) for one in known] == [3, 2]
    assert len(told) == 2 and "left out" in told[0] and path.read_bytes() == before
