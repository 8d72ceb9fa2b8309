from dataclasses import replace

import numpy as np
import pytest
from synthetic_people import standing_at

from hri_fullbody.core.detection.pose_estimator import PoseDetection
from hri_fullbody.core.detection.windows import FACE_WINDOW_SIZES, FaceBox, window_from_face
from hri_fullbody.core.tracking.reidentification import blend, describe, difference
from hri_fullbody.core.tracking.track import BodyMotion, BodyTrack, ConstantVelocity
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.tracks import TrackLife


def test_a_constant_velocity_is_found_and_goes_on():
    random = np.random.default_rng(0)
    known = ConstantVelocity(np.zeros(2), 1.0, 50.0, 0.0)
    for index in range(1, 60):
        known.update(np.array([30.0, -20.0]) * index * 0.05 + random.normal(size=2), 1.0, index * 0.05, 5.0)
    assert known.velocity == pytest.approx([30.0, -20.0], abs=4.0)
    value, sd = known.predict(3.45, 5.0)
    assert value == pytest.approx([103.5, -69.0], abs=4.0)
    assert np.all(sd > known.predict(2.95, 5.0)[1])


def test_an_older_stamp_changes_nothing():
    known = ConstantVelocity(np.zeros(1), 1.0, 1.0, 5.0)
    known.update(np.array([100.0]), 1.0, 4.0, 1.0)
    assert (known.value[0], known.stamp) == (0.0, 5.0)
    known.update(np.array([10.0]), 1.0, 6.0, 1.0)
    assert known.velocity[0] > 1.0
    for stamp in (6.0, 5.0, 0.0):
        assert known.expected(stamp) == known.value and known.predict(stamp, 1.0)[1] == known.predict(6.0, 1.0)[1]


def test_velocity_in_metres():
    motion = BodyMotion(np.array([300.0, 300.0]), 300.0, np.array([0.0, 0.0, 3.0]), 0.0)
    for index in range(1, 40):
        motion.update(np.array([300.0, 300.0]), 300.0, np.array([0.0, 0.0, 3.0 - 0.05 * index]), index * 0.05)
    assert motion.velocity == pytest.approx([0.0, 0.0, -1.0], abs=0.15)
    assert motion.depth_distance(np.array([0.0, 0.0, 3.0]), 2.0) > 3.0
    assert motion.depth_distance(None, 2.0) == 0.0
    assert BodyMotion(np.zeros(2), 1.0, None, 0.0).velocity is None
    motion.update(np.array([300.0, 300.0]), 300.0, None, 3.0)
    assert motion.velocity == pytest.approx([0.0, 0.0, -1.0], abs=0.15)
    motion.update(np.array([300.0, 300.0]), 300.0, np.array([0.0, 0.0, 3.0]), 4.0)
    assert motion.velocity.tolist() == [0.0, 0.0, 0.0], "how somebody walked more than 2 s ago says nothing any more"


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_body_is_expected_where_it_goes_in_an_image_that_is_turned_from_now_on(quarters):
    turn, place = ImageRotation(quarters, 1280, 720), np.linspace(0.0, 1.0, 99).reshape(33, 3)
    face = FaceBox("f", np.array([500.0, 100.0, 560.0, 180.0]))
    track = BodyTrack("b", PoseDetection(standing_at(500, 400), place), 0.0, TrackLife(0.0, 0.1, 1.0), face)
    for number in range(1, 12):
        track.update(PoseDetection(standing_at(500 + 10 * number, 400), place + (0.05 * number, 0.0, 0.0)),
                     0.1 * number, True)
    before, velocity = track.expected(1.3), track.motion.velocity
    window = track.window(None, 1.3)
    track.turn(turn)
    after = track.expected(1.3)
    assert after.landmarks == pytest.approx(turn.pixels(before.landmarks), abs=1e-6)
    assert track.motion.velocity == pytest.approx(turn.vectors(velocity)) and velocity[0] > 0.2
    assert track.detection.points == pytest.approx(turn.vectors(place + (0.55, 0.0, 0.0)))
    assert track.window(None, 1.3).centre == pytest.approx(turn.pixels(np.array([window.centre]))[0], abs=1e-6)
    assert track.had_face_at(face.turned(turn), 0.0) and not track.had_face_at(face, 0.0)
    track.update(replace(track.detection, points=turn.vectors(place + (0.65, 0.0, 0.0))), 1.3, True)
    assert track.motion.velocity == pytest.approx(turn.vectors(velocity), abs=0.1)


def face_at(x, name="f"):
    return FaceBox(name, np.array([x - 30.0, 100.0, x + 30.0, 180.0]))


def walking(speed=100.0):
    """A body that has gone to the right with its face (px/s), seen ten times a second until 1 s."""
    track = BodyTrack("b", PoseDetection(standing_at(500, 400)), 0.0, TrackLife(0.0, 0.1, 1.0), face_at(500))
    for number in range(1, 11):
        track.link(face_at(500 + 0.1 * speed * number), 0.1 * number)
        track.update(PoseDetection(standing_at(500 + 0.1 * speed * number, 400)), 0.1 * number, True)
    return track


def test_a_body_that_is_not_seen_goes_on_and_fades_more_slowly_where_turns_are_rare():
    track = walking()
    (x, y), score = track.estimate.centre, track.estimate.score
    ways = np.array([track.expected(stamp).centre - (x, y) for stamp in (1.0, 1.2, 1.5)])
    assert ways == pytest.approx(np.array([[0.0, 0.0], [20.0, 0.0], [43.0, 0.0]]), abs=4.0)
    assert score == track.expected(1.0).score > track.expected(1.2).score > track.expected(1.5).score
    rare = walking()
    rare.wait = 2.0
    assert rare.expected(1.5).score > 0.7 * score > track.expected(1.5).score


@pytest.mark.parametrize("speed", [0.0, 100.0])
def test_a_body_moves_with_the_image_when_the_camera_turns(speed):
    track, way = walking(speed), np.array([50.0, -20.0])
    before, window = track.expected(1.2).centre, np.array(track.window(None, 1.2).centre)
    track.carry(0.5 * way)
    track.carry(0.5 * way)
    assert track.expected(1.2).centre - before == pytest.approx(way)
    assert np.array(track.window(None, 1.2).centre) - window == pytest.approx(way)
    assert track.place - track.estimate.centre == pytest.approx(way)
    seen = face_at(500 + speed)
    assert track.had_face_at(replace(seen, box=seen.box + np.tile(way, 2)), 1.0)
    track.update(PoseDetection(standing_at(550 + speed, 380)), 1.2, True)
    assert track.place == pytest.approx(track.estimate.centre), "what it has turned is in what is seen"


def test_between_two_measurements_a_body_is_shown_where_its_own_face_goes():
    track = walking()
    track.link(face_at(640), 1.2)
    assert track.moved_with_face(1.2) == pytest.approx([40.0, 0.0])
    assert track.moved_with_face(1.3) == pytest.approx(track.moved(1.3)), "no face in that image"
    track.link(face_at(700, "new"), 1.3)
    assert track.moved_with_face(1.3) == pytest.approx(track.moved(1.3)), "how far apart two faces are is no way"
    new = BodyTrack("b", PoseDetection(standing_at(500, 400)), 0.0, TrackLife(0.0, 0.1, 1.0), face_at(500))
    new.link(face_at(540), 0.1)
    assert new.moved_with_face(0.1) == pytest.approx([40.0, 0.0]), "from its first image on"


def test_the_window_below_the_face_that_has_shown_the_body_is_used_for_two_seconds():
    track, face = walking(), face_at(600)
    own = track.window(face, 1.0)
    track.hold_anchor(FACE_WINDOW_SIZES[1], 1.0)
    anchored = window_from_face(face, FACE_WINDOW_SIZES[1])
    assert [track.window(face, stamp) == anchored for stamp in (1.0, 2.9, 3.1)] == [True, True, False]
    assert track.window(None, 1.0) == own and [track.next_anchor(attempt) for attempt in (0, 1)] == [
        FACE_WINDOW_SIZES[1], FACE_WINDOW_SIZES[2 % len(FACE_WINDOW_SIZES)]]


@pytest.mark.parametrize("last_seen, waited_for", [(1.4, True), (1.2, False)])
def test_who_was_seen_for_a_second_is_waited_for_behind_others(last_seen, waited_for):
    """1.4 - 0.4 is a little less than 1 in floating point."""
    detection = PoseDetection(standing_at(600, 400))
    track = BodyTrack("b", detection, 0.4, TrackLife(0.4, 0.1, 1.0), box_confirmed=True)
    track.update(detection, last_seen, False)
    track.missed(last_seen + 0.2)
    track.judge_hidden(last_seen + 0.2, 1280)
    assert track.waits(last_seen + 0.2) is waited_for


def seen_at(x, speed=0.0, **more):
    """A body that has come to x px at a speed (px/s), seen ten times a second from 0 to 1.5 s."""
    estimates = [standing_at(x - speed * (1.5 - 0.1 * number), 400) for number in range(16)]
    track = BodyTrack("b", PoseDetection(estimates[0]), 0.0, TrackLife(0.0, 0.1, 1.0), **more)
    for number in range(1, 16):
        track.update(PoseDetection(estimates[number]), 0.1 * number, True)
    return track


@pytest.mark.parametrize("x, speed, known, blank, left, hidden", [
    (600, 0.0, {}, False, False, False), (600, 0.0, dict(box_confirmed=True), False, False, True),
    (600, 0.0, dict(face=face_at(600)), False, False, True),
    (600, 0.0, dict(box_confirmed=False), False, False, False),
    (80, 0.0, dict(box_confirmed=True), False, False, False),
    (80, -150.0, dict(box_confirmed=True), False, True, False),
    (1195, 100.0, dict(box_confirmed=True), False, True, False),
    (120, -500.0, dict(box_confirmed=True), False, True, False),
    (1160, 500.0, dict(box_confirmed=True), False, True, False),
    (80, -150.0, dict(box_confirmed=True), True, False, True)],
    ids=["nobody but the network saw it", "a person's box", "a face", "no box", "stands at the left",
         "goes out at the left", "goes out at the right", "fast to the left", "fast to the right", "no light"])
def test_who_is_missed_at_a_side_has_left_and_who_was_known_is_hidden_elsewhere(x, speed, known, blank, left, hidden):
    track = seen_at(x, speed, **known)
    track.missed(1.7)
    track.judge_hidden(1.7, 1280, blank)
    assert (track.left, track.hidden, track.waits(1.7)) == (left, hidden, hidden)
    track.cut_off(1.8)
    track.judge_hidden(1.8, 1280, blank)
    assert not track.hidden and not track.waits(1.8), "what the picture before showed is not behind this one"


@pytest.mark.parametrize("known, misses, lives_s", [
    ({}, 1, 100.0), ({}, 2, 1.0), (dict(box_confirmed=True), 1, 100.0), (dict(box_confirmed=True), 2, 3.0)],
    ids=["missed once", "gone", "hidden, missed once", "hidden"])
def test_who_is_missed_twice_is_dead_after_the_death_time_and_who_is_hidden_after_three_times_that(
        known, misses, lives_s):
    track = seen_at(600, **known)
    for _ in range(misses):
        track.missed(1.7)
    track.judge_hidden(1.7, 1280)
    assert [track.dead(1.5 + age) for age in (0.99 * lives_s, 1.01 * lives_s)] == [False, lives_s < 100.0]


def test_a_hidden_body_is_looked_for_where_it_goes_and_where_it_vanished_by_turns():
    track, places = walking(), []
    for stamp in (1.2, 1.3, 1.4):
        track.missed(stamp)
        places.append(track.window(None, 1.5).centre[0] - track.estimate.next_window().centre[0])
    assert places == pytest.approx([0.0, 43.0, 0.0], abs=5.0)


def test_a_face_that_is_gone_is_kept_for_half_a_second():
    """For ever, the body would count as one with a face, and nobody would doubt it."""
    track = walking()
    for stamp, kept in ((1.5, True), (1.6, False)):
        track.forget_lost_face(stamp)
        assert (track.face_id == "f") is kept and track.had_face_at(face_at(600, "new"), stamp) is kept
    track.forget_lost_face(1.7)
    assert not walking().had_face_at(face_at(640, "new"), 1.2), "somewhere else"
    assert not walking().had_face_at(face_at(600, "new"), 1.6), "too late"


def test_while_somebody_may_stand_before_a_body_its_clothes_are_not_learnt_and_its_place_little():
    red, blue = (describe(picture(colour), standing_at(300, 400)) for colour in ((30, 30, 220), (220, 60, 30)))
    changed, moved = [], []
    for unhidden in (True, False):
        track = walking()
        track.appearance, before = red, track.motion.predicted_centre(1.1)[0]
        track.update(PoseDetection(standing_at(660, 400), appearance=blue), 1.1, unhidden)
        changed.append(difference(track.appearance, red))
        moved.append(track.motion.predicted_centre(1.1)[0] - before)
    assert changed[0] > 0.01 and changed[1] == pytest.approx(0.0, abs=1e-6) and moved[0] > 3.0 * moved[1] > 0.0


def picture(colour):
    image = np.full((720, 1280, 3), 128, np.uint8)
    image[250:650, 200:400] = colour
    return image


def test_appearance_tells_colours_apart_and_forgives_light():
    body = standing_at(300, 400)
    red, dim, blue = (describe(picture(colour), body) for colour in ((30, 30, 220), (22, 22, 160), (220, 60, 30)))
    assert difference(red, red) == pytest.approx(0.0, abs=1e-6)
    assert difference(red, dim) < 0.3
    assert difference(red, blue) > 0.6
    assert difference(describe(picture((20, 20, 20)), body), describe(picture((230, 230, 230)), body)) > 0.5
    assert difference(red, None) is None and difference(None, red) is None


@pytest.mark.parametrize("shoulder", [11, 12])
def test_an_unseen_trunk_has_no_appearance(shoulder):
    body = standing_at(300, 400)
    body.confidence[shoulder] = 0.1
    assert describe(picture((30, 30, 220)), body) is None
    assert describe(picture((30, 30, 220)), standing_at(-800, 400)) is None


@pytest.mark.parametrize("x, y, other_side", [
    (0, 400, np.s_[:, 1100:]), (1280, 400, np.s_[:, :180]), (300, 80, np.s_[500:]), (300, 720, np.s_[:150])],
    ids=["left", "right", "top", "bottom"])
def test_of_a_body_that_a_border_cuts_what_is_in_the_image_counts_and_nothing_from_the_other_side(x, y, other_side):
    image = np.full((720, 1280, 3), 128, np.uint8)
    plain = describe(image, standing_at(x, y))
    image[other_side] = 30, 30, 220
    assert np.array_equal(describe(image, standing_at(x, y)), plain)


@pytest.mark.parametrize("height, parts", [
    (312, None), (320, [1, 0, 0, 0, 0]), (355, [1, 0, 1, 0, 0]), (360, [1, 1, 1, 0, 0]), (720, [1, 1, 1, 1, 1])])
def test_a_part_of_which_hardly_anything_is_in_the_image_is_not_seen(height, parts):
    """The chest begins at 309 px, the belly at 352 px."""
    seen = describe(picture((30, 30, 220))[:height], standing_at(300, 400))
    assert (None if seen is None else seen.sum(axis=1).round(9).tolist()) == parts


@pytest.mark.parametrize("known, shown", [(True, False), (False, True)])
def test_a_part_that_one_of_two_images_shows_is_that_of_this_image(known, shown):
    whole = describe(picture((30, 30, 220)), standing_at(300, 400))
    old, new = (np.where(np.arange(5)[:, None] < 4, whole, whole * there) for there in (known, shown))
    assert blend(old, new, 0.1) == pytest.approx(whole)


def test_appearance_is_learnt_slowly():
    body = standing_at(300, 400)
    red, blue = describe(picture((30, 30, 220)), body), describe(picture((220, 60, 30)), body)
    mixed = blend(red, blue, 0.1)
    assert difference(mixed, red) < difference(mixed, blue)
    assert blend(None, blue, 0.1) is blue and blend(red, None, 0.1) is red
