"""The interactions node: topics that cannot be opened at once, and a time that stands still; without a master."""

import io
import threading
import time
from collections import Counter
from types import SimpleNamespace
from unittest.mock import MagicMock

import genpy
import numpy as np
import pytest
from tf2_msgs.msg import TFMessage

from hri_pipeline.core.frames import scan
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.engagement import Level
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.nodes import interactions as module
from hri_pipeline.nodes.interactions import ENGAGEMENT, InteractionsNode, InteractionTopics
from hri_pipeline.ros import people_input
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.testing import wait_for


class Topics:
    """IdPublishers without ROS, which open only whom they may."""

    def __init__(self):
        self.allowed, self.ids, self.published = set(), [], []

    def keep(self, wanted):
        self.ids = [person for person in wanted if person in self.allowed]
        if len(self.ids) < len(wanted):
            raise OSError("too few file descriptors")

    def publish(self, person, name, message):
        if person in self.ids:
            self.published.append((person, name, message.level))

    def close_all(self):
        self.ids = []


@pytest.fixture()
def topics(monkeypatch):
    monkeypatch.setattr(module, "_RETRY_S", 0.02)
    monkeypatch.setattr(module.rospy, "logerr_throttle", lambda *arguments: None)
    made = InteractionTopics.__new__(InteractionTopics)
    made._engagement, made._publishers, made._lock = True, Topics(), threading.Lock()
    made._levels, made._wanted, made._changed, made._closed = {}, [], threading.Event(), False
    made._gaze = made._groups = made._gazing = None
    made._worker = threading.Thread(target=made._open_and_close, daemon=True)
    made._worker.start()
    yield made
    made.close()


def test_topics_that_could_not_be_opened_are_tried_again(topics):
    topics._publishers.allowed = {"second"}
    topics.keep(["first", "second"])
    topics.publish_engagement({"first": Level.ENGAGED, "second": Level.ENGAGED}, module.genpy.Time(1))
    wait_for(lambda: topics._publishers.ids == ["second"], 5, "the others are open")
    topics._publishers.allowed.add("first")
    wait_for(lambda: ("first", ENGAGEMENT, Level.ENGAGED) in topics._publishers.published, 5, "what was told before")


@pytest.mark.parametrize("passed, ends", [(0.0, False), (5.0, True)])
def test_who_interacts_goes_on_while_time_stands_still(passed, ends, monkeypatch):
    """A bag that is paused, here for an hour of the wall's clock."""
    node = InteractionsNode.__new__(InteractionsNode)
    for name in ("_people", "_gazes", "_groups", "_engagement", "_topics", "_publish"):
        setattr(node, name, MagicMock())
    node._people.ids, node._settings = ["ann"], SimpleNamespace(frame_timeout=0.5)
    node._last, node._last_at, node._is_empty = module.genpy.Time(100), 100.0, False
    monkeypatch.setattr(module.rospy, "get_time", lambda: 100.0 + passed)
    monkeypatch.setattr(time, "monotonic", lambda: 3700.0)
    node._rest()
    assert node._publish.called is ends
    assert node._engagement.update.called is ends


def test_a_frame_from_before_the_clock_went_back_does_not_hide_those_after_it(monkeypatch):
    """The last image of a bag that loops: 10 s passed until gazes went on."""
    monkeypatch.setattr(people_input, "IdSubscribers", MagicMock())
    monkeypatch.setattr(people_input, "TfSubscriber", MagicMock())
    monkeypatch.setattr(people_input.rospy, "get_time", lambda: 100.2)
    people = people_input.PeopleInput(INTERACTION_PARAMETERS.resolve({}), MagicMock())
    people._tf.set_people(["ann"])
    people._tf.set_feature("ann", "face", "abcde")
    people.reset(20.0)
    for stamp in (119.9, 100.1):
        data = io.BytesIO()
        TFMessage([transform_to_msg(Pose(np.eye(3), np.ones(3)), genpy.Time.from_sec(stamp), "camera",
                                    "face_abcde")]).serialize(data)
        people._on_frames(data.getvalue(), scan(data.getvalue()), False)
    assert people.stamp == genpy.Time.from_sec(100.1)


def test_several_faces_of_a_camera_whose_clock_is_ahead_do_not_hide_those_of_the_others(monkeypatch):
    """From the second face of an image on the stamp counted as it is, and the other cameras' images were old."""
    monkeypatch.setattr(people_input, "IdSubscribers", MagicMock())
    monkeypatch.setattr(people_input, "TfSubscriber", MagicMock())
    monkeypatch.setattr(people_input.rospy, "get_time", lambda: 100.2)
    people = people_input.PeopleInput(INTERACTION_PARAMETERS.resolve({}), MagicMock())
    people._tf.set_people(["ann", "bob", "cid"])
    for person, face in (("ann", "aaaaa"), ("bob", "bbbbb"), ("cid", "ccccc")):
        people._tf.set_feature(person, "face", face)
    for stamp, camera, faces in ((100.1, "camera", ["aaaaa"]), (105.1, "other", ["bbbbb", "ccccc"]),
                                 (105.05, "other", ["bbbbb"])):
        data = io.BytesIO()
        TFMessage([transform_to_msg(Pose(np.eye(3), np.ones(3)), genpy.Time.from_sec(stamp), camera, "face_" + face)
                   for face in faces]).serialize(data)
        people._on_frames(data.getvalue(), scan(data.getvalue()), False)
    assert people.stamp == genpy.Time.from_sec(100.1)


@pytest.mark.parametrize("reference", ["map", "camera_optical_frame"])
def test_people_are_compared_on_the_floor_though_the_reference_frame_is_a_cameras(reference):
    """Heights are along y there: two who stand behind each other would be one above the other."""
    settings = INTERACTION_PARAMETERS.resolve({"reference_frame": reference, "robot_frame": "base"})
    from_reference = Pose.identity() if reference != "map" else people_input.LEVEL
    tf = MagicMock(lookup=lambda frame, stamp: from_reference if "optical" in frame else
                   from_reference.compose(people_input.LEVEL.inverse()))
    frame = people_input.InteractionFrame(settings, tf)
    frame.begin(module.genpy.Time(10))
    poses = frame.places(Counter(["camera_optical_frame", "camera_optical_frame"]))
    assert frame.name == reference and frame.is_level is (reference != "map")
    ahead = poses["camera_optical_frame"].apply(np.array([0.0, -0.4, 3.0]))
    assert ahead == pytest.approx([3.0, 0.0, 0.4]), "z is up"
    assert frame.robot_source == "base" and frame.robot.heading == pytest.approx([1.0, 0.0, 0.0])
