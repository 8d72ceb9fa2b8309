"""Puts scripts/ of the checkout on the import path: some tests measure with the tools of `scripts/benchmark`.
Linear algebra works in one thread, as in the nodes: with more, two test processes on two cores wait for each other."""

import sys
from pathlib import Path

from hypothesis import settings

from hri_pipeline.core.process import one_thread_each

sys.path += [str(Path(__file__).resolve().parents[2] / "scripts"), str(Path(__file__).resolve().parent / "msgs")]
one_thread_each()
# The same examples in each run, however slow the machine.
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None, max_examples=30)
settings.load_profile("repeatable")
