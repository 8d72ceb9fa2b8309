"""A photograph as cameras see it that are mounted upside down, on their side, or roll while they look: the same people
at the same places in the room."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from hri_fullbody.core.detection.windows import face_boxes
from hri_fullbody.core.parameters import VISION
from hri_fullbody.core.pipeline import BodyPipeline
from hri_pipeline.core.camera import Calibration, CameraModel
from hri_pipeline.core.faces.pipeline import FacePipeline
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import ImageRotation, RotationChooser
from hri_pipeline.core.onnx import models_directory

RATE = 15.0
HEIGHT_M = 1.4
LENS = (-0.1, 0.02, 0.004, -0.006, 0.0)
LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def photograph(number, width):
    image = cv2.imread(str(models_directory() / "demo" / "sample{}.jpg".format(number)))
    assert image is not None, "run `rosrun hri_pipeline fetch_models`"
    return cv2.resize(image, (width, width * image.shape[0] // image.shape[1]), interpolation=cv2.INTER_AREA)


class Watcher:
    """Both pipelines, and a camera that is rolled clockwise, as seen from behind it, by degrees that may change.

    What is kept is told of the image as it comes, by image: {id: place in the room (3,) m}, and {id: box (4,) px}.
    """

    def __init__(self, rotation="auto", ignored=()):
        settings = VISION.resolve({"face_budget": 1000.0, "cpu_share": 0.0, "recognition": False,
                                   "ignored_regions": list(ignored)})
        self.stages = FacePipeline(settings), BodyPipeline(settings)
        self.chooser, self.quarters, self.images = RotationChooser(rotation), 0, 0
        self.faces, self.bodies, self.boxes, self.turns = [], [], [], []

    def see(self, image, camera, roll, depth=None):
        angle, stamp = math.radians(roll), self.images / RATE
        rolled = np.array([[math.cos(angle), math.sin(angle), 0.0], [-math.sin(angle), math.cos(angle), 0.0],
                           [0.0, 0.0, 1.0]])
        place = Pose(LEVEL @ rolled.T, np.array([0.0, 0.0, HEIGHT_M]))
        turn = ImageRotation(self.chooser.update(place.rotation[2]), image.shape[1], image.shape[0])
        if turn.quarters != self.quarters:
            for stage in self.stages:
                stage.turn(turn.since(self.quarters))
            self.quarters = turn.quarters
        upright, model = turn.image(image), turn.camera(camera)
        depth = None if depth is None else turn.image(depth)
        seen = self.stages[0].update(upright, model, stamp, depth)
        bodies = self.stages[1].update(
            upright, model, stamp, face_boxes((face.id, face.landmarks, face.pose) for face in seen), depth=depth,
            up=turn.vectors(place.rotation[2]), camera_height=HEIGHT_M, camera_pose=turn.of_camera(place))
        faces = [turn.face_back(face) for face in seen]
        bodies = [turn.body_back(body) for body in bodies]
        for kept, found in ((self.faces, faces), (self.bodies, bodies)):
            kept.append({one.id: place.apply(one.pose.translation[None])[0] for one in found if one.pose is not None})
        self.boxes.append({one.id: one.box for one in [*faces, *bodies]})
        self.turns.append(turn.degrees)
        self.images += 1


def lens(image):
    height, width = image.shape[:2]
    matrix = np.array([[width, 0.0, 0.48 * width], [0.0, width, 0.53 * height], [0.0, 0.0, 1.0]])
    return CameraModel(width, height, matrix, np.array(LENS), "plumb_bob", Calibration.CALIBRATED)


def mounted(camera, quarters):
    """The same lens as the calibration of a camera tells it that is rolled clockwise by so many quarter turns."""
    k1, k2, p1, p2, k3 = camera.distortion
    (fx, _, cx), (_, fy, cy), _ = camera.matrix
    width, height = camera.width, camera.height
    for _ in range(quarters):       # the picture turns anticlockwise: x' = y, y' = width - 1 - x
        fx, fy, cx, cy, p1, p2, width, height = fy, fx, cy, width - 1 - cx, -p2, p1, height, width
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return CameraModel(width, height, matrix, np.array((k1, k2, p1, p2, k3)), "plumb_bob", Calibration.CALIBRATED)


def nearest(places, others):
    """Distance (m) of each of `others` from the nearest place."""
    return [min(float(np.linalg.norm(one - other)) for one in places.values()) for other in others.values()]


@pytest.fixture(scope="module")
def upright():
    """What a level camera sees, without and with a depth image of a wall that recedes to the right."""
    image = photograph(1, 960)
    wall = np.broadcast_to(np.linspace(1.5, 3.0, image.shape[1]), image.shape[:2]).astype(np.float32)
    watchers = {}
    for depth in (False, True):
        watchers[depth] = Watcher("0")
        for _ in range(14):
            watchers[depth].see(image, lens(image), 0.0, wall if depth else None)
    assert len(watchers[False].faces[-1]) >= 3 and len(watchers[False].bodies[-1]) >= 3
    return image, wall, watchers


@pytest.mark.parametrize("depth", [False, True])
@pytest.mark.parametrize("quarters, setting", [(1, "auto"), (2, "180"), (3, "auto")])
def test_the_same_people_at_the_same_places(upright, quarters, setting, depth):
    image, wall, watchers = upright
    turned, camera = np.ascontiguousarray(np.rot90(image, quarters)), mounted(lens(image), quarters)
    far = np.ascontiguousarray(np.rot90(wall, quarters)) if depth else None
    watcher = Watcher(setting)
    for _ in range(14):
        watcher.see(turned, camera, 90.0 * quarters, far)
    assert watcher.turns[-1] == 90 * quarters
    for found, wanted in ((watcher.faces, watchers[depth].faces), (watcher.bodies, watchers[depth].bodies)):
        assert len(found[-1]) == len(wanted[-1])
        assert max(nearest(wanted[-1], found[-1]) + nearest(found[-1], wanted[-1])) < 0.02
    back = ImageRotation(quarters, turned.shape[1], turned.shape[0])
    boxes = np.array(list(watchers[depth].boxes[-1].values()))
    for box in watcher.boxes[-1].values():
        assert np.abs(boxes - back.box(box)).max(axis=1).min() < 3.0
    shown = np.array(list(watcher.boxes[-1].values()))
    assert (shown >= -1.0).all() and (shown[:, 2:].max(axis=0) <= turned.shape[1::-1]).all()


def test_ignored_regions_are_those_of_the_image_as_it_comes(upright):
    image = upright[0]
    turned, camera = np.ascontiguousarray(np.rot90(image, 2)), mounted(lens(image), 2)
    free, ignoring = Watcher("180"), Watcher("180", ["0 0 0.45 1"])
    for _ in range(10):
        free.see(turned, camera, 180.0)
        ignoring.see(turned, camera, 180.0)
    everybody, left = (watcher.faces[-1] for watcher in (free, ignoring))
    there = {name: (box[0] + box[2]) / 2.0 / image.shape[1] for name, box in free.boxes[-1].items()
             if name in everybody}
    assert 0 < sum(x > 0.45 for x in there.values()) == len(left) < len(there)


@pytest.mark.parametrize("number", [1, 4])
def test_people_keep_their_ids_and_places_while_the_camera_rolls(number):
    picture, width, height = photograph(number, 660), 960, 720
    camera = CameraModel.from_fov(width, height, 0.9)
    watcher, start = Watcher(), 18
    for roll in [0.0] * start + list(np.arange(0.0, 181.0, 4.0)) + [180.0] * 6:
        view = cv2.getRotationMatrix2D((picture.shape[1] / 2.0, picture.shape[0] / 2.0), roll, 1.0)
        view[:, 2] += (width / 2.0 - picture.shape[1] / 2.0, height / 2.0 - picture.shape[0] / 2.0)
        watcher.see(cv2.warpAffine(picture, view, (width, height), borderValue=(120, 120, 120)), camera, roll)
    assert sorted(set(watcher.turns)) == [0, 90, 180]
    for found in (watcher.faces, watcher.bodies):
        first = found[start - 1]
        assert len(first) >= 3 and set().union(*found[start:]) == set(first) == set(found[-1])
    first = watcher.faces[start - 1]
    away = [float(np.linalg.norm(place - first[name]))
            for seen in watcher.faces[start:] for name, place in seen.items()]
    assert max(away) < 0.1
