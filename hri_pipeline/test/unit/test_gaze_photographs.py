"""Labels of who looks at whom on photographs, and the confusion table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.gaze_photographs import (
    CAMERA,
    CLOSED,
    NOBODY,
    NOT_FOUND,
    PERSON,
    WRONG_PERSON,
    GazeAnswer,
    confusion,
    labelled_gazes,
    observers,
    told_of,
)
from benchmarks.labels import labelled_eyes
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS
from hri_pipeline.core.interactions.people import PeopleTf, Seen
from hri_pipeline.core.observations import FaceObservation, GazeEstimate

SETTINGS = INTERACTION_PARAMETERS.resolve({})
LINE = "demo/x.jpg\t0\t0.25\t0.5\t{}\n"


def test_the_labels_agree_with_those_of_the_eyes() -> None:
    gazes = labelled_gazes()
    assert len(gazes) == 48
    eyes = {(eye.file, eye.frame): [] for eye in labelled_eyes()}
    for eye in labelled_eyes():
        eyes[eye.file, eye.frame].append(eye)
    compared = 0
    for gaze in gazes:
        face = gaze.face
        near = [eye for eye in eyes.get((face.file, face.frame), [])
                if abs(eye.x - face.x) + abs(eye.y - face.y) < 0.02]
        assert all((gaze.truth == CLOSED) == eye.closed for eye in near), face
        compared += len(near)
    assert compared >= 20


def test_one_who_looks_at_another_is_labelled_by_the_place_of_the_other(tmp_path: Path) -> None:
    table = tmp_path / "gazes.txt"
    table.write_text(LINE.format("person 0.6 0.4"), encoding="utf-8")
    gaze, = labelled_gazes(table)
    assert (gaze.truth, gaze.target) == (PERSON, (0.6, 0.4))


@pytest.mark.parametrize("label", ["person", "person 0.6", "person a b", "sky", ""])
def test_other_labels_are_refused_with_the_file(tmp_path: Path, label: str) -> None:
    table = tmp_path / "gazes.txt"
    table.write_text(LINE.format(label), encoding="utf-8")
    with pytest.raises(ValueError, match=r"gazes\.txt"):
        labelled_gazes(table)


def test_every_answer_is_counted_at_its_truth(tmp_path: Path) -> None:
    path = tmp_path / "gazes.txt"
    path.write_text("".join(LINE.format(label) for label in ("camera", "camera", "person 0.1 0.1", "closed", "nobody")),
                    encoding="utf-8")
    answers = [GazeAnswer(CAMERA), GazeAnswer(NOT_FOUND), GazeAnswer(WRONG_PERSON), GazeAnswer(CLOSED),
               GazeAnswer(CAMERA)]
    table = confusion(labelled_gazes(path), answers)
    assert table[CAMERA][CAMERA] == table[CAMERA][NOT_FOUND] == table[PERSON][WRONG_PERSON] == 1
    assert table[CLOSED][CLOSED] == table[NOBODY][CAMERA] == 1
    assert sum(count for row in table.values() for count in row.values()) == 5
    with pytest.raises(ValueError, match="5 labels and 4 answers"):
        confusion(labelled_gazes(path), answers[:4])


def test_a_face_becomes_an_onlooker_in_a_level_frame() -> None:
    # A face 2 m ahead of the camera, 0.5 m to the right, that looks back along the optical axis; its eyes look at the
    # camera.
    rotation = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    pose = Pose(rotation, np.array([0.5, 0.1, 2.0]))
    look = -pose.translation / np.linalg.norm(pose.translation)
    face = FaceObservation("abc", np.zeros(4), 1.0, np.zeros((70, 3)), np.zeros((478, 3)), pose,
                           GazeEstimate(look, 1.0, 0.0))
    person, = observers(PeopleTf(), [face], 10.0, SETTINGS, {"abc": Seen(10.0, 0.8)})
    assert np.allclose(person.head, [2.0, -0.5, -0.1])
    assert np.allclose(person.head_direction, [-1.0, 0.0, 0.0])
    assert person.gaze_direction is not None
    assert np.allclose(person.gaze_direction, -person.head / np.linalg.norm(person.head))
    assert person.eyes_closed == pytest.approx(0.8)


def test_precision_and_recall_of_the_looks_that_are_told() -> None:
    table = {truth: dict.fromkeys(("camera", "person", "wrong person", "nobody", "closed", "not found"), 0)
             for truth in ("camera", "person", "nobody", "closed")}
    table["camera"].update({"camera": 6, "nobody": 2})
    table["person"].update({"person": 1, "wrong person": 1})
    table["nobody"]["camera"] = 2
    assert told_of(table) == {"precision": 0.7, "recall": 0.7, "told": 10, "looks": 10}
