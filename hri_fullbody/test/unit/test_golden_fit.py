"""The error of the fitted joints on recorded motion against the golden figures of the bag tests: it may only
improve."""

from pathlib import Path

import pytest

from benchmarks.body_fit import fit_errors, motions
from benchmarks.report import ABSENT, data_directory
from hri_fullbody.core.model.anthropometry import SegmentTable
from hri_pipeline.score.metrics import compare, comparison_table, load_golden

GOLDEN = Path(__file__).resolve().parents[3] / "rosbag_tests" / "golden.yaml"
TRIALS, FRAMES = ("02_01", "03_01"), 240    # a walk and a walk on uneven ground, 8 s of each


@pytest.mark.slow("recorded motion, two trials")
@pytest.mark.skipif(data_directory() is None, reason=ABSENT)
def test_the_error_of_the_joints_may_only_become_less():
    table = SegmentTable.load()
    seen = [motion.cut(0, FRAMES) for motion in motions(table, names=TRIALS)]
    figures = {"mpjpe_mm": fit_errors(seen, table, True), "mpjpe_height_only_mm": fit_errors(seen, table, False)}
    outcomes = compare(figures, load_golden(GOLDEN, "mocap"))
    assert not any(one.failed for one in outcomes), "\n" + comparison_table(outcomes)
