"""Scores of groups against the truth."""

from __future__ import annotations

import pytest

from hri_pipeline.score.metrics import group_scores


def test_two_thirds_of_the_larger_group_are_enough_at_two_thirds_only() -> None:
    found, truth = [[{1, 2}]], [[{1, 2, 3}]]
    assert group_scores(found, truth).f1 == 1.0
    assert group_scores(found, truth, 1.0).f1 == 0.0
    assert group_scores([[{1, 2, 4}]], truth).f1 == 1.0
    assert group_scores([[{1, 2, 3, 4, 5}]], truth).f1 == 0.0


def test_precision_and_recall_are_means_over_frames() -> None:
    found = [[{1, 2}, {3, 4}], [{1, 2}]]
    truth = [[{1, 2}], [{1, 2}, {3, 4}]]
    scores = group_scores(found, truth)
    assert (scores.precision, scores.recall, scores.frames) == (0.75, 0.75, 2)
    assert scores.f1 == 0.75


def test_empty_frames() -> None:
    both = group_scores([[]], [[]])
    assert (both.precision, both.recall) == (1.0, 1.0)
    missed = group_scores([[]], [[{1, 2}]])
    assert (missed.precision, missed.recall, missed.f1) == (1.0, 0.0, 0.0)
    invented = group_scores([[{1, 2}]], [[]])
    assert (invented.precision, invented.recall, invented.f1) == (0.0, 1.0, 0.0)


def test_one_person_is_no_group() -> None:
    assert group_scores([[{1}]], [[{2}]]).f1 == 1.0


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(ValueError, match="1 frames found and 2"):
        group_scores([[]], [[], []])
    with pytest.raises(ValueError, match="no frame"):
        group_scores([], [])
    with pytest.raises(ValueError, match="tolerance"):
        group_scores([[]], [[]], 0.0)
