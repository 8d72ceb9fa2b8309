"""Who looks at whom on the labelled photographs."""

import cv2
import numpy as np
import pytest

from benchmarks.gaze_photographs import CAMERA, CLOSED, FRAMES, NOBODY, NOT_FOUND, USE_FACS, photographs
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.gaze import HEAD_CONFIDENCE, OPEN
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


def with_lenses(image, meshes, colour, clearness):
    """A picture with lenses of this colour, as clear (0 to 1), on the faces of these meshes (478, 3) px."""
    for mesh in meshes:
        right, left = (mesh[list(corners), :2].mean(axis=0) for corners in ((33, 133), (263, 362)))
        eyes = float(np.linalg.norm(left - right))
        turn = float(np.degrees(np.arctan2(*(left - right)[::-1])))
        lenses = np.zeros(image.shape[:2], np.uint8)
        for middle in (right, left):
            place = middle + 0.08 * eyes * np.array([-(left - right)[1], (left - right)[0]]) / eyes
            axes = (int(0.44 * eyes), int(0.34 * eyes))
            cv2.ellipse(lenses, tuple(int(value) for value in place), axes, turn, 0, 360, 255, -1, cv2.LINE_AA)
        part = lenses[..., None] / 255.0
        image = image * (1.0 - part) + part * (clearness * image + (1.0 - clearness) * np.array(colour))
    return np.uint8(image)


def test_eyes_behind_dark_and_mirrored_lenses_are_not_told_of():
    image = cv2.imread(str(models_directory() / "demo" / "sample3.jpg"))
    image = cv2.resize(image, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], 1.0)
    stage = FacePipeline(FACES.resolve({"expression": False, "age_gender": False, "recognition": False,
                                        "face_mesh_rate": 0.0, "face_budget": 1000.0}))

    def look(picture, begin):
        for index in range(10):
            faces = stage.update(picture, camera, begin + 0.15 * index, None,
                                 FaceDemand.everything(stage.tracked_ids))
        assert len(faces) == 3
        return faces

    try:
        bare = look(image, 100.0)
        for number, (colour, clearness) in enumerate([((8, 8, 8), 0.05), ((190, 110, 60), 0.3), ((60, 60, 60), 0.95)]):
            stage.reset()
            seen = look(with_lenses(image, [face.mesh for face in bare], colour, clearness), 200.0 + 100.0 * number)
            for face in seen:
                hidden = number < 2
                assert face.dark_glasses is hidden, number
                assert (face.gaze.confidence <= HEAD_CONFIDENCE) == (face.gaze.from_eyes == 0.0) == hidden
                assert (face.gaze.direction == face.pose.rotation[:, 0]).all() == hidden
                assert (face.action_units.confidence[[5, 43, 45, 61]] == 0.0).all() == hidden
                assert face.gaze.eyes_closed < OPEN
    finally:
        stage.close()
