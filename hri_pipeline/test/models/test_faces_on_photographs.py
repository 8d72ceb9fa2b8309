"""The face stage on photographs of groups: counts, identities, poses. Needs the models and their pictures."""

import shutil
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.canonical_face import load_canonical_face
from hri_pipeline.core.face_parameters import FACES
from hri_pipeline.core.face_stage import FaceStage
from hri_pipeline.core.head_pose import yaw_pitch_roll
from hri_pipeline.core.model_store import models_directory
from hri_pipeline.core.onnx_model import ModelError
from hri_pipeline.core.parameters import ParameterError

COUNTS = {"sample1": 3, "sample2": 3, "sample3": 3, "sample4": 4, "sample5": 5, "sample6": 4}
STEP = 1.0 / 15.0
HFOV = np.deg2rad(53.0)
SETTLED = 12
"""Images after which every face is found: the detector has then looked twice at the whole and at two tiles."""


@pytest.fixture(scope="module")
def stage():
    return FaceStage(FACES.resolve({}))


def photograph(name):
    path = models_directory() / "demo" / (name + ".jpg")
    image = cv2.imread(str(path))
    assert image is not None, "no picture {}; get it with `rosrun hri_pipeline fetch_models`".format(path)
    return image


def watch(stage, images):
    """Feed images to the stage, STEP apart; returns a list of observations per image."""
    stage.reset()
    seen = []
    for index, image in enumerate(images):
        camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
        seen.append(stage.update(image, camera, 1000.0 + index * STEP))
    return seen


def ids(observations):
    return sorted(face.id for face in observations)


@pytest.mark.parametrize("name", sorted(COUNTS))
def test_a_photograph_as_video(stage, name):
    seen = watch(stage, [photograph(name)] * 30)
    assert [len(faces) for faces in seen[SETTLED:]] == [COUNTS[name]] * (30 - SETTLED)
    assert len({tuple(ids(faces)) for faces in seen[SETTLED:]}) == 1
    assert len({identity for faces in seen for identity in ids(faces)}) == COUNTS[name], "no id came and went"
    for face in seen[-1]:
        check(face, photograph(name).shape)


def check(face, shape):
    assert face.pose is not None, "a plausible head"
    assert 0.3 < face.pose.translation[2] < 6.0
    assert np.abs(np.degrees(yaw_pitch_roll(face.pose))).max() < 90.0
    assert np.linalg.det(face.pose.rotation) == pytest.approx(1.0)
    assert face.landmarks.shape == (70, 3) and face.mesh.shape == (478, 3)
    assert (face.landmarks[:, 2] >= 0.0).all() and (face.landmarks[:, 2] <= 1.0).all()
    assert face.landmarks[:, 2].max() > 0.5
    camera = CameraModel.from_fov(shape[1], shape[0], HFOV)
    origin = camera.project(face.pose.translation[None])[0]
    bridge = face.landmarks[27, :2]
    assert np.linalg.norm(origin - bridge) < 0.15 * np.ptp(face.box[[0, 2]]), "the frame lies on the nasal bridge"


def panned(name):
    """The picture through a 1280 x 720 window that sways slowly."""
    image = photograph(name)
    scale = 1340.0 / image.shape[1]
    image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for index in range(45):
        left, top = int(30 + 25 * np.sin(index / 9.0)), int(25 + 20 * np.cos(index / 7.0))
        yield image[top:top + 720, left:left + 1280]


@pytest.mark.parametrize("name", sorted(COUNTS))
def test_a_slow_pan_changes_no_id(stage, name):
    seen = watch(stage, panned(name))
    assert max(len(faces) for faces in seen) == COUNTS[name]
    assert len({identity for faces in seen for identity in ids(faces)}) == COUNTS[name]
    assert len(stage.tracked_ids) == COUNTS[name]


def test_faces_die_in_the_dark_and_ids_never_come_again(stage):
    image = cv2.resize(photograph("sample1"), (960, 640), interpolation=cv2.INTER_AREA)
    dark = np.zeros_like(image)
    seen = watch(stage, [image] * 10 + [dark] * 20 + [image] * 10)
    assert len(seen[9]) == len(seen[-1]) == 3
    assert seen[12] == [] and seen[29] == []
    assert not set(ids(seen[9])) & set(ids(seen[-1]))


def disc(image, face, size):
    """A round cut-out of a face, (size, size, 3), and its mask."""
    middle, reach = (face.box[:2] + face.box[2:]) / 2.0, 0.75 * (face.box[3] - face.box[1])
    (x0, y0), (x1, y1) = (middle - reach).astype(int), (middle + reach).astype(int)
    patch = cv2.resize(image[y0:y1, x0:x1], (size, size), interpolation=cv2.INTER_AREA)
    row, column = np.indices((size, size)) - size / 2.0
    return patch, (row ** 2 + column ** 2 < (0.48 * size) ** 2)[..., None]


def test_faces_that_pass_each_other_keep_their_ids(stage):
    image = photograph("sample3")
    people = sorted(watch(stage, [image] * SETTLED)[-1], key=lambda face: face.box[0])
    front, behind = disc(image, people[0], 400), disc(image, people[2], 340)
    frames, places = [], range(200, 1080, 20)
    for place in places:
        frame = np.full((720, 1280, 3), 90, np.uint8)
        for (patch, mask), x in ((behind, 1280 - place), (front, place)):
            half = len(patch) // 2
            np.copyto(frame[360 - half:360 + half, x - half:x + half], patch, where=mask)
        frames.append(frame)
    seen = watch(stage, frames)
    before, after = ({face.id: face.box[0] for face in faces} for faces in (seen[6], seen[-1]))
    assert len(before) == 2 and before.keys() == after.keys()
    assert min(before, key=before.get) == max(after, key=after.get)


def test_time_that_goes_back_is_a_new_start(stage):
    image = cv2.resize(photograph("sample1"), (960, 640), interpolation=cv2.INTER_AREA)
    before = ids(watch(stage, [image] * 8)[-1])
    camera = CameraModel.from_fov(960, 640, HFOV)
    assert stage.update(image, camera, 5.0) == [], "younger than the birth delay"
    stage.update(image, camera, 5.2)
    after = ids(stage.update(image, camera, 5.4))
    assert len(after) == 3 and not set(before) & set(after)


@pytest.mark.parametrize("size", [(640, 480), (333, 777), (1, 1)])
def test_images_of_any_size_without_faces(stage, size):
    noise = np.random.RandomState(0).randint(0, 255, (size[1], size[0], 3), np.uint8)
    assert watch(stage, [noise] * 5)[-1] == []


def test_faces_of_people_looking_ahead_have_no_pitch_on_average(stage):
    """Guards the correction of the model's pitch: 19 of the 22 people look roughly towards the camera."""
    pitches = []
    for name in COUNTS:
        for face in watch(stage, [photograph(name)] * SETTLED)[-1]:
            yaw, pitch, _ = np.degrees(yaw_pitch_roll(face.pose))
            x, y, z = face.pose.translation
            if abs(yaw) < 25.0:
                pitches.append(pitch - np.degrees(np.arctan2(y, z)))
    assert len(pitches) >= 10
    assert abs(np.median(pitches)) < 5.0


def test_the_sellion_is_the_deepest_point_of_the_bridge():
    vertices = load_canonical_face(models_directory() / "canonical_face.npz").vertices
    bridge = [9, 8, 168, 6, 197, 195, 5, 4]
    assert max(bridge, key=lambda index: vertices[index, 2]) == 168


@pytest.mark.parametrize("name", ["face_detector_model", "face_mesh_model", "canonical_face"])
def test_a_missing_a_wrong_and_a_damaged_file_are_told_by_name(tmp_path, name):
    with pytest.raises(ModelError, match="absent.onnx"):
        FaceStage(FACES.resolve({name: str(tmp_path / "absent.onnx")}))
    wrong = tmp_path / "wrong.onnx"
    shutil.copy(str(models_directory() / "pose_landmarks_full.onnx"), str(wrong))
    with pytest.raises(ModelError, match="wrong.onnx"):
        FaceStage(FACES.resolve({name: str(wrong)}))
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(b"\x08\x07 this is no model")
    with pytest.raises(ModelError, match="damaged.onnx"):
        FaceStage(FACES.resolve({name: str(damaged)}))


def test_settings_are_checked_before_the_stage_is_built():
    assert isinstance(FACES.resolve({}), SimpleNamespace)
    with pytest.raises(ParameterError, match="face_death_time"):
        FACES.resolve({"face_death_time": 0.0})
