"""The figures of the face stage that a test can hold: pose, eyes, endurance, identities."""

import numpy as np
import pytest

from benchmarks import face_figures
from benchmarks.labels import TABLE
from hri_pipeline.core.onnx import models_directory

EVALUATION = models_directory() / "evaluation"


def test_pose_of_known_heads_with_one_pixel_of_noise():
    yaw, pitch, roll, position = face_figures.pose_errors(count=100)
    assert max(yaw, pitch, roll) < 1.0, "degrees, at yaw within 60, pitch 30, roll 45"
    assert position < 1.5, "% of the distance"


def test_errors_grow_with_the_noise():
    """The figure measures something: without noise it vanishes, with ten pixels it is large."""
    assert max(face_figures.pose_errors(count=30, noise_px=0.0)) < 0.1
    assert max(face_figures.pose_errors(count=30, noise_px=8.0)[:3]) > 1.0


@pytest.mark.skipif(not EVALUATION.is_dir(), reason="no evaluation pictures; `fetch_models --models evaluation`")
def test_closed_eyes_of_real_faces():
    assert TABLE.is_file()
    table = face_figures.eyes_closed(models_directory())
    assert table["tp"] + table["fn"] == 67 and table["tn"] + table["fp"] + table["unknown"] >= 126
    assert table["fp"] + table["fn"] <= 2 and table["unknown"] <= 3


@pytest.mark.skipif(not EVALUATION.is_dir(), reason="no evaluation pictures; `fetch_models --models evaluation`")
def test_portraits_have_no_pitch_on_average():
    pitches = face_figures.portrait_pitches(models_directory())
    assert len(pitches) >= 25
    assert abs(np.median(pitches)) < 4.0


def test_faces_that_come_and_go_leave_nothing_behind():
    growth = face_figures.churn(60)
    assert growth["fds"] == 0 and growth["threads"] == 0 and growth["rss_mb"] < 20.0


def test_a_pan_over_a_group_changes_no_id():
    assert face_figures.ids(models_directory(), 6.0) == 5
