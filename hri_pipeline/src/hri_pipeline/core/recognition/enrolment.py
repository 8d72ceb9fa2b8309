"""Enrolment from photographs: somebody who has agreed gets a name and templates in the store, without a camera.

Each photograph has to show one face, well enough; the faces have to be alike, so that a picture of somebody else is
found out. The person is noted as having agreed (`enrolled`), with the time of the enrolment as the first one seen.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.crops import judge_crop, looks_smeared
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.privacy import StoreError
from hri_pipeline.core.recognition.gallery import MAX_TEMPLATES
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.recogniser import COVERED, DARK_GLASSES, SMEARED
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore, StoredPerson

ENDINGS = (".jpg", ".jpeg", ".png", ".bmp", ".webp")
LEAST_QUALITY = 0.4
_IMAGES, _PERIOD_S = 6, 0.2     # a photograph is shown for so many images: a weak detection is looked at twice
_HFOV = np.deg2rad(53.0)
_LONGEST_SIDE = 1600            # px


class EnrolmentError(ValueError):
    """Photographs of which nobody can be made; the text says which, and why."""


class PhotographTemplates(NamedTuple):
    """Templates (K, D) of one person, the network that they are of, and what was left out and why.

    calibration: of the distances of that network's templates.
    """

    templates: np.ndarray
    model: str
    calibration: TemplateCalibration
    left_out: Tuple[str, ...]


def photographs(directory: Path) -> List[Path]:
    """Return the pictures of a directory, or the file itself. Raises EnrolmentError when there is none."""
    found = [directory] if directory.is_file() else sorted(
        path for path in directory.glob("*") if path.suffix.lower() in ENDINGS)
    if not found:
        raise EnrolmentError("{}: no photographs ({}) there".format(directory, ", ".join(ENDINGS)))
    return found


def templates_of(paths: Sequence[Path], model: str = "") -> PhotographTemplates:
    """Return the templates of the one person on all photographs.

    model: recognition network, empty for the default. Raises EnrolmentError, and ModelError for a missing network.
    """
    pipeline = FacePipeline(FACES.resolve({"recognition_model": model, "action_units": False, "expression": False,
                                           "age_gender": False, "recognition_policy": "enrolled",
                                           "face_person_lead": 0.0}))      # somebody says that these are people
    try:
        assert pipeline.recognition is not None
        embedder = pipeline.recognition.embedder
        templates, used, left_out = [], [], []
        for number, path in enumerate(paths):
            picture = _read(path)
            crop, problem = (None, "no picture, or one too large") if picture is None else _crop(
                pipeline, picture, 1000.0 + 60.0 * number)
            if crop is None:
                left_out.append("{}: {}".format(path.name, problem))
                continue
            template = embedder.embed([crop])
            problem = (COVERED if embedder.covered([crop], template)[0] else
                       SMEARED if looks_smeared(crop) else "")
            if problem:
                left_out.append("{}: {}".format(path.name, problem))
                continue
            templates.append(template[0])
            used.append(path.name)
    finally:
        pipeline.close()
    if not templates:
        raise EnrolmentError("no photograph can be used: {}".format("; ".join(left_out)))
    stack = np.stack(templates).astype(np.float32)
    apart = embedder.calibration.apart(stack, stack)
    first, second = np.unravel_index(int(apart.argmax()), apart.shape)
    if apart[first, second] > embedder.calibration.fair_midpoint:
        raise EnrolmentError("{} and {} do not show the same person (distance {:.2f}, {:.2f} at most)".format(
            used[int(first)], used[int(second)], apart[first, second], embedder.calibration.fair_midpoint))
    return PhotographTemplates(stack[:MAX_TEMPLATES], embedder.kind, embedder.calibration, tuple(left_out))


def _read(path: Path) -> Optional[np.ndarray]:
    """Return a picture, BGR, None for another file; no side is longer than _LONGEST_SIDE, nor shorter than 1 px."""
    try:
        picture = cv2.imread(str(path))
    except cv2.error:       # more pixels than OpenCV takes
        return None
    if picture is None or max(picture.shape[:2]) <= _LONGEST_SIDE:
        return picture
    scale = _LONGEST_SIDE / max(picture.shape[:2])
    height, width = (max(1, round(scale * side)) for side in picture.shape[:2])
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _crop(pipeline: FacePipeline, picture: np.ndarray, begin: float) -> Tuple[Optional[np.ndarray], str]:
    """Return the crop of the one face of a picture for the network; None, and why."""
    camera = CameraModel.from_fov(picture.shape[1], picture.shape[0], _HFOV)
    pipeline.reset()
    for number in range(_IMAGES):
        faces = pipeline.update(picture, camera, begin + _PERIOD_S * number)
    if len(faces) != 1:
        return None, "{} faces, one is wanted".format(len(faces) or "no")
    face, recognition = faces[0], pipeline.recognition
    assert recognition is not None
    crop = recognition.embedder.crop(picture, face.mesh)
    if judge_crop(face.mesh, face.pose, crop).template_quality < LEAST_QUALITY:
        return None, "the face is too small, blurred, dark, overexposed or turned away"
    if face.dark_glasses:
        return None, DARK_GLASSES
    return crop, ""


def enrol(store: PersonStore, name: str, found: PhotographTemplates, now: float) -> str:
    """Write somebody who has agreed at `now` (s) with name and templates; returns the new id.

    Raises StoreError, also while another process uses the store: it would write its own view of who is new; and
    EnrolmentError when the store holds somebody who looks the same.
    """
    with store.alone() as is_alone:
        if not is_alone:
            raise StoreError("{} is in use; end the robot's nodes first, or enrol who is seen now: people enrol "
                             "ID".format(store.path))
        return _enrol(store, name, found, now)


def _enrol(store: PersonStore, name: str, found: PhotographTemplates, now: float) -> str:
    known = store.load_templates(found.model, found.templates.shape[1])
    for person in known:
        distance = float(found.calibration.apart(person.templates, found.templates).min())
        if distance < found.calibration.fair_midpoint:
            raise EnrolmentError("{} is in the store already and looks the same (distance {:.2f}); `people forget` or "
                                 "`people name` them".format(person.id, distance))
    taken = {record.id for record in store.load_records()}
    ids = IdGenerator()
    person_id = next(new for new in iter(ids.new, None) if new not in taken)
    record = StoredPerson(person_id, enrolled=True, first_seen=now, last_seen=now)
    with store.change():
        store.put_record(replace(record, name=name.strip()))
        store.put_templates(KnownPerson(person_id, found.templates, True), found.model, now)
    return person_id
