"""Names, languages and demographics of known persons, in memory and across runs in a real file."""

from __future__ import annotations

import math
import sys
import threading
import time
from contextlib import contextmanager
from itertools import count

import numpy as np
import pytest

from benchmarks.store import no_room, write_locked
from hri_person_manager.core.register import (
    DAY_S,
    FEMALE,
    LONGEST_NAME,
    MALE,
    UNDEFINED,
    DemographicsFusion,
    PersonRecord,
    PersonRegister,
    RegisterError,
    SqliteRecordStore,
)
from hri_pipeline.core.privacy import StoreError, TemplateCipher, make_key_file
from hri_pipeline.core.recognition.database import PersonDatabase, StoreWriter
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore


class Shelf:
    """A store in memory that counts what is written."""

    def __init__(self, records=()):
        self.records = {record.id: record for record in records}
        self.written = 0

    def load_records(self):
        return list(self.records.values())

    def write(self, change):
        if change.everybody:
            self.records.clear()
        for person_id in change.removed:
            self.records.pop(person_id, None)
        self.written += len(change.records)
        self.records.update(change.records)
        return []


def register():
    shelf = Shelf()
    made = PersonRegister(shelf)
    made.seen(["ann", "bob"], 5.0)
    made.flush()
    return made, shelf


@pytest.mark.parametrize("name", [
    "\u0639\u0644\u06cc\u200c\u0631\u0636\u0627", "\u0d28\u0d28\u0d4d\u200d\u0d26\u0d41", "O'Neill",
    "Jean-Luc d\u2019Arc", "\u5c0f\u6797\u3000\u5065",
    "No\u00ebl", "Noe\u0308l"])
def test_names_of_all_scripts_are_kept_as_they_are_written(name):
    """Persian and Indic names are written with joiners and non-joiners of no width."""
    first, shelf = register()
    first.set_name("ann", name)
    first.flush()
    assert PersonRegister(shelf).get("ann").name == name


@pytest.mark.parametrize("name", ["\u200c", "a\u200db", "ann\u200c", "\u0639\u200c", "\u202eann",
                                  "a\u2066b", "a\u200bb"])
def test_letters_of_no_width_where_no_script_has_them_are_refused(name):
    """Two names that look the same would be two."""
    first, _ = register()
    with pytest.raises(RegisterError, match="printable"):
        first.set_name("ann", name)


def test_what_is_set_is_there_in_the_next_run():
    first, shelf = register()
    first.set_name("ann", "  Ann Øre ")
    first.set_native_language("ann", "pt-BR")
    first.set_enrolled("ann", True, 6.0)
    first.set_alias("bob", "ann")
    assert first.observe("ann", "f1", 40.0, 0.8, FEMALE, 0.9, 7.0)
    first.flush()
    second = PersonRegister(shelf)
    record = second.get("ann")
    assert (record.name, record.native_language, record.enrolled, record.first_seen) == ("Ann Øre", "pt-BR", True, 5.0)
    assert second.get("bob").alias == "ann" and second.demographics("ann").gender == FEMALE


@pytest.mark.parametrize("wish", [
    lambda book: book.set_name("nobody", "x"), lambda book: book.set_name("ann", "x" * (LONGEST_NAME + 1)),
    lambda book: book.set_name("ann", "a\nb"), lambda book: book.set_name("ann", "a\x00b"),
    lambda book: book.set_native_language("ann", "French!"), lambda book: book.set_native_language("ann", "f"),
    lambda book: book.set_native_language("ann", "fr\n"), lambda book: book.set_native_language("ann", "a-" * 40),
    lambda book: book.set_alias("ann", "nobody"), lambda book: book.export("nobody"),
    lambda book: book.export("no body; drop")])
def test_wishes_that_cannot_be_met_change_nothing(wish):
    book, shelf = register()
    before = dict(shelf.records)
    with pytest.raises(RegisterError):
        wish(book)
    book.flush()
    assert shelf.records == before


@pytest.mark.parametrize("wrong, shown", [("nobody", "nobody"), ("no body" * 20, repr("no body" * 20)[:40])])
def test_a_wrong_id_is_shown_in_short(wrong, shown):
    with pytest.raises(RegisterError, match="known person {};".format(shown)):
        register()[0].export(wrong)


def test_language_tags_are_kept_in_the_form_of_bcp_47():
    book, shelf = register()
    book.set_native_language("ann", "EN_gb")
    book.flush()
    assert book.get("ann").native_language == shelf.records["ann"].native_language == "en-GB"
    with pytest.raises(RegisterError, match="is no IETF language tag"):
        book.set_native_language("ann", "French")
    assert book.get("ann").native_language == "en-GB"
    book.set_native_language("ann", "")
    assert book.get("ann").native_language == ""


def test_forgetting_takes_aliases_along_and_leaves_the_others():
    book, shelf = register()
    book.seen(["eve"], 6.0)
    book.set_alias("bob", "ann")
    book.observe("ann", "f1", 40.0, 0.8, FEMALE, 0.9, 7.0)
    assert book.forget("ann")
    book.flush()
    assert not book.forget("ann")
    assert list(shelf.records) == ["eve"] and book.demographics("ann") is None
    assert book.forget_all() == 1 and book.records == []
    book.flush()
    assert not shelf.records


def test_what_was_said_of_somebody_merged_is_said_of_whom_all_see():
    people, _ = register()
    people.seen(["ann", "bob", "cat"], 1.0)
    people.set_name("bob", "Bob")
    people.set_native_language("cat", "fr")
    assert people.said_of("ann") == people.said_of("nobody") == ("", "")
    people.set_alias("bob", "ann")
    assert people.said_of("ann") == ("Bob", "") and people.said_of("ann", ["cat"]) == ("Bob", "fr")
    people.set_name("ann", "Ann")
    assert people.said_of("ann") == ("Ann", "") and people.said_of("bob") == ("Bob", "")
    people.set_name("ann", "")
    people.set_alias("bob", "")
    assert people.said_of("ann") == ("", "")
    people.set_alias("bob", "ann")
    people.forget("bob")
    assert people.said_of("ann") == ("", "")


def test_what_is_said_of_somebody_can_be_asked_for_while_others_come_and_go():
    """The thread that opens topics asks for it; it got an error, or a name too few for as long as nobody was merged."""
    book, _ = register()
    book.seen(["ann", "bob"], 1.0)
    book.set_name("bob", "Bob")
    book.set_alias("bob", "ann")
    asked, wrong = threading.Event(), []

    def ask():
        try:
            while not asked.is_set():
                if book.said_of("ann") != ("Bob", ""):
                    wrong.append("no name")
        except Exception as error:
            wrong.append(error)

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread = threading.Thread(target=ask)
    thread.start()
    try:
        for _ in range(20):
            for number in range(100):
                book.seen(["p%d" % number], 1.0)
                book.set_alias("p%d" % number, "p0" if number else "")
            for number in range(100):
                book.forget("p%d" % number)
    finally:
        asked.set()
        thread.join()
        sys.setswitchinterval(before)
    assert not wrong


def test_nobody_is_an_alias_of_the_empty_id():
    book, _ = register()
    book.seen(["ann", "bob"], 6.0)
    assert not book.forget("")
    assert "ann" in book and "bob" in book


def test_who_is_forgotten_and_met_again_before_it_is_written_is_somebody_new():
    book, shelf = register()
    book.set_name("ann", "Ann")
    book.forget("ann")
    book.seen(["ann"], 9.0)
    book.set_name("bob", "Bob")
    book.forget_all()
    book.seen(["ann"], 10.0)
    book.flush()
    assert list(shelf.records.values()) == [PersonRecord("ann", first_seen=10.0, last_seen=10.0)]


def test_being_seen_is_not_written_with_every_image():
    book, shelf = register()
    for number in range(1000):
        book.seen(["ann"], 5.0 + 0.01 * number)
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(shelf, "write", None)
            book.flush()
    shelf.written = 0
    for now in (20.0, 3.0):     # and the clock was ahead
        book.seen(["ann"], now)
        book.flush()
        assert shelf.records["ann"].last_seen == now
    assert shelf.written == 2


def test_export_holds_everything_of_one_and_of_all():
    book, _ = register()
    book.set_name("ann", "Ann")
    assert [entry["name"] for entry in book.export("ann")] == ["Ann"]
    assert [entry["id"] for entry in book.export()] == ["ann", "bob"]


def test_faces_of_one_person_that_disagree_on_the_age_make_it_less_sure():
    def fuse(*ages, sure=0.9):
        fused = DemographicsFusion()
        for number, age in enumerate(ages):
            fused.observe("face{}".format(number), age, sure, FEMALE, 0.9, 1.0 + number)
        return fused.estimate().age_confidence

    assert fuse(30.0, 30.0) == pytest.approx(0.9)
    assert fuse(25.0, 65.0) < 0.5 < fuse(30.0, 36.0) < 0.9
    assert fuse(25.0, 45.0) < fuse(25.0, 45.0, 25.0, 45.0) < 0.9, "many are surer of their mean"
    assert 0.5 < fuse(30.0, 36.0, sure=1.0) < 1.0 and fuse(25.0, 65.0, sure=1e-20) < 1e-6


def test_demographics_are_fused_over_faces_each_counted_once():
    fused = DemographicsFusion()
    assert fused.estimate() is None
    for _ in range(50):
        fused.observe("f1", 30.0, 0.5, FEMALE, 0.9, 1.0)
    fused.observe("f2", 40.0, 0.5, FEMALE, 0.8, 2.0)
    estimate = fused.estimate()
    assert estimate.age == pytest.approx(35.0) and estimate.gender == FEMALE and estimate.stamp == 2.0
    assert estimate.age_deviation > 6.3 and 0.8 < estimate.gender_confidence < 0.9
    fused.observe("f3", 35.0, 0.5, MALE, 0.9, 3.0)
    fused.observe("f4", 35.0, 0.5, MALE, 0.9, 3.0)
    assert fused.estimate().gender == UNDEFINED


@pytest.mark.parametrize("faces", [[(30.0, 0.55)], [(30.0, 0.9)], [(25.0, 0.9), (40.0, 0.6)], [(30.0, 0.9)] * 3])
def test_the_deviation_of_an_age_says_what_its_confidence_says(faces):
    """Of images with smoothed noise a confidence of .55 came with a deviation of 6.3 years, as .9 of good ones."""
    fused = DemographicsFusion()
    for number, (age, sure) in enumerate(faces):
        fused.observe("f%d" % number, age, sure, FEMALE, 0.9, 1.0)
    found = fused.estimate()
    within = math.erf(10.0 / (found.age_deviation * math.sqrt(2.0)))
    assert within == pytest.approx(found.age_confidence, abs=1e-6)


@pytest.mark.parametrize("sure", [1e-20, 1.0])
def test_ages_that_nobody_can_be_so_sure_of_have_a_deviation(sure):
    fused = DemographicsFusion()
    fused.observe("f1", 30.0, sure, FEMALE, 0.9, 1.0)
    assert 1.0 < fused.estimate().age_deviation <= 100.0


def test_of_many_faces_of_one_person_the_last_twenty_count():
    fused = DemographicsFusion()
    for number, age in [(number, 90.0) for number in range(30)] + [(number, 30.0) for number in range(30, 50)] + [
            (30, 50.0), (50, 30.0)]:
        fused.observe("f%d" % number, age, 0.5, FEMALE, 0.9, 1.0)
    assert fused.estimate().age == pytest.approx(31.0), "f31 was quiet for longest"


def test_faces_that_show_neither_age_nor_gender_take_no_place():
    fused = DemographicsFusion()
    for number in range(50):
        fused.observe("f%d" % number, 40.0, 0.0 if number else 0.8, UNDEFINED, 0.0, 1.0)
    assert fused.estimate().age == 40.0
    fused.observe("f0", 0.0, 0.0, UNDEFINED, 0.0, 2.0)
    assert fused.estimate() is None, "it does not any more"


@pytest.mark.parametrize("shown, age, gender", [
    ((40.0, 0.8, MALE, 0.0), (40.0, 7.803, 0.8), (UNDEFINED, 0.0)),
    ((40.0, 0.8, MALE, 0.59), (40.0, 7.803, 0.8), (UNDEFINED, 0.0)),
    ((40.0, 0.0, MALE, 0.9), (0.0, 0.0, 0.0), (MALE, 0.9))])
def test_of_age_and_gender_one_may_be_known_alone(shown, age, gender):
    fused = DemographicsFusion()
    assert fused.observe("f2", 80.0, 0.0, UNDEFINED, 0.9, 2.0) and fused.estimate() is None, "it shows nothing"
    fused.observe("f1", *shown, 1.0)
    found = fused.estimate()
    assert (found.age, found.age_deviation, found.age_confidence) == pytest.approx(age, abs=1e-3)
    assert (found.gender, found.gender_confidence) == gender and found.stamp == 1.0


@pytest.mark.parametrize("numbers", [
    (float("nan"), 0.5, FEMALE, 0.5, 1.0), (-1.0, 0.5, FEMALE, 0.5, 1.0), (30.0, 1.5, FEMALE, 0.5, 1.0),
    (30.0, 0.5, FEMALE, float("inf"), 1.0), (300.0, 0.5, FEMALE, 0.5, 1.0), (30.0, 0.5, FEMALE, 1.5, 1.0),
    (30.0, 0.5, FEMALE, 0.5, float("inf"))])
def test_unsound_demographics_are_not_used(numbers):
    fused = DemographicsFusion()
    assert not fused.observe("f1", *numbers)
    assert fused.estimate() is None


def test_what_is_set_to_what_it_was_is_not_written():
    book, shelf = register()
    shelf.written = 0
    book.set_name("ann", "")
    book.set_alias("bob", "")
    book.flush()
    assert shelf.written == 0


def test_age_and_gender_are_written_when_they_have_changed_by_much():
    book, shelf = register()

    def written(age, confidence, gender, sure):
        shelf.written = 0
        book.observe("ann", "f1", age, confidence, gender, sure, 7.0)
        book.flush()
        return bool(shelf.written)

    assert [written(*shown) for shown in (
        (40.0, 0.8, FEMALE, 0.9), (41.5, 0.75, FEMALE, 0.85), (42.5, 0.8, FEMALE, 0.9), (42.5, 0.65, FEMALE, 0.9),
        (42.5, 0.65, FEMALE, 0.75), (42.5, 0.65, MALE, 0.75))] == [True, False, True, True, True, True]


def test_of_anonymous_persons_who_have_gone_no_age_is_kept():
    book, _ = register()
    for person in ("ann", "anonymous", "gone"):
        book.observe(person, "f1", 40.0, 0.8, FEMALE, 0.9, 7.0)
    book.keep_demographics(["anonymous"])
    assert [book.demographics(person) is None for person in ("ann", "anonymous", "gone")] == [False, False, True]
    assert not book.forget("anonymous") and book.demographics("anonymous") is None


def test_what_is_set_again_is_not_written_again():
    book, shelf = register()
    written = []
    for _ in range(2):
        shelf.written = 0
        book.set_name("ann", "Ann")
        book.set_native_language("ann", "EN_gb")
        book.set_alias("bob", "ann")
        book.set_enrolled("ann", True, 5.0)
        book.flush()
        written.append(shelf.written)
    assert written == [2, 0], "both persons once"
    assert PersonRegister(shelf).records == book.records


def opened(path, **limits):
    return SqliteRecordStore(PersonStore(path), **limits)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "people" / "store.sqlite"


def filled(path, names=("ann",)):
    store = opened(path)
    register = PersonRegister(store)
    register.seen(names, 100.0)
    register.flush()
    return store, register


def test_what_a_full_disk_did_not_take_is_written_when_there_is_room(path):
    store, register = filled(path)
    with no_room():
        register.seen(["bob", "cho"], 101.0)
        assert "bob" in register and "cho" in register
        with pytest.raises(StoreError, match="2 persons.*make room"):
            register.flush()
        register.set_name("ann", "Ann")
        with pytest.raises(StoreError, match="3 persons.*make room"):
            register.flush()
    register.flush()
    store.close()
    store = opened(path)
    assert {record.id: record.name for record in store.load_records()} == {"ann": "Ann", "bob": "", "cho": ""}
    store.close()


@pytest.mark.parametrize("forget", [lambda register: register.forget("ann"), lambda register: register.forget_all()])
def test_whom_a_full_disk_does_not_let_go_goes_later(path, forget):
    store, register = filled(path)
    with no_room():
        assert forget(register) and "ann" not in register
        with pytest.raises(StoreError, match="make room"):
            register.flush()
    assert register.forget("ann"), "the wish can be repeated"
    register.flush()
    assert store.load_records() == [] and b"ann" not in path.read_bytes() and not register.forget("ann")
    store.close()


@pytest.mark.parametrize("forget", [lambda register: register.forget("bob"), lambda register: register.forget_all()])
def test_who_is_forgotten_while_a_store_refuses_the_record_is_not_written_later(forget):
    class Full(Shelf):
        def write(self, change):
            forget(book)
            raise StoreError("make room")

    shelf = Full()
    book = PersonRegister(shelf)
    book.seen(["bob"], 5.0)
    with pytest.raises(StoreError):
        book.flush()
    shelf.write = super(Full, shelf).write
    book.flush()
    assert not shelf.records


def test_whom_another_process_has_forgotten_is_not_written_again(path):
    filled(path, ("ann", "bob"))[0].close()
    recogniser, store = PersonStore(path), opened(path)
    register = PersonRegister(store)
    recogniser.remove_record("ann")
    register.set_name("ann", "Ann")
    register.set_name("bob", "Bob")
    register.flush()
    register.seen(["ann"], 200.0)
    register.flush()
    register.set_name("ann", "Anna")
    assert register.take_gone() == ["ann"] and "ann" not in register and register.take_gone() == []
    register.flush()
    assert [record.id for record in recogniser.load_records()] == ["bob"]
    register.seen(["ann"], 300.0)
    register.flush()
    assert [record.first_seen for record in recogniser.load_records()] == [300.0, 100.0], "who is met anew is new"
    register.forget_all()
    register.seen(["ann"], 400.0)
    register.flush()
    assert [record.first_seen for record in recogniser.load_records()] == [400.0]
    recogniser.close()
    store.close()


@pytest.fixture
def full_for_erasing(monkeypatch):
    """What was deleted cannot be erased: that rewrites the file, and takes as much room again."""
    @contextmanager
    def make_full():
        def erase(database):
            database.has_traces = True
            if not database._connection.in_transaction:
                raise StoreError("make room")
        with monkeypatch.context() as patched:
            patched.setattr(PersonDatabase, "erase", erase)
            yield
    return make_full


def test_whom_another_process_has_forgotten_is_not_written_again_when_traces_of_others_cannot_be_erased(
        path, full_for_erasing):
    store, register = filled(path, ("ann", "bob"))
    recogniser = PersonStore(path)
    recogniser.remove_record("ann")
    register.set_name("ann", "Ann")
    register.forget("bob")
    for _ in range(2):
        with full_for_erasing(), pytest.raises(StoreError, match="make room"):
            register.flush()
    register.flush()
    assert recogniser.load_records() == [] and register.take_gone() == ["ann"]
    register.seen(["ann"], 300.0)
    register.flush()
    assert [record.first_seen for record in recogniser.load_records()] == [300.0], "who is met anew is new"
    recogniser.close()
    store.close()


def test_who_has_expired_is_told_when_the_traces_could_be_erased(path, full_for_erasing):
    store = opened(path, max_persons=1)
    register = PersonRegister(store)
    register.seen(["ann"], 100.0)
    register.seen(["bob"], 101.0)
    register.flush()
    with full_for_erasing(), pytest.raises(StoreError, match="make room"):
        register.expire(200.0)
    assert [record.id for record in store.load_records()] == ["bob"]
    register.expire(200.0)
    assert register.take_gone() == ["ann"]
    store.close()


def test_persons_do_not_wait_for_a_store_that_another_process_holds(path):
    store, register = filled(path)
    writer = StoreWriter(register.flush, 0.02)
    waits = []
    with write_locked(path):
        end = time.monotonic() + 1.0
        for number in count(1):
            began = time.monotonic()
            register.seen(["ann", "person{}".format(number % 50)], 100.0 * number)
            register.set_name("ann", "Ann {}".format(number))
            register.forget("person{}".format(number % 7))
            register.take_gone()
            waits.append(time.monotonic() - began)
            if began > end:
                break
        with pytest.raises(StoreError, match="another process"):
            writer.wait(0.1)
    writer.wait()
    assert writer.close() == ""
    assert {record.id: record.name for record in store.load_records()} == {
        record.id: record.name for record in register.records}
    store.close()
    assert np.median(waits) < 0.01 and max(waits) < 0.5


def test_what_is_known_comes_back_in_the_next_run(tmp_path):
    path = tmp_path / "people" / "store.sqlite"
    store = opened(path)
    first = PersonRegister(store)
    first.seen(["ann", "bob"], 100.0)
    first.set_name("ann", "Ann Ø")
    first.set_native_language("ann", "da")
    first.set_enrolled("ann", True, 101.0)
    first.set_alias("bob", "ann")
    first.observe("ann", "f1", 33.0, 0.8, FEMALE, 0.9, 102.0)
    first.flush()
    store.close()
    store = opened(path)
    second = PersonRegister(store)
    assert second.records == first.records
    assert second.demographics("ann").age == 33.0
    store.close()
    with pytest.raises(StoreError):
        store.load_records()


def test_a_forgotten_person_is_in_no_byte_of_the_file_or_its_journal(tmp_path):
    path = tmp_path / "people" / "store.sqlite"
    people = PersonStore(path)
    store = SqliteRecordStore(people)
    register = PersonRegister(store)
    register.seen(["annsecretid", "bob"], 100.0)
    register.set_name("annsecretid", "Wilhelmina Unforgettable")
    register.flush()
    template = np.random.default_rng(1).normal(size=(1, 16)).astype(np.float32)
    template /= np.linalg.norm(template)
    people.put_templates(KnownPerson("annsecretid", template, True), "net", 100.0)

    def traces():
        content = b"".join(file.read_bytes() for file in path.parent.iterdir())
        return [trace for trace in (b"annsecretid", b"Wilhelmina", template.astype("<f4").tobytes())
                if trace in content]

    assert len(traces()) == 3
    assert register.forget("annsecretid")
    register.flush()
    assert traces() == []
    store.close()
    assert traces() == []


def test_the_unseen_and_the_surplus_expire(tmp_path):
    store = opened(tmp_path / "people" / "store.sqlite", max_age_days=10.0, max_persons=2)
    register = PersonRegister(store)
    for number, name in enumerate(("old", "one", "two", "three")):
        register.seen([name], 20.0 * DAY_S + number)
    register.seen(["old"], 1.0)
    register.flush()
    register.expire(20.0 * DAY_S + 60.0)
    assert sorted(register.take_gone()) == ["old", "one"]
    assert [record.id for record in register.records] == ["three", "two"]
    assert [record.id for record in store.load_records()] == ["three", "two"]
    store.close()


@pytest.mark.parametrize("encrypted", [False, True])
def test_of_too_many_those_go_first_of_whom_nobody_has_said_anything(tmp_path, encrypted):
    """A lobby: a thousand strangers in a week do not take the names of those who are on holiday."""
    key = tmp_path / "key"
    make_key_file(key)
    people = PersonStore(tmp_path / "people" / "store.sqlite", TemplateCipher(key) if encrypted else None)
    store = SqliteRecordStore(people, max_persons=5)
    register = PersonRegister(store)
    register.seen(["named", "agreed", "spoke", "other_id"], 1.0)
    register.set_name("named", "Ann")
    register.set_enrolled("agreed", True, 1.0)
    register.set_native_language("spoke", "fr")
    register.set_alias("other_id", "named")
    for number in range(20):
        register.seen(["stranger{}".format(number)], 10.0 + number)
    register.flush()
    register.expire(100.0)
    assert sorted(register.take_gone()) == sorted("stranger{}".format(number) for number in range(19))
    for number in range(3):
        register.seen(["last{}".format(number)], 50.0)
        register.set_name("last{}".format(number), "Bob")
    register.flush()
    register.expire(100.0)
    assert len(register.take_gone()) == 3 and len(store.load_records()) == 5, "the limit is one for all"
    assert {"last0", "last1", "last2"} <= {record.id for record in store.load_records()}
    store.close()


def test_who_goes_by_another_id_since_a_merge_is_seen_and_does_not_expire(tmp_path):
    """The templates of a face stand under both ids."""
    store = opened(tmp_path / "people" / "store.sqlite", max_age_days=10.0)
    register = PersonRegister(store)
    register.seen(["ann", "bob", "carl"], 1.0)
    register.set_alias("bob", "ann")
    for day in range(1, 15):
        register.seen(["ann"], day * DAY_S)
    register.flush()
    register.expire(14.0 * DAY_S)
    assert register.take_gone() == ["carl"] and register.get("bob").last_seen == 14.0 * DAY_S
    store.close()


def test_a_writer_in_the_other_process_keeps_its_templates(tmp_path):
    path = tmp_path / "people" / "store.sqlite"
    recogniser, store = PersonStore(path), opened(path)
    template = np.eye(1, 8, dtype=np.float32)
    recogniser.put_templates(KnownPerson("ann", template, False), "net", 5.0)
    register = PersonRegister(store)
    register.set_name("ann", "Ann")
    register.flush()
    assert store.load_records()[0].name == "Ann"
    assert len(recogniser.load_templates("net", 8)) == 1
    recogniser.close()
    store.close()


def test_records_of_a_read_only_store_are_known_and_stay_as_they_are():
    shelf = Shelf()
    made = PersonRegister(shelf, [PersonRecord("ada", "Ada", enrolled=True, last_seen=1.0)])
    made.seen(["ada", "bob"], 50.0)
    made.observe("ada", "face", 30.0, 0.9, FEMALE, 0.9, 50.0)
    made.flush()
    assert set(shelf.records) == {"bob"} and made.get("ada").name == "Ada"
    for change in (lambda: made.set_name("ada", "Eve"), lambda: made.set_enrolled("ada", False, 60.0),
                   lambda: made.forget("ada")):
        with pytest.raises(RegisterError, match="read-only store"):
            change()
    shelf.expire = lambda now: ["ada"]      # a recogniser had her in the own store, too
    made.expire(60.0)
    made.take_gone()
    made.seen(["ada"], 65.0)
    made.forget_all()
    assert made.demographics("ada") is None
    made.seen(["ada"], 70.0)
    made.set_name("ada", "Eve")
    own = PersonRegister(Shelf([PersonRecord("ada", "Own")]), [PersonRecord("ada", "Other")])
    assert own.get("ada").name == "Own", "the own store goes first"
    own.set_name("ada", "New")


def test_without_a_store_nothing_is_kept_of_those_whom_nobody_knows_any_more():
    memory = PersonRegister(borrowed=[PersonRecord("cleo")])
    for number in range(20):
        memory.seen(["p%d" % number], 5.0)
        memory.observe("p%d" % number, "f%d" % number, 40.0, 0.9, FEMALE, 0.9, 5.0)
    memory.set_name("p1", "Ada")
    memory.set_native_language("p2", "fr")
    memory.set_enrolled("p20", True, 6.0)
    memory.set_alias("p4", "p5")
    memory.keep_known({"p6"})
    memory.flush()
    memory.expire(1e9)
    assert [record.id for record in memory.records] == ["cleo", "p1", "p2", "p20", "p4", "p5", "p6"]
    assert memory.demographics("p6") is not None and memory.demographics("p7") is None
    stored, _ = register()
    stored.keep_known(())
    assert [record.id for record in stored.records] == ["ann", "bob"], "a store has limits of its own"


def test_a_restart_forgets_whom_no_store_keeps():
    stored, _ = register()
    stored.restart()
    assert [record.id for record in stored.records] == ["ann", "bob"]
    memory = PersonRegister(borrowed=[PersonRecord("cleo")])
    memory.seen(["ann"], 5.0)
    memory.observe("ann", "f1", 40.0, 0.9, FEMALE, 0.9, 5.0)
    memory.restart()
    assert [record.id for record in memory.records] == ["cleo"] and memory.demographics("ann") is None
