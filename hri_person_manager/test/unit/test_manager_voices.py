"""Voices and persons: every combination of identifiers, turns with ids of their own, and speakers whom nobody sees."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.location import Place, PlaceSource
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_pipeline.core.geometry import Pose

A1, A2 = "anonymous_person_a0001", "anonymous_person_a0002"
KINDS = {"f": Kind.FACE, "b": Kind.BODY, "v": Kind.VOICE, "p": Kind.PERSON}


def make(**given):
    numbers = itertools.count(1)
    return PersonManager(PERSON_MANAGER_PARAMETERS.resolve(given), new_id=lambda: "a%04d" % next(numbers))


def match(manager, first, second, likelihood, now):
    nodes = [MatchNode(KINDS[text[0]], text if text[0] != "p" else text[2:]) for text in (first, second)]
    return manager.on_match(CandidateMatch(nodes[0], nodes[1], likelihood), now)


def people(manager, now):
    """Return {id: (face, body, voice)} of all persons but aliases."""
    return {state.id: (state.face, state.body, state.voice) for state in manager.snapshot(now).persons
            if not state.alias}


def place(x, stamp):
    return Place("map", Pose(np.eye(3), np.array([x, 0.0, 0.0])), stamp)


def see(manager, now, faces=(), bodies=(), voices=()):
    for kind, ids in ((Kind.FACE, faces), (Kind.BODY, bodies), (Kind.VOICE, voices)):
        manager.on_tracked(kind, ids, now)


@pytest.mark.parametrize("face, body, voice, named", list(itertools.product((0, 1), repeat=4)))
def test_every_combination_of_identifiers(face, body, voice, named):
    manager = make()
    present = [name for name, wanted in (("f1", face), ("b1", body), ("v1", voice)) if wanted]
    see(manager, 0.0, ["f1"] * face, ["b1"] * body, ["v1"] * voice)
    for first, second in zip(present, present[1:]):
        match(manager, first, second, 0.9, 0.1)
    if named:
        match(manager, present[0] if present else "f0", "p:ann", 0.9, 0.1)
        if not present:
            see(manager, 0.2)      # known by a face that has left
    manager.tick(3.0)
    features = ("f1" * face, "b1" * body, "v1" * voice)
    assert people(manager, 3.0) == ({"ann" if named else A1: features} if present or named else {})


@pytest.mark.parametrize("all_wait, voices_wait", [(0.5, 2.0), (2.0, 0.5)])
def test_a_voice_alone_is_a_person_after_a_grace_in_which_the_mouths_are_compared(all_wait, voices_wait):
    manager = make(new_person_delay=all_wait, voice_person_delay=voices_wait)
    see(manager, 0.0, voices=["v1"])
    manager.tick(1.9)
    assert people(manager, 1.9) == {}
    manager.tick(2.0)
    assert people(manager, 2.0) == {A1: ("", "", "v1")}


def test_a_voice_that_is_matched_in_time_makes_no_person_of_its_own():
    manager = make()
    see(manager, 0.0, faces=["f1"])
    manager.tick(1.0)
    see(manager, 5.0, faces=["f1"], voices=["v1"])
    manager.tick(6.0)
    match(manager, "v1", "f1", 0.8, 6.1)
    manager.tick(20.0)
    assert people(manager, 20.0) == {A1: ("f1", "", "v1")}
    assert manager.snapshot(20.0).known == (A1,)


def test_a_voice_that_is_matched_late_makes_its_person_an_alias_and_is_it_again_when_the_match_is_withdrawn():
    manager = make()
    see(manager, 0.0, faces=["f1"])
    manager.tick(1.0)
    see(manager, 1.0, faces=["f1"], voices=["v1"])
    manager.tick(4.0)
    assert people(manager, 4.0) == {A1: ("f1", "", ""), A2: ("", "", "v1")}
    match(manager, "v1", "f1", 0.8, 4.5)
    assert people(manager, 4.5) == {A1: ("f1", "", "v1")}
    assert {state.id: state.alias for state in manager.snapshot(4.5).persons} == {A1: "", A2: A1}
    match(manager, "v1", "f1", 0.0, 5.0)
    assert people(manager, 5.0) == {A1: ("f1", "", ""), A2: ("", "", "v1")}


def test_a_voice_that_ends_leaves_an_empty_id_and_the_person():
    manager = make()
    see(manager, 0.0, faces=["f1"], voices=["v1"])
    match(manager, "v1", "f1", 0.8, 0.1)
    manager.tick(1.0)
    see(manager, 2.0, faces=["f1"])
    assert people(manager, 2.0) == {A1: ("f1", "", "")}


def test_turns_with_an_id_each_are_one_person_and_the_last_turn_is_its_voice():
    manager = make()
    see(manager, 0.0, faces=["f1"], voices=["v1"])
    match(manager, "v1", "f1", 0.9, 0.2)
    manager.tick(1.0)
    see(manager, 4.0, faces=["f1"], voices=["v1", "v2"])       # the first turn's voice is tracked a little longer
    match(manager, "v2", "f1", 0.8, 4.8)
    match(manager, "v1", "f1", 0.72, 4.8)
    for now in (5.0, 7.5, 20.0):
        manager.tick(now)
        assert people(manager, now) == {A1: ("f1", "", "v2")}
    see(manager, 21.0, faces=["f1"], voices=["v2"])
    assert people(manager, 21.0) == {A1: ("f1", "", "v2")}


def test_an_earlier_voice_that_is_withdrawn_altogether_is_somebody_unseen():
    manager = make()
    see(manager, 0.0, faces=["f1"], voices=["v1", "v2"])
    match(manager, "v2", "f1", 0.9, 0.1)
    match(manager, "v1", "f1", 0.8, 0.1)
    manager.tick(10.0)
    assert people(manager, 10.0) == {A1: ("f1", "", "v2")}
    match(manager, "v1", "f1", 0.0, 10.0)
    manager.tick(12.5)
    assert people(manager, 12.5) == {A1: ("f1", "", "v2"), A2: ("", "", "v1")}


def test_a_second_voice_takes_over_when_the_first_is_gone():
    manager = make()
    see(manager, 0.0, faces=["f1"], voices=["v1", "v2"])
    match(manager, "v2", "f1", 0.9, 0.1)
    match(manager, "v1", "f1", 0.8, 0.1)
    manager.tick(5.0)
    see(manager, 6.0, faces=["f1"], voices=["v1"])
    assert people(manager, 6.0) == {A1: ("f1", "", "v1")}


def test_a_speaker_who_turns_away_stays_the_same_person_and_gets_the_next_face():
    manager = make()
    see(manager, 0.0, faces=["f1"], voices=["v1"])
    match(manager, "v1", "f1", 0.9, 0.1)
    manager.tick(1.0)
    see(manager, 2.0, voices=["v1"])
    assert people(manager, 2.0) == {A1: ("", "", "v1")}
    see(manager, 3.0, faces=["f2"], voices=["v1"])
    match(manager, "v1", "f2", 0.8, 3.3)
    manager.tick(9.0)
    assert people(manager, 9.0) == {A1: ("f2", "", "v1")}


def test_a_voice_by_its_direction_goes_to_the_body_of_a_person_without_a_person_in_between():
    manager = make()
    see(manager, 0.0, bodies=["b1"])
    manager.tick(1.0)
    see(manager, 2.0, bodies=["b1"], voices=["v1"])
    match(manager, "v1", "p:" + A1, 0.8, 2.2)
    assert people(manager, 2.2) == {A1: ("", "b1", "v1")}
    assert [state.id for state in manager.snapshot(2.2).persons] == [A1]
    match(manager, "v1", "p:" + A1, 0.0, 3.0)
    manager.tick(6.0)
    assert people(manager, 6.0) == {A1: ("", "b1", ""), A2: ("", "", "v1")}


@pytest.mark.parametrize("known", [False, True])
def test_a_voice_that_is_taken_back_from_who_is_lost_makes_nobody_else_of_who_was_seen_before(known):
    manager = make()
    see(manager, 0.0, faces=["f1", "f2"])
    if known:
        match(manager, "f2", "p:ann", 0.9, 0.1)
    manager.on_place(PlaceSource.FACE, "f1", place(1.0, 0.0), 0.0)
    manager.tick(1.0)
    see(manager, 2.0, faces=["f2"], voices=["v1"])
    match(manager, "v1", "p:" + A1, 0.7, 2.1)
    other = "ann" if known else A2
    assert people(manager, 2.1) == {A1: ("", "", "v1"), other: ("f2", "", "")}
    match(manager, "v1", "p:" + A1, 0.0, 3.0)
    match(manager, "v1", "f2", 0.9, 3.0)
    manager.tick(3.1)
    assert people(manager, 3.1) == {A1: ("", "", ""), other: ("f2", "", "v1")}
    assert manager.snapshot(3.1).tracked == (other,)


def test_the_face_of_somebody_lost_who_spoke_on_is_the_same_person():
    manager = make()
    see(manager, 0.0, faces=["f1"])
    manager.on_place(PlaceSource.FACE, "f1", place(1.0, 0.0), 0.0)
    manager.tick(1.0)
    see(manager, 2.0, voices=["v1"])
    match(manager, "v1", "p:" + A1, 0.7, 2.1)
    see(manager, 3.0, faces=["f2"], voices=["v1"])
    manager.tick(6.0)
    match(manager, "v1", "p:" + A1, 0.0, 6.1)
    match(manager, "v1", "f2", 0.9, 6.1)
    assert people(manager, 6.1) == {A1: ("f2", "", "v1")}


def test_who_only_speaks_is_somebody_new_the_next_time():
    manager = make()
    see(manager, 0.0, voices=["v1"])
    manager.tick(2.5)
    see(manager, 5.0)
    manager.tick(5.1)
    assert people(manager, 5.1) == {}
    see(manager, 6.0, voices=["v2"])
    manager.tick(9.0)
    assert people(manager, 9.0) == {A2: ("", "", "v2")}


def test_who_only_speaks_from_a_place_is_who_he_was_when_a_match_with_that_place_says_so():
    manager = make()
    see(manager, 0.0, voices=["v1"])
    manager.tick(2.5)
    assert manager.on_place(PlaceSource.VOICE, "v1", place(1.0, 2.5), 2.5) == A1
    see(manager, 5.0)
    see(manager, 8.0, voices=["v2"])
    match(manager, "v2", "p:" + A1, 0.8, 8.5)
    manager.tick(12.0)
    assert people(manager, 12.0) == {A1: ("", "", "v2")}
    assert manager.on_place(PlaceSource.VOICE, "v2", place(1.1, 12.0), 12.0) == A1


def test_a_recogniser_of_voices_makes_a_permanent_person_of_all_turns():
    manager = make()
    for number in range(3):
        now = 10.0 * number
        see(manager, now, voices=["v%d" % number])
        match(manager, "v%d" % number, "p:ann", 0.9, now + 1.0)
        assert people(manager, now + 1.0) == {"ann": ("", "", "v%d" % number)}
        see(manager, now + 5.0)
    assert people(manager, 26.0) == {"ann": ("", "", "")}


def sizes(manager):
    """Number of things in all containers that the manager holds, by owner."""
    found, seen, pending = 0, set(), [manager]
    while pending:
        thing = pending.pop()
        if id(thing) in seen or isinstance(thing, (str, bytes, type, np.ndarray)):
            continue
        seen.add(id(thing))
        if isinstance(thing, dict):
            found += len(thing)
            pending += list(thing.keys()) + list(thing.values())
        elif isinstance(thing, (list, tuple, set, frozenset)) or hasattr(thing, "popleft"):
            found += len(thing)
            pending += list(thing)
        elif type(thing).__module__.startswith("hri_person_manager"):
            pending.append(getattr(thing, "__dict__", {}))
    return found


@pytest.mark.slow("thousands of turns")
def test_thousands_of_turns_leave_nothing_behind():
    manager = make()
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    counts = {}
    for number in range(4000):
        now, voice = 2.0 * number, "v%d" % number
        manager.on_tracked(Kind.VOICE, [voice], now)
        if number % 3 == 0:
            match(manager, voice, "f1", 0.8, now + 1.0)
        manager.tick(now + 1.9)
        manager.on_tracked(Kind.VOICE, [voice, "w%d" % number], now + 1.95)
        match(manager, voice, "f1", 0.0, now + 1.95)
        counts[number] = None if number % 1000 != 999 else sizes(manager)
    # Of those who left, 2000 are remembered so that a late match does not bring them back.
    assert counts[3999] <= counts[1999] + 20
    assert set(people(manager, 8000.0)) == {A1} and people(manager, 8000.0)[A1][0] == "f1"


def of_the_voice(manager):
    return manager.person_of(MatchNode(Kind.VOICE, "v1"))


@pytest.mark.parametrize("said", [
    lambda turn: [("v1", "f1", 0.9 if turn else 0.0)],
    lambda turn: [("v1", "f1", 0.9 if turn else 0.7), ("v1", "f2", 0.7 if turn else 0.9)],
    lambda turn: [("v1", "f1", 0.9 if turn else 0.0), ("v1", "f2", 0.0 if turn else 0.9)]],
    ids=["yes and no", "now this one, now that one", "withdrawn for the other one"])
def test_two_clients_that_contradict_each_other_a_hundred_times_a_second_move_a_voice_a_few_times_only(said):
    manager = make()
    see(manager, 0.0, faces=["f1", "f2"], voices=["v1"])
    manager.tick(0.5)
    owners = []
    for step in range(1000):
        now = 1.0 + 0.01 * step
        for words in said(step % 2):
            match(manager, *words, now)
        if step % 10 == 0:
            manager.tick(now)
        owners.append(of_the_voice(manager))
    assert sum(one != other for one, other in zip(owners, owners[1:])) <= 14
    # The last word counts when one of them is silent.
    for words in said(1):
        match(manager, *words, 11.0)
    manager.tick(13.1)
    assert of_the_voice(manager) == A1
    manager.tick(30.0)
    for words in said(0):
        match(manager, *words, 30.0)
    assert of_the_voice(manager) != A1, "later on nothing waits"


@pytest.mark.parametrize("said", [
    lambda turn: [("f1", "p:ann", 0.9), ("f2", "p:bob", 0.9), ("p:ann", "p:bob", 0.9 if turn else 0.0)],
    lambda turn: [("f2", "p:" + A1, 0.9 if turn else 0.0)],
    lambda turn: [("f1", "p:ann", 0.9 if turn else 0.6), ("f1", "p:bob", 0.6 if turn else 0.9)],
    lambda turn: [("f1", "b1", 0.9 if turn else 0.0)]],
    ids=["of two names", "of somebody anonymous", "of a face's name", "of face and body"])
def test_contradictions_do_not_change_what_is_published_with_each_message(said):
    manager = make()
    see(manager, 0.0, faces=["f1", "f2"], bodies=["b1"])
    manager.tick(0.5)
    states = []
    for step in range(1000):
        now = 1.0 + 0.01 * step
        for words in said(step % 2):
            match(manager, *words, now)
        if step % 10 == 5:
            manager.tick(now)
        states.append([state[:4] + (state.alias, ) for state in manager.snapshot(now).persons])
    assert sum(one != other for one, other in zip(states, states[1:])) <= 20
    for turn in (0, 1, 0):      # the last word counts, whatever was said before
        now += 30.0
        for words in said(turn):
            match(manager, *words, now)
        expected = people(manager, now)
        for step in range(10):
            for words in said(step % 2 if turn else 1 - step % 2):
                match(manager, *words, now + 0.1 * step)
        for words in said(turn):
            match(manager, *words, now + 1.0)
        manager.tick(now + 6.0)
        assert people(manager, now + 6.0) == expected


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 0, 3, 1), (3, 2, 1, 0)])
@pytest.mark.parametrize("least", [0.0, 0.2, 0.6])
@pytest.mark.parametrize("count", range(14, 20))
def test_two_names_that_a_recogniser_swaps_for_good_wait_one_second_at_most(count, least, order):
    """After as many changes as are let through at once; nothing contradicts the last one."""
    manager, now = make(), 0.5
    see(manager, 0.0, faces=["f1", "f2"])
    for number in range(count):
        now += 0.25
        one, other = ("ann", "bob") if number % 2 else ("bob", "ann")
        said = [("f1", one, 0.9), ("f1", other, least), ("f2", other, 0.9), ("f2", one, least)]
        for index in order:
            face, name, likelihood = said[index]
            match(manager, face, "p:" + name, likelihood, now)
        manager.tick(now)
    manager.tick(now + 1.01)
    assert people(manager, now + 1.01) == {one: ("f1", "", ""), other: ("f2", "", "")}


@pytest.mark.parametrize("period", [1.05, 1.1, 1.3, 1.7])
def test_two_who_contradict_each_other_slowly_and_withdraw_each_time_change_a_name_a_few_times_only(period):
    """What is let through sooner, and withdrawn after it, counts twice."""
    manager, owners = make(), []
    see(manager, 0.0, faces=["f1"])
    for step in range(780):
        now = 0.5 + 0.1 * step
        if int(now / period) != int((now - 0.1) / period):
            one, other = ("ann", "bob") if int(now / period) % 2 else ("bob", "ann")
            match(manager, "f1", "p:" + other, 0.0, now)
            match(manager, "f1", "p:" + one, 0.9, now)
        manager.tick(now)
        owners.append(manager.person_of(MatchNode(Kind.FACE, "f1")))
    assert sum(one != other for one, other in zip(owners, owners[1:])) <= 8 + 4 + 39 + 8


@pytest.mark.parametrize("pair, known", [(("f1", "p:ann"), ()), (("p:ann", "p:bob"), ("ann", "bob"))],
                         ids=["a name", "two who are one"])
def test_what_is_withdrawn_does_not_wait(pair, known):
    """Whatever was said before: somebody under a wrong name is worse than somebody without."""
    manager = make()
    manager.know(known)
    see(manager, 0.0, faces=["f1", "f2"])
    manager.tick(0.5)
    for feature, name in zip(("f1", "f2"), known):
        match(manager, feature, "p:" + name, 0.9, 0.6)
    for step in range(40):
        match(manager, *pair, 0.9 if step % 2 else 0.0, 1.0 + 0.1 * step)
        manager.tick(1.0 + 0.1 * step)
        first, second = (manager.person_of(MatchNode(Kind.FACE, face)) for face in ("f1", "f2"))
        assert step % 2 or first != (second if known else "ann")


def test_voices_that_come_and_go_keep_no_name_waiting():
    manager = make()
    see(manager, 0.0, faces=["f1"], voices=["v1"])
    manager.tick(0.5)
    for step in range(100):
        match(manager, "v1", "f1", 0.9 if step % 2 else 0.0, 1.0 + 0.01 * step)
    match(manager, "f1", "p:ann", 0.9, 2.0)
    assert people(manager, 2.0)["ann"][0] == "f1"


def test_a_feature_that_matches_call_and_withdraw_leaves_nothing_and_holds_nobody_up():
    """It is in no list: a match makes it exist, and the withdrawal ends it."""
    manager = make()
    see(manager, 0.0, faces=["f1"], voices=["v2"])
    manager.tick(0.5)
    changes, last = 0, None
    for step in range(2000):
        match(manager, "v1", "f1", 0.0 if step % 2 else 0.9, 1.0 + 0.01 * step)
        manager.tick(1.0 + 0.01 * step)
        changes, last = changes + (people(manager, 1.0) != last), people(manager, 1.0)
        if step % 2:
            assert manager.person_of(MatchNode(Kind.VOICE, "v1")) is None
    assert changes <= 30
    match(manager, "v2", "f1", 0.9, 21.0)
    manager.tick(26.0)
    assert ("f1", "", "v2") in people(manager, 26.0).values()


def test_matches_of_one_moment_do_not_wait_for_each_other():
    manager = make()
    see(manager, 0.0, faces=["f1"], bodies=["b1", "b2"], voices=["v1", "v2"])
    manager.tick(0.5)
    for words in (("f1", "b1", 0.9), ("v1", "f1", 0.8), ("f1", "p:ann", 0.9), ("v1", "f1", 0.0), ("v2", "f1", 0.9),
                  ("f1", "b1", 0.0), ("f1", "b2", 0.9)):
        match(manager, *words, 1.0)
    assert people(manager, 1.0)["ann"] == ("f1", "b2", "v2")


@pytest.mark.parametrize("delay, others", [(2.0, 3), (4.0, 0)])
def test_an_enrolled_voice_that_nobody_sees_is_one_person_in_all_turns(delay, others):
    manager = make(voice_person_delay=delay)
    told = set()
    for turn in range(3):
        for step in range(100):
            now = 10.0 * turn + 0.1 * step
            see(manager, now, voices=["v%d" % turn] if step < 80 else [])
            if step == 34:      # after 3.2 s of speech
                match(manager, "v%d" % turn, "p:ann", 0.95, now)
            manager.tick(now)
            told.update(manager.snapshot(now).tracked)
            if 34 <= step < 80:
                assert people(manager, now) == {"ann": ("", "", "v%d" % turn)}
    assert "ann" in told and len(told) == 1 + others
