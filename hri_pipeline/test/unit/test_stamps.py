"""Stamps of several sources: one that lags is no jump of time, one that goes back is."""

from __future__ import annotations

import pytest

from hri_pipeline.core.timing import ALL_STALE_S, MAX_SOURCES, Order, SourceStamps

FACES, BODIES = ("face_", b"camera"), ("body_", b"camera")


def at(seconds):
    return int(seconds), round((seconds - int(seconds)) * 1e9)


@pytest.mark.parametrize("lag", [0.6, 1.0, 4.0])
@pytest.mark.parametrize("gap", [0.1, 0.6, 1.5])
def test_a_source_that_lags_is_no_jump_even_while_the_other_one_pauses(lag, gap):
    stamps = SourceStamps()
    found = []
    for step in range(40):
        now = 100.0 + gap * step
        found += [stamps.note(FACES, at(now), now), stamps.note(BODIES, at(now - lag), now + 0.9 * gap)]
    assert set(found) == {Order.NEWER}


def test_a_source_whose_own_stamps_go_back_is_a_jump_and_the_others_follow_it():
    stamps = SourceStamps()
    for source, lag in ((FACES, 0.0), (BODIES, 2.0)):
        stamps.note(source, at(100.0 - lag), 50.0)
    assert stamps.note(FACES, at(80.0), 50.3) == Order.LATE, "it may have come late"
    assert stamps.note(FACES, at(80.3), 50.6) == Order.BACK
    assert stamps.note(BODIES, at(78.4), 50.7) == Order.NEWER, "the same jump is not told twice"
    assert stamps.note(FACES, at(80.4), 50.7) == Order.NEWER


def test_a_little_back_is_late_however_long_nothing_has_come():
    stamps = SourceStamps()
    stamps.note(FACES, at(100.0), 50.0)
    assert stamps.note(FACES, at(99.6), 60.5) == Order.LATE
    assert stamps.note(FACES, at(100.0), 60.5) == Order.LATE


def test_unknown_sources_alone_tell_a_jump_after_a_while():
    stamps = SourceStamps()
    stamps.note("person_a", at(100.0), 50.0)
    assert stamps.note("person_b", at(20.0), 50.0 + 0.9 * ALL_STALE_S) == Order.NEWER
    assert stamps.note("person_b", at(21.5), 50.0 + 1.1 * ALL_STALE_S) == Order.BACK
    assert stamps.note("person_b", at(21.6), 50.1 + 1.1 * ALL_STALE_S) == Order.NEWER


def test_the_number_of_sources_is_bounded():
    stamps = SourceStamps()
    for number in range(3 * MAX_SOURCES):
        stamps.note(number, at(number), float(number))
    assert len(stamps._newest) == MAX_SOURCES
