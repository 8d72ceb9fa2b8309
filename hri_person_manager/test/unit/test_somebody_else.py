"""A body that goes on while another face takes over never makes one human of two whom a recogniser tells apart."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hri_person_manager.core.features import Kind, MatchNode, PlaceSource
from hri_person_manager.core.location import Place
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.view_groups import ViewGroups
from hri_pipeline.core.geometry import Pose

STEP_S = 0.1
ANN, BOB = MatchNode(Kind.PERSON, "ann"), MatchNode(Kind.PERSON, "bob")
HER, HIM, BODY = MatchNode(Kind.FACE, "f1"), MatchNode(Kind.FACE, "f2"), MatchNode(Kind.BODY, "b1")


class Picture:
    """What one camera sees, all at one place, or `apart` m from each other by the numbers in their ids."""

    def __init__(self, apart=0.0):
        self.apart = apart
        numbers = itertools.count(1)
        self.manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}), lambda: "a%04d" % next(numbers))
        self.now = 0.0

    def show(self, seconds, faces, bodies=("b1",)):
        for _ in range(int(round(seconds / STEP_S))):
            self.now += STEP_S
            self.manager.on_tracked(Kind.FACE, faces, self.now)
            self.manager.on_tracked(Kind.BODY, bodies, self.now)
            for source, ids, far in ((PlaceSource.FACE, faces, 1.0), (PlaceSource.HEAD, bodies, 1.05)):
                for feature in ids:
                    place = Place("map", Pose(np.eye(3), np.array([far, self.apart * int(feature[1]), 1.6])), self.now,
                                  origin=np.array([0.0, 0.0, 1.5]))
                    self.manager.on_place(source, feature, place, self.now, "camera")
            self.manager.tick(self.now)

    def say(self, first, second, likelihood=0.9, recogniser="/ours"):
        self.manager.on_match(CandidateMatch(first, second, likelihood), self.now, recogniser)

    @property
    def tracked(self):
        return set(self.manager.snapshot(self.now).tracked)

    def stands_for(self, person):
        return self.manager.representative(person)


@pytest.fixture
def picture():
    picture = Picture()
    picture.show(1.0, ["f1"])
    picture.say(HER, BODY)
    picture.say(HER, ANN)
    picture.show(2.0, ["f1"])
    assert picture.tracked == {"ann"}
    return picture


@pytest.mark.parametrize("order", ["recognised first", "matched first", "nobody in between"])
def test_another_face_on_a_body_that_goes_on_is_another_person(picture, order):
    if order == "nobody in between":
        picture.show(0.5, [])
    else:
        picture.show(0.3, ["f1", "f2"])
    first, second = ((HIM, BOB), (HIM, BODY)) if order == "recognised first" else ((HIM, BODY), (HIM, BOB))
    picture.show(0.3, ["f2"])
    picture.say(*first)
    picture.show(0.3, ["f2"])
    picture.say(*second)
    picture.show(3.0, ["f2"])
    assert picture.tracked == {"bob"}
    assert not picture.manager.merges
    picture.show(2.0, [], [])
    picture.show(0.5, ["f3"], [])
    picture.say(MatchNode(Kind.FACE, "f3"), ANN)
    picture.show(1.0, ["f3"], [])
    assert picture.tracked == {"ann"} and picture.stands_for("bob") == "bob"


def test_who_was_anonymous_in_between_joins_no_two_who_are_recognised(picture):
    picture.show(0.2, [])
    picture.show(2.0, ["f2"])
    picture.say(HIM, BODY)
    picture.show(1.0, ["f2"])
    picture.say(HIM, BOB)
    picture.show(3.0, ["f2"])
    assert picture.tracked == {"bob"}
    for _ in range(30):
        picture.show(0.1, [], [])
        assert picture.stands_for("bob") == "bob" and picture.stands_for("ann") == "ann", picture.manager.merges


def test_a_body_bears_the_name_of_the_last_face_only(picture):
    picture.show(0.3, [])
    picture.show(0.3, ["f2"])
    picture.say(HIM, BODY)
    picture.say(HIM, BOB)
    picture.show(2.0, ["f2"])
    for _ in range(15):
        picture.show(0.1, [])
        assert picture.tracked == {"bob"}
    for _ in range(30):
        picture.show(0.1, [], [])
        assert picture.stands_for("bob") == "bob" and picture.stands_for("ann") == "ann", picture.manager.merges


def test_a_body_found_again_joins_no_two_who_are_recognised(picture):
    """The body was somebody anonymous who is Ann; now it is Bob's."""
    picture.show(1.0, [], [])
    picture.show(2.5, [], ["b2"])       # where Ann was: it waits to be recognised
    anonymous, = picture.tracked
    picture.say(MatchNode(Kind.PERSON, anonymous), ANN)
    picture.show(0.5, [], ["b2"])
    picture.show(0.5, ["f2"], ["b3", "b2"])
    picture.say(HIM, BOB)
    picture.say(HIM, MatchNode(Kind.BODY, "b3"))
    picture.show(0.5, ["f2"], ["b3", "b2"])
    picture.say(MatchNode(Kind.BODY, "b3"), MatchNode(Kind.PERSON, anonymous))
    picture.show(1.0, ["f2"], ["b3", "b2"])
    assert picture.stands_for("bob") == "bob" and picture.stands_for("ann") == "ann"


def test_a_stranger_on_a_body_that_goes_on_loses_the_name(picture):
    """The recogniser knows only that it is not Ann."""
    picture.show(0.3, [])
    picture.show(0.3, ["f2"])
    picture.say(HIM, BODY)
    picture.show(1.5, ["f2"])
    picture.say(HIM, ANN, 0.0)
    picture.show(1.5, ["f2"])
    for _ in range(30):
        picture.show(0.1, ["f2"])
        assert picture.tracked and "ann" not in picture.tracked
    assert not picture.manager.merges


def test_links_join_no_two_who_were_told_apart_over_somebody_between():
    groups = ViewGroups()
    links = [frozenset(pair) for pair in (("ann", "x"), ("x", "bob"), ("bob", "y"), ("y", "z"), ("bob", "z"))]
    assert list(groups.without_strangers(links)) == links
    groups.strangers[frozenset(("ann", "bob"))] = None
    assert list(groups.without_strangers(links)) == [links[0], *links[2:]]


CARL, HERS = MatchNode(Kind.PERSON, "carl"), MatchNode(Kind.PERSON, "own_ann")


@pytest.mark.parametrize("withdrawn", ["before", "after", "never"])
def test_a_recogniser_that_changes_its_mind_makes_no_two_persons_one(withdrawn):
    """Other recognisers than ours do not withdraw a name when they say another one."""
    picture = Picture()
    picture.show(1.0, ["f1"], [])
    picture.say(HER, ANN, 0.9)
    picture.show(2.0, ["f1"], [])
    if withdrawn == "before":
        picture.say(HER, ANN, 0.0)
    picture.say(HER, BOB, 0.95)
    if withdrawn == "after":
        picture.say(HER, ANN, 0.0)
    picture.show(2.0, ["f1"], [])
    assert picture.tracked == {"bob"} and not picture.manager.merges
    assert picture.stands_for("bob") == "bob" and picture.stands_for("ann") == "ann"


def both_say(picture, face, own, other):
    """Our recogniser knows who it is, then another one says what it calls that person."""
    picture.show(1.0, [face.id], [])
    picture.say(face, own, 0.9)
    picture.show(1.0, [face.id], [])
    picture.say(face, other, 0.95, "/theirs")
    picture.show(1.0, [face.id], [])


def test_what_two_recognisers_call_somebody_is_one_person():
    picture = Picture()
    both_say(picture, HER, ANN, HERS)
    assert len(picture.tracked) == 1 and picture.stands_for("ann") == picture.stands_for("own_ann")
    picture.show(2.0, [], [])
    picture.show(1.0, ["f3"], [])
    picture.say(MatchNode(Kind.FACE, "f3"), HERS, 0.9, "/theirs")
    picture.show(1.0, ["f3"], [])
    assert picture.tracked == {picture.stands_for("ann")}


@pytest.mark.parametrize("mended", ["withdrawn", "another name"])
def test_an_error_of_another_recogniser_joins_two_only_until_it_is_mended(mended):
    picture = Picture()
    picture.show(1.0, ["f1"], [])
    picture.say(HER, HERS, 0.95, "/theirs")
    picture.show(1.0, ["f1"], [])
    picture.show(2.0, [], [])
    both_say(picture, HIM, BOB, HERS)
    if mended == "withdrawn":
        picture.say(HIM, HERS, 0.0, "/theirs")
    else:
        picture.say(HIM, CARL, 0.97, "/theirs")
    picture.show(2.5, ["f2"], [])
    assert picture.stands_for("bob") != picture.stands_for("own_ann") == "own_ann"
    assert "own_ann" not in picture.tracked and len(picture.tracked) == 1


@pytest.mark.parametrize("likelihood", [0.8, 0.95])
def test_a_name_from_before_a_restart_yields_to_what_a_recogniser_says(likelihood):
    picture = Picture()
    picture.manager.recall({"ann": [HER]}, picture.now)
    picture.show(1.0, ["f1"], [])
    assert picture.tracked == {"ann"}
    picture.say(HER, BOB, likelihood)
    picture.show(2.0, ["f1"], [])
    assert picture.tracked == {"bob"} and not picture.manager.merges


def test_a_name_from_before_a_restart_yields_to_one_that_counts_since_the_threshold_is_lower():
    picture = Picture()
    picture.manager.recall({"ann": [HER]}, picture.now)
    picture.show(1.0, ["f1"], [])
    picture.say(HER, BOB, 0.4)
    picture.manager.reconfigure(PERSON_MANAGER_PARAMETERS.resolve({"match_threshold": 0.3}), picture.now)
    assert picture.tracked == {"ann"}
    picture.say(HER, BOB, 0.4)
    assert picture.tracked == {"bob"}


def test_a_name_from_before_a_restart_stays_when_the_recogniser_says_it_again():
    picture = Picture()
    picture.manager.recall({"ann": [HER]}, picture.now)
    picture.show(1.0, ["f1"], [])
    picture.say(HER, ANN, 0.8)
    picture.say(HER, BOB, 0.6)
    picture.show(2.0, ["f1"], [])
    assert picture.tracked == {"ann"}


@pytest.mark.parametrize("first", ["f1", "f2"])
@pytest.mark.parametrize("both", [True, False])
def test_two_whose_bodies_were_taken_for_each_others_stay_two_when_that_is_mended(first, both):
    picture, other = Picture(apart=1.5), MatchNode(Kind.BODY, "b2")
    picture.show(0.5, [first], [])
    picture.show(0.5, ["f1", "f2"], ["b1", "b2"])
    wrong = (HER, other), (HIM, BODY)
    for pair in wrong:
        picture.say(*pair)
    picture.show(3.0, ["f1", "f2"], ["b1", "b2"])
    before = picture.tracked
    for pair in wrong:
        picture.say(*pair, 0.0)
    for pair in ((HER, BODY), (HIM, other))[:1 + both]:
        picture.say(*pair)
    picture.show(5.0, ["f1", "f2"], ["b1", "b2"])
    assert len(before) == 2 and before <= picture.tracked and not picture.manager.merges
    of_faces, of_bodies = (list(map(picture.manager.person_of, nodes)) for nodes in ((HER, HIM), (BODY, other)))
    assert of_faces[0] == of_bodies[0] != of_faces[1] and (of_faces == of_bodies) == both


def test_a_match_that_was_wrong_for_a_moment_swaps_no_two_anonymous_persons():
    numbers = itertools.count(1)
    manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}), lambda: "a%04d" % next(numbers))
    bodies, face, voice = [MatchNode(Kind.BODY, "b1"), MatchNode(Kind.BODY, "b2")], HER, MatchNode(Kind.VOICE, "v1")

    def wait(start, seconds):
        for number in range(int(round(seconds / STEP_S))):
            manager.tick(start + STEP_S * (number + 1))
    manager.on_tracked(Kind.BODY, ["b1", "b2"], 0.0)
    wait(0.0, 30.0)
    before = [manager.person_of(body) for body in bodies]
    manager.on_tracked(Kind.FACE, [face.id], 30.0)
    manager.on_tracked(Kind.VOICE, [voice.id], 30.0)
    wrong, right = ((face, bodies[number], likelihood) for number, likelihood in ((0, 0.95), (1, 0.9)))
    for match in (wrong, (voice, face, 0.8), right):
        manager.on_match(CandidateMatch(*match), 30.1)
    wait(30.1, 1.0)
    assert manager.person_of(face) == before[0]
    manager.on_match(CandidateMatch(*wrong[:2], 0.0), 31.2)
    wait(31.2, 5.0)
    assert [manager.person_of(body) for body in bodies] == before
    assert manager.person_of(face) == manager.person_of(voice) == before[1]
