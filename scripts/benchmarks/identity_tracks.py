"""A track is one face: how long the name of one person stays on the face of another who has taken the place.

Films are made of photographs: one person is seen and enrolled, then another one's face stands at the same place, after
a hard cut, a cross-fade, an exchange of the face alone, an occlusion, or a walk in front. Others, of one person only
(swings, shakes, lights, real films with blinks and turns), tell how often a face that went on was taken for a new one.

The people of the demonstration's photographs were used to set the thresholds (`TUNING`); the figure is that of the
others, who share neither a photograph nor a film with them.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from typing import Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np

from benchmarks.labels import LabelledFace, images, nearest_face
from benchmarks.recognition import HFOV, PUBLISHED_AS_KNOWN, identities, recognising_stage
from benchmarks.report import models_directory
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.observations import FaceObservation

TUNING = "demo/"
"""Where the people stand with whom thresholds were set."""
WIDTH, HEIGHT, FACE = 640, 480, 110.0
"""Size of the films, and of their faces, px."""
RATE, FIRST, SECOND = 10.0, 2.2, 2.5
"""Images per second; time (s) of the first person, and of the second."""
ENROLLED = 1.2
"""Time (s) at which the first person gets a name, before that is learnt as somebody new."""
PAIRS = 8
"""Pairs of people for each way of changing."""
CENTRE = np.array([WIDTH / 2.0, HEIGHT / 2.0])
NAME = "known"
_FADE, _COVER = 0.5, 0.5
_WALK = 700.0
"""Speed (px/s) of somebody who walks in front."""
FILMS = ("grimaces_1", "grimaces_2", "smile", "talking", "weeping_laughing")
_FILM_IMAGES = 150
_EVERY = 2
"""Of a real film each second image is shown."""


@dataclass(frozen=True)
class Portrait:
    """A person on a photograph: name, file, and the view (HEIGHT, WIDTH, 3) with the face in its middle."""

    label: str
    file: str
    view: np.ndarray


Frame = Tuple[np.ndarray, Optional[np.ndarray], Optional[np.ndarray]]
"""An image, and where the faces of the first and the second person are in it, (2,) px, None where they are not seen."""


def portraits(tuning: bool) -> List[Portrait]:
    """Return everybody once, of the people for tuning or of the others. Raises FileNotFoundError with the mend."""
    wanted = [label for label in identities() if label.file.startswith(TUNING) == tuning]
    found: Dict[str, Portrait] = {}
    with closing(recognising_stage()) as stage:
        for of_image, image in images(wanted, models_directory()):
            for label, face in _found(stage, of_image, image):
                if label.label not in found and face is not None:
                    found[label.label] = Portrait(label.label, label.file, _view(image, face.box))
    return list(found.values())


def _found(stage: FacePipeline, of_image: Sequence[LabelledFace],
           image: np.ndarray) -> List[Tuple[LabelledFace, Optional[FaceObservation]]]:
    """Return the labelled faces of an image as the stage finds them."""
    stage.reset()
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    faces: List[FaceObservation] = []
    for index in range(10):
        faces = stage.update(image, camera, 0.2 * index)
    nearest = [nearest_face(label, np.array([face.box for face in faces]), image.shape) for label in of_image]
    return [(label, None if index is None else faces[index]) for label, index in zip(of_image, nearest)]


def _view(image: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return the part of an image about a face (box (4,) px), the face FACE px large in the middle."""
    scale = FACE / float((box[2:] - box[:2]).mean())
    shift = CENTRE - scale * (box[:2] + box[2:]) / 2.0
    if scale < 0.5:
        image = cv2.GaussianBlur(image, (0, 0), 0.4 / scale)
    return cv2.warpAffine(image, np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]]), (WIDTH, HEIGHT),
                          flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def head(to: np.ndarray, of: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the picture `to` with the head in the middle of `of` at `place` (2,) px, its rim soft."""
    row, column = np.indices((HEIGHT, WIDTH), dtype=np.float32)
    away = np.hypot((column - place[0]) / 0.75, (row - place[1] + 0.1 * FACE)) / FACE
    mask = np.clip((1.05 - away) / 0.15, 0.0, 1.0)[..., None]
    shift = place - CENTRE
    moved = cv2.warpAffine(of, np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]]), (WIDTH, HEIGHT),
                           borderMode=cv2.BORDER_REPLICATE)
    return (mask * moved + (1.0 - mask) * to).astype(np.uint8)


def cut(first: np.ndarray, second: np.ndarray, since: float) -> Frame:
    """Change the whole picture."""
    return (first, CENTRE, None) if since < 0.0 else (second, None, CENTRE)


def fade(first: np.ndarray, second: np.ndarray, since: float) -> Frame:
    """Let one picture become the other one; in its middle the face has changed."""
    part = float(np.clip(since / _FADE + 0.5, 0.0, 1.0))
    image = cv2.addWeighted(first, 1.0 - part, second, part, 0.0)
    return image, CENTRE if since < 0.0 else None, None if since < 0.0 else CENTRE


def exchange(first: np.ndarray, second: np.ndarray, since: float) -> Frame:
    """Put another head on the same shoulders."""
    return (first, CENTRE, None) if since < 0.0 else (head(first, second, CENTRE), None, CENTRE)


def occlusion(first: np.ndarray, second: np.ndarray, since: float) -> Frame:
    """Hide the face behind a board; when that is taken away, another one is there."""
    image = first if since < -_COVER else head(first, second, CENTRE)
    if not -_COVER <= since < 0.0:
        return image, CENTRE if since < 0.0 else None, None if since < 0.0 else CENTRE
    image = image.copy()
    image[HEIGHT // 6:-HEIGHT // 6, WIDTH // 4:-WIDTH // 4] = 70
    return image, None, None


def walk(first: np.ndarray, second: np.ndarray, since: float) -> Frame:
    """Let another head come from the left, and stay before the first one for ever."""
    x = min(CENTRE[0], CENTRE[0] + _WALK * since)
    if x < -FACE:
        return first, CENTRE, None
    place = np.array([x, CENTRE[1]])
    return head(first, second, place), CENTRE if CENTRE[0] - x > 1.2 * FACE else None, place


def pass_by(first: np.ndarray, second: np.ndarray, since: float) -> Frame:
    """Let another head walk past before the first one, which is there again afterwards."""
    x = CENTRE[0] + _WALK * since
    if not -FACE < x < WIDTH + FACE:
        return first, CENTRE, None
    place = np.array([x, CENTRE[1]])
    return head(first, second, place), CENTRE if abs(CENTRE[0] - x) > 1.2 * FACE else None, place


CHANGES: Mapping[str, Callable[[np.ndarray, np.ndarray, float], Frame]] = {
    "cut": cut, "fade": fade, "exchange": exchange, "occlusion": occlusion, "walk": walk, "pass_by": pass_by}
"""Ways in which somebody else's face comes to the place of the first one's, with the time since then (s)."""


def _unsteady(image: np.ndarray, time: float, random: np.random.RandomState) -> Tuple[np.ndarray, np.ndarray]:
    """Return the image of a hand-held camera with noise, and its shift (2,) px."""
    shift = np.array([8.0 * np.sin(2.1 * time), 5.0 * np.cos(3.3 * time)])
    moved = cv2.warpAffine(image, np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]]), (WIDTH, HEIGHT),
                           borderMode=cv2.BORDER_REPLICATE)
    noise = random.normal(0.0, 3.0, moved.shape[:2] + (1,))
    return np.clip(moved + noise, 0.0, 255.0).astype(np.uint8), shift


class Names:
    """Shows a film to a stage, to which everybody is new, and keeps which face bears the name."""

    def __init__(self, stage: FacePipeline) -> None:
        assert stage.recognition is not None
        stage.reset()
        self.recogniser = stage.recognition.recogniser
        self.recogniser.forget_all()
        self._stage = stage
        self._named: Dict[str, float] = {}

    def show(self, image: np.ndarray, stamp: float) -> List[FaceObservation]:
        """Show an image and return its faces."""
        camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
        faces = self._stage.update(image, camera, stamp, demand=FaceDemand(recognition=True))
        for match in self._stage.matches:
            if match.person_id == NAME:
                self._named[match.face_id] = match.likelihood
        return faces

    def bears(self, face: FaceObservation) -> bool:
        """Return whether this face is published as the known person."""
        return self._named.get(face.id, 0.0) >= PUBLISHED_AS_KNOWN


def at(faces: Sequence[FaceObservation], place: np.ndarray, reach: float = 0.5 * FACE) -> Optional[FaceObservation]:
    """Return the face nearest to a place (2,) px, None where there is none within `reach` px."""
    near = [(float(np.linalg.norm((face.box[:2] + face.box[2:]) / 2.0 - place)), face) for face in faces]
    near = [pair for pair in near if pair[0] < reach]
    return min(near, key=lambda pair: pair[0])[1] if near else None


@dataclass
class Outcome:
    """What became of a film.

    stays: time (s) after the change at which the second face bore the name for the last time, 0 for never; ever: it did
    at the end; returned: the first person had the same id and the name in the end, None where he does not come back;
    breaks: changes of the first person's id before.
    """

    stays: float = 0.0
    ever: bool = False
    returned: Optional[bool] = None
    breaks: int = 0


def take_over(stage: FacePipeline, change: str, first: Portrait, second: Portrait) -> Optional[Outcome]:
    """Show one film; None when the first person has no name when the second one comes."""
    outcome, random, ids, named = Outcome(), np.random.RandomState(0), [], False
    names = Names(stage)
    for index in range(int((FIRST + SECOND) * RATE)):
        since = index / RATE - FIRST
        picture, one, other = CHANGES[change](first.view, second.view, since)
        image, shift = _unsteady(picture, index / RATE, random)
        faces = names.show(image, 1000.0 + index / RATE)
        known = None if one is None else at(faces, one + shift)
        if known is not None:
            ids.append(known.id)
            named = names.bears(known)
            if abs(index / RATE - ENROLLED) < 0.5 / RATE:
                names.recogniser.enrol(known.id, NAME)
        if abs(since + 0.7) < 0.5 / RATE:
            outcome.breaks = len(set(ids)) - 1
            if not named:
                return None
        stranger = None if other is None else at(faces, other + shift)
        if stranger is not None and names.bears(stranger):
            outcome.stays = max(0.0, since) + 1.0 / RATE
            outcome.ever = index + 2 > (FIRST + SECOND) * RATE
    if change == "pass_by":
        outcome.returned = ids[-1] == ids[0] and named
    return outcome


def _chosen(people: Sequence[Portrait], count: int) -> List[Tuple[Portrait, Portrait]]:
    """Return pairs of people on different photographs, always the same ones."""
    pairs = [(a, b) for a in people for b in people if a.label != b.label and a.file != b.file]
    np.random.RandomState(1).shuffle(pairs)
    return pairs[:count]


def lights(view: np.ndarray, time: float) -> np.ndarray:
    """Switch the light on after 1.5 s: from a sixth to all of it, and from one side."""
    if time >= 1.5:
        return view
    side = np.linspace(0.25, 0.1, WIDTH)[None, :, None]
    return (view * side).astype(np.uint8)


def swing(view: np.ndarray, time: float) -> np.ndarray:
    """Pan by 150 px to and fro, twice per second at most 470 px/s."""
    shift = 75.0 * np.sin(2.0 * np.pi * time)
    return cv2.warpAffine(view, np.array([[1.0, 0.0, shift], [0.0, 1.0, 0.0]]), (WIDTH, HEIGHT),
                          borderMode=cv2.BORDER_REPLICATE)


def shake(view: np.ndarray, time: float) -> np.ndarray:
    """Knock against the camera each second: jumps of 60 px, and blur."""
    phase = time % 1.0
    if phase > 0.3:
        return view
    turn = cv2.getRotationMatrix2D((WIDTH / 2.0, HEIGHT / 2.0), 8.0 * np.sin(40.0 * phase), 1.0)
    turn[:, 2] += (60.0 * np.sin(47.0 * phase), 40.0 * np.cos(53.0 * phase))
    moved = cv2.warpAffine(view, turn, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)
    return cv2.blur(moved, (9, 1))


def turn(view: np.ndarray, time: float) -> np.ndarray:
    """Turn the picture of the head about the vertical as far as a picture can be, within 0.3 s, and back."""
    angle = np.deg2rad(50.0) * np.clip(4.0 * np.sin(2.0 * np.pi * time / 1.6), -1.0, 1.0)
    far, near = np.cos(angle), 0.35 * np.sin(angle)
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * 2.0 * FACE
    depth = 1.0 + near * corners[:, :1] / (4.0 * FACE)
    target = corners * np.array([far, 1.0]) / depth
    plane = cv2.getPerspectiveTransform((corners + CENTRE).astype(np.float32), (target + CENTRE).astype(np.float32))
    return cv2.warpPerspective(view, plane, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REPLICATE)


CONTINUATIONS: Mapping[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "lights": lights, "swing": swing, "shake": shake, "turn": turn}


def _made_film(change: str, person: Portrait) -> Iterator[np.ndarray]:
    random = np.random.RandomState(0)
    for index in range(int(3.0 * RATE)):
        yield _unsteady(CONTINUATIONS[change](person.view, index / RATE), index / RATE, random)[0]


def _real_film(name: str) -> Iterator[np.ndarray]:
    """Yield each second image. Raises FileNotFoundError when the film is absent."""
    path = models_directory() / "evaluation" / (name + ".mp4")
    if not path.is_file():
        raise FileNotFoundError("{} is absent; get it with `rosrun hri_pipeline fetch_models --models"
                                " evaluation`".format(path))
    capture = cv2.VideoCapture(str(path))
    try:
        for index in range(_EVERY * _FILM_IMAGES):
            found, image = capture.read()
            if not found:
                return
            if index % _EVERY == 0:
                yield image
    finally:
        capture.release()


def ids_of(stage: FacePipeline, film: Iterator[np.ndarray]) -> int:
    """Return how many ids the face in the middle of a film has had."""
    ids = set()
    names = Names(stage)
    for index, image in enumerate(film):
        middle = np.array([image.shape[1], image.shape[0]]) / 2.0
        face = at(names.show(image, 1000.0 + index / RATE), middle, float(middle.min()))
        if face is not None:
            ids.add(face.id)
    return len(ids)


def measured(tuning: bool, pairs: int = PAIRS) -> Dict[str, object]:
    """Return what happened to the people for tuning, or to the others: seconds by way of changing, and breaks."""
    people = portraits(tuning)
    result: Dict[str, object] = {}
    stays: List[float] = []
    with closing(recognising_stage()) as stage:
        for change in CHANGES:
            films = [take_over(stage, change, first, second) for first, second in _chosen(people, pairs)]
            outcomes = [outcome for outcome in films if outcome is not None]
            stays += [outcome.stays for outcome in outcomes]
            result[change] = _summary(change, outcomes)
        result["p95_s"] = _p95(stays)
        for name in CONTINUATIONS:
            counts = [ids_of(stage, _made_film(name, person)) for person in people[:pairs]]
            result[name] = {"films": len(counts), "ids": sum(counts)}
    return result


def _summary(change: str, outcomes: Sequence[Outcome]) -> Dict[str, object]:
    summary: Dict[str, object] = {
        "films": len(outcomes), "p95_s": _p95([outcome.stays for outcome in outcomes]),
        "for_ever": sum(outcome.ever for outcome in outcomes), "broken": sum(one.breaks for one in outcomes)}
    if change == "pass_by":
        summary["came_back"] = sum(bool(outcome.returned) for outcome in outcomes)
    return summary


def _p95(values: Sequence[float]) -> float:
    return float(np.percentile(values, 95)) if len(values) else float("nan")


def figures() -> Dict[str, object]:
    """Return `name_stays_p95_s`, over the people that nothing was tuned with, and the details."""
    result = measured(tuning=False)
    with closing(recognising_stage()) as stage:
        ids = {name: ids_of(stage, _real_film(name)) for name in FILMS}
    return {"name_stays_p95_s": result["p95_s"], "details": {"name_stays": result, "ids_of_films": ids},
            "input": "{} ways of changing, {} pairs of people each, at {:g} Hz".format(len(CHANGES), PAIRS, RATE)}
