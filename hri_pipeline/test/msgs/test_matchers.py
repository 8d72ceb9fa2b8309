"""The nodes of the matchers go on after an error; without a master."""

import threading
from unittest.mock import MagicMock

import pytest
from std_msgs.msg import String

from hri_pipeline.nodes import matchers as module
from hri_pipeline.nodes.matchers import FaceBodyMatcherNode, VoiceContext, VoiceMatcherNode
from hri_pipeline.ros.diagnostics import ERROR


@pytest.mark.parametrize("kind", [FaceBodyMatcherNode, VoiceMatcherNode])
def test_one_bad_comparison_does_not_end_the_node(kind, monkeypatch):
    monkeypatch.setattr(module.rospy, "logerr_throttle", MagicMock())
    monkeypatch.setattr(module.rospy, "get_time", lambda: 1.0)
    node = kind.__new__(kind)
    node._stop, node._changed, node._lock = threading.Event(), threading.Event(), threading.Lock()
    node._matcher, node._changes, node._diagnostics, node._report = (MagicMock() for _ in range(4))
    node._listen, node._publish, node._times = (MagicMock() for _ in range(3))
    node._context, node._last_now = None, 0.0
    node._matcher.is_busy = False
    node._changed.set()

    def matches(*_):
        node._changed.set()
        if node._matcher.matches.call_count == 1:
            raise ZeroDivisionError("a bad number")
        node._stop.set()
        return []

    node._matcher.matches.side_effect = matches
    node.spin()
    assert node._matcher.matches.call_count == 2
    node._diagnostics.set.assert_called_once_with("matches", ERROR, "ZeroDivisionError: a bad number")


def test_what_was_latched_of_a_person_counts_when_it_is_faster_than_the_list():
    """The topics of an id are subscribed to before the list is handed on; what is latched there comes only once."""
    context = VoiceContext.__new__(VoiceContext)
    context._matcher, context._tf, context._lock = MagicMock(), MagicMock(), threading.Lock()
    context._persons, context._known_ids = {}, []
    for name, value in (("face_id", "fa"), ("voice_id", "")):
        context._on_person("ann", name, String(value))
    context._on_persons(["ann"])
    context._matcher.set_persons.assert_called_with({"ann": ("fa", "")}, [])
    context._on_persons([])
    context._matcher.set_persons.assert_called_with({}, [])
