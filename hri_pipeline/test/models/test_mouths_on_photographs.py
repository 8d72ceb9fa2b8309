"""Mouths of real pictures that are made to speak: what comes of it through the face stage, and whose voice it is."""

import cv2
import numpy as np
import pytest

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.parameters import FACES
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.matching.parameters import VOICE_MATCHER_PARAMETERS
from hri_pipeline.core.matching.voice import FACE, MouthTrack, VoiceMatcher, opening_of_landmarks, opening_of_units
from hri_pipeline.core.onnx import models_directory

STEP = 1.0 / 15.0
HFOV = np.deg2rad(53.0)
SECONDS = 3.0
SILENCE = 1.2
WIDTH = 800
PICTURES = ("sample1", "sample2")    # in the first somebody laughs with the mouth wide open: AU25 is at its fullest
# Vertices of the face mesh: inner lips (upper, lower), corners of the mouth, chin.
UPPER, LOWER, CORNERS, CHIN = 13, 14, (61, 291), 152
INSIDE = (30, 30, 60)      # BGR of an open mouth
NOISE = 4.0                # grey values of a camera in a room


@pytest.fixture(scope="module")
def stage():
    return FacePipeline(FACES.resolve({"face_budget": 1000.0}))    # the same looks on a busy machine


def photograph(name):
    path = models_directory() / "demo" / (name + ".jpg")
    image = cv2.imread(str(path))
    assert image is not None, "no picture {}; get it with `rosrun hri_pipeline fetch_models`".format(path)
    return cv2.resize(image, None, fx=WIDTH / image.shape[1], fy=WIDTH / image.shape[1], interpolation=cv2.INTER_AREA)


def open_mouth(image, mesh, gap):
    """Return the picture with the lower lip and the chin of a face moved down by up to `gap` px, dark between the
    lips."""
    left, right = sorted((mesh[CORNERS[0], :2], mesh[CORNERS[1], :2]), key=lambda point: point[0])
    across = (right - left) / np.linalg.norm(right - left)
    down = np.array([-across[1], across[0]])
    middle, half = 0.5 * (mesh[UPPER, :2] + mesh[LOWER, :2]), 0.5 * np.linalg.norm(right - left)
    reach = 1.6 * float((mesh[CHIN, :2] - middle) @ down)
    rows, columns = np.mgrid[:image.shape[0], :image.shape[1]].astype(np.float32)
    aside = ((columns - middle[0]) * across[0] + (rows - middle[1]) * across[1]) / half
    below = (columns - middle[0]) * down[0] + (rows - middle[1]) * down[1]
    width = np.sqrt(np.clip(1.0 - aside ** 2, 0.0, 1.0)) * gap
    moved = np.where(below > 0.0, width * np.clip(1.0 - (below - width) / reach, 0.0, 1.0), 0.0)
    opened = cv2.remap(image, (columns - moved * down[0]).astype(np.float32),
                       (rows - moved * down[1]).astype(np.float32),
                       cv2.INTER_LINEAR)
    opened[(below > 0.0) & (below < width)] = INSIDE
    return opened


def film(stage, image, random):
    """Per image: {id: (action units, landmarks 0..1, aspect)}; the first face of the picture speaks after SILENCE."""
    height, width = image.shape[:2]
    camera = CameraModel.from_fov(width, height, HFOV)
    stage.reset()
    for index in range(15):
        faces = stage.update(image, camera, 101.0 + (index - 15) * STEP)
    speaker = max(faces, key=lambda face: np.ptp(face.mesh[:, 1]))
    eyes = 0.45 * np.ptp(speaker.mesh[:, 0])
    noise = random.normal(0.0, NOISE, (4,) + image.shape).astype(np.float32)
    found, place = [], np.zeros(2)
    for index in range(int((SILENCE + SECONDS) / STEP)):
        stamp = index * STEP
        speech = (
            max(0.0, np.sin(2.0 * np.pi * 2.1 * stamp)) * (0.6 + 0.4 * np.sin(5.1 * stamp)) if stamp > SILENCE else 0.0
        )
        frame = open_mouth(image, speaker.mesh, 0.14 * eyes * speech)
        place = 0.9 * place + random.normal(0.0, 0.5, 2)          # a head is never quite still, nor is a camera
        shift = np.float32([[1, 0, place[0]], [0, 1, place[1]]])
        frame = cv2.warpAffine(frame, shift, (width, height), borderMode=cv2.BORDER_REPLICATE)
        frame = np.clip(frame + noise[index % len(noise)], 0, 255).astype(np.uint8)
        faces = stage.update(frame, camera, 101.0 + stamp, demand=FaceDemand(frozenset(stage.tracked_ids)))
        found.append({face.id: (face.action_units, face.landmarks / np.array([width, height, 1.0]), width / height)
                      for face in faces})
    return speaker.id, found


def opening(seen, source):
    units, landmarks, aspect = seen
    if source == "landmarks":
        return opening_of_landmarks(landmarks, aspect)
    return (0.0, 0.0) if units is None else opening_of_units(units.intensity, units.confidence)


def heard(found, source, tracks):
    """Return [(time, kind, id)] of whom the voice was matched to; `tracks` {face: MouthTrack} get the mouths, too."""
    matcher = VoiceMatcher(VOICE_MATCHER_PARAMETERS.resolve({}))
    matcher.set_tracked("faces", found[-1])
    matcher.set_tracked("voices", ["v1"])
    owners = []
    for index, faces in enumerate(found):
        now = index * STEP
        if abs(now - SILENCE) < 0.5 * STEP:
            matcher.on_speaking("v1", True, now + 0.06)
        for face, seen in faces.items():
            sample = opening(seen, source)
            matcher.add_mouth(face, now, *sample)
            if face in tracks:
                tracks[face].add(now, *sample)
        owners += [(now, match.kind, match.id) for match in matcher.matches(now + 0.1)]
    return owners


@pytest.mark.parametrize("name", PICTURES)
def test_the_face_that_speaks_is_matched_by_its_landmarks_and_no_other(stage, name):
    speaker, found = film(stage, photograph(name), np.random.default_rng(3))
    tracks = {face: MouthTrack() for face in found[-1]}
    owners = heard(found, "landmarks", tracks)
    times = np.arange(SILENCE + 0.5, SILENCE + SECONDS - 0.5, 0.25)
    outcome = ({face: np.nanmedian(track.motion(times)[0]) for face, track in tracks.items()}, owners)
    assert {owner[1:] for owner in owners} == {(FACE, speaker)}, outcome
    assert owners[0][0] < SILENCE + 1.5 and owners[-1][0] > SILENCE + SECONDS - 0.5, outcome


def test_by_its_action_units_the_face_that_speaks_is_matched_more_than_all_others(stage):
    """One film tells little: roundings decide in which of them the units of a small face find its speaker."""
    counts = {}
    for seed in range(6):
        speaker, found = film(stage, photograph("sample2"), np.random.default_rng(seed))
        counts[seed] = [owner[1:] == (FACE, speaker) for owner in heard(found, "units", {})]
    assert sum(map(sum, counts.values())) > 0.5 * sum(map(len, counts.values())), counts
    assert sum(any(right) for right in counts.values()) >= 3, counts
