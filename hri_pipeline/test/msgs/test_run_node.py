"""How a node reads its parameters, and how it ends. Needs the message packages, no master."""

from __future__ import annotations

import pytest
import rospy

from hri_pipeline.core import error_log
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.ros import node
from hri_pipeline.ros.master import OwnParameters


@pytest.fixture
def said(monkeypatch):
    """What is logged as fatal."""
    lines = []
    monkeypatch.setattr(rospy, "logfatal", lambda text, *values: lines.append(text % values))
    monkeypatch.setattr(rospy, "get_name", lambda: "/hri_faces")
    monkeypatch.setattr(node, "_ignore_signals", lambda: None)
    return lines


def no_thread(parameters):
    raise RuntimeError("can't start new thread")


def test_a_node_that_gets_no_thread_names_the_limit_and_no_line_of_code(said, monkeypatch):
    monkeypatch.setattr(error_log, "fullest_group", lambda: None)
    monkeypatch.setattr(error_log.resource, "getrlimit", lambda which: (60, 60))
    monkeypatch.setattr(error_log.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(node, "MasterWatch", no_thread)
    assert node._run(lambda: None, OwnParameters()) == 1
    assert len(said) == 1 and "\n" not in said[0] and "60 processes and threads (ulimit -u)" in said[0]


def test_a_node_that_ends_by_any_other_error_tells_where(said, monkeypatch):
    monkeypatch.setattr(node, "MasterWatch", lambda parameters: 1 // 0)
    assert node._run(lambda: None, OwnParameters()) == 1
    assert "Traceback" in said[0] and "ZeroDivisionError" in said[0]


@pytest.mark.parametrize("own, shared, used", [
    ("", "odom", "odom"), ("", "", "map"), (None, "", "map"), ("base", "", "base"), ("base", "odom", "base")])
def test_a_reference_frame_without_a_name_is_one_that_is_not_set(monkeypatch, own, shared, used):
    """People were placed in the camera's frame, with a warning about the reference frame of no name."""
    server = {"/a": {} if own is None else {"reference_frame": own, "robot_frame": ""},
              "/humans/reference_frame": shared, "/humans/robot_reference_frame": "head"}
    monkeypatch.setattr(node.rospy, "get_name", lambda: "/a")
    monkeypatch.setattr(node.rospy, "has_param", lambda name: name in server)
    monkeypatch.setattr(node.rospy, "get_param", server.get)
    found = node.read_parameters(INTERACTION_PARAMETERS)
    assert found.reference_frame == used
    assert found.robot_frame == ("head" if own is None else ""), "there, no name has a meaning"
