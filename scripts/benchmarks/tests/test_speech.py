"""Counting word errors."""

from __future__ import annotations

import pytest

from hri_pipeline.score.metrics import word_errors


@pytest.mark.parametrize("said, recognised, errors", [
    ("go forward ten meters", "go forward ten meters", 0), ("go forward ten meters", "", 4), ("", "one two", 2),
    ("go forward ten meters", "go forward two ten meters", 1), ("go forward ten meters", "forward ten meters", 1),
    ("go forward ten meters", "go backward ten metres", 2), ("a b c d", "b c d a", 2), ("a", "b c d", 3)])
def test_substitutions_omissions_and_insertions_count(said, recognised, errors):
    assert word_errors(said.split(), recognised.split()) == errors
    assert word_errors(recognised.split(), said.split()) == errors
