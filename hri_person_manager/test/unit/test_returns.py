"""The head of the robot turns away and back: who is seen again at the same place is told as somebody else by no-one."""

from __future__ import annotations

import numpy as np
import pytest

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.location import Place, PlaceSource
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.core.waiting import RETURN_WAIT_S
from hri_pipeline.core.geometry import Pose

ANN = MatchNode(Kind.PERSON, "ann")
HERE, ELSEWHERE = (2.0, 0.5, 1.6), (2.0, -1.0, 1.6)
STEP_S, LEFT_S, BACK_S = 0.1, 5.0, 8.0


def persons(named_after, place=HERE, recognised=True, source=PlaceSource.FACE):
    """When (s after the return) there are which persons, besides Ann; her feature leaves and comes back as another.

    named_after: s after the return at which she is named, None for never.
    """
    manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}))
    kind = Kind.FACE if source == PlaceSource.FACE else Kind.BODY
    told = []
    for step in range(140):
        now = step * STEP_S
        name = "f1" if now < LEFT_S else "f2"
        ids = [] if LEFT_S <= now < BACK_S else [name]
        manager.on_tracked(kind, ids, now)
        for feature in ids:
            where = HERE if now < LEFT_S else place
            manager.on_place(source, feature, Place("map", Pose(np.eye(3), np.array(where)), now,
                                                    origin=np.array([0.0, 0.0, 1.4])), now, "camera")
        if (recognised and step == 10) or (named_after is not None and abs(now - BACK_S - named_after) < 0.5 * STEP_S):
            manager.on_match(CandidateMatch(MatchNode(kind, name), ANN, 0.9), now)
        manager.tick(now)
        if now >= BACK_S:
            told += [now - BACK_S for person in manager.snapshot(now).tracked if person != "ann"]
    return told


@pytest.mark.parametrize("source", [PlaceSource.FACE, PlaceSource.BODY])
def test_who_comes_back_is_nobody_else_until_recognised(source):
    assert persons(1.0, source=source) == []


def test_who_is_not_recognised_is_somebody_a_moment_later():
    assert RETURN_WAIT_S - STEP_S <= min(persons(None)) <= RETURN_WAIT_S + 4 * STEP_S


def test_somebody_at_another_place_does_not_wait():
    assert min(persons(None, place=ELSEWHERE)) < 0.7


def test_a_face_where_somebody_was_whom_nobody_knows_does_not_wait():
    assert min(persons(None, recognised=False)) < 0.7
