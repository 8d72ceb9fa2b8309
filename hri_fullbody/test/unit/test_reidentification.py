"""Bodies that come back under a new id."""

from __future__ import annotations

import numpy as np
import pytest

from hri_fullbody.core.tracking.reidentification import BodyReidentifier, TrackAppearance


def clothes(seed, noise=0.0):
    """Histograms (2, 17) of somebody's clothes, seen with some noise."""
    generator = np.random.default_rng(seed)
    looks = np.zeros((2, 17))
    for row in looks:
        row[generator.choice(17, 3, replace=False)] = (0.5, 0.3, 0.2)
    looks = looks + noise * np.random.default_rng(seed + 100).random((2, 17)) / 17.0
    return looks / looks.sum(axis=1, keepdims=True)


def body(name, seed, x=0.0, noise=0.3):
    return TrackAppearance(name, clothes(seed, noise), np.array([x, 0.0, 3.0]))


def told(continuity, stamp, *bodies):
    return [(item.id, item.earlier) for item in continuity.update(bodies, stamp)]


def test_who_comes_back_in_the_same_clothes_is_known_again():
    continuity = BodyReidentifier(10.0)
    assert told(continuity, 0.0, body("a", 1)) == []
    assert told(continuity, 1.0) == []
    (found,) = continuity.update([body("b", 1, 1.0, 0.5)], 3.0)
    assert (found.id, found.earlier) == ("b", "a") and 0.5 <= found.likelihood <= 0.75
    assert told(continuity, 3.1, body("b", 1, 1.0)) == []


def test_other_clothes_too_far_or_too_late_are_somebody_else():
    for later, new in ((3.0, body("b", 2)), (1.5, body("b", 1, 4.0)), (12.0, body("b", 1))):
        continuity = BodyReidentifier(10.0)
        told(continuity, 0.0, body("a", 1))
        told(continuity, 1.0)
        assert told(continuity, later, new) == []


def test_who_is_still_there_is_not_lost():
    continuity = BodyReidentifier(10.0)
    told(continuity, 0.0, body("a", 1))
    assert told(continuity, 1.0, body("a", 1), body("b", 1)) == []


def test_two_in_uniform_are_not_guessed_at_and_two_in_their_own_clothes_are_told_apart():
    continuity = BodyReidentifier(10.0)
    told(continuity, 0.0, body("a", 1), body("b", 1))
    told(continuity, 1.0)
    assert told(continuity, 2.0, body("c", 1)) == []
    continuity = BodyReidentifier(10.0)
    told(continuity, 0.0, body("a", 1), body("b", 2))
    told(continuity, 1.0)
    assert sorted(told(continuity, 2.0, body("d", 2), body("c", 1))) == [("c", "a"), ("d", "b")]


def test_a_body_that_does_not_show_itself_yet_is_told_of_when_it_does():
    continuity = BodyReidentifier(10.0)
    told(continuity, 0.0, body("a", 1))
    told(continuity, 1.0)
    assert told(continuity, 2.0, TrackAppearance("b", None, None)) == []
    assert told(continuity, 2.5, body("b", 1)) == [("b", "a")]


def test_nothing_is_remembered_without_memory_after_a_reset_or_beyond_the_bound():
    for continuity in (BodyReidentifier(0.0), BodyReidentifier(10.0)):
        told(continuity, 0.0, body("a", 1))
        told(continuity, 1.0)
        if continuity._memory:
            continuity.reset()
        assert told(continuity, 2.0, body("b", 1)) == []
    continuity = BodyReidentifier(1e9)
    for number in range(500):
        told(continuity, float(number), body("a%d" % number, number))
    assert len(continuity._lost) <= 51
    with pytest.raises(ValueError, match="memory"):
        BodyReidentifier(-1.0)
