"""Decay of the location confidence and the choice among sources of a place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hri_person_manager.core.location import (
    LONGEST_STEP,
    CoastingMotion,
    Decay,
    FaceBodyTransition,
    PersonLocation,
    Place,
    PlaceSource,
)
from hri_person_manager.core.persons import PersonState
from hri_pipeline.core.geometry import Pose


def place(x, stamp, frame="map"):
    return Place(frame, Pose(np.eye(3), np.array([x, 0.0, 0.0])), stamp)


@pytest.mark.parametrize("arguments", [
    {"kind": "sudden"}, {"half_life": 0.0}, {"half_life": -1.0}, {"half_life": float("nan")},
    {"floor": 0.0}, {"floor": 1.0}])
def test_illegal_decays_are_refused(arguments):
    with pytest.raises(ValueError):
        Decay(**arguments)


@pytest.mark.parametrize("kind, elapsed, expected", [
    ("exponential", 2.0, 0.5), ("exponential", 4.0, 0.25), ("exponential", 9.0, 0.0),
    ("linear", 2.0, 0.5), ("linear", 3.0, 0.25), ("linear", 4.0, 0.0),
    ("step", 0.0, 0.5), ("step", 3.9, 0.5), ("step", 4.0, 0.0)])
def test_decay_kinds(kind, elapsed, expected):
    assert Decay(kind, half_life=2.0, floor=0.05).confidence(elapsed) == pytest.approx(expected)


@pytest.mark.parametrize("kind", ["exponential", "linear", "step"])
def test_confidence_is_below_one_at_once_and_only_falls(kind):
    values = [Decay(kind).confidence(0.1 * step) for step in range(-5, 400)]
    assert values[0] < 1.0 and values[-1] == 0.0
    assert all(later <= earlier for earlier, later in zip(values, values[1:]))


def test_face_over_head_over_body_over_voice():
    for better in PlaceSource:
        for worse in PlaceSource:
            location = PersonLocation(0.5)
            assert location.offer(better, place(1.0, 10.0), 10.0)
            taken = location.offer(worse, place(2.0, 10.1), 10.1)
            assert taken == (worse <= better)
            assert location.place.pose.translation[0] == (2.0 if taken else 1.0)


def test_a_worse_source_speaks_once_the_better_one_is_silent_or_gone():
    location = PersonLocation(0.5)
    location.offer(PlaceSource.FACE, place(1.0, 10.0), 10.0)
    assert not location.offer(PlaceSource.BODY, place(2.0, 10.4), 10.4)
    assert location.offer(PlaceSource.BODY, place(2.0, 10.6), 10.6)
    assert location.offer(PlaceSource.FACE, place(1.0, 10.7), 10.7)
    location.retain((), 10.7)
    assert location.offer(PlaceSource.BODY, place(2.0, 10.8), 10.8)


@pytest.mark.parametrize("worse, other", [
    (PlaceSource.HEAD, "b"), (PlaceSource.BODY, "b"), (PlaceSource.VOICE, "v"), (PlaceSource.FACE, "g")])
@pytest.mark.parametrize("age", [-5.0, -0.65, 0.0, 0.3, 0.65, 5.0])
def test_no_message_wins_by_its_age(worse, other, age):
    location = PersonLocation(0.5)
    for number in range(60):
        now = 100.0 + 0.05 * number
        assert location.offer(PlaceSource.FACE, place(1.0, now), now, "f")
        if number % 2:
            assert not location.offer(worse, place(2.0, now - age), now + 0.01, other)


@pytest.mark.parametrize("age", [-0.65, 0.0, 0.65, 5.0])
def test_who_lags_takes_over_when_the_better_source_is_silent(age):
    location = PersonLocation(0.5)
    for number in range(20):
        location.offer(PlaceSource.FACE, place(1.0, 0.05 * number), 0.05 * number, "f")
    taken = [number for number in range(60)
             if location.offer(PlaceSource.BODY, place(2.0, 1.0 - age + 0.05 * number), 1.0 + 0.05 * number, "b")]
    assert 4 <= taken[0] <= 21 and taken == list(range(taken[0], 60))       # after 0.25 s to 1 s, and from then on


def test_stamps_that_jump_back_do_not_silence_anybody():
    location = PersonLocation(0.5)
    location.offer(PlaceSource.FACE, place(1.0, 1000.0), 10.0, "f")
    location.offer(PlaceSource.BODY, place(1.0, 1000.0), 10.0, "b")
    assert location.offer(PlaceSource.FACE, place(2.0, 3.0), 10.1, "f")          # a bag begins anew, the clock goes on
    assert not location.offer(PlaceSource.BODY, place(2.0, 3.0), 10.1, "b")
    location.offer(PlaceSource.FACE, place(1.0, 1000.0), 10.2, "f")
    assert not location.offer(PlaceSource.BODY, place(2.0, 3.1), 10.3, "b")
    assert location.offer(PlaceSource.BODY, place(2.0, 4.1), 11.3, "b")          # and there is no face at its beginning
    location.offer(PlaceSource.FACE, place(1.0, 1000.0), 1000.0, "f")
    assert location.offer(PlaceSource.BODY, place(2.0, 3.0), 3.0, "b")           # the clock goes back, too


def turning_away(face_error=0.3, speed=0.5, face_rate=15.0, until=2.0, then=4.0):
    """Stamps and places (x, m) of the frame of a person who walks, and turns the face away after `until` s."""
    location, way = PersonLocation(0.5), []
    for number in range(int(then * 30.0)):
        stamp = number / 30.0
        sources = [(PlaceSource.HEAD, speed * stamp)]
        if stamp < until and number % round(30.0 / face_rate) == 0:
            sources.append((PlaceSource.FACE, speed * stamp + face_error))
        for source, x in sources:
            if location.offer(source, place(x, stamp), stamp, "f" if source == PlaceSource.FACE else "b"):
                way.append((stamp, location.place.pose.translation[0]))
    return np.array(way[1:])         # the first is of the body alone


def test_a_body_goes_on_from_where_its_face_was():
    way = turning_away()
    assert np.diff(way[:, 0]).max() < 0.3 and np.diff(way[:, 0]).min() > 0.0         # no stop, nothing twice
    assert np.abs(np.diff(way[:, 1])).max() < 0.15                                  # no step of 0.3 m
    stamps, places = way[way[:, 0] > 3.9].T
    assert np.abs(places - 0.5 * stamps).max() < 0.1                                 # by and by where the body is
    # the face alone as long as it is there
    assert (way[way[:, 0] < 1.9, 1] > 0.5 * way[way[:, 0] < 1.9, 0] + 0.29).all()


def test_a_body_waits_longer_for_a_face_of_few_images():
    way = turning_away(face_rate=5.0)
    assert 0.45 < np.diff(way[:, 0]).max() <= 0.55                                   # source_timeout
    assert len(way[way[:, 0] < 1.9]) == 10


def test_a_body_too_far_from_the_face_is_taken_as_it_is():
    way = turning_away(face_error=1.5)
    assert abs(way[-1, 1] - 0.5 * way[-1, 0]) < 1e-9


def late_bodies(speed=0.0, face_rate=30.0, lag=3.0, face_error=0.6, until=10.0, then=16.0, root=False):
    """Times, x (m) and covariances of a person whose body comes `lag` s late, and whose face ends after `until` s;
    root: the root of the body comes, too."""
    location, way, period = PersonLocation(0.5), [], round(30.0 / face_rate)
    for number in range(int(then * 30.0)):
        now = number / 30.0
        if now < until and number % period == 0:
            location.offer(PlaceSource.FACE, place(speed * now + face_error, now), now, "f")
        if now >= lag and number % 30 == 0:
            seen = replace(place(speed * (now - lag), now - lag), covariance=0.01 * np.eye(3))
            location.offer(PlaceSource.HEAD, seen, now, "b", lag=lag)
            if root:
                location.offer(PlaceSource.BODY, seen, now, "b", lag=lag)
        way.append((now, location.place.pose.translation[0],
                    0.0 if location.place.covariance is None else location.place.covariance[0, 0]))
    return np.array(way)


@pytest.mark.parametrize("face_rate", [2.0, 5.0, 30.0])
def test_a_late_body_goes_on_from_where_its_face_was_at_that_time(face_rate):
    now, x, variance = late_bodies(face_rate=face_rate).T
    assert np.abs(np.diff(x)).max() < 0.2 and x[-1] < 0.5
    assert variance[now > 12.0].min() > 0.3          # one of the two is wrong by 0.6 m


def test_the_root_of_a_late_body_does_not_take_the_step_from_its_head():
    _, x, _ = late_bodies(root=True).T
    assert np.abs(np.diff(x)).max() < 0.2


def test_a_body_from_before_the_last_image_of_the_face_moves_nobody():
    now, x, _ = late_bodies(speed=0.5).T
    assert np.abs(np.diff(x[now < 12.9])).max() < 0.1, "it was 1 m behind"
    assert np.abs(np.diff(x)).max() < 0.55


def test_an_image_of_a_face_that_comes_late_does_not_end_the_comparison_with_its_body():
    location = PersonLocation(0.5)
    for stamp in (0.0, 0.2, 0.4, 0.3, 0.6):
        location.offer(PlaceSource.FACE, place(1.6, stamp), stamp, "f")
    location.offer(PlaceSource.HEAD, place(1.0, 0.1), 0.6, "b")
    assert location.offer(PlaceSource.HEAD, place(1.0, 1.7), 1.7, "b")
    assert location.place.pose.translation[0] > 1.2


def test_after_a_bag_has_begun_anew_a_body_goes_on_from_where_its_face_was():
    location = PersonLocation(0.5)
    location.offer(PlaceSource.FACE, place(1.6, 1000.0), 10.0, "f")
    for stamp in (0.0, 0.2, 0.4):
        location.offer(PlaceSource.FACE, place(1.6, stamp), 11.0 + stamp, "f")
        location.offer(PlaceSource.HEAD, place(1.0, stamp), 11.0 + stamp, "b")
    assert location.offer(PlaceSource.HEAD, place(1.0, 1.7), 12.7, "b")
    assert location.place.pose.translation[0] > 1.2


def test_where_a_face_was_between_two_images_far_apart_is_not_known():
    location = PersonLocation(0.5)
    for stamp in (0.0, 2.0):
        location.offer(PlaceSource.FACE, place(1.0 + stamp, stamp), stamp, "f")
    location.offer(PlaceSource.HEAD, place(2.5, 1.0), 2.1, "b")
    assert location.offer(PlaceSource.HEAD, place(3.5, 4.0), 4.0, "b")
    assert location.place.pose.translation[0] == 3.5


def face_and_body(last_body=1.0):
    """Somebody whose face was 0.6 m from the head of the body for a second, but in the last image."""
    location = PersonLocation(0.5)
    for stamp in np.linspace(0.0, 1.0, 21).tolist():
        location.offer(PlaceSource.FACE, place(1.6, stamp), stamp, "f")
        location.offer(PlaceSource.HEAD, place(1.0 if stamp < 1.0 else last_body, stamp), stamp, "b")
    return location


def both_seen(until=1.0, face=0.0, body=-0.2, rate=10.0, of="b"):
    """A face and a body at these x (m) of `map`, seen together until a time (s)."""
    transition = FaceBodyTransition()
    for stamp in (np.arange(0, int(until * rate) + 1) / rate).tolist():
        transition.face("map", np.array([face, 0.0, 0.0]), stamp)
        transition.body("map", np.array([body, 0.0, 0.0]), stamp, of)
    return transition


def shift(transition, stamp, of="b", x=-0.2):
    return transition.shifted(place(x, stamp), of).pose.translation[0] - x


def test_half_of_the_step_from_body_to_face_is_given_up_each_second_however_often_it_is_seen():
    for rate in (2.0, 5.0, 20.0):
        transition = both_seen()
        shifts = [shift(transition, 1.0 + number / rate) for number in range(1, int(2.0 * rate) + 1)]
        assert shifts[int(rate) - 1] == pytest.approx(0.1) and shifts[-1] == pytest.approx(0.05)
        transition.face("map", np.zeros(3), 3.1)
        assert shift(transition, 3.1 + 1e-6) == pytest.approx(0.2, abs=1e-3), "the face was there again"


def test_a_step_is_of_one_body_in_one_frame():
    transition = both_seen()
    assert shift(transition, 1.5, of="another") == 0.0
    transition.body("map", np.array([0.4, 0.0, 0.0]), 1.0, "another")
    assert shift(transition, 1.0 + 1e-6, of="another", x=0.4) == pytest.approx(-0.4, abs=1e-3), "not a mean of both"
    transition = FaceBodyTransition()
    transition.face("camera", np.array([0.9, 0.0, 0.0]), 1.0)
    transition.face("map", np.array([0.0, 0.0, 0.0]), 1.1)
    transition.body("map", np.array([-0.2, 0.0, 0.0]), 1.05, "b")
    assert shift(transition, 1.1 + 1e-6) == pytest.approx(0.2, abs=1e-3), "the face was in another frame before"
    transition.face("camera", np.array([0.9, 0.0, 0.0]), 1.2)
    transition.body("map", np.array([-0.2, 0.0, 0.0]), 1.2, "b")
    assert shift(transition, 1.3) == 0.0


def test_a_body_waits_for_three_images_of_the_face_once_both_were_seen():
    alone, cleared, paused = FaceBodyTransition(), both_seen(), both_seen()
    for number in range(200):
        alone.face("map", np.zeros(3), 0.1 * number)
    alone.body("map", np.zeros(3), 5.0, "b")        # 15 s late
    cleared.clear()
    for stamp in (6.0, 6.1):
        paused.face("map", np.zeros(3), stamp)
    assert [known.patience(1.0) for known in (FaceBodyTransition(), alone, cleared)] == [1.0, 1.0, 1.0]
    assert paused.patience(1.0) == pytest.approx(0.3) and paused.patience(0.2) == 0.2


def test_who_is_forgotten_or_leaves_has_left_nothing():
    location = PersonLocation(0.5, coast_time=1.0)
    for number in range(10):
        location.offer(PlaceSource.FACE, place(0.1 * number, 0.1 * number), 0.1 * number, "f")
        location.offer(PlaceSource.HEAD, place(0.1 * number - 0.2, 0.1 * number), 0.1 * number, "b")
    location.retain(("f", ), 0.95)
    assert not location.offer(PlaceSource.HEAD, place(0.75, 0.95), 0.95, "b"), "the face is there"
    assert not location.offer(PlaceSource.VOICE, place(5.0, 0.95), 0.95, "v")
    location.retain((), 1.0)
    assert 0.9 < location.confidence(1.0, Decay()) < 1.0 and location.confidence(6.1, Decay()) < 0.5
    location.offer(PlaceSource.FACE, place(1.0, 1.0), 1.0, "f")
    location.clear()
    assert location.place is None and location.expected(1.0) is None and location.confidence(1.0, Decay()) == 0.0
    assert location.offer(PlaceSource.VOICE, place(3.0, 1.0), 1.0, "v")
    assert location.offer(PlaceSource.HEAD, place(3.0, 1.1), 1.1, "b"), "no face is there any more"
    assert location.place.pose.translation[0] == 3.0
    assert location.expected(1.5).pose.translation[0] == pytest.approx(3.0)


def test_one_image_says_little_of_how_far_the_face_is_from_the_body():
    location = face_and_body(last_body=1.3)
    assert location.offer(PlaceSource.HEAD, place(1.0, 1.6), 1.6, "b")
    assert location.place.pose.translation[0] == pytest.approx(1.0 + 0.7 * 0.51)


def test_the_root_of_a_body_waits_for_its_head_as_for_any_better_source():
    location = face_and_body()
    for stamp in np.arange(1.05, 3.0, 0.05).tolist():
        location.offer(PlaceSource.HEAD, place(1.0, stamp), stamp, "b")
    assert not location.offer(PlaceSource.BODY, place(1.0, 3.4), 3.4, "b")
    assert location.offer(PlaceSource.BODY, place(1.0, 3.6), 3.6, "b")


def test_another_face_waits_for_the_first_one_as_for_any_better_source():
    location = face_and_body()
    assert not location.offer(PlaceSource.FACE, place(1.0, 1.4), 1.4, "g")
    assert location.offer(PlaceSource.FACE, place(1.0, 1.6), 1.6, "g")


@pytest.mark.parametrize("stamp", [0.5, 0.91 + LONGEST_STEP])
def test_two_places_far_apart_in_time_tell_no_velocity(stamp):
    motion = CoastingMotion(1.0)
    for number in range(10):
        motion.see(place(0.1 * number, 0.1 * number))
    assert motion.velocity[0] > 0.5
    motion.see(place(stamp, stamp))
    assert motion.velocity.tolist() == [0.0, 0.0, 0.0]


def test_a_body_in_another_frame_is_taken_as_it_is():
    location = PersonLocation(0.5)
    for number in range(10):
        location.offer(PlaceSource.FACE, place(1.0, 0.1 * number), 0.1 * number)
        location.offer(PlaceSource.HEAD, place(1.2, 0.1 * number), 0.1 * number)
    assert location.offer(PlaceSource.HEAD, replace(place(7.0, 2.0), frame="camera"), 2.0)
    assert location.place.pose.translation[0] == 7.0


def test_where_somebody_was_seen_is_better_than_the_direction_of_a_voice_for_a_while():
    location = PersonLocation(0.5)
    location.offer(PlaceSource.BODY, place(2.3, 10.0), 10.0)
    assert not location.offer(PlaceSource.VOICE, place(1.0, 11.0), 11.0)
    location.retain((), 11.0)
    assert not location.offer(PlaceSource.VOICE, place(1.0, 12.9), 12.9)
    assert location.place.pose.translation[0] == 2.3 and location.is_silent(12.9)
    assert location.offer(PlaceSource.VOICE, place(1.0, 13.1), 13.1)
    assert location.offer(PlaceSource.VOICE, place(1.1, 13.2), 13.2)
    assert location.offer(PlaceSource.VOICE, place(1.2, 5.0), 5.0)      # time has jumped back


def test_a_voice_that_lags_does_not_move_who_was_seen_shortly_before():
    location = PersonLocation(0.5)
    location.offer(PlaceSource.BODY, place(2.3, 10.0), 10.0, "b")
    location.retain(("v",), 10.1)
    assert not location.offer(PlaceSource.VOICE, place(1.0, 9.8), 10.5, "v")
    assert location.place.pose.translation[0] == 2.3


def test_silence():
    location = PersonLocation(0.5)
    assert location.is_silent(0.0)
    location.offer(PlaceSource.FACE, place(1.0, 10.0), 10.1)
    assert not location.is_silent(10.5)
    assert location.is_silent(10.7)


def test_the_newer_place_is_inherited():
    older, newer = PersonLocation(0.5), PersonLocation(0.5)
    older.offer(PlaceSource.BODY, place(1.0, 10.0), 10.0)
    newer.offer(PlaceSource.FACE, place(2.0, 11.0), 11.0)
    newer.inherit(older)
    assert newer.place.pose.translation[0] == 2.0
    older.inherit(newer)
    assert older.place.pose.translation[0] == 2.0


@pytest.mark.parametrize("own, at, other, other_at, taken", [
    (PlaceSource.FACE, 10.0, PlaceSource.VOICE, 10.2, False), (PlaceSource.VOICE, 10.2, PlaceSource.FACE, 10.0, True),
    (PlaceSource.FACE, 10.0, PlaceSource.BODY, 10.8, True), (PlaceSource.BODY, 10.8, PlaceSource.FACE, 10.0, False),
    (PlaceSource.FACE, 10.0, PlaceSource.FACE, 9.9, False), (PlaceSource.FACE, 9.9, PlaceSource.FACE, 10.0, True),
    (PlaceSource.VOICE, 10.0, None, 0.0, False), (None, 0.0, PlaceSource.FACE, 10.0, True)])
def test_of_two_who_are_one_the_better_place_counts_unless_it_is_old(own, at, other, other_at, taken):
    one, two = PersonLocation(0.5), PersonLocation(0.5)
    if own is not None:
        one.offer(own, place(1.0, at), at, "own")
    if other is not None:
        two.offer(other, place(2.0, other_at), other_at, "other")
    one.inherit(two)
    assert one.place.pose.translation[0] == (2.0 if taken else 1.0)
    assert one.confidence(max(at, other_at) + 0.9, Decay()) == 1.0
    seen = PlaceSource.VOICE not in (own, other) or PlaceSource.FACE in (own, other)
    assert one.offer(PlaceSource.VOICE, place(5.0, 12.0), 12.0, "v") != seen


def test_who_was_lost_is_as_sure_as_the_last_of_both_was():
    one, two = PersonLocation(0.5), PersonLocation(0.5)
    one.offer(PlaceSource.FACE, place(1.0, 5.0), 5.0, "own")
    two.offer(PlaceSource.FACE, place(2.0, 10.0), 10.0, "other")
    for location in (one, two):
        location.retain((), 10.2)
    one.inherit(two)
    assert one.confidence(10.3, Decay()) > 0.9


def test_the_face_of_two_who_are_one_goes_on_beside_the_body_of_the_other():
    body, face = PersonLocation(0.5), PersonLocation(0.5)
    face.offer(PlaceSource.FACE, place(2.0, 11.0), 11.0, "f")
    body.offer(PlaceSource.BODY, place(1.0, 11.1), 11.1, "b")
    body.inherit(face)
    assert body.place.pose.translation[0] == 2.0
    assert not body.is_silent(11.55), "the body was seen at 11.1"
    assert not body.offer(PlaceSource.BODY, place(1.0, 11.2), 11.2, "b")
    body.inherit(PersonLocation(0.5))
    assert body.place.pose.translation[0] == 2.0


def moving(coast_time, velocity=1.0, steps=20, step=0.1):
    location = PersonLocation(0.5, coast_time)
    for number in range(steps):
        stamp = number * step
        location.offer(PlaceSource.FACE, Place("map", Pose(np.eye(3), np.array([velocity * stamp, 0.0, 2.0])), stamp),
                       stamp)
    return location, (steps - 1) * step


def test_without_coasting_a_lost_person_stands_still():
    location, last = moving(0.0)
    assert location.expected(last + 5.0).pose.translation[0] == pytest.approx(last)


def test_a_lost_person_goes_on_and_comes_to_rest():
    location, last = moving(2.0)
    way = [location.expected(last + elapsed).pose.translation[0] - last for elapsed in (0.0, 0.1, 1.0, 2.0, 60.0)]
    assert way[0] == 0.0 and 0.07 < way[1] < 0.1 and 0.6 < way[2] < 0.75 and 0.8 < way[3] <= 1.0 and way[4] == way[3]


def test_a_place_that_is_told_twice_tells_no_other_velocity():
    once, twice = CoastingMotion(1.0), CoastingMotion(1.0)
    for number in range(10):
        once.see(place(0.1 * number, 0.1 * number))
        for _ in range(2):
            twice.see(place(0.1 * number, 0.1 * number))
    assert twice.velocity[0] == once.velocity[0] > 0.7


def test_in_the_frame_of_a_camera_the_floor_is_x_and_z():
    seen = Place("head_link", Pose(np.eye(3), np.array([1.0, 2.0, 3.0])), 0.0, covariance=np.diag([4.0, 5.0, 6.0]))
    assert seen.horizontal == (1.0, 2.0) and np.array_equal(seen.horizontal_covariance, np.diag([4.0, 5.0]))
    seen = replace(seen, of_camera=True)
    assert seen.horizontal == (1.0, 3.0) and np.array_equal(seen.horizontal_covariance, np.diag([4.0, 6.0]))


def test_a_jump_of_the_measurement_is_no_velocity():
    location, last = moving(2.0, velocity=0.0)
    location.offer(PlaceSource.FACE, Place("map", Pose(np.eye(3), np.array([9.0, 0.0, 2.0])), last + 0.1), last + 0.1)
    assert location.expected(last + 3.0).pose.translation[0] < 10.0
    location.offer(PlaceSource.FACE, Place("odom", Pose(np.eye(3), np.array([0.0, 0.0, 2.0])), last + 0.2), last + 0.2)
    assert location.expected(last + 3.0).pose.translation[0] == 0.0


def test_negative_coasting_is_refused():
    with pytest.raises(ValueError):
        PersonLocation(0.5, -1.0)


def test_nobody_knows_how_exact_a_place_is_for_long():
    location = PersonLocation(0.5)
    place = Place("map", Pose(np.eye(3), np.array([2.0, 0.0, 1.6])), 0.0, covariance=np.diag([0.04, 0.01, 0.01]))
    location.offer(PlaceSource.FACE, place, 0.0)
    assert location.expected(0.4) is place, "as long as its source is not silent"
    later = [location.expected(elapsed).covariance[0, 0] for elapsed in (1.0, 3.0, 9.0)]
    assert 0.04 < later[0] < later[1] < later[2]
    assert location.place is place
    optical = Place("camera_optical_frame", place.pose, 0.0, covariance=np.diag([1.0, 2.0, 3.0]))
    assert np.diag(optical.horizontal_covariance).tolist() == [1.0, 3.0]
    assert Place("map", place.pose, 0.0).horizontal_covariance is None


def test_the_place_now_is_less_exact_than_at_its_stamp_before_its_source_is_silent():
    seen = Place("map", Pose(np.eye(3), np.array([2.0, 0.0, 1.6])), 0.0, covariance=np.diag([0.04, 0.0016, 0.0016]))
    state = PersonState("ann", "fabcd", "", "", False, 1.0, "", seen, 0.3)
    assert state.place is seen and state.place_now.pose is seen.pose
    assert 0.1 < np.sqrt(state.place_now.covariance[1, 1]) < 0.25, "somebody walks on by .15 m"
    assert state._replace(place_age=0.0).place_now.covariance == pytest.approx(seen.covariance)
    assert state._replace(place=None).place_now is None
    assert state._replace(place=Place("map", seen.pose, 0.0)).place_now.covariance is None


@pytest.mark.parametrize("frame, is_level", [("map", True), ("base_footprint", True), ("camera_optical_frame", False)])
def test_who_is_out_of_sight_walks_away_but_not_up(frame, is_level):
    location = PersonLocation(0.5)
    seen = Place(frame, Pose(np.eye(3), np.array([2.0, 0.0, 1.6])), 0.0, covariance=np.diag([0.04, 0.01, 0.01]))
    location.offer(PlaceSource.FACE, seen, 0.0)
    spreads = np.array([np.sqrt(np.diag(location.expected(away).covariance)) for away in (0.6, 3.0, 20.0)])
    assert (np.diff(spreads[:, :2], axis=0) > 0.5).all(), "to the sides as before"
    if is_level:
        # A head that is still there is as high as before, or as that of who has sat down.
        assert 0.2 < spreads[-1, 2] < 0.3 and (np.diff(spreads[:, 2]) >= 0.0).all()
    else:
        assert spreads[-1, 2] > 2.0, "the camera may be tilted"
