"""Calls of services that never answer. Needs the message packages, no master."""

from __future__ import annotations

import threading

import pytest
import rospy

from hri_pipeline.ros import services
from hri_pipeline.ros.services import NoAnswer, call_service, in_time, wait_for_service


@pytest.fixture
def never():
    """A call that never returns, until the test has ended."""
    end = threading.Event()
    yield lambda *values: end.wait(60.0)
    end.set()


def test_a_call_has_its_time_and_its_own_errors(never):
    def slow():
        raise TimeoutError("of its own")

    assert in_time(lambda: 7, 20.0) == 7
    with pytest.raises(ZeroDivisionError):
        in_time(lambda: 1 // 0, 20.0)
    with pytest.raises(TimeoutError, match="of its own"):
        in_time(slow, 20.0)
    with pytest.raises(TimeoutError, match=r"no answer within 0\.05 s"):
        in_time(never, 0.05)


def test_a_service_that_never_answers_is_named_with_what_to_do(never, monkeypatch):
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, kind: never)
    with pytest.raises(NoAnswer, match=r"^/manager/forget has not answered within 0\.05 s.*start it again"):
        call_service("/manager/forget", object, ["ann"], 0.05)
    monkeypatch.setattr(rospy, "ServiceProxy", lambda name, kind: lambda *values: values)
    assert call_service("/manager/merge", object, ["ann", "bob"], 20.0) == ("ann", "bob")


def test_a_service_or_master_that_takes_no_call_is_named(never, monkeypatch):
    monkeypatch.setattr(services, "ANSWER_S", 0.05)
    monkeypatch.setattr(rospy, "wait_for_service", never)
    with pytest.raises(rospy.ROSException, match="^/manager/forget takes no call.*hangs"):
        wait_for_service("/manager/forget", 0.0)
