"""What the guard of candidate matches lets through."""

from __future__ import annotations

import pytest

from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.match_guard import Match, MatchGuard, RateLimit


def test_a_sound_match_passes():
    guard = MatchGuard(10.0)
    assert guard.check("f1", 2, "b1", 3, 0.5, 0.0) == Match(Node(Kind.FACE, "f1"), Node(Kind.BODY, "b1"), 0.5)


def test_two_persons_may_match_each_other():
    guard = MatchGuard(10.0)
    assert guard.check("ann", 1, "bob", 1, 0.5, 0.0) == Match(Node(Kind.PERSON, "ann"), Node(Kind.PERSON, "bob"), 0.5)


@pytest.mark.parametrize("fields", [
    ("ann", 1, "ann", 1, 0.5),
    ("f1", 2, "b1", 3, float("nan")), ("f1", 2, "b1", 3, float("inf")), ("f1", 2, "b1", 3, -0.1),
    ("f1", 2, "b1", 3, 1.2), ("", 2, "b1", 3, 0.5), ("f 1", 2, "b1", 3, 0.5), ("f1", 2, "b/1", 3, 0.5),
    ("f1", 2, "b'1", 3, 0.5), ("f1", 0, "b1", 3, 0.5), ("f1", 9, "b1", 3, 0.5), ("f1", 2, "f1", 2, 0.5),
    ("f1", 2, "f2", 2, 0.5)])
def test_unsound_matches_are_refused_and_counted(fields):
    guard = MatchGuard(10.0)
    assert guard.check(*fields, 0.0) is None
    assert sum(guard.refused.values()) == 1


def test_the_rate_is_limited_and_recovers():
    guard = MatchGuard(10.0)
    taken = [guard.check("f1", 2, "b1", 3, 0.5, 0.0) is not None for _ in range(100)]
    assert sum(taken) == 10
    assert guard.check("f1", 2, "b1", 3, 0.5, 1.0) is not None
    assert guard.check("f1", 2, "b1", 3, 0.5, -100.0) is not None   # time jumped back


def test_what_was_said_before_somebody_was_forgotten_and_comes_later_is_dropped():
    guard = MatchGuard(10.0)
    guard.forget("ann", 100.0)
    assert guard.check("f1", 2, "ann", 1, 0.9, 101.0) is None and guard.late == 1
    assert guard.check("f1", 2, "bob", 1, 0.9, 101.0) is not None
    assert guard.check("f1", 2, "ann", 1, 0.9, 103.0) is not None, "a recogniser that knows her still"
    assert not sum(guard.refused.values())


def test_illegal_rate():
    with pytest.raises(ValueError):
        RateLimit(0.0)
