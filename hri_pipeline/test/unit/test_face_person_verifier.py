"""Doubted faces: who is asked about, when again, and what comes of it, with a person detector made of numbers."""

import itertools

import numpy as np
import pytest

from hri_pipeline.core.faces.mesh import MESH_POINTS
from hri_pipeline.core.faces.person_verifier import AGAIN, PATIENCE, PersonVerifier
from hri_pipeline.core.faces.track import FaceMeasurement, FaceTrack
from hri_pipeline.core.onnx import ModelError
from hri_pipeline.core.tracks import TrackLife

IMAGE = np.zeros((480, 640, 3), np.uint8)
NUMBERS = itertools.count()


def moved(stamp):
    """An image in which all has moved since any other stamp (s)."""
    return np.random.RandomState(int(round(10.0 * stamp))).randint(0, 255, (480, 640, 3), np.uint8)


def measured(x, score=0.7, verification=1.0):
    """A square face of 50 px about x, 200 px."""
    mesh = np.random.RandomState(0).uniform(-0.5, 0.5, (MESH_POINTS, 3))
    mesh[:2, :2] = (-0.5, -0.5), (0.5, 0.5)
    return FaceMeasurement(50.0 * mesh + (x, 200.0, 0.0), 0.99, True, score=score, verification=verification)


def track(x=100.0, score=0.7, verification=1.0):
    """A new track of such a face."""
    return FaceTrack("face_%d" % next(NUMBERS), measured(x, score, verification), TrackLife(0.0, 0.1, 1.0), 0.0)


class People:
    """Gives the same lead to all, and notes about what it was asked."""

    def __init__(self, lead):
        self.lead, self.asked, self.loaded = lead, [], 0

    def load(self):
        self.loaded += 1
        return self

    def lead_around(self, image, face):
        self.asked.append(float(face[[0, 2]].mean()))
        return self.lead


@pytest.mark.parametrize("score, verification, doubted", [
    (0.95, 1.0, False), (0.95, 0.7, True), (0.85, 2.0, True)], ids=["sure", "hardly verified", "faint"])
def test_only_faces_of_which_the_detector_is_not_sure_are_doubted(score, verification, doubted):
    one, people = track(score=score, verification=verification), People(2.0)
    around = PersonVerifier(people.load, 1.0)
    assert around.doubts(one) is doubted and people.loaded == 0
    around.limit(0.0)
    assert not around.doubts(one)


def test_the_detector_is_loaded_ahead_where_faces_are_doubted_at_all():
    people = People(2.0)
    PersonVerifier(people.load, 0.0).prepare()
    assert people.loaded == 0
    around = PersonVerifier(people.load, 1.0)
    around.prepare()
    around.prepare()
    around.verify(IMAGE, [track()], 0.0)
    assert people.loaded == 1 and len(people.asked) == 1


def test_who_has_a_person_around_is_asked_about_once():
    one, people = track(), People(2.0)
    around = PersonVerifier(people.load, 1.0)
    around.verify(IMAGE, [one], 0.0)
    assert one.vouched and not one.refused and not around.doubts(one)
    assert len(people.asked) == people.loaded == 1


def test_a_refused_face_is_asked_about_again_after_a_while_though_its_track_is_another_one():
    people = People(0.5)
    around = PersonVerifier(people.load, 1.0)
    for stamp in (0.0, 0.1, 0.9 * AGAIN):
        one = track(x=100.0 + stamp)
        around.verify(moved(stamp), [one], stamp)
        assert one.refused and not one.vouched and around.doubts(one)
    assert len(people.asked) == 1
    people.lead = 2.0
    around.verify(moved(AGAIN), [one], AGAIN)
    assert one.vouched and not one.refused and len(people.asked) == 2 and people.loaded == 1


def test_a_refusal_counts_at_its_place_only_and_not_after_a_reset():
    one, beside, people = track(), track(300.0), People(0.5)
    around = PersonVerifier(people.load, 1.0)
    around.verify(IMAGE, [one], 0.0)
    people.lead = 2.0
    around.verify(IMAGE, [one, beside], 0.1)
    assert beside.vouched and not one.vouched
    around.reset()
    around.verify(IMAGE, [one], 0.2)
    assert one.vouched


def test_a_thing_that_stands_still_is_not_asked_about_again_until_it_moves():
    people, one = People(0.5), track()
    around = PersonVerifier(people.load, 1.0)
    for stamp in np.arange(0.0, 20.0 * AGAIN, 0.3):
        around.verify(moved(0.0), [one], stamp)
        assert one.refused
    assert len(people.asked) == 1
    people.lead = 2.0
    around.verify(moved(21.0 * AGAIN), [one], 21.0 * AGAIN)
    assert one.vouched and len(people.asked) == 2


@pytest.mark.parametrize("lead, refusals", [(0.7, PATIENCE), (0.4, 2 * PATIENCE), (0.1, 5 * PATIENCE)])
def test_less_is_enough_after_some_refusals_and_nobody_who_moves_is_refused_for_ever(lead, refusals):
    one, people = track(), People(lead)
    around = PersonVerifier(people.load, 1.0)
    for count in range(refusals):
        around.verify(moved(count * AGAIN), [one], count * AGAIN)
        assert not one.vouched
    around.verify(moved(refusals * AGAIN), [one], refusals * AGAIN)
    assert one.vouched


def walk(around, seconds, begin_anew=()):
    """Somebody who walks by at three sizes of the face a second, with images at 10 Hz; returns the last track.

    begin_anew: images in which a track ends, and another one begins.
    """
    one = track(0.0)
    for index in range(round(10.0 * seconds)):
        stamp, x = 0.1 * index, 15.0 * index
        if index in begin_anew:
            one = track(x)
        one.continue_with(measured(x), stamp)
        around.verify(moved(stamp), [one] if around.doubts(one) else [], stamp)
    return one


@pytest.mark.parametrize("begin_anew", [(), (5, 18, 19)], ids=["one track", "several"])
def test_a_refused_face_that_walks_is_asked_about_once_a_second_too(begin_anew):
    people = People(0.5)
    assert walk(PersonVerifier(people.load, 1.0), 3.0, begin_anew).refused
    assert people.asked == pytest.approx([0.0, 150.0, 300.0], abs=1.0)


def test_who_walks_is_asked_about_with_the_same_demand_until_standing_somewhere():
    people = People(0.7)
    around = PersonVerifier(people.load, 1.0)
    one = walk(around, 4.0 * PATIENCE * AGAIN)
    there = float(one.measurement.box[[0, 2]].mean())
    for second in range(PATIENCE + 1):
        assert one.refused and not one.vouched
        stamp = (4.0 * PATIENCE + 1.0 + 1.1 * second) * AGAIN
        one.continue_with(measured(there), stamp)
        around.verify(moved(stamp), [one], stamp)
    assert one.vouched


def test_nobody_is_refused_for_ever_in_images_that_are_slower_than_refusals_are_forgotten():
    one, people = track(), People(0.7)
    around = PersonVerifier(people.load, 1.0)
    for stamp in np.arange(0.0, 4.0 * PATIENCE + 1.0, 4.0):
        assert not one.vouched
        around.verify(moved(stamp), [one], stamp)
    assert one.vouched


def test_another_lead_counts_for_those_who_were_refused_though_nothing_moves():
    one, people = track(), People(0.5)
    around = PersonVerifier(people.load, 1.0)
    around.verify(IMAGE, [one], 0.0)
    around.limit(1.0)
    around.verify(IMAGE, [one], 0.1)
    assert not one.vouched and len(people.asked) == 1
    around.limit(0.4)
    around.verify(IMAGE, [one], 0.2)
    assert one.vouched


def test_refused_faces_do_not_take_the_turns_of_new_ones():
    toys, people = [track(100.0 * number) for number in range(4)], People(0.01)
    around = PersonVerifier(people.load, 1.0)
    for second in range(8):     # 1 Hz: each is due in each image
        around.verify(moved(second), toys, float(second))
    assert {round(x) for x in people.asked} == {0, 100, 200, 300}
    people.lead, new = 2.0, track(500.0)
    around.verify(moved(8), [*toys, new], 8.0)
    assert new.vouched


def test_of_many_faces_each_is_asked_about_in_its_turn():
    faces, people = [track(100.0 * number) for number in range(5)], People(2.0)
    around = PersonVerifier(people.load, 1.0)
    for stamp in (0.0, 0.1, 0.2):
        around.verify(IMAGE, [face for face in faces if around.doubts(face)], stamp)
    assert people.asked == pytest.approx([100.0 * number for number in range(5)])
    assert all(face.vouched for face in faces)


def test_without_a_person_detector_it_is_told_once_and_nobody_is_doubted():
    def load():
        raise ModelError("model file person.onnx does not exist")

    told, one = [], track()
    around = PersonVerifier(load, 1.0, told.append)
    assert around.doubts(one)
    around.verify(IMAGE, [one, track(300.0)], 0.0)
    assert not around.doubts(one) and not one.refused and not around.doubts(track(500.0))
    assert told == ["new faces are not compared with what is around them: model file person.onnx does not exist"]
