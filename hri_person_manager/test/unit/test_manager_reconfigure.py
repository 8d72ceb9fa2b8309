"""Parameters of the manager that change while it runs: who belongs together is solved anew, persons stay."""

import itertools

import pytest

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch, MatchGuard
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.proxemics import Proxemics, Space

FACE, BODY = MatchNode(Kind.FACE, "face1"), MatchNode(Kind.BODY, "body1")


def make(**given):
    numbers = itertools.count(1)
    settings = PERSON_MANAGER_PARAMETERS.resolve(given)
    return PersonManager(settings, new_id=lambda: "a%04d" % next(numbers)), settings


def change(manager, settings, now, **changes):
    changed = PERSON_MANAGER_PARAMETERS.changed(settings, changes)
    manager.reconfigure(changed, now)
    return changed


def features(manager, now):
    return sorted((state.face, state.body) for state in manager.snapshot(now).persons if not state.alias)


def test_a_higher_threshold_parts_and_a_lower_one_joins_again():
    manager, settings = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["face1"], 0.0)
    manager.on_tracked(Kind.BODY, ["body1"], 0.0)
    manager.on_match(CandidateMatch(FACE, BODY, 0.8), 0.0)
    manager.tick(0.1)
    before = manager.snapshot(0.1).tracked
    assert features(manager, 0.1) == [("face1", "body1")]
    settings = change(manager, settings, 0.2, match_threshold=0.9)
    manager.tick(0.2)
    assert features(manager, 0.2) == [("", "body1"), ("face1", "")]
    change(manager, settings, 0.3, match_threshold=0.7)
    manager.tick(0.3)
    assert features(manager, 0.3) == [("face1", "body1")]
    assert manager.snapshot(0.3).tracked == before


def test_a_named_person_stays_and_the_union_of_two_goes_by_the_threshold():
    manager, settings = make()
    manager.on_tracked(Kind.FACE, ["face1", "face2"], 0.0)
    manager.on_match(CandidateMatch(FACE, MatchNode(Kind.PERSON, "ann"), 0.95), 0.0)
    manager.on_match(CandidateMatch(MatchNode(Kind.FACE, "face2"), MatchNode(Kind.PERSON, "bea"), 0.95), 0.0)
    manager.on_match(CandidateMatch(MatchNode(Kind.PERSON, "ann"), MatchNode(Kind.PERSON, "bea"), 0.8), 0.0)
    assert manager.snapshot(0.1).tracked == ("ann",)
    change(manager, settings, 0.2, match_threshold=0.9)
    assert set(manager.snapshot(0.2).tracked) == {"ann", "bea"}


def test_whom_a_higher_threshold_takes_its_features_has_none():
    manager, settings = make(new_person_delay=0.0)
    manager.on_tracked(Kind.FACE, ["face1"], 0.0)
    manager.on_match(CandidateMatch(FACE, MatchNode(Kind.PERSON, "ann"), 0.6), 0.0)
    change(manager, settings, 0.1, match_threshold=0.7)
    manager.tick(0.2)
    assert features(manager, 0.2) == [("", ""), ("face1", "")], "the face is one person's"
    assert "ann" not in manager.snapshot(0.2).tracked


def test_delay_of_features_that_wait_already():
    manager, settings = make(new_person_delay=10.0)
    manager.on_tracked(Kind.FACE, ["face1"], 0.0)
    manager.tick(1.0)
    assert features(manager, 1.0) == []
    change(manager, settings, 1.0, new_person_delay=0.5)
    assert features(manager, 1.0) == [("face1", "")]


def test_rate_of_matches_and_borders_of_spaces():
    guard = MatchGuard(1.0)
    given = ("face1", int(Kind.FACE), "body1", int(Kind.BODY), 0.5)
    assert guard.check(*given, 0.0) and not guard.check(*given, 0.1)
    guard.limit.set_rate(100.0)
    assert guard.check(*given, 0.2)
    spaces = Proxemics(1.0, 3.0)
    assert spaces.update({"ann": 2.0})[Space.SOCIAL] == ["ann"]
    spaces.set_borders(2.5, 3.0)
    assert spaces.update({"ann": 2.0})[Space.PERSONAL] == ["ann"]
    with pytest.raises(ValueError):
        spaces.set_borders(3.5, 3.0)
    assert spaces.update({"ann": 2.0})[Space.PERSONAL] == ["ann"]
