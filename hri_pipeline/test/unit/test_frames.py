"""Frames of /tf: names and numbers out of the bytes of a message, and the frames of humans that are followed."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_pipeline.core.frames import FrameHistory, HumanTf, RawTransform, Timed, read, read_stamp, scan
from hri_pipeline.core.geometry import rotate, view_axis


def packed(*transforms):
    """Serialise transforms as the message's definition says."""
    data = struct.pack("<I", len(transforms))
    for transform in transforms:
        data += struct.pack("<III", 7, transform.secs, transform.nsecs)
        for name in (transform.parent, transform.child):
            text = name.encode()
            data += struct.pack("<I", len(text)) + text
        data += struct.pack("<7d", *transform.translation, *transform.rotation)
    return data


HEAD = RawTransform("neck_abcde", "head_abcde", 12, 500000000, (0.1, 0.2, 0.3), (0.0, 0.0, 0.6, 0.8))
LONG = RawTransform("map", "x" * 300, 1, 2, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))


def test_all_frames_are_named_and_read():
    data = packed(HEAD, LONG, HEAD)
    frames = scan(data)
    assert [name for name, _ in frames] == [b"head_abcde", b"x" * 300, b"head_abcde"]
    assert [read(data, offset) for _, offset in frames] == [HEAD, LONG, HEAD]
    assert read(data, frames[0][1]).stamp == 12.5
    assert scan(packed()) == []


def test_a_leading_slash_is_dropped():
    data = packed(HEAD._replace(parent="/neck", child="/head"))
    assert read(data, scan(data)[0][1])[:2] == ("neck", "head")


@pytest.mark.parametrize("data", [
    b"", b"\x01", packed(HEAD)[:-1], packed(HEAD) + b"\0", struct.pack("<I", 2 ** 32 - 1),
    struct.pack("<I", 1) + b"\xff" * 200])
def test_what_is_no_message_is_refused(data):
    with pytest.raises(ValueError):
        scan(data)


@pytest.mark.parametrize("secs, nsecs", [(2 ** 31 - 1, 0), (2 ** 32 - 1, 2 ** 32 - 1), (12, 10 ** 9)])
def test_a_stamp_that_is_none_is_refused(secs, nsecs):
    data = packed(HEAD._replace(secs=secs, nsecs=nsecs))
    for reader in (read, read_stamp):
        with pytest.raises(ValueError, match="no time"):
            reader(data, scan(data)[0][1])


@pytest.mark.parametrize("secs, nsecs", [(0, 0), (2 ** 31 - 2, 999999999)])
def test_the_first_and_the_last_stamp(secs, nsecs):
    data = packed(HEAD._replace(secs=secs, nsecs=nsecs))
    assert read_stamp(data, 4) == (secs, nsecs)
    assert read(data, 4) == HEAD._replace(secs=secs, nsecs=nsecs)


@pytest.mark.parametrize("numbers, is_pose", [
    ({}, True), ({"rotation": (0.0, 0.0, 3.0, 4.0)}, True), ({"rotation": (0.0,) * 4}, False),
    ({"rotation": (0.0, 0.0, 0.0, float("nan"))}, False), ({"rotation": (1e200, 0.0, 0.0, 1e200)}, False),
    ({"translation": (0.0, float("inf"), 0.0)}, False), ({"translation": (float("nan"), 0.0, 0.0)}, False),
    ({"translation": (6.4e6, 0.0, -6.4e6)}, True), ({"translation": (0.0, -1e12, 0.0)}, False)])
def test_numbers_that_are_a_pose(numbers, is_pose):
    assert HEAD._replace(**numbers).is_pose is is_pose


def link(parent, child, seed=None, stamp=1.0, position=(0.0, 0.0, 2.0)):
    if seed is None:
        return RawTransform(parent, child, int(stamp), int(1e9 * (stamp % 1.0)), position, (0.0, 0.0, 0.0, 1.0))
    turn = tuple(Rotation.random(random_state=seed).as_quat())
    return RawTransform(parent, child, int(stamp), int(1e9 * (stamp % 1.0)),
                        tuple(np.random.default_rng(seed).normal(size=3)), turn)


def followed():
    tf = HumanTf()
    tf.follow(face=["f1"], head=["b1"])
    return tf


def test_frames_of_strangers_are_not_wanted_and_a_face_is_below_its_camera():
    tf = followed()
    assert tf.wants(b"face_f1") and tf.wants(b"head_b1")
    assert not tf.wants(b"face_b1") and not tf.wants(b"l_arm_b1") and not tf.wants(b"map")
    assert tf.put(link("camera", "face_f1"), False) == "f1"
    assert tf.chain("face_f1") == [Timed(link("camera", "face_f1"), 1.0, arrived=math.nan)]
    assert tf.put(link("camera", "face_f2"), False) is None
    assert tf.get("face_f2") is None and tf.chain("face_f2") == [] and len(tf) == 1


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (1, 3, 0, 2)])
@pytest.mark.parametrize("whole", [True, False])
def test_the_links_from_the_head_to_the_camera_are_found_in_any_order(order, whole):
    chain = [link("neck_b1", "head_b1", 4), link("torso_b1", "neck_b1", 3), link("body_b1", "torso_b1", 2),
             link("camera", "body_b1", 1)]
    tf = followed()
    if whole:                       # in one message at once
        data = packed(*(chain[index] for index in order))
        assert sorted(tf.put_message(data, scan(data), False)) == sorted((item.child, "b1") for item in chain)
    else:
        for _ in range(4):          # what is not wanted yet comes again with the next image
            for index in order:
                if tf.wants(chain[index].child.encode()):
                    tf.put(chain[index], False)
    assert [timed.transform for timed in tf.chain("head_b1")] == chain
    assert tf.chain("head_b1", oldest=1.5) == []


def other(tf, transform, fixed):
    data = packed(transform)
    ((child, offset),) = scan(data)
    return tf.take_other(child, data, offset, fixed)


def test_a_fixed_link_of_a_skeleton_may_come_before_those_that_move():
    tf = followed()
    assert other(tf, link("torso_b1", "neck_b1", position=(0.0, 0.0, 0.3)), fixed=True) is None
    tf.put(link("neck_b1", "head_b1"), False)
    tf.put(link("camera", "torso_b1"), False)
    assert [timed.transform.child for timed in tf.chain("head_b1")] == ["head_b1", "neck_b1", "torso_b1"]


def test_what_is_not_of_humans_may_be_of_the_robot():
    tf = followed()
    moving, fixed = link("map", "base"), link("base", "face_plate_link")
    assert other(tf, moving, fixed=False) == moving and other(tf, fixed, fixed=True) == fixed
    assert other(tf, link("camera", "face_f9"), fixed=False) is None
    assert other(tf, link("arm_b1", "hand_b1"), fixed=False) is None and len(tf) == 1


def test_a_loop_ends_and_who_has_gone_is_forgotten():
    tf = followed()
    tf.put(link("neck_b1", "head_b1"), False)
    tf.put(link("head_b1", "neck_b1"), False)
    assert tf.chain("head_b1") == [] and len(tf) == 2
    tf.follow(head=[])
    assert not tf.wants(b"head_b1") and not tf.wants(b"neck_b1") and tf.wants(b"face_f1") and len(tf) == 0


def test_transforms_of_a_kind_that_are_fresh():
    tf = followed()
    tf.follow(voice=["va"])
    tf.put(link("camera", "face_f1", stamp=10.0, position=(1.0, 2.0, 3.0)), False)
    assert tf.fresh("face", 10.5, 2.0)["f1"].translation == (1.0, 2.0, 3.0)
    assert tf.fresh("face", 20.0, 2.0) == {} and tf.fresh("voice", 10.0, 2.0) == {}
    assert tf.put(link("camera", "voice_va", stamp=10.0, position=(math.nan, 0.0, 0.0)), False) is None
    assert tf.fresh("voice", 10.0, 2.0) == {} and tf.refused == 1
    tf.follow(face=[])
    assert tf.fresh("face", 10.5, 2.0) == {} and not tf.wants(b"face_f1")


def test_vectors_are_turned_as_scipy_turns_them():
    turn = Rotation.random(random_state=5)
    quaternion = tuple(3.0 * turn.as_quat())        # of any length
    np.testing.assert_allclose(rotate(quaternion, (1.0, -2.0, 0.5)), turn.apply((1.0, -2.0, 0.5)), atol=1e-12)
    np.testing.assert_allclose(view_axis(quaternion, along_z=False), turn.apply((1.0, 0.0, 0.0)), atol=1e-12)
    np.testing.assert_allclose(view_axis(quaternion, along_z=True), turn.apply((0.0, 0.0, 1.0)), atol=1e-12)


def heights(history, frame, *stamps):
    return [pose if pose is None else pose.translation[2] for pose in (
        history.between("map", frame, stamp) for stamp in stamps)]


def test_only_the_history_of_what_lies_above_a_followed_frame_is_kept():
    history = FrameHistory(10.0)
    history.follow("map")
    history.put(link("base", "camera", position=(0.0, 0.0, 1.0)), True)
    history.put(link("odom", "base", stamp=1.0), False)
    history.put(link("base", "wheel"), False)
    history.follow("camera")
    history.put(link("map", "odom", stamp=1.0, position=(0.0, 0.0, 0.0)), False)
    history.put(link("map", "odom", stamp=2.0, position=(0.0, 0.0, 0.0)), False)
    history.put(link("odom", "base", stamp=2.0, position=(0.0, 0.0, 3.0)), False)
    history.put(link("base", "wheel", stamp=2.0), False)
    assert history.followed == {"map", "camera", "base", "odom"}
    assert heights(history, "camera", 1.0, 1.5, 2.0) == [3.0, 3.5, 4.0] and len(history) == 4
    assert heights(history, "wheel", 1.0, 2.0) == [None, 5.0]
    history.forget_moving()
    assert history.newest_stamp("base") is None and history.newest_stamp("camera") == 1.0


def test_the_history_is_bounded_and_keeps_what_is_followed():
    history = FrameHistory(10.0, max_frames=10)
    history.follow("camera")
    history.put(link("map", "camera"), True)
    for number in range(100):
        history.put(link("map", "stray%d" % number), True)
    assert len(history) == 10 and heights(history, "camera", None) == [2.0]


def test_fixed_frames_outlive_moving_ones_of_which_nobody_knows_the_use():
    history = FrameHistory(10.0, max_frames=10)
    history.put(link("map", "camera"), True)      # comes once
    for number in range(100):
        history.put(link("body", "limb%d" % number), False)
    assert len(history) == 10 and heights(history, "camera", None) == [2.0]
    assert history.newest_stamp("limb99") == 1.0 and history.newest_stamp("limb1") is None
