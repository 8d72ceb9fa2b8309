"""Transforms of a face, and what the node says about people's privacy at its start."""

from dataclasses import replace
from unittest.mock import MagicMock

import genpy
import numpy as np
import pytest
from std_msgs.msg import Header

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.error_log import ItemGuard
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import FaceObservation, GazeEstimate, SoftBiometrics
from hri_pipeline.nodes.faces import FaceProcessor, FaceTopics, face_transforms, privacy_line
from hri_pipeline.ros.conversions import pose_from_transform
from hri_pipeline.ros.image_input import Frame

UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def frame():
    header = Header(stamp=genpy.Time(12, 5), frame_id="camera")
    return Frame(np.zeros((48, 64, 3), np.uint8), CameraModel.from_fov(64, 48, 1.0), 12.0, header)


def face(pose, gaze):
    return FaceObservation("abcde", np.array([1.0, 2, 3, 4]), 1.0, np.zeros((70, 3)), np.zeros((478, 3)), pose, gaze)


@pytest.mark.parametrize("interface", ["paper", "rep155"])
def test_face_and_gaze_frames(interface):
    pose = Pose(UPRIGHT, np.array([0.1, 0.2, 1.5]))
    direction = np.array([0.6, 0.0, -0.8])
    head, gaze = face_transforms(face(pose, GazeEstimate(direction, 0.9, 0.0)), frame(), interface)
    assert (head.header.frame_id, head.child_frame_id) == ("camera", "face_abcde")
    assert (gaze.header.frame_id, gaze.child_frame_id) == ("face_abcde", "gaze_abcde")
    assert head.header.stamp == gaze.header.stamp == genpy.Time(12, 5)
    whole = pose_from_transform(head).compose(pose_from_transform(gaze))
    assert whole.translation == pytest.approx(pose.translation), "collocated"
    assert whole.rotation[:, 2] == pytest.approx(direction)
    assert whole.rotation[1, 1] == pytest.approx(1.0), "y is down for a level gaze"


def test_no_gaze_frame_while_the_eyes_are_closed_and_none_at_all_without_a_pose():
    pose = Pose(UPRIGHT, np.array([0.1, 0.2, 1.5]))
    assert len(face_transforms(face(pose, GazeEstimate(None, 0.0, 1.0)), frame(), "paper")) == 1
    assert len(face_transforms(face(pose, None), frame(), "paper")) == 1
    assert face_transforms(face(None, None), frame(),
                           "paper") == face_transforms(face(None, None), frame(), "rep155") == []


@pytest.mark.parametrize("estimate", [None, GazeEstimate(None, 0.0, 1.0)])
def test_clients_of_rep155_always_find_a_gaze_frame_that_of_the_head_where_the_eyes_tell_nothing(estimate):
    pose = Pose.from_quaternion((0.1, -0.2, 0.3, 0.9), (0.1, 0.2, 1.5))
    head, gaze = face_transforms(face(pose, estimate), frame(), "rep155")
    assert (gaze.header.frame_id, gaze.child_frame_id, gaze.header.stamp) == ("face_abcde", "gaze_abcde",
                                                                              head.header.stamp)
    assert pose_from_transform(gaze).rotation[:, 2] == pytest.approx([1.0, 0.0, 0.0]), "out of the face"


def test_privacy_line():
    stock = privacy_line(FACES.resolve({}))
    assert "inferred about people: action_units, expression, age_gender, recognition; switched off: nothing" in stock
    assert "in memory only" in stock
    assert "/data/people.npz" in privacy_line(FACES.resolve({"gallery": "/data/people.npz"}))
    strict = privacy_line(FACES.resolve(
        {"action_units": False, "expression": False, "age_gender": False, "recognition": False}))
    assert strict.startswith("inferred about people: nothing; switched off: action_units") and "templates" not in strict


def test_age_and_gender_are_told_where_they_change_and_once_a_second():
    topics = FaceTopics.__new__(FaceTopics)
    topics._publishers, topics._told = MagicMock(), {}
    seen, told = face(None, None), []
    for stamp, age in ((12.0, 30.0), (12.1, 30.0), (12.2, 31.0), (12.3, 31.0), (13.1, 31.0), (13.3, 31.0), (9.0, 31.0)):
        estimate = SoftBiometrics(age, 0.8, 0.2, 0.8)
        topics._publish_biometrics(replace(seen, soft_biometrics=estimate), replace(frame(), stamp=stamp))
        told.append(topics._publishers.publish.call_count)
    assert told == [1, 1, 2, 2, 2, 3, 4], "a new value, a second without one, and a time that has gone back"
    topics._publish_biometrics(replace(seen, id="other", soft_biometrics=estimate), frame())
    topics._publish_biometrics(seen, frame())
    assert topics._publishers.publish.call_count == 5, "each face by itself, and nothing where nothing is known"
    topics.keep(iter(["other"]))
    assert list(topics._told) == ["other"] == list(topics._publishers.keep.call_args[0][0])


def test_faces_whose_topics_cannot_be_opened_are_listed_and_placed_all_the_same():
    processor = FaceProcessor.__new__(FaceProcessor)
    processor._pipeline, processor._topics, processor._tracked, processor._transforms = (MagicMock() for _ in range(4))
    processor._pipeline.tracked_ids = ["abcde"]
    processor._topics.keep.side_effect = OSError("too few file descriptors")
    processor._guard, processor._interface = ItemGuard(), "paper"
    seen = face(Pose(UPRIGHT, np.array([0.1, 0.2, 1.5])), None)
    processor._publish_places([seen], frame())
    assert processor._tracked.set.call_args[0][0] == ["abcde"]
    (transforms,), _ = processor._transforms.send.call_args
    assert [transform.child_frame_id for transform in transforms] == ["face_abcde"]
    assert "descriptors" in processor._guard.news()


@pytest.mark.parametrize("overtaken, told", [(False, True), (True, False)])
def test_nothing_is_told_of_an_image_after_which_the_time_has_gone_back(overtaken, told):
    processor = FaceProcessor.__new__(FaceProcessor)
    processor._pipeline, processor._topics, processor._tracked, processor._transforms = (MagicMock() for _ in range(4))
    processor._guard, processor._interface, processor._quarters = ItemGuard(), "paper", 0
    processor._publish_matches = processor._tell_turned = MagicMock()
    seen = face(Pose(UPRIGHT, np.array([0.1, 0.2, 1.5])), None)
    processor._pipeline.update.side_effect = lambda *arguments: arguments[-1]([seen]) or [seen]
    processor.process(replace(frame(), overtaken=lambda: overtaken), {})
    assert processor._transforms.send.called == processor._tracked.set.called == told
    assert processor._topics.publish.called == processor._publish_matches.called == told
