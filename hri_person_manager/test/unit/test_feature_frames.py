"""Where tracked features are, by the transforms of their frames, which are kept while they are tracked."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from hri_person_manager.core.features import FeatureTf, Kind, PlaceSource
from hri_pipeline.core.frames import MAX_WANTED, RawTransform, scan
from hri_pipeline.core.geometry import Pose

STILL = (0.0, 0.0, 0.0, 1.0)


def serialised(transforms):
    """Serialise (parent, child, translation, rotation, stamp) as the definition of TFMessage says."""
    data = struct.pack("<I", len(transforms))
    for parent, child, translation, rotation, stamp in transforms:
        data += struct.pack("<III", 0, int(stamp), int(round(1e9 * (stamp % 1.0))))
        for name in (parent, child):
            data += struct.pack("<I", len(name)) + name.encode()
        data += struct.pack("<7d", *translation, *rotation)
    return data


def take(frames, *transforms, fixed=False, now=math.nan):
    """Take a message; return the feature poses."""
    data = serialised(transforms)
    return frames.take(data, scan(data), fixed, now)


def put(frames, name, parent, z, stamp=1.0, fixed=False, now=math.nan):
    """Take a message of one transform; return the feature pose, None without one."""
    found = take(frames, (parent, name, (0.0, 0.0, z), STILL, stamp), fixed=fixed, now=now)
    assert len(found) < 2
    return found[0] if found else None


def followed(**ids):
    frames = FeatureTf(0.5)
    for kind, names in ids.items():
        assert frames.set_tracked(Kind[kind], names) == []
    return frames


def test_whose_frame_it_is():
    frames = followed(FACE=["abcde", "a_b"], VOICE=["va"], BODY=["abcde", "link"])
    assert put(frames, "face_abcde", "camera", 2.0)[:3] == (PlaceSource.FACE, "abcde", "camera")
    assert put(frames, "face_a_b", "camera", 2.0)[:2] == (PlaceSource.FACE, "a_b")
    assert put(frames, "voice_va", "microphones", 2.0)[:2] == (PlaceSource.VOICE, "va")
    assert put(frames, "body_link", "camera", 2.0)[:2] == (PlaceSource.BODY, "link")
    assert frames.is_limb(b"l_elbow_abcde") and not frames.wants(b"l_elbow_abcde")
    for name in ("person_abcde", "gaze_abcde", "voice_abcde", "face_zzzzz", "map", "_abcde", "head_camera", ""):
        assert put(frames, name, "camera", 2.0) is None, name


def test_a_body_is_placed_by_its_head_when_the_chain_is_complete():
    frames = followed(BODY=["abcde"])
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY
    put(frames, "head_abcde", "neck_abcde", 0.2)
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY
    put(frames, "neck_abcde", "body_abcde", 0.5)
    pose = put(frames, "body_abcde", "camera", 3.0)
    assert (pose.source, pose.sensor) == (PlaceSource.HEAD, "camera")
    assert np.isclose(pose.pose.translation[2], 3.7)
    assert put(frames, "body_abcde", "camera", 3.0, stamp=9.0).source == PlaceSource.BODY     # the head is old


def test_the_chain_to_the_head_is_composed_exactly_and_fixed_links_never_grow_old():
    rng = np.random.default_rng(4)
    poses = [Pose.from_quaternion(rng.normal(size=4), rng.normal(size=3)) for _ in range(6)]
    names = ["camera", "body_abcde", "waist_abcde", "torso_abcde", "y_head_abcde", "p_head_abcde", "head_abcde"]
    frames = followed(BODY=["abcde"])
    links = [(names[index], names[index + 1], pose.translation, [2.0 * value for value in pose.quaternion], 20.0)
             for index, pose in enumerate(poses)]
    for index in (5, 4, 3, 2, 1):
        assert frames.wants(names[index + 1].encode()), names[index + 1]
        assert take(frames, links[index], fixed=index in (2, 5)) == []
    root = links[0][:4] + (20.1,)
    (pose,) = take(frames, root)
    expected = poses[0]
    for other in poses[1:]:
        expected = expected.compose(other)
    assert pose.source == PlaceSource.HEAD and pose.sensor == "camera" and (pose.secs, pose.nsecs) == (20, 100000000)
    assert np.allclose(pose.pose.translation, expected.translation)
    assert np.allclose(pose.pose.rotation, expected.rotation)
    frames.clear_moving()
    assert len(frames) == 2 and take(frames, root)[0].source == PlaceSource.BODY


def test_a_skeleton_in_one_message_places_its_body_once():
    frames = followed(BODY=["abcde"])
    links = [("body_abcde", "waist_abcde", (0.0, 0.0, 0.5), STILL, 1.0),
             ("waist_abcde", "head_abcde", (0.0, 0.0, 0.2), STILL, 1.0)]
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY
    (pose,) = take(frames, *links)          # the way is complete
    assert pose.source == PlaceSource.HEAD and np.isclose(pose.pose.translation[2], 3.7)
    assert take(frames, *links) == [] and put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.HEAD


def test_a_head_places_a_body_of_which_there_is_no_body_frame():
    pose = put(followed(BODY=["abcde"]), "head_abcde", "camera", 3.0)
    assert (pose.source, pose.id, pose.sensor, pose.secs) == (PlaceSource.HEAD, "abcde", "camera", 1)
    assert np.isclose(pose.pose.translation[2], 3.0)


def test_a_chain_from_the_head_to_the_sensor_places_a_body_once_per_image():
    frames = followed(BODY=["abcde"])
    assert put(frames, "head_abcde", "neck_abcde", 0.2) is None
    assert put(frames, "neck_abcde", "torso_abcde", 0.5, fixed=True) is None
    pose = put(frames, "torso_abcde", "camera", 3.0)
    assert pose.source == PlaceSource.HEAD and np.isclose(pose.pose.translation[2], 3.7)
    assert put(frames, "head_abcde", "neck_abcde", 0.3, stamp=1.5) is None
    assert np.isclose(put(frames, "torso_abcde", "camera", 3.0, stamp=1.5).pose.translation[2], 3.8)
    assert put(frames, "torso_abcde", "camera", 3.0, stamp=9.0) is None         # the head is old


def test_a_head_that_moves_on_a_fixed_torso_places_the_body():
    frames = followed(BODY=["abcde"])
    put(frames, "head_abcde", "torso_abcde", 0.2)
    put(frames, "torso_abcde", "camera", 3.0, fixed=True)
    assert np.isclose(put(frames, "head_abcde", "torso_abcde", 0.3, stamp=2.0).pose.translation[2], 3.3)


@pytest.mark.parametrize("sensor", ["camera", "other_camera"])
def test_a_head_beside_its_body_in_a_sensor_frame_goes_before_it(sensor):
    frames = followed(BODY=["abcde"])
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY
    assert put(frames, "head_abcde", sensor, 3.6).source == PlaceSource.HEAD
    assert put(frames, "body_abcde", "camera", 3.0, stamp=1.1).source == PlaceSource.BODY
    pose = put(frames, "head_abcde", sensor, 3.7, stamp=1.1)
    assert (pose.source, pose.sensor) == (PlaceSource.HEAD, sensor)


def test_a_chain_that_lags_is_used_as_long_as_it_comes():
    frames = followed(BODY=["abcde"])
    for number in range(40):
        now = 10.0 + 0.05 * number
        put(frames, "head_abcde", "body_abcde", 0.6, now - 0.7, now=now)
        assert put(frames, "body_abcde", "camera", 3.0, now, now=now).source == PlaceSource.HEAD
    assert put(frames, "body_abcde", "camera", 3.0, 12.6, now=12.6).source == PlaceSource.BODY


def fixed_link(child, parent, z):
    return RawTransform(parent, child, 1, 0, (0.0, 0.0, z), STILL)


def test_a_fixed_frame_of_a_feature_may_come_before_the_list():
    frames = FeatureTf(0.5)
    for frame in ("face_f1", "voice_v1", "body_b1", "head_b2"):
        frames.keep_fixed(fixed_link(frame, "camera", 2.0))
    frames.keep_fixed(fixed_link("head_f1", "camera", math.nan))
    found = [pose for kind, ids in ((Kind.FACE, ["f1"]), (Kind.BODY, ["b1", "b2", "f1"]), (Kind.VOICE, ["v1"]))
             for pose in frames.set_tracked(kind, ids)]
    assert sorted((pose.source, pose.id) for pose in found) == [
        (PlaceSource.FACE, "f1"), (PlaceSource.HEAD, "b2"), (PlaceSource.BODY, "b1"), (PlaceSource.VOICE, "v1")]
    assert frames.set_tracked(Kind.FACE, ["f1"]) == []


def test_a_fixed_link_may_come_before_the_list():
    frames = FeatureTf(0.5)
    frames.keep_fixed(fixed_link("head_abcde", "body_abcde", 0.6))
    frames.set_tracked(Kind.BODY, ["abcde"])
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.HEAD


def test_only_frames_between_head_and_root_are_wanted():
    frames = followed(BODY=["abcde"])
    assert not frames.wants(b"l_elbow_abcde") and not frames.wants(b"torso_abcde")
    put(frames, "head_abcde", "torso_abcde", 0.2)
    assert frames.wants(b"torso_abcde")
    frames.set_tracked(Kind.BODY, [])
    assert not frames.wants(b"torso_abcde") and not frames.wants(b"body_abcde")


@pytest.mark.parametrize("bad", [
    ("camera", (math.nan, 0.0, 0.0), STILL), ("camera", (0.0, 0.0, 1.0), (0.0,) * 4),
    ("camera", (0.0, 0.0, 1.0), (0.0, math.inf, 0.0, 1.0)), ("", (0.0, 0.0, 1.0), STILL),
    (None, (0.0, 0.0, 1.0), STILL)])
@pytest.mark.parametrize("name", ["face_abcde", "body_abcde", "head_abcde"])
def test_what_is_no_transform_is_refused(bad, name):
    frames = followed(BODY=["abcde"], FACE=["abcde"])
    parent, translation, rotation = bad
    assert take(frames, (name if parent is None else parent, name, translation, rotation, 1.0)) == []
    assert len(frames) == 0 and frames.refused == 1


def test_links_in_a_circle_end():
    frames = followed(BODY=["abcde"])
    put(frames, "head_abcde", "neck_abcde", 0.2)
    put(frames, "neck_abcde", "head_abcde", 0.2)
    assert put(frames, "body_abcde", "camera", 3.0).source == PlaceSource.BODY


def test_frames_go_with_their_human_and_are_bounded():
    frames = FeatureTf(0.5)
    for number in range(1000):
        name = "x%d" % number
        frames.set_tracked(Kind.BODY, [name])
        put(frames, "body_" + name, "camera", 1.0)
        frames.keep_fixed(fixed_link("hand_" + name, "arm_" + name, 0.2))
    assert len(frames) == 2
    for number in range(MAX_WANTED + 500):
        put(frames, "head_x999", "l%d_x999" % number, 1.0)
    assert sum(frames.wants(b"l%d_x999" % number) for number in range(MAX_WANTED + 500)) == MAX_WANTED - 2
