"""Which likelihoods are published, and when."""

from __future__ import annotations

from hri_pipeline.core.matching.changes import MatchChanges


def test_changes_repeats_and_withdrawals():
    changes = MatchChanges(0.1)
    assert changes.update({"a": 0.7}, 100.0) == [("a", 0.7)]
    assert changes.update({"a": 0.75}, 100.5) == []
    assert changes.update({"a": 0.85}, 100.6) == [("a", 0.85)]
    assert changes.update({"a": 0.85}, 101.6) == [("a", 0.85)]
    assert changes.update({"b": 0.9}, 101.7) == [("a", 0.0), ("b", 0.9)]
    assert changes.withdraw_all() == [("b", 0.0)]


def test_nothing_is_withdrawn_of_what_has_left():
    changes = MatchChanges(0.1)
    changes.update({"stays": 0.7, "leaves": 0.7}, 0.0)
    assert changes.update({}, 0.1, lambda key: key == "leaves") == [("stays", 0.0)]
    assert changes.update({}, 0.2) == []
    assert changes.update({"leaves": 0.7}, 0.3) == [("leaves", 0.7)]       # is back: published at once
