"""The figures of the face stage that a test can hold: pose and eyes; and their endurance."""

import os
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks import face_figures
from benchmarks.labels import TABLE
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
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


def resources():
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return {"fds": len(os.listdir("/proc/self/fd")), "threads": threading.active_count(),
            "rss_mb": pages * os.sysconf("SC_PAGE_SIZE") / 2.0 ** 20}


def test_faces_that_come_and_go_leave_nothing_behind():
    still = face_figures.read_image(models_directory() / "demo/sample5.jpg")
    bright = cv2.resize(still, (640, 640 * still.shape[0] // still.shape[1]), interpolation=cv2.INTER_AREA)
    camera = CameraModel.from_fov(bright.shape[1], bright.shape[0], 0.93)
    stage = FacePipeline(FACES.resolve({
        "face_birth_delay": 0.0, "face_min_detections": 1, "face_death_time": 0.05, "face_person_lead": 0.0,
        "face_detection_tiles": 1, "recognition_learn_delay": 600.0}))
    gone, stamp, start = 0, 1000.0, None
    while gone < 60:
        stage.update(bright, camera, stamp)
        faces = stage.update(bright, camera, stamp + 0.04, None, FaceDemand.everything(stage.tracked_ids))
        gone += len(faces)
        # Long enough in the dark that the detector looks again at once when the light comes back.
        for later in (1.0, 2.0):
            stage.update(np.zeros_like(bright), camera, stamp + later)
        assert faces and not stage.tracked_ids
        stamp += 3.0
        if start is None and gone >= 10:    # by then everything has its working size
            start = resources()
    end = resources()
    stage.close()
    assert end["fds"] == start["fds"] and end["threads"] == start["threads"] and end["rss_mb"] < start["rss_mb"] + 20.0
