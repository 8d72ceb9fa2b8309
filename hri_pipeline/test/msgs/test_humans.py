"""The client for people: what a user's callbacks do to it."""

import logging

import pytest

from hri_pipeline.client import humans
from hri_pipeline.ros.rospy_compat import WallTimeThrottle


def failing(*errors):
    """A callback that fails with these errors by turns, and how often it was called."""
    called = []

    def fail(value):
        called.append(value)
        raise errors[(len(called) - 1) % len(errors)]
    return fail, called


@pytest.fixture
def now(monkeypatch):
    """Seconds that the throttle of each callback sees, to be set."""
    clock = [0.0]
    monkeypatch.setattr(humans, "WallTimeThrottle", lambda: WallTimeThrottle(lambda: clock[0]))
    return clock


def test_a_callback_that_fails_for_each_message_ends_nothing_and_is_told_now_and_then(now, caplog):
    fail, called = failing(KeyError("ann"))
    guarded = humans._guarded(fail)
    with caplog.at_level(logging.ERROR, "rosout"):
        for number in range(300):
            now[0] = number / 15.0
            guarded(number)
    assert len(called) == 300
    assert [record.getMessage() for record in caplog.records] == 2 * ["a callback of Humans failed: KeyError: 'ann'"]


def test_a_callback_that_fails_for_each_message_hides_no_other_error(now, caplog):
    often, seldom = (humans._guarded(failing(*errors)[0]) for errors in (
        (KeyError("ann"), ValueError("no place")), (TypeError("no number"), )))
    with caplog.at_level(logging.ERROR, "rosout"):
        for number in range(90):
            now[0] = number / 15.0
            often(number)
            if number == 45:
                seldom(number)
    assert [record.getMessage().split(": ")[1] for record in caplog.records] == ["KeyError", "ValueError", "TypeError"]
