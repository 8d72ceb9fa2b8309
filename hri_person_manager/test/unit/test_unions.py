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
