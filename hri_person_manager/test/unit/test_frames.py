"""Frames of humans, kept while they are tracked, and the frames of the robot that matter."""

from __future__ import annotations

import numpy as np

from hri_person_manager.core.association import Kind
from hri_person_manager.core.frame_tree import FrameTree
from hri_person_manager.core.human_frames import MAX_LINKS, HumanFrames, Link
from hri_person_manager.core.location import Source
from hri_pipeline.core.geometry import Pose


def link(parent, z, stamp=1.0):
    return Link(parent, Pose(np.eye(3), np.array([0.0, 0.0, z])), stamp)


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
