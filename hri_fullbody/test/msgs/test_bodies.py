"""Messages of bodies: transforms, joint states, crops, constants. Needs the message packages, no master."""

from __future__ import annotations

import io
import threading
from collections import OrderedDict
from dataclasses import replace
from unittest.mock import MagicMock

import genpy
import numpy as np
import pytest
import rospy
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage

from benchmarks.report import least_cost
from hri_fullbody.core.behaviour.attitude import AttitudeClass
from hri_fullbody.core.behaviour.gesture import GestureClass
from hri_fullbody.core.behaviour.posture import PostureClass
from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.model.anthropometry import SegmentTable
from hri_fullbody.core.model.human import Dimensions, layout_for
from hri_fullbody.core.modeller import BodyInput, BodyModeller
from hri_fullbody.core.parameters import BODIES
from hri_fullbody.core.tracking.reidentification import Reidentification
from hri_fullbody.ros import bodies
from hri_fullbody.ros.bodies import BodyProcessor, ReidentificationMatches, body_transform, drawn
from hri_fullbody.ros.topics import BodyTopics, crop, joint_state
from hri_msgs.msg import BodyAttitude, BodyPosture, IdsList
from hri_msgs.msg import Gesture as GestureMessage
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import turned_problem
from hri_pipeline.core.observations import BodyObservation
from hri_pipeline.ros.conversions import landmarks_to_msg, pose_from_transform, transform_to_msg
from hri_pipeline.ros.image_input import Frame
from hri_pipeline.ros.mounting import up_and_height

HEADER = Header(stamp=genpy.Time(12, 345), frame_id="camera")
FRAME = Frame(np.zeros((4, 4, 3), np.uint8), CameraModel.from_fov(4, 4, 1.0), 12.000000345, HEADER)
FACING = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
UP = np.array([0.0, -1.0, 0.0])


def model_of(interface):
    """A person of 1.7 m, 3 m before the camera, as the modeller sees it."""
    modeller = BodyModeller(interface)
    layout = layout_for(interface)
    dimensions = Dimensions.from_stature(1.7, SegmentTable.load())
    points, _, _ = forward(FACING[None], np.array([[0.1, 0.2, 3.0]]), np.zeros((1, len(layout))), [dimensions], layout)
    model, = modeller.update([BodyInput("abcde", points[0])], 1.0, UP)
    return model, layout


@pytest.mark.parametrize("interface, joints", [("paper", 18), ("rep155", 20)])
def test_joints_are_suffixed_and_have_the_stamp_of_the_image(interface, joints):
    model, layout = model_of(interface)
    message = joint_state(model, layout.joint_names, FRAME)
    assert len(message.name) == len(message.position) == joints
    assert all(name.endswith("_abcde") for name in message.name) and len(set(message.name)) == joints
    assert "waist_abcde" in message.name and "l_elbow_abcde" in message.name
    assert message.header == HEADER and np.all(np.isfinite(message.position))


def test_joints_that_are_no_numbers_are_not_published():
    model, layout = model_of("paper")
    for bad in (np.full(18, np.nan), np.zeros(17), np.concatenate([np.zeros(17), [np.inf]])):
        assert joint_state(replace(model, joints=bad), layout.joint_names, FRAME) is None


def test_the_body_has_the_stamp_and_frame_of_the_image():
    model, _ = model_of("paper")
    transform = body_transform(model, FRAME)
    assert (transform.header.frame_id, transform.child_frame_id) == ("camera", "body_abcde")
    assert transform.header.stamp == HEADER.stamp
    pose = pose_from_transform(transform)
    assert pose.translation == pytest.approx([0.1, 0.2, 3.0], abs=0.02)
    assert np.allclose(pose.rotation, FACING, atol=0.05)


def test_filtered_points_are_drawn_and_observed_ones_where_there_is_no_model():
    model, _ = model_of("paper")
    body = BodyObservation("abcde", np.array([0.0, 0, 4, 4]), 0.9, np.zeros((18, 3)), np.full((18, 3), 7.0))
    assert drawn(body, model).keypoints_3d is model.points
    assert drawn(body, None) is body
    assert drawn(replace(body, measured=False), model).keypoints_3d is body.keypoints_3d


def test_a_key_point_is_published_as_sure_as_it_is_seen_and_right():
    topics = BodyTopics("paper")
    topics._publishers = MagicMock()
    points = np.tile([2.0, 1.0, 0.8], (18, 1))
    body = BodyObservation("abcde", np.array([0.0, 0, 4, 4]), 0.9, points, np.full((18, 3), 7.0))
    for reliability, told in ((None, 0.8), (np.full(18, 0.5), 0.4)):
        topics.publish_seen(replace(body, reliability=reliability), FRAME)
        sent = {call.args[1]: call.args[2] for call in topics._publishers.publish.call_args_list}["skeleton2d"]
        assert [point.c for point in sent.skeleton] == pytest.approx([told] * 18)
        assert (sent.skeleton[4].x, sent.skeleton[4].y) == pytest.approx((2.0 / 3.0, 1.0 / 3.0), abs=0.2)


def test_a_crop_is_the_part_of_the_box_that_is_in_the_image():
    image = np.arange(10 * 20 * 3, dtype=np.uint8).reshape(10, 20, 3)
    assert np.array_equal(crop(image, np.array([2.2, 3.0, 5.5, 6.0])), image[3:6, 2:6])
    assert crop(image, np.array([-5.0, -5, 50, 50])).shape == (10, 20, 3)
    for outside in ([30.0, 0, 40, 5], [5.0, 5, 5, 5], [0.0, -9, 5, -1], [np.nan, 0, 1, 1]):
        assert crop(image, np.array(outside)) is None


def test_up_is_the_z_axis_of_the_other_frame_and_a_height_must_be_one():
    upright = Pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([4.0, 5.0, 1.4]))
    up, height = up_and_height(upright)
    assert up == pytest.approx([0, -1, 0]) and height == pytest.approx(1.4)
    assert up_and_height(Pose(upright.rotation, np.array([0.0, 0, -3.0])))[1] is None


@pytest.mark.parametrize("seen, transform, words", [
    (None, None, None), (0, None, None), (None, 0, None), (0, 0, None),
    (2, None, "only after half a turn"), (2, 0, "only after half a turn"), (1, 1, "a quarter turn anticlockwise"),
    (None, 3, "~up_frame they would be upright after a quarter turn clockwise"), (0, 2, "correct the transform")])
def test_a_camera_that_is_mounted_turned_is_told_with_the_mend(seen, transform, words):
    text = turned_problem(seen, transform)
    assert text == "" if words is None else words in text and "Mend: " in text


@pytest.mark.parametrize("seen, rotation, by_gravity, mend", [
    (1, 0, False, "set image_rotation:=270, or up_frame"), (2, 0, False, "image_rotation:=180,"),
    (2, 90, False, "image_rotation:=270,"), (1, 180, True, "correct the transform of the camera to ~up_frame, or set"
                                                           " image_rotation:=90")])
def test_the_mend_is_the_rotation_that_makes_the_images_upright(seen, rotation, by_gravity, mend):
    text = turned_problem(seen, None, rotation, by_gravity)
    assert mend in text and ("{} degrees clockwise already".format(rotation) in text) == bool(rotation)


def test_a_camera_between_two_turns_is_not_told_where_gravity_decides():
    assert turned_problem(0, 1, 90, True) == turned_problem(None, 1, 0, True) == ""


@pytest.mark.parametrize("ours, message", [
    (AttitudeClass, BodyAttitude), (PostureClass, BodyPosture), (GestureClass, GestureMessage)])
def test_numbers_equal_the_constants_of_the_message(ours, message):
    constants = {name: getattr(message, name) for name in vars(message)
                 if name.isupper() and isinstance(getattr(message, name), int)}
    assert {item.name: item.value for item in ours} == constants


def transforms_of_ten(stamp=10.0):
    """A message of /tf of ten faces that look somewhere, as bytes, and the poses of the faces by id."""
    random, poses, sent = np.random.default_rng(1), {}, []
    for identity in ("face{}".format(number) for number in range(10)):
        pose = poses[identity] = Pose.from_quaternion(random.normal(size=4), random.normal(size=3))
        sent += [transform_to_msg(pose, stamp, "camera", "face_" + identity),
                 transform_to_msg(pose, stamp, "face_" + identity, "gaze_" + identity)]
    return serialised(sent), poses


def serialised(transforms):
    buffer = io.BytesIO()
    TFMessage(transforms=transforms).serialize(buffer)
    message = rospy.AnyMsg()
    message._buff = buffer.getvalue()
    return message


@pytest.fixture
def face_input(monkeypatch):
    """A FaceInput that listens to nothing."""
    monkeypatch.setattr(bodies, "IdSubscribers", lambda *_, **__: None)
    monkeypatch.setattr(bodies.rospy, "Subscriber", lambda *_, **__: None)
    monkeypatch.setattr(bodies.rospy, "logwarn_throttle", lambda *_: None)
    return bodies.FaceInput(list_timeout=0.0)


def test_poses_of_faces_are_taken_out_of_the_bytes(face_input):
    message, poses = transforms_of_ten()
    face_input._keep(list(poses)[1:])
    face_input._on_transforms(message)
    assert face_input._pose_near("face0", 10.0, "camera") is None, "nobody lists it"
    for identity in list(poses)[1:]:
        assert np.allclose(face_input._pose_near(identity, 10.0, "/camera").rotation, poses[identity].rotation)
        assert face_input._pose_near(identity, 10.0, "other") is face_input._pose_near(identity, 10.3, "camera") is None


def test_what_is_no_pose_costs_no_other_face(face_input):
    face_input._keep(["bad", "good"])
    good = transform_to_msg(Pose.identity(), 10.0, "camera", "face_good")
    nowhere, unturned = (transform_to_msg(Pose.identity(), 10.0, "camera", "face_bad") for _ in range(2))
    nowhere.transform.translation.x, unturned.transform.rotation.w = float("nan"), 0.0
    face_input._on_transforms(serialised([nowhere, unturned, good]))
    cut = serialised([good])
    cut._buff = cut._buff[:-3]
    face_input._on_transforms(cut)
    assert set(face_input._poses) == {"good"} and len(face_input._poses["good"]) == 1


def test_poses_of_faces_are_cheap(face_input):
    """They come with each image of the faces, and bodies look at few of them; it is a third of unpacking (measured)."""
    message, poses = transforms_of_ten()
    face_input._keep(list(poses))

    unpacking = least_cost(lambda: TFMessage().deserialize(message._buff), 30)
    assert least_cost(lambda: face_input._on_transforms(message), 30) < 0.7 * unpacking


def test_a_body_that_comes_back_is_not_matched_with_somebody_who_was_forgotten_meanwhile():
    matches = ReidentificationMatches.__new__(ReidentificationMatches)
    matches._lock, matches._person_of, matches._known, matches._publisher = (
        threading.Lock(), OrderedDict(), None, MagicMock())
    for person, body in (("ann", "b1"), ("bob", "b2")):
        matches._on_body_id(person, "body_id", String(body))
        matches._on_body_id(person, "body_id", String(""))
    matches._on_known(IdsList(ids=["bob"]))
    matches.publish([Reidentification("b3", "b1", 0.95), Reidentification("b4", "b2", 0.95)])
    (match,), _ = matches._publisher.publish.call_args
    assert matches._publisher.publish.call_count == 1 and (match.id1, match.id2) == ("b4", "bob")


@pytest.mark.parametrize("overtaken, told", [(False, True), (True, False)])
def test_nothing_is_told_of_an_image_after_which_the_time_has_gone_back(overtaken, told):
    processor = MagicMock()
    processor._find.side_effect = lambda frame, context, seen: seen([])
    processor._publish = lambda *about: BodyProcessor._publish(processor, *about)
    BodyProcessor.process(processor, replace(FRAME, overtaken=lambda: overtaken), {})
    assert processor._tracked.set.called == processor._publish_models.called == processor._guard.each.called == told


def test_the_first_body_need_not_wait_for_what_takes_long_the_first_time(monkeypatch):
    is_prepared = threading.Event()
    for name in ("BodyPipeline", "StatePublishers", "BodyTopics", "TrackedList", "TfPublisher", "FaceInput",
                 "ReidentificationMatches", "ModelLog"):
        monkeypatch.setattr(bodies, name, MagicMock())
    monkeypatch.setattr(rospy, "Publisher", MagicMock())
    monkeypatch.setattr(bodies, "prepare_colours", is_prepared.set)
    BodyProcessor(BODIES.resolve({}))
    assert is_prepared.wait(60.0)


def test_faces_of_another_process_are_forgotten_with_the_bodies_and_none_are_expected_without_it():
    processor = MagicMock()
    BodyProcessor.reset(processor)
    processor._faces.reset.assert_called_once_with()
    processor._faces.boxes.return_value = []
    for is_published, found in ((True, []), (False, None)):
        processor._faces.is_published = is_published
        assert BodyProcessor._face_boxes(processor, FRAME, {}) == found
    assert BodyProcessor._face_boxes(processor, FRAME, {"faces": []}) == [], "of the same process"
    processor._faces = None
    assert BodyProcessor._face_boxes(processor, FRAME, {}) == [], "which has failed in this image"


@pytest.mark.parametrize("stamp, nearest", [(10.0, 10.0), (10.12, 10.1), (10.6, 10.2)])
def test_of_the_images_of_a_face_that_nearest_to_the_body_s_is_taken_and_told(face_input, stamp, nearest):
    """While the camera turns, the same face is elsewhere in the next image."""
    face_input._keep(["f0"])
    for number in range(3):
        points = np.column_stack([np.linspace(100.0, 200.0, 70) + 100.0 * number, np.linspace(300.0, 400.0, 70),
                                  np.ones(70)])
        face_input._store("f0", "landmarks", landmarks_to_msg(
            points, Header(stamp=rospy.Time.from_sec(10.0 + 0.1 * number), frame_id="camera"), 1000, 1000))
    face, = face_input.boxes(stamp, 1000, 1000, "camera")
    assert face.stamp == pytest.approx(nearest)
    assert face.box[0] == pytest.approx(100.0 + 1000.0 * (nearest - 10.0), abs=0.1)
