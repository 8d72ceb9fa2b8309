"""What the last seconds show of each look, and the trees that judge it."""

import math

import numpy as np
import pytest

from hri_pipeline.core.interactions import gaze_trees
from hri_pipeline.core.interactions.gaze import SightLines
from hri_pipeline.core.interactions.gaze_cues import CUES, LEAST_BELIEF, SECOND_CUES, GazeCues, GazeJudge, Trees, turns
from hri_pipeline.core.interactions.people import UNKNOWN, PeopleSnapshot

CAMERA = np.array([0.0, 0.0, 1.5])
PLACES = {"ann": [2.0, -1.0, 1.5], "bob": [2.0, 1.0, 1.5], "cho": [4.0, 0.0, 1.5]}
RADIUS, STEP = 0.12, 0.1
SPREAD = math.hypot(0.1, math.hypot(0.5 * RADIUS, math.hypot(0.03, 0.03)) / 2.0)


def people(looks, left=0.0, faced=True):
    """These people at their places; each looks `left` rad beside somebody, head and trunk too."""
    ids = list(looks)
    heads = np.array([PLACES[identity] for identity in ids])
    ways = np.array([PLACES[target] for target in looks.values()]) - heads
    bearings = np.arctan2(ways[:, 1], ways[:, 0]) + left
    directions = np.stack([np.cos(bearings), np.sin(bearings), np.zeros(len(ids))], axis=1)
    unknown = np.tile(UNKNOWN, (len(ids), 1))
    seen = PeopleSnapshot(ids, heads, directions if faced else unknown, directions if faced else unknown, directions,
                          np.tile([0.03, 0.09, 0.1, 0.35], (len(ids), 1)), np.zeros(len(ids)))
    seen.groups = np.full(len(ids), -1)
    return seen


def even(count):
    return np.full((count, count + 2), 1.0 / (count + 2))


class Watch:
    """Cues of one image after the other."""

    def __init__(self, judge=None):
        self.judge, self.now = judge or GazeCues(), 0.0

    def see(self, seen, beliefs=None, times=1):
        for _ in range(times):
            self.now += STEP
            lines, beliefs = SightLines(seen, CAMERA, 8.0), even(len(seen)) if beliefs is None else beliefs
            if isinstance(self.judge, GazeJudge):
                self.latest = self.judge.update(seen, lines, beliefs, RADIUS, self.now, STEP)
            else:
                self.judge.update(seen, lines, self.now, STEP)
                rows, targets = (places.ravel() for places in np.indices(lines.distances.shape))
                found = self.judge.of(rows, targets, seen, lines, beliefs, RADIUS, self.now)
                self.latest = found.reshape(*lines.distances.shape, len(CUES))
        return self

    def cue(self, name, observer, target):
        return self.latest[observer, target, CUES.index(name)]


EACH = {"ann": "bob", "bob": "ann", "cho": "ann"}


def test_left_and_above():
    units = np.array([[[0.0, 1.0, 0.0], [math.cos(0.2), 0.0, math.sin(0.2)]]])
    left, above = turns(units, np.array([[math.cos(0.1), math.sin(0.1), 0.0]]))
    assert left[0] == pytest.approx([0.5 * math.pi - 0.1, -0.1 * math.cos(0.2)])
    assert above[0] == pytest.approx([0.0, 0.2])


def test_eyes_beside_a_target_count_in_standard_deviations_and_their_means_follow_in_time():
    watch = Watch().see(people(EACH))
    assert watch.cue("aside", 0, 1) == pytest.approx(0.0, abs=1e-9)
    assert watch.cue("looks_back", 0, 1) == pytest.approx(0.0, abs=1e-9)
    watch.see(people(EACH, left=0.2))
    assert watch.cue("aside", 0, 1) == pytest.approx(0.2 / SPREAD)
    for time in (0.4, 1.0, 2.5):
        assert watch.cue("off_{}".format(time), 0, 1) == pytest.approx(
            (1.0 - math.exp(-STEP / time)) * 0.2 / SPREAD)
    assert watch.cue("robot", 0, 3) == 1.0 and watch.cue("robot", 0, 1) == 0.0


def test_the_sign_is_that_of_the_side_of_the_trunk():
    for left in (0.1, -0.1):
        watch = Watch().see(people(EACH, left=left))       # the trunk is beside the target as the eyes are
        assert watch.cue("eyes_to_side_now", 0, 1) == pytest.approx(0.1 / SPREAD)
        assert watch.cue("head_to_side_now", 0, 1) == pytest.approx(0.1)


def test_what_is_not_seen_is_unknown_and_what_was_seen_stays():
    watch = Watch().see(people(EACH, faced=False))
    assert math.isnan(watch.cue("off_1.0", 0, 1)) and watch.cue("face_missing", 0, 1) == math.inf
    watch.see(people(EACH, left=0.1)).see(people(EACH, faced=False), times=3)
    assert math.isnan(watch.cue("aside", 0, 1))
    assert watch.cue("off_1.0", 0, 1) == pytest.approx(0.1 / SPREAD)
    assert watch.cue("face_missing", 0, 1) == pytest.approx(3 * STEP) == watch.cue("eyes_missing", 0, 1)


def test_people_come_and_go_and_others_keep_what_is_known_of_them():
    watch = Watch().see(people(EACH, left=0.1))
    known = watch.cue("off_2.5", 2, 0)
    watch.see(people({"cho": "ann", "ann": "cho"}, faced=False))
    assert watch.cue("off_2.5", 0, 1) == pytest.approx(known)
    watch.see(people(EACH, faced=False))
    assert watch.cue("off_2.5", 2, 0) == pytest.approx(known)
    assert math.isnan(watch.cue("off_2.5", 1, 0)) and math.isnan(watch.cue("off_2.5", 0, 1))
    assert watch.cue("off_2.5", 2, 3) > 0.0      # the robot did not go


def test_who_speaks_and_who_stands_with_whom():
    seen = people(EACH)
    seen.speaking, seen.groups = np.array([False, True, False]), np.array([0, 0, -1])
    watch = Watch().see(seen, times=50)
    assert watch.cue("heard", 0, 1) == pytest.approx(1.0, abs=0.01) and watch.cue("heard", 1, 0) == 0.0
    assert watch.cue("speaks", 1, 0) > 0.9 and watch.cue("heard", 0, 3) == 0.0
    assert [watch.cue("grouped", *pair) for pair in ((0, 1), (0, 2), (2, 0), (0, 3))] == [1.0, 0.0, 0.0, 0.0]
    assert [watch.cue("in_group", row, 3) for row in range(3)] == [1.0, 1.0, 0.0]


def test_the_rival_of_the_likeliest_is_the_second_and_of_all_others_the_likeliest():
    beliefs = np.array([[0.0, 0.6, 0.2, 0.1, 0.1]] * 3)
    watch = Watch().see(people(EACH), beliefs)
    assert [watch.cue("rival", 0, target) for target in range(4)] == [0.6, 0.2, 0.6, 0.6]
    assert watch.cue("nobody", 0, 1) == 0.1


TREE = ((0, 2, 0), (0.5, 1.0, 0.8), tuple(float(value) for value in range(8)))


@pytest.mark.parametrize("belief, nobody, leaf", [(0.3, 0.0, 0), (0.6, 0.0, 1), (0.6, 2.0, 3), (0.9, 2.0, 7),
                                                  (math.nan, 2.0, 2)])
def test_the_levels_of_a_tree_are_the_bits_of_its_leaf(belief, nobody, leaf):
    cues = np.zeros((1, len(CUES)))
    cues[0, [0, 2]] = belief, nobody
    assert Trees(-1.0, [TREE]).odds(cues) == pytest.approx([leaf - 1.0])
    assert Trees(-1.0, [TREE, TREE]).odds(cues) == pytest.approx([2.0 * leaf - 1.0])


ALWAYS, NEVER, NONE = Trees(2.0, [((0, 0, 0), (0.0, 0.0, 0.0), (0.0,) * 8)]), Trees(-2.0, []), Trees(0.0, [])
SURE = 1.0 / (1.0 + math.exp(-2.0))


def test_only_what_the_filter_believes_possible_of_people_with_faces_is_judged():
    beliefs = even(3)
    beliefs[0, 1] = 0.5 * LEAST_BELIEF
    watch = Watch(GazeJudge(ALWAYS, ALWAYS)).see(people(EACH), beliefs)
    assert watch.latest[0] == pytest.approx([beliefs[0, 0], beliefs[0, 1], SURE, SURE])
    watch.see(people(EACH, faced=False), beliefs)       # the face is missing for a moment
    assert watch.latest[0, 2] == pytest.approx(SURE)
    watch.see(people(EACH, faced=False), beliefs, times=6)
    assert watch.latest == pytest.approx(beliefs[:, :-1])


def second_cues(judge, seen, beliefs, stamp=0.0):
    """Of the looks that are judged, {(observer, target): {name: cue}}."""
    rows, targets, cues = judge.looks(seen, SightLines(seen, CAMERA, 8.0), beliefs, RADIUS, stamp, STEP)
    return {pair: dict(zip(SECOND_CUES, row)) for pair, row in zip(zip(rows.tolist(), targets.tolist()), cues)}


def test_the_second_pass_sees_what_the_first_said_of_all_looks():
    found = second_cues(GazeJudge(ALWAYS), people(EACH), even(3))
    assert len(found) == 9
    at_bob = found[0, 1]
    assert [at_bob["first"], at_bob["first_rival"], at_bob["first_back"]] == pytest.approx([SURE] * 3)
    # Cho looks at Bob, too; Ann herself counts as what the filter believes, one in five.
    assert at_bob["first_joint"] == pytest.approx(SURE + 0.2) and at_bob["first_sum"] == pytest.approx(3 * SURE + 0.2)
    assert found[0, 3]["first_back"] == 0.0      # of the robot's looks nothing is known
    assert at_bob["unheard"] == 1.0 and at_bob["eyes_sd"] == 0.1


def test_what_the_first_pass_said_is_followed_in_time_for_each_look():
    by_belief = Trees(0.0, [((0, 0, 0), (0.5, 0.5, 0.5), (-9.0,) + (0.0,) * 6 + (9.0,))])
    judge, before = GazeJudge(by_belief), np.tile([0.1, 0.1, 0.1, 0.6, 0.1], (3, 1))
    assert second_cues(judge, people(EACH), before)[2, 0]["first_1.5"] == pytest.approx(0.0, abs=1e-3)
    at_ann = np.tile([0.6, 0.1, 0.1, 0.1, 0.1], (3, 1))
    found = second_cues(judge, people(EACH), at_ann, STEP)[2, 0]
    assert found["first"] == pytest.approx(1.0, abs=1e-3)
    for time in (0.4, 1.5, 8.0):
        assert found["first_{}".format(time)] == pytest.approx(1.0 - math.exp(-STEP / time), abs=1e-3)
    # The others come in another order, and somebody has left: the look is the same one.
    seen = people({"cho": "ann", "ann": "cho"})
    found = second_cues(judge, seen, np.tile([0.1, 0.6, 0.2, 0.1], (2, 1)), 2 * STEP)[0, 1]
    assert found["first_8.0"] == pytest.approx(1.0 - math.exp(-2 * STEP / 8.0), abs=1e-3)


def test_of_people_without_a_trunk_the_first_pass_says_what_the_filter_believes_and_the_second_judges():
    seen = people(EACH)
    seen.trunks = seen.trunks.copy()
    seen.trunks[1] = math.nan
    watch = Watch(GazeJudge(ALWAYS, ALWAYS)).see(seen)
    assert watch.latest[1, 0] == pytest.approx(1.0 / (1.0 + math.exp(-0.5 * (2.0 - math.log(4.0)))))
    found = second_cues(GazeJudge(ALWAYS), seen, even(3))
    assert found[1, 0]["first"] == pytest.approx(0.2) and found[1, 0]["trunk_missing"] == math.inf
    assert found[0, 1]["first"] == pytest.approx(SURE) and found[0, 1]["trunk_missing"] == 0.0


def test_the_odds_are_the_mean_of_both_passes():
    assert Watch(GazeJudge(ALWAYS, NEVER)).see(people(EACH)).latest[0, 1] == pytest.approx(0.5)
    assert Watch(GazeJudge(NEVER, NEVER)).see(people(EACH)).latest[0, 1] == pytest.approx(1.0 - SURE)


def test_of_people_whose_eyes_are_not_seen_the_first_pass_has_the_last_word():
    seen = people(EACH)
    seen.gazes = seen.gazes.copy()
    watch = Watch(GazeJudge(ALWAYS, NEVER)).see(seen)
    assert watch.latest[0, 1] == pytest.approx(0.5)
    seen.gazes[0] = math.nan
    assert watch.see(seen, times=19).latest[0, 1] == pytest.approx(0.5)
    assert watch.see(seen, times=2).latest[0, 1] == pytest.approx(SURE)
    assert watch.latest[1, 0] == pytest.approx(0.5)


def test_where_groups_are_not_known_the_first_pass_has_the_last_word():
    seen = people(EACH)
    seen.groups = None
    assert Watch(GazeJudge(ALWAYS, NONE)).see(seen).latest[0, 1] == pytest.approx(SURE)


@pytest.mark.parametrize("trees, known", [(gaze_trees.TREES, CUES), (gaze_trees.SECOND_TREES, SECOND_CUES)])
def test_the_trees_are_whole(trees, known):
    assert len(trees) >= 20
    for cues, limits, values in trees:
        assert (len(cues), len(limits), len(values)) == (gaze_trees.LEVELS, gaze_trees.LEVELS, 1 << gaze_trees.LEVELS)
        assert all(0 <= cue < len(known) for cue in cues)
        assert np.isfinite([*limits, *values]).all()
