"""Compares what a recording of the stack scores with golden.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping

from hri_pipeline.score.bag import read_bag
from hri_pipeline.score.command import score
from hri_pipeline.score.metrics import compare, comparison_table, load_golden

GOLDEN = Path(__file__).resolve().parent / "golden.yaml"


def check_bag(bag: Path, section: str) -> None:
    """Score a bag and compare. Raises AssertionError with the table when a figure is worse than golden."""
    check_figures(score(read_bag(bag)), section)


def check_figures(figures: Mapping[str, object], section: str) -> None:
    """Compare figures, and print the table. Raises AssertionError with it when one is worse than golden."""
    outcomes = compare(figures, load_golden(GOLDEN, section))
    table = "{}:\n{}".format(section, comparison_table(outcomes))
    print(table, flush=True)
    if any(one.failed for one in outcomes):
        raise AssertionError(table)
