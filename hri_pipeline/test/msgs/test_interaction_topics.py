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
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import FacialActionUnits
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


def test_each_stamp_has_one_result_also_when_the_next_image_comes_meanwhile(monkeypatch):
    """People are taken at the newest stamp, which may be newer than the one that the cycle began with."""
    monkeypatch.setattr(module.rospy, "get_time", lambda: 102.0)
    node = InteractionsNode.__new__(InteractionsNode)
    for name in ("_people", "_frame", "_gazes", "_engagement", "_topics", "_publish", "_times", "_group", "_rest",
                 "_watch_clock"):
        setattr(node, name, MagicMock())
    node._settings, node._last, node._frame.robot = SimpleNamespace(rate=15.0), module.genpy.Time(), None
    node._frame_name = node._frame.name
    node._people.take.return_value = SimpleNamespace(stamp=genpy.Time(101), people=MagicMock(), unplaced=[])
    for newest in (100, 101, 101):
        node._people.stamp = genpy.Time(newest)
        node._cycle()
    assert [call.args[0] for call in node._publish.call_args_list] == [genpy.Time(101)]


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


def people_with_faces(monkeypatch, *names):
    """Input of people with these names, the voice v of which and the face f of which are known; the frames of all
    faces have come."""
    monkeypatch.setattr(people_input, "IdSubscribers", MagicMock())
    monkeypatch.setattr(people_input, "TfSubscriber", MagicMock())
    monkeypatch.setattr(people_input.rospy, "get_time", lambda: 100.2)
    people = people_input.PeopleInput(INTERACTION_PARAMETERS.resolve({}), MagicMock())
    people._on_people(list(names))
    for name in names:
        people._on_feature(name, "voice_id", String("v" + name))
    see_faces(people, names)
    return people


def see_faces(people, names):
    for name in names:
        people._on_feature(name, "face_id", String("f" + name))
    data = io.BytesIO()
    TFMessage([transform_to_msg(Pose(np.eye(3), np.ones(3)), genpy.Time.from_sec(100.1), "camera", "face_f" + name)
               for name in names]).serialize(data)
    people._on_frames(data.getvalue(), scan(data.getvalue()), False)


def places(sensors):
    return {sensor: Pose.identity() for sensor in sensors}


def who_speaks(people):
    found = people.take(places).people
    return [] if found.speaking is None else [name for name, speaks in zip(found.ids, found.speaking) if speaks]


def test_who_speaks_is_whose_voice_does(monkeypatch):
    people = people_with_faces(monkeypatch, "ann", "bob")
    assert who_speaks(people) == []
    people._on_speaking("vann", "is_speaking", Bool(True))
    people._on_speaking("vbob", "is_speaking", Bool(False))
    assert who_speaks(people) == ["ann"]
    people._on_feature("ann", "voice_id", String(""))
    assert who_speaks(people) == [], "it was somebody else's voice"
    people._on_feature("ann", "voice_id", String("vann"))
    people._on_people(["bob"])
    people._on_people(["bob", "ann"])
    see_faces(people, ["ann", "bob"])
    assert people.take(places).unplaced == [] and who_speaks(people) == [], "whose voice it is was of before she left"
    people._on_feature("ann", "voice_id", String("vann"))
    people._on_voices(["vbob"])
    assert who_speaks(people) == [], "the voice has ended in the middle of a word"


def test_who_is_tracked_and_has_no_place_is_told_apart_and_what_is_no_id_is_refused(monkeypatch):
    people = people_with_faces(monkeypatch, "ann", "bob")
    taken = people.take(places)
    assert taken.stamp == genpy.Time.from_sec(100.1) and list(taken.people.ids) == ["ann", "bob"]
    assert taken.unplaced == []
    people._on_people(["ann", "bob", "cid"])
    assert people.take(places).unplaced == ["cid"] and people.ids == ["ann", "bob", "cid"]
    for name in ("face_id", "body_id", "voice_id"):
        with pytest.raises(ValueError, match="is not an id"):
            people._on_feature("ann", name, String("../f"))
    assert list(people.take(places).people.ids) == ["ann", "bob"]
    people._on_feature("ann", "face_id", String(""))
    assert people.take(places).unplaced == ["ann", "cid"]


def test_closed_eyes_are_told_by_the_units_that_are_known(monkeypatch):
    people = people_with_faces(monkeypatch, "ann", "bob")

    def eyes(face, *units):
        message = FacialActionUnits(intensity=[0.0] * 99, confidence=[0.0] * 99)
        for unit, intensity, confidence in units:
            message.intensity[unit], message.confidence[unit] = intensity, confidence
        people._on_facs(face, "facs", message)
        return people._closures.get(face)

    closed, blink = people_input.AU_EYES_CLOSED, people_input.AU_BLINK
    assert eyes("fann", (closed, 1.0, 0.0), (blink, float("nan"), 1.0)) is None
    assert eyes("fann", (closed, 0.2, 1.0), (blink, 0.9, 1.0))[1] == eyes("fann", (blink, 0.9, 0.5))[1] == 0.9
    assert eyes("fann", (closed, 0.3, 1.0), (blink, 0.9, 0.0))[1] == 0.3
    with pytest.raises(ValueError, match="without number"):
        people._on_facs("fann", "facs", FacialActionUnits(intensity=[0.0] * 20, confidence=[0.0] * 20))
    people._on_faces(["fbob"])
    assert not people._closures


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


@pytest.mark.parametrize("reference", ["map", "wall_optical_frame"])
def test_of_a_camera_that_turns_people_are_where_they_were_seen_whatever_the_reference_frame(reference):
    settings = INTERACTION_PARAMETERS.resolve({"reference_frame": reference})
    from_reference = Pose.identity() if reference != "map" else people_input.LEVEL
    tf = MagicMock(lookup=lambda frame, stamp: from_reference.compose(Pose(np.eye(3), [0.0, 0.0, stamp.to_sec()])))
    frame = people_input.InteractionFrame(settings, tf)
    frame.begin(module.genpy.Time(10))
    poses = frame.places(Counter(["head_optical_frame"]))
    assert poses["head_optical_frame"].translation == pytest.approx([10.0, 0.0, 0.0])
    pose = frame.pose_at("head_optical_frame", 9.0)
    assert pose is not None and pose.translation == pytest.approx([9.0, 0.0, 0.0])
    assert frame.pose_at(reference, 9.0) is None, "it is where `places` says"
