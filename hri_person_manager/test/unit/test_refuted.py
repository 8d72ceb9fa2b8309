"""What the person manager hears of who is *not* one: it ends wrong unions, and only those."""

from __future__ import annotations

import itertools

import pytest

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS

ANN = MatchNode(Kind.PERSON, "ann")
FACE, BODY = MatchNode(Kind.FACE, "f1"), MatchNode(Kind.BODY, "b1")


class World:
    def __init__(self, faces=("f1",), bodies=("b1",)):
        numbers = itertools.count(1)
        self.manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}), lambda: "a%04d" % next(numbers))
        self.now = 0.0
        self.show(faces, bodies)

    def show(self, faces, bodies):
        self.manager.on_tracked(Kind.FACE, faces, self.now)
        self.manager.on_tracked(Kind.BODY, bodies, self.now)

    def say(self, first, second, likelihood):
        self.manager.on_match(CandidateMatch(first, second, likelihood), self.now)

    def run(self, seconds):
        for _ in range(int(round(10 * seconds))):
            self.now += 0.1
            self.manager.tick(self.now)
        return self.manager.person_of(FACE), self.manager.person_of(BODY)


def union():
    """The face is ann's, and so, says somebody, is the body."""
    world = World()
    world.say(FACE, ANN, 0.9)
    world.say(BODY, ANN, 0.6)
    assert world.run(1.0) == ("ann", "ann")
    return world


def test_a_face_and_a_body_that_are_two_part_what_a_name_has_joined():
    world = union()
    world.say(FACE, BODY, 0.0)
    face, body = world.run(2.0)
    assert face == "ann" and body.startswith("anonymous_person_")


def test_who_is_told_again_and_again_to_be_two_is_so_after_a_second():
    world = union()
    for _ in range(15):
        world.say(FACE, BODY, 0.0)
        face, body = world.run(0.1)
    assert face == "ann" != body


def test_nobody_parts_before_a_second_is_over_whatever_else_is_told():
    world = union()
    world.say(FACE, BODY, 0.0)
    world.run(0.3)
    world.say(MatchNode(Kind.VOICE, "v1"), FACE, 0.9)
    assert world.run(0.3) == ("ann", "ann")


@pytest.mark.parametrize("first, for_s, then, within_s", [
    pytest.param(0.8, 0.5, 0.2, 3.0, id="who fit no longer so well are not told to be two"),
    pytest.param(0.0, 2.0, 0.8, 0.2, id="a match that counts again joins them again")])
def test_a_face_and_a_body_are_one_again_or_still(first, for_s, then, within_s):
    world = union()
    world.say(FACE, BODY, first)
    world.run(for_s)
    world.say(FACE, BODY, then)
    assert world.run(within_s) == ("ann", "ann")


def test_what_is_told_of_a_body_that_is_not_there_yet_does_not_part_it_later():
    world = World(bodies=())
    world.say(FACE, ANN, 0.9)
    world.say(FACE, BODY, 0.0)
    world.run(2.0)
    world.show(("f1", ), ("b1", ))
    world.say(BODY, ANN, 0.6)
    assert world.run(3.0) == ("ann", "ann")


def test_the_weaker_link_ends():
    world = World()
    world.say(FACE, ANN, 0.6)
    world.say(BODY, ANN, 0.9)
    world.run(1.0)
    world.say(FACE, BODY, 0.0)
    face, body = world.run(2.0)
    assert body == "ann" and face.startswith("anonymous_person_")


def test_a_withdrawal_just_before_the_face_leaves_parts_nobody():
    world = union()
    world.say(FACE, BODY, 0.0)
    world.run(0.3)
    world.show((), ("b1",))
    assert world.run(3.0)[1] == "ann"


@pytest.mark.parametrize("doubt", [0.0, 0.2])
def test_a_recogniser_that_doubts_ends_a_name_that_a_body_has_kept(doubt):
    world = World()
    world.say(FACE, BODY, 0.8)
    world.say(FACE, ANN, 0.9)
    world.run(1.0)
    world.say(BODY, ANN, 0.7)           # who knows bodies again by their clothes
    assert world.run(0.5) == ("ann", "ann")
    world.say(FACE, ANN, doubt)
    face, body = world.run(2.0)
    assert face == body and face.startswith("anonymous_person_")


def test_a_low_match_that_was_never_higher_is_no_doubt():
    world = World()
    world.say(FACE, BODY, 0.8)
    world.say(BODY, ANN, 0.7)
    world.say(FACE, ANN, 0.3)
    assert world.run(3.0) == ("ann", "ann")


def test_a_name_is_not_inherited_past_a_doubt():
    world = World(("f1", "f2"), ("b1",))
    world.say(FACE, BODY, 0.8)
    world.say(FACE, ANN, 0.9)
    world.run(1.0)
    world.say(BODY, ANN, 0.0)
    world.run(1.5)
    world.show(("f2",), ("b1",))
    assert world.run(1.0)[1] != "ann"


def test_a_face_that_is_told_not_to_be_somebody_gets_the_name_of_no_body_meanwhile():
    world = World(("f1", "f2"), ("b1",))
    world.say(FACE, BODY, 0.8)
    world.say(FACE, ANN, 0.9)
    world.run(1.0)
    other = MatchNode(Kind.FACE, "f2")
    world.say(other, ANN, 0.0)
    world.run(0.2)
    world.show(("f2",), ("b1",))
    world.say(other, BODY, 0.8)
    assert world.manager.person_of(other) == world.manager.person_of(BODY) != "ann"
    world.say(other, ANN, 0.9)
    assert world.manager.person_of(other) == world.manager.person_of(BODY) == "ann"


def test_somebody_else_on_a_body_gets_no_id_that_stands_for_the_one_before():
    world = World(("f1", "f2"), ("b1",))
    world.say(FACE, BODY, 0.8)
    before = world.run(1.0)[0]
    world.say(FACE, ANN, 0.9)
    world.run(1.0)
    world.show(("f2",), ("b1",))
    other = MatchNode(Kind.FACE, "f2")
    world.say(other, BODY, 0.8)
    world.say(other, ANN, 0.0)
    world.run(2.0)
    persons = {state.id: state for state in world.manager.snapshot(world.now).persons}
    assert persons[before].alias == "ann"
    assert world.manager.person_of(other) == world.manager.person_of(BODY) not in (None, before, "ann")


def test_a_name_that_is_taken_back_gives_the_id_before_it_back():
    world = World()
    world.say(FACE, BODY, 0.8)
    before = world.run(1.0)[0]
    world.say(FACE, ANN, 0.9)
    world.run(1.0)
    world.say(FACE, ANN, 0.0)
    assert world.run(2.0) == (before, before)
