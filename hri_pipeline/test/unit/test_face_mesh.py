"""Face mesh: the table of the 70 landmarks and their confidence."""

import numpy as np
import pytest

from hri_pipeline.core.faces.detector import FaceDetection
from hri_pipeline.core.faces.mesh import (
    LANDMARK_TO_MESH,
    LANDMARKS,
    MESH_POINTS,
    FaceMeshResult,
    agreement_score,
    bounding_box,
    landmarks_from_meshes,
)


def mesh_with_indices():
    return np.stack([np.arange(MESH_POINTS), 2.0 * np.arange(MESH_POINTS), np.zeros(MESH_POINTS)], axis=1)


def test_table_has_70_different_vertices():
    assert LANDMARK_TO_MESH.shape == (LANDMARKS,)
    assert len(set(LANDMARK_TO_MESH)) == LANDMARKS
    assert LANDMARK_TO_MESH.min() >= 0 and LANDMARK_TO_MESH.max() < MESH_POINTS


def test_corrected_entries_and_pupils():
    assert [LANDMARK_TO_MESH[index] for index in (0, 16, 17, 26)] == [127, 356, 70, 300]
    assert (LANDMARK_TO_MESH[68], LANDMARK_TO_MESH[69]) == (468, 473)


def test_table_cannot_be_changed():
    with pytest.raises(ValueError):
        LANDMARK_TO_MESH[0] = 1


def test_points_outside_the_image_have_no_confidence():
    landmarks, = landmarks_from_meshes([mesh_with_indices()], [0.8], 400, 10000, [np.ones(LANDMARKS)])
    outside = LANDMARK_TO_MESH >= 400
    assert (landmarks[outside, 2] == 0.0).all()
    assert landmarks[~outside, 2] == pytest.approx(0.8)
    assert (landmarks[:, 0] == LANDMARK_TO_MESH).all()


def test_confidence_falls_with_visibility_and_stays_in_range():
    visibility = np.linspace(-1.0, 2.0, LANDMARKS)
    confidence = landmarks_from_meshes([mesh_with_indices()], [1.5], 10000, 10000, [visibility])[0, :, 2]
    assert confidence.min() == 0.0 and confidence.max() == 1.0
    assert (np.diff(confidence) >= 0.0).all()


@pytest.mark.parametrize("shape", [(468, 3), (478,), (478, 1)])
def test_another_mesh_is_refused(shape):
    with pytest.raises(ValueError, match="mesh"):
        landmarks_from_meshes([np.zeros(shape)], [1.0], 640, 480, [np.ones(LANDMARKS)])


def test_bounding_box():
    assert bounding_box(np.array([[3.0, 9.0, 0.0], [1.0, 12.0, 5.0]])) == pytest.approx((1, 9, 3, 12))


def seen_again(score, moved=0.0):
    """A mesh of 100 px, and the face that the detector finds there, its eyes, nose and mouth `moved` px away."""
    points = np.random.RandomState(0).uniform(0.0, 100.0, (MESH_POINTS, 3))
    points[[5, 6]] = [[0.0], [100.0]]
    places = [points[list(vertices), :2].mean(axis=0) for vertices in ((33, 133), (362, 263), (1,), (13, 14))]
    keypoints = np.array(places + [np.zeros(2)] * 2) + (moved, 0.0)
    return FaceDetection(np.array([0.0, 0.0, 100.0, 100.0]), keypoints, score), FaceMeshResult(1.0, points)


@pytest.mark.parametrize("score, moved, verdict", [
    (0.9, 2.0, 1.0), (0.9, 40.0, -1.0), (0.66, 0.0, 0.0), (0.5, 0.0, -1.0), (0.72, 5.0, 0.667)])
def test_a_face_is_sure_when_the_detector_sees_its_parts_where_the_mesh_does(score, moved, verdict):
    again, mesh = seen_again(score, moved)
    assert agreement_score(again, mesh, 0.6) == pytest.approx(verdict, abs=0.01)


def test_what_the_detector_does_not_find_again_is_none():
    assert agreement_score(None, seen_again(0.9)[1], 0.6) == -1.0
