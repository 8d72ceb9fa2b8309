"""Matcher and manager beside other load: bodies, or faces, of few images come seconds late; people stay as many as they
are."""

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
from hri_pipeline.core.matching.changes import MatchChanges
from hri_pipeline.core.matching.face_body import FaceBodyMatcher
from hri_pipeline.core.matching.parameters import MATCHER_PARAMETERS

ASPECT = 16.0 / 9.0
HEAD = {0: 30, 14: 42, 15: 36, 16: 16, 17: 0}      # joints of the skeleton, and landmarks at the same place
KINDS = ((Kind.FACE, "faces", PlaceSource.FACE), (Kind.BODY, "bodies", PlaceSource.HEAD))


def head(place, rng):
    """Landmarks (70, 3) of a head (3,) m before the camera, and a skeleton (18, 3) that is a little beside it."""
    size, middle = 0.17 / place[2], 0.5 + place[:2] / place[2] / (ASPECT, 1.0)
    landmarks = np.column_stack([middle[0] + size / ASPECT * np.linspace(-0.5, 0.5, 70),
                                 middle[1] + 0.5 * size * np.sin(np.arange(70)), np.ones(70)])
    landmarks[36:42, :2], landmarks[42:48, :2] = (middle + size * np.array([[x / ASPECT, -0.2]]) for x in (-0.2, 0.2))
    landmarks[30, :2] = middle
    skeleton = np.zeros((18, 3))
    skeleton[list(HEAD)] = landmarks[list(HEAD.values())]
    return landmarks, skeleton + (*(0.1 * size * rng.normal(size=2)), 0.0)


class Crowd:
    """People who sway before one camera. periods: s that an image takes for faces and for bodies; it is told then."""

    def __init__(self, people, periods, seed):
        numbers = itertools.count(1)
        self.rng = np.random.default_rng(seed)
        self.manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}), lambda: "a%04d" % next(numbers))
        self.matcher, self.changes = FaceBodyMatcher(MATCHER_PARAMETERS.resolve({})), MatchChanges(0.05)
        order = np.arange(people)
        self.home = np.column_stack([0.8 * (order % 5 - 2) + 0.3 * (order // 5), 0.1 * self.rng.normal(size=people),
                                     3.0 + 1.3 * (order // 5)])
        self.phase, self.along = self.rng.uniform(0.0, 6.3, people), 1.0 + 0.08 * self.rng.normal(size=(2, people))
        self.periods, self.people, self.most, self.wrong = periods, people, 0, 0
        self.renewal, self.shown = 0.0, set()

    def bodies(self, stamp):
        """Ids of the bodies at `stamp`, by human, and those of before that are listed still.

        They begin anew every `renewal` s, one after the other, and the old ids stay for three images.
        """
        if not self.renewal:
            return ["b%d" % number for number in range(self.people)], []
        begun = [stamp - 2.0 - self.renewal * (1.0 + number / self.people) for number in range(self.people)]
        ids = ["b%d" % number + "n" * max(0, int(since // self.renewal) + 1) for number, since in enumerate(begun)]
        listed = [name[:-1] for name, since in zip(ids, begun)
                  if name.endswith("n") and since % self.renewal < 3.0 * self.periods[1]]
        return ids, listed

    def tell(self, kind, stamp, now):
        """What one image shows, of a body in nine of ten images only."""
        of, name, source = KINDS[kind]
        ids, listed = self.bodies(stamp) if kind else (["f%d" % number for number in range(self.people)], [])
        self.matcher.set_tracked(name, ids + listed)
        self.manager.on_tracked(of, ids + listed, now)
        for number, identity in enumerate(ids):
            is_new = kind and identity not in self.shown
            if kind and stamp > self.periods[1] and not is_new and self.rng.random() < 0.1:
                continue
            self.shown.add(identity)
            place = self.home[number] + (0.8 * np.sin(stamp + self.phase[number]), 0.0, 0.0)
            points = head(place, self.rng)[kind]
            if kind:
                self.matcher.add_body(identity, stamp, points, "camera")
            else:
                self.matcher.add_face(identity, stamp, points, ASPECT, "camera")
            told = Place("camera", Pose(np.eye(3), self.along[kind, number] * place), stamp)
            self.manager.on_place(source, identity, told, now, "camera")

    def step(self, now):
        """Tell the images that are done at `now` (s), compare, and let time pass."""
        for kind, period in enumerate(self.periods):
            if round(10.0 * now) % round(10.0 * period) == 0 and now >= period:
                self.tell(kind, now - period, now)
        for (face, body), likelihood in self.changes.update(
                {(match.face, match.body): match.confidence for match in self.matcher.matches()}, now,
                self.matcher.has_left):
            self.manager.on_match(CandidateMatch(MatchNode(Kind.FACE, face), MatchNode(Kind.BODY, body), likelihood),
                                  now)
        self.manager.tick(now)
        persons = [person for person in self.manager.snapshot(now).persons if person.tracked and not person.alias]
        self.most = max(self.most, len(persons))
        self.wrong += sum(bool(person.face and person.body) and person.face[1:] != person.body[1:].rstrip("n")
                          for person in persons)


@pytest.mark.parametrize("people", [3, 10])
@pytest.mark.parametrize("periods", [(0.1, 0.1), (0.1, 1.0), (0.3, 3.0), (0.1, 4.0), (0.3, 5.0), (4.0, 0.1)],
                         ids=lambda periods: "faces %g s, bodies %g s" % periods)
def test_late_images_make_no_more_persons_than_people(people, periods):
    crowd = Crowd(people, periods, seed=1)
    for step in range(1, 301):
        crowd.step(round(0.1 * step, 6))
    assert crowd.most == people and crowd.wrong == 0
    assert all(crowd.manager.person_of(MatchNode(Kind.FACE, "f%d" % number))
               == crowd.manager.person_of(MatchNode(Kind.BODY, "b%d" % number)) is not None for number in range(people))


@pytest.mark.parametrize("periods", [(0.1, 0.2), (0.1, 1.0), (0.3, 3.0)],
                         ids=lambda periods: "faces %g s, bodies %g s" % periods)
def test_bodies_that_begin_anew_beside_their_old_ids_make_no_more_persons(periods):
    crowd = Crowd(6, periods, seed=2)
    crowd.renewal = 12.0
    owners = {}
    for step in range(1, 401):
        crowd.step(round(0.1 * step, 6))
        for number in range(6 if step > 100 else 0):
            owners.setdefault(number, set()).add(crowd.manager.person_of(MatchNode(Kind.FACE, "f%d" % number)))
    assert crowd.most == 6 and crowd.wrong == 0
    assert all(len(persons) == 1 for persons in owners.values())


def test_who_was_placed_once_and_late_is_somebody_in_the_end():
    manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}))
    early, late = MatchNode(Kind.FACE, "early"), MatchNode(Kind.BODY, "late")
    for number in range(300):
        now = 100.0 + 0.1 * number
        for node, source, x, stamp in [(early, PlaceSource.FACE, 0.0, now)] + [
                (late, PlaceSource.HEAD, 3.0, now - 2.0)] * (number == 2):
            manager.on_tracked(node.kind, [node.id], now)
            manager.on_place(source, node.id, Place("camera", Pose(np.eye(3), np.array([x, 0.0, 2.0])), stamp), now,
                             "camera")
        manager.tick(now)
        if number == 100:
            assert manager.person_of(early) and not manager.person_of(late), "a newer image may show nobody"
    assert manager.person_of(late)
