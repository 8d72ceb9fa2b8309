"""Looks shared out among faces."""

from collections import Counter

import pytest

from hri_pipeline.core.faces.face_budget import FaceBudget, TimeShare

FACES = ["f%d" % number for number in range(10)]


def looks(budget, faces, rate, seconds, urgent=()):
    counts = Counter()
    most = 0
    for index in range(int(rate * seconds)):
        chosen = budget.choose(faces, 50.0 + index / rate, urgent)
        counts.update(chosen)
        most = max(most, len(chosen)) if index else most
    return counts, most


@pytest.mark.parametrize("images", [10.0, 20.0, 30.0, 60.0])
def test_each_face_gets_its_rate_whatever_the_rate_of_the_images(images):
    counts, _ = looks(FaceBudget(12.0, 1.0), FACES[:3], images, 10.0)
    for face in FACES[:3]:
        assert counts[face] == pytest.approx(min(12.0, images) * 10.0, rel=0.05)


def test_a_rate_of_zero_is_every_image():
    counts, _ = looks(FaceBudget(0.0, 1.0), FACES, 30.0, 2.0)
    assert set(counts.values()) == {60}


def test_at_the_rate_of_the_images_no_turn_is_lost_to_rounding():
    counts, _ = looks(FaceBudget(15.0, 1.0), FACES[:1], 15.0, 20.0)
    assert counts["f0"] >= 299


def test_a_tight_budget_is_shared_fairly_and_never_exceeded():
    budget = FaceBudget(12.0, 0.020, cost=0.005)
    counts, most = looks(budget, FACES, 20.0, 20.0)
    assert most == budget.limit == 4
    assert sum(counts.values()) == pytest.approx(4 * 400, rel=0.02)
    assert max(counts.values()) - min(counts.values()) <= 2
    assert set(counts) == set(FACES)


def test_looks_are_bunched_into_batches_even_of_faces_born_at_different_times():
    budget = FaceBudget(10.0, 1.0)
    batches = []
    for index in range(200):
        batches.append(len(budget.choose(FACES[:1 + min(2, index // 7)], 0.05 * index)))
    assert sum(batches[100:]) == pytest.approx(3 * 50, abs=3), "three faces ten times a second for 5 s"
    assert batches[100:].count(0) >= 40, "in every second image"


def test_at_least_one_face_is_looked_at_however_dear_it_is():
    budget = FaceBudget(12.0, 0.001)
    budget.spent(10.0, 1)
    assert budget.limit == 1
    counts, _ = looks(budget, FACES[:4], 20.0, 20.0)
    assert max(counts.values()) - min(counts.values()) <= 1


def test_the_cost_of_a_look_is_learnt():
    budget = FaceBudget(12.0, 0.020, cost=0.005)
    for _ in range(60):
        budget.spent(0.008, 4)
    assert budget.cost == pytest.approx(0.002, rel=0.02)
    assert budget.limit == 9
    budget.spent(float("nan"), 3)
    budget.spent(1.0, 0)
    assert budget.cost == pytest.approx(0.002, rel=0.02)


def test_urgent_faces_come_first_and_new_ones_at_once():
    counts, _ = looks(FaceBudget(12.0, 0.010, cost=0.005), FACES[:6], 20.0, 10.0, urgent=["f5"])
    assert counts["f5"] > 1.5 * counts["f0"] > 0
    budget = FaceBudget(12.0, 0.005, cost=0.005)
    looks(budget, FACES[:3], 20.0, 2.0)
    assert budget.choose(FACES[:3] + ["new"], 52.0) == ["new"]


def test_faces_that_have_gone_are_forgotten():
    budget = FaceBudget(12.0, 1.0)
    for index in range(5000):
        budget.choose(["face%d" % index], 0.05 * index)
    assert len(budget._credit) == 1


@pytest.mark.parametrize("arguments", [(-1.0, 0.02), (10.0, 0.0), (float("nan"), 0.02), (10.0, 0.02, 0.0)])
def test_nonsense_is_refused(arguments):
    with pytest.raises(ValueError, match="rate"):
        FaceBudget(*arguments)


def test_work_of_ten_shares_leaves_nine_images_out():
    share = TimeShare(0.005)
    allowed = []
    for _ in range(40):
        allowed.append(share.next_image())
        if allowed[-1]:
            share.spent(0.05)
    assert allowed == ([True] + [False] * 9) * 4


def test_work_within_the_share_is_done_in_every_image():
    share = TimeShare(0.005)
    for _ in range(20):
        assert share.next_image()
        share.spent(0.004)


def test_a_larger_share_pays_sooner_and_nonsense_is_refused():
    share = TimeShare(0.001)
    share.spent(0.01)
    assert not share.next_image()
    share.change(0.01)
    assert share.next_image()
    share.spent(float("nan"))
    share.spent(-1.0)
    assert share.next_image()
    for wrong in (0.0, -0.1, float("nan")):
        with pytest.raises(ValueError):
            share.change(wrong)


def test_what_is_saved_up_is_there_at_once_and_comes_again_in_quiet_images():
    share = TimeShare(0.005, saved=0.1)

    def done(images):
        count = 0
        for _ in range(images):
            if share.next_image():
                share.spent(0.025)
                count += 1
        return count

    assert share.ample
    assert done(5) == 5                 # 0.125 of 0.1 and five shares
    assert not share.ample
    assert done(100) == 20              # as without savings
    for _ in range(10):
        share.next_image()
    assert done(3) == 3                 # 0.05 has been saved up
    for _ in range(1000):
        share.next_image()
    assert done(20) == 5 + 3            # no more than 0.1 is


def test_savings_that_are_none_are_refused():
    for wrong in (-0.1, float("nan")):
        with pytest.raises(ValueError):
            TimeShare(0.005, wrong)


def test_what_is_left_of_the_budget_goes_to_the_next_image():
    """2.4 looks per image are two and three in turn: no face pays for the rounding."""
    budget = FaceBudget(0.0, 0.012, 0.005)
    per_image = [len(budget.choose(FACES, 50.0 + index / 12.0)) for index in range(100)]
    assert set(per_image) == {2, 3} and sum(per_image) == pytest.approx(240, abs=2)
    counts, _ = looks(FaceBudget(0.0, 0.012, 0.005), FACES, 12.0, 20.0)
    assert max(counts.values()) - min(counts.values()) <= 1


def test_what_was_not_needed_is_not_saved_up():
    budget = FaceBudget(0.0, 0.02, 0.005)
    for index in range(50):
        budget.choose(FACES[:2], 50.0 + index / 12.0)
    assert len(budget.choose(FACES, 50.0 + 50 / 12.0)) == 4


def test_images_that_come_slowly_have_time_for_everybody():
    budget = FaceBudget(10.0, 0.01, 0.005)
    for index in range(20):
        chosen = budget.choose(FACES, 50.0 + 1.0 * index)
        assert index == 0 or len(chosen) == len(FACES)


def test_a_slow_image_pays_for_more():
    share = TimeShare(0.005)
    share.spent(0.02)
    assert share.next_image(1.0)
