"""Tables of labelled faces: reading, refusing, frames of a film, the face a label speaks of, the confusion table."""

import cv2
import numpy as np
import pytest

from benchmarks.labels import TABLE, LabelledFace, confusion, frames, images, labelled_eyes, nearest_face, read_labels
from hri_pipeline.core.faces.expression import CATEGORIES


def test_the_tables_of_the_package():
    eyes = labelled_eyes()
    assert sum(face.closed for face in eyes) >= 50 and sum(not face.closed for face in eyes) >= 100
    assert len({(face.file, face.frame, face.x, face.y) for face in eyes}) == len(eyes)
    expressions = read_labels(TABLE.with_name("expressions.txt"), CATEGORIES)
    assert len(expressions) >= 40


@pytest.mark.parametrize("line, told", [
    ("a.jpg\t0\t0.5\t0.5", "line 2"), ("a.jpg\t0\t0.5\t0.5\tajar", "ajar"), ("a.jpg\t-1\t0.5\t0.5\topen", "range"),
    ("a.jpg\t0\t1.5\t0.5\topen", "range"), ("a.jpg\tx\t0.5\t0.5\topen", "line 2")])
def test_a_bad_line_is_told_by_file_and_number(tmp_path, line, told):
    table = tmp_path / "table.txt"
    table.write_text("# head\n" + line + "\n", encoding="utf-8")
    with pytest.raises(ValueError, match=told) as error:
        labelled_eyes(table)
    assert "table.txt" in str(error.value)


def test_frames_of_a_film_are_counted(tmp_path):
    path = tmp_path / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    for number in range(10):
        writer.write(np.full((48, 64, 3), 20 * number, np.uint8))
    writer.release()
    found = {number: image.mean() for number, image in frames(path, [0, 3, 9])}
    assert [round(value / 20.0) for value in found.values()] == [0, 3, 9]
    with pytest.raises(ValueError, match="no frame 12"):
        list(frames(path, [12]))


def test_images_come_once_with_all_their_labels(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((48, 64, 3), np.uint8))
    labels = [LabelledFace("a.png", 0, 0.2, 0.5, "open"), LabelledFace("a.png", 0, 0.8, 0.5, "closed")]
    (found, image), = images(labels, tmp_path)
    assert found == labels and image.shape == (48, 64, 3)
    with pytest.raises(FileNotFoundError, match="fetch_models"):
        list(images([LabelledFace("absent.jpg", 0, 0.5, 0.5, "open")], tmp_path))


def test_the_face_a_label_speaks_of():
    label = LabelledFace("a.png", 0, 0.5, 0.5, "open")
    boxes = np.array([[0, 0, 20, 20], [30, 30, 80, 80], [40, 40, 62, 62]], float)
    assert nearest_face(label, boxes, (100, 100)) == 2
    assert nearest_face(label, boxes[:1], (100, 100)) is None
    assert nearest_face(label, np.empty((0, 4)), (100, 100)) is None


def test_confusion():
    faces = [LabelledFace("a", 0, 0.5, 0.5, label) for label in ("closed", "closed", "open", "open", "open")]
    assert confusion(faces, [True, False, False, True, None]) == {"tp": 1, "fn": 1, "tn": 1, "fp": 1, "unknown": 1}
    with pytest.raises(ValueError, match="5 labels and 1 answers"):
        confusion(faces, [True])
