"""robot_state_publishers while the master is away; without a master."""

import functools
import socket
from unittest.mock import MagicMock

import pytest

from hri_fullbody.ros import state_publishers as module
from hri_fullbody.ros.state_publishers import DescriptionServer, StatePublishers
from hri_pipeline.ros import master


@pytest.fixture
def publishers(monkeypatch):
    """Publishers whose thread does nothing; their server is `_server`."""
    monkeypatch.setattr(module, "rospy", MagicMock())
    monkeypatch.setattr(module, "DescriptionServer", MagicMock())
    monkeypatch.setattr(StatePublishers, "_run", lambda self: None)
    return StatePublishers(limit=10)


def test_bodies_that_leave_while_the_master_is_away_cost_it_one_call_a_second_and_no_line_each(publishers):
    publishers._server.delete.side_effect = ConnectionRefusedError("no master")
    for number in range(50):
        publishers._undeleted["body%d" % number] = None
    for step in range(100):
        publishers._delete(0.1 * step)
    assert len(publishers._undeleted) == 50
    assert publishers._server.delete.call_count <= 11
    assert module.rospy.logwarn.call_count == 0 and module.rospy.logwarn_throttle.call_count >= 1
    publishers._server.delete.side_effect = None
    publishers._delete(20.0)
    assert not publishers._undeleted


def test_what_is_left_of_one_body_does_not_keep_what_is_left_of_others(publishers):
    """One whose node another process has taken over, say."""
    def delete(body):
        if body == "first":
            raise ConnectionRefusedError("nobody there")
    publishers._server.delete.side_effect = delete
    publishers._undeleted.update(first=None, second=None)
    for step in range(30):
        publishers._delete(0.1 * step)
    assert set(publishers._undeleted) == {"first"}


def test_a_master_that_hangs_is_not_waited_for(monkeypatch):
    """The thread of all bodies would wait for ever, and nobody who comes later would have a skeleton."""
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen(5)
        monkeypatch.setattr(master, "node_at", functools.partial(master.node_at, patience=0.05))
        monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:{}/".format(silent.getsockname()[1]))
        server = DescriptionServer(50.0)
        for call in (server.names, lambda: server.put("abcde", "<robot/>"), lambda: server.delete("abcde")):
            with pytest.raises(OSError):
                call()
