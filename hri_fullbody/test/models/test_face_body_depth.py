"""Faces and bodies of photographs stand at one distance, each measured without the other."""

from benchmarks.body_fit import face_body_depth_ratio_median
from hri_pipeline.core.onnx import models_directory


def test_a_face_and_its_body_are_equally_far_away():
    assert 0.85 <= face_body_depth_ratio_median(models_directory()) <= 1.15
