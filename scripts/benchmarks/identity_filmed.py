"""Several real cameras with one view: is each human of a film one person, and is it where the cameras say together?

The demonstration films of Pose2Sim (BSD-3-Clause): four calibrated cameras, 60 images a second, 1.7 s, a man on a
treadmill, in one of two scenes with a woman drawn into the films beside him, and an operator in the background whom
two cameras see. Here they run to and fro, 10 images a second. Each camera has a pipeline of faces and one of bodies of
its own; all bodies go to one `PersonManager`, for each choice of two to four cameras. Who is who follows from the sight
lines of the trunk over the whole film; the truth of a place is where the sight lines of a head's middle meet, of three
cameras or four.
"""

from __future__ import annotations

import itertools
import os
import tempfile
import zipfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Counter as CounterType
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple
from xml.etree import ElementTree

import cv2
import numpy as np

from benchmarks.face_figures import GEOMETRY_ONLY
from benchmarks.identity_returns import FilmError, images
from hri_fullbody.core import keypoints as kp
from hri_fullbody.core.detection.windows import FaceBox
from hri_fullbody.core.parameters import BODIES
from hri_fullbody.core.pipeline import BodyPipeline
from hri_person_manager.core.features import Kind, MatchNode
from hri_person_manager.core.location import Place, PlaceSource
from hri_person_manager.core.manager import PersonManager
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_pipeline.core.camera import Calibration, CameraModel
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.geometry import Pose

PACKAGE, VERSION = "pose2sim", "0.10.49"
SCENES = ("Demo_SinglePerson", "Demo_MultiPerson")
_CALIBRATION = "Pose2Sim/Demo_MultiPerson/calibration/Calib.qca.txt"
_FILM_HZ, RATE_HZ, SECONDS, SETTLED_S, CLOTHES_EVERY = 60.0, 10.0, 10.0, 3.0, 5
_UNITS = 64.0       # of the calibration, in a pixel
_TRUNK = (kp.NECK, kp.RIGHT_SHOULDER, kp.LEFT_SHOULDER, kp.RIGHT_HIP, kp.LEFT_HIP)
_SEEN = 0.5
_MEET_M = 0.06      # median distance of the sight lines of one human's trunk; of two humans: .08 m and more
# As on a machine that is fast enough: with a limit of time, answers would hang on the load.
_UNLIMITED = {"cpu_share": 0.0, "pose_budget": 0, "pose_rate": 0.0}


@dataclass(frozen=True)
class FilmCamera:
    """A camera of the films. rotation: (3, 3) from the world, whose z points up, to the optical frame; position: (3,) m
    in the world."""

    name: str
    model: CameraModel
    rotation: np.ndarray
    position: np.ndarray

    def sight_line(self, pixel: np.ndarray) -> np.ndarray:
        """Return the unit vector (3,) in the world from the camera through a pixel (2,)."""
        ray = np.append(self.model.normalise(np.asarray(pixel, dtype=float)[None])[0][:2], 1.0) @ self.rotation
        return ray / np.linalg.norm(ray)


class BodyView(NamedTuple):
    """A body in one image: head (3,) m in the world, key points (18, 3) px and confidence, and its clothes."""

    id: str
    head: Optional[Pose]
    keypoints: np.ndarray
    clothes: Optional[np.ndarray]


Film = Dict[str, List[List[BodyView]]]
"""The bodies of each image, by camera."""
SightLines = Dict[Tuple[int, int], np.ndarray]
"""Unit vectors (3,) in the world by image and key point."""


def find_package() -> Path:
    """Return the wheel with the films, that $ROS4HRI_POSE2SIM names. Raises FilmError with the mend."""
    path = Path(os.environ.get("ROS4HRI_POSE2SIM", ""))
    if not path.is_file():
        raise FilmError("the films are not there: `pip download --no-deps {}=={}` brings a wheel of 51 MB, "
                        "ROS4HRI_POSE2SIM names its path".format(PACKAGE, VERSION))
    return path


def read_calibration(text: str) -> List[FilmCamera]:
    """Read the cameras of a Qualisys calibration (XML). Raises ValueError when something is missing."""
    cameras = []
    for camera in ElementTree.fromstring(text).iter("camera"):
        place, lens, view = (camera.find(name) for name in ("transform", "intrinsic", "fov_video"))
        if place is None or lens is None or view is None:
            raise ValueError("camera {} of the calibration is not whole".format(camera.get("serial")))
        # Rows: right, up and backwards of the camera in the world; an optical frame looks forwards, y down.
        axes = np.array([[float(place.attrib["r{}{}".format(row, column)]) for column in (1, 2, 3)]
                         for row in (1, 2, 3)])
        matrix = np.eye(3)
        for row, axis in enumerate("UV"):
            matrix[row, row] = float(lens.attrib["focalLength" + axis]) / _UNITS
            matrix[row, 2] = float(lens.attrib["centerPoint" + axis]) / _UNITS
        names = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
        distortion = np.array([float(lens.attrib[name]) for name in names] + [0.0])
        size = int(view.attrib["right"]) + 1, int(view.attrib["bottom"]) + 1
        cameras.append(FilmCamera(
            camera.attrib["serial"], CameraModel(*size, matrix, distortion, "plumb_bob", Calibration.CALIBRATED),
            np.diag([1.0, -1.0, -1.0]) @ axes, 1e-3 * np.array([float(place.attrib[axis]) for axis in "xyz"])))
    return cameras


def to_and_fro(count: int) -> Iterator[int]:
    """Yield the numbers of the images of a film that runs forwards and backwards for ever."""
    return itertools.cycle([*range(count), *range(count - 2, 0, -1)])


def watch(camera: FilmCamera, film: Sequence[np.ndarray], seconds: float = SECONDS) -> List[List[BodyView]]:
    """Return what the pipelines of a camera see of a film of `RATE_HZ` images a second."""
    faces, bodies = FacePipeline(FACES.resolve(GEOMETRY_ONLY)), BodyPipeline(BODIES.resolve(_UNLIMITED))
    found = []
    numbers = to_and_fro(len(film))
    for index in range(int(seconds * RATE_HZ)):
        image, stamp = film[next(numbers)], index / RATE_HZ
        boxes = [FaceBox(face.id, face.box, face.pose) for face in faces.update(image, camera.model, stamp)]
        seen = bodies.update(image, camera.model, stamp, boxes, up=camera.rotation[:, 2])
        views = []
        for body in seen:
            model = bodies.model(body)
            head = None if model is None else Pose(camera.rotation.T @ model.head.rotation,
                                                   camera.rotation.T @ model.head.translation + camera.position)
            views.append(BodyView(camera.name + body.id, head, body.keypoints, bodies.appearance(body.id)))
        found.append(views)
    return found


def lines_apart(one: np.ndarray, other: np.ndarray, between: np.ndarray) -> float:
    """Return the distance (m) of two lines of unit directions (3,), whose origins are `between` (3,) m apart."""
    normal = np.cross(one, other)
    return float(abs(between @ normal) / max(1e-9, float(np.linalg.norm(normal))))


def meeting_point(origins: Sequence[np.ndarray], directions: Sequence[np.ndarray]) -> np.ndarray:
    """Return the point (3,) m of the least squared distances to lines of unit directions."""
    projections = [np.eye(3) - np.outer(direction, direction) for direction in directions]
    return np.linalg.solve(sum(projections), sum(p @ origin for p, origin in zip(projections, origins)))


def humans_of(film: Film, cameras: Sequence[FilmCamera]) -> Dict[str, int]:
    """Return which human each body is: those whose trunks' sight lines meet, the nearest first."""
    tracks = {camera.name: _trunks(film[camera.name], camera) for camera in cameras}
    distances = sorted(
        (apart, first, second) for one, other in itertools.combinations(cameras, 2)
        for first, second in itertools.product(tracks[one.name], tracks[other.name])
        for apart in [_apart(tracks[one.name][first], tracks[other.name][second], other.position - one.position)]
        if apart < _MEET_M)
    groups = {body: {body} for bodies in tracks.values() for body in bodies}
    together = {frozenset(pair) for images_of in film.values() for views in images_of
                for pair in itertools.combinations([view.id for view in views], 2)}
    for _, first, second in distances:
        joined = groups[first] | groups[second]
        if not any(frozenset(pair) in together for pair in itertools.combinations(joined, 2)):
            groups.update({body: joined for body in joined})
    numbers: Dict[int, int] = {}
    return {body: numbers.setdefault(id(group), len(numbers)) for body, group in groups.items()}


def _trunks(images_of: Sequence[Sequence[BodyView]], camera: FilmCamera) -> Dict[str, SightLines]:
    """Sight lines of the seen points of each body's trunk."""
    lines: Dict[str, SightLines] = {}
    for index, views in enumerate(images_of):
        for view in views:
            lines.setdefault(view.id, {}).update({
                (index, point): camera.sight_line(view.keypoints[point, :2])
                for point in _TRUNK if view.keypoints[point, 2] >= _SEEN})
    return lines


def _apart(one: SightLines, other: SightLines, between: np.ndarray) -> float:
    both = [lines_apart(one[key], other[key], between) for key in one.keys() & other.keys()]
    return float(np.median(both)) if both else np.inf


def true_heads(film: Film, cameras: Sequence[FilmCamera], humans: Dict[str, int], index: int) -> Dict[int, np.ndarray]:
    """Return the middles of the heads (3,) m of those whom three cameras see from both ears on."""
    lines: Dict[int, List[Tuple[np.ndarray, np.ndarray]]] = {}
    for camera in cameras:
        for view in film[camera.name][index]:
            ears = view.keypoints[[kp.RIGHT_EAR, kp.LEFT_EAR]]
            if ears[:, 2].min() > 0.3:
                lines.setdefault(humans[view.id], []).append(
                    (camera.position, camera.sight_line(ears[:, :2].mean(axis=0))))
    return {human: meeting_point(*zip(*found)) for human, found in lines.items() if len(found) >= 3}


class Score:
    """What one choice of cameras makes of a film."""

    def __init__(self) -> None:
        self.counts: CounterType[str] = Counter()
        self.errors: List[float] = []
        self.wrong: Set[Tuple[int, ...]] = set()

    def judge(self, manager: PersonManager, seen: Sequence[BodyView], humans: Dict[str, int],
              heads: Dict[int, np.ndarray], now: float) -> None:
        """Count what is right and wrong after the image of `now` (s)."""
        made: Dict[str, Set[int]] = {}
        for view in seen:
            person = manager.person_of(MatchNode(Kind.BODY, view.id))
            if person is not None:
                made.setdefault(person, set()).add(humans[view.id])
        owners = Counter(human for of in made.values() for human in of)
        self.counts.update(images=1, extra=any(count > 1 for count in owners.values()),
                           missing=bool({humans[view.id] for view in seen} - set(owners)))
        self.wrong.update(tuple(sorted(of)) for of in made.values() if len(of) > 1)
        for state in manager.snapshot(now).persons:
            of = made.get(state.id, set())
            if len(of) == 1 and of <= set(heads) and state.place is not None:
                self.errors.append(float(np.linalg.norm(state.place.pose.translation - heads[next(iter(of))])))


def score(film: Film, cameras: Sequence[FilmCamera], chosen: Sequence[FilmCamera], humans: Dict[str, int]) -> Score:
    """Give the bodies of some cameras to a person manager, and judge it from `SETTLED_S` on."""
    found, numbers = Score(), itertools.count()
    manager = PersonManager(PERSON_MANAGER_PARAMETERS.resolve({}), lambda: "a{:04d}".format(next(numbers)))
    for index in range(len(film[chosen[0].name])):
        now = index / RATE_HZ
        seen = [view for camera in chosen for view in film[camera.name][index]]
        manager.on_tracked(Kind.BODY, [view.id for view in seen], now)
        for camera in chosen:
            for view in film[camera.name][index]:
                if view.head is not None:
                    manager.on_place(PlaceSource.HEAD, view.id, Place("map", view.head, now, origin=camera.position),
                                     now, camera.name)
                if view.clothes is not None and index % CLOTHES_EVERY == 0:
                    manager.on_appearance(view.id, view.clothes)
        manager.tick(now)
        if now >= SETTLED_S:
            found.judge(manager, seen, humans, true_heads(film, cameras, humans, index), now)
    return found


def load_scene(package: zipfile.ZipFile, scene: str, cameras: Sequence[FilmCamera]) -> Film:
    """Return what each camera sees of a scene. Raises FilmError for a film that cannot be read."""
    film: Film = {}
    with tempfile.TemporaryDirectory() as directory:
        for camera in cameras:
            path = package.extract("Pose2Sim/{}/videos/{}.mp4".format(scene, camera.name), directory)
            pictures = [_filled(image, camera.model.width, camera.model.height)
                        for image in itertools.islice(images(Path(path)), 0, None, round(_FILM_HZ / RATE_HZ))]
            if len(pictures) < 2:
                raise FilmError("{} of {} cannot be read".format(Path(path).name, scene))
            film[camera.name] = watch(camera, pictures)
    return film


def _filled(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """The image with black borders at the right and below, as large as it was calibrated."""
    return cv2.copyMakeBorder(image[:height, :width], 0, max(0, height - image.shape[0]), 0,
                              max(0, width - image.shape[1]), cv2.BORDER_CONSTANT)


def figures() -> Dict[str, object]:
    """What `scripts/benchmark identity` reports of real cameras."""
    found: List[Score] = []
    people = 0
    with zipfile.ZipFile(str(find_package())) as package:
        cameras = read_calibration(package.read(_CALIBRATION).decode("utf-8"))
        for scene in SCENES:
            film = load_scene(package, scene, cameras)
            humans = humans_of(film, cameras)
            people += len(set(humans.values()))
            found += [score(film, cameras, chosen, humans) for count in range(2, len(cameras) + 1)
                      for chosen in itertools.combinations(cameras, count)]
    counts: CounterType[str] = sum((one.counts for one in found), Counter())
    errors = [error for one in found for error in one.errors]
    return {"filmed_cameras": {
        "extra_time": round(counts["extra"] / counts["images"], 4), "wrong_joins": sum(len(one.wrong) for one in found),
        "error_m": round(float(np.mean(errors)), 3)},
        "details": {"filmed_people": people, "filmed_missing_time": round(counts["missing"] / counts["images"], 4),
                    "filmed_error_p95_m": round(float(np.percentile(errors, 95)), 3)},
        "input": "{} scenes filmed by {} cameras, {} choices of 2 to 4 of them, {:g} s each".format(
            len(SCENES), len(cameras), len(found), SECONDS)}
