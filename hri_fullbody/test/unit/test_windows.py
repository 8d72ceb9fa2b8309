import numpy as np
import pytest

from hri_fullbody.core.detection.windows import (
    FaceBox,
    Window,
    window_from_face,
    window_from_landmarks,
    window_from_person_box,
)


@pytest.mark.parametrize("centre, size, angle", [
    ((0.0, 0.0), 0.0, 0.0), ((0.0, 0.0), -1.0, 0.0), ((np.nan, 0.0), 1.0, 0.0), ((0.0, np.inf), 1.0, 0.0),
    ((0.0, 0.0), 1.0, np.nan)])
def test_impossible_windows_are_refused(centre, size, angle):
    with pytest.raises(ValueError, match="window"):
        Window(centre, size, angle)


@pytest.mark.parametrize("box, centre, size", [
    ((10.0, 20.0, 40.0, 120.0), (25.0, 70.0), 125.0),     # whole: centred on it
    ((10.0, 20.0, 90.0, 120.0), (50.0, 130.0), 275.0),    # cut at a table: hangs from the head
    ((10.0, 20.0, 210.0, 70.0), (110.0, 45.0), 250.0)])    # lies
def test_a_person_is_at_least_as_tall_as_its_breadth_tells(box, centre, size):
    assert window_from_person_box(np.array(box)) == Window(centre, size, 0.0)


def test_face_window_hangs_below_the_face():
    face = FaceBox("f", np.array([90.0, 40.0, 110.0, 60.0]))
    window = window_from_face(face, 10.0)
    assert window.size == pytest.approx(200.0)
    assert window.centre == pytest.approx((100.0, 110.0))


@pytest.mark.parametrize("offset, angle", [
    ((0.0, -40.0), 0.0), ((40.0, 0.0), np.pi / 2), ((-40.0, 0.0), -np.pi / 2), ((0.0, 40.0), np.pi)])
def test_landmark_window_stands_upright_along_the_body(offset, angle):
    landmarks = np.zeros((39, 2))
    landmarks[33] = (300.0, 200.0)
    landmarks[34] = landmarks[33] + offset
    window = window_from_landmarks(landmarks)
    assert window.centre == (300.0, 200.0)
    assert window.size == pytest.approx(100.0)
    assert abs(window.angle) == pytest.approx(abs(angle))
    assert np.sin(window.angle) == pytest.approx(np.sin(angle), abs=1e-9)


def test_landmarks_in_one_point_are_refused():
    with pytest.raises(ValueError):
        window_from_landmarks(np.zeros((39, 2)))


def test_face_box_spans_its_landmarks():
    face = FaceBox.from_landmarks("f", np.array([[10.0, 20.0, 1.0], [30.0, 60.0, 0.1]]))
    assert face.box == pytest.approx([10.0, 20.0, 30.0, 60.0])
    assert face.centre == pytest.approx([20.0, 40.0])
    assert face.distance(np.array([20.0, 40.0])) == 0.0
    with pytest.raises(ValueError, match="f"):
        FaceBox.from_landmarks("f", np.full((70, 3), np.nan))
