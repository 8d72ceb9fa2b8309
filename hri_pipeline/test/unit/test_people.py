"""The frames of people become observers: eyes, heads, trunks, in one frame, whatever the sensor."""

import math
import struct

import numpy as np
import pytest

from hri_pipeline.core.frames import RawTransform
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.interactions.people import HEAD_ABOVE_HIPS, PeopleTf, Seen, gather

SETTINGS = INTERACTION_PARAMETERS.resolve({})
OPTICAL = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 1.3]))
"""A camera 1.3 m above the floor that looks along x."""


def raw(parent, child, pose, stamp=10.0):
    secs = int(stamp)
    return RawTransform(parent, child, secs, int(round((stamp - secs) * 1e9)), tuple(pose.translation), pose.quaternion)


def facing_camera(distance):
    """A face before the camera that looks into it: x out of the face is -z of the camera, z to the scalp is -y."""
    return Pose(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]), np.array([0.0, 0.0, distance]))


def straight(turn=0.0):
    """A gaze along x of the face: z of the gaze frame is x of the face, y is down; turn: rad to its left."""
    cosine, sine = math.cos(turn), math.sin(turn)
    return Pose(np.array([[sine, 0.0, cosine], [-cosine, 0.0, sine], [0.0, -1.0, 0.0]]), np.zeros(3))


@pytest.fixture
def frames():
    made = PeopleTf()
    made.set_people(["ann"])
    made.set_feature("ann", "face", "fa")
    made.set_feature("ann", "body", "")
    return made


def put(frames, parent, child, pose, stamp=10.0, fixed=False):
    assert frames.wants(child.encode())
    assert frames.put(raw(parent, child, pose, stamp), fixed)


def seen(frames, newest=10.0, lids=None, settings=SETTINGS):
    return gather(frames, lambda sensors: {sensor: OPTICAL for sensor in sensors if sensor == "camera"}, newest,
                  settings, lids or {}).observers()


def test_a_face_and_its_gaze(frames):
    put(frames, "camera", "face_fa", facing_camera(1.0))
    put(frames, "face_fa", "gaze_fa", straight(0.01))
    (ann,) = seen(frames)
    np.testing.assert_allclose(ann.head, (1.0, 0.0, 1.3), atol=1e-9)
    np.testing.assert_allclose(ann.head_direction, (-1.0, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(ann.gaze_direction, (-math.cos(0.01), -math.sin(0.01), 0.0), atol=1e-9)
    assert ann.eyes_closed == 0.0
    assert ann.body_direction is None


def test_a_gaze_that_is_the_heads_own_says_nothing_more_than_the_head(frames):
    """Of a face of 13 to 30 px, and of detectors that measure no eyes."""
    put(frames, "camera", "face_fa", facing_camera(1.0))
    put(frames, "face_fa", "gaze_fa", straight())
    (ann,) = seen(frames)
    assert ann.gaze_direction is None and ann.eyes_closed == 0.0 and ann.head_direction is not None


def test_a_gaze_given_in_the_frame_of_the_camera(frames):
    put(frames, "camera", "face_fa", facing_camera(1.0))
    put(frames, "camera", "gaze_fa", Pose(np.eye(3), np.array([0.0, 0.0, 1.0])))
    np.testing.assert_allclose(seen(frames)[0].gaze_direction, (1.0, 0.0, 0.0), atol=1e-9)


def test_where_gazes_are_told_a_face_that_never_had_one_has_closed_eyes(frames):
    frames.set_people(["ann", "bob"])
    frames.set_feature("bob", "face", "fb")
    for stamp in (10.0, 10.0 + 2.0 * SETTINGS.gaze_timeout):
        put(frames, "camera", "face_fa", facing_camera(1.0), stamp)
        put(frames, "camera", "face_fb", facing_camera(2.0), stamp)
        assert [person.eyes_closed for person in seen(frames, stamp)] == [None, None]
    put(frames, "face_fa", "gaze_fa", straight(), stamp)
    assert [person.eyes_closed for person in seen(frames, stamp)] == [0.0, 1.0]
    # Another sensor may not measure gazes, and a face that has just come may get one.
    put(frames, "other", "face_fb", facing_camera(2.0), stamp)
    poses = {"camera": OPTICAL, "other": OPTICAL}
    assert gather(frames, lambda sensors: poses, stamp, SETTINGS, {}).observers()[1].eyes_closed is None
    frames.set_people(["ann", "cho"])
    frames.set_feature("cho", "face", "fc")
    put(frames, "camera", "face_fc", facing_camera(2.0), stamp)
    assert [person.eyes_closed for person in seen(frames, stamp)] == [0.0, None]


def test_a_transform_is_read_when_it_is_asked_for(frames):
    names = [text.encode() for text in ("camera", "face_fa")]
    pose = facing_camera(1.0)
    text = b"".join(struct.pack("<I", len(name)) + name for name in names)
    data = struct.pack("<III", 7, 10, 0) + text + struct.pack("<7d", *pose.translation, *pose.quaternion)
    frames.put_unread(b"face_fa", data, 0)
    assert len(frames) == 1
    np.testing.assert_allclose(seen(frames)[0].head, (1.0, 0.0, 1.3), atol=1e-9)
    assert len(frames) == 1
    wrong = data[:-8] + struct.pack("<d", math.nan)
    frames.put_unread(b"face_fa", wrong, 0)
    np.testing.assert_allclose(seen(frames)[0].head, (1.0, 0.0, 1.3), atol=1e-9)
    assert frames.refused == 1


def test_a_gaze_that_is_missing_means_closed_eyes_but_only_after_there_was_one(frames):
    put(frames, "camera", "face_fa", facing_camera(1.0))
    assert seen(frames)[0].eyes_closed is None
    put(frames, "face_fa", "gaze_fa", straight())
    put(frames, "camera", "face_fa", facing_camera(1.0), 10.0 + 0.5 * SETTINGS.gaze_timeout)
    assert seen(frames, 10.1)[0].eyes_closed is None
    put(frames, "camera", "face_fa", facing_camera(1.0), 10.1 + SETTINGS.gaze_timeout)
    (ann,) = seen(frames, 10.1 + SETTINGS.gaze_timeout)
    assert ann.eyes_closed == 1.0
    assert ann.gaze_direction is None


def test_frames_of_a_camera_whose_clock_is_ahead_hide_nobody(frames):
    frames.set_people(["ann", "bob"])
    frames.set_feature("bob", "body", "bb")
    put(frames, "camera", "face_fa", facing_camera(1.0), 22.0)
    put(frames, "other", "body_bb", facing_camera(2.0), 10.0)
    put(frames, "body_bb", "head_bb", facing_camera(0.0), 10.0)
    poses = {"camera": OPTICAL, "other": OPTICAL}
    for newest, shifts in ((22.0, {"other": 12.0}), (10.0, {"camera": -12.0})):
        people = gather(frames, lambda sensors: poses, newest, SETTINGS, {}, shifts)
        assert people.ids == ["ann", "bob"]
        assert gather(frames, lambda sensors: poses, newest + 2.0, SETTINGS, {}, shifts).ids == []


def test_action_units_go_before(frames):
    put(frames, "camera", "face_fa", facing_camera(1.0))
    put(frames, "face_fa", "gaze_fa", straight())
    assert seen(frames, lids={"fa": Seen(9.9, 0.8)})[0].eyes_closed == 0.8
    assert seen(frames, lids={"fa": Seen(5.0, 0.8)})[0].eyes_closed == 0.0


def test_eyes_far_away_are_too_small(frames):
    sds = []
    for distance in (0.3, 0.8, 1.2):
        put(frames, "camera", "face_fa", facing_camera(distance * SETTINGS.gaze_range))
        put(frames, "face_fa", "gaze_fa", straight(0.01))
        (ann,) = seen(frames)
        sds.append(ann.gaze_direction_sd if ann.gaze_direction is not None else math.inf)
    assert sds[0] == pytest.approx(SETTINGS.gaze_sd)
    assert sds[0] < sds[1] < sds[2] == math.inf


@pytest.mark.parametrize("place", [(0.0, 0.0, 2.0), (1.5, 0.0, 1.0), (0.0, -1.0, 1.0)], ids=["ahead", "aside", "above"])
def test_directions_are_less_sure_the_more_a_face_is_turned_away_from_the_camera(frames, place):
    ahead = -np.array(place) / np.linalg.norm(place)
    left = np.cross((0.0, -1.0, 0.0), ahead) / np.linalg.norm(np.cross((0.0, -1.0, 0.0), ahead))
    found = []
    for turn in np.radians([0.0, 25.0, 60.0, 90.0]):
        axes = [math.cos(turn) * ahead + math.sin(turn) * left, math.cos(turn) * left - math.sin(turn) * ahead]
        put(frames, "camera", "face_fa", Pose(np.array([*axes, np.cross(*axes)]).T, np.array(place)))
        put(frames, "face_fa", "gaze_fa", straight(0.01))
        (ann,) = seen(frames)
        found.append((ann.head_direction_sd, ann.gaze_direction_sd))
    straight_on, hardly, turned, profile = found
    assert straight_on == hardly == pytest.approx((SETTINGS.head_sd, SETTINGS.gaze_sd))
    assert straight_on < turned < profile and straight_on[1] < turned[1] < profile[1]


def test_a_face_at_the_place_of_the_camera_hides_nobody(frames):
    frames.set_people(["ann", "bob"])
    frames.set_feature("bob", "face", "fb")
    put(frames, "camera", "face_fa", Pose(np.eye(3), np.zeros(3)))
    put(frames, "camera", "face_fb", facing_camera(1.0))
    assert [person.id for person in seen(frames)] == ["ann", "bob"]


@pytest.mark.parametrize("slope, is_told", [(0.0, True), (60.0, True), (80.0, False), (-90.0, False)])
def test_the_trunk_of_who_lies_or_bends_down_points_nowhere(frames, slope, is_told):
    frames.set_feature("ann", "body", "ba")
    cosine, sine = math.cos(math.radians(slope)), math.sin(math.radians(slope))
    raised = np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
    put(frames, "camera", "body_ba", Pose(OPTICAL.rotation.T @ raised, np.array([0.0, 0.0, 2.0])))
    (ann,) = seen(frames)
    assert (ann.body_direction is not None) is is_told


def test_a_skeleton_without_a_face_gives_head_and_trunk(frames):
    frames.set_feature("ann", "face", "")
    frames.set_feature("ann", "body", "ba")
    put(frames, "camera", "body_ba", Pose(facing_camera(2.0).rotation, np.array([0.0, 0.4, 2.0])))
    (ann,) = seen(frames)
    np.testing.assert_allclose(ann.head, (2.0, 0.0, 0.9 + HEAD_ABOVE_HIPS), atol=1e-9)
    np.testing.assert_allclose(ann.body_direction, (-1.0, 0.0, 0.0), atol=1e-9)
    assert ann.head_direction is None
    # The way from the head leads over a link whose name is learned from the head.
    quarter = Pose(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.0, 0.0, 0.5]))
    assert not frames.wants(b"neck_ba")
    assert frames.is_limb(b"neck_ba")
    put(frames, "neck_ba", "head_ba", Pose(np.eye(3), np.array([0.0, 0.0, 0.2])))
    put(frames, "body_ba", "neck_ba", quarter)
    (ann,) = seen(frames)
    np.testing.assert_allclose(ann.head, (2.0, 0.0, 0.9 + 0.7), atol=1e-9)
    np.testing.assert_allclose(ann.head_direction, (0.0, -1.0, 0.0), atol=1e-9)
    assert ann.head_direction_sd == SETTINGS.skeleton_head_sd


def test_a_person_of_whom_nothing_else_is_told():
    frames = PeopleTf()
    frames.set_people(["ann", "bob"])
    frames.set_feature("bob", "face", "")
    frames.set_feature("bob", "body", "")
    for name in ("ann", "bob"):
        put(frames, "camera", "person_" + name, facing_camera(1.5))
    ann, bob = seen(frames)
    np.testing.assert_allclose(ann.head_direction, (-1.0, 0.0, 0.0), atol=1e-9)
    # Of this one it is told that there is neither face nor body: a voice, or out of sight.
    np.testing.assert_allclose(bob.head, (1.5, 0.0, 1.3), atol=1e-9)
    assert bob.head_direction is None


def test_old_frames_and_sensors_without_a_place_give_nobody(frames):
    put(frames, "camera", "face_fa", facing_camera(1.0), 5.0)
    assert seen(frames) == []
    put(frames, "elsewhere", "face_fa", facing_camera(1.0))
    assert seen(frames) == []
    frames.set_people(["ann", "bob"])
    frames.set_feature("bob", "face", "fb")
    put(frames, "camera", "face_fb", facing_camera(1.0))
    assert [person.id for person in seen(frames)] == ["bob"], "the others are where they are"


def test_numbers_that_are_none_are_refused(frames):
    broken = raw("camera", "face_fa", facing_camera(1.0))
    for bad in (broken._replace(translation=(math.nan, 0.0, 1.0)), broken._replace(rotation=(0.0, 0.0, 0.0, 0.0)),
                broken._replace(translation=(math.inf, -math.inf, 0.0))):
        assert not frames.put(bad, False)
    assert frames.refused == 3
    assert seen(frames) == []


def test_what_is_kept_goes_with_the_person(frames):
    for index in range(50):
        name = "p{}".format(index)
        frames.set_people([name])
        frames.set_feature(name, "face", "f" + name)
        put(frames, "camera", "face_f" + name, facing_camera(1.0))
    assert len(frames) == 1
    frames.set_people([])
    assert len(frames) == 0
    assert not frames.wants(b"face_fp49")


def test_a_fixed_frame_that_came_before_its_owner_was_known_is_kept(frames):
    fixed = raw("body_bx", "head_bx", Pose(np.eye(3), np.array([0.0, 0.0, 0.7])))
    assert not frames.wants(b"head_bx")
    frames.keep_fixed(fixed)
    frames.set_feature("ann", "face", "")
    frames.set_feature("ann", "body", "bx")
    put(frames, "camera", "body_bx", facing_camera(2.0))
    np.testing.assert_allclose(seen(frames)[0].head, (2.0, 0.0, 2.0), atol=1e-9)
    frames.clear_moving()
    assert len(frames) == 1


def test_what_a_person_consists_of_may_be_told_before_the_person_is_listed():
    frames = PeopleTf()
    frames.set_feature("bob", "face", "fb")
    frames.set_people(["bob"])
    put(frames, "camera", "face_fb", facing_camera(1.0))
    assert len(seen(frames)) == 1
    for index in range(2000):
        frames.set_feature("never{}".format(index), "face", "f")
    frames.set_people(["bob", "never0"])
    assert frames.people["never0"].face is None


def test_a_body_of_an_older_image_is_where_it_was_seen_then(frames):
    """While the head of the robot turns by 90 degrees per second, and the body is 0.1 s older than the face."""
    frames.set_feature("ann", "body", "ba")
    frames.set_people(["ann", "bob"])
    frames.set_feature("bob", "body", "bb")

    def camera(stamp):
        turn = math.radians(90.0) * (stamp - 10.0)
        pan = Pose(np.array([[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0],
                             [0.0, 0.0, 1.0]]), np.zeros(3))
        return pan.compose(OPTICAL)

    for name, place, stamp in (("face_fa", (3.0, 0.0, 1.6), 10.0), ("body_bb", (3.0, 1.0, 0.9), 9.9)):
        put(frames, "camera", name, Pose(np.eye(3), camera(stamp).inverse().apply(np.array([place]))[0]), stamp)
    people = gather(frames, lambda sensors: {"camera": camera(10.0)}, 10.0, SETTINGS, {},
                    pose_at=lambda sensor, stamp: camera(stamp))
    np.testing.assert_allclose(people.heads[:, :2], [[3.0, 0.0], [3.0, 1.0]], atol=1e-6)
    unknown = gather(frames, lambda sensors: {"camera": camera(10.0)}, 10.0, SETTINGS, {},
                     pose_at=lambda sensor, stamp: None)
    assert np.linalg.norm(unknown.heads[1, :2] - (3.0, 1.0)) > 0.4
