"""The whole manager: Table I of the paper row by row, the rules of the person frame, merging, bounds."""

from __future__ import annotations

import itertools
import random
import time
from dataclasses import replace

import numpy as np
import pytest

from hri_person_manager.core.features import MAX_FEATURES, Kind, MatchNode
from hri_person_manager.core.location import Place, PlaceSource
from hri_person_manager.core.manager import MAX_UNSEEN_PERSONS, PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.register import PersonRegister
from hri_pipeline.core.geometry import Pose

LISTS = {"faces": Kind.FACE, "bodies": Kind.BODY, "voices": Kind.VOICE}


def make(**given):
    """A manager with these parameters; `faces`, `bodies`, `voices`: who is tracked at 0 s."""
    numbers, tracked = itertools.count(1), {name: given.pop(name) for name in list(given) if name in LISTS}
    manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve(given), new_id=lambda: "a%04d" % next(numbers))
    for name, ids in tracked.items():
        manager.on_tracked(LISTS[name], ids, 0.0)
    return manager


def place(x, stamp):
    return Place("map", Pose(np.eye(3), np.array([x, 0.0, 0.0])), stamp)


def match(manager, first, second, likelihood, now):
    kinds = {"f": Kind.FACE, "b": Kind.BODY, "v": Kind.VOICE, "p": Kind.PERSON}
    nodes = [MatchNode(kinds[text[0]], text[2:]) for text in (first, second)]
    return manager.on_match(CandidateMatch(nodes[0], nodes[1], likelihood), now)


def people(manager, now):
    """Return {id: (face, body, voice, confidence)} of all persons but aliases."""
    return {state.id: (state.face, state.body, state.voice, state.confidence)
            for state in manager.snapshot(now).persons if not state.alias}


A1, A2 = "anonymous_person_a0001", "anonymous_person_a0002"


def named(manager, face, person, sender, now):
    manager.on_match(CandidateMatch(MatchNode(Kind.FACE, face), MatchNode(Kind.PERSON, person), 0.9), now, sender)


def test_whom_a_recogniser_lost_when_it_was_started_anew_is_known_no_more_once_gone():
    manager = make(faces=["f1", "f2", "f3", "f4"])
    for face, person in (("f1", "ann"), ("f2", "bob"), ("f3", "cho"), ("f4", "dan")):
        named(manager, face, person, "eyes", 0.0)
    named(manager, "f3", "cho", "others", 0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 1.0)
    manager.renew("eyes", {"bob"}, 2.0)
    assert manager.snapshot(2.0).known == ("ann", "bob", "cho"), "dan is lost; ann is seen; others know cho"
    assert manager.snapshot(2.0).tracked == ("ann", )
    manager.on_tracked(Kind.FACE, [], 3.0)
    manager.tick(3.1)
    assert manager.snapshot(3.1).known == ("bob", "cho") and "ann" not in people(manager, 3.1)
    manager.renew("others", (), 4.0)
    assert manager.snapshot(4.0).known == ("bob", )
    manager.renew("eyes", (), 5.0)
    assert manager.snapshot(5.0).known == ()


def test_who_is_named_again_after_the_start_of_a_recogniser_stays_known():
    manager = make(faces=["f1"])
    named(manager, "f1", "ann", "eyes", 0.0)
    manager.renew("eyes", (), 1.0)
    named(manager, "f1", "ann", "eyes", 1.5)
    manager.on_tracked(Kind.FACE, [], 3.0)
    manager.tick(3.1)
    manager.tick(300.0)
    assert manager.snapshot(300.0).known == ("ann", )


def test_who_was_joined_with_somebody_stays_known_when_the_recogniser_has_lost_one_of_them():
    manager = make(faces=["f1", "f2"])
    named(manager, "f1", "ann", "eyes", 0.0)
    named(manager, "f2", "bob", "others", 0.0)
    manager.merge("ann", "bob", 0.5)
    manager.renew("eyes", (), 1.0)
    manager.on_tracked(Kind.FACE, ["f2"], 2.0)
    manager.tick(2.1)
    assert manager.snapshot(2.1).tracked == ("ann", )


# -- Table I, one test per row. Its ids such as 24ac start with a digit; ours have to start with a letter.

def test_row_1_a_face_alone_has_no_person_until_the_delay_is_over():
    manager = make(faces=["f24ac"])
    manager.tick(0.4)
    assert people(manager, 0.4) == {}
    manager.tick(0.5)
    assert people(manager, 0.5) == {A1: ("f24ac", "", "", 0.0)}


def test_row_1_strictly_no_person_before_identification():
    manager = make(anonymous_persons=False, faces=["f24ac"])
    manager.tick(100.0)
    assert people(manager, 100.0) == {}
    assert manager.on_place(PlaceSource.FACE, "f24ac", place(1.0, 100.0), 100.0) is None
    assert manager.groups == (frozenset([MatchNode(Kind.FACE, "f24ac")]),)


def test_row_2_a_redetected_face_is_a_new_face():
    manager = make(new_person_delay=0.0, faces=["f24ac"])
    manager.on_tracked(Kind.FACE, [], 1.0)
    manager.on_tracked(Kind.FACE, ["d73b"], 2.0)
    assert manager.snapshot(2.0).tracked == (A2,)


def test_row_3_a_body_alone():
    manager = make(new_person_delay=0.0, bodies=["b37ef"])
    assert people(manager, 0.0) == {A1: ("", "b37ef", "", 0.0)}


def test_row_4_a_face_and_a_body_associated_without_a_person():
    manager = make(anonymous_persons=False, faces=["d73b"], bodies=["b37ef"])
    assert match(manager, "f:d73b", "b:b37ef", 0.8, 0.1)
    assert manager.groups == (frozenset([MatchNode(Kind.FACE, "d73b"), MatchNode(Kind.BODY, "b37ef")]),)
    assert people(manager, 1.0) == {}


def test_row_5_a_known_person_without_any_feature():
    manager = make(faces=["d73b"])
    match(manager, "f:d73b", "p:p9d8a", 0.9, 0.1)
    manager.on_tracked(Kind.FACE, [], 1.0)
    manager.tick(1.0)
    snapshot = manager.snapshot(1.0)
    assert snapshot.tracked == () and snapshot.known == ("p9d8a",)
    assert people(manager, 1.0) == {"p9d8a": ("", "", "", 0.0)}


def test_row_6_a_recognised_face():
    manager = make(faces=["d73b"])
    match(manager, "f:d73b", "p:p9d8a", 0.9, 0.1)
    state = manager.snapshot(0.1).persons[0]
    assert (state.id, state.face, state.anonymous) == ("p9d8a", "d73b", False)


def test_row_7_another_face_of_the_same_person():
    manager = make(faces=["d73b"])
    match(manager, "f:d73b", "p:p9d8a", 0.9, 0.1)
    manager.on_tracked(Kind.FACE, ["f96f1"], 1.0)
    match(manager, "f:f96f1", "p:p9d8a", 0.9, 1.1)
    manager.tick(5.0)
    assert people(manager, 5.0) == {"p9d8a": ("f96f1", "", "", 0.0)}


def test_row_8_a_fully_tracked_person():
    manager = make(faces=["f96f1"], bodies=["b37ef"])
    match(manager, "f:f96f1", "p:p9d8a", 0.9, 0.1)
    match(manager, "f:f96f1", "b:b37ef", 0.9, 0.1)
    assert people(manager, 0.1) == {"p9d8a": ("f96f1", "b37ef", "", 0.0)}


def test_row_9_a_voice_and_a_person():
    manager = make(voices=["ab7f"])
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
    manager = make(faces=["f1"])
    assert manager.on_place(PlaceSource.FACE, "f1", place(1.0, 0.1), 0.1) is None
    assert manager.silent(0.2) == []


def test_rule_2_face_then_body_then_voice():
    manager = make(new_person_delay=0.0, faces=["f1"], bodies=["b1"], voices=["v1"])
    match(manager, "f:f1", "b:b1", 0.9, 0.0)
    match(manager, "v:v1", "b:b1", 0.9, 0.0)
    ident = manager.snapshot(0.0).tracked[0]
    assert manager.on_place(PlaceSource.VOICE, "v1", place(4.0, 1.0), 1.0) == ident
    assert manager.on_place(PlaceSource.BODY, "b1", place(3.0, 1.0), 1.0) == ident
    assert manager.on_place(PlaceSource.HEAD, "b1", place(2.0, 1.0), 1.0) == ident
    assert manager.on_place(PlaceSource.FACE, "f1", place(1.0, 1.0), 1.0) == ident
    assert manager.on_place(PlaceSource.HEAD, "b1", place(2.0, 1.1), 1.1) is None
    assert people(manager, 1.1)[ident][3] == 1.0
    manager.on_tracked(Kind.FACE, [], 1.2)
    assert manager.on_place(PlaceSource.HEAD, "b1", place(2.0, 1.2), 1.2) == ident
    assert people(manager, 1.2)[ident][3] == 1.0


def test_rule_3_the_frame_stays_and_the_confidence_decays_to_zero():
    manager = make(new_person_delay=0.0, half_life=2.0, faces=["f1"])
    manager.on_place(PlaceSource.FACE, "f1", place(1.5, 1.0), 1.0)
    assert manager.silent(1.1) == []
    manager.on_tracked(Kind.FACE, [], 1.0)
    assert 0.9 < people(manager, 1.0)[A1][3] < 1.0
    assert people(manager, 3.0)[A1][3] == pytest.approx(0.5)
    (ident, where), = manager.silent(3.0)
    assert ident == A1 and where.pose.translation[0] == 1.5
    manager.tick(20.0)
    assert manager.silent(20.0) == [] and people(manager, 20.0) == {}


def test_rule_3_a_permanent_person_stays_known_when_the_place_is_forgotten():
    manager = make(half_life=2.0, faces=["f1"])
    match(manager, "f:f1", "p:ann", 1.0, 0.0)
    manager.on_place(PlaceSource.FACE, "f1", place(1.5, 1.0), 1.0)
    manager.on_tracked(Kind.FACE, [], 1.0)
    manager.tick(20.0)
    assert people(manager, 20.0) == {"ann": ("", "", "", 0.0)}
    assert manager.snapshot(20.0).known == ("ann",)


def test_rule_4_a_voice_without_a_direction_gives_no_frame():
    manager = make(new_person_delay=0.0, voice_person_delay=0.0, voices=["v1"])
    assert people(manager, 1.0)[A1][3] == 0.0
    assert manager.silent(1.0) == []


def test_a_tracked_person_whose_sources_are_silent_stays_at_the_last_place():
    manager = make(new_person_delay=0.0, faces=["f1"])
    manager.on_place(PlaceSource.FACE, "f1", place(1.5, 1.0), 1.0)
    assert [ident for ident, _ in manager.silent(2.0)] == [A1]
    assert people(manager, 2.0)[A1][3] == 1.0


def test_the_frame_of_somebody_seen_just_now_is_not_sent_again_when_the_feature_leaves():
    manager = make(new_person_delay=0.0, faces=["f1"])
    manager.on_place(PlaceSource.FACE, "f1", place(1.5, 0.9), 1.0)
    manager.on_tracked(Kind.FACE, [], 1.05)
    assert manager.silent(1.1) == []
    assert [ident for ident, _ in manager.silent(1.6)] == [A1]


def test_one_frame_is_sent_of_persons_that_are_one_until_it_is_not_to_be_trusted_any_more():
    manager = make(new_person_delay=0.0, half_life=2.0, faces=["f1", "f2"])
    match(manager, "p:" + A1, "p:" + A2, 0.9, 0.1)
    for face in ("f1", "f2"):
        manager.on_place(PlaceSource.FACE, face, place(1.5, 1.0), 1.0)
    for now, active, silent in ((1.1, [A1], []), (3.0, [], [A1]), (20.0, [], [])):
        assert [ident for ident, _ in manager.active(now)] == active, now
        assert [ident for ident, _ in manager.silent(now)] == silent, now


def watch(manager, source, feature, begin, end, period=0.05, age=0.0, frame="map", tick=True):
    """Tell places x = time of a feature every `period` s, `age` s old; return those of them that moved a person."""
    moved = []
    for number in range(int(round((end - begin) / period)) + 1):
        now = begin + number * period
        if manager.on_place(source, feature, replace(place(now, now - age), frame=frame), now) is not None:
            moved.append(now)
        manager.tick(now)
    return moved


def confidences(manager, *times):
    (ident,) = manager.snapshot(times[0]).tracked
    return [people(manager, time)[ident][3] for time in times]


def test_the_confidence_falls_when_a_feature_that_is_listed_tells_no_place_any_more():
    manager = make(new_person_delay=0.0, half_life=2.0, faces=["f1"])
    watch(manager, PlaceSource.FACE, "f1", 0.0, 5.0)
    assert confidences(manager, 5.0, 5.9, 8.0, 10.0) == [1.0, 1.0, pytest.approx(0.5), pytest.approx(0.25)]
    assert [ident for ident, _ in manager.silent(10.0)] == [A1]
    manager.tick(30.0)
    assert people(manager, 30.0) == {A1: ("f1", "", "", 0.0)} and manager.silent(30.0) == []
    assert manager.on_place(PlaceSource.FACE, "f1", place(1.0, 31.0), 31.0) == A1
    assert confidences(manager, 31.0) == [1.0]
    manager.on_tracked(Kind.FACE, [], 31.5)
    assert people(manager, 33.5)[A1][3] == pytest.approx(0.5)       # from when it left


def test_the_place_of_a_slow_camera_counts_for_three_images():
    manager = make(new_person_delay=0.0, half_life=2.0, faces=["f1"])
    watch(manager, PlaceSource.FACE, "f1", 0.0, 6.0, period=2.0)
    assert confidences(manager, 6.0, 11.9, 14.0) == [1.0, 1.0, pytest.approx(0.5)]
    # An image in which the face was not found is no period; nor is the time in which nothing came.
    watch(manager, PlaceSource.FACE, "f1", 20.0, 21.0, period=0.2)
    watch(manager, PlaceSource.FACE, "f1", 25.0, 25.4, period=0.2)
    assert confidences(manager, 26.3)[0] == 1.0 and confidences(manager, 28.4)[0] == pytest.approx(0.5)


def test_the_age_of_images_is_no_loss_of_confidence():
    manager = make(new_person_delay=0.0, half_life=2.0, faces=["f1"])
    watch(manager, PlaceSource.FACE, "f1", 10.0, 15.0, age=3.0)
    assert confidences(manager, 15.9)[0] == 1.0


def test_a_voice_without_a_direction_does_not_keep_the_place():
    manager = make(new_person_delay=0.0, voice_person_delay=0.0, faces=["f1"], voices=["v1"])
    match(manager, "f:f1", "v:v1", 0.9, 0.0)
    watch(manager, PlaceSource.FACE, "f1", 0.0, 5.0)
    manager.on_tracked(Kind.FACE, [], 5.0)
    assert confidences(manager, 10.0) == [pytest.approx(0.5)]
    manager.tick(600.0)
    assert confidences(manager, 600.0) == [0.0] and manager.silent(600.0) == []
    assert manager.on_place(PlaceSource.VOICE, "v1", place(3.0, 601.0), 601.0) == A1
    assert confidences(manager, 601.5) == [1.0]


def test_any_feature_of_the_persons_that_are_one_keeps_the_confidence():
    manager = make(new_person_delay=0.0, faces=["f1", "g1"])
    manager.merge(A1, A2, 0.0)
    watch(manager, PlaceSource.FACE, "f1", 0.0, 5.0)
    watch(manager, PlaceSource.FACE, "g1", 5.0, 10.0)
    assert confidences(manager, 10.9) == [1.0]
    manager.split(A1, 11.0)
    assert people(manager, 11.0)[A2][3] == 1.0 and people(manager, 16.0)[A1][3] == pytest.approx(0.5)


# -- which feature places a person

@pytest.mark.parametrize("kind, feature, source", [
    (Kind.BODY, "b1", PlaceSource.BODY), (Kind.BODY, "b1", PlaceSource.HEAD), (Kind.VOICE, "v1", PlaceSource.VOICE)])
@pytest.mark.parametrize("age", [-0.65, 0.0, 0.65, 2.0])
@pytest.mark.parametrize("merged", [False, True])
def test_a_face_that_is_there_places_the_person_however_old_other_messages_are(kind, feature, source, age, merged):
    manager = make(new_person_delay=0.0, voice_person_delay=0.0, faces=["f1"])
    manager.on_tracked(kind, [feature], 0.0)
    if merged:
        manager.merge(A1, A2, 0.0)
    else:
        match(manager, "f:f1", feature[0] + ":" + feature, 0.9, 0.0)
    taken = 0
    for number in range(60):
        now = 10.0 + 0.05 * number
        assert manager.on_place(PlaceSource.FACE, "f1", place(1.0, now), now) == A1
        taken += number % 2 and manager.on_place(source, feature, place(2.0, now - age), now) is not None
    assert taken == 0
    manager.on_tracked(Kind.FACE, [], 13.0)
    assert manager.on_place(source, feature, place(2.0, 16.1 - age), 16.1) == A1


def test_the_body_of_somebody_just_recognised_does_not_place_it_beside_the_face():
    manager = make(new_person_delay=0.0, faces=["f1"], bodies=["b1"])
    match(manager, "f:f1", "b:b1", 0.9, 0.0)
    watch(manager, PlaceSource.FACE, "f1", 0.0, 2.0)
    match(manager, "f:f1", "p:ann", 0.9, 2.0)
    assert manager.on_place(PlaceSource.BODY, "b1", place(9.0, 1.3), 2.0) is None


# -- places told before there is a person

def test_a_place_told_before_the_person_exists_places_it():
    manager = make(new_person_delay=0.5, faces=["f1"], bodies=["b1"])
    match(manager, "f:f1", "b:b1", 0.9, 0.0)
    assert manager.on_place(PlaceSource.FACE, "f1", place(1.0, 0.40), 0.40) is None
    assert manager.on_place(PlaceSource.BODY, "b1", place(2.0, 0.41), 0.41) is None
    assert manager.newly_placed(0.4) == []
    manager.tick(0.5)
    assert people(manager, 0.5) == {A1: ("f1", "b1", "", 1.0)}
    ((ident, where),) = manager.newly_placed(0.5)
    assert (ident, where.stamp, where.pose.translation[0]) == (A1, 0.4, 1.0)
    assert manager.newly_placed(0.6) == [] and [ident for ident, _ in manager.silent(1.0)] == [A1]


def test_an_old_place_told_before_the_person_exists_is_not_that_of_now():
    manager = make(anonymous_persons=False, half_life=2.0, faces=["f1", "f2"])
    manager.on_place(PlaceSource.FACE, "f1", place(1.0, 0.0), 0.0)
    manager.on_place(PlaceSource.FACE, "f2", place(2.0, 0.0), 0.0)
    match(manager, "f:f1", "p:ann", 0.9, 3.0)
    assert people(manager, 3.0)["ann"][3] == pytest.approx(0.5)
    assert manager.newly_placed(3.0) == [] and [ident for ident, _ in manager.silent(3.0)] == ["ann"]
    match(manager, "f:f2", "p:bob", 0.9, 600.0)
    manager.tick(600.0)
    assert people(manager, 600.0)["bob"][3] == 0.0 and manager.silent(600.0) == []


def test_who_is_recognised_has_a_frame_at_once_and_so_has_who_was_parted():
    manager = make(new_person_delay=0.0, faces=["f1"], bodies=["b1"])
    match(manager, "f:f1", "b:b1", 0.9, 0.0)
    watch(manager, PlaceSource.FACE, "f1", 0.0, 2.0)
    watch(manager, PlaceSource.BODY, "b1", 2.0, 2.1)
    assert manager.newly_placed(2.1) == []
    match(manager, "f:f1", "p:ann", 0.9, 2.1)
    assert [ident for ident, _ in manager.newly_placed(2.1)] == ["ann"]
    match(manager, "f:f1", "b:b1", 0.0, 2.2)
    ((ident, where),) = manager.newly_placed(2.2)
    assert ident != "ann" and where.pose.translation[0] == pytest.approx(2.1, abs=0.05)


def test_of_a_feature_that_has_left_no_place_is_kept():
    manager = make(anonymous_persons=False, faces=["f1"])
    manager.on_place(PlaceSource.FACE, "f1", place(1.0, 0.1), 0.1)
    manager.on_place(PlaceSource.FACE, "nobody", place(1.0, 0.1), 0.1)
    manager.on_tracked(Kind.FACE, [], 0.2)
    manager.on_tracked(Kind.FACE, ["f1", "nobody"], 0.3)
    match(manager, "f:f1", "p:ann", 0.9, 0.4)
    match(manager, "f:nobody", "p:bob", 0.9, 0.4)
    assert [state.place for state in manager.snapshot(0.4).persons] == [None, None]


# -- existence, merging, withdrawal

def test_a_person_keeps_its_id_while_any_feature_lives():
    manager = make(new_person_delay=0.0, faces=["f1"], bodies=["b1"])
    match(manager, "f:f1", "b:b1", 0.9, 0.1)
    manager.on_tracked(Kind.FACE, ["f2"], 1.0)
    match(manager, "f:f2", "b:b1", 0.9, 1.1)
    manager.on_tracked(Kind.BODY, [], 2.0)
    assert people(manager, 2.0)[A1][:3] == ("f2", "", "")


def test_the_older_id_stays_and_the_other_becomes_an_alias_and_returns():
    manager = make(new_person_delay=0.0, bodies=["b1"])
    manager.on_tracked(Kind.FACE, ["f1"], 1.0)
    assert set(people(manager, 1.0)) == {A1, A2}
    match(manager, "f:f1", "b:b1", 0.9, 2.0)
    assert people(manager, 2.0) == {A1: ("f1", "b1", "", 0.0)}
    assert {state.id: state.alias for state in manager.snapshot(2.0).persons} == {A1: "", A2: A1}
    match(manager, "f:f1", "b:b1", 0.0, 3.0)
    assert {key: value[:2] for key, value in people(manager, 3.0).items()} == {
        A1: ("", "b1"), A2: ("f1", "")}
    assert all(not state.alias for state in manager.snapshot(3.0).persons)


def test_the_older_id_of_two_persons_that_are_one_stays_as_long_as_either_is_tracked_and_then_the_other_is_back():
    manager = make(new_person_delay=0.0, faces=["f1", "f2"])
    match(manager, "p:" + A1, "p:" + A2, 0.9, 0.1)
    manager.on_tracked(Kind.FACE, ["f2"], 1.0)
    manager.tick(600.0)
    assert people(manager, 600.0) == {A1: ("f2", "", "", 0.0)}
    manager.on_place(PlaceSource.FACE, "f2", place(1.0, 600.1), 600.1)
    manager.on_tracked(Kind.BODY, ["b3"], 600.2)
    assert people(manager, 600.2)[A1] == ("f2", "", "", 1.0)
    match(manager, "p:" + A1, "p:" + A2, 0.0, 600.3)
    assert people(manager, 600.3)[A2] == ("f2", "", "", 1.0)
    manager.tick(700.0)
    assert A1 not in people(manager, 700.0)


def test_who_is_joined_with_somebody_seen_is_where_that_one_is_at_once():
    manager = make(new_person_delay=0.0, faces=["f1", "f2"])
    match(manager, "f:f1", "p:ann", 0.9, 0.0)
    manager.on_place(PlaceSource.FACE, "f2", place(1.5, 1.0), 1.0)
    match(manager, "p:ann", "p:" + A2, 0.9, 1.1)
    assert people(manager, 1.1) == {"ann": ("f1", "", "", 1.0)}
    assert manager.place("ann").pose.translation[0] == 1.5


@pytest.mark.parametrize("ids", itertools.permutations(("alfa", "mike", "zulu")))
def test_of_anonymous_persons_that_are_one_the_oldest_stands_for_all_whatever_their_ids(ids):
    manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({"new_person_delay": 0.0}), new_id=iter(ids).__next__)
    for number in range(3):
        manager.on_tracked(Kind.FACE, ["f%d" % face for face in range(number + 1)], float(number))
    names = ["anonymous_person_" + name for name in ids]
    match(manager, "p:" + names[2], "p:" + names[1], 0.9, 3.0)
    assert manager.snapshot(3.0).tracked == tuple(sorted(names[:2]))
    match(manager, "p:" + names[2], "p:" + names[0], 0.9, 3.0)
    assert manager.snapshot(3.0).tracked == (names[0],)


def test_whoever_a_named_person_was_is_an_alias_of_it_and_comes_back_when_parted():
    manager = make(new_person_delay=0.0, bodies=["b1"])
    manager.on_tracked(Kind.FACE, ["f1"], 1.0)
    match(manager, "f:f1", "b:b1", 0.9, 2.0)
    match(manager, "f:f1", "p:ann", 0.9, 3.0)
    assert {state.id: state.alias for state in manager.snapshot(3.0).persons} == {"ann": "", A1: "ann", A2: "ann"}
    match(manager, "f:f1", "p:ann", 0.0, 4.0)
    match(manager, "f:f1", "b:b1", 0.0, 4.0)
    assert {key: value[:2] for key, value in people(manager, 4.0).items() if key != "ann"} == {
        A1: ("", "b1"), A2: ("f1", "")}


def test_an_anonymous_person_turns_into_the_recognised_one_and_brings_its_place():
    manager = make(new_person_delay=0.0, faces=["f1"])
    manager.on_place(PlaceSource.FACE, "f1", place(1.5, 1.0), 1.0)
    match(manager, "f:f1", "p:ann", 0.9, 1.1)
    states = {state.id: state for state in manager.snapshot(1.1).persons}
    assert states["ann"].face == "f1" and states["ann"].confidence == 1.0
    assert states["ann"].place.pose.translation[0] == 1.5
    assert states[A1].alias == "ann" and not states[A1].tracked
    manager.on_tracked(Kind.FACE, [], 2.0)
    assert [state.id for state in manager.snapshot(2.0).persons] == ["ann"]


def test_the_recognised_one_is_where_the_anonymous_one_was_though_what_told_that_place_has_left():
    manager = make(new_person_delay=0.0, faces=["f1"], bodies=["b1"])
    match(manager, "f:f1", "b:b1", 0.9, 0.1)
    manager.on_place(PlaceSource.FACE, "f1", place(1.5, 1.0), 1.0)
    manager.on_tracked(Kind.FACE, [], 1.1)
    match(manager, "b:b1", "p:ann", 0.9, 1.2)
    assert manager.place("ann").pose.translation[0] == 1.5


def test_a_withdrawn_recognition_gives_the_face_back():
    manager = make(new_person_delay=0.0, faces=["f1"])
    match(manager, "f:f1", "p:ann", 0.9, 1.0)
    match(manager, "f:f1", "p:ann", 0.0, 2.0)
    assert people(manager, 2.0) == {"ann": ("", "", "", 0.0), A1: ("f1", "", "", 0.0)}


def test_a_person_keeps_its_face_when_the_body_in_between_leaves():
    manager = make(faces=["f1"], bodies=["b1"])
    match(manager, "f:f1", "b:b1", 0.6, 0.1)
    match(manager, "b:b1", "p:ann", 0.7, 0.1)
    manager.on_tracked(Kind.BODY, [], 1.0)
    assert people(manager, 1.0)["ann"][:3] == ("f1", "", "")


def test_a_match_may_come_before_the_tracked_list():
    manager = make(features_from_matches=False)
    assert not match(manager, "f:f1", "p:ann", 0.9, 0.0)
    manager.on_tracked(Kind.FACE, ["f1"], 0.1)
    assert people(manager, 0.1)["ann"][0] == "f1"


@pytest.mark.parametrize("named_until, gone_at", [(0, 10), (8, 18)])
def test_a_body_that_no_list_contains_is_there_for_ten_seconds_after_its_last_match(named_until, gone_at):
    manager, there = make(new_person_delay=0.0, faces=["f1"]), []
    for now in range(30):
        if now <= named_until:
            match(manager, "f:f1", "b:b1", 0.9, now + 0.01)
        manager.on_tracked(Kind.FACE, ["f1"], now + 0.02)       # lists of others tell nothing of it
        manager.tick(now + 0.03)
        there.append([state.body for state in manager.snapshot(now + 0.03).persons if state.face == "f1"] == ["b1"])
    assert there == [now < gone_at for now in range(30)]


def test_a_body_that_a_match_named_before_its_list_came_is_there_as_long_as_the_list_says():
    manager = make(new_person_delay=0.0, faces=["f1"])
    match(manager, "f:f1", "b:b1", 0.9, 0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 1.0)
    manager.tick(100.0)
    assert people(manager, 100.0) == {A1: ("f1", "b1", "", 0.0)}
    manager.on_tracked(Kind.BODY, [], 101.0)
    assert people(manager, 101.0) == {A1: ("f1", "", "", 0.0)}


def test_bodies_that_only_matches_name_are_as_many_as_a_list_may_hold():
    manager = make()
    for number in range(2 * MAX_FEATURES):
        match(manager, "b:b%d" % number, "p:p%d" % number, 0.9, 1.0)
    assert len(manager.snapshot(1.0).tracked) == MAX_FEATURES


def test_ids_that_are_none_and_those_beyond_the_longest_list_are_counted_and_left_out():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1", "no id", ""], 0.0)
    assert manager.refused_ids == 2 and len(manager.snapshot(0.0).tracked) == 1
    manager.on_tracked(Kind.FACE, ["f%d" % number for number in range(MAX_FEATURES + 5)], 0.0)
    assert manager.refused_ids == 7 and len(manager.snapshot(0.0).tracked) == MAX_FEATURES


def test_a_match_below_the_threshold_is_kept_and_may_rise():
    manager = make(faces=["f1"], bodies=["b1"])
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
    manager.on_place(PlaceSource.FACE, "f1", place(1.0, 100.3), 100.3)
    before = people(manager, 100.3)
    assert set(before) == {"ann", A1, A2} and before["ann"][3] == 1.0
    manager.rewind(40.0)
    after = people(manager, 40.0)
    assert {key: value[:3] for key, value in after.items()} == {key: value[:3] for key, value in before.items()}
    assert all(value[3] == 0.0 for value in after.values()), "places are of another time"
    assert {"ann", "bea"} <= set(manager.snapshot(40.0).known)
    assert next(state.alias for state in manager.snapshot(40.0).persons if state.id == "bea") == "ann"
    assert manager.on_place(PlaceSource.FACE, "f1", place(2.0, 40.1), 40.1) == "ann"
    assert people(manager, 40.2)["ann"][3] == 1.0
    manager.tick(51.0)      # nobody has spoken of the voice since the jump
    assert {value[2] for value in people(manager, 51.0).values()} == {""}
    manager.on_place(PlaceSource.FACE, "f1", place(2.0, 51.0), 51.0)
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
    manager = make(faces=["f1"])
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
    manager = make(faces=["f1"], bodies=["b1"])
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
    manager = make(new_person_delay=0.0, faces=["f1"])
    manager.on_tracked(Kind.FACE, ["f1", "g1"], 1.0)
    assert manager.merge(A1, A2, 1.0) == (A1, A2)
    assert manager.on_place(PlaceSource.FACE, "f1", place(1.0, 1.0), 1.0) == A1
    assert manager.on_place(PlaceSource.FACE, "g1", place(1.1, 1.1), 1.1) is None    # one face is enough
    assert people(manager, 1.1) == {A1: ("f1", "", "", 1.0)}
    manager.on_tracked(Kind.FACE, ["g1"], 2.0)
    assert manager.on_place(PlaceSource.FACE, "g1", place(2.0, 2.5), 2.5) == A1
    assert people(manager, 2.5) == {A1: ("g1", "", "", 1.0)}
    manager.on_tracked(Kind.FACE, [], 3.0)
    assert 0.0 < people(manager, 3.5)[A1][3] < 1.0
    manager.tick(60.0)
    assert manager.snapshot(60.0).persons == ()


def test_an_anonymous_person_joined_with_a_permanent_one_is_its_alias():
    manager = make(new_person_delay=0.0, faces=["f1"])
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


def test_of_more_permanent_persons_than_are_kept_unseen_those_go_who_were_lost_first():
    names = ["n%02d" % number for number in range(MAX_UNSEEN_PERSONS + 2)]
    manager = make(faces=["f" + name for name in names])
    for name in names:
        match(manager, "f:f" + name, "p:" + name, 0.9, 0.0)
    manager.tick(500.0)
    assert set(people(manager, 500.0)) == set(names), "who is seen stays, however many these are"
    for now, gone in enumerate((names[7], names[3], names[5]), 501):
        names.remove(gone)
        manager.on_tracked(Kind.FACE, ["f" + name for name in names], float(now))
    for name in names:
        manager.on_place(PlaceSource.FACE, "f" + name, place(1.0, 503.5), 503.5)
    manager.on_tracked(Kind.FACE, [], 504.0)
    manager.tick(504.1)
    assert len(people(manager, 504.1)) == len(names) + 3, "those who have a place yet are not counted"
    manager.tick(1000.0)
    assert set(people(manager, 1000.0)) == {"n05", *names}


# -- forgetting

def test_a_forgotten_person_is_a_stranger_again():
    manager = make(new_person_delay=0.0, faces=["f1"])
    match(manager, "f:f1", "p:ann", 0.9, 0.1)
    match(manager, "p:ann", "p:bob", 0.9, 0.1)
    manager.on_place(PlaceSource.FACE, "f1", place(1.0, 0.2), 0.2)
    assert manager.forget("ann", 0.3) and not manager.forget("ann", 0.3)
    assert "ann" not in manager.snapshot(0.3).known and not [edge for edge in manager.merges if "ann" in edge]
    (state,) = [state for state in manager.snapshot(0.3).persons if state.tracked]
    assert state.anonymous and state.face == "f1"


def test_forgetting_one_of_a_union_leaves_the_other():
    manager = make()
    match(manager, "f:f1", "p:ann", 0.9, 0.0)
    match(manager, "b:b1", "p:bob", 0.9, 0.0)
    match(manager, "p:ann", "p:bob", 0.9, 0.0)
    assert manager.forget("ann", 1.0)
    assert people(manager, 1.0)["bob"][1] == "b1"


def test_what_belonged_to_a_forgotten_person_is_nobodys_and_not_who_it_was_before_the_name():
    manager = make(faces=["f1", "f2"])
    manager.tick(0.5)
    assert set(people(manager, 0.5)) == {A1, A2}
    for face, name in (("f:f1", "p:ann"), ("f:f2", "p:bob")):
        match(manager, face, name, 0.9, 0.6)
    assert manager.forget("ann", 0.7)
    assert people(manager, 0.7) == {"bob": ("f2", "", "", 0.0)}
    match(manager, "f:f2", "p:bob", 0.0, 0.8)
    assert people(manager, 0.8)[A2] == ("f2", "", "", 0.0), "who is not forgotten is who he was before the name"
    manager.tick(1.2)
    assert people(manager, 1.2)["anonymous_person_a0003"] == ("f1", "", "", 0.0)


def test_an_alias_that_is_forgotten_is_none_any_more():
    manager = make(new_person_delay=0.0, faces=["f1"])
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    match(manager, "f:f1", "b:b1", 0.9, 0.1)
    alias, = [state.id for state in manager.snapshot(0.1).persons if state.alias]
    assert manager.forget(alias, 0.2) and not manager.forget(alias, 0.2)
    assert [(state.face, state.body, state.alias) for state in manager.snapshot(0.2).persons] == [("f1", "b1", "")]


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


def test_an_id_from_before_a_restart_is_given_once_though_its_features_are_two_peoples_now():
    manager = make(new_person_delay=0.0)
    manager.expect({"anonymous_person_aback": [MatchNode(Kind.FACE, "f1"), MatchNode(Kind.BODY, "b1")]})
    manager.on_tracked(Kind.FACE, ["f1"], 1.0)
    assert set(people(manager, 1.0)) == {"anonymous_person_aback"}
    manager.on_tracked(Kind.FACE, [], 2.0)
    manager.tick(60.0)
    manager.on_tracked(Kind.BODY, ["b1"], 61.0)
    assert set(people(manager, 61.0)) == {A1}, "of whom that was nothing is left"


def test_permanent_persons_are_themselves_at_once_after_a_restart():
    first = make(new_person_delay=0.0)
    first.on_tracked(Kind.FACE, ["f1", "f9"], 0.0)
    first.on_tracked(Kind.BODY, ["b1", "b2"], 0.0)
    first.on_match(CandidateMatch(MatchNode(Kind.FACE, "f1"), MatchNode(Kind.PERSON, "ann"), 0.8), 0.0)
    first.on_match(CandidateMatch(MatchNode(Kind.FACE, "f1"), MatchNode(Kind.BODY, "b1"), 0.8), 0.0)
    first.on_match(CandidateMatch(MatchNode(Kind.BODY, "b2"), MatchNode(Kind.PERSON, "bob"), 0.8), 0.0)
    memory = first.identified()
    assert memory == {"ann": [MatchNode(Kind.FACE, "f1")], "bob": [MatchNode(Kind.BODY, "b2")]}
    assert first.anonymous() == {A2: [MatchNode(Kind.FACE, "f9")]}
    second = make(new_person_delay=0.0)
    second.recall(memory, 10.0)
    second.on_tracked(Kind.FACE, ["f1", "f3"], 10.0)
    second.on_tracked(Kind.BODY, ["b2"], 10.0)
    shown = {state.id: (state.face, state.body) for state in second.snapshot(10.0).persons}
    assert shown["ann"] == ("f1", "") and shown["bob"] == ("", "b2") and len(shown) == 3
    # The recogniser has the last word.
    second.on_match(CandidateMatch(MatchNode(Kind.FACE, "f1"), MatchNode(Kind.PERSON, "ann"), 0.0), 11.0)
    second.on_match(CandidateMatch(MatchNode(Kind.FACE, "f1"), MatchNode(Kind.PERSON, "eve"), 0.7), 11.0)
    assert {state.id: state.face for state in second.snapshot(11.0).persons}["eve"] == "f1"


# -- hostile input and bounds

def test_hostile_ids_are_left_out_and_counted():
    manager = make(new_person_delay=0.0, faces=["f1", "", "a b", "a/b", "1abc", "x" * 33, "a'b", "f2\n"])
    assert [state.face for state in manager.snapshot(0.0).persons] == ["f1"]
    assert manager.refused_ids == 7


@pytest.mark.slow("thousands of ids")
def test_state_is_bounded_over_thousands_of_ids():
    manager = make(new_person_delay=0.0, half_life=0.1)
    for number in range(2000):
        now = float(number)
        manager.on_tracked(Kind.FACE, ["f%d" % number], now)
        match(manager, "f:f%d" % number, "b:never%d" % number, 0.9, now)
        match(manager, "f:f%d" % number, "p:p%d" % number, 0.9, now)
        manager.on_place(PlaceSource.FACE, "f%d" % number, place(1.0, now), now)
        manager.tick(now)
    manager.on_tracked(Kind.FACE, [], 3000.0)
    manager.tick(3011.0)
    manager.tick(3020.0)
    assert len(manager.snapshot(3010.0).persons) == MAX_UNSEEN_PERSONS
    assert len(manager.snapshot(3010.0).known) == 2000
    assert manager.groups == ()


# -- Matches with an anonymous person, as of a body that comes back in the same clothes.

def test_an_anonymous_person_keeps_a_feature_that_is_said_not_to_be_its_own_as_long_as_it_is_nobody_elses():
    manager = make(new_person_delay=0.0, bodies=["b1"])
    match(manager, "b:b1", "p:" + A1, 0.0, 1.0)
    manager.on_tracked(Kind.FACE, ["f1"], 2.0)
    match(manager, "f:f1", "b:b1", 0.9, 2.1)
    assert people(manager, 2.1) == {A1: ("f1", "b1", "", 0.0)}


def test_a_lost_anonymous_person_goes_on_with_a_feature_that_a_match_gives_it():
    manager = make(bodies=["b1"])
    manager.tick(1.0)
    manager.on_tracked(Kind.BODY, [], 1.0)
    manager.on_tracked(Kind.BODY, ["b2"], 3.0)
    assert match(manager, "b:b2", "p:" + A1, 0.7, 3.1)
    assert people(manager, 3.1) == {A1: ("", "b2", "", 0.0)}
    manager.tick(9.0)
    assert manager.snapshot(9.0).known == (A1,)


def test_a_feature_that_is_a_person_already_is_joined_with_the_anonymous_one_and_can_be_parted():
    manager = make(new_person_delay=0.0, bodies=["b1"])
    manager.on_tracked(Kind.BODY, [], 1.0)
    manager.on_tracked(Kind.BODY, ["b2"], 3.0)
    assert manager.snapshot(3.0).tracked == (A2,)
    match(manager, "b:b2", "p:" + A1, 0.7, 3.1)
    assert manager.snapshot(3.1).tracked == (A1,)
    match(manager, "b:b2", "p:" + A1, 0.0, 3.2)
    assert manager.snapshot(3.2).tracked == (A2,)


def test_an_anonymous_person_that_is_seen_is_joined_with_the_new_feature():
    manager = make(faces=["f1"])
    manager.tick(1.0)
    manager.on_tracked(Kind.BODY, ["b2"], 1.0)
    match(manager, "b:b2", "p:" + A1, 0.7, 1.1)
    assert people(manager, 1.1) == {A1: ("f1", "b2", "", 0.0)}


@pytest.mark.parametrize("likelihood, person", [(0.4, A1), (0.9, "anonymous_person_zzzzz")])
def test_a_claim_that_is_unlikely_or_of_somebody_who_never_was_changes_nothing(likelihood, person):
    manager = make(bodies=["b1"])
    manager.tick(1.0)
    manager.on_tracked(Kind.BODY, [], 1.0)
    manager.on_tracked(Kind.BODY, ["b2"], 3.0)
    assert not match(manager, "b:b2", "p:" + person, likelihood, 3.1)
    manager.tick(4.0)
    assert manager.snapshot(4.0).tracked == (A2,)


def test_a_claim_brings_nobody_back_who_is_forgotten():
    manager = make(half_life=0.1, bodies=["b1"])
    manager.tick(1.0)
    manager.on_tracked(Kind.BODY, [], 1.0)
    manager.tick(5.0)
    assert manager.snapshot(5.0).known == ()
    manager.on_tracked(Kind.BODY, ["b2"], 5.0)
    assert not match(manager, "b:b2", "p:" + A1, 0.9, 5.1)


# -- Links that are told again, and many ids that all match each other.

@pytest.mark.parametrize("body_first", [False, True])
def test_a_link_that_is_told_again_has_the_new_likelihood(body_first):
    manager = make(new_person_delay=0.0, faces=["f1", "f2"], bodies=["b1"])
    if body_first:
        match(manager, "f:f1", "b:b1", 0.9, 0.0)
    match(manager, "f:f1", "p:ann", 0.9, 0.0)
    match(manager, "f:f2", "p:ann", 0.8, 0.0)
    assert people(manager, 0.0)["ann"][0] == "f1"
    match(manager, "f:f1", "p:ann", 0.7, 1.0)
    assert people(manager, 1.0)["ann"][0] == "f2", "told lower, above the threshold"
    match(manager, "p:ann", "f:f1", 0.95, 2.0)
    assert people(manager, 2.0)["ann"][0] == "f1", "told higher, the other way round"
    match(manager, "f:f1", "p:ann", 0.5, 3.0)
    match(manager, "f:f2", "p:ann", 0.4, 3.0)
    assert people(manager, 3.0)["ann"][0] == "f1"
    match(manager, "f:f1", "p:ann", 0.45, 4.0)
    assert people(manager, 4.0)["ann"][0] == "", "told below the threshold"


def test_a_voice_of_an_anonymous_person_that_is_told_again_has_the_new_likelihood():
    manager = make(new_person_delay=0.0, bodies=["b1"], voices=["v1"])
    match(manager, "v:v1", "p:" + A1, 0.9, 0.1)
    assert people(manager, 0.1)[A1][:3] == ("", "b1", "v1")
    manager.on_tracked(Kind.FACE, ["f1"], 0.2)
    match(manager, "f:f1", "b:b1", 0.9, 0.2)
    match(manager, "v:v1", "p:" + A1, 0.3, 0.3)
    assert people(manager, 0.3)[A1][:3] == ("f1", "b1", "")


def all_linked(count, likelihood):
    """A manager with so many ids of each kind that all match, by one change; and how to change one match."""
    manager = make(match_threshold=0.99)
    ids = {kind: ["%s%d" % (kind.name[0].lower(), number) for number in range(count)] for kind in Kind}
    manager.know(ids[Kind.PERSON])
    for kind in (Kind.FACE, Kind.BODY, Kind.VOICE):
        manager.on_tracked(kind, ids[kind], 0.0)
    pairs = [(MatchNode(one, first), MatchNode(two, second)) for one, two in itertools.combinations(Kind, 2)
             for first, second in itertools.product(ids[one], ids[two])]
    for first, second in pairs:
        manager.on_match(CandidateMatch(first, second, likelihood()), 0.0)
    manager.reconfigure(PERSON_MANAGER_PARAMETERS.resolve({}), 1.0)
    return manager, pairs


@pytest.mark.parametrize("spread", [0.0, 0.4], ids=["alike", "different"])
def test_a_change_costs_little_whatever_is_linked_with_whatever(spread):
    chance = random.Random(1)
    manager, pairs = all_linked(15, lambda: 0.55 + spread * chance.random())
    times = []
    for first, second in chance.sample(pairs, 10):
        begin = time.thread_time()
        manager.on_match(CandidateMatch(first, second, 0.55 + spread * chance.random()), 2.0)
        manager.on_match(CandidateMatch(first, second, 0.3), 2.0)
        times.append((time.thread_time() - begin) / 2.0)
    assert sorted(times)[5] < 0.1
    assert len(manager.groups) == 15 and all(len(group) == 4 for group in manager.groups)


def test_it_is_said_that_groups_are_not_proved_until_these_ids_have_gone():
    chance = random.Random(3)
    manager, _ = all_linked(9, lambda: 0.5 + 0.45 * chance.random())
    assert not manager.exact
    match(manager, "f:other", "b:other", 0.9, 2.0)
    assert people(manager, 3.0) and not manager.exact, "what is solved elsewhere says nothing of these"
    for kind in (Kind.FACE, Kind.BODY, Kind.VOICE):
        manager.on_tracked(kind, [], 3.0)
    assert manager.exact


# -- Merging through aliases, and what is kept of it.

class Shelf:
    """A store in memory."""

    def __init__(self):
        self.records = {}

    def load_records(self):
        return list(self.records.values())

    def write(self, change):
        self.records.update(change.records)
        return []


class Kept:
    """A manager and a register with its store, as the node uses them."""

    def __init__(self, shelf):
        self.shelf, self.manager, self.register = shelf, make(new_person_delay=0.0), PersonRegister(shelf)
        self.manager.know(record.id for record in self.register.records)
        for record in self.register.records:
            if record.alias:
                self.manager.merge(record.alias, record.id, 0.0)

    def know(self, *persons):
        self.manager.know(persons)
        self.register.seen(persons, 1.0)
        self.register.flush()

    def merge(self, person_id, other):
        answer = self.manager.merge(person_id, other, 0.0)
        self.keep(person_id, other, *answer)
        return answer

    def keep(self, *changed):
        self.register.keep_aliases(filter(self.manager.is_permanent, changed), self.manager.representative, 1.0)
        self.register.flush()

    def shown(self):
        """Who stands for each person when all are seen."""
        faces = {"f_" + person: person for person in self.shelf.records}
        self.manager.on_tracked(Kind.FACE, sorted(faces), 1.0)
        for feature, person in faces.items():
            match(self.manager, "f:" + feature, "p:" + person, 0.9, 1.0)
        return {state.id: state.alias or state.id for state in self.manager.snapshot(1.0).persons
                if not state.anonymous}


@pytest.mark.parametrize("seen", [False, True])
def test_a_merge_through_an_alias_joins_those_who_stand_for_both_also_after_a_restart(seen):
    kept = Kept(Shelf())
    kept.know("ann", "bob", "cyd", "dan", "eve")
    if seen:
        kept.shown()
    assert kept.merge("ann", "bob") == ("ann", "bob")
    assert kept.merge("cyd", "bob") == ("cyd", "ann")
    assert kept.merge("eve", "dan") == ("eve", "dan")
    assert kept.merge("bob", "dan") == ("cyd", "eve")
    everybody = dict.fromkeys(("ann", "bob", "cyd", "dan", "eve"), "cyd")
    assert kept.shown() == everybody
    assert {record.id: record.alias or record.id for record in kept.shelf.records.values()} == everybody
    assert Kept(kept.shelf).shown() == everybody


def test_whoever_is_to_stand_for_a_union_of_which_it_is_an_alias_does():
    kept = Kept(Shelf())
    kept.know("ann", "bob", "cyd")
    kept.merge("ann", "bob")
    kept.merge("ann", "cyd")
    assert kept.merge("bob", "ann") == ("bob", "ann")
    assert kept.shown() == Kept(kept.shelf).shown() == dict.fromkeys(("ann", "bob", "cyd"), "bob")


@pytest.mark.parametrize("parted", ["ann", "bob", "cyd"])
def test_what_is_split_is_the_same_after_a_restart(parted):
    kept = Kept(Shelf())
    kept.know("ann", "bob", "cyd")
    kept.merge("ann", "bob")
    kept.merge("cyd", "bob")
    kept.manager.split(parted, 1.0)
    kept.keep(parted)
    before = kept.shown()
    assert before[parted] == parted and [*before.values()].count(parted) == 1
    assert Kept(kept.shelf).shown() == before


def test_a_merge_with_what_features_have_made_an_alias_goes_to_its_target():
    manager = make(new_person_delay=0.0, faces=["f1"], bodies=["b1"])
    match(manager, "f:f1", "b:b1", 0.9, 1.0)
    assert {state.id: state.alias for state in manager.snapshot(1.0).persons} == {A1: "", A2: A1}
    manager.know(["ann"])
    assert manager.merge("ann", A2, 1.0) == ("ann", A1)
    assert people(manager, 1.0) == {"ann": ("f1", "b1", "", 0.0)}


def test_permanent_persons_whom_nobody_sees_stay_after_time_has_jumped_back():
    manager = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["f1", "f2"], 100.0)
    match(manager, "f:f1", "p:ann", 0.9, 100.0)
    match(manager, "f:f2", "p:bob", 0.9, 100.0)
    manager.on_place(PlaceSource.FACE, "f1", place(1.0, 100.0), 100.0)
    manager.on_tracked(Kind.FACE, ["f2"], 101.0)
    manager.tick(200.0)
    assert set(people(manager, 200.0)) == {"ann", "bob"}
    manager.rewind(40.0)
    assert people(manager, 40.0) == {"ann": ("", "", "", 0.0), "bob": ("f2", "", "", 0.0)}
    manager.tick(41.0)
    assert set(people(manager, 41.0)) == {"ann", "bob"} and manager.snapshot(41.0).tracked == ("bob",)


# -- sources that lag, on a loaded machine

CAMERA = "camera_optical_frame"


def lagging(lag, body_period=0.2, delay=0.0):
    """A manager that has followed a face in time, of f1, and a body b2 of somebody else, `lag` s late, for 20 s."""
    manager = make(new_person_delay=delay, half_life=2.0, faces=["f1"], bodies=["b2"])
    now, body_at = 0.0, 0.0
    while now < 20.0:
        manager.on_place(PlaceSource.FACE, "f1", place(1.0, now - 0.05), now, CAMERA)
        if now >= body_at:
            body_at += body_period
            manager.on_place(PlaceSource.BODY, "b2", place(3.0, now - lag), now, CAMERA)
        manager.tick(now)
        now = round(now + 0.1, 6)
    return manager


def of_body(manager, now):
    (found,) = [state[3] for state in people(manager, now).values() if state[1] == "b2"]
    return found


def test_who_was_last_seen_in_an_old_image_is_not_as_sure_as_who_is_seen_now():
    assert of_body(lagging(0.3), 20.0) == 1.0
    assert of_body(lagging(3.05), 19.8) == pytest.approx(0.5)     # 2 s after the second that counts as now


def test_a_body_that_comes_rarely_counts_as_now_for_two_seconds_at_most():
    manager = lagging(0.05, body_period=2.0)
    assert (of_body(manager, 19.9), of_body(manager, 20.5)) == (1.0, pytest.approx(0.5 ** 0.25, abs=0.03))


def test_a_clock_that_is_off_or_a_bag_that_pauses_is_no_lag():
    manager = make(new_person_delay=0.0, half_life=2.0, faces=["f1"])
    for begin, age in ((10.0, 3.0), (20.0, 1000.0), (40.0, -7.0), (60.0, 1.5), (180.0, 2.5)):
        for number in range(50):
            now = begin + 0.1 * number
            manager.on_place(PlaceSource.FACE, "f1", place(1.0, now - age), now, CAMERA)
        if age != 1.5:      # for a minute that is a lag
            assert confidences(manager, now + 0.5) == [1.0], age


def test_nobody_is_born_of_one_image_that_is_old():
    manager = lagging(3.0, delay=0.4)
    manager.on_tracked(Kind.BODY, ["b2", "b3", "b4"], 20.0)
    for body in ("b3", "b4"):
        manager.on_place(PlaceSource.BODY, body, place(9.0, 17.0), 20.0, CAMERA)
    manager.tick(20.5)
    assert len(people(manager, 20.5)) == 2
    manager.on_tracked(Kind.BODY, ["b2", "b4"], 20.6)       # the next image does not show b3 any more
    manager.on_place(PlaceSource.BODY, "b4", place(9.0, 17.5), 20.6, CAMERA)
    manager.tick(20.7)
    assert {state[1] for state in people(manager, 20.7).values()} == {"", "b2", "b4"}
