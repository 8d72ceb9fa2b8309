"""The client for people: what a user's callbacks do to it."""

import logging

import rospy

from hri_pipeline.client import humans
from hri_pipeline.ros.rospy_compat import WallTimeThrottle


def test_a_callback_that_fails_for_each_message_ends_nothing_and_is_told_now_and_then(monkeypatch, caplog):
    monkeypatch.setattr(rospy.core, "_logging_throttle", WallTimeThrottle(lambda: now[0]))
    now, called = [0.0], []

    def fail(value):
        called.append(value)
        raise KeyError("ann")

    guarded = humans._guarded(fail)
    with caplog.at_level(logging.ERROR, "rosout"):
        for number in range(300):
            now[0] = number / 15.0
            guarded(number)
    assert len(called) == 300
    assert [record.getMessage() for record in caplog.records] == 2 * ["a callback of Humans failed: KeyError: 'ann'"]
