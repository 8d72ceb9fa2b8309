"""Frames of humans, kept while they are tracked."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hri_person_manager.core.features import Kind
from hri_person_manager.core.human_frames import MAX_LINKS, FrameLink, HumanFrames
from hri_person_manager.core.location import PlaceSource
from hri_pipeline.core.geometry import Pose


def link(parent, z, stamp=1.0, arrived=math.nan):
    return FrameLink(parent, (0.0, 0.0, z), (0.0, 0.0, 0.0, 1.0), stamp, arrived)


def put(frames, name, parent, z, stamp=1.0):
    return frames.put(frames.owner(name), name, link(parent, z, stamp))


def test_whose_frame_it_is():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.FACE, ["abcde", "a_b"])
    frames.set_tracked(Kind.BODY, ["abcde", "link"])
    assert frames.owner("face_abcde") == (Kind.FACE, "abcde")
    assert frames.owner("face_a_b") == (Kind.FACE, "a_b")
    assert frames.owner("l_elbow_abcde") == (Kind.BODY, "abcde")
    for name in ("person_abcde", "gaze_abcde", "voice_abcde", "face_zzzzz", "map", "_abcde", "head_camera", ""):
        assert frames.owner(name) is None, name


def test_a_body_is_placed_by_its_head_when_the_chain_is_complete():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY
    put(frames, "head_abcde", "neck_abcde", 0.2)
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY
    put(frames, "neck_abcde", "body_abcde", 0.5)
    feature_pose = put(frames, "body_abcde", "camera", 3.0)
    assert (feature_pose.source, feature_pose.sensor) == (PlaceSource.HEAD, "camera")
    assert np.isclose(feature_pose.pose.translation[2], 3.7)
    assert put(frames, "body_abcde", "camera", 3.0, stamp=9.0).source == PlaceSource.BODY     # the head is old


def test_the_chain_to_the_head_is_composed_exactly_and_fixed_links_never_grow_old():
    rng = np.random.default_rng(4)
    poses = [Pose.from_quaternion(rng.normal(size=4), rng.normal(size=3)) for _ in range(6)]
    names = ["body_abcde", "waist_abcde", "torso_abcde", "y_head_abcde", "p_head_abcde", "head_abcde"]
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    stamps = [20.0, 20.0, float("inf"), 20.0, 20.0, float("inf")]
    for index in (5, 4, 3, 2, 1):
        assert frames.wanted(names[index]) == (Kind.BODY, "abcde"), names[index]
        pose = poses[index]
        frames.put((Kind.BODY, "abcde"), names[index], FrameLink(
            names[index - 1], tuple(pose.translation), tuple(2.0 * value for value in pose.quaternion), stamps[index]))
    root = FrameLink("camera", tuple(poses[0].translation), poses[0].quaternion, 20.1)
    feature_pose = frames.put((Kind.BODY, "abcde"), names[0], root)
    expected = poses[0]
    for pose in poses[1:]:
        expected = expected.compose(pose)
    assert feature_pose.source == PlaceSource.HEAD and feature_pose.sensor == "camera"
    assert np.allclose(feature_pose.pose.translation, expected.translation)
    assert np.allclose(feature_pose.pose.rotation, expected.rotation)
    frames.clear()
    assert len(frames) == 2 and frames.put((Kind.BODY, "abcde"), names[0], root).source == PlaceSource.BODY


def test_a_head_places_a_body_of_which_there_is_no_body_frame():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    feature_pose = put(frames, "head_abcde", "camera", 3.0)
    assert (feature_pose.source, feature_pose.id, feature_pose.sensor,
            feature_pose.stamp) == (PlaceSource.HEAD, "abcde", "camera", 1.0)
    assert np.isclose(feature_pose.pose.translation[2], 3.0)


def test_a_chain_from_the_head_to_the_sensor_places_a_body_once_per_image():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    assert put(frames, "head_abcde", "neck_abcde", 0.2) is None
    assert put(frames, "neck_abcde", "torso_abcde", 0.5, stamp=float("inf")) is None
    feature_pose = put(frames, "torso_abcde", "camera", 3.0)
    assert feature_pose.source == PlaceSource.HEAD and np.isclose(feature_pose.pose.translation[2], 3.7)
    assert put(frames, "head_abcde", "neck_abcde", 0.3, stamp=1.5) is None
    assert np.isclose(put(frames, "torso_abcde", "camera", 3.0, stamp=1.5).pose.translation[2], 3.8)
    assert put(frames, "torso_abcde", "camera", 3.0, stamp=9.0) is None         # the head is old


def test_a_head_that_moves_on_a_fixed_torso_places_the_body():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    put(frames, "head_abcde", "torso_abcde", 0.2)
    put(frames, "torso_abcde", "camera", 3.0, stamp=float("inf"))
    assert np.isclose(put(frames, "head_abcde", "torso_abcde", 0.3, stamp=2.0).pose.translation[2], 3.3)


@pytest.mark.parametrize("sensor", ["camera", "other_camera"])
def test_a_head_beside_its_body_in_a_sensor_frame_goes_before_it(sensor):
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY
    assert put(frames, "head_abcde", sensor, 3.6).source == PlaceSource.HEAD
    assert put(frames, "body_abcde", "camera", 3.0, stamp=1.1).source == PlaceSource.BODY
    feature_pose = put(frames, "head_abcde", sensor, 3.7, stamp=1.1)
    assert (feature_pose.source, feature_pose.sensor) == (PlaceSource.HEAD, sensor)


def test_a_chain_that_lags_is_used_as_long_as_it_comes():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    for number in range(40):
        now = 10.0 + 0.05 * number
        frames.put((Kind.BODY, "abcde"), "head_abcde", link("body_abcde", 0.6, now - 0.7, now))
        feature_pose = frames.put((Kind.BODY, "abcde"), "body_abcde", link("camera", 3.0, now, now))
        assert feature_pose.source == PlaceSource.HEAD
    assert frames.put((Kind.BODY, "abcde"), "body_abcde", link("camera", 3.0, 12.6, 12.6)).source == PlaceSource.BODY


def test_a_fixed_frame_of_a_feature_may_come_before_the_list():
    frames = HumanFrames(0.5)
    for frame in ("face_f1", "voice_v1", "body_b1", "head_b2"):
        frames.keep_static(frame, link("camera", 2.0, float("inf")))
    frames.keep_static("head_f1", link("camera", float("nan"), float("inf")))
    found = [feature_pose for kind, ids in ((Kind.FACE, ["f1"]), (Kind.BODY, ["b1", "b2", "f1"]), (Kind.VOICE, ["v1"]))
             for feature_pose in frames.set_tracked(kind, ids)]
    assert {(feature_pose.source, feature_pose.id) for feature_pose in found} == {
        (PlaceSource.FACE, "f1"), (PlaceSource.BODY, "b1"), (PlaceSource.HEAD, "b2"), (PlaceSource.VOICE, "v1")}
    assert frames.set_tracked(Kind.FACE, ["f1"]) == []


def test_only_frames_between_head_and_root_are_wanted():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    assert frames.wanted("l_elbow_abcde") is None and frames.wanted("torso_abcde") is None
    put(frames, "head_abcde", "torso_abcde", 0.2)
    assert frames.wanted("torso_abcde") == (Kind.BODY, "abcde")
    frames.set_tracked(Kind.BODY, [])
    assert frames.wanted("torso_abcde") is None and frames.wanted("body_abcde") is None


@pytest.mark.parametrize("bad", [
    FrameLink("camera", (float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 1.0),
    FrameLink("camera", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0), 1.0),
    FrameLink("camera", (0.0, 0.0, 1.0), (0.0, float("inf"), 0.0, 1.0), 1.0)])
@pytest.mark.parametrize("name", ["face_abcde", "body_abcde", "head_abcde"])
def test_numbers_that_are_none_are_refused(bad, name):
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    frames.set_tracked(Kind.FACE, ["abcde"])
    with pytest.raises(ValueError):
        frames.put(frames.owner(name), name, bad)
    assert len(frames) == 0


def test_links_in_a_circle_end():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    put(frames, "head_abcde", "neck_abcde", 0.2)
    put(frames, "neck_abcde", "head_abcde", 0.2)
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY


def test_frames_go_with_their_human_and_are_bounded():
    frames = HumanFrames(0.5)
    for number in range(1000):
        name = "x%d" % number
        frames.set_tracked(Kind.BODY, [name])
        put(frames, "body_" + name, "camera", 1.0)
    assert len(frames) == 1
    for number in range(2 * MAX_LINKS):
        put(frames, "l%d_x999" % number, "body_x999", 1.0)
    assert len(frames) == MAX_LINKS


def test_a_fixed_link_may_come_before_the_list():
    frames = HumanFrames(0.5)
    frames.keep_static("head_abcde", link("body_abcde", 0.6, float("inf")))
    frames.set_tracked(Kind.BODY, ["abcde"])
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.HEAD
