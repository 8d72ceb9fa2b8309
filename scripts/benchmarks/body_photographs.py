"""Postures and attitudes of the people on real photographs, from the picture to the answer, against postures.txt."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np

from benchmarks.face_figures import GEOMETRY_ONLY, PHOTOGRAPH_HFOV
from benchmarks.labels import LabelledFace, images, read_labels
from hri_fullbody.core import keypoints as kp
from hri_fullbody.core.behaviour.attitude import AttitudeClass
from hri_fullbody.core.behaviour.posture import PostureClass
from hri_fullbody.core.detection.windows import FaceBox
from hri_fullbody.core.parameters import VISION
from hri_fullbody.core.pipeline import BodyPipeline
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.pipeline import FacePipeline

TABLE = Path(__file__).with_name("postures.txt")
POSTURES = ("sitting", "standing")
ATTITUDES = ("arms_crossed", "hands_on_face", "hands_raised")
SECONDS, RATE_HZ, JUDGED_S = 3.0, 10.0, 1.0
# As on a machine that is fast enough: with a limit of time, answers would hang on the load.
_UNLIMITED = {"cpu_share": 0.0, "pose_budget": 0, "pose_rate": 0.0, "face_budget": 1000.0, "face_mesh_rate": 0.0}
_HEAD = (kp.NOSE, kp.LEFT_EYE, kp.RIGHT_EYE, kp.LEFT_EAR, kp.RIGHT_EAR)
_NEAR = 0.6     # of the trunk's length in the image: farther from the label is another one's head


@dataclass(frozen=True)
class LabelledBody:
    """A person whose posture is known. legs: a knee is in the image. attitude: None where nobody can tell."""

    face: LabelledFace
    posture: str
    legs: bool
    attitude: Optional[str]


@dataclass(frozen=True)
class BodyAnswer:
    """What was told of a person for most of the last second, `other` for nothing; None: no body was found."""

    posture: Optional[str] = None
    attitude: Optional[str] = None


def labelled_bodies() -> List[LabelledBody]:
    """Read the labels. Raises ValueError naming the file and what stands there."""
    found = []
    for face in read_labels(TABLE):
        words = face.label.split()
        if len(words) != 3 or words[0] not in POSTURES or words[1] not in ("legs", "hidden") or (
                words[2] not in (*ATTITUDES, "other", "unknown")):
            raise ValueError("{}: {!r} of {} is not `posture legs|hidden attitude`".format(
                TABLE, face.label, face.file))
        found.append(LabelledBody(face, words[0], words[1] == "legs", None if words[2] == "unknown" else words[2]))
    return found


def figures(models: Path) -> Dict[str, object]:
    """Return precision and recall of postures (recall: of found people with a knee in the image) and of attitudes.

    models: directory of the models and pictures. Raises FileNotFoundError with the mend when a picture is absent.
    """
    labels = labelled_bodies()
    answers = dict(_answers(labels, models))
    return {"people": len(labels), "found": sum(answers[label.face].posture is not None for label in labels),
            **scores(labels, [answers[label.face] for label in labels])}


def scores(labels: Sequence[LabelledBody], answers: Sequence[BodyAnswer]) -> Dict[str, Dict[str, Optional[float]]]:
    """Return, by posture and attitude, `precision` and `recall`, None of nothing, and the numbers they are of."""
    found = [(label, answer) for label, answer in zip(labels, answers) if answer.posture is not None]
    table = {name: _rates([(label.posture == name, answer.posture == name, label.legs) for label, answer in found])
             for name in POSTURES}
    table.update({name: _rates([(label.attitude == name, answer.attitude == name, True) for label, answer in found
                                if label.attitude is not None]) for name in ATTITUDES})
    return table


def _rates(rows: Sequence[Tuple[bool, bool, bool]]) -> Dict[str, Optional[float]]:
    """Rates of (is, told, asked for) rows."""
    told = [true for true, said, _ in rows if said]
    asked = [said for true, said, wanted in rows if true and wanted]
    return {"precision": round(sum(told) / len(told), 3) if told else None,
            "recall": round(sum(asked) / len(asked), 3) if asked else None, "told": len(told), "asked": len(asked)}


def _answers(labels: Sequence[LabelledBody], models: Path) -> Iterator[Tuple[LabelledFace, BodyAnswer]]:
    """Show each picture for SECONDS to the whole pipeline."""
    settings = VISION.resolve(dict(GEOMETRY_ONLY, **_UNLIMITED))
    faces, bodies = FacePipeline(settings), BodyPipeline(settings)
    try:
        for group, image in images([label.face for label in labels], models):
            camera = CameraModel.from_fov(image.shape[1], image.shape[0], PHOTOGRAPH_HFOV)
            told: Dict[LabelledFace, List[Tuple[str, str]]] = {face: [] for face in group}
            faces.reset()
            bodies.reset()
            for index in range(int(SECONDS * RATE_HZ)):
                stamp = 1000.0 + index / RATE_HZ
                boxes = [FaceBox.from_landmarks(face.id, face.landmarks, face.pose)
                         for face in faces.update(image, camera, stamp)]
                seen = bodies.update(image, camera, stamp, boxes)
                if index < (SECONDS - JUDGED_S) * RATE_HZ:
                    continue
                for face, body in _matched(group, seen, image.shape).items():
                    behaviour = bodies.behaviour(body.id, stamp)
                    if behaviour is not None:
                        told[face].append((PostureClass(behaviour.posture).name.lower(),
                                           AttitudeClass(behaviour.attitude).name.lower()))
            for face, words in told.items():
                yield face, (BodyAnswer(*(Counter(column).most_common(1)[0][0] for column in zip(*words)))
                             if words else BodyAnswer())
    finally:
        faces.close()


def _matched(labels: Sequence[LabelledFace], bodies: Sequence, shape: Sequence[int]) -> Dict[LabelledFace, object]:
    """The body of each label: the one whose head is nearest, each body once."""
    pairs = []
    for label in labels:
        place = np.array([label.x * shape[1], label.y * shape[0]])
        for body in bodies:
            points = body.keypoints[:, :2]
            trunk = float(np.linalg.norm(points[kp.NECK] - 0.5 * (points[kp.LEFT_HIP] + points[kp.RIGHT_HIP])))
            apart = float(np.linalg.norm(points[list(_HEAD)].mean(axis=0) - place))
            if apart < _NEAR * trunk:
                pairs.append((apart, label, body))
    matched: Dict[LabelledFace, object] = {}
    taken: List[object] = []
    for _, label, body in sorted(pairs, key=lambda pair: pair[0]):
        if label not in matched and not any(body is other for other in taken):
            matched[label] = body
            taken.append(body)
    return matched
