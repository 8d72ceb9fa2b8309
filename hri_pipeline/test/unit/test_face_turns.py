"""Whose turn it is among the networks behind the faces."""

from collections import Counter

from hri_pipeline.core.faces.face_analysis import next_turn


def test_the_most_overdue_comes_first():
    assert next_turn({"expression": 1.5, "age_gender": 2.0, "recognition": 0.0}, "") == "age_gender"
    assert next_turn({"expression": 1.5, "age_gender": 0.5, "recognition": 4.0}, "expression") == "recognition"


def test_none_is_shut_out_by_one_that_is_always_due():
    counts, last = Counter(), ""
    for _ in range(100):
        last = next_turn({"expression": 2.0, "age_gender": 2.0, "recognition": 4.0}, last)
        counts[last] += 1
    assert counts["recognition"] == 50 and counts["expression"] + counts["age_gender"] == 50


def test_the_last_one_goes_on_when_no_other_is_due():
    assert next_turn({"expression": 0.9, "age_gender": 0.0, "recognition": 4.0}, "recognition") == "recognition"
    assert next_turn({"expression": 0.9, "age_gender": 0.0, "recognition": 0.0}, "recognition") == "expression"
