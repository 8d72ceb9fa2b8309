"""CLEAR-MOT and pairs, by hand."""

import pytest

from hri_pipeline.score.metrics import MotFrame, clear_mot, pair_scores

A, B = (0.0, 0.0), (3.0, 0.0)


def frames(*found, truth=None, required=None):
    return [MotFrame(truth if truth is not None else {"ann": A, "bob": B}, places, required) for places in found]


def test_all_right():
    scores = clear_mot(frames({"x": A, "y": B}, {"x": A, "y": B}))
    assert (scores.mota, scores.distance, scores.switches, scores.persons, scores.persons_true) == (1.0, 0.0, 0, 2, 2)
    assert scores.pairs == ({"x": "ann", "y": "bob"},) * 2


def test_nothing_found():
    scores = clear_mot(frames({}, {}))
    assert (scores.mota, scores.misses, scores.distance, scores.persons) == (0.0, 4, None, 0)


def test_nothing_true():
    scores = clear_mot([MotFrame({}, {"x": A})])
    assert (scores.mota, scores.false_positives) == (None, 1)


def test_the_error_is_the_mean_distance():
    assert clear_mot(frames({"x": (0.3, 0.0), "y": (3.0, 0.1)})).distance == pytest.approx(0.2)


def test_too_far_is_a_miss_and_a_false_positive():
    scores = clear_mot(frames({"x": A, "y": (3.6, 0.0)}))
    assert (scores.misses, scores.false_positives, scores.mota) == (1, 1, 0.0)


def test_a_new_id_is_a_switch_and_the_old_one_again_another():
    scores = clear_mot(frames({"x": A, "y": B}, {"x": A, "z": B}, {"x": A, "z": B}, {"x": A, "y": B}))
    assert (scores.switches, scores.fragments, scores.misses) == (2, 0, 0)
    assert scores.mota == pytest.approx(1.0 - 2.0 / 8.0)


def test_swapped_ids_are_two_switches():
    assert clear_mot(frames({"x": A, "y": B}, {"y": A, "x": B})).switches == 2


def test_a_switch_is_seen_over_a_gap():
    scores = clear_mot(frames({"x": A, "y": B}, {"x": A}, {"x": A, "z": B}))
    assert (scores.switches, scores.fragments, scores.misses) == (1, 1, 1)


def test_a_pair_stays_though_another_is_nearer():
    near = {"ann": (0.0, 0.0)}
    scores = clear_mot([MotFrame(near, {"x": (0.1, 0.0)}), MotFrame(near, {"x": (0.4, 0.0), "y": (0.0, 0.0)})])
    assert (scores.switches, scores.false_positives) == (0, 1)


def test_who_need_not_be_found_is_neither_missed_nor_wrong():
    scores = clear_mot(frames({"x": A}, {"x": A, "y": B}, required={"ann"}))
    assert (scores.misses, scores.false_positives, scores.persons_true, scores.truths) == (0, 0, 1, 3)


def test_the_least_total_distance():
    truth = {"ann": (0.0, 0.0), "bob": (0.4, 0.0)}
    scores = clear_mot([MotFrame(truth, {"x": (0.3, 0.0), "y": (0.75, 0.0)})])
    assert scores.pairs == ({"x": "ann", "y": "bob"},)


@pytest.mark.parametrize("distance", [0.0, -1.0, float("nan")])
def test_illegal_distance(distance):
    with pytest.raises(ValueError, match="above 0"):
        clear_mot([], distance)


def test_pairs():
    scores = pair_scores([{("a", "b")}, {("a", ""), ("b", "a")}, set()], [{("a", "b")}, {("a", "")}, {("b", "a")}])
    assert (scores.right, scores.wrong, scores.missed) == (2, 1, 1)
    assert (
        scores.precision == pytest.approx(2 / 3)
        and scores.recall == pytest.approx(2 / 3)
        and scores.f1 == pytest.approx(2 / 3)
    )


def test_pairs_with_slack_forgive_what_comes_late():
    truth = [set(), {("a", "b")}, {("a", "b")}, set()]
    late = [set(), set(), {("a", "b")}, {("a", "b")}]
    assert pair_scores(late, truth).precision == 0.5
    forgiven = pair_scores(late, truth, 1)
    assert (forgiven.right, forgiven.wrong, forgiven.missed) == (2, 0, 0)
    assert pair_scores([set()] * 4, [{("a", "b")}] * 4, 1).missed == 4


def test_no_pairs_have_no_scores():
    scores = pair_scores([set()], [set()])
    assert (scores.precision, scores.recall, scores.f1) == (None, None, None)
    with pytest.raises(ValueError, match="2 of truth"):
        pair_scores([set()], [set(), set()])
