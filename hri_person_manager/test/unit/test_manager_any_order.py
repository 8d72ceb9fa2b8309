"""Whatever comes, in whatever order: lists, matches, places, services, jumps of time and live parameters at random
leave persons of whom each feature is one's, and nothing when everybody has left."""

from __future__ import annotations

import itertools
import random
from collections import Counter

import numpy as np
import pytest

from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.location import Place, PlaceSource
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.match_graph import CandidateMatch
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_pipeline.core.geometry import Pose

NAMES = ["ann", "bob", "cho"]
# One id of all kinds.
FEATURES = {Kind.FACE: ["f1", "f2", "f3", "x"], Kind.BODY: ["b1", "b2", "b3", "x"], Kind.VOICE: ["v1", "v2", "x"]}
SOURCES = {Kind.FACE: [PlaceSource.FACE], Kind.BODY: [PlaceSource.HEAD, PlaceSource.BODY],
           Kind.VOICE: [PlaceSource.VOICE]}


class AnyClient:
    """Does one of all things that the graph can ask of a person manager."""

    def __init__(self, seed):
        self.chance = random.Random(seed)
        numbers = itertools.count(1)
        self.given = {"cross_camera": seed % 2 == 0, "features_from_matches": seed % 3 == 0}
        self.manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve(self.given), lambda: "a%04d" % next(numbers))
        self.now, self.shown = 10.0, {kind: set() for kind in FEATURES}
        self.seen = set(NAMES)      # ids of persons, also of those who have gone

    def feature(self):
        kind = self.chance.choice(list(FEATURES))
        return MatchNode(kind, self.chance.choice(FEATURES[kind]))

    def person(self):
        return MatchNode(Kind.PERSON, self.chance.choice(sorted(self.seen)))

    def step(self):
        self.now += self.chance.choice((0.0, 0.01, 0.1, 0.3, 0.3)) if self.chance.random() < 0.99 else 20.0
        self.chance.choice((self.show, self.show, self.match, self.match, self.match, self.place, self.tick, self.serve,
                            self.disturb))()
        self.seen |= {state.id for state in self.manager.snapshot(self.now).persons}

    def show(self):
        kind = self.chance.choice(list(FEATURES))
        self.shown[kind] = {one for one in FEATURES[kind] if (one in self.shown[kind]) != (self.chance.random() < 0.2)}
        self.manager.on_tracked(kind, sorted(self.shown[kind]), self.now)

    def match(self):
        first, second = self.chance.choice(((self.feature, self.feature), (self.feature, self.person),
                                            (self.person, self.person)))
        first, second = first(), second()
        if first.kind != second.kind or (first.kind == Kind.PERSON and first != second):
            self.manager.on_match(CandidateMatch(first, second, self.chance.choice((0.0, 0.3, 0.6, 0.9, 1.0))),
                                  self.now, self.chance.choice(("", "one", "another")))

    def place(self):
        kind, one = self.feature()
        pose = Pose(np.eye(3), np.array([self.chance.choice((0.0, 1.0, 1e6)), self.chance.choice((0.0, 1.0)), 1.0]))
        origin = self.chance.choice((None, np.zeros(3), np.array([2.0, 0.0, 0.0])))
        self.manager.on_place(self.chance.choice(SOURCES[kind]), one, Place(
            self.chance.choice(("map", "camera")), pose, self.now - self.chance.choice((0.0, 3.0)), origin=origin),
            self.now, self.chance.choice(("camera", "other_camera")))

    def tick(self):
        self.manager.tick(self.now)

    def serve(self):
        try:
            self.chance.choice((
                lambda: self.manager.merge(self.person().id, self.person().id, self.now),
                lambda: self.manager.split(self.person().id, self.now),
                lambda: self.manager.forget(self.person().id, self.now)))()
        except ValueError:
            pass        # refused with a word

    def disturb(self):
        threshold = self.chance.choice((0.3, 0.5, 1.0))
        settings = PERSON_MANAGER_PARAMETERS.resolve(dict(self.given, match_threshold=threshold))
        self.chance.choice((
            lambda: self.manager.rewind(self.now), lambda: self.manager.reconfigure(settings, self.now),
            lambda: self.manager.renew("one", NAMES[:1], self.now),
            lambda: self.manager.recall(self.manager.identified(), self.now)))()

    def check(self):
        snapshot = self.manager.snapshot(self.now)
        persons = {state.id: state for state in snapshot.persons}
        assert {state.id for state in snapshot.persons if state.tracked} == set(snapshot.tracked)
        features = Counter()
        for state in persons.values():
            if state.alias:
                assert not persons[state.alias].alias and not state.tracked, state
            features.update(node for node in zip(FEATURES, (state.face, state.body, state.voice)) if node[1])
            assert 0.0 <= state.confidence <= 1.0
        assert max(features.values(), default=1) == 1
        if not self.given["features_from_matches"]:
            assert all(one in self.shown[kind] for kind, one in features)


@pytest.mark.parametrize("seed", range(6))
def test_any_order_of_anything(seed):
    client = AnyClient(seed)
    for _ in range(400):
        client.step()
        client.check()
    for kind in FEATURES:
        client.manager.on_tracked(kind, (), client.now)
    for _ in range(300):
        client.now += 10.0
        client.tick()
    state = client.manager.snapshot(client.now)
    left = {*state.tracked, *state.known, *(one.id for one in state.persons)}
    assert not state.tracked and not [one for one in left if one.startswith("anonymous_person_")]
    assert client.manager.matches == []
