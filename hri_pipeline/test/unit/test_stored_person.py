"""How long people stay in a store: by age and number, and never by a clock that is wrong."""

import pytest

from hri_pipeline.core.privacy import TemplateCipher, make_key_file
from hri_pipeline.core.recognition.store import PersonStore, StoredPerson
from hri_pipeline.core.recognition.stored_person import BACK_S, DAY_S, Span, StoreClock, judge_retention

NOW = 1.8e9         # s: a day in 2027
MAX_AGE = 30 * DAY_S
WRONG = pytest.mark.parametrize("wrong", [0.0, NOW + 16 * DAY_S, NOW + 400 * DAY_S, NOW + 30000 * DAY_S])
ENCRYPTED = pytest.mark.parametrize("encrypted", [False, True])


@pytest.fixture
def opened(tmp_path):
    stores = []

    def open_store(encrypted=False):
        key = tmp_path / "key"
        if encrypted and not key.exists():
            make_key_file(key)
        stores.append(PersonStore(tmp_path / "people" / "store.sqlite", TemplateCipher(key) if encrypted else None))
        return stores[-1]

    yield open_store
    for store in stores:
        store.close()


def filled(store):
    for name, days in (("ann", 29), ("bob", 10), ("eve", 0)):
        store.put_record(StoredPerson(name, last_seen=NOW - days * DAY_S))
    return store


def ids(store):
    return [record.id for record in store.load_records()]


@WRONG
@ENCRYPTED
def test_nobody_is_lost_by_a_clock_that_starts_wrong(opened, wrong, encrypted):
    store = filled(opened(encrypted))
    assert store.expire(NOW, MAX_AGE, 0) == [] and store.clock_problem == ""
    store.close()
    for _ in range(3):                           # starts of the robot: wrong at first, then as it should be
        store = opened(encrypted)
        for hour in range(48):
            assert store.expire(wrong + 3600.0 * hour, MAX_AGE, 3) == []
        assert "store_max_age" in store.clock_problem
        store.close()
        store = opened(encrypted)
        assert store.expire(NOW + 600.0, MAX_AGE, 0) == [] and store.clock_problem == ""
        store.close()
    assert opened(encrypted).expire(NOW + 1.5 * DAY_S, MAX_AGE, 0) == ["ann"], "the right clock still counts"


@WRONG
def test_the_store_of_an_earlier_version_is_not_lost_either(opened, wrong):
    store = filled(opened())
    assert store.expire(wrong, MAX_AGE, 0) == [] and store.clock_problem
    assert store.expire(NOW + 1.5 * DAY_S, MAX_AGE, 0) == ["ann"]


@WRONG
def test_who_was_seen_while_it_was_wrong_was_seen_lately(opened, wrong):
    store = filled(opened())
    store.expire(NOW, MAX_AGE, 0)
    store.expire(wrong, MAX_AGE, 0)
    store.put_record(StoredPerson("ann", last_seen=wrong + 60.0), is_new=False)
    store.put_record(StoredPerson("new", first_seen=wrong + 60.0, last_seen=wrong + 60.0))
    assert store.expire(wrong + 120.0, MAX_AGE, 3) == ["bob"], "of too many those seen last stay"
    assert store.expire(NOW + 600.0, MAX_AGE, 0) == [] and ids(store) == ["ann", "eve", "new"]
    assert {record.last_seen for record in store.load_records()} == {NOW, NOW + 600.0}
    for day in range(1, 35):
        store.expire(NOW + day * DAY_S, MAX_AGE, 0)
    assert ids(store) == [], "and is not kept for ever"


def test_a_robot_that_was_off_for_long_expires_people_when_the_clock_has_proved_right(opened):
    store = filled(opened())
    store.expire(NOW, MAX_AGE, 0)
    gone = {}
    for day in range(200, 250):
        if day % 5 == 0:
            store.put_record(StoredPerson("eve", last_seen=NOW + day * DAY_S), is_new=False)
        gone.update((name, day) for name in store.expire(NOW + day * DAY_S, MAX_AGE, 0))
    assert gone == {"ann": 231, "bob": 231} and ids(store) == ["eve"] and store.clock_problem == ""


def test_a_clock_that_is_synchronised_needs_no_proof(opened):
    store = filled(opened())
    store.expire(NOW, MAX_AGE, 0)
    assert store.expire(NOW + 25 * DAY_S, MAX_AGE, 0) == [] and store.clock_problem, "not yet"
    assert set(store.expire(NOW + 25 * DAY_S + 60.0, MAX_AGE, 0, True)) == {"ann", "bob"}
    assert store.clock_problem == "" and ids(store) == ["eve"]
    assert store.expire(NOW + 300 * DAY_S, MAX_AGE, 0, True) == ["eve"]


def test_who_was_seen_by_a_wrong_clock_before_it_was_synchronised_was_seen_lately(opened):
    store = filled(opened())
    store.expire(NOW, MAX_AGE, 0)
    wrong = NOW + 100 * DAY_S
    store.expire(wrong, MAX_AGE, 0)
    store.put_record(StoredPerson("bob", last_seen=wrong + 60.0), is_new=False)
    store.expire(wrong + 120.0, MAX_AGE, 0)
    assert set(store.expire(NOW + 200 * DAY_S, MAX_AGE, 0, True)) == {"ann", "eve"}
    assert [record.last_seen for record in store.load_records()] == [NOW + 200 * DAY_S]


def test_who_was_seen_since_a_right_jump_keeps_that_time(opened):
    store = filled(opened())
    store.expire(NOW, MAX_AGE, 0)
    store.expire(NOW + 100 * DAY_S, MAX_AGE, 0)
    store.put_record(StoredPerson("bob", last_seen=NOW + 100 * DAY_S), is_new=False)
    assert set(store.expire(NOW + 101 * DAY_S, MAX_AGE, 0, True)) == {"ann", "eve"}
    assert [record.last_seen for record in store.load_records()] == [NOW + 100 * DAY_S]


def test_a_synchronised_clock_that_is_behind_counts_from_now_on(opened):
    store = filled(opened())
    store.expire(NOW, MAX_AGE, 0)
    assert store.expire(NOW - 50 * DAY_S, MAX_AGE, 0, True) == [] and store.clock_problem == ""
    assert ids(store) == ["ann", "bob", "eve"]
    gone = {}
    for day in range(-49, 0):
        gone.update((name, day) for name in store.expire(NOW + day * DAY_S, MAX_AGE, 0, True))
    assert sorted(gone) == ["ann", "bob", "eve"] and max(gone.values()) < -17, "within 31 days from then"


def test_a_clock_that_jumps_at_each_start_proves_nothing(opened):
    store = filled(opened())
    store.expire(NOW, MAX_AGE, 0)
    for start in range(40):
        wrong = NOW + (1000 + 97 * (start % 7)) * DAY_S
        assert store.expire(wrong, MAX_AGE, 0) == store.expire(wrong + DAY_S, MAX_AGE, 0) == []


def test_small_errors_are_no_jump():
    clock = StoreClock(Span(NOW - 100 * DAY_S, NOW))
    seen = {"ann": NOW - 29 * DAY_S, "bob": NOW + 0.5 * DAY_S}
    for now in (NOW - BACK_S, NOW, NOW + 0.5 * DAY_S):
        verdict = judge_retention(seen, clock, now, MAX_AGE, 0)
        assert (verdict.gone, verdict.redated, verdict.problem, verdict.clock.doubted) == ([], [], "", None)
    assert judge_retention(seen, clock, NOW + 14 * DAY_S, MAX_AGE, 0).gone == ["ann"], "two weeks off"


def test_without_a_limit_of_age_the_clock_is_no_problem():
    clock = StoreClock(Span(NOW - 100 * DAY_S, NOW))
    verdict = judge_retention({"ann": NOW, "bob": NOW - 5.0}, clock, NOW + 4000 * DAY_S, 0.0, 1)
    assert verdict.gone == ["bob"] and verdict.problem == ""


@pytest.mark.parametrize("text", ["", "[]", "{}", "[[1]]", "[[1, 2], [3, 4], [5, 6]]", "[[0, NaN]]", "[[0, 1e300]]",
                                  "[[\"a\", 2]]", "7", "[["])
def test_a_clock_that_cannot_be_read_is_none(text):
    assert StoreClock.from_json(text) is None


@pytest.mark.parametrize("clock", [StoreClock(Span(1.0, 2.5)), StoreClock(Span(1.0, 2.5), Span(7.0, 8.0))])
def test_a_clock_is_read_as_it_was_written(clock):
    assert StoreClock.from_json(clock.to_json()) == clock
