"""Who points, and at what."""

import numpy as np
import posed_people as people
import pytest

from hri_fullbody.core.behaviour.pointing import Pointing, PointingEstimator, aim

AHEAD = people.standing().arm("right", (0.28, 0.02, -0.02), (0.54, 0.04, -0.02))


def told(points, seconds=1.0, rate=15.0):
    estimator = PointingEstimator()
    return [estimator.update(points(time) if callable(points) else points, people.STATURE, time, people.UP)
            for time in np.arange(int(seconds * rate)) / rate]


def test_a_stretched_arm_held_still_points_after_half_a_second():
    found = told(AHEAD.seen())
    assert found[3] is None and found[-1] is not None
    eyes = AHEAD.seen()[[14, 15]].mean(axis=0)
    assert found[-1].origin == pytest.approx(eyes)
    assert found[-1].direction[2] < -0.8 and found[-1].direction[1] > 0.0     # to the camera, down


@pytest.mark.parametrize("pose", [
    people.standing(), people.raised("right"), people.crossed(), people.on_face(),
    people.standing().arm("left", (0.02, 0.02, 0.28), (0.04, 0.03, 0.54))],
    ids=["standing", "raised", "crossed", "on_face", "bent"])
def test_other_arms_do_not_point(pose):
    assert told(pose.seen())[-1] is None


def test_an_arm_that_sweeps_does_not_point():
    def sweeping(time):
        angle = 1.5 * time
        return people.standing().arm("right", (0.28 * np.cos(angle), 0.28 * np.sin(angle), 0.0),
                                     (0.54 * np.cos(angle), 0.54 * np.sin(angle), 0.0)).seen()
    assert all(one is None for one in told(sweeping))


def test_the_ray_ends_on_a_body_else_on_the_floor():
    ray = Pointing(np.zeros(3), np.array([0.0, 0.0, 1.0]), 1.0)
    other = people.standing().seen(place=(0.1, 0.5, 4.0))
    hit = aim(ray, {"other": other}, people.UP, 1.5)
    assert hit.receiver == "other" and hit.place[2] == pytest.approx(4.0, abs=0.2) and hit.confidence < 1.0
    down = Pointing(np.zeros(3), np.array([0.0, 0.6, 0.8]), 1.0)
    floor = aim(down, {}, people.UP, 1.5)
    assert floor.receiver == "" and floor.place == pytest.approx([0.0, 1.5, 2.0])
    assert aim(down, {}, people.UP, None).place is None
    assert aim(ray, {}, people.UP, 1.5).place is None


def test_of_two_side_by_side_neither_is_surely_meant():
    ray = Pointing(np.zeros(3), np.array([0.0, 0.0, 1.0]), 1.0)
    one, two = (people.standing().seen(place=(left, 0.5, 4.0)) for left in (0.1, -0.15))
    alone, both = aim(ray, {"one": one}, people.UP, 1.5), aim(ray, {"one": one, "two": two}, people.UP, 1.5)
    assert alone.receiver == both.receiver == "one"
    assert alone.confidence > 0.75 and 0.3 < both.confidence < 0.55
