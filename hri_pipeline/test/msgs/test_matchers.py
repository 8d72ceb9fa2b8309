"""The nodes of the matchers go on after an error; without a master."""

import threading
from unittest.mock import MagicMock

import pytest

from hri_pipeline.nodes import matchers as module
from hri_pipeline.nodes.matchers import FaceBodyMatcherNode, VoiceMatcherNode
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
