"""How well faces are recognised, and how fast: on labelled photographs, and with a thousand people who do not exist."""

from __future__ import annotations

import tempfile
from contextlib import closing
from pathlib import Path
from typing import Callable, Dict, List, Sequence, Tuple

import numpy as np

from benchmarks.labels import LabelledFace, images, nearest_face, read_labels
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.observations import FaceObservation

TABLE = Path(__file__).with_name("identities.txt")
ASKED = ("demo/", "evaluation/recognition/")
"""Where the pictures of the figure `recognition` are."""
RATE, SECONDS = 5.0, 8.0
"""A photograph is shown as a film of so many images per second, for so long."""
HFOV = np.deg2rad(53.0)
PUBLISHED_AS_KNOWN = 0.5
"""Likelihood from which the person manager joins a face to a person."""


def identities(asked_only: bool = False) -> List[LabelledFace]:
    """Return who is who on the pictures, those of the figure `recognition` only or all of them."""
    return [label for label in read_labels(TABLE) if not asked_only or label.file.startswith(ASKED)]


class Encounters:
    """Shows images as films to a face stage that recognises, and counts who was recognised as whom."""

    def __init__(self, stage: FacePipeline) -> None:
        self._stamp = 1000.0
        self._id_of: Dict[str, str] = {}
        self.counts = {"right": 0, "wrong": 0, "unknown": 0}
        self.mistakes: List[str] = []
        self.use(stage)

    def use(self, stage: FacePipeline) -> None:
        """Go on with another stage, as in another run; what was learnt of who has which id stays.

        Raises ValueError for a stage that does not recognise.
        """
        if stage.recognition is None:
            raise ValueError("recognition is switched off in the face stage")
        self._stage, self._recogniser = stage, stage.recognition.recogniser

    def show(self, of_image: Sequence[LabelledFace], image: np.ndarray, rate: float = RATE,
             seconds: float = SECONDS) -> None:
        """Show one image. Everybody has left before."""
        self._stage.reset()
        faces: List[FaceObservation] = []
        told: Dict[Tuple[str, str], float] = {}
        camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
        for _ in range(int(rate * seconds)):
            self._stamp += 1.0 / rate
            faces = self._stage.update(image, camera, self._stamp, demand=FaceDemand(recognition=True))
            for match in self._stage.matches:
                told[match.face_id, match.person_id] = max(
                    match.likelihood, told.get((match.face_id, match.person_id), 0.0))
        for label in of_image:
            found = nearest_face(label, np.array([face.box for face in faces]), image.shape)
            self._judge(label, "" if found is None else faces[found].id, told)

    def _judge(self, label: LabelledFace, face_id: str, told: Dict[Tuple[str, str], float]) -> None:
        """Compare what was told of a face with who it is.

        right: the id of before, or one that nobody had; wrong: at any time joined to somebody else; unknown: no id, or
        a second one.
        """
        names = {person_id for (face, person_id), likelihood in told.items()
                 if face == face_id and likelihood >= PUBLISHED_AS_KNOWN}
        person_id = self._recogniser.person_of(face_id)
        others = {name for person, name in self._id_of.items() if person != label.label}
        if names & others:
            verdict = "wrong"
        elif person_id and self._id_of.setdefault(label.label, person_id) == person_id:
            verdict = "right"
        else:
            verdict = "unknown"
        self.counts[verdict] += 1
        if verdict != "right":
            self.mistakes.append("{} on {} (frame {}): {}{}".format(
                label.label, label.file, label.frame, verdict, ", a second id" if person_id else ""))


def recognising_stage(gallery: str = "", model: str = "") -> FacePipeline:
    """Return a face stage that recognises, and does nothing else.

    gallery: its file, empty for none; model: the network, empty for the default.

    Raises ModelError when a model is missing.
    """
    return FacePipeline(FACES.resolve({"gallery": gallery, "recognition_model": model, "action_units": False,
                                       "expression": False, "age_gender": False}))


def recognise_twice(wanted: Sequence[LabelledFace], models: Path,
                    say: Callable[[str], None] = lambda text: None, model: str = "") -> Encounters:
    """Show the pictures of `wanted` one after the other, everybody unknown at first, and again in another run that has
    only the file of the first.

    models: directory of the models; model: the network, empty for the default. Raises FileNotFoundError with the mend
    when a picture is absent.
    """
    with tempfile.TemporaryDirectory() as directory:
        file = str(Path(directory) / "faces.gallery")
        with closing(recognising_stage(file, model)) as stage:
            encounters = Encounters(stage)
            _show_all(encounters, wanted, models, lambda name: say("first run: " + name))
        with closing(recognising_stage(file, model)) as stage:
            encounters.use(stage)
            _show_all(encounters, wanted, models, lambda name: say("second run: " + name))
    return encounters


def _show_all(encounters: Encounters, wanted: Sequence[LabelledFace], models: Path, say: Callable[[str], None]) -> None:
    for of_image, image in images(wanted, models):
        say(of_image[0].file)
        encounters.show(of_image, image)


SIZE = 128
"""Numbers in a template."""


def template(person: int, distance: float = 0.0, view: int = 0) -> np.ndarray:
    """Return a unit vector (SIZE,) float32: a person's own, or one at a distance (0 to 2) from it, in the direction
    that `view` picks. Those of two persons are about sqrt(2) apart.
    """
    base = np.random.RandomState(person).randn(SIZE)
    base /= np.linalg.norm(base)
    across = np.random.RandomState(1000 * person + view + 7).randn(SIZE)
    across -= (across @ base) * base
    across /= np.linalg.norm(across)
    angle = 2.0 * np.arcsin(distance / 2.0)
    return (np.cos(angle) * base + np.sin(angle) * across).astype(np.float32)
