"""The node of the person manager goes on, whatever the master and one bad number do; without a master."""

import threading
from unittest.mock import MagicMock

import pytest

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.ros import node as module
from hri_person_manager.ros.node import PersonManagerNode, RestartState
from hri_pipeline.testing import wait_for

PRESENT = {"anonymous_person_abcde": [MatchNode(Kind.FACE, "fghij")]}


@pytest.fixture()
def written(monkeypatch):
    """What has been written; `may_go_on` is cleared while the master does not answer."""
    found = MagicMock(values=[], may_go_on=threading.Event(), problems=[])

    def write(name, value):
        found.may_go_on.wait(20.0)
        if found.problems:
            raise found.problems.pop()
        found.values.append(value)

    monkeypatch.setattr(module.rospy, "set_param", write)
    monkeypatch.setattr(module.rospy, "has_param", lambda name: False)
    monkeypatch.setattr(module, "_RESTART_PERIOD_S", 0.01)
    found.may_go_on.set()
    return found


def test_a_master_that_does_not_answer_holds_nobody_up(written):
    written.may_go_on.clear()
    state = RestartState()
    updating = threading.Thread(target=state.update, args=(lambda: PRESENT, True), daemon=True)
    updating.start()
    updating.join(5.0)
    assert not updating.is_alive()
    state.wait(0.01)
    assert written.values == []
    written.may_go_on.set()
    state.wait(5.0)
    assert written.values == [{"anonymous_person_abcde": ["FACE fghij"]}]
    state.close()


def test_what_the_master_has_not_taken_is_written_again_also_that_nobody_is_left(written):
    state = RestartState()
    state.update(lambda: PRESENT, at_once=True)
    state.wait(5.0)
    written.problems.append(OSError("away"))
    state.update(lambda: {}, at_once=True)
    state.wait(5.0)
    assert len(written.values) == 1
    wait_for(lambda: written.values[1:] == [{}], 5, "the second try", act=lambda: state.update(lambda: {}))
    state.close()


def test_one_bad_cycle_does_not_end_the_node():
    node = PersonManagerNode.__new__(PersonManagerNode)
    node._stop, node._lock, node._report = threading.Event(), threading.RLock(), MagicMock()
    cycles = []

    def tick():
        cycles.append(1)
        if len(cycles) == 1:
            raise ZeroDivisionError("a place without a ray")
        node._stop.set()

    node._tick = tick
    node.spin()
    assert len(cycles) == 2
    (error,), _ = node._report.fail.call_args
    assert isinstance(error, ZeroDivisionError)
