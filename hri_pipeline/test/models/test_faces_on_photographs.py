"""The face stage on photographs of groups: counts, identities, poses. Needs the models and their pictures."""

import math
import shutil
import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hri_pipeline.core.camera import CameraError, CameraModel
from hri_pipeline.core.faces import person_verifier
from hri_pipeline.core.faces.analysis import FaceDemand
from hri_pipeline.core.faces.head_pose import yaw_pitch_roll
from hri_pipeline.core.faces.mesh import load_canonical_face
from hri_pipeline.core.faces.parameters import FACES, FacesSettings
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.faces.tracking_pipeline import FaceTrackingPipeline
from hri_pipeline.core.onnx import ModelError, models_directory
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.recognition.embedding import load_face_embedder
from hri_pipeline.core.sources.image_sources import PictureMotion
from hri_pipeline.core.timing import StageTimes

COUNTS = {"sample1": 3, "sample2": 3, "sample3": 3, "sample4": 4, "sample5": 5, "sample6": 4}
STEP = 1.0 / 15.0
HFOV = np.deg2rad(53.0)
SETTLED = 12
"""Images after which every face is found: the detector has then looked twice at the whole and at two tiles."""


@pytest.fixture(scope="module")
def stage():
    return FacePipeline(FACES.resolve({"face_budget": 1000.0}))    # the same looks on a busy machine


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


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_a_camera_on_its_side_or_upside_down_is_told_by_faces_within_a_minute(stage, turn):
    stage.reset()
    image = np.ascontiguousarray(np.rot90(photograph("sample1"), -turn))
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    for index in range(30):
        stage.update(image, camera, 1000.0 + 2.0 * index)
        if stage.seen_turn is not None:
            break
    assert stage.seen_turn == turn


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


@pytest.mark.parametrize("rest", [20, 22, 24])
def test_whoever_comes_into_the_image_while_the_head_of_the_robot_turns_is_found_at_once(stage, rest):
    """The head turns by some 35 degrees in a second, and stops; two faces are seen all the time."""
    image = photograph("sample3")
    image = cv2.resize(image, None, fx=1280.0 / image.shape[1], fy=1280.0 / image.shape[1])[:720]
    left = np.concatenate([np.zeros(rest), np.linspace(0.0, 330.0, 15), np.full(15, 330.0)]).astype(int)
    seen = watch(stage, [image[:, place:place + 900] for place in left])
    assert len(seen[rest - 1]) == 2
    late = next(index for index, faces in enumerate(seen) if len(faces) == 3) - (rest + 15)
    assert late < 0     # before the head has stopped


def test_a_stall_of_a_busy_machine_changes_no_id(stage):
    image, seen, stamp = photograph("sample5"), [], 1000.0
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    stage.reset()
    for step in [STEP] * 20 + [0.3, 1.5, 0.3, 2.5, 0.3, 0.3] * 2:
        stamp += step
        seen.append(ids(stage.update(image, camera, stamp)))
    assert len(seen[19]) == COUNTS["sample5"]
    assert all(names == seen[19] for names in seen[19:])


@pytest.mark.parametrize("count, other, stay", [(20, False, True), (20, True, False), (55, False, False)],
                         ids=["short", "somebody else after it", "long"])
def test_faces_outlive_a_short_dark_and_no_long_one_and_nobody_takes_their_ids(stage, count, other, stay):
    image = cv2.resize(photograph("sample1"), (960, 640), interpolation=cv2.INTER_AREA)
    after = cv2.resize(photograph("sample3"), (960, 640), interpolation=cv2.INTER_AREA) if other else image
    seen = watch(stage, [image] * 10 + [np.zeros_like(image)] * count + [after] * 10)
    assert len(seen[9]) == len(seen[-1]) == 3
    assert not any(seen[10:10 + count])
    before, now = set(ids(seen[9])), {name for faces in seen[10 + count:] for name in ids(faces)}
    # One woman is on both photographs.
    assert now == before if stay else len(now & before) <= other


def test_after_a_zoom_nobody_is_told_without_a_look():
    """Where corners say that a face is now, nobody has looked yet."""
    stage = FacePipeline(FACES.resolve({"face_mesh_rate": 2.0, "face_budget": 1000.0, "cpu_share": 0.0}))
    image = cv2.resize(photograph("sample1"), (960, 640), interpolation=cv2.INTER_AREA)
    zoomed = cv2.warpAffine(image, np.array([[0.75, 0.0, 120.0], [0.0, 0.75, 80.0]]), (960, 640))
    seen = watch(stage, [image] * 20 + [zoomed])
    assert len(seen[-2]) == 3 and not all(face.measured for face in seen[-2])
    assert ids(seen[-1]) == ids(seen[-2]) and all(face.measured for face in seen[-1])


@pytest.mark.parametrize("dark", [0, 3])
def test_by_a_focal_length_that_is_told_anew_every_face_is_elsewhere_at_once(dark):
    """Faces glided there, and who was not looked at waited for his turn. dark: so many images show nothing first."""
    stage = FacePipeline(FACES.resolve({"face_mesh_rate": 2.0, "face_budget": 1000.0, "cpu_share": 0.0}))
    image = cv2.resize(photograph("sample1"), (960, 640), interpolation=cv2.INTER_AREA)
    before = watch(stage, [image] * 20)[-1]
    camera = CameraModel.from_fov(960, 640, 2.0 * math.atan(math.tan(0.5 * HFOV) / 1.8))
    for number in range(dark):
        assert not stage.update(np.zeros_like(image), camera, 1000.0 + (20 + number) * STEP)
    after = stage.update(image, camera, 1000.0 + (20 + dark) * STEP)
    assert len(before) == 3 and ids(after) == ids(before)
    for old, new in zip(before, after):
        assert new.measured and np.linalg.norm(new.pose.translation) == pytest.approx(
            1.8 * np.linalg.norm(old.pose.translation), rel=0.06)


@pytest.mark.parametrize("patience", [0.05, 1.0])
def test_an_image_that_did_not_arrive_as_a_whole_costs_nobody_more_than_that_image(patience):
    """However soon faces that are gone end."""
    stage = FacePipeline(FACES.resolve({"face_death_time": patience, "face_budget": 1000.0}))
    image = cv2.resize(photograph("sample1"), (960, 640), interpolation=cv2.INTER_AREA)
    other = image.copy()
    other[200:] = 128
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    seen = [ids(stage.update(shown, camera, 1000.0 + 0.2 * number))
            for number, shown in enumerate([image] * 12 + [other, image, image] * 4)]
    assert len(seen[11]) == 3
    assert seen[12:] == 4 * [[], seen[11], seen[11]]


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
    """Guards the correction of the model's pitch; people who look down under closed lids are left out."""
    pitches = []
    for name in COUNTS:
        for face in watch(stage, [photograph(name)] * SETTLED)[-1]:
            yaw, pitch, _ = np.degrees(yaw_pitch_roll(face.pose))
            x, y, z = face.pose.translation
            if abs(yaw + np.degrees(np.arctan2(x, z))) < 25.0 and face.gaze.eyes_closed < 0.5:
                pitches.append(pitch - np.degrees(np.arctan2(y, z)))
    assert len(pitches) >= 10
    assert abs(np.median(pitches)) < 7.0, "the chins of these people are held 3 degrees low"


def test_people_who_look_at_the_camera_do(stage):
    """The three of sample3 and the four of sample6 look into the camera."""
    off = []
    for name in ("sample3", "sample6"):
        for face in watch(stage, [photograph(name)] * SETTLED)[-1]:
            assert face.gaze.from_eyes > 0.3 and face.gaze.confidence > 0.5
            to_camera = -face.pose.translation / np.linalg.norm(face.pose.translation)
            off.append(np.degrees(np.arccos(face.gaze.direction @ to_camera)))
    assert len(off) == 7
    assert np.median(off) < 8.0 and max(off) < 20.0


def test_closed_eyes_have_no_gaze(stage):
    """In sample2 two have their eyes shut, one of them just so; in sample3 all eyes are open."""
    open_eyed = watch(stage, [photograph("sample3")] * SETTLED)[-1]
    assert len(open_eyed) == 3
    for face in open_eyed:
        assert face.gaze.eyes_closed < 0.2 and face.gaze.direction is not None
    closed = sorted((face.gaze for face in watch(stage, [photograph("sample2")] * SETTLED)[-1]),
                    key=lambda gaze: gaze.eyes_closed)
    assert closed[-1].direction is None and closed[-1].eyes_closed > 0.6
    assert closed[-2].eyes_closed > 0.4


def test_the_size_of_a_head_is_told_with_its_error(stage):
    faces = watch(stage, [photograph("sample3")] * 20)[-1]
    assert len(faces) == 3
    for face in faces:
        assert 0.9 < face.head_scale < 1.1 and 0.03 < face.head_scale_sd < 0.05, "the irises are large enough"


def test_a_depth_image_places_the_head(stage):
    image = cv2.resize(photograph("sample3"), (960, 640), interpolation=cv2.INTER_AREA)
    camera = CameraModel.from_fov(960, 640, HFOV)
    place = {}
    for factor, size in ((None, ()), (1.1, (640, 960)), (1.1, (240, 360)), (2.0, (640, 960))):
        stage.reset()
        for index in range(60):
            depth = None if factor is None or index < 12 else np.full(size, factor * place[None], np.float32)
            faces = stage.update(image, camera, 1000.0 + 0.1 * index, depth)
        nearest = max(faces, key=lambda face: face.box[3] - face.box[1])
        place[factor] = nearest.pose.translation[2] / nearest.head_scale
        if factor == 1.1:
            assert nearest.head_scale == pytest.approx(1.1, abs=0.04) and nearest.head_scale_sd < 0.02
        if factor == 2.0:
            assert 0.9 < nearest.head_scale < 1.1, "no head is twice as large: this is the wall behind"
    assert stage.update(image, camera, 1006.0, np.full((10, 10), 1.0, np.float32)), "another shape of depth image"


def test_many_faces_take_turns_and_none_is_lost():
    """Under a budget of one look per image all eight faces stay, and those not looked at say so."""
    stage = FacePipeline(FACES.resolve({"face_budget": 1.0, "face_mesh_rate": 0.0}))
    pictures = [cv2.resize(photograph(name), (640, 427), interpolation=cv2.INTER_AREA)
                for name in ("sample5", "sample3")]
    image = np.vstack(pictures)
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    measured, ids_seen, counts = {}, set(), []
    for index in range(90):
        faces = stage.update(image, camera, 1000.0 + index / 15.0)
        counts.append(len(faces))
        for face in faces:
            measured[face.id] = measured.get(face.id, 0) + face.measured
            assert face.pose is not None and (face.measured or face.score < 1.0)
        ids_seen |= set(ids(faces))
    assert counts[-1] == 8 and min(counts[45:]) == 8 and len(ids_seen) == 8
    assert max(measured.values()) < 60 and min(measured.values()) >= 5


def films(names, rate, swing, period, seconds):
    """(stamp s, image) of photographs side by side, before a camera that swings by `swing` of its view in `period`
    s."""
    picture = np.hstack([cv2.resize(photograph(name), (960, 640), interpolation=cv2.INTER_AREA) for name in names])
    motion = PictureMotion(picture, 1280, 720, pan=swing, period=period)
    for index in range(int(seconds * rate)):
        yield 1000.0 + index / rate, motion.view(index / rate)


@pytest.mark.parametrize("names, rate, swing, period", [
    (("sample4",), 12.0, 0.03, 12.0), (("sample4",), 8.0, 0.05, 3.0), (("sample3", "sample5"), 8.0, 0.05, 4.0)])
def test_a_camera_that_swings_and_two_looks_for_all_faces(names, rate, swing, period):
    """Nobody is lost or doubled between two looks, when they come late and the camera turns back meanwhile."""
    finder = FaceTrackingPipeline(FACES.resolve({"face_budget": 10.0, "face_mesh_rate": 0.0}), StageTimes(),
                                  clock=lambda: 0.0)
    counts, known = [], set()
    for stamp, image in films(names, rate, swing, period, 9.0):
        finder.update(image, stamp)
        counts.append(len(finder.tracked_ids))
        known.update(finder.tracked_ids)
    there = sum(COUNTS[name] for name in names)
    assert counts[len(counts) // 2:] == [there] * (len(counts) - len(counts) // 2) and len(known) == there


def test_images_that_come_now_and_then_on_a_busy_machine_end_no_face():
    """One look is left per image, and an image comes late after two faces had to wait: they stay who they were."""
    image = cv2.resize(photograph("sample1"), (960, 640), interpolation=cv2.INTER_AREA)
    finder = FaceTrackingPipeline(FACES.resolve({"cpu_share": 0.0}), StageTimes(), clock=lambda: 0.0)
    known = set()
    for stamp in (0.04, 0.67, 0.89, 1.12, 1.68, 1.93, 2.3, 2.9):
        finder.scheduler.note_timing(0.2, 0.2)
        finder.update(image, 1000.0 + stamp)
        known.update(finder.tracked_ids)
    assert len(known) == len(finder.tracked_ids) == 3


def test_what_looks_like_a_face_now_and_then_is_none(stage):
    """A blurred chair, in which the detector sees half a face in some images, and the mesh a whole one."""
    motion = PictureMotion(photograph("sample1"), 1280, 720)
    stage.reset()
    camera, known = CameraModel.from_fov(1280, 720, HFOV), set()
    for index in range(54):
        stage.update(motion.view(index / 6.0), camera, 1000.0 + index / 6.0)
        known.update(stage.tracked_ids)
    assert len(known) == 3


@pytest.mark.parametrize("width, rate", [(640, 10.0), (1280, 15.0)])
def test_a_profile_keeps_its_place_and_its_id(stage, width, rate):
    """The mesh of a profile, cropped round itself again and again, ran away: half as far again within 2 s."""
    motion = PictureMotion(photograph("sample2"), width, 9 * width // 16, pan=0.03, period=12.0)
    stage.reset()
    camera = CameraModel.from_fov(width, 9 * width // 16, HFOV)
    depths = {}
    for index in range(int(10.0 * rate)):
        for face in stage.update(motion.view(index / rate), camera, 1000.0 + index / rate):
            if face.box[0] < 0.35 * width:
                depths.setdefault(face.id, []).append(face.pose.translation[2])
    assert len(depths) == 1, "she has one id"
    low, high = np.percentile(list(depths.values())[0], [1.0, 99.0])
    assert high < 1.25 * low


def dial(seed):
    """A round thing with letters on it, such as hang on walls; in one of ten of them the mesh network is sure of a
    face."""
    random = np.random.RandomState(seed)
    image = np.full((480, 640, 3), random.randint(60, 230, 3), np.uint8)
    radius = random.randint(40, 120)
    for part in (1.0, random.uniform(0.5, 0.85)):
        cv2.circle(image, (320, 240), int(part * radius), random.randint(0, 255, 3).tolist(), -1, cv2.LINE_AA)
    text = str(random.randint(0, 99)) if random.rand() < 0.7 else random.choice(list("OSBDeamR@&"))
    size = radius / 40.0 * random.uniform(0.6, 1.2)
    stroke = max(1, int(3.0 * size))
    (width, height), _ = cv2.getTextSize(text, 0, size, stroke)
    colour = random.randint(0, 255, 3).tolist()
    cv2.putText(image, text, (320 - width // 2, 240 + height // 2), 0, size, colour, stroke, cv2.LINE_AA)
    return cv2.GaussianBlur(image, (0, 0), 1.0)


DIALS = (6, 18, 23, 34, 49, 59, 92, 95, 99, 105, 108, 110, 119, 121, 129, 142, 153, 158, 164, 176, 246, 247)
"""Those of the first 250 with a detection above 0.45 in which the mesh network is sure of a face."""


def test_things_that_only_the_mesh_takes_for_faces_are_none():
    finder = FaceTrackingPipeline(FACES.resolve({"face_budget": 1000.0}), StageTimes(), clock=lambda: 0.0)
    taken = {}
    for seed in DIALS:
        finder.reset()
        motion = PictureMotion(dial(seed), 640, 480)
        for index in range(18):
            finder.update(motion.view(index / 6.0), 100.0 * seed + index / 6.0)
            if finder.tracked_ids:
                taken[seed] = taken.get(seed, 0) + 1
    assert len(taken) <= 6, "{} of {}: {}".format(len(taken), len(DIALS), taken)


@pytest.mark.parametrize("name, side, least", [("sample6", 30, 4), ("sample6", 24, 3), ("sample3", 30, 2)])
def test_faces_of_30_px_in_a_large_image(stage, name, side, least):
    image = photograph(name)
    sizes = [face.box[2] - face.box[0] for face in watch(stage, [image] * SETTLED)[-1]]
    scale = side / np.median(sizes)
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    large = np.full((720, 1280, 3), 90, np.uint8)
    large[100:100 + small.shape[0], 900:900 + small.shape[1]] = small
    assert least <= len(watch(stage, [large] * 45)[-1]) <= COUNTS[name]


def test_a_face_that_fills_the_image(stage):
    image = photograph("sample3")
    box = max(watch(stage, [image] * SETTLED)[-1], key=lambda face: face.box[2] - face.box[0]).box
    x0, y0, x1, y1 = box.astype(int)
    side = int(1.02 * (y1 - y0))
    close = cv2.resize(image[y0:y0 + side, x0 - 20:x0 - 20 + side], (480, 480))
    seen = watch(stage, [close] * 30)
    assert len(seen[-1]) == 1 and len({identity for faces in seen for identity in ids(faces)}) == 1
    assert 0.7 * 480 < seen[-1][0].box[3] - seen[-1][0].box[1] < 1.3 * 480


def bad_images():
    image = cv2.resize(photograph("sample3"), (960, 640), interpolation=cv2.INTER_AREA)
    face = cv2.resize(photograph("sample1"), (480, 320), interpolation=cv2.INTER_AREA)
    shifted = np.zeros_like(image)
    shifted[:, :620] = image[:, 340:]       # the left face is cut by the border
    tiny = np.full((480, 640, 3), 90, np.uint8)
    tiny[200:232, 300:348] = cv2.resize(face, (48, 32), interpolation=cv2.INTER_AREA)   # faces of 6 to 8 px
    yield "half a face at the border", shifted, 2
    yield "faces of 8 px", tiny, 0
    yield "black", np.zeros_like(image), 0
    yield "white", np.full_like(image, 255), 0
    yield "upside down", image[::-1, ::-1].copy(), None
    yield "one row", image[:1].copy(), 0
    yield "not contiguous", image[::2, ::2], 3


@pytest.mark.parametrize("index", range(7))
def test_bad_images_are_survived_with_sane_numbers(stage, index):
    name, image, least = list(bad_images())[index]
    seen = watch(stage, [image] * 10)
    assert least is None or len(seen[-1]) == least, name
    for faces in seen:
        for face in faces:
            for values in (face.box, face.landmarks, face.mesh):
                assert np.isfinite(values).all(), name
            assert ((face.landmarks[:, 2] >= 0.0) & (face.landmarks[:, 2] <= 1.0)).all()
            assert face.pose is None or np.isfinite(face.pose.translation).all()


def test_a_camera_with_nan_in_its_matrix_is_refused_by_name():
    with pytest.raises(CameraError, match="K"):
        CameraModel.from_calibration(960, 640, [np.nan] * 9, [], "plumb_bob", 1.0)


def test_a_portrait_on_the_wall_is_another_face_beside_the_person(stage):
    image = cv2.resize(photograph("sample3"), (1280, 853), interpolation=cv2.INTER_AREA)
    other = photograph("sample6")
    box = watch(stage, [other] * SETTLED)[-1][0].box
    middle, reach = (box[:2] + box[2:]) / 2.0, 0.9 * (box[3] - box[1])
    (x0, y0), (x1, y1) = np.maximum(middle - reach, 0).astype(int), (middle + reach).astype(int)
    image[10:190, 10:190] = cv2.resize(other[y0:y1, x0:x1], (180, 180), interpolation=cv2.INTER_AREA)
    seen = watch(stage, [image] * 24)
    assert len(seen[-1]) == 4
    assert len({tuple(ids(faces)) for faces in seen[2 * SETTLED - 8:]}) == 1


def test_the_sellion_is_the_deepest_point_of_the_bridge():
    vertices = load_canonical_face(models_directory() / "canonical_face.npz").vertices
    bridge = [9, 8, 168, 6, 197, 195, 5, 4]
    assert max(bridge, key=lambda index: vertices[index, 2]) == 168


@pytest.mark.parametrize("name", ["face_detector_model", "face_mesh_model", "canonical_face"])
def test_a_missing_a_wrong_and_a_damaged_file_are_told_by_name(tmp_path, name):
    with pytest.raises(ModelError, match="absent.onnx"):
        FacePipeline(FACES.resolve({name: str(tmp_path / "absent.onnx")}))
    wrong = tmp_path / "wrong.onnx"
    shutil.copy(str(models_directory() / "pose_landmarks_full.onnx"), str(wrong))
    with pytest.raises(ModelError, match="wrong.onnx"):
        FacePipeline(FACES.resolve({name: str(wrong)}))
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(b"\x08\x07 this is no model")
    with pytest.raises(ModelError, match="damaged.onnx"):
        FacePipeline(FACES.resolve({name: str(damaged)}))


def test_settings_are_checked_before_the_stage_is_built():
    assert isinstance(FACES.resolve({}), FacesSettings)
    with pytest.raises(ParameterError, match="face_death_time"):
        FACES.resolve({"face_death_time": 0.0})


def test_no_face_begins_in_an_ignored_region_and_one_that_moves_through_it_stays():
    image = photograph("sample4")
    faces = watch(FacePipeline(FACES.resolve({"face_budget": 1000.0})), [image] * 20)[-1]
    middles = sorted(float(np.mean(face.box[[0, 2]])) / image.shape[1] for face in faces)
    border = (middles[1] + middles[2]) / 2.0
    stage = FacePipeline(FACES.resolve({"face_budget": 1000.0, "ignored_regions": ["0 0 {} 1".format(border)]}))
    seen = watch(stage, [image] * 20)
    assert [len(faces) for faces in seen[SETTLED:]] == [COUNTS["sample4"] - 2] * (20 - SETTLED)
    assert all(np.mean(face.box[[0, 2]]) > border * image.shape[1] for faces in seen for face in faces)
    shifts = np.arange(0, int((middles[2] - border + 0.05) * image.shape[1]), 12)
    moved = [np.roll(image, -shift, axis=1) for shift in shifts]
    seen = watch(stage, [image] * 20 + moved)
    assert set(ids(seen[19])) <= set(ids(seen[-1])), "who walks in front of it is followed"
    assert any(np.mean(face.box[[0, 2]]) < border * image.shape[1] for face in seen[-1])


def test_threads_change_nothing_of_what_is_seen():
    """A camera that pans over four people, whom each image shows to all networks."""
    picture = photograph("sample6")
    images = [np.ascontiguousarray(picture[:, shift:picture.shape[1] - 60 + shift]) for shift in range(0, 60, 3)]
    before, seen = set(threading.enumerate()), []
    for threads in (1, 3):
        stage = FacePipeline(FACES.resolve({"face_budget": 1000.0, "face_mesh_rate": 0.0, "max_age": 10.0,
                                            "threads": threads}))
        camera = CameraModel.from_fov(images[0].shape[1], images[0].shape[0], HFOV)
        seen.append([stage.update(image, camera, index * STEP, demand=FaceDemand.everything(stage.tracked_ids))
                     for index, image in enumerate(images)])
        assert bool(set(threading.enumerate()) - before) == (threads > 1)
        stage.close()
        assert not set(threading.enumerate()) - before
    assert len(seen[0][-1]) >= 3
    for alone, shared in zip(*seen):
        assert len(alone) == len(shared)
        for one, other in zip(alone, shared):
            np.testing.assert_array_equal(one.landmarks, other.landmarks)
            np.testing.assert_array_equal(one.pose.rotation, other.pose.rotation)
            assert one.score == other.score and one.measured == other.measured


@pytest.mark.parametrize("count", [1, 3])
def test_an_error_of_the_mesh_costs_no_search_of_the_detector(count):
    """Where the detector was due in the image of the error, it is in the next one, for the same regions."""
    image, threads, asked = cv2.resize(photograph("sample3"), (960, 640)), Threads(count), []
    finder = FaceTrackingPipeline(FACES.resolve({"face_budget": 1000.0, "face_mesh_rate": 0.0}), StageTimes(),
                                  threads=threads)
    due, run = finder._detection_scheduler.due, finder._mesh.run
    finder._detection_scheduler.due = lambda *about: asked.append(due(*about)) or asked[-1]
    for index in range(3):
        finder.update(image, 0.0333 * index)
    assert finder.all_ids

    def fail(bgr, rois, camera=None):
        raise ModelError("out of memory")

    stamps, lost = iter(np.arange(0.1, 20.0, 0.0333)), 0
    while lost < 4:
        finder._mesh.run = fail
        with pytest.raises(ModelError):
            finder.update(image, next(stamps))
        if not finder.detected:
            continue
        lost += 1
        finder._mesh.run = run
        finder.update(image, next(stamps))
        assert finder.detected and asked[-1] == asked[-2] != []
        finder.update(image, next(stamps))
        assert not finder.detected
    threads.close()


@pytest.mark.parametrize("doubt", ["the last mesh is weak", "more detections are wanted now"])
def test_only_listed_faces_that_the_detector_cannot_move_are_told_before_it_searches(doubt):
    image, told = cv2.resize(photograph("sample3"), (960, 640)), []
    finder = FaceTrackingPipeline(FACES.resolve({"face_budget": 1000.0, "face_mesh_rate": 0.0}), StageTimes())
    for index in range(15):
        finder.update(image, 0.1 * index, told.append)
    assert max(map(len, told)) == len(finder.tracked_ids) == 3
    told.clear()
    if doubt.startswith("the"):
        for track in finder._tracker.tracks:
            track.measurement = replace(track.measurement, presence=0.5)
        finder._mesh_scheduler.choose = lambda *about: []
    else:
        finder.reconfigure(FACES.resolve({"face_budget": 1000.0, "face_mesh_rate": 0.0, "face_min_detections": 20}))
        assert not finder.tracked_ids
    finder._detection_scheduler.reset()
    found = finder.update(image, 1.5, told.append)
    assert told == [[]] and len(found) == 3 and all(face.measured for face in found)


def test_the_time_of_a_detector_that_runs_beside_is_its_own_and_not_how_long_it_is_waited_for():
    image, threads, now, done = photograph("sample3"), Threads(2), [0.0], threading.Event()
    times = StageTimes(clock=lambda: now[0])
    finder = FaceTrackingPipeline(FACES.resolve({"face_budget": 1000.0}), times, threads=threads)
    finder.update(image, 0.0)
    times.clear()

    def detect(bgr, regions):
        now[0] += 5.0
        done.set()
        return []

    finder._detector.detect = detect
    finder._measure_tracks = lambda *arguments: {} if done.wait(20.0) else None
    finder.update(image, 10.0)
    threads.close()
    assert times.summary()["face_detection"] == (5000.0, 5000.0)


def test_after_a_card_has_failed_the_threads_of_the_processor_share_the_faces_and_diagnostics_say_so():
    stage = FacePipeline(FACES.resolve({"face_budget": 1000.0, "threads": 3, "recognition": False}))
    mesh, detector = stage._tracking._mesh._model, stage._tracking._detector._model
    on_processor, mesh.threads, detector.threads = mesh.threads, ONE_THREAD, ONE_THREAD     # as on a card
    image = photograph("sample3")
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    stage.update(image, camera, 0.0)
    assert (stage.status()["threads"], stage._tracking._detector.threads) == (1, ONE_THREAD)
    mesh.threads = detector.threads = on_processor      # see test_onnx.py
    stage.update(image, camera, 0.1)
    assert (stage.status()["threads"], stage._tracking._detector.threads.count) == (3, 3)
    stage.close()


@pytest.mark.parametrize("period", [0.0, 10.0])
def test_each_stage_has_one_time_for_each_image_whether_the_detector_searches_it_or_not(period):
    image = photograph("sample3")
    stage = FacePipeline(FACES.resolve({"face_budget": 1000.0, "recognition": False, "face_detection_period": period}))
    camera = CameraModel.from_fov(image.shape[1], image.shape[0], HFOV)
    for index in range(8):
        stage.update(image, camera, 0.1 * index)
    times, told = stage.times._times, []
    for index in range(8, 14):
        before = {name: len(times[name]) for name in times}
        stage.update(image, camera, 0.1 * index, placed=told.append)
        more = {name: len(times[name]) - count for name, count in before.items()}
        assert more["face_pose"] == more["face_flow"] == more["face_mesh"] == 1 and max(more.values()) == 1, more
    assert len(told) == (12 if period == 0.0 else 6)
    stage.close()


def test_threads_change_nothing_of_templates():
    crops = np.random.default_rng(5).integers(0, 256, (5, 150, 150, 3), dtype=np.uint8)
    threads = Threads(2)
    alone, shared = load_face_embedder(), load_face_embedder(threads=threads)
    for count in range(len(crops) + 1):
        np.testing.assert_array_equal(alone.embed(crops[:count]), shared.embed(crops[:count]))
    threads.close()


class Witness:
    """A person detector that gives each face the same lead, and counts."""

    def __init__(self, lead):
        self.lead, self.asked = lead, 0

    def lead_around(self, image, face):
        self.asked += 1
        return self.lead


def doubting_stage(monkeypatch, person_detector=None):
    """A stage in which no new face is sure."""
    monkeypatch.setattr(person_verifier, "SURE_SCORE", 1.1)
    values = {"face_budget": 1000.0, "recognition": False, "face_person_lead": 0.85}
    return FacePipeline(FACES.resolve(values), person_detector=person_detector)


@pytest.mark.parametrize("lead, count", [(0.1, 0), (2.0, 3)])
def test_doubted_faces_are_published_where_the_person_detector_sees_people(monkeypatch, lead, count):
    witness = Witness(lead)
    seen = watch(doubting_stage(monkeypatch, lambda: witness), [photograph("sample1")] * SETTLED)
    assert len(seen[-1]) == count
    assert witness.asked == COUNTS["sample1"], "each once, a refused one not within a second"


@pytest.mark.parametrize("next_one", ["sample1", "hidden", "sample4"])
def test_new_faces_are_asked_about_only_where_they_are_in_the_image(monkeypatch, next_one):
    witness, image = Witness(0.1), photograph("sample1")
    stage = doubting_stage(monkeypatch, lambda: witness)
    watch(stage, [image] * SETTLED)
    witness.asked, witness.lead = 0, 2.0
    other = cv2.resize(photograph("sample1" if next_one == "hidden" else next_one), image.shape[1::-1])
    if next_one == "hidden":
        for track in stage._tracking._tracker.tracks:
            x0, y0, x1, y1 = np.rint(track.measurement.box).astype(int)
            other[y0 - 100:y1 + 100, x0 - 100:x1 + 100] = 128
    if next_one == "sample1":
        other = np.roll(other, 6, axis=1)
    stage.update(other, CameraModel.from_fov(image.shape[1], image.shape[0], HFOV), 1001.6)
    assert (witness.asked > 0, bool(stage.tracked_ids)) == ((next_one == "sample1",) * 2)


def test_people_of_photographs_are_not_refused(monkeypatch):
    stage = doubting_stage(monkeypatch)
    assert {name: len(watch(stage, [photograph(name)] * SETTLED)[-1]) for name in COUNTS} == COUNTS
