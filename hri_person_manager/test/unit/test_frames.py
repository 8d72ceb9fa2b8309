"""Frames of humans, kept while they are tracked, and the frames of the robot that matter."""

from __future__ import annotations

import numpy as np
import pytest

from hri_person_manager.core.association import Kind
from hri_person_manager.core.human_frames import MAX_LINKS, HumanFrames, Link
from hri_person_manager.core.location import Source
from hri_pipeline.core.frame_tree import FrameTree
from hri_pipeline.core.geometry import Pose


def link(parent, z, stamp=1.0):
    return Link(parent, (0.0, 0.0, z), (0.0, 0.0, 0.0, 1.0), stamp)


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
    assert put(frames, "body_abcde", "camera", 3.0).source == Source.BODY
    put(frames, "head_abcde", "neck_abcde", 0.2)
    assert put(frames, "body_abcde", "camera", 3.0).source == Source.BODY
    put(frames, "neck_abcde", "body_abcde", 0.5)
    sighting = put(frames, "body_abcde", "camera", 3.0)
    assert (sighting.source, sighting.sensor) == (Source.HEAD, "camera")
    assert np.isclose(sighting.pose.translation[2], 3.7)
    assert put(frames, "body_abcde", "camera", 3.0, stamp=9.0).source == Source.BODY     # the head is old


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
        frames.put((Kind.BODY, "abcde"), names[index], Link(
            names[index - 1], tuple(pose.translation), tuple(2.0 * value for value in pose.quaternion), stamps[index]))
    root = Link("camera", tuple(poses[0].translation), poses[0].quaternion, 20.1)
    sighting = frames.put((Kind.BODY, "abcde"), names[0], root)
    expected = poses[0]
    for pose in poses[1:]:
        expected = expected.compose(pose)
    assert sighting.source == Source.HEAD and sighting.sensor == "camera"
    assert np.allclose(sighting.pose.translation, expected.translation)
    assert np.allclose(sighting.pose.rotation, expected.rotation)
    frames.clear()
    assert len(frames) == 2 and frames.put((Kind.BODY, "abcde"), names[0], root).source == Source.BODY


def test_only_frames_between_head_and_root_are_wanted():
    frames = HumanFrames(0.5)
    frames.set_tracked(Kind.BODY, ["abcde"])
    assert frames.wanted("l_elbow_abcde") is None and frames.wanted("torso_abcde") is None
    put(frames, "head_abcde", "torso_abcde", 0.2)
    assert frames.wanted("torso_abcde") == (Kind.BODY, "abcde")
    frames.set_tracked(Kind.BODY, [])
    assert frames.wanted("torso_abcde") is None and frames.wanted("body_abcde") is None


@pytest.mark.parametrize("bad", [
    Link("camera", (float("nan"), 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), 1.0),
    Link("camera", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0), 1.0),
    Link("camera", (0.0, 0.0, 1.0), (0.0, float("inf"), 0.0, 1.0), 1.0)])
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
    assert put(frames, "body_abcde", "camera", 3.0).source == Source.BODY


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
    assert put(frames, "body_abcde", "camera", 3.0).source == Source.HEAD


def test_only_what_lies_above_a_followed_frame_is_relevant():
    tree = FrameTree()
    assert tree.follow("map") == []
    assert tree.put("camera", "base", "camera->base", True) == []
    assert tree.put("base", "odom", "base->odom", False) == []
    assert tree.put("wheel", "base", "wheel->base", False) == []
    assert tree.follow("camera") == ["camera->base", "base->odom"]
    assert tree.put("odom", "map", "odom->map", False) == ["odom->map"]
    assert tree.put("base", "odom", "newer", False) == ["newer"]
    assert tree.relevant == {"map", "camera", "base", "odom"}
    assert tree.forget_moving() == ["camera->base"]
    assert tree.latest("base") is None


def test_the_tree_is_bounded_and_keeps_what_is_relevant():
    tree = FrameTree(max_frames=10)
    tree.follow("camera")
    tree.put("camera", "map", "camera->map", True)
    for number in range(100):
        tree.put("stray%d" % number, "map", number, True)
    assert len(tree) == 10 and tree.latest("camera") == "camera->map"


def test_fixed_frames_outlive_moving_ones_of_which_nobody_knows_the_use():
    tree = FrameTree(max_frames=10)
    tree.put("camera", "base", "camera->base", True)      # comes once
    for number in range(100):
        tree.put("limb%d" % number, "body", number, False)
    assert len(tree) == 10
    assert tree.follow("camera") == ["camera->base"]
    assert tree.latest("limb99") == 99 and tree.latest("limb1") is None
