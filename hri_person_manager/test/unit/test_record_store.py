"""The register across runs, in a real file."""

from __future__ import annotations

import numpy as np
import pytest

from hri_person_manager.core.demographics import FEMALE
from hri_person_manager.core.person_register import PersonRegister
from hri_person_manager.core.record_store import DAY_S, StoreOfRecords
from hri_pipeline.core.private_file import StoreError
from hri_pipeline.core.recognition.gallery import KnownPerson
from hri_pipeline.core.recognition.person_store import PersonStore
from hri_pipeline.evaluation.full_disk import no_room


def opened(path, **limits):
    return StoreOfRecords(PersonStore(path), **limits)


def test_what_a_full_disk_did_not_take_is_written_when_there_is_room(tmp_path):
    path = tmp_path / "people" / "store.sqlite"
    store = opened(path)
    register = PersonRegister(store)
    register.seen(["ann"], 100.0)
    assert not register.problem
    with no_room():
        register.seen(["bob", "cho"], 101.0)
        assert "bob" in register and "cho" in register
        assert "2 persons" in register.problem and "make room" in register.problem
        with pytest.raises(StoreError, match="make room"):
            register.set_name("ann", "Ann")
        register.write_pending()
        assert register.problem
    register.write_pending()
    assert not register.problem
    store.close()
    store = opened(path)
    assert {record.id: record.name for record in store.load_records()} == {"ann": "Ann", "bob": "", "cho": ""}
    store.close()


def test_a_name_that_a_full_disk_did_not_take_can_be_given_again(tmp_path):
    path = tmp_path / "people" / "store.sqlite"
    store = opened(path)
    register = PersonRegister(store)
    register.seen(["ann"], 100.0)
    with no_room(), pytest.raises(StoreError):
        register.set_name("ann", "Ann")
    register.set_name("ann", "Ann")
    store.close()
    store = opened(path)
    assert store.load_records()[0].name == "Ann"
    store.close()


@pytest.mark.parametrize("forget", [lambda register: register.forget("ann"), lambda register: register.forget_all() == 1])
def test_whom_a_full_disk_does_not_let_go_can_be_forgotten_again(tmp_path, forget):
    path = tmp_path / "people" / "store.sqlite"
    store = opened(path)
    register = PersonRegister(store)
    register.seen(["ann"], 100.0)
    with no_room(), pytest.raises(StoreError, match="make room"):
        forget(register)
    assert "ann" in register
    assert forget(register)
    assert store.load_records() == []
    store.close()


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
    store.close()
    store = opened(path)
    second = PersonRegister(store)
    assert second.records == first.records
    assert second.demographics("ann").age == 33.0
    store.close()


def test_a_forgotten_person_is_in_no_byte_of_the_file_or_its_journal(tmp_path):
    path = tmp_path / "people" / "store.sqlite"
    people = PersonStore(path)
    store = StoreOfRecords(people)
    register = PersonRegister(store)
    register.seen(["annsecretid", "bob"], 100.0)
    register.set_name("annsecretid", "Wilhelmina Unforgettable")
    template = np.random.default_rng(1).normal(size=(1, 16)).astype(np.float32)
    template /= np.linalg.norm(template)
    people.put_templates(KnownPerson("annsecretid", template, True), "net", 100.0)

    def traces():
        content = b"".join(file.read_bytes() for file in path.parent.iterdir())
        return [trace for trace in (b"annsecretid", b"Wilhelmina", template.astype("<f4").tobytes()) if trace in content]

    assert len(traces()) == 3
    assert register.forget("annsecretid")
    assert traces() == []
    store.close()
    assert traces() == []


def test_the_unseen_and_the_surplus_expire(tmp_path):
    store = opened(tmp_path / "people" / "store.sqlite", max_age_days=10.0, max_persons=2)
    register = PersonRegister(store)
    for number, name in enumerate(("old", "one", "two", "three")):
        register.seen([name], 20.0 * DAY_S + number)
    register.seen(["old"], 1.0)
    assert sorted(store.expire(20.0 * DAY_S + 60.0)) == ["old", "one"]
    assert [record.id for record in store.load_records()] == ["three", "two"]
    store.close()


def test_a_writer_in_the_other_process_keeps_its_templates(tmp_path):
    path = tmp_path / "people" / "store.sqlite"
    recogniser, store = PersonStore(path), opened(path)
    template = np.eye(1, 8, dtype=np.float32)
    recogniser.put_templates(KnownPerson("ann", template, False), "net", 5.0)
    register = PersonRegister(store)
    register.set_name("ann", "Ann")
    assert len(recogniser.load_templates("net", 8)) == 1
    recogniser.close()
    store.close()
