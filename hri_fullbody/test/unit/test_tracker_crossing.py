"""Ids of people who cross, stand still, hide, and look alike."""

import itertools

import numpy as np
import pytest
from synthetic_people import Phantoms, Walkers, face_of, standing_at

from hri_fullbody.core.keypoints import BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER
from hri_fullbody.core.tracking.tracker import BodyTracker
from hri_pipeline.core.scheduler import InferenceScheduler

RED, ORANGE, BLUE, GREEN = (40, 40, 220), (40, 120, 220), (220, 60, 40), (50, 200, 60)


def locate(estimate):
    """Landmarks (33, 3) m as a camera of f = 1000 px would place them."""
    scale = float(np.linalg.norm(estimate.landmarks[34, :2] - estimate.landmarks[33, :2])) / 0.9
    depth = 1000.0 / scale
    root = np.append((estimate.landmarks[33, :2] - (640.0, 360.0)) / 1000.0 * depth, depth)
    return estimate.world + root


class Film:
    """Runs a tracker on walkers and notes who has which id."""

    def __init__(self, scene, rate=20.0, **changes):
        numbers = itertools.count()
        options = dict(birth_delay=0.1, death_time=1.0)
        options.update(changes)
        self.tracker = BodyTracker(scene, lambda: "b{}".format(next(numbers)), **options)
        self.scene, self.step, self.stamp = scene, 1.0 / rate, 0.0

    def run(self, seconds, walk=None, boxes=None, faces=lambda: ()):
        """Feed images for a time; walk(t) gives the people at t s of this run."""
        for index in range(int(round(seconds / self.step))):
            if walk is not None:
                self.scene.people = walk(index * self.step)
            seen = [self.scene.people[number] for number in self.scene.visible()]
            self.tracker.follow(self.scene.image(), self.stamp, faces(), locate)
            if boxes is not False:
                self.tracker.propose([standing_at(*person).box for person in seen], faces(), self.stamp)
            self.tracker.try_new(self.scene.image(), self.stamp, faces(), 3)
            self.stamp += self.step

    def ids(self):
        """Id at each visible person, None where there is none."""
        now = self.stamp - self.step
        published = self.tracker.published(now)
        found = []
        for number in self.scene.visible():
            x = self.scene.people[number][0]
            here = [track.id for track in published if abs(track.expected(now).centre[0] - x) < 40.0]
            assert len(here) <= 1
            found.append(here[0] if here else None)
        return found


def crossing(speed):
    return lambda time: [(300.0 + speed * time, 400.0), (900.0 - speed * time, 400.0)]


@pytest.mark.parametrize("schedule", [None, InferenceScheduler(10.0, most=6, batches=False)],
                         ids=["every image", "10 Hz"])
@pytest.mark.parametrize("rate", [20.0, 5.0])
@pytest.mark.parametrize("colours", [(RED, BLUE), (RED, RED)], ids=["unlike", "alike"])
@pytest.mark.parametrize("speed", [150.0, 300.0])
def test_two_people_who_cross_keep_their_ids(colours, rate, speed, schedule):
    if schedule is not None:
        schedule.reset()
    film = Film(Walkers([(300.0, 400.0), (900.0, 400.0)], colours), rate, schedule=schedule)
    film.run(0.8)
    before = film.ids()
    assert None not in before
    film.run(600.0 / speed, crossing(speed))
    assert film.ids() == before
    film.run(1.0)
    assert film.ids() == before
    assert sorted(track.id for track in film.tracker.tracks) == sorted(before)


def test_two_who_meet_and_turn_round_are_told_apart_by_their_clothes():
    film = Film(Walkers([(300.0, 400.0), (900.0, 400.0)], (RED, BLUE)))
    film.run(0.8)
    before = film.ids()
    film.run(1.2, crossing(240.0))
    assert len(film.scene.visible()) == 1
    film.run(1.0, lambda time: [(588.0 - 240.0 * time, 400.0), (612.0 + 240.0 * time, 400.0)])
    assert film.ids() == before


def test_a_hidden_person_is_not_published_and_comes_back_with_the_id():
    film = Film(Walkers([(500.0, 400.0), (900.0, 400.0)], (RED, BLUE)))
    film.run(0.8)
    before = film.ids()
    film.run(1.0, lambda time: [(500.0, 400.0), (900.0 - 400.0 * time, 400.0)])
    film.run(0.4)
    assert film.ids() == [before[1]]
    assert len(film.tracker.tracks) == 2
    film.run(0.6, lambda time: [(500.0, 400.0), (520.0 + 400.0 * time, 400.0)])
    assert film.ids() == before


class Remains(Walkers):
    """Like the network: in the window of somebody who has gone by a body is made of what is there, without shoulders
    that are seen."""

    remains = False

    def estimate(self, image, window, hidden=(), shown=None, mirrored=False):
        found = super().estimate(image, window, hidden, shown, mirrored)
        if found.score > 0.5 or not self.remains:
            return found
        made = standing_at(window.centre[0] - 60.0, window.centre[1], score=0.97)
        made.confidence[[BLAZE_LEFT_SHOULDER, BLAZE_RIGHT_SHOULDER]] = 0.2
        return made


def test_nobody_is_made_of_what_is_in_the_window_of_who_has_left_at_the_side():
    film = Film(Remains([(500.0, 400.0), (1100.0, 400.0)], (RED, BLUE)))
    film.run(1.2)
    before = film.ids()
    film.run(0.5, lambda time: [(500.0, 400.0), (1100.0 + 300.0 * time, 400.0)])
    film.run(0.2, lambda time: [(500.0, 400.0), (3000.0, 400.0)])
    film.scene.remains = True
    for _ in range(6):
        film.run(0.1)
        told = [track.id for track in film.tracker.published(film.stamp - film.step)]
        assert told == before[:1]


class HalfIn(Walkers):
    """One shoulder lies outside the image, so that the clothes are never known; at times the network finds nobody."""

    misses = False

    def estimate(self, image, window, hidden=(), shown=None, mirrored=False):
        if self.misses:
            return standing_at(*window.centre, score=0.01)
        found = super().estimate(image, window, hidden, shown, mirrored)
        found.confidence[BLAZE_LEFT_SHOULDER] = 0.2
        return found


@pytest.mark.parametrize("missed_s", [0.05, 0.3])
def test_who_stands_half_in_at_the_side_and_was_missed_comes_back_though_nobody_knows_the_clothes(missed_s):
    film = Film(HalfIn([(1250.0, 400.0)], (RED,)))
    film.run(1.2)
    before = film.ids()
    assert before != [None] and film.tracker.tracks[0].appearance is None
    film.scene.misses = True
    film.run(missed_s, boxes=False)
    film.scene.misses = False
    film.run(0.2, boxes=False)
    assert film.ids() == before


@pytest.mark.parametrize("onwards", [-1.0, 1.0], ids=["goes on", "goes back"])
@pytest.mark.parametrize("colours", [(RED, BLUE), (RED, RED)], ids=["unlike", "alike"])
def test_who_stands_before_a_seated_person_for_two_seconds_keeps_both_ids(colours, onwards):
    """At a walk, 1.2 m/s; images at 10 Hz."""
    seated = (500.0, 400.0)
    film = Film(Walkers([seated, (1000.0, 420.0)], colours), rate=10.0)
    film.run(1.0)
    before = film.ids()
    film.run(2.0, lambda time: [seated, (1000.0 - 240.0 * time, 420.0)])
    film.run(2.0, lambda time: [seated, (520.0, 420.0)])
    assert film.ids() == [before[1]]
    film.run(1.5, lambda time: [seated, (520.0 + onwards * 240.0 * time, 420.0)])
    assert film.ids() == before


def test_who_is_found_again_among_many_is_looked_at_again_at_once():
    """Else the turn is that of a hidden body, up to a second away, and the place drifts with a guessed velocity."""
    others = [(100.0 + 150.0 * number, 400.0) for number in range(7)]
    scene = Walkers([(1180.0, 400.0), *others], [RED] + 7 * [BLUE])
    film = Film(scene, rate=10.0, schedule=InferenceScheduler(10.0, most=3, batches=False))
    film.run(2.0)
    own = film.ids()[0]
    film.run(1.5, lambda time: [(1000.0, 400.0), *others])      # behind the last one
    assert own not in film.ids()
    film.run(0.1, lambda time: [(1160.0, 400.0), *others])
    back = next(track for track in film.tracker.tracks if track.id == own)
    looks = []
    for _ in range(6):
        film.run(0.1)
        looks.append(back.inferred_at)
        if back.visible:
            break
    film.run(0.1)
    assert back.visible and back.inferred_at > looks[-1]
    assert film.ids()[0] == own


def test_somebody_else_at_the_place_of_a_lost_person_gets_a_new_id():
    film = Film(Walkers([(500.0, 400.0)], (RED,)), death_time=2.0)
    film.run(1.0)
    film.scene.people = []
    film.run(0.4)
    film.scene.colours = [BLUE]
    film.run(0.8, lambda time: [(540.0, 400.0)])
    assert film.ids() == ["b1"]
    film.scene.colours = [RED]
    film.run(0.8, lambda time: [(500.0, 400.0)])
    assert film.ids()[0] != "b1"


def test_who_begins_where_another_one_is_hidden_is_told_when_that_one_has_not_come_back_for_half_a_second():
    others = [(800.0, 400.0), (1000.0, 400.0), (1150.0, 400.0)]
    film = Film(Walkers([(500.0, 400.0), *others], (RED, GREEN, GREEN, GREEN)), death_time=2.0)
    film.run(1.2)
    first = film.ids()
    film.scene.people, film.scene.colours = others, [GREEN] * 3
    film.run(0.4)
    film.scene.colours = [BLUE, *film.scene.colours]
    film.run(0.4, lambda time: [(520.0, 400.0), *others])
    assert len(film.tracker.tracks) == 5 and film.ids() == [None, *first[1:]]
    film.run(0.4)
    told = film.ids()
    assert told[0] not in (None, *first) and told[1:] == first[1:]
    for track in film.tracker.tracks:
        track.cut_off(film.stamp)       # the picture changes, and shows the same people
    film.run(0.1)
    assert film.ids() == told and set(told) <= {track.id for track in film.tracker.tracks if track.confirmed}


def test_the_lost_of_two_gets_the_id_back_and_not_that_of_a_neighbour():
    film = Film(Walkers([(400.0, 400.0), (620.0, 400.0)], (RED, BLUE)), death_time=2.0)
    film.run(1.0)
    before = film.ids()
    film.scene.people, film.scene.colours = [], []
    film.run(0.5)
    film.scene.colours = [BLUE]
    film.run(0.6, lambda time: [(520.0, 400.0)])      # half-way between the two places
    assert film.ids() == [before[1]]


def test_people_who_stand_still_are_kept_without_the_detector():
    film = Film(Walkers([(300.0, 400.0), (700.0, 400.0)], (RED, RED)))
    film.run(1.0)
    before = film.ids()
    film.run(8.0, boxes=False)
    assert film.ids() == before


def test_a_window_captured_by_a_neighbour_refreshes_the_neighbour():
    scene = Walkers([(300.0, 400.0), (460.0, 400.0)], (RED, BLUE))
    film = Film(scene)
    film.run(1.0)
    before = film.ids()
    scene.people, scene.colours = [(460.0, 400.0)], [BLUE]      # the left one is hidden behind a pillar
    film.run(0.6)
    assert film.ids() == [before[1]]
    scene.people, scene.colours = [(300.0, 400.0), (460.0, 400.0)], [RED, BLUE]
    film.run(0.6)
    assert film.ids() == before


@pytest.mark.parametrize("schedule", [None, InferenceScheduler(10.0, most=1, batches=False)],
                         ids=["every image", "by turns"])
@pytest.mark.parametrize("first", [0, 1], ids=["hidden came first", "hidden came last"])
def test_who_is_hidden_does_not_become_a_double_of_who_stands_before(first, schedule):
    places = [(300.0, 400.0), (460.0, 400.0)]
    scene = Phantoms([places[first]], [RED])
    if schedule is not None:
        schedule.reset()
    film = Film(scene, schedule=schedule)
    film.run(1.0)
    scene.people, scene.colours = list(places), [RED, RED]
    film.run(1.5)
    before = film.ids()
    assert None not in before
    film.run(0.6, lambda time: [(300.0 + 240.0 * time, 400.0), places[1]])
    film.run(0.4)       # till both had their turn
    for _ in range(20):
        film.run(0.1)
        assert len(film.tracker.published(film.stamp - film.step)) <= 1     # dressed alike, nothing tells who it is
    film.run(0.6, lambda time: [(444.0 - 240.0 * time, 400.0), places[1]])
    film.run(0.5)
    assert sorted(film.ids()) == sorted(before)


def test_of_two_bodies_on_one_head_the_one_with_a_face_in_the_image_stays():
    scene = Phantoms([(300.0, 400.0), (460.0, 400.0)], (RED, RED))
    film = Film(scene)
    faces = [face_of(standing_at(300.0, 400.0), "f0"), face_of(standing_at(460.0, 400.0), "f1")]
    film.run(1.0, faces=lambda: faces)
    before = film.ids()
    film.run(0.6, lambda time: [(300.0 + 240.0 * time, 400.0), (460.0, 400.0)], faces=lambda: faces[1:])
    for _ in range(10):
        film.run(0.1, faces=lambda: faces[1:])
        assert [track.id for track in film.tracker.published(film.stamp - film.step)] == [before[1]]


def test_a_body_that_nobody_looks_at_is_published_for_the_death_time():
    film = Film(Walkers([(300.0, 400.0)], (RED,)), death_time=0.4, schedule=InferenceScheduler(5.0, batches=False))
    film.run(2.0)
    track = film.tracker.tracks[0]
    assert film.tracker.published(track.stamp + 0.39) == [track]
    assert film.tracker.published(track.stamp + 0.41) == []


def test_a_body_that_waits_for_its_look_is_published_until_that_is_overdue():
    film = Film(Walkers([(300.0, 400.0)], (RED,)), death_time=0.4, schedule=InferenceScheduler(1.0, batches=False))
    film.run(3.0)
    track = film.tracker.tracks[0]
    assert film.tracker.published(track.stamp + 1.3) == [track]
    assert film.tracker.published(track.stamp + 1.7) == []
    assert track.expected(track.stamp + 1.0).confidence.max() > 0.3 * track.estimate.confidence.max()


def test_a_body_between_two_looks_moves_on_with_less_confidence():
    scene = Walkers([(300.0, 400.0)], (RED,))
    film = Film(scene, rate=20.0, schedule=InferenceScheduler(5.0, batches=False))
    film.run(2.0, lambda time: [(300.0 + 200.0 * time, 400.0)])
    track = film.tracker.tracks[0]
    later = track.expected(track.stamp + 0.15)
    assert later.centre[0] - track.estimate.centre[0] == pytest.approx(30.0, abs=4.0)
    assert later.confidence.max() < 0.75 * track.estimate.confidence.max()
    assert track.expected(track.stamp) is track.estimate


def test_a_second_body_within_another_is_dropped_when_the_detector_sees_one_person():
    film = Film(Walkers([(300.0, 400.0), (460.0, 400.0)], (RED, RED), reach=0.0))
    film.run(0.6)
    film.run(0.5, lambda time: [(300.0, 400.0), (460.0 - 282.0 * time, 400.0)], boxes=False)
    assert len(film.tracker.tracks) == 2
    for _ in range(50):
        film.tracker.follow(film.scene.image(), film.stamp, (), locate)
        film.tracker.propose([standing_at(300.0, 400.0).box], (), film.stamp)
        film.stamp += 0.05
    assert len(film.tracker.tracks) == 1


def test_faces_decide_in_a_tight_pair():
    film = Film(Walkers([(300.0, 400.0), (380.0, 400.0)], (RED, RED), reach=0.0))
    faces = [face_of(standing_at(300.0, 400.0), "f0"), face_of(standing_at(380.0, 400.0), "f1")]
    film.run(2.0, faces=lambda: faces)
    assert sorted(track.face_id for track in film.tracker.tracks) == ["f0", "f1"]


@pytest.mark.parametrize("hidden_colour, hidden_s, worn, x, faced, told", [
    (ORANGE, 0.5, ORANGE, 365.0, False, False),
    (ORANGE, 0.5, RED, 365.0, False, True),
    (ORANGE, 3.2, ORANGE, 365.0, False, True),
    (RED, 0.5, ORANGE, 365.0, False, True),
    (ORANGE, 0.5, ORANGE, 340.0, False, True),
    (ORANGE, 0.5, ORANGE, 365.0, True, True),
], ids=["clothes of the hidden", "own clothes", "hidden for long", "both alike", "hidden elsewhere", "own face"])
def test_who_is_seen_in_the_clothes_of_a_hidden_neighbour_is_silent(hidden_colour, hidden_s, worn, x, faced, told):
    front = (430.0, 400.0)
    film = Film(Walkers([(x, 400.0), front], (hidden_colour, RED)), death_time=2.0)
    faces = (lambda: [face_of(standing_at(*front), "f1")]) if faced else tuple
    film.run(1.2, faces=faces)
    first = film.ids()
    film.scene.people = [(400.0, 400.0), front]
    film.run(hidden_s, faces=faces)
    assert film.ids() == first[1:]
    film.scene.colours = [hidden_colour, worn]      # the network made its body of who is behind
    film.run(film.step, faces=faces)
    assert film.ids() == [first[1] if told else None]
    assert [track.id for track in film.tracker.tracks if track.visible] == first[1:]
    film.scene.colours = [hidden_colour, RED]
    film.run(film.step, faces=faces)
    assert film.ids() == first[1:]
