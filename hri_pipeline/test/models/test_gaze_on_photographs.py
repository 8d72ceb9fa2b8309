"""Who looks at whom on the labelled photographs."""

import cv2
import pytest

from benchmarks.gaze_photographs import CAMERA, CLOSED, FRAMES, NOBODY, NOT_FOUND, USE_FACS, photographs
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.gaze import HEAD_CONFIDENCE
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
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


@pytest.mark.skipif(not EVALUATION.is_dir(), reason="no evaluation pictures; `fetch_models --models evaluation`")
def test_faces_of_13_to_30_px_look_where_their_heads_do_and_say_so():
    image = cv2.imread(str(EVALUATION / "group.jpg"))
    stage = FacePipeline(FACES.resolve(dict.fromkeys(("expression", "age_gender", "recognition"), False)))
    widths = []
    try:
        for part in (0.1, 0.18, 0.24):
            small = cv2.resize(image, None, fx=part, fy=part, interpolation=cv2.INTER_AREA)
            padded = cv2.copyMakeBorder(small, 0, 480 - small.shape[0], 0, 640 - small.shape[1], cv2.BORDER_CONSTANT)
            camera = CameraModel.from_fov(640, 480, 1.0)
            stage.reset()
            for index in range(10):
                faces = stage.update(padded, camera, 1000.0 + 0.1 * index, None, FaceDemand())
            for face in faces:
                width = face.box[2] - face.box[0]
                if face.pose is not None and 13.0 <= width <= 30.0:
                    widths.append(width)
                    assert face.gaze.direction is None or (face.gaze.direction == face.pose.rotation[:, 0]).all()
                    assert face.gaze.from_eyes == 0.0 and face.gaze.confidence <= HEAD_CONFIDENCE
    finally:
        stage.close()
    assert len(widths) >= 4 and min(widths) < 20.0 < 24.0 < max(widths), widths
