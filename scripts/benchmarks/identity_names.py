"""How often a face bears the wrong name, and how often the right one: people who are enrolled, strangers, and kin.

Real are the faces: the pictures and films that fetch_models gets, of 44 people. A picture becomes a film of a few
seconds by small changes of size, place, light, sharpness and noise; films are shown as they are. Simulated are the
people who look like somebody enrolled: their templates are drawn at the distances that were measured between kin, and
vary from view to view as those of the real films do. Simulated, too, is how the templates of a person of whom there is
one picture differ from one day to another.

The people are divided into two halves before anything is measured. The calibrations were chosen on `tuning`; the
figures are those of `report`.
"""

from __future__ import annotations

import zlib
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Dict, Iterator, List, Mapping, Optional, Sequence, Set, Tuple

import cv2
import numpy as np

from benchmarks.labels import LabelledFace, frames, images, nearest_face
from benchmarks.recognition import HFOV, PUBLISHED_AS_KNOWN, identities, recognise_twice
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.observations import FaceObservation
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.core.recognition.embedding import FaceEmbedder, load_face_embedder, unit
from hri_pipeline.core.recognition.face_identity import ACCEPT
from hri_pipeline.core.recognition.gallery import MemoryGallery
from hri_pipeline.core.recognition.recogniser import Recogniser

MODELS = ("face_recognition", "mobilefacenet")
"""The networks; the figures are those of the first, which is the default."""
TUNING_FIRST = ("one", "talking")
TUNING_NEVER = ("other", "grimaces", "smiling", "weeping")
"""Which half the people without a number are in; of the others the odd ones are in `tuning`."""
FILMS = {"talking.mp4": 60.0, "grimaces_1.mp4": 25.0, "grimaces_2.mp4": 20.0, "smile.mp4": 10.0,
         "weeping_laughing.mp4": 20.0}
"""Seconds that are used of each film, in pieces of PIECE seconds spread over all of it."""
PIECE, STEP, PERIOD = 10.0, 0.125, 0.25
"""Times (s): a piece of a film, between two images, between two templates."""
VIEWS = 16
"""Templates of each picture."""
KIN = {"face_recognition": (0.32, 0.49), "mobilefacenet": (0.98, 1.34)}
"""Distances of somebody alike from the template of who is like him. Of face_recognition: as measured on kin and
children. Of mobilefacenet: inferred from its error rate on a film of alike people, not measured."""
HARD_KIN = {"face_recognition": (0.26, 0.32), "mobilefacenet": (0.80, 0.98)}
"""The same of twins, nearly: nearer than any that were measured. In the details only."""
ANOTHER_DAY = {"face_recognition": (0.20, 0.06), "mobilefacenet": (0.45, 0.15)}
"""Mean and standard deviation of how far a person's templates lie from those of another day (on real pictures of one
person, single views, 0.23 +- 0.07 and 0.52 +- 0.16 are measured, views included)."""
KIN_NAME = "kin "
GALLERIES, ENROLLED, KIN_MET, SECONDS = 6, 12, 16, 8.0
"""Galleries per half, people enrolled in each, kin that are met, and for how long (s) everybody is."""


def half_of(person: str) -> str:
    """Return the half of the people, `tuning` or `report`, that a label is in."""
    digits = person.rpartition("_")[2]
    is_tuning = int(digits) % 2 == 1 if digits.isdigit() else person in TUNING_FIRST
    return "tuning" if is_tuning and person not in TUNING_NEVER else "report"


@dataclass(frozen=True)
class Appearance:
    """Templates (N, D) by network of one person in one picture or piece of a film, PERIOD apart."""

    person: str
    source: str
    is_film: bool
    templates: Mapping[str, np.ndarray]


@dataclass
class Outcome:
    """Times (s) for which people were visible, rightly and wrongly named; of several encounters the sum."""

    visible: float = 0.0
    right: float = 0.0
    wrong: float = 0.0
    encounters: int = 0
    wrong_encounters: int = 0

    def add(self, other: "Outcome") -> None:
        """Add those of another."""
        for name in ("visible", "right", "wrong", "encounters", "wrong_encounters"):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def shares(self) -> Dict[str, float]:
        """Return the shares of the visible time, and how many encounters there were."""
        visible = self.visible or 1.0
        return {"right": round(self.right / visible, 4), "wrong": round(self.wrong / visible, 4),
                "encounters": self.encounters, "wrong_encounters": self.wrong_encounters}


# ---- real faces

def appearances(embedders: Mapping[str, FaceEmbedder]) -> List[Appearance]:
    """Return everybody on the labelled pictures and films."""
    # With time for all, so that a busy machine gives the same meshes.
    pipeline = FacePipeline(FACES.resolve({"recognition": False, "gallery": "", "face_budget": 1000.0,
                                           "action_units": False, "expression": False, "age_gender": False}))
    return list(_of_pictures(pipeline, embedders)) + list(_of_films(pipeline, embedders))


def _of_pictures(pipeline: FacePipeline, embedders: Mapping[str, FaceEmbedder]) -> Iterator[Appearance]:
    wanted = [label for label in identities() if not label.file.endswith(".mp4")]
    for of_image, image in images(wanted, models_directory()):
        faces = _faces_of(pipeline, image)
        for label in of_image:
            found = nearest_face(label, np.array([face.box for face in faces]), image.shape)
            if found is not None:
                crops = _moving(image, faces[found], _generator(label))
                yield Appearance(label.label, label.file, False, {
                    name: embedder.embed([embedder.crop(*crop) for crop in crops])
                    for name, embedder in embedders.items()})


def _generator(label: LabelledFace) -> np.random.RandomState:
    return np.random.RandomState(zlib.crc32("{}{}".format(label.file, label.label).encode()) % 2 ** 31)


def _faces_of(pipeline: FacePipeline, image: np.ndarray) -> List[FaceObservation]:
    pipeline.reset()
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    faces: List[FaceObservation] = []
    for number in range(8):
        faces = pipeline.update(image, camera, 1.0 + 0.2 * number)
    return faces


def _moving(image: np.ndarray, face: FaceObservation,
            random: np.random.RandomState) -> List[Tuple[np.ndarray, np.ndarray]]:
    """Return VIEWS images of a face, with its mesh, as of somebody who moves a little before a camera: size, roll and
    light change smoothly, sharpness, noise and the errors of the mesh from view to view."""
    width = float(face.box[2] - face.box[0])
    low = np.maximum(face.box[:2] - width, 0.0).astype(int)
    high = (face.box[2:] + width).astype(int)
    part, mesh = image[low[1]:high[1], low[0]:high[0]], face.mesh[:, :2] - low
    walk = np.cumsum(0.35 * random.randn(VIEWS, 3), axis=0) + random.randn(3)
    walk = np.sin(walk)     # -1..1, smooth
    views = []
    for size, roll, light in walk:
        scale = min(1.0, 75.0 * np.exp(0.6 * size) / width)
        angle = np.deg2rad(15.0 * roll)
        turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        side = int(3.0 * scale * width) + 8
        affine = np.column_stack([turn, side / 2.0 - turn @ mesh.mean(axis=0)])
        view = cv2.warpAffine(cv2.GaussianBlur(part, (0, 0), max(0.3, 0.4 / scale)), affine, (side, side))
        view = cv2.GaussianBlur(view, (0, 0), random.uniform(0.3, 1.0))
        noise = random.uniform(0.0, 6.0) * random.randn(*view.shape)
        view = np.clip((1.0 + 0.25 * light) * view + noise, 0.0, 255.0).astype(np.uint8)
        error = 0.01 * random.randn(2) + 0.006 * random.randn(len(mesh), 2)
        views.append((view, mesh @ turn.T + affine[:, 2] + error * scale * width))
    return views


def _of_films(pipeline: FacePipeline, embedders: Mapping[str, FaceEmbedder]) -> Iterator[Appearance]:
    people = {label.file.rpartition("/")[2]: label.label for label in identities()}
    for name, seconds in FILMS.items():
        path = models_directory() / "evaluation" / name
        capture = cv2.VideoCapture(str(path))
        rate, length = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        capture.release()
        pieces = max(1, int(min(seconds, length / rate) / PIECE))
        for piece in range(pieces):
            begin = int(piece * length / pieces)
            end = min(begin + int(PIECE * rate), length)
            templates = _film_templates(pipeline, embedders, path, np.arange(begin, end - 1, max(1.0, STEP * rate)))
            if len(templates[MODELS[0]]) >= 4:
                yield Appearance(people[name], "{} {}".format(name, piece), True, templates)


def _film_templates(pipeline: FacePipeline, embedders: Mapping[str, FaceEmbedder], path: object,
                    numbers: np.ndarray) -> Dict[str, np.ndarray]:
    pipeline.reset()
    found: Dict[str, List[np.ndarray]] = {name: [] for name in embedders}
    for index, (_, image) in enumerate(frames(path, [int(number) for number in numbers])):     # type: ignore[arg-type]
        camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
        faces = [face for face in pipeline.update(image, camera, 1.0 + STEP * index) if face.measured]
        if faces and index % int(PERIOD / STEP) == 0:
            face = max(faces, key=lambda one: float(one.box[2] - one.box[0]))
            for name, embedder in embedders.items():
                found[name].append(embedder.embed([embedder.crop(image, face.mesh, camera)])[0])
    return {name: np.array(some, np.float32).reshape(len(some), embedders[name].dimension)
            for name, some in found.items()}


# ---- people who do not exist

def at_distance(start: np.ndarray, towards: np.ndarray, distance: float) -> np.ndarray:
    """Return the unit vector (D,) at a distance (0 to 2) from a unit vector, in the direction of another."""
    across = towards - (towards @ start) * start
    across = across / np.linalg.norm(across)
    angle = 2.0 * np.arcsin(distance / 2.0)
    return np.cos(angle) * start + np.sin(angle) * across


def around(centre: np.ndarray, film: np.ndarray) -> np.ndarray:
    """Return templates (N, D) that vary around a unit vector (D,) as those of a film (N, D) do around their mean."""
    return unit(centre + film - unit(film.mean(axis=0)))


# ---- meeting people

class Meetings:
    """A recogniser and whoever comes along; knows who is who.

    Parameters
    ----------
    gallery : empty.
    seed : of the ids.
    """

    def __init__(self, gallery: MemoryGallery, seed: int) -> None:
        self.recogniser = Recogniser(gallery, ids=IdGenerator(seed=seed))
        self._now, self._number = 100.0, 0
        self._human_of: Dict[str, str] = {}

    def enrol(self, human: str, templates: np.ndarray) -> bool:
        """Show somebody for 2 s and enrol the face; False where that is refused, as for somebody alike."""
        outcome = Outcome()
        face_id = self._show(human, templates[:8], outcome, 2.0)
        try:
            self._human_of[self.recogniser.enrol(face_id)] = human
        except ValueError:
            return False
        finally:
            self.recogniser.keep([])
        return True

    def meet(self, human: str, templates: np.ndarray, seconds: float = SECONDS) -> Outcome:
        """Show somebody; ids that the recogniser makes meanwhile are that human's."""
        outcome = Outcome(encounters=1)
        self._show(human, templates, outcome, seconds)
        outcome.wrong_encounters = int(outcome.wrong > 0.0)
        self.recogniser.keep([])
        if human.startswith(KIN_NAME):
            # How alike the kin of two people are to each other was not measured.
            for person in [person for person, name in self._human_of.items() if name == human]:
                self.recogniser.forget(person)
        self._now += 5.0
        return outcome

    def time_until_taken_back(self, human: str, templates: np.ndarray, other: np.ndarray) -> Optional[float]:
        """Show somebody for 6 s and then somebody else as the same face; returns for how long (s) the name stays, None
        where there was none. At most 10 s."""
        self._show(human, templates, Outcome(), 6.0 + self._number % 8 * STEP)
        named = [person for person, likelihood in self._told.items() if likelihood >= PUBLISHED_AS_KNOWN]
        stays = None
        if named and self._human_of.get(named[0]) == human:
            begin, stays = self._now, 0.0
            while stays < 10.0 and self._told[named[0]] >= PUBLISHED_AS_KNOWN:
                self._show("somebody else", other[int(stays / PERIOD) % len(other):], Outcome(), STEP, goes_on=True)
                stays = self._now - begin
        self.recogniser.keep([])
        self._now += 5.0
        return stays

    def _show(self, human: str, templates: np.ndarray, outcome: Outcome, seconds: float, goes_on: bool = False) -> str:
        if not goes_on:
            self._number += 1
            self._told: Dict[str, float] = {}
        face_id, begin = "face{}".format(self._number), self._now
        while self._now < begin + seconds:
            self._now += STEP
            due = self.recogniser.seen({face_id: 0.9}, self._now)
            self.recogniser.keep([face_id])
            index = int((self._now - begin) / PERIOD)
            # There and back again: a film that starts anew would jump.
            index = abs((index + len(templates) - 1) % max(1, 2 * len(templates) - 2) - (len(templates) - 1))
            changes = (self.recogniser.update(due, templates[index:index + 1], [0.9], self._now) if due
                       else self.recogniser.changes())
            self._told.update({match.person_id: match.likelihood for match in changes if match.face_id == face_id})
            self._judge(human, outcome)
        return face_id

    def _judge(self, human: str, outcome: Outcome) -> None:
        names: Set[str] = set()
        for person, likelihood in self._told.items():
            if likelihood >= PUBLISHED_AS_KNOWN:
                names.add(self._human_of.setdefault(person, human))
        outcome.visible += STEP
        outcome.wrong += STEP * bool(names - {human})
        outcome.right += STEP * (names == {human})


@dataclass
class Half:
    """The people of one half, for one network: templates by person and source, and the films of all."""

    model: str
    calibrated: FaceEmbedder
    people: Dict[str, List[np.ndarray]]
    films: List[np.ndarray]
    outcomes: Dict[str, Outcome] = field(default_factory=lambda: defaultdict(Outcome))
    stays: List[float] = field(default_factory=list)
    refused: int = 0

    def run(self, seed: int) -> None:
        """Fill a gallery with some of the people, and meet them, the others, and kin of those in the gallery."""
        random = np.random.RandomState(seed)
        names = [str(name) for name in random.permutation(sorted(self.people))]
        embedder = self.calibrated
        meetings = Meetings(MemoryGallery(embedder.kind, embedder.dimension, embedder.calibration), seed)
        known = {}
        for name in names[:ENROLLED]:
            if meetings.enrol(name, self.people[name][0]):
                known[name] = unit(self.people[name][0][:8].mean(axis=0))
            else:
                self.refused += 1
        encounters = (self._of_enrolled(list(known), random) + [("stranger", name, self.people[name][0])
                                                                for name in names[ENROLLED:]]
                      + self._of_kin("kin", KIN, known, random, 0))
        for index in random.permutation(len(encounters)):
            kind, human, templates = encounters[index]
            self.outcomes[kind].add(meetings.meet(human, templates))
        for kind, human, templates in self._of_kin("nearly twins", HARD_KIN, known, random, KIN_MET):
            self.outcomes[kind].add(meetings.meet(human, templates))
        self._swap(meetings, known, random)

    def _film(self, random: np.random.RandomState) -> np.ndarray:
        return self.films[random.randint(len(self.films))]

    def _of_enrolled(self, names: Sequence[str], random: np.random.RandomState) -> List[Tuple[str, str, np.ndarray]]:
        """Everybody again: other pictures or pieces of film where there are some, and a day that is simulated."""
        encounters = []
        mean, deviation = ANOTHER_DAY[self.model]
        for name in names:
            own = self.people[name]
            encounters += [("enrolled, another picture", name, other) for other in own[1:4]]
            if len(own) == 1:
                encounters.append(("enrolled, the same picture", name, own[0][8:]))
                shift = float(np.clip(random.normal(mean, deviation), 0.25 * mean, mean + 3.0 * deviation))
                centre = at_distance(unit(own[0].mean(axis=0)), random.randn(own[0].shape[1]), shift)
                encounters.append(("enrolled, another day (simulated)", name, around(centre, self._film(random))))
        return encounters

    def _of_kin(self, kind: str, distances: Mapping[str, Tuple[float, float]], known: Mapping[str, np.ndarray],
                random: np.random.RandomState, first: int) -> List[Tuple[str, str, np.ndarray]]:
        """Somebody alike: at a distance that is drawn from somebody enrolled, and of nobody else's likeness."""
        encounters = []
        for number in range(KIN_MET):
            name = sorted(known)[random.randint(len(known))]
            centre = self._alike(name, known[name], random.uniform(*distances[self.model]), random)
            human = "{}{} of {}".format(KIN_NAME, first + number, name)
            encounters.append((kind, human, around(centre, self._film(random))))
        return encounters

    def _alike(self, name: str, template: np.ndarray, distance: float, random: np.random.RandomState) -> np.ndarray:
        """Return a unit vector (D,) at a distance from a template (D,) of a person, in a direction in which people
        differ, and as far from everybody else as strangers are."""
        others = np.stack([unit(some[0].mean(axis=0)) for other, some in sorted(self.people.items())
                           if other != name])
        spread = others - others.mean(axis=0)
        best, farthest = template, -1.0
        for _ in range(30):
            centre = at_distance(template, unit(random.randn(len(spread)) @ spread), distance)
            nearest = float(np.linalg.norm(others - centre, axis=1).min())
            if nearest > farthest:
                best, farthest = centre, nearest
        return best

    def _swap(self, meetings: Meetings, known: Mapping[str, np.ndarray], random: np.random.RandomState) -> None:
        """Faces that become somebody else's: a kin's or anybody's."""
        for name in sorted(known):
            names = sorted(self.people)
            stranger = self.people[names[random.randint(len(names))]][0]
            alike = around(self._alike(name, known[name], random.uniform(*KIN[self.model]), random), self._film(random))
            others = [alike] + ([stranger] if not np.array_equal(stranger, self.people[name][0]) else [])
            for other in others:
                stays = meetings.time_until_taken_back(name, self.people[name][0], other)
                self.stays += [] if stays is None else [stays]

    def report(self) -> Dict[str, object]:
        """Return the figures of this half."""
        strangers, enrolled = Outcome(), Outcome()
        for kind, outcome in self.outcomes.items():
            if kind in ("stranger", "kin"):
                strangers.add(outcome)
            elif kind.startswith("enrolled"):
                enrolled.add(outcome)
        calibration = self.calibrated.calibration
        limit = calibration.limit(ACCEPT, ENROLLED, 4.0)
        return {"stranger_wrong_name": strangers.shares()["wrong"],
                "enrolled_precision": round(enrolled.right / max(1e-9, enrolled.right + enrolled.wrong), 4),
                "enrolled_recall": enrolled.shares()["right"],
                "name_stays_s": {"p50": _percentile(self.stays, 50), "p95": _percentile(self.stays, 95),
                                 "over_2": sum(stays > 2.0 for stays in self.stays), "swaps": len(self.stays)},
                "by_kind": {kind: outcome.shares() for kind, outcome in sorted(self.outcomes.items())},
                "enrolment_refused_as_alike": self.refused, "named_up_to_distance": round(limit, 3),
                "bound_of_false_matches": dict(zip(("stranger", "kin"), (
                    round(rate, 4) for rate in calibration.false_match_rates(limit, ENROLLED, 4.0))))}


def _percentile(values: Sequence[float], percent: float) -> Optional[float]:
    return round(float(np.percentile(values, percent)), 2) if values else None


def halves(model: str, embedder: FaceEmbedder, everybody: Sequence[Appearance]) -> Dict[str, Half]:
    """Return the two halves of the people for one network."""
    result = {name: Half(model, embedder, defaultdict(list), []) for name in ("tuning", "report")}
    for one in everybody:
        half = result[half_of(one.person)]
        half.people[one.person].append(one.templates[model])
        if one.is_film:
            half.films.append(one.templates[model])
    return result


def figures() -> Dict[str, object]:
    """Return the figures of the default network on the half `report`; in `details` those of both on both halves."""
    embedders = {name: load_face_embedder(name) for name in MODELS
                 if name == MODELS[0] or (models_directory() / (name + ".onnx")).is_file()}
    everybody = appearances(embedders)
    details: Dict[str, Dict[str, object]] = {}
    for model, embedder in embedders.items():
        details[model] = {}
        for number, (name, half) in enumerate(sorted(halves(model, embedder, everybody).items())):
            for gallery in range(GALLERIES):
                half.run(1000 * number + gallery)
            details[model][name] = half.report()
    found = details[MODELS[0]]["report"]
    assert isinstance(found, dict)
    closed = recognise_twice(identities(), models_directory())
    details["closed_sets"] = {
        "mistakes": closed.mistakes,
        "pictures of the figure `recognition`": recognise_twice(identities(asked_only=True), models_directory()).counts}
    return {"stranger_wrong_name": found["stranger_wrong_name"], "enrolled_precision": found["enrolled_precision"],
            "enrolled_recall": found["enrolled_recall"], "closed_sets": closed.counts,
            "details": {"names": details},
            "input": "{} people on {} pictures and pieces of film; simulated: kin, and other days".format(
                len({one.person for one in everybody}), len(everybody))}
