"""Which way is up and how high the camera stands, from people, and what follows for posture and stature."""

import numpy as np
import posed_people as people
import pytest

from hri_fullbody.core.behaviour.posture import PostureClass
from hri_fullbody.core.behaviour.recognizer import BehaviourRecognizer
from hri_fullbody.core.localization.ground import GroundPlane, up_of
from hri_pipeline.core.geometry import Pose

SURE = np.ones(18)


def seen(pose, pitch=0.0, scale=1.0, place=(0.0, 0.3, 3.5)):
    """A person before a camera that looks down by `pitch` rad, at average size."""
    up = up_of(pitch, 0.0)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, -up[1], up[2]], [0.0, -up[2], -up[1]]])
    return (pose.seen(place=place) * scale) @ turn.T


@pytest.mark.parametrize("pitch", np.radians([0.0, 15.0, 35.0]))
def test_somebody_who_stands_tells_the_tilt(pitch):
    ground = GroundPlane()
    assert ground.up_sd > np.radians(12.0)
    for index in range(10):
        ground.add("a", seen(people.standing(), pitch), SURE, 0.1 * index)
        ground.solve(0.1 * index)
    assert np.degrees(np.arccos(ground.up @ up_of(pitch, 0.0))) < 5.0
    assert ground.up_sd < np.radians(6.5)


def test_feet_of_several_people_and_an_outlier():
    ground, pitch = GroundPlane(), np.radians(25.0)
    for number, (x, z) in enumerate([(-0.6, 2.5), (0.2, 3.5), (0.8, 5.0)]):
        ground.add(str(number), seen(people.standing(), pitch, place=(x, 0.3, z)), SURE, 0.0)
    ground.add("leaning", seen(people.standing().lean(40.0, whole=True), pitch), SURE, 0.0)
    ground.solve(0.0)
    assert np.degrees(np.arccos(ground.up @ up_of(pitch, 0.0))) < 5.0


def off(ground, pitch):
    """Degrees between the vertical that was learnt and that of a camera which looks down by `pitch` rad."""
    return np.degrees(np.arccos(min(1.0, float(ground.up @ up_of(pitch, 0.0)))))


@pytest.mark.parametrize("body, share", [(people.seated(), 0.35), (None, 0.55)], ids=["who sits", "a face alone"])
def test_who_sits_and_a_face_tell_the_tilt_less_surely(body, share):
    ground, pitch = GroundPlane(), np.radians(30.0)
    before, face = off(ground, pitch), None
    if body is None:
        face = Pose(np.stack([(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), up_of(pitch, 0.0)], axis=1), np.zeros(3))
    ground.add("a", np.full((18, 3), np.nan) if body is None else seen(body, pitch), SURE, 0.0, face)
    ground.solve(0.0)
    assert off(ground, pitch) < share * before and ground.camera_height("x") is None


def learnt(points, confidence=SURE):
    ground = GroundPlane()
    ground.add("a", points, confidence, 0.0)
    ground.solve(0.0)
    return ground.up


def test_of_who_sits_only_legs_that_are_seen_to_be_bent_help_the_trunk():
    """The back leans by 20 degrees; the shanks of who sits make up for that."""
    sits = seen(people.seated(-20.0))
    trunk = sits.copy()
    trunk[[9, 10, 12, 13]] = np.nan
    alone = learnt(trunk)
    assert not learnt(sits) == pytest.approx(alone, abs=0.02)
    guessed = SURE.copy()
    guessed[10] = 0.2
    stretched, lifted = sits.copy(), sits.copy()
    stretched[10] = 2.0 * sits[9] - sits[8]
    lifted[[10, 13], 1] = sits[[9, 12], 1] - 0.3
    for points, confidence in ((sits, guessed), (stretched, SURE), (lifted, SURE)):
        assert learnt(points, confidence) == pytest.approx(alone)
    unknown = sits.copy()
    unknown[1] = np.nan
    assert learnt(unknown) == pytest.approx(GroundPlane().up), "without the neck there is no trunk"


@pytest.mark.parametrize("trunk", [-30.0, 30.0])
def test_who_was_seen_to_stand_tells_the_vertical_when_sitting_down_with_a_bent_back(trunk):
    ground, pitch = GroundPlane(), np.radians(10.0)
    for index in range(40):
        body = people.standing() if index < 20 else people.seated(trunk)
        ground.add("a", seen(body, pitch), SURE, 0.1 * index)
    ground.solve(4.0)
    assert off(ground, pitch) < 1.0


@pytest.mark.parametrize("lean", [-12.0, 12.0])
def test_feet_at_several_distances_tell_the_tilt_where_all_lean(lean):
    """As those do who walk up to a camera."""
    pitch, errors = np.radians(30.0), []
    for count in (1, 3):
        ground = GroundPlane()
        for number, (x, z) in enumerate([(-0.6, 2.0), (0.2, 4.0), (0.8, 7.0)][:count]):
            ground.add(str(number), seen(people.standing().lean(lean, whole=True), pitch, place=(x, 0.3, z)), SURE, 0.0)
        ground.solve(0.0)
        errors.append(off(ground, pitch))
    assert errors[1] < 0.6 * errors[0]


@pytest.mark.parametrize("down", [-1.5, 4.0])
def test_who_stands_on_a_stage_or_far_below_tells_no_height(down):
    ground = GroundPlane()
    ground.add("a", seen(people.standing(), place=(0.0, down, 6.0)), SURE, 0.0)
    ground.solve(0.0)
    assert ground.camera_height("x") is None


def test_of_people_who_went_by_little_is_kept():
    ground = GroundPlane()
    for number in range(100):
        ground.add("p%d" % number, seen(people.standing()), SURE, 2.0 * number)
        ground.solve(2.0 * number)
    assert max(len(known) for known in vars(ground).values() if isinstance(known, dict)) <= 30


def test_guessed_legs_and_people_who_lie_say_nothing():
    ground = GroundPlane()
    before = ground.up
    guessed = SURE.copy()
    guessed[[9, 10, 12, 13]] = 0.2
    ground.add("a", seen(people.lying()), SURE, 0.0)
    ground.solve(0.0)
    assert ground.up == pytest.approx(before) and ground.camera_height("x") is None
    ground.add("b", seen(people.standing()), guessed, 0.0)
    ground.solve(0.0)
    assert ground.camera_height("x") is None


def test_the_height_is_that_of_the_others():
    ground = GroundPlane()
    truth = 0.817 + 0.3 + 0.07      # hips 0.3 m below the camera, ankles 0.817 m below the hips
    for index in range(3):
        ground.add(str(index), seen(people.standing(), place=(index - 1.0, 0.3, 3.0 + index)), SURE, 0.0)
    ground.solve(0.0)
    height, sd = ground.camera_height("0")
    assert height == pytest.approx(truth, rel=0.1) and 0.03 < sd < 0.2
    ground.reset()
    assert ground.camera_height("0") is None


def test_nobody_tells_the_height_for_oneself_and_who_kneels_for_nobody():
    ground = GroundPlane()
    ground.add("a", seen(people.standing()), SURE, 0.0)
    ground.add("kneels", seen(people.standing().legs((0.0, 0.0, -0.25), (-0.24, 0.0, -0.25))), SURE, 0.0)
    ground.solve(0.0)
    assert ground.camera_height("a") is None and ground.camera_height("kneels") is not None


def test_who_is_seen_counts_for_half_a_minute_after_the_last_sight():
    ground, pitch = GroundPlane(), np.radians(25.0)
    before = ground.up
    for stamp in range(40):
        ground.add("a", seen(people.standing(), pitch), SURE, float(stamp))
    for stamp, learnt in ((39.0, True), (68.0, True), (70.0, False)):
        ground.solve(stamp)
        assert (np.degrees(np.arccos(min(1.0, float(ground.up @ before)))) > 5.0) == learnt


def test_one_odd_look_at_somebody_turns_the_vertical_by_a_part_only():
    ground = GroundPlane()
    for index in range(50):
        ground.add("a", seen(people.standing(), np.radians(10.0)), SURE, 0.1 * index)
    ground.add("a", seen(people.standing(), np.radians(40.0)), SURE, 5.0)
    ground.solve(5.0)
    assert np.degrees(np.arccos(ground.up @ up_of(np.radians(10.0), 0.0))) < 4.0


def test_posture_before_a_steep_camera_is_told_with_the_learnt_vertical():
    pitch, body, ground = np.radians(35.0), BehaviourRecognizer(), GroundPlane()
    told = []
    for index in range(40):
        points = seen(people.standing() if index < 15 else people.seated(), pitch)
        ground.add("a", points, SURE, 0.1 * index)
        ground.solve(0.1 * index)
        told.append(body.update(points, people.STATURE, 0.1 * index, ground.up, ground.up_sd).posture)
    assert told[14] == PostureClass.STANDING and told[-1] == PostureClass.SITTING


@pytest.mark.parametrize("stood", [False, True], ids=["from the first", "who stood before"])
def test_who_lies_with_the_feet_to_a_steep_camera_does_not_stand(stood):
    pitch, body, ground, told = np.radians(35.0), BehaviourRecognizer(), GroundPlane(), []
    for index in range(40):
        points = seen(people.standing() if stood and index < 15 else people.lying(), pitch)
        ground.add("a", points, SURE, 0.1 * index)
        ground.solve(0.1 * index)
        told.append(body.update(points, people.STATURE, 0.1 * index, ground.up, ground.up_sd).posture)
    assert told[-1] in (PostureClass.LAYING, PostureClass.OTHER)
