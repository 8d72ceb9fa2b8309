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


@pytest.mark.parametrize("rate, seconds", [(4.0, 1.0), (5.0, 0.8), (8.0, 0.6), (30.0, 0.5)])
def test_it_is_told_from_slow_cameras_too(rate, seconds):
    found = told(AHEAD.seen(), seconds=2.0, rate=rate)
    assert [pointing is not None for pointing in found].index(True) / rate <= seconds
    assert None not in found[int(seconds * rate):]


@pytest.mark.parametrize("rate, gap", [(30.0, 0.85), (15.0, 0.8)])
def test_what_was_seen_before_a_gap_is_no_part_of_it(rate, gap):
    """A camera of many images is no slow one where some are missing: the arm was anywhere in between."""
    estimator, point = PointingEstimator(), AHEAD.seen()
    for stamp in np.arange(int(rate)) / rate:
        found = estimator.update(point, people.STATURE, stamp, people.UP)
    assert found is not None
    back = 1.0 - 1.0 / rate + gap + np.arange(int(0.5 * rate) + 1) / rate
    told_again = [estimator.update(point, people.STATURE, stamp, people.UP) is not None for stamp in back]
    assert told_again[-1] and not any(told_again[:int(0.3 * rate)]), told_again


@pytest.mark.parametrize("pose", [
    people.standing(), people.raised("right"), people.crossed(), people.on_face(),
    people.standing().arm("left", (0.02, 0.02, 0.28), (0.04, 0.03, 0.54))],
    ids=["standing", "raised", "crossed", "on_face", "bent"])
def test_other_arms_do_not_point(pose):
    assert told(pose.seen())[-1] is None


def stretched(pose, side, height, aside=0.0):
    """An arm that is stretched out forwards, `height` rad above the level of the shoulder, turned `aside` rad."""
    way = np.array([np.cos(height) * np.cos(aside), np.cos(height) * np.sin(aside), np.sin(height)])
    return pose.arm(side, tuple(0.28 * way), tuple(0.54 * way))


@pytest.mark.parametrize("degrees, points", [(-48, False), (-42, True), (0, True), (47, True), (53, False)])
def test_an_arm_that_hangs_or_is_raised_steeply_does_not_point(degrees, points):
    assert (told(stretched(people.standing(), "right", np.radians(degrees)).seen())[-1] is not None) == points


@pytest.mark.parametrize("speed", [0.15, 1.5], ids=["held less still", "swept"])
@pytest.mark.parametrize("still, sign", [("left", 1.0), ("right", -1.0)])
def test_of_two_stretched_arms_the_stiller_one_points(still, sign, speed):
    moving = {"left": "right", "right": "left"}[still]

    def pointing(time):
        pose = stretched(people.standing(), still, 0.0, sign * 0.5)
        return stretched(pose, moving, 0.0, sign * (-0.5 + speed * time)).seen()

    both, alone = told(pointing)[-1], told(stretched(people.standing(), still, 0.0, sign * 0.5).seen())[-1]
    assert both.direction == pytest.approx(alone.direction, abs=1e-6)


def test_an_arm_that_sweeps_does_not_point():
    assert all(one is None for one in told(
        lambda time: stretched(people.standing(), "right", 0.0, 1.5 * time).seen()))


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
