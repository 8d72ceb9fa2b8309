"""Which changes of the matches are worth solving, and what is kept for features that come later."""

from __future__ import annotations

import pytest

from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.known_ids import MAX_KNOWN_IDS, KnownIds
from hri_person_manager.core.live_association import MAX_STRAY_MATCHES, LiveAssociation
from hri_person_manager.core.match_guard import Match

F1, F2, B1, B2 = Node(Kind.FACE, "f1"), Node(Kind.FACE, "f2"), Node(Kind.BODY, "b1"), Node(Kind.BODY, "b2")
ANN = Node(Kind.PERSON, "ann")


@pytest.fixture
def present():
    return {F1, B1, B2, ANN}


@pytest.fixture
def association(present):
    found = LiveAssociation(0.5, present.__contains__, lambda person: None)
    found.solve(present)
    return found


def keep(association, first, second, likelihood):
    """Whether a match was worth solving, and whether that changed a group."""
    worth = association.keep(Match(first, second, likelihood))
    return worth, association.solve((first, second))


def test_only_what_may_change_a_group_is_worth_solving(association):
    assert keep(association, F1, B1, 0.4) == (False, False)
    assert keep(association, F1, B1, 0.8) == (True, True)
    assert keep(association, F1, B1, 0.8) == (False, False)
    assert keep(association, F1, B1, 0.9) == (False, False), "the pair has no other choice"
    assert keep(association, F1, B2, 0.7) == (True, False)
    assert keep(association, F1, B1, 0.85) == (True, False), "now it has one"
    assert keep(association, F1, B1, 0.6) == (True, True)
    assert frozenset((F1, B2)) in association.groups
    assert keep(association, F1, B2, 0.3) == (True, True)
    assert keep(association, F1, B1, 0.0) == (True, True)


def test_a_choice_that_is_not_there_yet_counts_when_it_comes(association, present):
    keep(association, F1, B1, 0.6)
    association.keep(Match(F2, B1, 0.9))
    assert keep(association, F1, B1, 0.7) == (False, False)
    present.add(F2)
    association.arrive([F2])
    assert association.solve([F2]) and frozenset((F2, B1)) in association.groups
    assert association.leave(F2) == [B1]
    present.discard(F2)
    assert association.solve([B1]) and frozenset((F1, B1)) in association.groups


def test_who_a_recogniser_sees_in_a_face_is_known_whoever_gets_the_name(association, present):
    present.add(F2)
    association.solve([F2])
    keep(association, F1, ANN, 0.9)
    keep(association, F2, ANN, 0.8)
    assert association.named(F1) == association.named(F2) == {"ann"}
    keep(association, F2, ANN, 0.4)
    assert association.named(F2) == set()


def test_matches_of_strangers_are_bounded(association):
    for number in range(MAX_STRAY_MATCHES + 10):
        association.keep(Match(Node(Kind.FACE, "x%d" % number), B1, 0.9))
    assert len(association._strays) == MAX_STRAY_MATCHES


def test_known_ids_remember_who_was_first_and_forget_who_was_named_longest_ago():
    known = KnownIds()
    assert known.add("ann") and known.add("bob") and not known.add("ann")
    assert known.number("ann", 9) < known.number("bob", 9) < known.number("eve", 9) == 9
    for number in range(MAX_KNOWN_IDS - 1):
        known.add("x%d" % number)
    assert "ann" in known and "bob" not in known and len(list(known)) == MAX_KNOWN_IDS
    known.remove("ann")
    known.remove("ann")
    assert "ann" not in known
