"""Who looks at whom on the labelled photographs."""

import cv2
import pytest

from benchmarks.gaze_photographs import CAMERA, CLOSED, FRAMES, NOBODY, NOT_FOUND, USE_FACS, photographs
from hri_pipeline.core.onnx import models_directory

EVALUATION = models_directory() / "evaluation"


@pytest.mark.skipif(not EVALUATION.is_dir(), reason="no evaluation pictures; `fetch_models --models evaluation`")
def test_who_looks_into_the_camera_and_who_does_not(tmp_path):
    overlay = tmp_path / "overlay.png"
    tables = photographs(models_directory(), overlay)
    table = tables[USE_FACS]
    assert sum(count for row in table.values() for count in row.values()) == 48
    assert all(row[NOT_FOUND] <= 1 for row in table.values())
    assert table[CAMERA][CAMERA] >= 30
    assert table[NOBODY][CAMERA] + table[CLOSED][CAMERA] <= 2
    assert table[CLOSED][CLOSED] >= 8
    assert tables[FRAMES][CAMERA][CAMERA] >= 30
    assert cv2.imread(str(overlay)).shape[1] == 3 * 640
