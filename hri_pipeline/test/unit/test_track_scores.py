"""CLEAR-MOT, IDF1, HOTA and pairs, by hand."""

import math

import pytest

from hri_pipeline.score.metrics import MotFrame, box_distance, clear_mot, identity_scores, pair_scores

A, B = (0.0, 0.0), (3.0, 0.0)
TRACKEVAL = (0.5329341317365269, 0.3780227395852826, 0.5922693952845991, 0.2418889044104385)
"""IDF1, HOTA, DetA, AssA of the walk below."""


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


def test_all_right_is_one_in_every_measure():
    scores = identity_scores(frames({"x": A, "y": B}, {"x": A, "y": B}))
    assert (scores.idf1, scores.hota, scores.deta, scores.assa) == pytest.approx((1.0, 1.0, 1.0, 1.0))


def test_a_track_cut_in_half_costs_identity_and_not_detection():
    """Half of ann's places have another id: IDF1 = 2 * 2 / (4 + 4); each of the matches associates 2 of 4 places."""
    scores = identity_scores(frames(*[{"x": A}] * 2 + [{"z": A}] * 2, truth={"ann": A}))
    assert (scores.idf1, scores.deta, scores.assa) == pytest.approx((0.5, 1.0, 0.5))
    assert scores.hota == pytest.approx(math.sqrt(0.5))


def test_ids_that_swap_for_good_cost_half():
    """Each match associates 2 places of the 6 that its true and its found id have together: 2 / (4 + 4 - 2)."""
    scores = identity_scores(frames(*[{"x": A, "y": B}] * 2 + [{"y": A, "x": B}] * 2))
    assert (scores.idf1, scores.assa) == pytest.approx((0.5, 1.0 / 3.0))


def test_misses_and_false_places_cost_detection():
    """Of 4 true places 2 are found, besides 1 false one: IDF1 = 2 * 2 / (4 + 3), DetA = 2 / (2 + 2 + 1)."""
    scores = identity_scores(frames({"x": A, "q": (9.0, 9.0)}, {"x": A}))
    assert (scores.idf1, scores.deta, scores.assa) == pytest.approx((4.0 / 7.0, 0.4, 1.0))


def test_a_place_that_is_off_counts_below_its_similarity():
    """0.25 m off at 0.5 m: a similarity of 0.75, reached by 15 of the 19 thresholds."""
    scores = identity_scores(frames({"x": (0.25, 0.0)}, truth={"ann": A}))
    assert scores.idf1 == 1.0 and scores.deta == pytest.approx(15.0 / 19.0)


def test_who_need_not_be_found_counts_in_no_identity():
    shown, hidden = {"x": A, "y": B}, {"x": A}
    for found in (shown, hidden):
        scores = identity_scores(frames(found, found, required={"ann"}))
        assert (scores.idf1, scores.hota) == pytest.approx((1.0, 1.0))


def test_boxes_compare_by_their_overlap():
    boxes = {"ann": (0.0, 0.0, 10.0, 10.0)}
    assert box_distance((0, 0, 10, 10), (0, 5, 10, 15)) == pytest.approx(2.0 / 3.0)
    near, far = ({"x": (0.0, off, 10.0, 10.0 + off)} for off in (2.0, 5.0))
    assert identity_scores([MotFrame(boxes, near)], 0.5, box_distance).idf1 == 1.0
    assert identity_scores([MotFrame(boxes, far)], 0.5, box_distance).idf1 == 0.0
    assert clear_mot([MotFrame(boxes, far)], 0.5, box_distance).misses == 1


def test_the_figures_are_those_of_trackeval():
    """Three who circle, with swaps, new ids and gaps; the figures are those of trackeval 1.3.0 (HOTA, Identity) for the
    same similarities."""
    walk = []
    for step in range(60):
        truth = {"t%d" % number: (2.0 * math.cos(0.05 * step + number), 2.0 * math.sin(0.07 * step + 2.0 * number))
                 for number in range(3)}
        names = ["a%d" % (step // 25), "bc"[step // 40], "cb"[step // 40]]
        walk.append(MotFrame(truth, {
            name: (x + 0.3 * math.sin(step), y + 0.3 * math.cos(1.7 * step))
            for number, (name, (x, y)) in enumerate(zip(names, truth.values())) if (step + 3 * number) % 7}))
    scores = identity_scores(walk)
    assert (scores.idf1, scores.hota, scores.deta, scores.assa) == pytest.approx(TRACKEVAL, abs=1e-9)


def test_identities_need_a_distance_and_somebody():
    with pytest.raises(ValueError, match="above 0"):
        identity_scores([], 0.0)
    assert identity_scores([]).idf1 is None
    assert identity_scores([MotFrame({"ann": A}, {})]).idf1 == 0.0
