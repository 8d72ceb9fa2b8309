"""Which persons are one human."""

from __future__ import annotations

import pytest

from hri_person_manager.core.unions import MAX_UNIONS, Unions

ORDER = {"ann": 0, "bob": 1, "eve": 2}


def settled(unions, persons=("ann", "bob", "eve")):
    unions.settle(persons, ORDER.__getitem__)
    return {person: unions.target(person) for person in persons}


def test_persons_are_joined_from_the_threshold_on_and_parted_below():
    unions = Unions(0.5)
    assert not unions.set("eve", "bob", 0.4)
    assert settled(unions) == {"ann": "ann", "bob": "bob", "eve": "eve"}
    assert unions.set("eve", "bob", 0.5)
    assert settled(unions) == {"ann": "ann", "bob": "bob", "eve": "bob"}
    assert not unions.set("bob", "eve", 0.9)
    assert unions.set("bob", "eve", 0.0)
    assert settled(unions)["eve"] == "eve" and unions.pairs == ()


def test_a_chain_has_one_target_and_breaks_in_the_middle():
    unions = Unions(0.5)
    unions.set("eve", "bob", 0.9)
    unions.set("bob", "ann", 0.9)
    assert settled(unions) == {"ann": "ann", "bob": "ann", "eve": "ann"}
    assert unions.members("ann") == ["ann", "bob", "eve"]
    assert unions.split("bob")
    assert settled(unions) == {"ann": "ann", "bob": "bob", "eve": "eve"}
    assert not unions.split("bob")


def test_absent_persons_join_nobody_and_forgotten_ones_are_gone():
    unions = Unions(0.5)
    unions.set("ann", "bob", 0.9)
    assert settled(unions, ("bob",)) == {"bob": "bob"}
    assert settled(unions, ("ann", "bob")) == {"ann": "ann", "bob": "ann"}
    unions.remove("ann")
    assert settled(unions, ("ann", "bob")) == {"ann": "ann", "bob": "bob"}


def test_settle_tells_whether_a_target_changed():
    unions = Unions(0.5)
    unions.set("ann", "bob", 0.9)
    assert unions.settle(["ann", "bob"], ORDER.__getitem__)
    assert not unions.settle(["ann", "bob"], ORDER.__getitem__)


def test_a_person_and_itself_are_no_union_and_the_number_is_bounded():
    unions = Unions(0.5)
    with pytest.raises(ValueError):
        unions.set("ann", "ann", 0.9)
    for number in range(2 * MAX_UNIONS):
        unions.set("a%d" % number, "b%d" % number, 0.9)
    assert len(unions.pairs) == MAX_UNIONS


def test_what_is_seen_joins_until_it_is_told_otherwise():
    unions = Unions(0.5)
    assert unions.see("bob", "ann", 0.8) and unions.seen == (("ann", "bob", 0.8),) and unions.pairs == ()
    assert settled(unions)["bob"] == "ann"
    assert unions.set("ann", "bob", 0.2), "told that they are two"
    assert settled(unions)["bob"] == "bob" and unions.seen == ()
    assert unions.set("ann", "bob", 0.0), "nothing is told any more"
    assert settled(unions)["bob"] == "ann"
    assert unions.see("ann", "bob", 0.0)
    assert settled(unions)["bob"] == "bob"


def test_what_is_told_stays_when_it_is_not_seen_any_more():
    unions = Unions(0.5)
    unions.set("ann", "bob", 0.9)
    assert not unions.see("ann", "bob", 0.8)
    assert not unions.see("ann", "bob", 0.0)
    assert settled(unions)["bob"] == "ann"


def test_whom_a_user_has_parted_sight_does_not_join_again_but_the_user_does():
    unions = Unions(0.5)
    unions.see("ann", "bob", 0.8)
    unions.see("bob", "eve", 0.8)
    assert unions.split("eve") and not unions.split("eve")
    assert not unions.see("eve", "bob", 0.8) and not unions.see("eve", "ann", 0.8)
    assert settled(unions) == {"ann": "ann", "bob": "ann", "eve": "eve"}
    assert unions.set("eve", "bob", 1.0)
    assert settled(unions) == {"ann": "ann", "bob": "ann", "eve": "ann"}


def test_the_number_of_pairs_seen_and_parted_is_bounded():
    unions = Unions(0.5)
    for number in range(MAX_UNIONS + 50):
        unions.see("a%d" % number, "b%d" % number, 0.9)
        unions.split("a%d" % number)
        unions.see("c%d" % number, "d%d" % number, 0.9)
    assert len(unions.seen) == MAX_UNIONS and len(unions._parted) == MAX_UNIONS
    unions.remove("c%d" % (MAX_UNIONS + 49))
    assert len(unions.seen) == MAX_UNIONS - 1
