"""Who waits for matches, names and places before becoming somebody new, and for how long."""

import numpy as np
import pytest

from hri_person_manager.core.features import Kind, MatchNode, PlaceSource
from hri_person_manager.core.location import Decay, FeaturePlaces, PersonLocation, Place
from hri_person_manager.core.persons import PersonEntry
from hri_person_manager.core.waiting import (
    MATCH_WAIT_S,
    PARTED_WAIT_S,
    PLACE_WAIT_S,
    RETURN_WAIT_S,
    waiting_for_matches,
    waiting_for_names,
    waiting_for_places,
)
from hri_pipeline.core.geometry import Pose

FACE, BODY = MatchNode(Kind.FACE, "f"), MatchNode(Kind.BODY, "b")
ANN = MatchNode(Kind.PERSON, "ann")
DECAY = Decay("exponential", 5.0, 0.05)
SOURCES = {Kind.FACE: PlaceSource.FACE, Kind.BODY: PlaceSource.HEAD}


def place(x, stamp=10.0):
    return Place("camera", Pose(np.eye(3), np.array([x, 0.0, 2.0])), stamp, covariance=np.diag([0.01, 0.01, 0.01]))


def places(stamp=10.0, **where):
    """Where the features f, b and others are: x in m, at `stamp` (s)."""
    found = FeaturePlaces()
    for name, x in where.items():
        node = MatchNode(Kind.FACE if name.startswith("f") else Kind.BODY, name)
        found.add(node, SOURCES[node.kind], place(x, stamp), stamp, "camera")
    return found


def matches(new, groups, where, now=10.0, refuted=()):
    return waiting_for_matches(new, [frozenset(group) for group in groups], where,
                               lambda face, body: (face, body) in refuted, now)


def test_a_body_at_the_place_of_a_face_waits_for_their_match():
    apart = [[FACE, ANN], [BODY]]
    assert matches({BODY: 10.0}, apart, places(f=0.0, b=0.1)) == {BODY}
    assert matches({FACE: 10.0}, [[FACE], [BODY, ANN]], places(f=0.0, b=0.1)) == {FACE}
    assert matches({BODY: 10.0}, apart, places(f=0.0, b=1.5)) == set()
    assert matches({BODY: 10.0}, apart, places(f=0.0, b=0.1), refuted=[(FACE, BODY)]) == set()
    assert matches({}, apart, places(f=0.0, b=0.1)) == set()


@pytest.mark.parametrize("age, wanted", [(0.0, {BODY}), (MATCH_WAIT_S - 0.01, {BODY}), (MATCH_WAIT_S + 20.0, set())])
def test_no_longer_than_a_match_takes(age, wanted):
    assert matches({BODY: 10.0}, [[FACE, ANN], [BODY]], places(f=0.0, b=0.1), now=10.0 + age) == wanted


@pytest.mark.parametrize("age, waits", [(0.0, True), (PARTED_WAIT_S - 0.01, True), (PARTED_WAIT_S + 0.01, False)])
def test_a_body_whose_face_has_got_another_one_waits_a_moment(age, waits):
    """Of two women side by side the network made one body; when the right one came, it was a fourth person for 2 s."""
    right, where = MatchNode(Kind.BODY, "b2"), places(f=0.0, b=0.4, b2=0.0)
    now, parted = 10.0 + age, [(FACE, BODY)]
    assert matches({BODY: 10.0}, [[FACE, right, ANN], [BODY]], where, now, parted) == ({BODY} if waits else set())
    assert matches({BODY: 10.0}, [[FACE, right, ANN], [BODY]], where, now) == set(), "never said to be one"
    assert matches({BODY: 10.0}, [[FACE, ANN], [BODY]], where, now, parted) == set(), "its face has no other body"


def test_of_two_that_are_new_the_face_goes_first():
    assert matches({FACE: 10.0, BODY: 10.0}, [[FACE], [BODY]], places(f=0.0, b=0.1)) == {BODY}


def test_a_face_that_has_a_body_keeps_no_other_one_waiting():
    other = MatchNode(Kind.BODY, "b2")
    assert matches({BODY: 10.0}, [[FACE, other], [BODY]], places(f=0.0, b=0.1, b2=0.0)) == set()


def test_the_old_id_of_a_body_that_has_begun_anew_is_nobody_else():
    where = places(8.0, b=0.0)
    where.add(MatchNode(Kind.BODY, "b2"), PlaceSource.HEAD, place(0.0, 10.0), 10.0, "camera")
    groups = [[BODY], [MatchNode(Kind.BODY, "b2"), ANN]]
    assert matches({BODY: 0.0}, groups, where, now=60.0) == {BODY}
    for name, stamp in (("f", 8.0), ("f2", 10.0)):
        where.add(MatchNode(Kind.FACE, name), PlaceSource.FACE, place(0.0, stamp), stamp, "camera")
    groups = [[FACE], [BODY], [MatchNode(Kind.BODY, "b2"), MatchNode(Kind.FACE, "f2")]]
    assert matches({FACE: 10.0}, groups, where) == set(), "nor the body of a new face; and faces are not outdated"


def test_a_face_and_a_body_that_are_known_as_two_keep_a_new_body_waiting_for_the_face():
    new = MatchNode(Kind.BODY, "b2")
    groups = [[FACE, ANN], [BODY, MatchNode(Kind.PERSON, "bob")], [new]]
    assert matches({new: 10.0}, groups, places(f=0.0, b=0.0, b2=0.1)) == {new}


def test_who_has_no_place_yet_waits_beside_a_half_that_has_one():
    where, faces, bodies = places(f=0.0), [FACE], [BODY]
    assert waiting_for_places({BODY}, faces, bodies, where) == {BODY}
    assert waiting_for_places(set(), faces, bodies, where) == set()
    assert waiting_for_places({BODY}, [], bodies, where) == set()
    assert waiting_for_places({BODY}, faces, bodies, places(f=0.0, b=9.0)) == set()
    groups = [[FACE, ANN], [BODY]]
    assert matches({BODY: 10.0}, groups, where, now=10.0 + PLACE_WAIT_S) == {BODY}
    assert matches({BODY: 10.0}, groups, where, now=10.1 + PLACE_WAIT_S) == set()


def lost(x, anonymous, *features):
    person = PersonEntry("ann", 1, anonymous, PersonLocation(0.5), dict.fromkeys(features, 0.0))
    person.location.offer(PlaceSource.FACE, place(x, 8.0), 8.0)
    return person


@pytest.mark.parametrize("node, person, age, wanted", [
    (FACE, lost(0.2, False), 0.0, True),
    (FACE, lost(0.2, False), RETURN_WAIT_S, True),
    (FACE, lost(0.2, False), RETURN_WAIT_S + 0.1, False),
    (FACE, lost(3.0, False), 0.0, False),                       # elsewhere
    (FACE, lost(0.2, True), 0.0, False),                        # no recogniser knows an anonymous face
    (BODY, lost(0.2, True), 0.0, True),                         # clothes are known
    (FACE, lost(0.2, False, MatchNode(Kind.BODY, "b2")), 0.0, False),      # not lost
    (FACE, lost(0.2, False, MatchNode(Kind.VOICE, "v")), 0.0, True),       # heard only
    (FACE, PersonEntry("ann", 1, False, PersonLocation(0.5)), 0.0, False)])    # never placed
def test_who_appears_where_somebody_was_lost_waits_for_a_name(node, person, age, wanted):
    found = waiting_for_names({node: 10.0}, [person], places(f=0.0, b=0.0), DECAY, 10.0 + age)
    assert found == ({node} if wanted else set())


def test_where_somebody_was_long_ago_nobody_waits():
    assert waiting_for_names({FACE: 100.0}, [lost(0.2, False)], places(100.0, f=0.0), DECAY, 100.0) == set()
