"""Who looks at whom on real photographs: the whole way from the picture to the gaze, against the labels of
gazes.txt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from benchmarks.labels import LabelledFace, images, nearest_face, read_labels
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.action_units import BLINK, EYES_CLOSED
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.gaze import gaze_frame
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.frames import RawTransform
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.interactions.gaze import ROBOT, GazeTargets
from hri_pipeline.core.interactions.parameters import INTERACTION_PARAMETERS, InteractionSettings
from hri_pipeline.core.interactions.people import Observer, PeopleTf, Seen, gather
from hri_pipeline.core.observations import FaceObservation

TABLE = Path(__file__).with_name("gazes.txt")
CAMERA, PERSON, NOBODY, CLOSED = "camera", "person", "nobody", "closed"
WRONG_PERSON, NOT_FOUND = "wrong person", "not found"
TRUTHS = (CAMERA, PERSON, NOBODY, CLOSED)
FRAMES, USE_FACS = "frames", "use_facs"
ANSWERS = (CAMERA, PERSON, WRONG_PERSON, NOBODY, CLOSED, NOT_FOUND)

PHOTOGRAPH_HFOV = math.radians(53.0)
RATE_HZ, SECONDS = 10.0, 2.0
_SENSOR = "camera"
# The camera is held level: x ahead, y to the left, z up, from the optical frame's x right, y down, z ahead.
_LEVEL = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
_TILE = 640
_COLOURS = {True: (80, 220, 80), False: (60, 60, 255)}


class GazeAnswer(NamedTuple):
    """kind: of ANSWERS; target: of a person, the point (2,) px between the eyes; direction: (2,) of the gaze in the
    image."""

    kind: str
    target: Optional[np.ndarray] = None
    direction: Optional[np.ndarray] = None


@dataclass(frozen=True)
class LabelledGaze:
    """A face whose gaze is known.

    truth: of TRUTHS; target: x, y of the one who is looked at, fractions of the image.
    """

    face: LabelledFace
    truth: str
    target: Optional[Tuple[float, float]] = None


def labelled_gazes(path: Optional[Path] = None) -> List[LabelledGaze]:
    """Read the labels, by default those of this package. Raises ValueError naming the file and what stands there."""
    path = path or TABLE
    found = []
    for face in read_labels(path):
        words = face.label.split()
        try:
            if words[:1] == [PERSON]:
                x, y = (float(word) for word in words[1:])
                found.append(LabelledGaze(face, PERSON, (x, y)))
                continue
        except ValueError:
            pass
        if face.label not in (CAMERA, NOBODY, CLOSED):
            raise ValueError("{}: the label {!r} of {} is none of camera, nobody, closed, `person X Y`".format(
                path, face.label, face.file))
        found.append(LabelledGaze(face, face.label))
    return found


def confusion(gazes: Sequence[LabelledGaze], answers: Sequence[GazeAnswer]) -> Dict[str, Dict[str, int]]:
    """Count, for each truth, the answers. Raises ValueError when the lengths differ."""
    if len(gazes) != len(answers):
        raise ValueError("{} labels and {} answers".format(len(gazes), len(answers)))
    table = {truth: dict.fromkeys(ANSWERS, 0) for truth in TRUTHS}
    for gaze, answer in zip(gazes, answers):
        table[gaze.truth][answer.kind] += 1
    return table


def told_of(table: Mapping[str, Mapping[str, int]]) -> Dict[str, float]:
    """Return precision and recall of the looks into the camera and at people out of a confusion table, and how many
    looks were told and are there."""
    told = {truth: sum(row[answer] for answer in (CAMERA, PERSON, WRONG_PERSON)) for truth, row in table.items()}
    right = table[CAMERA][CAMERA] + table[PERSON][PERSON]
    there = sum(table[CAMERA].values()) + sum(table[PERSON].values())
    return {"precision": right / max(1, sum(told.values())), "recall": right / max(1, there),
            "told": sum(told.values()), "looks": there}


def photographs(models: Path, overlay: Optional[Path] = None, settings: Optional[InteractionSettings] = None
                ) -> Dict[str, Dict[str, Dict[str, int]]]:
    """Return confusion tables, rows truth, of all labelled faces; each picture is looked at as a film of 2 s.

    `frames`: from the frames of faces and gazes alone, as by default; there, eyes that are closed from the first image
    on are known to be so once any face of the camera had a gaze, so all pictures are of one camera. `use_facs`: with
    the action units of the lids, too, as with the parameter of that name. models: directory of the models and pictures;
    overlay: where to write all pictures with what was found with use_facs, green where it is right; settings: of the
    interactions node, None: the defaults. Raises FileNotFoundError with the mend when a picture is absent, OSError when
    the overlay cannot be written.
    """
    settings = settings or INTERACTION_PARAMETERS.resolve({})
    labels = labelled_gazes()
    by_face = {gaze.face: gaze for gaze in labels}
    stage = FacePipeline(FACES.resolve(dict.fromkeys(("expression", "age_gender", "recognition"), False)))
    frames = PeopleTf()
    gazes: List[LabelledGaze] = []
    answers: Dict[str, List[GazeAnswer]] = {FRAMES: [], USE_FACS: []}
    tiles: List[np.ndarray] = []
    try:
        for faces, image in images([gaze.face for gaze in labels], models):
            group = [by_face[face] for face in faces]
            told = _answers(stage, frames, image, group, settings)
            gazes += group
            for name in answers:
                answers[name] += told[name]
            if overlay is not None:
                tiles.append(_drawn(image, group, told[USE_FACS]))
    finally:
        stage.close()
    if overlay is not None and not cv2.imwrite(str(overlay), _mosaic(tiles)):
        raise OSError("{} cannot be written".format(overlay))
    return {name: confusion(gazes, found) for name, found in answers.items()}


def _answers(stage: FacePipeline, frames: PeopleTf, image: np.ndarray, gazes: Sequence[LabelledGaze],
             settings: InteractionSettings
             ) -> Dict[str, List[GazeAnswer]]:
    """Return what is found of the labelled faces of a picture, without and with the action units."""
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], PHOTOGRAPH_HFOV)
    targets = {name: GazeTargets(settings) for name in (FRAMES, USE_FACS)}
    stage.reset()
    faces: List[FaceObservation] = []
    looks: Dict[str, Dict[str, str]] = {}
    people: Dict[str, Dict[str, Observer]] = {}
    for index in range(int(SECONDS * RATE_HZ)):
        stamp = 1000.0 + index / RATE_HZ
        faces = stage.update(image, camera, stamp, None, FaceDemand(action_units=frozenset(stage.tracked_ids)))
        lids = {face.id: _lids(face, stamp) for face in faces if face.action_units is not None}
        for name in targets:
            seen = observers(frames, faces, stamp, settings, lids if name == USE_FACS else {})
            looks[name] = {gaze.sender: gaze.receiver for gaze in targets[name].update(seen, np.zeros(3), stamp)}
            people[name] = {person.id: person for person in seen}
    boxes = np.array([face.box for face in faces]).reshape(-1, 4)
    rows = [nearest_face(gaze.face, boxes, image.shape) for gaze in gazes]
    return {name: [_answer(gaze, None if row is None else faces[row], people[name], looks[name], faces, image.shape,
                           settings)
                   for gaze, row in zip(gazes, rows)] for name in targets}


def _lids(face: FaceObservation, stamp: float) -> Seen:
    """Closedness of the eyes in the action units, as the interactions node reads them."""
    units = face.action_units
    return Seen(stamp, max(float(units.intensity[unit]) for unit in (EYES_CLOSED, BLINK)))


def observers(frames: PeopleTf, faces: Sequence[FaceObservation], stamp: float, settings: InteractionSettings,
              lids: Mapping[str, Seen]) -> List[Observer]:
    """Return the people of these faces as the interactions node makes them of their frames; ids are those of the faces.

    A level frame at the camera takes the place of the reference frame. lids: closedness of the eyes by face.
    """
    placed = [face for face in faces if face.pose is not None]
    frames.set_people(face.id for face in placed)
    for face in placed:
        pose = face.pose
        frames.set_feature(face.id, "face", face.id)
        frames.put(_raw(_SENSOR, "face_" + face.id, stamp, pose), fixed=False)
        if face.gaze is not None and face.gaze.direction is not None:
            frames.put(_raw("face_" + face.id, "gaze_" + face.id, stamp, gaze_frame(pose, face.gaze.direction)),
                       fixed=False)
    return gather(frames, lambda sensors: {name: _LEVEL for name in sensors}, stamp, settings, lids).observers()


def _raw(parent: str, child: str, stamp: float, pose: Pose) -> RawTransform:
    nanoseconds = int(round(stamp * 1e9))
    x, y, z = pose.translation.tolist()
    return RawTransform(parent, child, nanoseconds // 10 ** 9, nanoseconds % 10 ** 9, (x, y, z), pose.quaternion)


def _answer(gaze: LabelledGaze, face: Optional[FaceObservation], people: Mapping[str, Observer],
            looks: Mapping[str, str],
            faces: Sequence[FaceObservation], shape: Sequence[int], settings: InteractionSettings) -> GazeAnswer:
    if face is None or face.id not in people:
        return GazeAnswer(NOT_FOUND)
    person, receiver = people[face.id], looks.get(face.id)
    direction = person.gaze_direction if person.gaze_direction is not None else person.head_direction
    arrow = None if direction is None else -direction[1:]          # y left, z up: to the right and down in the image
    if receiver is None:
        closed = person.eyes_closed is not None and person.eyes_closed >= settings.closed_threshold
        return GazeAnswer(CLOSED if closed else NOBODY, direction=arrow)
    if receiver == ROBOT:
        return GazeAnswer(CAMERA, direction=arrow)
    other = next(one for one in faces if one.id == receiver)
    target = other.landmarks[36:48, :2].mean(axis=0)
    right = False
    if gaze.target is not None:
        label = LabelledFace(gaze.face.file, gaze.face.frame, gaze.target[0], gaze.target[1], "")
        index = nearest_face(label, np.array([one.box for one in faces]), shape)
        right = index is not None and faces[index].id == receiver
    return GazeAnswer(PERSON if right else WRONG_PERSON, target, arrow)


def _drawn(image: np.ndarray, gazes: Sequence[LabelledGaze], answers: Sequence[GazeAnswer]) -> np.ndarray:
    """Return a picture, _TILE wide, with an arrow or a ring (camera) at each labelled face, and label and answer in
    words."""
    scale = _TILE / image.shape[1]
    tile = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for gaze, answer in zip(gazes, answers):
        colour = _COLOURS[gaze.truth == answer.kind]
        start = np.array([gaze.face.x * tile.shape[1], gaze.face.y * tile.shape[0]])
        if answer.target is not None:
            cv2.arrowedLine(tile, _pixel(start), _pixel(answer.target * scale), colour, 2, cv2.LINE_AA)
        elif answer.direction is not None and answer.kind != CLOSED:
            cv2.arrowedLine(tile, _pixel(start), _pixel(start + 60.0 * answer.direction), colour, 2, cv2.LINE_AA,
                            tipLength=0.3)
        if answer.kind == CAMERA:
            cv2.circle(tile, _pixel(start), 9, colour, 2, cv2.LINE_AA)
        words = answer.kind if gaze.truth == answer.kind else "{}, is {}".format(answer.kind, gaze.truth)
        for thickness, ink in ((5, (0, 0, 0)), (2, colour)):
            cv2.putText(tile, words, _pixel(start + (-50.0, -20.0)), cv2.FONT_HERSHEY_SIMPLEX, 0.7, ink, thickness,
                        cv2.LINE_AA)
    return tile


def _pixel(point: np.ndarray) -> Tuple[int, int]:
    return int(round(float(point[0]))), int(round(float(point[1])))


def _mosaic(tiles: Sequence[np.ndarray], columns: int = 3) -> np.ndarray:
    height = max(tile.shape[0] for tile in tiles)
    tiles = [cv2.copyMakeBorder(tile, 0, height - tile.shape[0], 0, 0, cv2.BORDER_CONSTANT) for tile in tiles]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    return np.vstack([np.hstack(tiles[row:row + columns]) for row in range(0, len(tiles), columns)])
