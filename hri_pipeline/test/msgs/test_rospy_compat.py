"""rospy's publish() goes on at once, and still sends everything."""

import threading
import time

import pytest
from rospy.impl import tcpros_pubsub

from hri_pipeline.ros.rospy_compat import publish_without_yielding


class Wire:
    """A connection that keeps what is written."""

    def __init__(self):
        self.done, self.sent, self.news = False, [], threading.Event()

    def set_cleanup_callback(self, callback):
        self.callback = callback

    def write_data(self, data):
        self.sent.append(data)
        if data == b"last":
            self.news.set()

    def close(self):
        self.done = True
        self.callback(self)


@pytest.fixture
def sleeps(monkeypatch):
    """Every sleep of rospy's connections from now on."""
    monkeypatch.setattr(tcpros_pubsub, "time", time)
    taken = []
    monkeypatch.setattr(time, "sleep", taken.append)
    return taken


def write(messages):
    wire = Wire()
    connection = tcpros_pubsub.QueuedConnection(wire, 100)
    try:
        for message in messages:
            connection.write_data(message)
        assert wire.news.wait(10.0)
    finally:
        wire.close()
        connection._thread.join(10.0)
    assert not connection._thread.is_alive()
    return wire.sent


MESSAGES = [b"%d" % number for number in range(20)] + [b"last"]


def test_rospy_sleeps_for_each_message(sleeps):
    assert write(MESSAGES) == MESSAGES
    assert sleeps == [0] * len(MESSAGES)


def test_it_does_not_any_more_and_all_is_sent_in_order(sleeps):
    publish_without_yielding()
    publish_without_yielding()
    assert write(MESSAGES) == MESSAGES
    assert sleeps == []


def test_a_real_sleep_is_one_and_the_rest_of_time_is_there(sleeps):
    publish_without_yielding()
    tcpros_pubsub.time.sleep(0.5)
    assert sleeps == [0.5]
    assert tcpros_pubsub.time.time is time.time
