"""The whole manager: Table I of the paper row by row, the rules of the person frame, merging, bounds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.location import Place, Source
from hri_person_manager.core.manager import MAX_UNSEEN_PERSONS, PersonManager
from hri_person_manager.core.manager_parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.match_guard import Match
from hri_pipeline.core.geometry import Pose


def make(**given):
    numbers = itertools.count(1)
    return PersonManager(PERSON_MANAGER_PARAMETERS.resolve(given), new_id=lambda: "a%04d" % next(numbers))


def place(x, stamp):
    return Place("map", Pose(np.eye(3), np.array([x, 0.0, 0.0])), stamp)


def match(manager, first, second, likelihood, now):
    kinds = {"f": Kind.FACE, "b": Kind.BODY, "v": Kind.VOICE, "p": Kind.PERSON}
    nodes = [Node(kinds[text[0]], text[2:]) for text in (first, second)]
    return manager.on_match(Match(nodes[0], nodes[1], likelihood), now)


def people(manager, now):
    """Return {id: (face, body, voice, confidence)} of all persons but aliases."""
    return {state.id: (state.face, state.body, state.voice, state.confidence)
            for state in manager.snapshot(now).persons if not state.alias}


A1, A2 = "anonymous_person_a0001", "anonymous_person_a0002"


# -- Table I, one test per row. Its ids such as 24ac start with a digit; ours have to start with a letter.

def test_row_1_a_face_alone_has_no_person_until_the_delay_is_over():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f24ac"], 0.0)
    manager.tick(0.4)
    assert people(manager, 0.4) == {}
    manager.tick(0.5)
    assert people(manager, 0.5) == {A1: ("f24ac", "", "", 0.0)}


def test_row_1_strictly_no_person_before_identification():
    manager = make(anonymous_persons=False)
    manager.on_tracked(Kind.FACE, ["f24ac"], 0.0)
    manager.tick(100.0)
    assert people(manager, 100.0) == {}
    assert manager.on_place(Source.FACE, "f24ac", place(1.0, 100.0), 100.0) is None
    assert manager.groups == (frozenset([Node(Kind.FACE, "f24ac")]),)


def test_row_2_a_redetected_face_is_a_new_face():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f24ac"], 0.0)
    manager.on_tracked(Kind.FACE, [], 1.0)
    manager.on_tracked(Kind.FACE, ["d73b"], 2.0)
    assert manager.snapshot(2.0).tracked == (A2,)


def test_row_3_a_body_alone():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.BODY, ["b37ef"], 0.0)
    assert people(manager, 0.0) == {A1: ("", "b37ef", "", 0.0)}


def test_row_4_a_face_and_a_body_associated_without_a_person():
    manager = make(anonymous_persons=False)
    manager.on_tracked(Kind.FACE, ["d73b"], 0.0)
    manager.on_tracked(Kind.BODY, ["b37ef"], 0.0)
    assert match(manager, "f:d73b", "b:b37ef", 0.8, 0.1)
    assert manager.groups == (frozenset([Node(Kind.FACE, "d73b"), Node(Kind.BODY, "b37ef")]),)
    assert people(manager, 1.0) == {}


def test_row_5_a_known_person_without_any_feature():
    manager = make()
    manager.on_tracked(Kind.FACE, ["d73b"], 0.0)
    match(manager, "f:d73b", "p:p9d8a", 0.9, 0.1)
    manager.on_tracked(Kind.FACE, [], 1.0)
    manager.tick(1.0)
    snapshot = manager.snapshot(1.0)
    assert snapshot.tracked == () and snapshot.known == ("p9d8a",)
    assert people(manager, 1.0) == {"p9d8a": ("", "", "", 0.0)}


def test_row_6_a_recognised_face():
    manager = make()
    manager.on_tracked(Kind.FACE, ["d73b"], 0.0)
    match(manager, "f:d73b", "p:p9d8a", 0.9, 0.1)
    state = manager.snapshot(0.1).persons[0]
    assert (state.id, state.face, state.anonymous) == ("p9d8a", "d73b", False)


def test_row_7_another_face_of_the_same_person():
    manager = make()
    manager.on_tracked(Kind.FACE, ["d73b"], 0.0)
    match(manager, "f:d73b", "p:p9d8a", 0.9, 0.1)
    manager.on_tracked(Kind.FACE, ["f96f1"], 1.0)
    match(manager, "f:f96f1", "p:p9d8a", 0.9, 1.1)
    manager.tick(5.0)
    assert people(manager, 5.0) == {"p9d8a": ("f96f1", "", "", 0.0)}


def test_row_8_a_fully_tracked_person():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f96f1"], 0.0)
    manager.on_tracked(Kind.BODY, ["b37ef"], 0.0)
    match(manager, "f:f96f1", "p:p9d8a", 0.9, 0.1)
    match(manager, "f:f96f1", "b:b37ef", 0.9, 0.1)
    assert people(manager, 0.1) == {"p9d8a": ("f96f1", "b37ef", "", 0.0)}


def test_row_9_a_voice_and_a_person():
    manager = make()
    manager.on_tracked(Kind.VOICE, ["ab7f"], 0.0)
    match(manager, "v:ab7f", "p:baf0", 0.9, 0.1)
    assert people(manager, 0.1) == {"baf0": ("", "", "ab7f", 0.0)}


def test_row_10_nothing_at_all_is_no_person():
    manager = make(new_person_delay=0.0)
    for kind in (Kind.FACE, Kind.BODY, Kind.VOICE):
        manager.on_tracked(kind, [], 0.0)
    manager.tick(10.0)
    assert manager.snapshot(10.0).persons == () and manager.groups == ()


# -- the four rules of the person frame

def test_rule_1_no_frame_without_a_person():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    assert manager.on_place(Source.FACE, "f1", place(1.0, 0.1), 0.1) is None
    assert manager.silent(0.2) == []


def test_rule_2_face_then_body_then_voice():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    manager.on_tracked(Kind.VOICE, ["v1"], 0.0)
    match(manager, "f:f1", "b:b1", 0.9, 0.0)
    match(manager, "v:v1", "b:b1", 0.9, 0.0)
    ident = manager.snapshot(0.0).tracked[0]
    assert manager.on_place(Source.VOICE, "v1", place(4.0, 1.0), 1.0) == ident
    assert manager.on_place(Source.BODY, "b1", place(3.0, 1.0), 1.0) == ident
    assert manager.on_place(Source.HEAD, "b1", place(2.0, 1.0), 1.0) == ident
    assert manager.on_place(Source.FACE, "f1", place(1.0, 1.0), 1.0) == ident
    assert manager.on_place(Source.HEAD, "b1", place(2.0, 1.1), 1.1) is None
    assert people(manager, 1.1)[ident][3] == 1.0
    manager.on_tracked(Kind.FACE, [], 1.2)
    assert manager.on_place(Source.HEAD, "b1", place(2.0, 1.2), 1.2) == ident
    assert people(manager, 1.2)[ident][3] == 1.0


def test_rule_3_the_frame_stays_and_the_confidence_decays_to_zero():
    manager = make(new_person_delay=0.0, half_life=2.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_place(Source.FACE, "f1", place(1.5, 1.0), 1.0)
    assert manager.silent(1.1) == []
    manager.on_tracked(Kind.FACE, [], 1.0)
    assert 0.9 < people(manager, 1.0)[A1][3] < 1.0
    assert people(manager, 3.0)[A1][3] == pytest.approx(0.5)
    (ident, where), = manager.silent(3.0)
    assert ident == A1 and where.pose.translation[0] == 1.5
    manager.tick(20.0)
    assert manager.silent(20.0) == [] and people(manager, 20.0) == {}


def test_rule_3_a_permanent_person_stays_known_when_the_place_is_forgotten():
    manager = make(half_life=2.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    match(manager, "f:f1", "p:ann", 1.0, 0.0)
    manager.on_place(Source.FACE, "f1", place(1.5, 1.0), 1.0)
    manager.on_tracked(Kind.FACE, [], 1.0)
    manager.tick(20.0)
    assert people(manager, 20.0) == {"ann": ("", "", "", 0.0)}
    assert manager.snapshot(20.0).known == ("ann",)


def test_rule_4_a_voice_without_a_direction_gives_no_frame():
    manager = make(new_person_delay=0.0, voice_person_delay=0.0)
    manager.on_tracked(Kind.VOICE, ["v1"], 0.0)
    assert people(manager, 1.0)[A1][3] == 0.0
    assert manager.silent(1.0) == []


def test_a_tracked_person_whose_sources_are_silent_stays_at_the_last_place():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_place(Source.FACE, "f1", place(1.5, 1.0), 1.0)
    assert [ident for ident, _ in manager.silent(2.0)] == [A1]
    assert people(manager, 2.0)[A1][3] == 1.0


# -- existence, merging, withdrawal

def test_a_person_keeps_its_id_while_any_feature_lives():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    match(manager, "f:f1", "b:b1", 0.9, 0.1)
    manager.on_tracked(Kind.FACE, ["f2"], 1.0)
    match(manager, "f:f2", "b:b1", 0.9, 1.1)
    manager.on_tracked(Kind.BODY, [], 2.0)
    assert people(manager, 2.0)[A1][:3] == ("f2", "", "")


def test_the_older_id_stays_and_the_other_becomes_an_alias_and_returns():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 1.0)
    assert set(people(manager, 1.0)) == {A1, A2}
    match(manager, "f:f1", "b:b1", 0.9, 2.0)
    assert people(manager, 2.0) == {A1: ("f1", "b1", "", 0.0)}
    assert {state.id: state.alias for state in manager.snapshot(2.0).persons} == {A1: "", A2: A1}
    match(manager, "f:f1", "b:b1", 0.0, 3.0)
    assert {key: value[:2] for key, value in people(manager, 3.0).items()} == {
        A1: ("", "b1"), A2: ("f1", "")}
    assert all(not state.alias for state in manager.snapshot(3.0).persons)


def test_an_anonymous_person_turns_into_the_recognised_one_and_brings_its_place():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_place(Source.FACE, "f1", place(1.5, 1.0), 1.0)
    match(manager, "f:f1", "p:ann", 0.9, 1.1)
    states = {state.id: state for state in manager.snapshot(1.1).persons}
    assert states["ann"].face == "f1" and states["ann"].confidence == 1.0
    assert states["ann"].place.pose.translation[0] == 1.5
    assert states[A1].alias == "ann" and not states[A1].tracked
    manager.on_tracked(Kind.FACE, [], 2.0)
    assert [state.id for state in manager.snapshot(2.0).persons] == ["ann"]


def test_a_withdrawn_recognition_gives_the_face_back():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    match(manager, "f:f1", "p:ann", 0.9, 1.0)
    match(manager, "f:f1", "p:ann", 0.0, 2.0)
    assert people(manager, 2.0) == {"ann": ("", "", "", 0.0), A1: ("f1", "", "", 0.0)}


def test_a_person_keeps_its_face_when_the_body_in_between_leaves():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    match(manager, "f:f1", "b:b1", 0.6, 0.1)
    match(manager, "b:b1", "p:ann", 0.7, 0.1)
    manager.on_tracked(Kind.BODY, [], 1.0)
    assert people(manager, 1.0)["ann"][:3] == ("f1", "", "")


def test_a_match_may_come_before_the_tracked_list():
    manager = make(features_from_matches=False)
    assert not match(manager, "f:f1", "p:ann", 0.9, 0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.1)
    assert people(manager, 0.1)["ann"][0] == "f1"


def test_a_match_below_the_threshold_is_kept_and_may_rise():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    assert not match(manager, "f:f1", "b:b1", 0.4, 0.1)
    assert match(manager, "f:f1", "b:b1", 0.6, 0.2)
    assert not match(manager, "f:f1", "b:b1", 0.7, 0.3)
    assert match(manager, "f:f1", "b:b1", 0.3, 0.4)


def test_reset_forgets_persons_and_keeps_tracked_features():
    manager = make(new_person_delay=0.2)
    manager.on_tracked(Kind.FACE, ["f1"], 100.0)
    match(manager, "f:f1", "p:ann", 0.9, 100.0)
    manager.reset(10.0)
    assert manager.snapshot(10.0).known == ()
    manager.tick(10.3)
    assert people(manager, 10.3) == {A1: ("f1", "", "", 0.0)}


def test_the_same_persons_after_time_has_jumped_back():
    manager = make(new_person_delay=0.2)
    manager.on_tracked(Kind.FACE, ["f1", "f2", "f3"], 100.0)
    manager.on_tracked(Kind.BODY, ["b2"], 100.0)
    match(manager, "f:f1", "p:ann", 0.9, 100.0)
    match(manager, "f:f2", "b:b2", 0.9, 100.0)
    match(manager, "p:ann", "p:bea", 0.9, 100.0)
    match(manager, "v:v1", "f:f3", 0.9, 100.0)
    manager.tick(100.3)
    manager.on_place(Source.FACE, "f1", place(1.0, 100.3), 100.3)
    before = people(manager, 100.3)
    assert set(before) == {"ann", A1, A2} and before["ann"][3] == 1.0
    manager.rewind(40.0)
    after = people(manager, 40.0)
    assert {key: value[:3] for key, value in after.items()} == {key: value[:3] for key, value in before.items()}
    assert all(value[3] == 0.0 for value in after.values()), "places are of another time"
    assert {"ann", "bea"} <= set(manager.snapshot(40.0).known)
    assert next(state.alias for state in manager.snapshot(40.0).persons if state.id == "bea") == "ann"
    assert manager.on_place(Source.FACE, "f1", place(2.0, 40.1), 40.1) == "ann"
    assert people(manager, 40.2)["ann"][3] == 1.0
    manager.tick(51.0)      # nobody has spoken of the voice since the jump
    assert {value[2] for value in people(manager, 51.0).values()} == {""}
    manager.on_tracked(Kind.FACE, [], 51.0)
    assert people(manager, 56.0)["ann"][3] == pytest.approx(0.5)


# -- features that a match names first

def test_a_feature_named_in_a_match_is_present_until_its_list_says_otherwise():
    manager = make()
    assert match(manager, "f:f1", "p:ann", 0.9, 0.0)
    assert people(manager, 0.0)["ann"][0] == "f1"
    manager.on_tracked(Kind.FACE, ["f2"], 0.5)
    assert people(manager, 0.5)["ann"][0] == ""
    manager.on_tracked(Kind.FACE, ["f1", "f2"], 0.6)
    assert people(manager, 0.6)["ann"][0] == "f1"       # the match was kept


def test_a_late_match_does_not_bring_back_a_feature_that_has_left():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_tracked(Kind.FACE, [], 1.0)
    assert not match(manager, "f:f1", "p:ann", 0.9, 1.1)
    assert people(manager, 1.1) == {}


def test_a_presumed_feature_goes_with_the_match_that_named_it_or_when_nobody_speaks_of_it():
    manager = make()
    match(manager, "v:v1", "p:ann", 0.9, 0.0)
    match(manager, "v:v1", "p:ann", 0.0, 1.0)
    assert people(manager, 1.0) == {"ann": ("", "", "", 0.0)} and manager.groups == ()
    match(manager, "v:v2", "p:ann", 0.9, 2.0)
    match(manager, "v:v2", "p:ann", 0.8, 9.0)
    manager.tick(18.0)
    assert people(manager, 18.0)["ann"][2] == "v2"
    manager.tick(19.1)
    assert people(manager, 19.1)["ann"][2] == ""


# -- persons that are one human

def test_a_match_between_persons_joins_them_and_can_be_undone():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    match(manager, "f:f1", "p:ann", 0.9, 0.0)
    match(manager, "b:b1", "p:bob", 0.9, 0.0)
    assert match(manager, "p:ann", "p:bob", 0.8, 0.1)
    assert people(manager, 0.1) == {"ann": ("f1", "b1", "", 0.0)}
    states = {state.id: state for state in manager.snapshot(0.1).persons}
    assert states["bob"].alias == "ann" and not states["bob"].tracked
    assert not match(manager, "p:ann", "p:bob", 0.7, 0.2)
    assert match(manager, "p:ann", "p:bob", 0.4, 0.3)
    assert people(manager, 0.3) == {"ann": ("f1", "", "", 0.0), "bob": ("", "b1", "", 0.0)}
    assert match(manager, "p:ann", "p:bob", 0.9, 0.4)
    manager.split("bob", 0.5)
    assert set(people(manager, 0.5)) == {"ann", "bob"}
    with pytest.raises(ValueError):
        manager.split("bob", 0.6)


def test_a_person_seen_by_two_cameras_keeps_id_and_place_when_one_loses_it():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_tracked(Kind.FACE, ["f1", "g1"], 1.0)
    assert manager.merge(A1, A2, 1.0) == (A1, A2)
    assert manager.on_place(Source.FACE, "f1", place(1.0, 1.0), 1.0) == A1
    assert manager.on_place(Source.FACE, "g1", place(1.1, 1.1), 1.1) is None    # one face is enough
    assert people(manager, 1.1) == {A1: ("f1", "", "", 1.0)}
    manager.on_tracked(Kind.FACE, ["g1"], 2.0)
    assert manager.on_place(Source.FACE, "g1", place(2.0, 2.5), 2.5) == A1
    assert people(manager, 2.5) == {A1: ("g1", "", "", 1.0)}
    manager.on_tracked(Kind.FACE, [], 3.0)
    assert 0.0 < people(manager, 3.5)[A1][3] < 1.0
    manager.tick(60.0)
    assert manager.snapshot(60.0).persons == ()


def test_an_anonymous_person_joined_with_a_permanent_one_is_its_alias():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    match(manager, "b:b1", "p:ann", 0.9, 1.0)
    manager.merge(A1, "ann", 1.0)
    assert people(manager, 1.0) == {"ann": ("f1", "b1", "", 0.0)}
    with pytest.raises(ValueError):
        manager.merge("ann", "nobody", 1.0)
    with pytest.raises(ValueError):
        manager.merge("ann", "ann", 1.0)


def test_persons_joined_again_though_one_was_not_seen_for_long():
    manager = make()
    for name in ("ann", "bob"):
        match(manager, "f:f" + name, "p:" + name, 0.9, 0.0)
    match(manager, "p:ann", "p:bob", 1.0, 0.0)
    manager.on_tracked(Kind.FACE, [], 1.0)
    for number in range(2 * MAX_UNSEEN_PERSONS):
        match(manager, "f:x%d" % number, "p:x%d" % number, 0.9, 2.0)
        manager.on_tracked(Kind.FACE, [], 3.0 + number)
    manager.tick(500.0)
    match(manager, "f:fagain", "p:bob", 0.9, 501.0)
    assert [state.id for state in manager.snapshot(501.0).persons if state.tracked] == ["ann"]


# -- forgetting

def test_a_forgotten_person_is_a_stranger_again():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    match(manager, "f:f1", "p:ann", 0.9, 0.1)
    match(manager, "p:ann", "p:bob", 0.9, 0.1)
    manager.on_place(Source.FACE, "f1", place(1.0, 0.2), 0.2)
    assert manager.forget("ann", 0.3) and not manager.forget("ann", 0.3)
    assert "ann" not in manager.snapshot(0.3).known and not [edge for edge in manager.unions if "ann" in edge]
    (state,) = [state for state in manager.snapshot(0.3).persons if state.tracked]
    assert state.anonymous and state.face == "f1"


def test_forgetting_one_of_a_union_leaves_the_other():
    manager = make()
    match(manager, "f:f1", "p:ann", 0.9, 0.0)
    match(manager, "b:b1", "p:bob", 0.9, 0.0)
    match(manager, "p:ann", "p:bob", 0.9, 0.0)
    assert manager.forget("ann", 1.0)
    assert people(manager, 1.0)["bob"][1] == "b1"


def test_people_of_a_store_are_known_from_the_start():
    manager = make()
    manager.know(["ann", "bob"])
    assert manager.snapshot(0.0).known == ("ann", "bob") and manager.snapshot(0.0).tracked == ()


# -- another run

def test_anonymous_persons_have_the_same_ids_after_a_restart():
    first = make(new_person_delay=0.0)
    first.on_tracked(Kind.FACE, ["f1", "f2"], 0.0)
    memory = first.anonymous()
    second = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}), new_id=lambda: "other")
    second.expect(memory)
    second.on_tracked(Kind.FACE, ["f2", "f3", "f1"], 10.0)
    assert {state.id: state.face for state in second.snapshot(10.0).persons} == {A1: "f1", A2: "f2"}
    second.tick(11.0)
    assert second.snapshot(11.0).tracked[-1] == "anonymous_person_other"


def test_permanent_persons_are_themselves_at_once_after_a_restart():
    first = make(new_person_delay=0.0)
    first.on_tracked(Kind.FACE, ["f1"], 0.0)
    first.on_tracked(Kind.BODY, ["b1", "b2"], 0.0)
    first.on_match(Match(Node(Kind.FACE, "f1"), Node(Kind.PERSON, "ann"), 0.8), 0.0)
    first.on_match(Match(Node(Kind.FACE, "f1"), Node(Kind.BODY, "b1"), 0.8), 0.0)
    first.on_match(Match(Node(Kind.BODY, "b2"), Node(Kind.PERSON, "bob"), 0.8), 0.0)
    memory = first.identified()
    assert memory == {"ann": [Node(Kind.FACE, "f1")], "bob": [Node(Kind.BODY, "b2")]}
    second = make(new_person_delay=0.0)
    second.recall(memory, 10.0)
    second.on_tracked(Kind.FACE, ["f1", "f3"], 10.0)
    second.on_tracked(Kind.BODY, ["b2"], 10.0)
    shown = {state.id: (state.face, state.body) for state in second.snapshot(10.0).persons}
    assert shown["ann"] == ("f1", "") and shown["bob"] == ("", "b2") and len(shown) == 3
    # The recogniser has the last word.
    second.on_match(Match(Node(Kind.FACE, "f1"), Node(Kind.PERSON, "ann"), 0.0), 11.0)
    second.on_match(Match(Node(Kind.FACE, "f1"), Node(Kind.PERSON, "eve"), 0.7), 11.0)
    assert {state.id: state.face for state in second.snapshot(11.0).persons}["eve"] == "f1"


# -- hostile input and bounds

def test_hostile_ids_are_left_out_and_counted():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1", "", "a b", "a/b", "1abc", "x" * 33, "a'b", "f2\n"], 0.0)
    assert [state.face for state in manager.snapshot(0.0).persons] == ["f1"]
    assert manager.refused_ids == 7


def test_state_is_bounded_over_thousands_of_ids():
    manager = make(new_person_delay=0.0, half_life=0.1)
    for number in range(2000):
        now = float(number)
        manager.on_tracked(Kind.FACE, ["f%d" % number], now)
        match(manager, "f:f%d" % number, "b:never%d" % number, 0.9, now)
        match(manager, "f:f%d" % number, "p:p%d" % number, 0.9, now)
        manager.on_place(Source.FACE, "f%d" % number, place(1.0, now), now)
        manager.tick(now)
    manager.on_tracked(Kind.FACE, [], 3000.0)
    manager.tick(3011.0)
    manager.tick(3020.0)
    assert len(manager.snapshot(3010.0).persons) == MAX_UNSEEN_PERSONS
    assert len(manager.snapshot(3010.0).known) == 2000
    assert manager.groups == ()


# -- Matches with an anonymous person, as of a body that comes back in the same clothes.

def test_a_lost_anonymous_person_goes_on_with_a_feature_that_a_match_gives_it():
    manager = make()
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    manager.tick(1.0)
    manager.on_tracked(Kind.BODY, [], 1.0)
    manager.on_tracked(Kind.BODY, ["b2"], 3.0)
    assert match(manager, "b:b2", "p:" + A1, 0.7, 3.1)
    assert people(manager, 3.1) == {A1: ("", "b2", "", 0.0)}
    manager.tick(9.0)
    assert manager.snapshot(9.0).known == (A1,)


def test_a_feature_that_is_a_person_already_is_joined_with_the_anonymous_one_and_can_be_parted():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    manager.on_tracked(Kind.BODY, [], 1.0)
    manager.on_tracked(Kind.BODY, ["b2"], 3.0)
    assert manager.snapshot(3.0).tracked == (A2,)
    match(manager, "b:b2", "p:" + A1, 0.7, 3.1)
    assert manager.snapshot(3.1).tracked == (A1,)
    match(manager, "b:b2", "p:" + A1, 0.0, 3.2)
    assert manager.snapshot(3.2).tracked == (A2,)


def test_an_anonymous_person_that_is_seen_is_joined_with_the_new_feature():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.tick(1.0)
    manager.on_tracked(Kind.BODY, ["b2"], 1.0)
    match(manager, "b:b2", "p:" + A1, 0.7, 1.1)
    assert people(manager, 1.1) == {A1: ("f1", "b2", "", 0.0)}


@pytest.mark.parametrize("likelihood, person", [(0.4, A1), (0.9, "anonymous_person_zzzzz")])
def test_a_claim_that_is_unlikely_or_of_somebody_who_never_was_changes_nothing(likelihood, person):
    manager = make()
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    manager.tick(1.0)
    manager.on_tracked(Kind.BODY, [], 1.0)
    manager.on_tracked(Kind.BODY, ["b2"], 3.0)
    assert not match(manager, "b:b2", "p:" + person, likelihood, 3.1)
    manager.tick(4.0)
    assert manager.snapshot(4.0).tracked == (A2,)


def test_a_claim_brings_nobody_back_who_is_forgotten():
    manager = make(half_life=0.1)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    manager.tick(1.0)
    manager.on_tracked(Kind.BODY, [], 1.0)
    manager.tick(5.0)
    assert manager.snapshot(5.0).known == ()
    manager.on_tracked(Kind.BODY, ["b2"], 5.0)
    assert not match(manager, "b:b2", "p:" + A1, 0.9, 5.1)
