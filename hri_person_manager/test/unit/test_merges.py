"""Which persons are one human."""

from __future__ import annotations

import pytest

from hri_person_manager.core.merges import MAX_MERGES, ChangeLimit, Merges

ORDER = {"ann": 0, "bob": 1, "eve": 2}


def updated(merges, persons=("ann", "bob", "eve")):
    merges.update(persons, ORDER.__getitem__)
    return {person: merges.representative(person) for person in persons}


def test_persons_are_joined_from_the_threshold_on_and_split_below():
    merges = Merges(0.5)
    assert not merges.set("eve", "bob", 0.4)
    assert updated(merges) == {"ann": "ann", "bob": "bob", "eve": "eve"}
    assert merges.set("eve", "bob", 0.5)
    assert updated(merges) == {"ann": "ann", "bob": "bob", "eve": "bob"}
    assert not merges.set("bob", "eve", 0.9)
    assert merges.set("bob", "eve", 0.0)
    assert updated(merges)["eve"] == "eve" and merges.pairs == ()


def test_a_chain_has_one_representative_and_breaks_in_the_middle():
    merges = Merges(0.5)
    merges.set("eve", "bob", 0.9)
    merges.set("bob", "ann", 0.9)
    assert updated(merges) == {"ann": "ann", "bob": "ann", "eve": "ann"}
    assert merges.members("ann") == ["ann", "bob", "eve"]
    assert merges.split("bob")
    assert updated(merges) == {"ann": "ann", "bob": "bob", "eve": "eve"}
    assert not merges.split("bob")


def test_absent_persons_join_nobody_and_forgotten_ones_are_gone():
    merges = Merges(0.5)
    merges.set("ann", "bob", 0.9)
    assert updated(merges, ("bob",)) == {"bob": "bob"}
    assert updated(merges, ("ann", "bob")) == {"ann": "ann", "bob": "ann"}
    merges.prefer("bob")
    merges.remove("bob")
    assert not merges.is_preferred("bob") and merges.representative("bob") == "bob" and merges.members("ann") == ["ann"]
    assert updated(merges, ("ann", "bob")) == {"ann": "ann", "bob": "bob"}


def test_update_tells_whether_a_representative_changed():
    merges = Merges(0.5)
    merges.set("ann", "bob", 0.9)
    assert merges.update(["ann", "bob"], ORDER.__getitem__)
    assert not merges.update(["ann", "bob"], ORDER.__getitem__)


def test_a_person_and_itself_are_no_merge_and_the_number_is_bounded():
    merges = Merges(0.5)
    with pytest.raises(ValueError):
        merges.set("ann", "ann", 0.9)
    for number in range(2 * MAX_MERGES):
        merges.set("a%d" % number, "b%d" % number, 0.9)
    assert len(merges.pairs) == MAX_MERGES


def test_observed_pairs_are_merged_until_a_report_says_otherwise():
    merges = Merges(0.5)
    assert merges.set_observed("bob", "ann", 0.8) and merges.observed == (("ann", "bob", 0.8),) and merges.pairs == ()
    assert updated(merges)["bob"] == "ann"
    assert merges.set("ann", "bob", 0.2), "told that they are two"
    assert updated(merges)["bob"] == "bob" and merges.observed == ()
    assert merges.set("ann", "bob", 0.0), "nothing is told any more"
    assert updated(merges)["bob"] == "ann"
    assert merges.set_observed("ann", "bob", 0.0)
    assert updated(merges)["bob"] == "bob"


def test_a_report_stays_when_the_pair_is_not_observed_any_more():
    merges = Merges(0.5)
    merges.set("ann", "bob", 0.9)
    assert not merges.set_observed("ann", "bob", 0.8)
    assert not merges.set_observed("ann", "bob", 0.0)
    assert updated(merges)["bob"] == "ann"


def test_a_pair_split_by_the_user_is_merged_again_by_the_user_only():
    merges = Merges(0.5)
    merges.set_observed("ann", "bob", 0.8)
    merges.set_observed("bob", "eve", 0.8)
    assert merges.split("eve") and not merges.split("eve")
    assert not merges.set_observed("eve", "bob", 0.8) and not merges.set_observed("eve", "ann", 0.8)
    assert updated(merges) == {"ann": "ann", "bob": "ann", "eve": "eve"}
    merges.set("eve", "bob", 0.2)
    merges.set("eve", "bob", 0.0)
    assert updated(merges)["eve"] == "eve", "that they are hardly one is no reason to join them again"
    assert merges.parted == {frozenset(("bob", "eve")), frozenset(("eve", "ann"))}
    assert merges.set("eve", "bob", 1.0)
    assert updated(merges) == {"ann": "ann", "bob": "ann", "eve": "ann"}
    merges.set("eve", "bob", 0.0)
    assert merges.parted == {frozenset(("eve", "ann"))} and updated(merges)["eve"] == "ann", "observed still"


def test_those_whom_a_user_has_parted_are_one_only_as_long_as_a_match_says_so():
    merges = Merges(0.5)
    merges.set_observed("ann", "bob", 0.8)
    merges.split("bob")
    merges.set_observed("ann", "bob", 0.8)
    assert merges.report("ann", "bob", 0.9, 0.0) and updated(merges)["bob"] == "ann"
    assert merges.report("ann", "bob", 0.0, 1.0) and updated(merges)["bob"] == "bob"


def test_reports_that_join_and_part_too_often_wait_and_those_that_part_do_not():
    """Eight changes at once, then one each two seconds."""
    merges, now = Merges(0.5), 0.0
    for _ in range(50):
        merges.report("ann", "bob", 0.9, now)
    for _ in range(3):
        assert merges.report("ann", "bob", 0.0, now) and merges.report("ann", "bob", 0.9, now)
    assert merges.report("ann", "bob", 0.0, now), "what parts never waits"
    assert not merges.report("ann", "bob", 0.8, now) and merges.pairs == ()
    assert merges.report("eve", "bob", 0.9, now), "of another pair nothing was said so far"
    assert not merges.report("ann", "bob", 0.4, now) and merges.pairs[-1] == ("ann", "bob", 0.4), "joins nobody"
    assert not merges.report("ann", "bob", 0.8, now) and not merges.report_held(now + 1.9)
    assert merges.report_held(now + 2.1) and ("ann", "bob", 0.8) in merges.pairs and not merges.report_held(now + 9.0)


@pytest.mark.parametrize("says_so", [
    lambda merges: merges.set("ann", "bob", 0.0), lambda merges: merges.split("bob"),
    lambda merges: merges.remove("bob")], ids=["told", "split", "forgotten"])
def test_what_a_user_says_ends_a_report_that_waits(says_so):
    merges = Merges(0.5)
    for _ in range(5):
        merges.report("ann", "bob", 0.9, 0.0)
        merges.report("ann", "bob", 0.0, 0.0)
    merges.set_observed("ann", "bob", 0.9)
    merges.set("ann", "bob", 0.4)
    assert not merges.report("ann", "bob", 0.9, 0.0)
    merges.set_observed("bob", "eve", 0.9)
    merges.set_observed("eve", "ann", 0.9)
    says_so(merges)
    assert not merges.report_held(60.0) and all(pair[2] < 0.5 for pair in merges.pairs)


def test_of_too_many_pairs_it_is_told_whether_the_oldest_was_joined():
    merges = Merges(0.5)
    for number in range(MAX_MERGES):
        merges.set("a%d" % number, "b%d" % number, 0.9 if number else 0.1)
    assert not merges.set("ann", "bob", 0.2), "the oldest was joined with nobody"
    assert merges.set("bob", "eve", 0.2)


def test_pairs_that_are_not_observed_any_more_push_nobody_out():
    merges = Merges(0.5)
    merges.set_observed("ann", "bob", 0.9)
    for number in range(MAX_MERGES):
        merges.set_observed("a%d" % number, "b%d" % number, 0.9)
        merges.set_observed("a%d" % number, "b%d" % number, 0.0)
        merges.prefer("a%d" % number)
    assert updated(merges)["bob"] == "ann" and merges.is_preferred("a0")
    merges.prefer("ann")
    assert not merges.is_preferred("a0"), "bounded"


def test_the_number_of_observed_and_split_pairs_is_bounded():
    merges = Merges(0.5)
    for number in range(MAX_MERGES + 50):
        merges.set_observed("a%d" % number, "b%d" % number, 0.9)
        merges.split("a%d" % number)
        merges.set_observed("c%d" % number, "d%d" % number, 0.9)
    assert len(merges.observed) == MAX_MERGES and len(merges._split) == MAX_MERGES
    merges.remove("c%d" % (MAX_MERGES + 49))
    assert len(merges.observed) == MAX_MERGES - 1


@pytest.mark.parametrize("says, let_through", [
    (lambda now: "bob", 1.0), (lambda now: "ann" if now < 0.8 else "bob", 1.8),
    (lambda now: ("ann", "bob")[int(now / 0.9) % 2], 4.0), (lambda now: None, 4.0)],
    ids=["one thing", "another one", "now this, now that", "no word is the best"])
def test_what_nothing_contradicts_for_a_second_is_let_through_sooner(says, let_through):
    """Nine changes at once last for 4 s."""
    limit, keys = ChangeLimit(), ("f1", )
    for _ in range(20):
        limit.note(keys, 0.0)
    assert limit.holds(keys, 0.0)
    for step in range(1, 60):
        now = 0.1 * step
        if limit.holds(keys, now):
            limit.hear(keys, says(now), now)
        if limit.due(now, lambda keys, now=now: says(now)):
            break
    assert now == pytest.approx(let_through, abs=0.11)
    assert limit.due(now, lambda keys: says(now)) == [], "it is told once"
    limit.due(now + 60.0)
    assert not any(vars(limit).values()), "nothing is kept of what was long ago"


def test_what_others_say_of_a_held_match_counts_without_another_match():
    limit, keys = ChangeLimit(), ("f1", )
    for _ in range(20):
        limit.note(keys, 0.0)
    assert limit.holds(keys, 0.0)
    limit.hear(keys, "ann", 0.0)
    due = [step for step in range(1, 40) if limit.due(0.1 * step, lambda keys, step=step: "ann" if step < 8 else "bob")]
    assert due == [18]


def test_a_rest_lets_no_more_changes_through_at_once_and_a_clock_that_is_set_back_holds_nothing():
    limit, keys = ChangeLimit(), ("f1", )
    for now in (0.0, *[1000.0] * 8):
        assert not limit.holds(keys, now)
        limit.note(keys, now)
    assert limit.holds(keys, 1000.0)
    assert not limit.holds(keys, 10.0)


def test_what_nothing_contradicts_is_not_let_through_for_ever():
    """Said for 1.125 s each: a few changes more than the limit lets through in a minute, not all 54."""
    limit, keys, shown, count = ChangeLimit(), ("f1", ), -1, 0
    for step in range(480):
        now, word = 0.125 * step, step // 9     # of which binary numbers are exact
        if word != shown and limit.holds(keys, now):
            limit.hear(keys, word, now)
        for key in limit.due(now, lambda keys, word=word: word) or (() if limit.holds(keys, now) else keys):
            if word != shown:
                limit.note((key, ), now)
                count, shown = count + 1, word
    assert 30 <= count <= 8 + 4 + 30 + 1
