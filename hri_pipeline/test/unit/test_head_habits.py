"""How far everybody turns the head to what they look at."""

import math

import numpy as np
import pytest

from hri_pipeline.core.interactions.head_habits import HeadHabits, rivals
from hri_pipeline.core.interactions.people import UNKNOWN, PeopleSnapshot

STEP = 0.1
BEARINGS = np.array([math.nan, -0.6, 0.5, 0.0])
"""Where the others and the robot are for the first of three people (rad), who faces along x."""


def people(bearing, ids=("ann", "bob", "cho"), trunk=True):
    """Ann's head has this bearing (rad); those of the others are not seen."""
    count = len(ids)
    faces, trunks = np.tile(UNKNOWN, (count, 1)), np.tile(UNKNOWN, (count, 1))
    row = ids.index("ann")
    faces[row] = math.cos(bearing), math.sin(bearing), 0.0
    if trunk:
        trunks[row] = 1.0, 0.0, 0.0
    return PeopleSnapshot(list(ids), np.zeros((count, 3)), faces.copy(), faces, trunks, np.zeros((count, 4)),
                          np.zeros(count))


class Ann:
    """Ann looks at one target after the other, and turns the head a share of the way, beside an offset."""

    def __init__(self, share, offset=0.0, trunk=True):
        self.habits, self.share, self.offset, self.trunk = HeadHabits(), share, offset, trunk

    def look(self, target, times, chance=0.95):
        head = self.share * BEARINGS[target] + self.offset
        aside, chances = np.full((3, 4), np.nan), np.full((3, 4), 0.01)
        aside[0], chances[0, target] = BEARINGS - head, chance
        for _ in range(times):
            self.habits.compare(people(head, trunk=self.trunk), aside, np.full((3, 4), 0.05 ** 2), STEP)
            self.habits.learn(chances)
        return self

    def cues(self):
        possible = np.ones((3, 4), dtype=bool)
        possible[0, 0] = False
        return self.habits.cues(np.zeros(3, dtype=int), np.array([1, 2, 3]), possible)


@pytest.mark.parametrize("share, offset", [(0.4, 0.05), (0.9, -0.1)])
def test_share_and_offset_of_somebody_are_learnt(share, offset):
    ann = Ann(share, offset)
    for _ in range(10):
        for target in (1, 2, 3):
            ann.look(target, 20)
    assert ann.cues()[0, 3] == pytest.approx(share, abs=0.06)
    ann.look(1, 50)
    right, wrong, robot = ann.cues()
    assert right[:3] == pytest.approx([0.0] * 3, abs=0.5)
    assert right[4] < -2.0 < 2.0 < wrong[4]          # the rival of the robot is the right one
    assert wrong[0] > robot[0] > right[0] + 2.0


def test_looks_that_are_not_believed_teach_nothing():
    ann = Ann(0.4)
    for target in (1, 2, 3, 1):
        ann.look(target, 20, chance=0.5)
    assert ann.cues()[0, 3] == 0.65


def test_of_somebody_without_a_trunk_the_head_says_where_ahead_is():
    ann = Ann(0.9, trunk=False)
    for _ in range(10):
        for target in (1, 2, 3):
            ann.look(target, 10)
    ann.look(2, 10)
    assert ann.cues()[1, 4] < ann.cues()[0, 4] - 2.0


def test_people_come_and_go_and_others_keep_their_habits():
    ann = Ann(0.4)
    for target in (1, 2, 3) * 5:
        ann.look(target, 20)
    known = ann.cues()[0, 3]
    order = ("bob", "ann")
    ann.habits.compare(people(0.0, order), np.full((2, 3), 0.2), np.zeros((2, 3)), STEP)
    ann.habits.learn(np.zeros((2, 3)))
    cues = ann.habits.cues(np.array([1, 0]), np.array([2, 2]), np.ones((2, 3), dtype=bool))
    assert cues[0, 3] == pytest.approx(known) and cues[1, 3] == 0.65
    assert np.isfinite(cues[0]).all() and np.isnan(cues[1, 0])


def test_the_rival_of_the_best_is_the_second():
    assert rivals(np.array([[0.1, 0.6, 0.3]]), np.array([0, 0, 0]), np.array([0, 1, 2])).tolist() == [0.6, 0.3, 0.6]
