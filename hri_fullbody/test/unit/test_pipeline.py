import itertools
import math
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from synthetic_people import Scene, face_of, standing_at, textured

from hri_fullbody.core import pipeline
from hri_fullbody.core.detection.pose_estimator import pose_model_path
from hri_fullbody.core.detection.windows import FaceBox, face_boxes
from hri_fullbody.core.parameters import BODIES, VISION
from hri_fullbody.core.pipeline import BodyPipeline
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import ImageRotation
from hri_pipeline.core.onnx import ModelError
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.process import ONE_THREAD, Threads
from hri_pipeline.core.timing import StageTimes

IMAGE = np.zeros((720, 1280, 3), np.uint8)
CAMERA = CameraModel.from_fov(1280, 720, 1.05)


class Boxes:
    """A person detector that knows the scene."""

    def __init__(self, scene):
        self.scene, self.calls = scene, 0

    def detect(self, image):
        self.calls += 1
        boxes = np.array([standing_at(x, y).box for x, y in self.scene.people]).reshape(-1, 4)
        return boxes, np.ones(len(boxes))

    def is_human(self, image, box):
        return True


def make(people, **given):
    scene = Scene(people)
    detector = Boxes(scene)
    return BodyPipeline(BODIES.resolve(given), pose=scene, detector=detector), scene, detector


def test_bodies_come_with_everything():
    stage, _, _ = make([(400, 400), (800, 380)])
    for index in range(10):
        bodies = stage.update(IMAGE, CAMERA, index / 20.0)
    assert len(bodies) == 2 and sorted(stage.tracked_ids) == sorted(body.id for body in bodies)
    body = min(bodies, key=lambda body: body.keypoints[0, 0])
    assert body.keypoints.shape == (18, 3) and body.keypoints_3d.shape == (18, 3)
    assert body.keypoints[0, :2] == pytest.approx(standing_at(400, 400).nose, abs=0.1)
    depth = CAMERA.matrix[0, 0] / 200.0
    assert body.pose.translation[2] == pytest.approx(depth, rel=0.15)
    assert CAMERA.project(body.pose.translation[None])[0] == pytest.approx([400.0, 400.0], abs=15.0)
    x0, y0, x1, y1 = body.box
    assert 0 <= x0 < 370 and 430 < x1 <= 1280 and 0 <= y0 < y1 <= 720


def test_the_detector_runs_by_time_and_not_with_new_windows():
    stage, scene, detector = make([(400, 400)], person_detection_period=0.5)
    stage.update(IMAGE, CAMERA, 0.0)
    assert (detector.calls, len(scene.windows)) == (1, 0)
    for index in range(1, 40):
        stage.update(IMAGE, CAMERA, index * 0.05)
    assert detector.calls == 4


def test_known_bodies_do_not_wait_for_the_search_of_others():
    stage, scene, detector = make([(400, 400)], person_detection_period=0.5)
    told, searched, detect = [], [], detector.detect
    detector.detect = lambda image: searched.append(len(told)) or detect(image)
    for index in range(40):
        bodies = stage.update(IMAGE, CAMERA, index * 0.05, seen=told.append)
        assert told[-1] is bodies and len(told) == index + 1
    assert len(bodies) == 1 and searched[1:], "the detector ran while the body was known"
    assert all(before == image for before, image in zip(searched, [1, 11, 21, 31])), searched


@pytest.mark.parametrize("where", ["seen", "_observe_all"])
def test_an_error_while_known_bodies_are_placed_or_told_costs_nobody_the_search(where):
    stage, _, detector = make([(400, 400)], person_detection_period=0.5)

    def fail(*about):
        raise OSError("no process can be started")

    if where != "seen":
        setattr(stage, where, fail)
    for index in range(12):
        with pytest.raises(OSError):
            stage.update(IMAGE, CAMERA, index * 0.05, seen=fail)
    assert detector.calls == 2 and len(stage.tracked_ids) == 1


@pytest.mark.parametrize("rate", [20.0, 10.0, 5.0])
def test_nobody_is_told_whom_the_detector_does_not_see(rate):
    stage, _, detector = make([(400, 400)])
    detector.detect = lambda image: (np.empty((0, 4)), np.empty(0))
    told, face = [], face_of(standing_at(400, 400), "f0")
    for index in range(20):
        stage.update(IMAGE, CAMERA, index / rate, [face], seen=told.extend)
    assert told == [] and stage.tracked_ids == []


def test_who_is_found_in_slow_images_is_there_in_the_same_image():
    stage, _, detector = make([(400, 400)], person_detection_period=10.0, body_birth_delay=0.0)
    order, detect = [], detector.detect
    detector.detect = lambda image: order.append("search") or detect(image)
    for index in range(4):
        stage.update(IMAGE, CAMERA, index * 1.0, seen=lambda bodies: order.append(len(bodies)))
    assert "search" in order and order[-1] == 1 and order.index(1) <= 4, order


def test_a_detector_that_runs_beside_ends_with_the_image_also_when_the_bodies_fail():
    stage, _, detector = make([(400, 400)])
    detector.threads, begun, failed, running = Threads(2), threading.Event(), threading.Event(), []

    def detect(image):
        running.append(image)
        begun.set()
        assert failed.wait(20.0)
        np.linalg.svd(np.ones((300, 300)))      # still at work
        running.pop()
        return np.empty((0, 4)), np.empty(0)

    def follow(*arguments):
        assert begun.wait(20.0), "it runs beside"
        failed.set()
        raise KeyError("a body")

    detector.detect, stage._tracker.follow = detect, follow
    with pytest.raises(KeyError):
        stage.update(IMAGE, CAMERA, 0.0)
    assert not running
    again = []
    detector.detect = lambda image: again.append(image) or (np.empty((0, 4)), np.empty(0))
    stage._tracker.follow = lambda *arguments: None
    stage.update(IMAGE, CAMERA, 0.05)
    assert again, "what it found was lost"
    detector.threads.close()


def test_the_time_of_a_detector_that_runs_beside_is_its_own_and_not_how_long_it_is_waited_for():
    stage, _, detector = make([(400, 400)])
    detector.threads, now, done = Threads(2), [0.0], threading.Event()
    stage.times = StageTimes(clock=lambda: now[0])

    def detect(image):
        now[0] += 5.0
        done.set()
        return np.empty((0, 4)), np.empty(0)

    detector.detect, stage._tracker.follow = detect, lambda *arguments: done.wait(20.0)
    stage.update(IMAGE, CAMERA, 0.0)
    detector.threads.close()
    assert stage.times.summary()["person detector"] == (5000.0, 5000.0)


def test_each_stage_has_one_time_for_each_image_however_many_bodies_there_are():
    stage, _, _ = make([(400, 400), (800, 380), (1100, 400)], pose_rate=0.0, pose_budget=0)
    for index in range(12):
        stage.update(IMAGE, CAMERA, index / 15.0)
    times = stage.times._times
    for index in range(12, 20):
        before = {name: len(times[name]) for name in times}
        assert len(stage.update(IMAGE, CAMERA, index / 15.0)) == 3
        more = {name: len(times[name]) - count for name, count in before.items()}
        assert more["perspective"] == more["placement"] == 1 and max(more.values()) == 1, more


def test_after_a_card_has_failed_the_threads_of_the_processor_share_the_bodies_and_diagnostics_say_so():
    stage, scene, _ = make([(400, 400)])
    scene.threads = ONE_THREAD
    stage.update(IMAGE, CAMERA, 0.0)
    assert stage.status()["threads"] == 1
    scene.threads = Threads(3)
    stage.update(IMAGE, CAMERA, 0.05)
    assert stage.status()["threads"] == 3
    scene.threads.close()


def test_the_cost_of_a_body_has_the_time_of_those_who_cut_the_windows_for_a_card():
    """The batches of a card are not divided, the windows are cut by several threads."""
    stage, scene, _ = make([(400, 400), (800, 380), (1100, 400)], threads=3, pose_rate=0.0, pose_budget=0)
    all_here, sizes = threading.Barrier(3, timeout=20.0), []

    def cut(windows):
        all_here.wait()
        began = time.thread_time()
        while time.thread_time() - began < 0.03:
            pass
        return windows

    def estimate_all(image, windows):
        sizes.append(len(windows))
        if len(windows) == 3:
            stage._threads.in_parts(cut, windows)
        return [scene.estimate(image, one.window, one.hidden, one.shown) for one in windows]

    scene.threads, scene.takes_batches, scene.estimate_all = ONE_THREAD, True, estimate_all
    for index in range(25):
        stage.update(IMAGE, CAMERA, index / 15.0)
    stage.close()
    assert sizes.count(3) > 15 and stage.status()["pose_ms"] > 20.0


@pytest.mark.parametrize("period, interval", [(0.0, 0.05), (1.0, 1.4)])
def test_bodies_come_also_when_the_detector_is_due_in_every_image(period, interval):
    stage, _, detector = make([(400, 400), (800, 380)], person_detection_period=period)
    ids = [sorted(body.id for body in stage.update(IMAGE, CAMERA, index * interval)) for index in range(12)]
    assert len(ids[-1]) == 2 and ids[-1] == ids[-6]
    assert detector.calls >= 11


def test_ten_people_in_slow_images_are_found_soon_and_stay():
    """Two images a second: windows are few, and what is known can wait for those who are not."""
    people = [(80.0 + 120.0 * index, 400.0) for index in range(10)]
    stage, scene, _ = make(people)
    faces = [face_of(standing_at(*place), "f{}".format(index)) for index, place in enumerate(people)]
    ids, all_there = set(), None
    for index in range(60):
        before = len(scene.windows)
        bodies = stage.update(IMAGE, CAMERA, 0.5 * index, faces)
        assert all_there is None or len(bodies) == 10, "those who wait for their look are where they were"
        assert len(scene.windows) - before <= 4
        ids.update(stage.tracked_ids)
        if all_there is None and len(stage.tracked_ids) == 10:
            all_there = 0.5 * index
    assert len(ids) == len(stage.tracked_ids) == 10
    assert all_there is not None and all_there <= 7.0


@pytest.mark.parametrize("rate, cost, within", [
    (2.0, 0.015, 1.5), (3.0, 0.015, 1.4), (5.0, 0.015, 1.4), (2.0, 0.2, None)])
def test_ten_people_before_a_slow_camera_are_found_soon_where_the_machine_has_time(monkeypatch, rate, cost, within):
    """As many windows in each image as of a quick camera took 6 s for the last at 2 Hz. cost: of a window, s."""
    people = [(80.0 + 120.0 * index, 400.0) for index in range(10)]
    stage, scene, _ = make(people, cpu_share=0.0)
    monkeypatch.setattr(pipeline, "time", SimpleNamespace(monotonic=lambda: cost * len(scene.windows)))
    faces = [face_of(standing_at(*place), "f{}".format(index)) for index, place in enumerate(people)]
    all_there, most, told = math.inf, 0, []
    for index in range(40):
        before = len(scene.windows)
        stage.note_timing(0.01, cost * most)
        stage.update(IMAGE, CAMERA, index / rate, faces, seen=lambda bodies: told.append(len(scene.windows)))
        told[-1] -= before
        most = max(most, len(scene.windows) - before)
        if len(stage.tracked_ids) == 10:
            all_there = min(all_there, index / rate)
    if within is None:      # no time is left: as many windows as ever
        assert most <= 6
    else:
        assert all_there <= within and most * cost <= 0.6 / rate
        assert max(told) <= 10, "who is known does not wait for it"


@pytest.mark.parametrize("interval", [0.3, 1.0, 1.5])
@pytest.mark.parametrize("count", [8, 10])
def test_everybody_is_found_without_faces_in_slow_images(count, interval):
    """The detector is due in each image, and there is one window for who is new, who needs two looks."""
    stage, _, _ = make([(80.0 + 120.0 * index, 400.0) for index in range(count)])
    for index in range(25):
        bodies = stage.update(IMAGE, CAMERA, index * interval)
    assert len(bodies) == count


def distances(stage, bodies):
    """Distances (m) of all bodies, and of their models."""
    return [place[2] for body in bodies for place in (body.pose.translation, stage.model(body).pose.translation)]


def zoomed_camera(zoom):
    return CameraModel.from_fov(1280, 720, 2.0 * math.atan(math.tan(0.5 * 1.05) / zoom))


@pytest.mark.parametrize("zoom", [0.5, 1.6])
def test_by_a_focal_length_that_is_told_anew_bodies_are_elsewhere_at_once(zoom):
    """They glided there for half a second."""
    stage, _, _ = make([(400, 400), (640, 390), (800, 380)], pose_rate=5.0, pose_budget=2)
    for index in range(30):
        before = stage.update(IMAGE, CAMERA, index / 20.0)
    known = distances(stage, before)
    after = stage.update(IMAGE, zoomed_camera(zoom), 30 / 20.0)
    assert [body.id for body in after] == [body.id for body in before]
    assert sum(body.measured for body in after) == 2, "as many as the budget allows"
    assert distances(stage, after) == pytest.approx(zoom * np.array(known), rel=0.03)


def test_a_face_that_was_placed_by_another_focal_length_places_no_body():
    """Faces come from another node, a moment later."""
    stage, scene, _ = make([(400, 400)])
    face = face_of(standing_at(400, 400), "f0")

    def placed(stamp, distance):
        ray = CAMERA.normalise(face.centre[None])[0]
        return [replace(face, stamp=stamp, pose=Pose(np.eye(3), distance * np.array([*ray, 1.0])))]

    for index in range(30):
        before = stage.update(IMAGE, CAMERA, index / 20.0, placed(index / 20.0, 5.6))
    after = stage.update(IMAGE, zoomed_camera(1.6), 30 / 20.0, placed(29 / 20.0, 5.6))
    assert after[0].pose.translation[2] == pytest.approx(1.6 * before[0].pose.translation[2], rel=0.03)


@pytest.mark.parametrize("follows", [False, True])
def test_in_a_picture_that_has_jumped_bodies_are_elsewhere_at_once(follows):
    """follows: the calibration tells of the zoom, in the same image."""
    stage, scene, _ = make([(500, 400), (700, 400)])
    stage._ground.reset = lambda: grounds.append(1)
    grounds, image = [], textured()
    for index in range(30):
        before = stage.update(image, CAMERA, index / 20.0)
    known = distances(stage, before)
    zoom, shift = 1.5, np.array([-320.0, -180.0])
    scene.people = [tuple(zoom * np.array(place) + shift) for place in scene.people]
    scene.scale *= zoom
    jumped = cv2.warpAffine(image, np.column_stack([zoom * np.eye(2), shift]), (1280, 720))
    after = stage.update(jumped, zoomed_camera(zoom) if follows else CAMERA, 30 / 20.0)
    assert [body.id for body in after] == [body.id for body in before]
    assert distances(stage, after) == pytest.approx(np.array(known) / (1.0 if follows else zoom), rel=0.03)
    for body, place in zip(after, scene.people):
        assert body.keypoints[0, :2] == pytest.approx(standing_at(*place, scene.scale).nose, abs=0.5)
    assert len(grounds) == (0 if follows else 1)


@pytest.mark.parametrize("with_face", [False, True])
def test_bodies_wait_for_their_faces_only_where_faces_are_looked_for(with_face):
    stage, _, _ = make([(400, 400), (800, 380)])
    face = replace(face_of(standing_at(400, 400), "f0"), pose=Pose(np.eye(3), np.array([0.0, 0.0, 4.0])))
    near, placed = CameraModel.from_fov(1280, 560, 1.05), {}
    for index in range(30):
        for body in stage.update(IMAGE[:560], near, index * 0.05, [face] if with_face else []):
            placed.setdefault("face" if body.head is not None else body.box[0] > 600, []).append(body.pose is not None)
    assert placed[True][0] != with_face and all(placed[True][15:])
    assert all(placed["face" if with_face else False])


def test_nobody_waits_for_a_face_once_faces_are_looked_for_no_more():
    stage, _, _ = make([(400, 400)])
    awaited, localize = [], stage._localize
    stage._localize = lambda *about: awaited.append(about[-1].faces) or localize(*about)
    face = FaceBox("abcde", np.array([370.0, 100.0, 430.0, 170.0]), Pose(np.eye(3), np.array([0.0, 0.0, 2.0])))
    for faces in ((), [replace(face, pose=None)], [face], (), None, (), [face], ()):
        stage.update(IMAGE, CAMERA, 0.05 * len(awaited), faces)
    assert awaited == [False, False, True, True, False, False, True, True]


def test_who_has_no_place_has_none_between_two_looks_either():
    """The border cuts it: the place of before is that of the camera of before, which may have turned."""
    stage, _, _ = make([(400, 400)])
    for index in range(10):
        body, = stage.update(IMAGE, CAMERA, index / 20.0) or [None]
    assert stage.model(body) is not None and stage.model(replace(body, measured=False)) is not None
    unplaced = replace(body, measured=True, pose=None, keypoints_3d=np.full((18, 3), np.nan))
    stage.fit([unplaced], 0.5, stage.up, (1280, 720))
    assert stage.model(unplaced) is None
    between = replace(unplaced, measured=False)
    stage.fit([between], 0.55, stage.up, (1280, 720))
    assert stage.model(between) is None


def test_that_people_were_upside_down_does_not_hold_for_images_that_are_turned_from_now_on():
    stage, _, _ = make([(400, 400)])
    stage._orientation.turn = 2
    stage.turn(ImageRotation(2, 1280, 720))
    assert stage.seen_turn is None


def test_time_that_goes_back_starts_afresh():
    stage, _, _ = make([(400, 400)])
    stamps = itertools.count(100)
    for _ in range(8):
        stage.update(IMAGE, CAMERA, next(stamps) * 0.1)
    assert len(stage.tracked_ids) == 1
    assert stage.update(IMAGE, CAMERA, 1.0) == []
    assert stage.tracked_ids == []


def test_camera_of_another_size_is_scaled():
    stage, _, _ = make([(400, 400)])
    for index in range(10):
        bodies = stage.update(IMAGE, CameraModel.from_fov(640, 360, 1.05), index / 20.0,
                              [face_of(standing_at(400, 400), "f0")])
    assert bodies[0].pose.translation[2] == pytest.approx(CAMERA.matrix[0, 0] / 200.0, rel=0.15)


@pytest.mark.parametrize("name, value", [
    ("max_bodies", 0), ("min_body_score", 1.5), ("body_death_time", 0.0), ("providers", ["abacus"]),
    ("body_birth_dely", 1.0)])
def test_illegal_parameters_are_named(name, value):
    with pytest.raises(ParameterError, match=name):
        BODIES.resolve({name: value})


def test_vision_has_the_parameters_of_both():
    names = {parameter.name for parameter in VISION.parameters}
    assert {parameter.name for parameter in BODIES.parameters} < names
    assert "face_detection_period" in names


def test_bodies_are_published_in_every_image_but_looked_at_at_their_rate():
    stage, scene, _ = make([(400, 400), (800, 380)], pose_rate=5.0, person_detection_period=10.0)
    measured, published = 0, 0
    for index in range(100):
        if index == 40:
            scene.windows.clear()
        bodies = stage.update(IMAGE, CAMERA, index / 20.0)
        if index >= 40:
            published += len(bodies)
            measured += sum(body.measured for body in bodies)
    assert published == 120
    assert measured == pytest.approx(30, abs=1)
    assert len(scene.windows) == pytest.approx(30, abs=1)


def test_a_hidden_body_is_tracked_and_not_published():
    stage, scene, _ = make([(400, 400)], body_death_time=0.8, pose_rate=10.0)
    for index in range(20):
        stage.update(IMAGE, CAMERA, index / 20.0)
    scene.people = []
    shown = [len(stage.update(IMAGE, CAMERA, 1.0 + index / 20.0)) for index in range(10)]
    assert sum(shown) <= 1                  # until the next look
    assert len(stage.tracked_ids) == 1
    for index in range(10):
        stage.update(IMAGE, CAMERA, 1.5 + index / 20.0)
    assert stage.tracked_ids == []


@pytest.mark.parametrize("rate", [10.0, 2.0, 1.0])
@pytest.mark.parametrize("pause", [8.0, 600.0, 1.7e9])
def test_who_left_while_there_were_no_images_is_not_published(rate, pause):
    stage, scene, _ = make([(80.0 + 300.0 * index, 400.0) for index in range(3)])
    for index in range(30):
        bodies = stage.update(IMAGE, CAMERA, index / rate)
    assert len(bodies) == 3
    scene.people = []
    shown = [len(stage.update(IMAGE, CAMERA, (29 + index) / rate + pause)) for index in range(6)]
    assert shown == [0] * 6


def test_no_windows_are_spent_on_more_people_than_allowed():
    people = [(150 + 150 * index, 400) for index in range(6)]
    stage, scene, _ = make(people, max_bodies=3, pose_rate=0.0, person_detection_period=0.0)
    faces = [face_of(standing_at(*person), "f{}".format(index)) for index, person in enumerate(people)]
    for index in range(40):
        if index == 20:
            scene.windows.clear()
        stage.update(IMAGE, CAMERA, index / 20.0, faces)
    assert len(stage.tracked_ids) <= 3
    assert len(scene.windows) <= 20 * 3


def test_the_budget_is_kept_with_many_people():
    people = [(100 + 110 * index, 400) for index in range(10)]
    stage, scene, _ = make(people, pose_rate=0.0, pose_budget=4, new_windows_per_image=3)
    for index in range(60):
        scene.windows.clear()
        bodies = stage.update(IMAGE, CAMERA, index / 20.0)
        assert len(scene.windows) <= 5
    assert len(bodies) == 10


@pytest.mark.parametrize("name, model", [("lite", "pose_landmarks_lite"), ("heavy", "pose_landmarks_heavy"),
                                         ("", "pose_landmarks_full")])
def test_a_pose_model_that_was_not_fetched_names_the_command(name, model, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS4HRI_MODELS", str(tmp_path))
    with pytest.raises(ModelError, match="fetch_models --models {}`".format(model)):
        pose_model_path(name)
    (tmp_path / (model + ".onnx")).write_bytes(b"")
    assert pose_model_path(name) == tmp_path / (model + ".onnx")


def test_a_pose_model_is_a_name_or_a_path(tmp_path):
    with pytest.raises(ModelError, match="lite, full, heavy"):
        pose_model_path("ful")
    with pytest.raises(ModelError, match="nowhere"):
        pose_model_path("/nowhere/model.onnx")
    (tmp_path / "own.onnx").write_bytes(b"")
    assert pose_model_path(str(tmp_path / "own.onnx")) == tmp_path / "own.onnx"


class OneBad(Scene):
    """A scene whose last person comes out of the network spoilt, or not at all."""

    def __init__(self, people, spoil):
        super().__init__(people)
        self.spoil, self.since = spoil, 0

    def estimate(self, image, window, hidden=(), shown=None, mirrored=False):
        estimate = super().estimate(image, window, hidden, shown)
        if estimate.score > 0.5 and abs(estimate.centre[0] - self.people[-1][0]) < 10.0:
            self.since += 1
            if self.since > 3:
                return self.spoil(estimate)
        return estimate


def spoilt(name, value, where=slice(None)):
    def spoil(estimate):
        array = np.array(getattr(estimate, name))
        array[where] = value
        return replace(estimate, **{name: array})
    return spoil


def broken(estimate):
    raise RuntimeError("the network has no answer")


@pytest.fixture(scope="module")
def alone():
    """The bodies in each image where somebody is alone."""
    stage, _, _ = make([(400, 400)], pose_rate=0.0)
    return [stage.update(IMAGE, CAMERA, index / 20.0) for index in range(30)]


@pytest.mark.parametrize("spoil", [
    broken, spoilt("landmarks", 1e300, 15), spoilt("landmarks", 1e200), spoilt("landmarks", -1e300, 34),
    spoilt("landmarks", np.nan, 7),
    spoilt("world", 1e300), spoilt("world", 0.0), spoilt("world", np.inf, 3), spoilt("confidence", np.nan),
    spoilt("confidence", np.inf), lambda estimate: replace(estimate, score=math.nan),
    lambda estimate: replace(estimate, confidence=estimate.confidence[:5]),
    lambda estimate: replace(estimate, world=estimate.world[:5])])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_one_bad_look_costs_that_body_alone(spoil, alone, left_out):
    scene = OneBad([(400, 400), (900, 380)], spoil)
    stage = BodyPipeline(BODIES.resolve({"pose_rate": 0.0}), pose=scene, detector=Boxes(scene))
    for index, expected in enumerate(alone):
        bodies = stage.update(IMAGE, CAMERA, index / 20.0)
        first = [body for body in bodies if abs(body.box[:3:2].mean() - 400.0) < 50.0]
        assert len(first) == len(expected)
    assert len(expected) == 1 and scene.since > 10
    assert first[0].keypoints_3d == pytest.approx(expected[0].keypoints_3d, nan_ok=True)


@pytest.mark.parametrize("box",
                         [[np.nan] * 4, [100.0, 100.0, 100.0, 100.0], [np.inf] * 4, [300.0, 300.0, 100.0, 100.0]])
def test_one_bad_box_costs_that_box_alone(box, left_out):
    stage, _, detector = make([(400, 400)], person_detection_period=0.0)
    good = detector.detect
    detector.detect = lambda image: (np.concatenate([[box], good(image)[0]]), np.ones(2))
    for index in range(10):
        bodies = stage.update(IMAGE, CAMERA, index / 20.0)
    assert len(bodies) == 1


@pytest.mark.parametrize("pose", [None, Pose(np.eye(3), np.full(3, np.nan)),
                                  Pose(np.eye(3) * np.nan, np.array([0.0, 0.0, 2.0]))])
@pytest.mark.parametrize("landmarks", [np.full((70, 3), np.nan), np.full((70, 3), 500.0), np.full((70, 3), 1e300),
                                       np.zeros((0, 3)), face_of(standing_at(900, 380), "bad").box.reshape(2, 2)])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_one_bad_face_costs_no_body(landmarks, pose):
    stage, _, _ = make([(400, 400)], pose_rate=0.0)
    good = face_of(standing_at(400, 400), "good")
    corners = np.array([[*good.box[:2], 1.0], [*good.box[2:], 1.0]])
    for index in range(10):
        faces = face_boxes([("bad", landmarks, pose), ("good", corners, Pose(np.eye(3), np.array([0.0, -0.6, 6.0])))])
        bodies = stage.update(IMAGE, CAMERA, index / 20.0, faces)
    own = [body for body in bodies if body.head is not None]
    assert len(own) == 1 and np.isfinite(own[0].keypoints_3d).all()


def looks(stage, faces, count=60, start=0):
    """How many bodies there were in each of the images at 20 Hz."""
    return [len(stage.update(IMAGE, CAMERA, (start + index) / 20.0, faces)) for index in range(count)]


def test_a_body_below_a_face_where_the_detector_sees_nobody_is_not_published():
    """The pose network makes a body of a pattern that was taken for a face."""
    stage, scene, detector = make([(400, 400)])
    detector.scene = Scene([])
    face = face_of(standing_at(400, 400), "pattern")
    assert set(looks(stage, [face])) == {0} and stage.tracked_ids == []
    # It is tried again now and then, not all the time.
    scene.windows.clear()
    looks(stage, [face], 400, 60)
    assert len(scene.windows) < 150
    assert detector.calls < 40
    # When it is a human after all, it comes.
    detector.scene = scene
    assert looks(stage, [face], 400, 460)[-1] == 1


@pytest.mark.parametrize("score, count", [(0.2, 1), (0.1, 0)])
def test_a_faint_box_is_enough_for_a_body_that_the_network_is_sure_of_or_a_face_has_shown(score, count):
    stage, scene, detector = make([(400, 400)])
    boxes = detector.detect(IMAGE)[0]
    detector.detect = lambda image: (boxes,
                                     np.array([score])) if score >= detector.threshold else (boxes[:0], np.zeros(0))
    detector.threshold = 0.15
    assert looks(stage, [])[-1] == count
    assert looks(stage, [face_of(standing_at(400, 400), "f")], 20, 60)[-1] == count


class Flag(Scene):
    """What the network takes for a body that it does not see in the mirror, or elsewhere, `aside` px away."""

    def __init__(self, people, aside, score):
        super().__init__(people)
        self.aside, self.score = aside, score

    def estimate(self, image, window, hidden=(), shown=None, mirrored=False):
        found = super().estimate(image, window, hidden, shown, mirrored)
        if not mirrored:
            return found
        return replace(found, score=self.score, landmarks=found.landmarks + [self.aside, 0.0, 0.0])


@pytest.mark.parametrize("aside, mirror_score, box_score, count", [
    (10.0, 0.9, 0.2, 1), (80.0, 0.9, 0.2, 0), (10.0, 0.1, 0.2, 0), (80.0, 0.1, 0.4, 1)])
def test_a_faint_box_starts_a_body_only_if_the_network_sees_it_in_the_mirror_too(aside, mirror_score, box_score,
                                                                                 count):
    boxes = np.array([standing_at(400, 400).box])
    detector = SimpleNamespace(threshold=0.15, detect=lambda image: (boxes, np.array([box_score])),
                               is_human=lambda image, box: True)
    stage = BodyPipeline(BODIES.resolve({}), pose=Flag([(400, 400)], aside, mirror_score), detector=detector)
    assert looks(stage, [])[-1] == count
    # Where there is a face, no box decides.
    assert looks(stage, [face_of(standing_at(400, 400), "f")], 20, 20)[-1] == 1


def test_a_new_body_waits_no_longer_for_the_detector():
    stage, scene, detector = make([(400, 400)], person_detection_period=10.0)
    detector.scene = Scene([])
    looks(stage, [], 2)
    detector.scene = scene
    shown = looks(stage, [face_of(standing_at(400, 400), "f")], 8, 2)
    assert shown[-1] == 1 and shown.index(1) <= 4 and detector.calls == 2


@pytest.mark.parametrize("distance, count", [(6.0, 1), (60.0, 0), (0.5, 0)])
def test_a_small_body_on_a_person_is_none_and_a_face_at_another_distance_needs_a_box_of_its_own(distance, count):
    """The knot of a tie lies in the box of who wears it."""
    stage, _, detector = make([(400, 400)])
    x0, y0, x1, y1 = standing_at(400, 400).box
    wide = np.array([x0 - 60.0, y0 - 100.0, x1 + 500.0, y1 + 20.0])     # of a group
    detector.detect = lambda image: (wide[None], np.full(1, 0.2))     # too faint to start a body
    face = replace(face_of(standing_at(400, 400), "f"), pose=Pose(np.eye(3), np.array([-1.2, 0.0, distance])))
    assert looks(stage, [face], 20)[-1] == count
    stage, _, detector = make([(400, 400)])
    detector.detect = lambda image: (np.array([[0.0, -1000.0, 1280.0, 1000.0]]), np.full(1, 0.2))
    assert looks(stage, [face_of(standing_at(400, 400), "knot")], 20)[-1] == 0


class Reads:
    """Settings that note which of them are read."""

    def __init__(self, values):
        self._values = values
        self.read = set()

    def __getattr__(self, name):
        self.read.add(name)
        return getattr(self._values, name)


def test_the_pipeline_takes_up_every_live_parameter():
    settings = BODIES.resolve({})
    pipeline = BodyPipeline(settings, pose=SimpleNamespace(), detector=SimpleNamespace(
        threshold=0.5, detect=lambda image: (np.zeros((0, 4)), np.zeros(0))))
    changed = Reads(BODIES.changed(settings, {"min_person_score": 0.4}))
    pipeline.reconfigure(changed)
    pipeline.update(np.zeros((48, 64, 3), np.uint8), CAMERA, 0.0)
    pipeline.update(np.zeros((48, 64, 3), np.uint8), CAMERA, 0.1)
    of_the_node = {"max_rate", "joint_state_rate"}
    assert {parameter.name for parameter in BODIES.live} - of_the_node <= changed.read
    assert pipeline._detector.threshold == 0.2     # what is fainter than 0.4 starts no body, and confirms one


def remembered_places(told):
    """Places, for whom to recognise again, of somebody who stands while the head turns by 10 degrees per second.

    told: whether the pose of the camera is.
    """
    stage, scene, _ = make([(150, 400)])
    places, focal = [], CAMERA.matrix[0, 0]
    stage._reidentifier = SimpleNamespace(update=lambda bodies, stamp: places.extend(
        (body.place, body.still) for body in bodies if body.place is not None) or [])
    for index in range(80):
        turn = math.radians(0.5) * index
        cosine, sine = math.cos(turn), math.sin(turn)
        pose = Pose(np.array([[sine, 0.0, cosine], [-cosine, 0.0, sine], [0.0, -1.0, 0.0]]), np.array([5.0, 5.0, 1.4]))
        # On a circle around the camera: at one distance, and so of one size in this scene, by the depth.
        scene.people = [(640.0 + focal * math.tan(math.atan((150.0 - 640.0) / focal) + turn), 400)]
        stage.update(IMAGE, CAMERA, 0.05 * index, camera_pose=pose if told else None)
    return places


def test_who_was_lost_is_remembered_in_the_room_where_the_pose_of_the_camera_is_known():
    places = remembered_places(True)
    ground = np.array([place for place, _ in places])[:, [0, 2]]
    assert len(places) > 30 and all(still for _, still in places)
    bearing = np.degrees(np.arctan2(*(ground - (-5.0, 5.0)).T))
    assert np.ptp(bearing) < 4.0
    others = np.array([place for place, _ in remembered_places(False)])
    assert np.ptp(np.degrees(np.arctan2(others[:, 0], others[:, 2]))) > 25.0


def test_a_box_in_which_a_second_look_sees_an_animal_starts_no_body_unless_there_is_a_face():
    stage, scene, detector = make([(400, 400)])
    looks = []
    detector.is_human = lambda image, box: looks.append(box)
    for index in range(10):
        assert not stage.update(IMAGE, CAMERA, index / 20.0)
    assert np.allclose(looks[0], standing_at(400, 400).box)
    asked = len(looks)
    for index in range(10, 20):
        bodies = stage.update(IMAGE, CAMERA, index / 20.0, [face_of(standing_at(400, 400), "f")])
    assert len(bodies) == 1 and len(looks) == asked


@pytest.mark.parametrize("other, human, faces, count", [
    (650, 400, False, 2), (650, 650, False, 2), (650, None, True, 2), (650, None, False, 0), (800, 400, False, 1)],
    ids=["first is known", "second is known", "a face", "nobody is known", "apart"])
def test_who_stands_beside_a_known_human_needs_no_second_look_since_the_view_would_show_both(
        other, human, faces, count):
    stage, scene, detector = make([(400, 400), (other, 400)])
    detector.is_human = lambda image, box: human is not None and box[0] < human < box[2]
    for index in range(10):
        bodies = stage.update(IMAGE, CAMERA, index / 20.0, [face_of(standing_at(400, 400), "f")] if faces else ())
    assert len(bodies) == count


def still_room():
    return np.random.RandomState(1).randint(60, 200, IMAGE.shape).astype(np.uint8)


def refused(scene, stage, detector, images, start=0.0):
    """How often a second look is asked that sees no human, of images 0.1 s apart."""
    asked = []
    detector.is_human = lambda image, box: asked.append(box)
    for index, image in enumerate(images):
        assert not stage.update(image, CAMERA, start + 0.1 * index)
    return len(asked)


def test_what_was_refused_is_not_asked_again_until_it_moves_or_something_moves_in_it():
    stage, scene, detector = make([(400, 400)], person_detection_period=0.3)
    room = still_room()
    assert refused(scene, stage, detector, [room] * 40) == 1
    nodded = room.copy()
    nodded[360:420, 380:430] = 20
    assert refused(scene, stage, detector, [nodded] * 40, 4.0) == 1
    scene.people = [(460, 400)]
    assert refused(scene, stage, detector, [nodded] * 40, 8.0) == 1
    assert refused(scene, stage, detector, [np.roll(nodded, 3 * step, axis=1) for step in range(40)], 12.0) > 5
    detector.is_human = lambda image, box: True
    for index in range(10):
        bodies = stage.update(room, CAMERA, 16.0 + 0.1 * index)
    assert len(bodies) == 1


def test_refused_places_do_not_delay_who_comes():
    others = [(150, 300), (1000, 300), (150, 650), (1000, 650)]
    stage, scene, detector = make(others, person_detection_period=1.0, new_windows_per_image=1)
    room = still_room()
    assert refused(scene, stage, detector, [room] * 30) == len(others)
    scene.people = [*others, (560, 400)]
    detector.is_human = lambda image, box: box[0] < 560 < box[2]
    stage.update(room, CAMERA, 4.1)     # the detector sees all
    bodies = [stage.update(room, CAMERA, 4.2 + 0.1 * index) for index in range(6)]
    assert sum(map(bool, bodies)) >= 4, [len(found) for found in bodies]


def test_a_face_where_a_body_was_refused_begins_one_in_the_same_picture():
    stage, scene, detector = make([(400, 400)])
    room = still_room()
    assert refused(scene, stage, detector, [room] * 20) == 1
    for index in range(10):
        bodies = stage.update(room, CAMERA, 2.0 + 0.1 * index, [face_of(standing_at(400, 400), "f")])
    assert len(bodies) == 1


class Panned(Scene):
    """People who stand in a room, 0.3 rad apart, before a camera that pans."""

    ANGLES = (-0.3, 0.0, 0.3)
    WALL = np.random.default_rng(2).integers(0, 255, (45, 240, 3)).astype(np.uint8).repeat(16, 0).repeat(16, 1)

    def look(self, pan):
        """Turn the camera to `pan` (rad, to the right) and return its image."""
        focal, (x, y) = CAMERA.matrix[0, 0], CAMERA.matrix[:2, 2]
        self.people = [(x + focal * math.tan(angle - pan), 400.0) for angle in self.ANGLES]
        columns, rows = np.meshgrid(np.arange(1280, dtype=np.float32), np.arange(720, dtype=np.float32))
        angles = np.arctan((columns - x) / focal)
        height = (rows - y) * np.cos(angles) / focal
        turned = angles + pan
        return cv2.remap(self.WALL, (1920.0 + focal * turned).astype(np.float32),
                         (y + focal * height / np.cos(turned)).astype(np.float32), cv2.INTER_LINEAR)

    def faces(self, stamp):
        return [replace(face_of(standing_at(x, y), "f{}".format(number)), stamp=stamp)
                for number, (x, y) in enumerate(self.people) if 0.0 < x < 1280.0]


@pytest.mark.parametrize("with_faces", [True, False])
def test_while_the_camera_pans_nobody_s_body_becomes_the_neighbour_s(with_faces):
    """In a pan of 90 degrees a second the neighbour is in the next image where somebody was in this one, and the faces
    are those of the image before."""
    stage, scene, _ = make([])
    stage._pose = stage._tracker._pose = people = Panned([])
    owners, faces, pan = {}, [], 0.0
    steps = [0.0] * 20 + [0.06, 0.15, 0.2, -0.1, -0.2, -0.11] * 2 + [0.0] * 4
    for number, step in enumerate(steps):
        pan += step
        image = people.look(pan)
        scene.people = [place for place in people.people if 0.0 < place[0] < 1280.0]
        for body in stage.update(image, CAMERA, 0.1 * number, faces):
            human = int(np.argmin([abs(x - body.keypoints[0, 0]) for x, _ in people.people]))
            owners.setdefault(body.id, set()).add(human)
        faces = people.faces(0.1 * number) if with_faces else []
    assert all(len(humans) == 1 for humans in owners.values()), owners
    assert {human for humans in owners.values() for human in humans} == {0, 1, 2} and len(owners) <= 4, owners


def test_in_a_camera_that_shakes_key_points_count_as_in_one_that_stands():
    stage, scene, _ = make([])
    stage._pose = stage._tracker._pose = people = Panned([])
    for number, pan in enumerate([0.0] * 10 + np.random.default_rng(5).uniform(-0.03, 0.03, 20).tolist()):
        image = people.look(pan)
        scene.people = people.people
        bodies = stage.update(image, CAMERA, 0.1 * number, [])
    assert [body.reliability.min() > 0.97 for body in bodies] == [True] * 3
