"""The overlay node without a master: pictures that cannot be drawn, and a camera without a clock."""

import threading
from collections import deque
from unittest.mock import MagicMock

import genpy
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Header

from hri_pipeline.core.observations import FeatureHistory
from hri_pipeline.core.overlay import OVERLAY_PARAMETERS
from hri_pipeline.core.timing import Pacer
from hri_pipeline.nodes import overlay as module
from hri_pipeline.nodes.overlay import IgnoredByNodes, OverlayInputs, OverlayNode
from hri_pipeline.ros.conversions import bgr_to_image
from hri_pipeline.ros.master import MasterAway
from hri_pipeline.testing import wait_for

SETTINGS = OVERLAY_PARAMETERS.resolve({})


@pytest.fixture()
def node(monkeypatch):
    monkeypatch.setattr(module, "release", lambda subscriber: None)
    monkeypatch.setattr(module.rospy, "logerr_throttle", lambda *arguments: None)
    made = OverlayNode.__new__(OverlayNode)
    made._settings, made._inputs, made._drawn, made._pacer = SETTINGS, None, -1.0, Pacer(100.0)
    made._lock, made._stop, made._wake = threading.Lock(), threading.Event(), threading.Event()
    made._output, made._diagnostics, made._grey = MagicMock(), MagicMock(), module.GreyBits()
    monkeypatch.setattr(module, "parameter_of_subscribers", lambda *arguments: [])
    made._ignored = IgnoredByNodes()
    made._output.get_num_connections.return_value = 1
    yield made
    made._end()


def test_what_goes_wrong_once_does_not_end_the_node(node, monkeypatch):
    inputs = MagicMock()
    inputs.take.side_effect = [ValueError("no picture of this world")] + [None] * 10000
    opened = iter([OSError("the master is away"), inputs])

    def open_inputs(settings):
        answer = next(opened)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(module, "OverlayInputs", open_inputs)
    threading.Thread(target=node.spin, daemon=True).start()
    wait_for(lambda: inputs.take.call_count > 2, 5, "pictures after the bad ones")
    told = [call.args[2] for call in node._diagnostics.set.call_args_list if call.args[1] == DiagnosticStatus.ERROR]
    assert told == ["OSError: the master is away", "ValueError: no picture of this world"]


def test_subscriptions_that_cannot_all_be_made_leave_none(monkeypatch):
    released, feed = [], MagicMock()
    monkeypatch.setattr(module, "release", released.append)
    monkeypatch.setattr(module, "IdSubscribers", lambda *arguments, **options: feed)
    monkeypatch.setattr(module.rospy, "Subscriber", MagicMock(side_effect=["gaze", OSError("the master is away")]))
    with pytest.raises(OSError):
        OverlayInputs(SETTINGS)
    assert released == ["gaze"] and feed.close.call_count == 3


def test_a_camera_without_a_clock_is_drawn_all_the_time(node, monkeypatch):
    now = iter([5.0, 5.1])
    monkeypatch.setattr(module.rospy.Time, "now", lambda: genpy.Time.from_sec(next(now)))
    inputs = OverlayInputs.__new__(OverlayInputs)
    inputs._lock, inputs._images, inputs._frame = threading.Lock(), deque(maxlen=9), ""
    inputs._history, inputs._persons = FeatureHistory(), {}
    for count in (1, 2):
        inputs._on_image(bgr_to_image(np.zeros((48, 64, 3), np.uint8), Header()))
        node._draw(inputs)
        assert node._output.publish.call_count == count
    node._draw(inputs)
    assert node._output.publish.call_count == 2


def test_ignored_regions_are_those_of_all_nodes_and_stay_while_the_master_is_away(monkeypatch):
    answers = [[["0 0 0.5 1"], [], ["0 0 0.5 1", "0.5 0 0.5 0.5"]], MasterAway("refused"), [["no region"]], [7, []]]

    def ask(*arguments):
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def told(ignored):
        ignored.boxes()
        ignored._asking.join(5.0)
        return ignored._boxes

    monkeypatch.setattr(module, "parameter_of_subscribers", ask)
    monkeypatch.setattr(module, "_ASK_S", 0.0)
    ignored, both = IgnoredByNodes(), [(0.0, 0.0, 0.5, 1.0), (0.5, 0.0, 1.0, 0.5)]
    assert [told(ignored) for _ in range(4)] == [both, both, both, []]


def test_pictures_do_not_wait_for_a_master_that_hangs(monkeypatch):
    answers, asked = threading.Event(), []

    def ask(*arguments):
        asked.append(threading.current_thread())
        assert answers.wait(10.0)
        return [["0 0 0.5 1"]]

    monkeypatch.setattr(module, "parameter_of_subscribers", ask)
    monkeypatch.setattr(module, "_ASK_S", 0.0)
    ignored = IgnoredByNodes()
    assert [ignored.boxes() for _ in range(3)] == [[], [], []]
    wait_for(lambda: asked, 5, "the master is asked")
    answers.set()
    asked[0].join(5.0)
    assert len(asked) == 1 and asked[0] is not threading.current_thread()
    assert ignored.boxes() == [(0.0, 0.0, 0.5, 1.0)]
