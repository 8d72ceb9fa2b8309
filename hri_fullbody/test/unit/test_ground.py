"""Which way is up and how high the camera stands, from people, and what follows for posture and stature."""

import numpy as np
import posed_people as people
import pytest

from hri_fullbody.core.behaviour.posture import PostureClass
from hri_fullbody.core.behaviour.recognizer import BehaviourRecognizer
from hri_fullbody.core.localization.ground import GroundPlane, up_of

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
