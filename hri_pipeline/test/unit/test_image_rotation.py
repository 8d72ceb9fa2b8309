"""Cameras that are mounted upside down or on their side: everything is turned, and turned back."""

import math

import numpy as np
import pytest

from hri_pipeline.core.camera import EQUIDISTANT, RATIONAL, Calibration, CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.image_rotation import (
    FaceOrientation,
    ImageOrientation,
    ImageRotation,
    RotationChooser,
    quarter_turns,
)
from hri_pipeline.core.observations import BodyObservation, FaceObservation, GazeEstimate

WIDTH, HEIGHT = 64, 48
MATRIX = np.array([[60.0, 0.0, 30.0], [0.0, 55.0, 26.0], [0.0, 0.0, 1.0]])
LENSES = {
    "none": ("plumb_bob", ()), "tangential": ("plumb_bob", (-0.2, 0.05, 0.01, -0.02, 0.003)),
    "prisms": (RATIONAL, (0.1, -0.05, 0.01, -0.02, 0.01, 0.1, 0.01, 0.02, 0.01, -0.004, 0.006, 0.002)),
    "tilted": (RATIONAL, (0.1, 0.0, 0.01, -0.02, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.05, -0.08)),
    "fisheye": (EQUIDISTANT, (0.02, -0.01, 0.003, 0.0))}
QUARTERS = (0, 1, 2, 3)
IMAGE = np.zeros((48, 64, 3), np.uint8)
IMAGE[0] = 255      # the way up of what it shows


def rotation(quarters):
    return ImageRotation(quarters, WIDTH, HEIGHT)


def camera(lens):
    model, coefficients = LENSES[lens]
    return CameraModel(WIDTH, HEIGHT, MATRIX, np.array(coefficients), model, Calibration.CALIBRATED)


def up_of(roll_deg, down_deg=10.0):
    """Up in the optical frame of a camera that is rolled clockwise, seen from behind it, and looks down."""
    roll, down = math.radians(roll_deg), math.radians(down_deg)
    return np.array([-math.sin(roll) * math.cos(down), -math.cos(roll) * math.cos(down), -math.sin(down)])


@pytest.mark.parametrize("quarters", QUARTERS)
def test_a_pixel_is_where_its_point_is(quarters):
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[7, 50] = 255
    turned = rotation(quarters).image(image)
    x, y, other = rotation(quarters).pixels(np.array([[50.0, 7.0, 0.25]]))[0]
    assert turned[int(y), int(x)].all() and turned.sum() == 3 * 255 and other == 0.25
    assert rotation(quarters).pixels_back(np.array([[x, y, other]]))[0] == pytest.approx([50.0, 7.0, 0.25])


def test_it_turns_clockwise_what_was_on_the_left_is_at_the_top():
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    image[:, 0] = 255
    assert rotation(1).image(image)[0].all()


def test_what_is_not_turned_is_not_copied():
    image, points, pose, box = np.zeros((HEIGHT, WIDTH, 3), np.uint8), np.ones((4, 3)), Pose.identity(), np.ones(4)
    none, model = rotation(0), camera("tangential")
    assert none.image(image) is image and none.camera(model) is model and none.pixels(points) is points
    assert none.vectors_back(points) is points and none.pose(pose) is pose and none.box(box) is box


@pytest.mark.parametrize("lens", sorted(LENSES))
@pytest.mark.parametrize("quarters", QUARTERS)
def test_a_turned_camera_sees_the_turned_world(quarters, lens):
    turn, model = rotation(quarters), camera(lens)
    turned = turn.camera(model)
    assert (turned.width, turned.height) == turn.image(np.zeros((HEIGHT, WIDTH))).shape[::-1]
    world = np.random.default_rng(1).uniform((-0.5, -0.4, 1.0), (0.5, 0.4, 3.0), (20, 3))
    seen = turned.project(turn.vectors(world))
    assert turn.pixels_back(seen) == pytest.approx(model.project(world), abs=1e-6)
    assert turned.normalise(seen) == pytest.approx((turn.vectors(world) / world[:, 2:])[:, :2], abs=1e-5)
    hidden = turned.project(np.array([[0.0, 0.0, -1.0]]))
    assert np.isnan(hidden).all()


@pytest.mark.parametrize("quarters", QUARTERS)
def test_the_matrix_of_a_turned_camera_has_its_focal_lengths_and_its_middle(quarters):
    ideal = CameraModel(WIDTH, HEIGHT, MATRIX, np.zeros(0), "plumb_bob", Calibration.CALIBRATED)
    turned = rotation(quarters).camera(ideal)
    plain = CameraModel(turned.width, turned.height, turned.matrix, np.zeros(0), "plumb_bob", Calibration.CALIBRATED)
    world = np.random.default_rng(2).uniform((-0.5, -0.4, 1.0), (0.5, 0.4, 3.0), (20, 3))
    assert turned.project(world) == pytest.approx(plain.project(world), abs=1e-6)


@pytest.mark.parametrize("quarters", QUARTERS)
def test_a_turned_camera_can_be_of_another_size(quarters):
    turn, model = rotation(quarters), camera("tangential")
    half = turn.camera(model).resized(*((24, 32) if quarters % 2 else (32, 24)))
    small = ImageRotation(quarters, 32, 24)
    world = np.random.default_rng(3).uniform((-0.5, -0.4, 1.0), (0.5, 0.4, 3.0), (20, 3))
    assert small.pixels_back(half.project(turn.vectors(world))) == pytest.approx(
        model.resized(32, 24).project(world), abs=1e-6)
    assert small.camera(model).project(world) == pytest.approx(half.project(world), abs=1e-6)


@pytest.mark.parametrize("quarters", QUARTERS)
def test_boxes_vectors_and_poses_come_back(quarters):
    turn, random = rotation(quarters), np.random.default_rng(4)
    box = np.array([5.0, 7.0, 20.0, 40.0])
    corners = turn.pixels(box.reshape(2, 2))
    assert turn.box(box) == pytest.approx([*corners.min(axis=0), *corners.max(axis=0)])
    assert turn.box_back(turn.box(box)) == pytest.approx(box)
    places = random.normal(size=(2, 5, 3))
    assert turn.vectors_back(turn.vectors(places)) == pytest.approx(places)
    pose = Pose.from_quaternion(random.normal(size=4), random.normal(size=3))
    assert turn.pose(pose).apply(places[0]) == pytest.approx(turn.vectors(pose.apply(places[0])))
    assert turn.pose_back(turn.pose(pose)).differs(pose) == pytest.approx((0.0, 0.0), abs=1e-7)
    # A place in the room is the same, whichever optical frame it is told in.
    assert turn.of_camera(pose).apply(turn.vectors(places[0])) == pytest.approx(pose.apply(places[0]))


@pytest.mark.parametrize("quarters", QUARTERS)
def test_observations_are_told_in_the_original_image(quarters):
    turn, random = rotation(quarters), np.random.default_rng(5)
    pixels, places = random.uniform(0.0, 40.0, (478, 3)), random.normal(size=(18, 3))
    pose = Pose.from_quaternion(random.normal(size=4), random.normal(size=3))
    box, direction = np.array([5.0, 7.0, 20.0, 40.0]), np.array([0.6, 0.0, -0.8])
    seen = FaceObservation("a", turn.box(box), 0.9, turn.pixels(pixels[:70]), turn.pixels(pixels), turn.pose(pose),
                           GazeEstimate(turn.vectors(direction), 0.8, 0.1))
    face = turn.face_back(seen)
    assert face.landmarks == pytest.approx(pixels[:70]) and face.mesh == pytest.approx(pixels)
    assert face.box == pytest.approx(box) and face.gaze.direction == pytest.approx(direction)
    assert face.pose.translation == pytest.approx(pose.translation)
    body = turn.body_back(BodyObservation(
        "b", turn.box(box), 0.9, turn.pixels(pixels[:18]), turn.vectors(places), turn.pose(pose), turn.pose(pose),
        turn.vectors(direction), hands=turn.vectors(places[:2])))
    assert body.box == pytest.approx(box) and body.keypoints == pytest.approx(pixels[:18])
    assert body.keypoints_3d == pytest.approx(places) and body.hands == pytest.approx(places[:2])
    assert body.velocity == pytest.approx(direction)
    for one in (body.pose, body.head):
        assert one.rotation == pytest.approx(pose.rotation) and one.translation == pytest.approx(pose.translation)
    nothing = turn.body_back(BodyObservation("b", box, 0.9, pixels[:18], places))
    assert nothing.pose is nothing.head is nothing.velocity is nothing.hands is None


@pytest.mark.parametrize("roll, quarters", [
    (0, 0), (40, 0), (50, 1), (90, 1), (130, 1), (140, 2), (180, 2), (-180, 2), (-90, 3), (-50, 3), (-40, 0)])
@pytest.mark.parametrize("down", [-60.0, 0.0, 70.0])
def test_the_roll_of_the_camera_decides(roll, quarters, down):
    up = up_of(roll, down)
    assert RotationChooser().update(up) == quarters
    # In the image that is turned so, up is up.
    turned = rotation(quarters).vectors(up)
    assert -turned[1] >= abs(turned[0])


def test_a_camera_near_45_degrees_does_not_flap():
    chooser, random = RotationChooser(), np.random.default_rng(6)
    turns = [chooser.update(up_of(45.0 + random.normal(0.0, 3.0))) for _ in range(200)]
    assert len(set(turns)) == 1
    assert chooser.update(up_of(90.0)) == 1 and chooser.update(up_of(37.0)) == 1 and chooser.update(up_of(33.0)) == 0


def test_a_camera_that_looks_straight_up_or_down_keeps_its_turn():
    chooser = RotationChooser()
    assert chooser.update(up_of(180.0, 40.0)) == 2
    for down in (80.0, 90.0, -80.0):
        assert {chooser.update(up_of(roll, down)) for roll in range(0, 360, 10)} == {2}
    assert chooser.update(None) == 2 and chooser.update(np.full(3, np.nan)) == 2
    assert RotationChooser().update(up_of(180.0, 85.0)) == 0


def test_a_given_rotation_holds_whatever_the_transform_says():
    assert [RotationChooser(str(degrees)).update(up_of(180.0)) for degrees in (0, 90, 180, 270)] == [0, 1, 2, 3]
    with pytest.raises(ValueError, match="auto, 0, 90, 180, 270"):
        RotationChooser("45")


class Clear:
    """A detector that sees people clearly where the white row is at the top, and a little elsewhere."""

    def __init__(self, score=0.7):
        self.score, self.calls = score, 0

    def __call__(self, image):
        self.calls += 1
        return np.zeros((1, 4)), np.array([self.score if image[0].all() else 0.2])


def shown(image, seconds, detect, orientation=None):
    orientation = orientation or ImageOrientation()
    for stamp in np.arange(0.0, seconds, 1.0):
        orientation.update(image, detect(image)[1], float(stamp), detect)
    return orientation.turn


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_a_turned_camera_is_told_within_a_minute(turn):
    assert shown(np.rot90(IMAGE, -turn), 60.0, Clear()) == turn


def test_an_upright_camera_costs_nothing_and_stays_upright():
    detect, orientation = Clear(), ImageOrientation()
    assert shown(IMAGE, 60.0, detect, orientation) == 0 and detect.calls == 60
    orientation.update(np.rot90(IMAGE, 2), np.array([0.2]), 100.0, detect)     # somebody stands on their head
    assert orientation.turn == 0 and detect.calls == 60


def test_who_is_unclear_either_way_tells_nothing_and_costs_little():
    detect = Clear(0.4)
    assert shown(np.rot90(IMAGE, 2), 60.0, detect) is None and detect.calls <= 66


def test_who_was_clear_once_in_a_turned_image_is_no_sign():
    detect, orientation = Clear(), ImageOrientation()
    for stamp in range(15):     # asked about once
        orientation.update(np.rot90(IMAGE, 2), np.array([0.2]), float(stamp), detect)
    for stamp in range(15, 90):
        orientation.update(np.zeros_like(IMAGE), np.zeros(0), float(stamp), detect)
    assert orientation.turn is None


class Faces:
    """A detector of faces that sees them a little less clearly in turned images: best with the white row at the top."""

    def __init__(self, *scores):
        self.scores, self.calls = scores, 0

    def __call__(self, image):
        self.calls += 1
        turn = next(turn for turn in range(4) if np.rot90(image, turn)[0].all())
        return np.zeros((1, 4)), np.array([self.scores[turn]])


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_by_faces_the_best_of_four_orientations_is_told_within_a_minute(turn):
    orientation, detect = FaceOrientation(), Faces(0.9, 0.7, 0.6, 0.85)
    for stamp in range(60):
        orientation.update(np.rot90(IMAGE, -turn), float(stamp), detect)
    assert orientation.turn == turn and (turn or detect.calls == 8)


def test_the_four_orientations_of_one_image_are_compared_in_four_images():
    """All in one image they made it the dearest of ten seconds."""
    orientation, detect = FaceOrientation(), Faces(0.9, 0.7, 0.6, 0.85)
    calls = []
    for step in range(120):     # who comes later changes nothing of a comparison that has begun
        of = IMAGE if step in (0, 100) else np.rot90(IMAGE, 2)
        orientation.update(of, 0.1 * step, detect)
        calls.append(detect.calls)
    assert max(np.diff([0] + calls)) == 1 and orientation.turn == 0 and detect.calls == 8


def test_an_orientation_that_could_not_be_asked_about_is_asked_about_again():
    orientation, detect = FaceOrientation(), Faces(0.9, 0.7, 0.6, 0.85)
    orientation.update(IMAGE, 0.0, detect)
    with pytest.raises(RuntimeError):
        orientation.update(IMAGE, 0.1, failing)
    for step in range(2, 120):
        orientation.update(IMAGE, 0.1 * step, detect)
    assert orientation.turn == 0 and detect.calls == 8


def failing(image):
    raise RuntimeError("no memory")


def test_faces_that_are_unclear_or_as_clear_in_two_orientations_tell_nothing():
    for scores in ((0.8, 0.5, 0.3, 0.3), (0.9, 0.5, 0.3, 0.89), (0.3, 0.5, 0.81, 0.3)):
        orientation, detect = FaceOrientation(), Faces(*scores)
        for stamp in range(60):
            orientation.update(IMAGE, float(stamp), detect)
        assert orientation.turn is None and detect.calls == 4 * 6


@pytest.mark.parametrize("make, detect", [(ImageOrientation, Clear()), (FaceOrientation, Faces(0.9, 0.7, 0.6, 0.85))])
def test_what_was_seen_of_turned_images_does_not_hold_for_those_that_are_turned_upright(make, detect):
    """As where the transform to ~up_frame comes late: what is to be set was told for the images as they came."""
    orientation = make()
    for stamp in range(60):
        of = np.rot90(IMAGE, 2)
        given = (of, detect(of)[1]) if make is ImageOrientation else (of,)
        orientation.update(*given, float(stamp), detect)
    assert orientation.turn == 2
    orientation.images_turn()
    assert orientation.turn is None
    orientation.turn = 0
    orientation.images_turn()
    assert orientation.turn == 0, "a camera that rolls shows upright people all the time"


@pytest.mark.parametrize("up, turn", [
    ((0.0, -1.0, 0.0), 0), ((0.3, -0.8, -0.5), 0), ((0.0, 1.0, 0.0), 2), ((1.0, 0.0, 0.0), 1), ((-0.9, 0.1, -0.3), 3),
    ((0.1, 0.2, -0.97), None)])
def test_turns_by_the_vertical(up, turn):
    assert quarter_turns(np.array(up)) == turn
