"""Rules of the person manager that need no master: who gets a name, how long one change takes, which feature places a
person."""

from __future__ import annotations

import itertools
import time
from functools import partial
from typing import Dict, List, Tuple

import numpy as np

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.location import Place, PlaceSource
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_pipeline.core.geometry import Pose

TWO_FACES = ((.55, .95), (.6, .99), (.55, .99), (.9, .95), (.51, .99))
"""Likelihoods that one person is the first face, and the second: the second is the likelier one."""
LINKED = 15
LATE_S = 0.65


def _manager() -> PersonManager:
    numbers = itertools.count()
    return PersonManager(PERSON_MANAGER_PARAMETERS.resolve({"new_person_delay": 0.0}),
                         new_id=lambda: "a%04d" % next(numbers))


def who_wins() -> int:
    """In how many of ten cases a name goes to the likelier of two faces, with and without a body and a voice on the
    other one."""
    return sum(_winner(first, second, followed) == "f2" for first, second in TWO_FACES for followed in (False, True))


def _winner(first: float, second: float, followed: bool) -> str:
    manager = _manager()
    lists: Dict[Kind, List[str]] = {Kind.FACE: ["f1", "f2"], Kind.BODY: ["b1"] * followed,
                                    Kind.VOICE: ["v1"] * followed}
    for kind, ids in lists.items():
        manager.on_tracked(kind, ids, 0.0)
    face, person = MatchNode(Kind.FACE, "f1"), MatchNode(Kind.PERSON, "p1")
    links = [(face, person, first), (MatchNode(Kind.FACE, "f2"), person, second)]
    if followed:
        links += [(face, MatchNode(Kind.BODY, "b1"), .9), (face, MatchNode(Kind.VOICE, "v1"), .9)]
    for link in links:
        manager.on_match(CandidateMatch(*link), 0.1)
    return next(state.face for state in manager.snapshot(0.2).persons if state.id == "p1")


def linked_ms(count: int = LINKED) -> float:
    """The longest change (ms) while `count` faces, bodies, voices and persons are all linked with each other."""
    rng, manager, longest = np.random.default_rng(1), _manager(), 0.0
    nodes = {kind: [MatchNode(kind, "%s%02d" % (kind.name[0].lower(), number)) for number in range(count)]
             for kind in Kind}
    for kind in (Kind.FACE, Kind.BODY, Kind.VOICE):
        manager.on_tracked(kind, [node.id for node in nodes[kind]], 0.0)
    pairs: List[Tuple[MatchNode, MatchNode]] = [pair for first, second in itertools.combinations(Kind, 2)
                                                for pair in itertools.product(nodes[first], nodes[second])]
    rng.shuffle(pairs)
    changes = [partial(manager.on_match, CandidateMatch(first, second, float(rng.uniform(0.55, 0.99))), 1.0)
               for first, second in pairs + pairs[:100]]
    for kind in (Kind.FACE, Kind.BODY, Kind.VOICE):
        ids = [node.id for node in nodes[kind]]
        # One leaves and is back, with what is said of it.
        changes += [partial(manager.on_tracked, kind, ids[1:], 2.0), partial(manager.on_tracked, kind, ids, 3.0)]
        changes += [partial(manager.on_match, CandidateMatch(nodes[kind][0], other, 0.9), 3.0)
                    for other_kind in Kind if other_kind != kind for other in nodes[other_kind]]
    for change in changes:
        began = time.perf_counter()
        change()
        longest = max(longest, time.perf_counter() - began)
    return round(1e3 * longest, 1)


def late_bodies_taken(bodies: int = 30) -> int:
    """How many of the bodies that are 0.65 s old place a person whose face is there, seen 20 times a second."""
    manager, taken = _manager(), 0
    manager.on_tracked(Kind.FACE, ["f1"], 0.0)
    manager.on_tracked(Kind.BODY, ["b1"], 0.0)
    manager.on_match(CandidateMatch(MatchNode(Kind.FACE, "f1"), MatchNode(Kind.BODY, "b1"), 0.9), 0.0)
    for number in range(bodies):
        now = 1.0 + number / 20.0
        manager.on_place(PlaceSource.FACE, "f1", _place(1.6, now - 0.05), now)
        taken += manager.on_place(PlaceSource.BODY, "b1", _place(0.9, now - LATE_S), now) is not None
    return taken


def _place(height: float, stamp: float) -> Place:
    return Place("map", Pose(np.eye(3), np.array([1.0, 0.0, height])), stamp)


def rules() -> Dict[str, object]:
    """The figures of all rules."""
    return {"who_wins": who_wins(), "linked_15_ms": linked_ms(), "late_body_taken": late_bodies_taken()}
