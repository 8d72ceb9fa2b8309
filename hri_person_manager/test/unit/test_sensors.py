"""How late sources are, and a localisation that corrects itself: all that a camera sees jumps in map, and nobody
walks."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hri_person_manager.core.features import Kind, MatchNode, PlaceSource
from hri_person_manager.core.location import CoastingMotion, Place
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.sensors import (
    LASTS_S,
    LONGEST_LAG_S,
    LONGEST_PERIOD_S,
    MEMORY_S,
    CameraMotion,
    SensorTimes,
)
from hri_pipeline.core.geometry import Pose

CLOCK_S = 1000.0     # by which the camera's clock is behind
RATES = pytest.mark.parametrize("rate", [8.0, 15.0, 30.0])


def turned(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def speeds(rate, camera, person, seconds=6.0, noise=0.003):
    """Speeds (m/s) that are told; camera(t): its pose in map; person(t): where somebody is in the room, which the
    first pose of the camera tells right."""
    rng, motion, found = np.random.default_rng(5), CoastingMotion(1.0), []
    for stamp in np.arange(0.0, seconds, 1.0 / rate):
        told, true = camera(stamp)
        seen = true.inverse().apply(person(stamp)) + rng.normal(0.0, noise, 3)
        motion.see(Place("map", Pose(np.eye(3), told.apply(seen)), stamp, origin=told.translation, camera=told))
        found.append((stamp, float(np.linalg.norm(motion.velocity))))
    return np.array(found)


def localised(jump, drive=lambda stamp: Pose.identity(), at=3.0, lasts=0.0):
    """A camera on a way, told by a localisation that jumps at a time, at once or within `lasts` s."""
    def camera(stamp):
        true = drive(stamp)
        share = 0.0 if stamp < at else min(1.0, (stamp - at) / lasts) if lasts else 1.0
        return Pose(turned(share * jump[2]), share * np.array([jump[0], jump[1], 0.0])).compose(true), true
    return camera


def standing(stamp):
    return np.array([3.0, 0.5, 1.6])


@RATES
@pytest.mark.parametrize("jump", [(0.2, 0.0, 0.0), (-0.3, 0.4, 0.0), (0.2, 0.1, math.radians(5.0)),
                                  (0.0, 0.0, math.radians(25.0))])
def test_nobody_walks_by_a_jump_of_the_localisation(rate, jump):
    told = speeds(rate, localised(jump), standing)
    assert told[:, 1].max() < 0.1
    assert speeds(rate, localised(jump, lasts=0.1), standing)[:, 1].max() < 0.13, "as tf spreads it over 0.1 s"


@RATES
def test_who_walks_goes_on_with_the_same_speed(rate):
    told = speeds(rate, localised((0.3, 0.2, 0.0)), lambda stamp: np.array([3.0, 1.0 * stamp - 3.0, 1.6]))
    assert np.all(np.abs(told[told[:, 0] > 2.5, 1] - 1.0) < 0.2)


def driving(speed, turn):
    """A robot that accelerates for 1 s, then drives at a speed (m/s), and pans its camera with a rate (rad/s), ramped
    up as slowly, or by 45 degrees to and fro where that is None."""
    def drive(stamp):
        way = 0.5 * min(stamp, 1.0) ** 2 + max(0.0, stamp - 1.0)
        pan = math.radians(45.0) * math.sin(2.0 * stamp) if turn is None else turn * way     # up to 90 degrees/s
        return Pose(turned(pan), np.array([speed * way, 0.0, 0.0]))
    return drive


@RATES
@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_a_robot_that_drives_and_turns_changes_nothing(rate, speed):
    drive = driving(0.4, None)
    told = speeds(rate, lambda stamp: (drive(stamp),) * 2, lambda stamp: np.array([3.0, speed * stamp, 1.6]))
    assert np.all(np.abs(told[told[:, 0] > 2.5, 1] - speed) < 0.12)


def jumps(rate, camera):
    """The times (s) at which the camera is taken to jump."""
    motion = CameraMotion()
    return [stamp for stamp in np.arange(0.0, 5.0, 1.0 / rate) if motion.see(camera(stamp), 1.0 / rate) is not None]


@RATES
@pytest.mark.parametrize("speed, turn", [(2.0, 0.0), (0.0, 3.5)])
def test_a_fast_robot_does_not_jump(rate, speed, turn):
    assert not jumps(rate, driving(speed, turn))


@RATES
@pytest.mark.parametrize("jump", [(4.0, 1.0, 0.0), (0.0, 0.0, math.radians(60.0))])
def test_a_jump_is_over_soon_however_large_it_was(rate, jump):
    camera = localised(jump, driving(0.8, 0.0))
    assert 3.0 - 1e-6 < max(jumps(rate, lambda stamp: camera(stamp)[0])) < 3.0 + LASTS_S + 1.0 / rate


def test_where_the_camera_is_not_known_in_between_nothing_jumps_and_afterwards_it_may():
    motion, here = CameraMotion(), Pose.identity()
    for pose, step in ((None, 0.1), (here, 0.1), (here, 0.1), (None, 0.1), (here, 0.1), (here, 0.1)):
        assert motion.see(pose, step) is None
    assert motion.see(Pose(np.eye(3), np.array([0.3, 0.0, 0.0])), 0.1).translation == pytest.approx([0.3, 0.0, 0.0])


@pytest.mark.parametrize("angle", np.linspace(0.1, 3.1, 20))
def test_a_camera_that_stands_turned_by_any_angle_does_not_jump(angle):
    motion, pose = CameraMotion(), Pose(turned(angle), np.zeros(3))
    assert [motion.see(pose, step) for step in (0.0, 0.1, 0.1)] == [None] * 3


def test_the_way_of_a_robot_while_somebody_was_out_of_sight_is_no_jump():
    """Who walks beside the robot goes on as fast as before, after 2 s behind a pillar, too."""
    motion, without = CoastingMotion(1.0), CoastingMotion(1.0)
    for stamp in np.concatenate([np.arange(0.0, 3.0, 0.1), np.arange(5.0, 6.0, 0.1)]):
        camera = Pose(np.eye(3), np.array([stamp, 0.0, 1.2]))
        place = Place("map", Pose(np.eye(3), np.array([stamp, 1.5, 1.6])), stamp, origin=camera.translation,
                      camera=camera)
        motion.see(place)
        without.see(replace(place, camera=None))
        assert motion.velocity == pytest.approx(without.velocity), stamp


def test_the_camera_stands_with_the_place_of_a_person():
    settings = PERSON_MANAGER_PARAMETERS.resolve({})
    manager = PersonManager(settings)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_match(CandidateMatch(MatchNode(Kind.FACE, "f1"), MatchNode(Kind.PERSON, "ann"), 0.9), 0.0)
    camera = Pose(np.eye(3), np.array([1.0, 0.0, 1.2]))
    place = Place(settings.reference_frame, Pose(np.eye(3), np.array([3.0, 0.0, 1.6])), 0.1, origin=camera.translation,
                  camera=camera)
    assert manager.on_place(PlaceSource.FACE, "f1", place, 0.1, "camera") == "ann"
    assert manager.place("ann").camera is camera


def note(times, stamps, delay, source="face"):
    """The lags (s) of places of these stamps (s), which arrive `delay` s later by the clock of the robot."""
    return [times.note("camera", source, stamp, stamp + CLOCK_S + delay) for stamp in stamps]


def test_a_source_is_as_late_as_it_comes_after_the_least_delayed_one_whatever_the_clocks_say():
    times = SensorTimes()
    assert note(times, np.arange(0.0, 2.0, 0.1), 0.2) == pytest.approx([0.0] * 20)
    assert note(times, [1.0], 1.5, "body") == pytest.approx([1.3])


def test_the_least_delay_is_forgotten_after_half_a_minute_to_a_minute():
    times = SensorTimes()
    note(times, [0.0], 0.0)
    lags = note(times, np.arange(1.0, 70.0), 2.0)
    assert lags[:int(MEMORY_S / 2.0)] == pytest.approx([2.0] * int(MEMORY_S / 2.0))
    assert lags[int(MEMORY_S):] == pytest.approx([0.0] * (len(lags) - int(MEMORY_S)))


def test_a_least_delay_from_before_a_pause_of_a_minute_counts_no_more():
    times = SensorTimes()
    note(times, [0.0], 0.0)
    assert note(times, [MEMORY_S + 1.0], 2.0) == pytest.approx([0.0])


def test_where_a_bag_begins_anew_nothing_is_late():
    times = SensorTimes()
    note(times, np.arange(0.0, 5.0, 0.1), 0.2)
    assert note(times, [0.0, 0.1], 5.2) == pytest.approx([0.0, 0.0])


def test_more_than_the_longest_lag_is_a_clock_that_was_set():
    times = SensorTimes()
    note(times, [0.0], 0.2)
    late, very_late = 0.2 + LONGEST_LAG_S - 0.1, 0.2 + LONGEST_LAG_S + 0.1
    assert note(times, [1.0], late) == pytest.approx([LONGEST_LAG_S - 0.1])
    assert note(times, [2.0], very_late) == pytest.approx([0.0])
    assert note(times, [3.0], very_late + 1.0) == pytest.approx([1.0])


def test_what_comes_after_a_long_pause_tells_no_period():
    times = SensorTimes()
    note(times, [0.0, LONGEST_PERIOD_S + 1.0], 0.2)
    assert times.period("camera") is None
    note(times, [LONGEST_PERIOD_S + 1.5], 0.2)
    assert times.period("camera") == pytest.approx(0.5) and times.period("other") is None


def test_an_image_that_comes_late_makes_no_period_longer():
    times = SensorTimes()
    note(times, [1.0, 0.95, 1.1], 0.2)
    assert times.period("camera") == pytest.approx(0.1)


def test_sensors_are_bounded_and_those_that_began_first_go_first():
    times = SensorTimes()
    for number in range(150):
        times.note("s%d" % number, "face", 2000.0, 2000.0)
        times.note("first", "face", 1000.0 - number, 2000.0)       # its clock jumps back again and again
    assert list(times._sensors) == [*("s%d" % number for number in range(51, 150)), "first"]
