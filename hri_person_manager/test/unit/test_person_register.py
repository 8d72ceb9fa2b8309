"""Names, languages, demographics and forgetting."""

from __future__ import annotations

import pytest

from hri_person_manager.core.demographics import FEMALE, MALE, UNDEFINED, Demographics
from hri_person_manager.core.person_register import LONGEST_NAME, PersonRecord, PersonRegister, RegisterError


class Shelf:
    """A store in memory that counts what is written."""

    def __init__(self, records=()):
        self.records = {record.id: record for record in records}
        self.written = 0

    def load_records(self):
        return list(self.records.values())

    def put_record(self, record):
        self.written += 1
        self.records[record.id] = record

    def remove_record(self, person_id):
        self.records.pop(person_id, None)

    def remove_all(self):
        self.records.clear()


def register():
    shelf = Shelf()
    made = PersonRegister(shelf)
    made.seen(["ann", "bob"], 5.0)
    return made, shelf


def test_what_is_set_is_there_in_the_next_run():
    first, shelf = register()
    first.set_name("ann", "  Ann Øre ")
    first.set_native_language("ann", "pt-BR")
    first.set_enrolled("ann", True, 6.0)
    first.set_alias("bob", "ann")
    assert first.observe("ann", "f1", 40.0, 0.8, FEMALE, 0.9, 7.0)
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
    assert shelf.records == before


@pytest.mark.parametrize("tag", ["fr", "pt-BR", "zh-Hant-TW", "es-419", "de-CH-1901", "sl-rozaj", ""])
def test_language_tags(tag):
    book, _ = register()
    book.set_native_language("ann", tag)
    assert book.get("ann").native_language == tag


def test_forgetting_takes_aliases_along_and_leaves_the_others():
    book, shelf = register()
    book.seen(["eve"], 6.0)
    book.set_alias("bob", "ann")
    book.observe("ann", "f1", 40.0, 0.8, FEMALE, 0.9, 7.0)
    assert book.forget("ann") and not book.forget("ann")
    assert list(shelf.records) == ["eve"] and book.demographics("ann") is None
    assert book.forget_all() == 1 and not shelf.records and book.records == []


def test_being_seen_is_not_written_with_every_image():
    book, shelf = register()
    shelf.written = 0
    for number in range(1000):
        book.seen(["ann"], 5.0 + 0.01 * number)
    assert shelf.written == 0
    book.seen(["ann"], 20.0)
    assert shelf.written == 1 and shelf.records["ann"].last_seen == 20.0


def test_export_holds_everything_of_one_and_of_all():
    book, _ = register()
    book.set_name("ann", "Ann")
    assert [entry["name"] for entry in book.export("ann")] == ["Ann"]
    assert [entry["id"] for entry in book.export()] == ["ann", "bob"]


def test_demographics_are_fused_over_faces_each_counted_once():
    fused = Demographics()
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


@pytest.mark.parametrize("numbers", [
    (float("nan"), 0.5, FEMALE, 0.5, 1.0), (-1.0, 0.5, FEMALE, 0.5, 1.0), (30.0, 1.5, FEMALE, 0.5, 1.0),
    (30.0, 0.5, FEMALE, float("inf"), 1.0), (300.0, 0.5, FEMALE, 0.5, 1.0)])
def test_unsound_demographics_are_not_used(numbers):
    fused = Demographics()
    assert not fused.observe("f1", *numbers)
    assert fused.estimate() is None


def test_records_compare_by_value():
    assert PersonRecord("ann") == PersonRecord("ann")
