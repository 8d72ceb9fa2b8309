import numpy as np
import pytest
from synthetic_people import standing_at

from hri_fullbody.core.sight.body_sight import Sight
from hri_fullbody.core.tracking.body_appearance import blend, describe, difference
from hri_fullbody.core.tracking.body_motion import BodyMotion, ConstantVelocity
from hri_fullbody.core.tracking.body_schedule import PoseSchedule
from hri_fullbody.core.tracking.body_track import BodyTrack
from hri_pipeline.core.track_life import TrackLife


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


def test_velocity_in_metres():
    motion = BodyMotion(np.array([300.0, 300.0]), 300.0, np.array([0.0, 0.0, 3.0]), 0.0)
    for index in range(1, 40):
        motion.update(np.array([300.0, 300.0]), 300.0, np.array([0.0, 0.0, 3.0 - 0.05 * index]), index * 0.05)
    assert motion.velocity == pytest.approx([0.0, 0.0, -1.0], abs=0.15)
    assert motion.predicted_root(2.15)[2] == pytest.approx(0.85, abs=0.1)
    assert motion.depth_distance(np.array([0.0, 0.0, 3.0]), 2.0) > 3.0
    assert motion.depth_distance(None, 2.0) == 0.0
    assert BodyMotion(np.zeros(2), 1.0, None, 0.0).velocity is None


def picture(colour):
    image = np.full((720, 1280, 3), 128, np.uint8)
    image[250:650, 200:400] = colour
    return image


def test_appearance_tells_colours_apart_and_forgives_light():
    body = standing_at(300, 400)
    red, dim, blue = (describe(picture(colour), body) for colour in ((30, 30, 220), (22, 22, 160), (220, 60, 30)))
    assert difference(red, red) == pytest.approx(0.0, abs=1e-6)
    assert difference(red, dim) < 0.1
    assert difference(red, blue) > 0.9
    assert difference(describe(picture((20, 20, 20)), body), describe(picture((230, 230, 230)), body)) > 0.8
    assert difference(red, None) is None


def test_an_unseen_trunk_has_no_appearance():
    body = standing_at(300, 400)
    body.confidence[11] = 0.1
    assert describe(picture((30, 30, 220)), body) is None
    assert describe(picture((30, 30, 220)), standing_at(-800, 400)) is None


def test_appearance_is_learnt_slowly():
    body = standing_at(300, 400)
    red, blue = describe(picture((30, 30, 220)), body), describe(picture((220, 60, 30)), body)
    mixed = blend(red, blue, 0.1)
    assert difference(mixed, red) < difference(mixed, blue)
    assert blend(None, blue, 0.1) is blue and blend(red, None, 0.1) is red


def tracks(count, stamp=0.0):
    made = []
    for index in range(count):
        track = BodyTrack("b{}".format(index), Sight(standing_at(100 + 100 * index, 400)), stamp,
                          TrackLife(stamp, 0.0, 1.0))
        made.append(track)
    return made


@pytest.mark.parametrize("count, rate, fps", [(1, 10.0, 20.0), (3, 10.0, 20.0), (2, 10.0, 15.0), (10, 8.0, 30.0)])
def test_every_body_gets_its_rate_and_the_images_an_even_load(count, rate, fps):
    schedule, known, looks, load = PoseSchedule(rate), tracks(count), {}, []
    for index in range(1, int(10 * fps) + 1):
        stamp = index / fps
        chosen = schedule.choose(known, stamp)
        load.append(len(chosen))
        for track in chosen:
            track.looked_at = stamp
            looks[track.id] = looks.get(track.id, 0) + 1
    assert list(looks.values()) == pytest.approx([rate * 10] * count, rel=0.05)
    assert max(load[1:]) - min(load[1:]) <= 1


def test_a_rate_above_that_of_the_images_is_every_image():
    schedule, known = PoseSchedule(10.0), tracks(4)
    for index in range(1, 20):
        chosen = schedule.choose(known, index * 0.2)
        for track in chosen:
            track.looked_at = index * 0.2
        assert index == 1 or len(chosen) == 4


def test_a_budget_is_shared_fairly_and_never_exceeded():
    schedule, known, longest = PoseSchedule(0.0, budget=3), tracks(10), 0.0
    for index in range(1, 100):
        stamp = index * 0.05
        chosen = schedule.choose(known, stamp)
        assert len(chosen) == 3
        for track in chosen:
            longest = max(longest, stamp - track.looked_at)
            track.looked_at = stamp
    assert longest <= 0.05 * 4 + 1e-9


def test_what_is_reserved_is_left_but_for_one_look():
    schedule, known = PoseSchedule(0.0, budget=3), tracks(10)
    assert [len(schedule.choose(known, 1.0 + reserved, reserved)) for reserved in range(5)] == [3, 2, 1, 1, 1]


def test_the_newborn_come_first():
    known = tracks(3, 0.0)
    known[1].looked_at = 0.3
    known[1].life = TrackLife(0.0, 0.1, 1.0)
    schedule = PoseSchedule(0.0, budget=1)
    assert [track.id for track in schedule.choose(known, 0.45)] == ["b1"] or known[1].looked_at == 0.3
    known[1].looked_at = 0.0
    assert [track.id for track in schedule.choose(known, 0.5)] == ["b1"]


@pytest.mark.parametrize("rate, budget", [(-1.0, 0), (1.0, -1)])
def test_negative_rates_are_refused(rate, budget):
    with pytest.raises(ValueError):
        PoseSchedule(rate, budget)
