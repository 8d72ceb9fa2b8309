"""Engagement: legal transitions only, each level reached, distance with hysteresis, the lost are unknown."""

import numpy as np
import pytest

from benchmarks.gaze import engagement
from hri_pipeline.core.interactions.engagement import LEGAL, EngagementEstimator, Level
from hri_pipeline.core.interactions.gaze import ROBOT, GazeTarget, Observer
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS

ROBOT_AT = np.array([0.0, 0.0, 1.3])
AHEAD = np.array([1.0, 0.0, 0.0])


class Visitor:
    """One person before a robot that looks along x."""

    def __init__(self, **changes):
        self.estimator = EngagementEstimator(INTERACTION_PARAMETERS.resolve(changes))
        self.now, self.levels = 0.0, []

    def stay(self, seconds, distance=1.5, looks=True, bearing=0.0, seen=True, rate=10.0, robot=ROBOT_AT):
        """Return the level after so many seconds."""
        head = np.array([distance * np.cos(bearing), distance * np.sin(bearing), 1.6])
        person = Observer("ann", head, head_direction=-AHEAD) if seen else Observer("ann")
        for _ in range(max(1, int(seconds * rate))):
            self.now += 1.0 / rate
            gazes = [GazeTarget("ann", ROBOT, 0.9)] if looks else []
            self.levels.append(self.estimator.update([person], gazes, robot, self.now, AHEAD)["ann"])
        return self.levels[-1]

    def course(self):
        """Return the levels without repetitions."""
        return [level for index, level in enumerate(self.levels) if index == 0 or level != self.levels[index - 1]]


def test_somebody_comes_looks_glances_away_and_leaves():
    ann = Visitor()
    assert ann.stay(1.0, looks=False) == Level.DISENGAGED
    assert ann.stay(1.0) == Level.ENGAGING
    assert ann.stay(2.0) == Level.ENGAGED
    assert ann.stay(0.7, looks=False) == Level.ENGAGED
    assert ann.stay(1.5, looks=False) == Level.DISENGAGING
    assert ann.stay(3.0) == Level.ENGAGED
    assert ann.stay(10.0, looks=False) == Level.DISENGAGED
    assert ann.stay(3.0, seen=False, looks=False) == Level.UNKNOWN
    assert ann.course() == [Level.DISENGAGED, Level.ENGAGING, Level.ENGAGED, Level.DISENGAGING, Level.ENGAGED,
                            Level.DISENGAGING,
                            Level.DISENGAGED, Level.UNKNOWN]


def test_whatever_happens_only_legal_transitions_come():
    chance = np.random.default_rng(3)
    ann = Visitor()
    for _ in range(400):
        ann.stay(chance.uniform(0.1, 4.0), chance.uniform(0.5, 5.0), bool(chance.random() < 0.5),
                 chance.uniform(-3.0, 3.0),
                 bool(chance.random() < 0.8), rate=float(chance.choice([1.0, 5.0, 15.0])))
    for before, after in zip(ann.levels, ann.levels[1:]):
        assert after == before or after in LEGAL[before]
    assert set(ann.levels) == set(Level)


def test_the_distance_has_hysteresis():
    ann = Visitor(engagement_distance=2.0, engagement_distance_margin=0.4)
    assert ann.stay(8.0, distance=2.2) == Level.DISENGAGED
    assert ann.stay(8.0, distance=1.9) == Level.ENGAGED
    assert ann.stay(8.0, distance=2.2) == Level.ENGAGED
    assert ann.stay(15.0, distance=2.5) == Level.DISENGAGED


def test_the_margin_of_the_distance_goes_with_who_was_lost():
    ann = Visitor(engagement_distance=2.0, engagement_distance_margin=0.4)
    assert ann.stay(8.0, distance=1.9) == Level.ENGAGED
    assert ann.stay(8.0, seen=False) == Level.UNKNOWN
    assert ann.stay(8.0, distance=2.2) == Level.DISENGAGED


def test_nobody_is_engaged_with_a_robot_whose_place_is_not_known():
    ann = Visitor()
    assert ann.stay(8.0) == Level.ENGAGED
    assert ann.stay(8.0, robot=None) == Level.UNKNOWN


def test_who_comes_is_not_engaged_at_once_however_few_images_there_are():
    ann = Visitor()
    assert [ann.stay(10.0, seen=False, rate=0.1)] + [ann.stay(10.0, rate=0.1) for _ in range(3)] == [
        Level.UNKNOWN, Level.DISENGAGED, Level.ENGAGING, Level.ENGAGED]


def test_images_that_come_late_count_no_time_twice():
    needed = []
    for late in (0.0, 0.3):
        ann = Visitor()
        while ann.stay(0.1) != Level.ENGAGED:
            ann.now -= late
            ann.stay(0.0, rate=1e9)
            ann.now += late
        needed.append(ann.now)
    assert needed[1] == pytest.approx(needed[0], abs=1e-3)


def test_a_gaze_at_a_robot_that_looks_elsewhere_is_not_mutual():
    assert Visitor().stay(8.0, bearing=2.0) == Level.DISENGAGED
    assert Visitor(engagement_view=3.15).stay(8.0, bearing=2.0) == Level.ENGAGED


def test_an_image_that_comes_late_after_a_silence_does_not_begin_anew():
    ann = Visitor()
    assert ann.stay(6.0) == Level.ENGAGED
    for silence in (0.6, 0.8):
        assert ann.estimator.update((), [], None, ann.now + silence, unplaced=["ann"])["ann"] == Level.ENGAGED
    assert ann.stay(0.7, rate=1.0 / 0.7) == Level.ENGAGED
    assert ann.stay(1.0, rate=1.0) == Level.ENGAGED


def test_who_has_gone_is_forgotten_and_time_may_go_back():
    ann = Visitor()
    ann.stay(8.0)
    assert ann.estimator.update([], [], ROBOT_AT, ann.now) == {}
    assert ann.stay(0.2) == Level.DISENGAGED
    ann.stay(8.0)
    ann.now = 0.0
    assert ann.stay(0.1) in (Level.UNKNOWN, Level.DISENGAGED)


def test_levels_in_the_wrong_order_are_refused():
    with pytest.raises(ValueError, match="engaged_level"):
        EngagementEstimator(INTERACTION_PARAMETERS.resolve({"engaged_level": 0.3}))


def test_the_scripted_visit_reaches_each_level():
    assert engagement() == {"illegal": 0, "missing": [], "levels": [
        "UNKNOWN", "DISENGAGED", "ENGAGING", "ENGAGED", "DISENGAGING", "ENGAGED", "DISENGAGING", "DISENGAGED"]}


def test_who_is_tracked_but_has_no_place_stays_for_a_while():
    ann = Visitor()
    assert ann.stay(8.0) == Level.ENGAGED
    bob = Observer("bob", np.array([1.0, 1.0, 1.6]), head_direction=-AHEAD)

    def update(seconds):
        ann.now += seconds
        return ann.estimator.update([bob], [], ROBOT_AT, ann.now, AHEAD, unplaced=["ann"])

    assert update(0.1) == {"bob": Level.DISENGAGED, "ann": Level.ENGAGED}
    assert update(3.0)["ann"] == Level.UNKNOWN
    assert list(ann.estimator.update([bob], [], ROBOT_AT, ann.now + 0.1, AHEAD)) == ["bob"]
