"""People in the views of several cameras: one human is one person, two humans never are."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hri_person_manager.core.cross_camera import CrossCamera
from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.location import Place, PlaceSource
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.triangulation import Scale, SensorTrack, ray_covariance
from hri_person_manager.core.view_groups import (
    MAX_NAMES,
    MAX_SENSORS,
    SensedGroup,
    View,
    ViewGroups,
    clothes_evidence,
    evidence_of_pairs,
    fuse_views,
    place_by_all,
)
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.tracks import COLOUR_BINS

RATE = 15.0


class Room:
    """Cameras that each see the people between two x, as faces, with noise and an error of the calibration."""

    def __init__(self, views, noise=0.03, seed=1, frame="map", clothes=None, farther=None, **given):
        """views: {camera: (x from, x to, error of x)}, m. clothes: {(camera, person): colours}; people are bodies
        then. farther: {camera: how many times as far away as they are it takes all people to be}."""
        self._clothes, self._farther = clothes or {}, farther or {}
        self._of = (Kind.BODY, PlaceSource.HEAD) if clothes else (Kind.FACE, PlaceSource.FACE)
        numbers = itertools.count(1)
        self.manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve(given), lambda: "a%04d" % next(numbers))
        self.views, self.frame = views, frame
        self._chance, self._noise = np.random.default_rng(seed), noise
        self._faces, self._visits = {}, itertools.count()
        self.now, self.most, self.ids = 0.0, 0, []

    def run(self, seconds, *people, say=()):
        """Let time pass with people given as functions of time that return x, y (or None, who is not there)."""
        for _ in range(int(round(seconds * RATE))):
            self.now += 1.0 / RATE
            self._see({number: person(self.now) for number, person in enumerate(people)})
            self.manager.tick(self.now)
            self.ids.append(self.tracked)
            self.most = max(self.most, len(self.tracked))
        return self.tracked

    @property
    def tracked(self):
        return self.manager.snapshot(self.now).tracked

    def face(self, camera, person):
        return self._faces[camera, person]

    def say(self, feature, person_id, likelihood=0.9, recogniser=""):
        self.manager.on_match(CandidateMatch(MatchNode(Kind.FACE, feature), MatchNode(Kind.PERSON, person_id),
                                             likelihood), self.now, recogniser)

    def _see(self, people):
        seen = {}
        for camera, (low, high, error) in self.views.items():
            for number, point in people.items():
                if point is not None and low <= point[0] <= high:
                    seen[camera, number] = (point[0] + error, point[1])
        for key in [key for key in self._faces if key not in seen]:
            del self._faces[key]
        for key in seen:
            self._faces.setdefault(key, "f%03d" % next(self._visits) if key not in self._faces else "")
        self.manager.on_tracked(self._of[0], sorted(self._faces.values()), self.now)
        for key, point in seen.items():
            position, origin = np.array([*point, 1.6]) + self._chance.normal(0.0, self._noise, 3), self._origin(key[0])
            position = origin + self._farther.get(key[0], 1.0) * (position - origin)
            self.manager.on_place(self._of[1], self._faces[key],
                                  Place(self.frame, Pose(np.eye(3), position), self.now, origin=origin),
                                  self.now, key[0])
            if key in self._clothes:
                self.manager.on_appearance(self._faces[key], self._clothes[key])

    def _origin(self, camera):
        """The cameras stand on both sides, in turn, 3 m away."""
        low, high, _ = self.views[camera]
        return np.array([0.5 * (low + high), -3.0 if list(self.views).index(camera) % 2 else 3.0, 1.6])


OVERLAPPING = {"left": (0.0, 4.0, 0.0), "right": (2.0, 6.0, 0.15)}
APART = {"left": (0.0, 3.0, 0.0), "right": (5.0, 8.0, 0.1)}


def standing(x, y=0.0):
    return lambda time: (x, y)


def walking(start, speed, y=0.0, since=0.0, stop=None):
    """From x = start on, as far as x = stop."""
    def where(time):
        x = start + speed * max(0.0, time - since)
        return (x if stop is None else min(x, stop) if speed > 0.0 else max(x, stop)), y
    return where


def test_one_human_in_two_views_is_one_person():
    room = Room(OVERLAPPING)
    room.run(4.0, standing(3.0))
    assert len(room.tracked) == 1
    aliases = [state.alias for state in room.manager.snapshot(room.now).persons if state.alias]
    assert aliases == list(room.tracked)
    room.run(20.0, standing(3.0))
    assert len(room.tracked) == 1 and len(set(room.ids[60:])) == 1


def test_a_threshold_that_is_changed_parts_nobody_whom_two_cameras_see():
    room = Room(OVERLAPPING)
    room.run(4.0, standing(3.0))
    for threshold in (0.95, 0.3):
        room.manager.reconfigure(PERSON_MANAGER_PARAMETERS.resolve({"match_threshold": threshold}), room.now)
        room.run(1.0, standing(3.0))
        assert len(room.tracked) == 1
        assert [likelihood >= threshold for _, _, likelihood in room.manager.merges] == [True]


def colours(top, trousers=60.0, light=0.0, tint=0.0):
    """Histograms (5, 21) of clothes of these lightnesses (0 to 255) as a camera of some light and tint shows them."""
    middles = [top + light] * 3 + [trousers + light] * 2
    spread = np.array([[25.0], [8.0], [8.0]])
    rows = [np.exp(-0.5 * ((COLOUR_BINS - np.array([[middle], [tint], [tint]])) / spread) ** 2) for middle in middles]
    return np.stack([(row / row.sum(axis=1, keepdims=True)).ravel() / 3.0 for row in rows])


def test_clothes_end_and_hasten_unions():
    """Two cameras that see somebody each, at one place; the clothes differ or not, or are of the commonest kind."""
    joined = {}
    for name, own, other in (("equal", 160.0, 160.0), ("dark", 40.0, 40.0), ("unknown", 160.0, None),
                             ("different", 160.0, 20.0)):
        clothes = {("left", 0): colours(own)}
        if other is not None:
            clothes["right", 0] = colours(other)
        room = Room(OVERLAPPING, clothes=clothes)
        room.run(4.0, standing(1.0))        # one camera knows him before
        start = room.now
        while room.now < start + 10.0:
            room.run(0.2, standing(3.0))
            groups = room.manager._cameras._groups
            if len(groups.all) == 1 and len(groups.sensors) == 2:
                break
        joined[name] = room.now - start
    assert joined["equal"] < joined["dark"] <= joined["unknown"] < joined["different"]


def view_of(number, sensor, origin, **places):
    """What a camera at `origin` sees of somebody who stands: its tracks by "face" or "body", each at a place."""
    view, origin = View(number, sensor), np.array(origin)
    for kind, place in places.items():
        track = view.tracks[MatchNode(Kind.FACE if kind == "face" else Kind.BODY, kind + sensor)] = SensorTrack(sensor)
        for step in range(30):
            track.add(int(PlaceSource.FACE if kind == "face" else PlaceSource.HEAD), np.array(place),
                      ray_covariance(np.array(place), origin), origin, step / RATE)
    return view


def test_a_face_and_a_body_in_one_view_place_somebody_together():
    views = [view_of(0, "a", (0.0, -2.5, 1.6), face=(0.1, 0.0, 1.6), body=(-0.1, 0.0, 1.6)),
             view_of(1, "b", (-2.5, 0.0, 1.6), face=(0.0, 0.1, 1.6), body=(0.0, -0.1, 1.6))]
    assert np.linalg.norm(place_by_all(views, 2.0, {}).position - (0.0, 0.0, 1.6)) < 0.02
    assert np.linalg.norm(fuse_views(views, 2.0).position - (0.0, 0.0, 1.6)) > 0.1


def test_a_distance_that_is_known_to_be_wrong_is_mended_where_rays_do_not_cross():
    """Two cameras that look at each other; one takes the human to be 15 % too far away."""
    views = [view_of(0, "a", (-2.5, 0.0, 1.6), face=(0.375, 0.0, 1.6)),
             view_of(1, "b", (2.5, 0.0, 1.6), face=(0.0, 0.0, 1.6))]
    scales = {("a", 0): Scale(1.0 / 1.15, 0.03 ** 2), ("b", 0): Scale(1.0, 0.03 ** 2)}
    assert abs(place_by_all(views, 2.0, scales).position[0]) < 0.02
    assert abs(place_by_all(views, 2.0, {}).position[0]) > 0.1


def test_a_distance_that_is_measured_better_than_its_error_was_learnt_stays():
    view = view_of(0, "a", (-2.5, 0.0, 1.6), face=(0.0, 0.0, 1.6))
    view.best.covariance = ray_covariance(np.array([0.0, 0.0, 1.6]), np.array([-2.5, 0.0, 1.6]), 0.02)
    assert abs(fuse_views([view], 2.0, {("a", 0): Scale(1.08, 0.03 ** 2)}).position[0]) < 1e-6


def test_two_cameras_place_somebody_before_they_are_told_to_see_one():
    room = Room(OVERLAPPING)
    (person,) = room.run(3.0, standing(1.8))
    groups, alone, both = room.manager._cameras._groups, np.trace(room.manager.place(person).covariance), []
    while room.now < 8.0 and not (len(groups.view_of) == 2 and len(groups.all) == 1):
        room.run(0.1, walking(1.8, 0.3, since=3.0))
        both += [np.trace(room.manager.place(person).covariance)] * (len(groups.all) == 2)
    assert room.tracked == (person,) and min(both) < 0.6 * alone < both[0]


def test_whose_clothes_are_others_is_not_who_left():
    seen = {}
    for other in (40.0, 220.0):
        room = Room(APART, clothes={("left", 0): colours(40.0), ("right", 0): colours(other)})
        first = room.run(2.0, standing(0.5))
        room.run(9.0, walking(0.5, 1.0, since=2.0, stop=7.0))
        seen[other] = room.tracked == first
    assert seen == {40.0: True, 220.0: False}


def test_who_left_is_known_in_the_light_of_another_camera():
    """A brighter and yellower image changes all parts alike; a dark shirt under it is somebody else's."""
    seen = {}
    for top in (180.0, 20.0):
        room = Room(APART, clothes={("left", 0): colours(180.0), ("right", 0): colours(top, light=45.0, tint=11.0)})
        first = room.run(2.0, standing(0.5))
        room.run(9.0, walking(0.5, 1.0, since=2.0, stop=7.0))
        seen[top] = room.tracked == first
    assert seen == {180.0: True, 20.0: False}


def evidence(one, other):
    tracks = SensorTrack("left"), SensorTrack("right")
    for track, appearance in zip(tracks, (one, other)):
        track.appearance = appearance
    return clothes_evidence(tracks[:1], tracks[1:])


def test_the_light_of_a_camera_speaks_less_against_one_human_than_one_part_of_the_clothes():
    own = colours(100.0)
    of_light = evidence(own, colours(100.0, light=45.0, tint=11.0))
    assert of_light > 1.5 and of_light == pytest.approx(evidence(colours(100.0, light=45.0, tint=11.0), own))
    assert evidence(own, colours(220.0)) < 0.0 < 1.5 < evidence(own, colours(190.0, 150.0))


def test_clothes_of_many_pairs_are_compared_as_those_of_each_one():
    worn = [colours(40.0), colours(100.0), None, colours(100.0, 200.0), np.ones((4, COLOUR_BINS.size)), np.ones((5, 7)),
            colours(220.0, light=45.0)]
    worn[3][3:] = 0.0
    people = [[SensorTrack("left")] for _ in worn]
    for (track,), appearance in zip(people, worn):
        track.appearance = appearance
    pairs = np.array(list(itertools.combinations(range(len(worn)), 2)))
    found = evidence_of_pairs(people, pairs)
    assert found == pytest.approx([evidence(worn[one], worn[other]) for one, other in pairs])
    assert [tuple(pair) for pair in pairs[found != 0.0]] == [(0, 1), (0, 3), (0, 6), (1, 3), (1, 6), (3, 6)]


def test_dark_clothes_are_common_and_speak_less_for_one_human_than_others():
    assert 0.0 < evidence(colours(40.0), colours(40.0)) < 0.6 * evidence(colours(160.0), colours(160.0))
    assert evidence(colours(40.0), colours(220.0)) < -1.0


def test_clothes_are_compared_by_the_parts_that_both_show():
    own, other = colours(100.0), colours(100.0, 200.0)
    other[3:] = 0.0
    assert evidence(own, other) > 0.0 > evidence(own, colours(100.0, 250.0))
    own[:3] = 0.0
    assert evidence(own, other) == 0.0


@pytest.mark.parametrize("colours", [np.zeros(5), np.full((5, 21), np.nan), np.full((5, 21), -0.1)],
                         ids=["flat", "nan", "negative"])
def test_an_appearance_of_wrong_numbers_is_refused(colours):
    with pytest.raises(ValueError, match="histograms"):
        Room(OVERLAPPING).manager.on_appearance("b1", colours)


def test_clothes_of_another_number_of_colours_say_nothing():
    room = Room(OVERLAPPING, clothes={("left", 0): colours(40.0), ("right", 0): np.ones((3, 4)) / 4.0})
    room.run(6.0, standing(3.0))
    assert len(room.tracked) == 1


@pytest.mark.parametrize("noise", [0.0, 0.03, 0.1])
def test_who_walks_through_overlapping_views_and_back_keeps_the_id(noise):
    room = Room(OVERLAPPING, noise)
    first = room.run(2.0, standing(0.5))
    room.run(8.0, walking(0.5, 0.7, since=2.0, stop=5.5))
    assert room.tracked == first
    room.run(8.0, walking(5.5, -0.7, since=10.0, stop=1.0))
    assert room.tracked == first
    # Later all is forgotten but the id and the person of the face that is seen now.
    room.run(40.0, standing(1.0))
    assert room.tracked == first
    owner = room.manager.person_of(MatchNode(Kind.FACE, room.face("left", 0)))
    assert [owner] == list(first) and len(room.manager.snapshot(room.now).persons) == 2


@pytest.mark.parametrize("speed", [0.8, 1.4])
def test_who_walks_through_views_with_a_gap_keeps_the_id(speed):
    room = Room(APART)
    way = walking(1.0, speed, since=1.0, stop=7.5)
    first = room.run(1.5, way)
    assert len(first) == 1
    room.run(2.0 + 6.5 / speed, way)
    assert room.tracked == first
    room.run(2.0 + 6.5 / speed, walking(7.5, -speed, since=room.now, stop=1.0))
    assert room.tracked == first


def test_the_id_stays_when_the_first_name_comes_in_the_second_view():
    room = Room(APART)
    way = walking(1.0, 1.0, since=1.0, stop=7.5)
    first = room.run(1.5, way)
    room.run(7.0, way)
    assert room.tracked == first
    room.say(room.face("right", 0), "ann")
    room.run(1.0, way)
    assert room.tracked == ("ann",)
    aliases = {state.id: state.alias for state in room.manager.snapshot(room.now).persons}
    assert aliases[first[0]] == "ann"


def test_somebody_else_who_comes_up_elsewhere_or_much_later_is_somebody_else():
    room = Room(APART)
    first = room.run(2.0, standing(2.5))
    room.run(1.0, lambda time: None)
    room.run(3.0, standing(7.5))
    assert len(room.tracked) == 1 and room.tracked != first
    room = Room({"left": (0.0, 3.0, 0.0), "right": (3.1, 8.0, 0.0)})
    first = room.run(2.0, standing(2.9))
    room.run(6.0, lambda time: None)
    room.run(3.0, standing(3.2))
    assert len(room.tracked) == 1 and room.tracked != first


@pytest.mark.parametrize("handover, ids", [(0.0, 2), (4.0, 1)])
def test_who_goes_over_to_another_view_is_handed_over_unless_that_is_switched_off(handover, ids):
    """The views overlap for less time than it takes to join who is seen in both."""
    room = Room({"left": (0.0, 3.05, 0.0), "right": (2.95, 8.0, 0.0)}, cross_camera_handover=handover)
    way = walking(1.0, 1.0, since=1.0, stop=7.5)
    first = room.run(1.5, way)
    room.run(4.0, way)
    assert len({*first, *room.tracked}) == ids


def test_whom_one_camera_has_lost_and_sees_again_is_for_its_tracker_and_recogniser_to_know():
    room = Room(APART)
    room.run(1.0, standing(6.0))        # the other camera sees somebody, too
    room.run(1.0, lambda time: None)
    first = room.run(2.0, standing(1.0))
    room.run(1.0, lambda time: None)
    room.run(3.0, standing(1.0))
    assert len(room.tracked) == 1 and room.tracked != first


def test_who_may_be_somebody_known_is_held_for_fifteen_seconds_and_then_a_person():
    room = Room({"left": OVERLAPPING["left"]}, cross_camera_time=30.0)
    room.run(1.0, standing(3.0))
    room.views = OVERLAPPING
    assert len(room.run(14.5, standing(3.0))) == room.most == 1
    assert len(room.run(1.5, standing(3.0))) == 2


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gap", [0.5, 0.7, 1.0])
def test_two_side_by_side_are_two_persons(gap, seed):
    room = Room(OVERLAPPING, 0.05, seed)
    room.run(10.0, standing(3.0), standing(3.0, gap))
    assert len(room.tracked) == 2
    owners = [{room.manager.person_of(MatchNode(Kind.FACE, room.face(camera, person))) for camera in room.views}
              for person in (0, 1)]
    assert (owners[0] - {None}).isdisjoint(owners[1])       # what may be either is nobody's yet


@pytest.mark.parametrize("seed", range(4))
def test_two_of_whom_each_camera_sees_another_are_two_persons(seed):
    room = Room({"left": (0.0, 3.0, 0.0), "right": (3.0, 6.0, 0.0)}, 0.05, seed)
    room.run(10.0, standing(2.6), standing(3.4))
    assert len(room.tracked) == 2


@pytest.mark.parametrize("speed", [0.6, 1.2])
def test_people_who_cross_stay_who_they_are(speed):
    room = Room({"left": (0.0, 6.0, 0.0), "right": (0.0, 6.0, 0.1)}, 0.05)
    there, back = walking(0.5, speed, since=3.0), walking(5.5, -speed, 0.3, since=3.0)
    first = room.run(3.0, there, back)
    assert len(first) == 2
    room.run(3.0 / speed, there, back)
    owners = [room.manager.person_of(MatchNode(Kind.FACE, room.face("left", person))) for person in (0, 1)]
    room.run(1.5, there, back)
    assert room.tracked == first and max(len(ids) for ids in room.ids[40:]) == 2
    assert owners == [room.manager.person_of(MatchNode(Kind.FACE, room.face("left", person))) for person in (0, 1)]


def test_people_who_pass_before_different_cameras_are_not_joined():
    """Each camera sees only one of them, as the other one is hidden."""
    room = Room({"left": (0.0, 6.0, 0.0), "right": (0.0, 6.0, 0.0)}, 0.05)
    there, back = walking(0.5, 1.0), walking(5.5, -1.0)
    hidden = {("left", 1), ("right", 0)}

    def half(people):
        faces = {}
        for camera, number in itertools.product(room.views, people):
            if (camera, number) not in hidden:
                faces[camera, number] = people[number]
        room.manager.on_tracked(Kind.FACE, ["f%s%d" % key for key in faces], room.now)
        for key, point in faces.items():
            room.manager.on_place(PlaceSource.FACE, "f%s%d" % key,
                                  Place("map", Pose(np.eye(3), np.array([*point, 1.6])), room.now),
                                  room.now, key[0])

    room._see = half
    room.run(5.0, there, back)
    assert len(room.tracked) == 2 and {len(ids) for ids in room.ids[15:]} == {2}
    assert room.manager.merges == () and not any(state.alias for state in room.manager.snapshot(room.now).persons)


def test_who_was_taken_for_one_and_parts_is_two_again():
    room = Room({"left": (0.0, 3.05, 0.0), "right": (3.0, 9.0, 0.0)})
    room.run(4.0, standing(2.95), standing(3.1))       # nothing tells them apart
    assert len(room.tracked) == 1
    room.run(5.0, standing(2.95), walking(3.1, 0.8, since=room.now))
    assert len(room.tracked) == 2


def test_who_was_taken_for_one_is_so_after_a_jump_of_time_until_it_parts():
    room = Room({"left": (0.0, 3.05, 0.0), "right": (3.0, 9.0, 0.0)})
    room.run(4.0, standing(2.95), standing(3.1))       # nothing tells them apart
    (person,) = room.tracked
    room.now -= 3.0
    room.manager.rewind(room.now)
    for _ in range(20):
        assert room.run(0.1, standing(2.95), standing(3.1)) == (person,)
    room.run(5.0, standing(2.95), walking(3.1, 0.8, since=room.now))
    assert len(room.tracked) == 2


def test_who_is_not_seen_after_a_jump_of_time_stays_one_while_somebody_else_is():
    room = known_by_two_names(11)
    room.now -= 20.0
    room.manager.rewind(room.now)
    for _ in range(2):
        room.run(1.5, standing(1.0))
        assert room.manager.representative("zoe") == "ann"


def test_two_who_stand_apart_after_a_jump_of_time_are_two():
    room = Room({"left": (0.0, 3.05, 0.0), "right": (3.0, 9.0, 0.0)})
    room.run(4.0, standing(2.95), standing(3.1))
    room.say(room.face("left", 0), "ann", 0.9, "/left")
    room.say(room.face("right", 1), "zoe", 0.9, "/right")
    assert room.run(1.0, standing(2.95), standing(3.1)) == ("ann",)
    room.now -= 3.0
    room.manager.rewind(room.now)
    room.run(5.0, standing(2.0), standing(5.0, 1.0))
    assert set(room.tracked) == {"ann", "zoe"}


def test_recognisers_that_do_not_know_each_other_may_give_two_names_to_one_human():
    room = Room(OVERLAPPING)
    room.run(4.0, standing(3.0))
    room.say(room.face("left", 0), "ann")
    room.run(1.0, standing(3.0))
    assert room.tracked == ("ann",)
    room.say(room.face("right", 0), "zoe")
    room.run(3.0, standing(3.0))
    assert room.tracked == ("ann",)
    # Later only the camera that says "zoe" sees her.
    room.run(3.0, lambda time: None)
    room.run(1.0, standing(5.0))
    room.say(room.face("right", 0), "zoe")
    room.run(1.0, standing(5.0))
    assert room.tracked == ("ann",)


def known_by_two_names(seed):
    """Whom the left camera calls ann and the right one zoe, and nobody is there."""
    room = Room(OVERLAPPING, seed=seed)
    room.run(4.0, standing(3.0))
    room.say(room.face("left", 0), "ann", 0.9, "/left")
    room.say(room.face("right", 0), "zoe", 0.9, "/right")
    assert room.run(4.0, standing(3.0)) == ("ann",)
    room.run(30.0, lambda time: None)
    return room


@pytest.mark.parametrize("seed", [11, 12, 13])
@pytest.mark.parametrize("named_after", [0.1, 1.0])
def test_who_comes_back_with_two_names_is_one_person_at_once(named_after, seed):
    room = known_by_two_names(seed)
    room.most = 0
    room.run(named_after, standing(3.3))
    room.say(room.face("left", 0), "ann", 0.9, "/left")
    room.say(room.face("right", 0), "zoe", 0.9, "/right")
    assert room.run(4.0, standing(3.3)) == ("ann",) and room.most == 1


@pytest.mark.parametrize("seed", [11, 12])
def test_two_names_of_one_human_who_are_seen_apart_are_two_at_once(seed):
    room = known_by_two_names(seed)
    people = standing(1.0), standing(5.0)
    room.run(1.0, *people)
    room.say(room.face("left", 0), "ann", 0.9, "/left")
    room.say(room.face("right", 1), "zoe", 0.9, "/right")
    room.run(0.4, *people)
    assert room.run(2.0, *people) == ("ann", "zoe") and {len(ids) for ids in room.ids[-30:]} == {2}


def test_who_comes_up_where_another_one_left_joins_no_two_whom_one_recogniser_names():
    """A hand-over that was wrong ends with the name; the names that two recognisers have for the first one stay."""
    room = Room(OVERLAPPING)
    people = standing(2.4), standing(3.6)
    room.run(3.0, *people)
    for number, (one, other) in enumerate((("ann", "zoe"), ("bob", "yan"))):
        room.say(room.face("left", number), one, 0.9, "/left")
        room.say(room.face("right", number), other, 0.9, "/right")
    assert set(room.run(2.0, *people)) == {"ann", "bob"}
    both, nobody = room.views, lambda time: None
    room.run(3.0, nobody)
    room.views = {"left": both["left"]}
    room.run(0.5, standing(3.0))
    room.say(room.face("left", 0), "ann", 0.9, "/left")
    assert room.run(2.0, standing(3.0)) == ("ann",)
    room.run(1.0, nobody)
    room.views = {"left": (9.0, 9.1, 0.0), "right": both["right"]}
    room.run(1.0, standing(3.0))
    room.say(room.face("right", 0), "yan", 0.9, "/right")
    room.run(2.0, standing(3.0))
    assert room.tracked == ("bob",)
    for stands_for, known in (("ann", ("ann", "zoe")), ("bob", ("bob", "yan"))):
        assert {room.manager.representative(person) for person in known} == {stands_for}


def test_names_of_one_recogniser_are_two_persons_at_one_place():
    room = Room(OVERLAPPING)
    room.run(1.0, standing(3.5), standing(5.5))
    room.say(room.face("right", 0), "ann")
    room.say(room.face("right", 1), "bob")
    room.run(1.0, standing(3.5), standing(5.5))
    room.run(1.0, lambda time: None, lambda time: None)
    room.run(0.2, standing(3.0))
    room.say(room.face("left", 0), "ann")
    room.say(room.face("right", 0), "bob")
    room.run(4.0, standing(3.0))
    assert room.tracked == ("ann", "bob")
    room.say(room.face("right", 0), "bob", 0.0)
    room.say(room.face("right", 0), "ann")
    room.run(4.0, standing(3.0))
    assert room.tracked == ("ann",)


def test_a_face_that_two_cameras_know_may_stand_farther_apart():
    views = {"left": (0.0, 4.0, 0.0), "right": (2.0, 6.0, 0.8)}
    room = Room(views)
    room.run(4.0, standing(3.0))
    assert len(room.tracked) == 2
    room.say(room.face("left", 0), "ann")
    room.say(room.face("right", 0), "ann", 0.8)
    room.run(4.0, standing(3.0))
    assert room.tracked == ("ann",)


def test_a_user_who_parts_or_joins_goes_before_what_is_seen():
    room = Room(OVERLAPPING)
    room.run(4.0, standing(3.0))
    (person,) = room.tracked
    room.manager.split(person, room.now)
    room.run(5.0, standing(3.0))
    assert len(room.tracked) == 2
    room.manager.merge(*room.tracked, room.now)
    room.run(2.0, standing(3.0))
    assert len(room.tracked) == 1
    room = Room(APART)
    room.run(2.0, standing(1.0), standing(6.0))
    room.manager.merge(*room.tracked, room.now)
    room.run(6.0, standing(1.0), standing(6.0))
    assert len(room.tracked) == 1


def test_who_is_parted_and_joined_again_by_a_user_is_placed_by_both_cameras_again():
    room = Room(OVERLAPPING)
    room.run(4.0, standing(3.0))
    (person,) = room.tracked
    sure = np.trace(room.manager.place(person).covariance)
    room.manager.split(person, room.now)
    first, second = room.run(3.0, standing(3.0))
    assert np.trace(room.manager.place(first).covariance) > 2.0 * sure, "each is where one camera sees it"
    (person, _) = room.manager.merge(first, second, room.now)
    room.run(4.0, standing(3.0))
    assert np.trace(room.manager.place(person).covariance) < 1.2 * sure


def test_who_is_seen_by_one_of_several_cameras_is_where_that_one_says():
    room = Room(APART)
    first, _ = room.run(2.0, standing(1.0), standing(6.0))
    position, stamp = np.array([1.2, 0.1, 1.6]), room.now + 0.05
    room.manager.on_place(PlaceSource.FACE, room.face("left", 0), Place(
        "map", Pose(np.eye(3), position), stamp, origin=room._origin("left")), stamp, "left")
    assert room.manager.place(first).pose.translation == pytest.approx(position)


def test_whose_distance_several_cameras_have_told_is_at_it_where_one_sees_on():
    room = Room(OVERLAPPING, farther={"right": 1.15})
    room.run(6.0, standing(3.0))
    (person,) = room.run(4.0, walking(3.0, 0.7, since=room.now, stop=5.0))
    assert room.manager.place(person).pose.translation[1] == pytest.approx(0.0, abs=0.2), "not 0.45 m off"


def test_three_cameras():
    room = Room({"a": (0.0, 4.0, 0.0), "b": (1.0, 5.0, 0.1), "c": (2.0, 6.0, -0.1)}, 0.05)
    room.run(5.0, standing(3.0), standing(3.0, 1.2))
    assert len(room.tracked) == 2
    owners = [{room.manager.person_of(MatchNode(Kind.FACE, room.face(camera, person))) for camera in room.views}
              for person in (0, 1)]
    assert [len(found) for found in owners] == [1, 1]


@pytest.mark.parametrize("number", [0, 1, 2])
def test_whom_a_user_parts_from_two_others_leaves_these_one(number):
    room = Room({"a": (0.0, 4.0, 0.0), "b": (1.0, 5.0, 0.1), "c": (2.0, 6.0, -0.1)})
    room.run(5.0, standing(3.0))
    seen = sorted(state.id for state in room.manager.snapshot(room.now).persons)
    assert len(seen) == 3 and len(room.tracked) == 1
    room.manager.split(seen[number], room.now)
    room.ids.clear()
    room.run(4.0, standing(3.0))
    assert {len(ids) for ids in room.ids} == {2} and seen[number] in room.tracked


def test_nothing_happens_with_one_camera_without_reference_frame_or_when_switched_off():
    for room in (Room({"left": (0.0, 6.0, 0.0)}), Room(OVERLAPPING, frame="left"),
                 Room(OVERLAPPING, cross_camera=False)):
        room.run(5.0, standing(3.0))
        assert len(room.tracked) == len(room.views)
        assert room.manager.merges == ()


def test_the_ids_of_a_union_survive_a_restart():
    room = Room(APART)
    way = walking(1.0, 1.0, since=1.0)
    first = room.run(1.5, way)
    room.run(6.0, way)
    assert list(room.manager.anonymous()) == list(first)


@pytest.mark.parametrize("before, after", [(0.3, 6.0), (4.0, 6.0)])
def test_one_wrong_stamp_of_the_future_ends_nothing(before, after):
    """As of the first image of a camera whose driver takes another clock."""
    room = Room(OVERLAPPING)
    room.run(before, standing(3.0))
    room.manager.on_place(PlaceSource.FACE, room.face("left", 0), Place(
        "map", Pose(np.eye(3), np.array([3.0, 0.0, 1.6])), room.now + 1000.0, origin=room._origin("left")), room.now,
        "left")
    assert len(room.run(after, standing(3.0))) == 1
    assert len(room.run(6.0, standing(2.5), standing(3.5))) == 2


def test_a_wrong_stamp_of_the_future_ends_nothing_where_only_something_else_is_seen_afterwards():
    """Somebody whose body was placed by the wrong image shows the camera only the face from then on."""
    room = Room(OVERLAPPING)
    room.run(1.0, standing(3.0))
    room.manager.on_tracked(Kind.BODY, ["b1"], room.now)
    room.manager.on_place(PlaceSource.HEAD, "b1", Place(
        "map", Pose(np.eye(3), np.array([3.0, 0.0, 1.6])), room.now + 1000.0, origin=room._origin("left")), room.now,
        "left")
    room.manager.on_tracked(Kind.BODY, [], room.now)
    assert len(room.run(6.0, standing(3.0))) == 1
    assert len(room.run(6.0, standing(2.5), standing(3.5))) == 2


def test_what_is_kept_is_bounded():
    room = Room(OVERLAPPING, half_life=0.1)
    for _ in range(12):
        start = room.now
        room.run(4.0, walking(1.5, 1.0, since=start))
        room.run(8.0, lambda time: None)
    groups = room.manager._cameras._groups
    assert not groups.tracks and not groups.view_of and len(groups.all) <= 2 and len(groups.near) <= 2
    assert sum(map(len, groups.two.values())) <= 4 and len(room.manager.merges) <= 2


F1, F2, B1, B2 = (MatchNode(kind, name) for kind, name in (
    (Kind.FACE, "f1"), (Kind.FACE, "f2"), (Kind.BODY, "b1"), (Kind.BODY, "b2")))


def sensed(groups, *features):
    """Group the features, all of which one camera sees; returns the numbers of the groups, by feature."""
    groups.regroup([SensedGroup(frozenset(group), "") for group in features])
    seen = {feature for group in features for feature in group}
    assert set(groups.tracks) == set(groups.view_of) == seen
    assert {frozenset(view.tracks) for view in groups.views()} == set(map(frozenset, features))
    assert all(groups.view_of[feature] is view for view in groups.views() for feature in view.tracks)
    assert {groups.group_of[view.number] for view in groups.views()} == set(groups.all.values())
    return {feature: groups.group_of[groups.view_of[feature].number].number for feature in seen}


def test_a_view_goes_on_as_long_as_one_of_its_features_does():
    groups = ViewGroups()
    for feature in (F1, F2, B1, B2):
        groups.track(feature, "left")
    apart = sensed(groups, [F1], [F2], [B1], [B2])
    joined = sensed(groups, [F1, B1], [F2, B2])
    assert len(set(apart.values())) == 4 and joined == {
        F1: apart[F1], B1: apart[F1], F2: apart[F2], B2: apart[F2]}
    assert sensed(groups, [F1, B2], [F2, B1]) == {F1: joined[F1], B2: joined[F1], F2: joined[F2], B1: joined[F2]}
    parted = sensed(groups, [F1, B1], [F2], [B2])
    assert parted == {F1: joined[F1], B1: joined[F1], F2: joined[F2], B2: parted[B2]}
    assert parted[B2] not in joined.values()
    assert sensed(groups, [F2, B2]) == {F2: joined[F2], B2: joined[F2]}, "the older one, as they are one"


def test_cameras_and_names_are_bounded():
    groups, faces = ViewGroups(), [MatchNode(Kind.FACE, "f%d" % number) for number in range(MAX_SENSORS + 1)]
    tracks = [groups.track(feature, feature.id) for feature in faces]
    assert None not in tracks[:-1] and tracks[-1] is None
    assert groups.track(faces[0], "f0") is tracks[0] is not groups.track(faces[0], "f1")
    cameras = CrossCamera(0.5, 1.0, 3.0)
    for feature in faces:
        cameras.add_place(feature, 0, feature.id, np.array([1.0, 0.0, 1.6]), np.eye(3), None, 1.0)
    assert cameras.fused(faces[-1], 1.0) is None, "one camera too many is left out"
    for number in range(MAX_NAMES + 5):
        for name in ("first", "p%d" % number):
            groups.note_namer(name, "eyes")
        view = View(number, "left")
        view.names = frozenset(["p%d" % number])
        groups.note_names([view])
    assert len(groups.namers) == len(groups.named_by) == MAX_NAMES
    assert "first" in groups.namers, "it is said again and again"


def place_of(track, x, stamp, source=PlaceSource.FACE):
    track.add(int(source), np.array([x, 0.0, 1.6]), np.eye(3), None, stamp)


def test_a_source_that_lags_does_not_begin_the_stretch_of_a_track_anew():
    track = SensorTrack("camera")
    for number in range(60):
        now = 10.0 + 0.05 * number
        place_of(track, now, now)
        place_of(track, now - 1.5, now - 1.5, PlaceSource.BODY)
    assert track.began == 10.0 and track.ended == now and track.at(now).velocity[0] == pytest.approx(1.0)
    assert track.at(now + 0.1).position[0] == pytest.approx(now + 0.1)
    place_of(track, 0.0, 2.0)           # time has jumped back
    assert track.began == track.ended == 2.0


def test_who_is_said_to_be_where_the_camera_is_ends_nothing():
    """A place at the optical centre has no ray: as a tool publishes that has frames of faces, and no poses."""
    manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}), map("a{}".format, itertools.count()).__next__)
    cameras = {"left": (np.zeros(3), "f1"), "right": (np.array([2.0, 0.0, 0.0]), "f2")}
    manager.on_tracked(Kind.FACE, ["f1", "f2"], 0.0)
    for stamp in np.arange(0.0, 4.0, 0.1):
        # The right camera sees both where the left one is, and then walks away.
        seen = np.array([0.0, 0.0, 0.0 if stamp < 2.0 else 2.0 * (stamp - 2.0)])
        for camera, (origin, face) in cameras.items():
            position = origin if camera == "left" else seen
            manager.on_place(PlaceSource.FACE, face, Place("map", Pose(np.eye(3), position), stamp, origin=origin),
                             stamp, camera)
        manager.tick(stamp)
    assert manager.snapshot(4.0).tracked
