"""Gaze and eyelids of a made-up head whose eyes look where we want."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_pipeline.core.camera import Calibration, CameraModel
from hri_pipeline.core.faces.gaze import (
    EYE_BACK,
    EYE_OUT,
    EYE_RADIUS,
    EYE_UP,
    EYES_CONFIDENCE,
    HEAD_CONFIDENCE,
    OPEN,
    EyeGeometry,
    Eyelids,
    GazeEstimator,
    GazeSmoother,
    OpenEyeBaseline,
    closedness,
    gaze_frame,
)
from hri_pipeline.core.faces.head_pose import IRIS_BIAS, scale_from_iris
from hri_pipeline.core.faces.mesh import EYE_BLINK, LOOK_DOWN, LOOK_IN, LOOK_OUT, CanonicalFace
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.observations import GazeEstimate

CAMERA = CameraModel.from_fov(1280, 720, 1.0)
UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
CORNERS = {33: (-0.0445, -0.0266, -0.0317), 133: (-0.0186, -0.0259, -0.0376),
           263: (0.0445, -0.0266, -0.0317), 362: (0.0186, -0.0259, -0.0376)}
PAIRS = {(160, 144): (33, 133, 0.33), (158, 153): (33, 133, 0.67), (387, 373): (263, 362, 0.33),
         (385, 380): (263, 362, 0.67)}


def head(opening=0.3):
    """Vertices of a face of which only sellion and eyes matter; opening: aspect ratio of the lids."""
    vertices = np.tile([0.0, 0.0, 0.02], (468, 1))
    vertices[168] = (0.0, -0.024, -0.045)
    for index, place in CORNERS.items():
        vertices[index] = place
    for (upper, lower), (outer, inner, part) in PAIRS.items():
        outer, inner = np.array(CORNERS[outer]), np.array(CORNERS[inner])
        middle, half = outer + part * (inner - outer), 0.5 * opening * np.linalg.norm(inner - outer)
        vertices[upper], vertices[lower] = middle - (0, half, 0), middle + (0, half, 0)
    return CanonicalFace(vertices, np.arange(6))


def pose_of(yaw=0.0, pitch=0.0, roll=0.0, place=(0.0, 0.0, 0.7)):
    turn = Rotation.from_euler("zyx", [roll, -yaw, -pitch], degrees=True).as_matrix()
    return Pose(turn @ UPRIGHT, np.array(place))


def mesh_of(pose, direction, opening=0.3, scale=1.0):
    """Mesh (478, 3) px of that head whose eyes look in `direction` of the optical frame, (3,), or (2, 3) one of each
    eye; scale: of the irises' size."""
    face = head(opening)
    model = pose.compose(face.face_frame().inverse())
    mesh = np.zeros((478, 3))
    mesh[:468, :2] = CAMERA.project(model.apply(face.vertices))
    corners = np.array([[CORNERS[33], CORNERS[133]], [CORNERS[263], CORNERS[362]]]).mean(axis=1)
    centres = model.apply(corners + [[-EYE_OUT, -EYE_UP, EYE_BACK], [EYE_OUT, -EYE_UP, EYE_BACK]])
    for first, centre, line in zip((468, 473), centres, np.broadcast_to(direction, (2, 3))):
        iris = CAMERA.project((centre + EYE_RADIUS * line)[None])[0]
        radius = scale * 0.5 * 0.0117 * CAMERA.matrix[0, 0] / centre[2]
        mesh[first:first + 5, :2] = iris + radius * np.array([(0, 0), (1, 0), (0, -1), (-1, 0), (0, 1)])
    return mesh


def estimator(opening=0.3):
    return GazeEstimator(EyeGeometry(head(opening)))


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0)))


def towards(yaw, pitch):
    """Unit direction, degrees to the right of the image and up, from one that looks at the camera."""
    yaw, pitch = np.radians([yaw, pitch])
    return np.array([np.sin(yaw) * np.cos(pitch), -np.sin(pitch), -np.cos(yaw) * np.cos(pitch)])


@pytest.mark.parametrize("head_turn", [(0, 0, 0), (25, 0, 0), (-20, 10, 15), (0, -15, -30)])
@pytest.mark.parametrize("look", [(0, 0), (15, 5), (-12, -8)])
def test_eyes_tell_the_direction_whatever_the_head_does(head_turn, look):
    pose, direction = pose_of(*head_turn), towards(*look)
    gaze = estimator().estimate(mesh_of(pose, direction), pose, CAMERA)
    assert gaze.from_eyes == pytest.approx(1.0)
    assert degrees(gaze.direction, direction) < 1.0
    assert gaze.confidence == pytest.approx(EYES_CONFIDENCE)
    assert np.linalg.norm(gaze.direction) == pytest.approx(1.0)


def test_small_irises_leave_it_to_the_head_and_say_so():
    pose, direction = pose_of(20, 0, 0, (0, 0, 0.7)), towards(-5, 0)
    gaze = estimator().estimate(mesh_of(pose, direction, scale=0.1), pose, CAMERA, presence=0.5)
    assert gaze.from_eyes == 0.0
    assert degrees(gaze.direction, pose.rotation[:, 0]) < 1e-3
    assert gaze.confidence == pytest.approx(0.5 * HEAD_CONFIDENCE)
    half = estimator().estimate(mesh_of(pose, direction, scale=0.18), pose, CAMERA)
    assert 0.0 < half.from_eyes < 1.0
    assert degrees(half.direction, direction) < degrees(pose.rotation[:, 0], direction)


def test_eyes_that_disagree_are_not_believed():
    pose = pose_of()
    mesh = mesh_of(pose, towards(0, 0))
    mesh[468:473] = mesh_of(pose, towards(35, 0))[468:473]
    assert estimator().estimate(mesh, pose, CAMERA).from_eyes < 0.1


@pytest.mark.parametrize("distance", [0.15, 0.25, 0.3])
@pytest.mark.parametrize("beside", [0.0, 2.0, -10.0])
def test_the_eyes_of_a_near_face_converge_and_are_believed(distance, beside):
    pose = pose_of(place=(0.0, 0.0, distance))
    target = pose.translation + distance * towards(beside, 0.0)
    inner = np.array([[CORNERS[33], CORNERS[133]], [CORNERS[263], CORNERS[362]]]).mean(axis=1)
    eyes = pose.compose(head().face_frame().inverse()).apply(inner)
    lines = (target - eyes) / np.linalg.norm(target - eyes, axis=1, keepdims=True)
    gaze = estimator().estimate(mesh_of(pose, lines), pose, CAMERA)
    assert gaze.from_eyes > 0.9
    assert degrees(gaze.direction, towards(beside, 0.0)) < 4.0
    # As far apart, but diverging, they are wrong.
    apart = estimator().estimate(mesh_of(pose, lines[::-1]), pose, CAMERA)
    assert distance > 0.2 or apart.from_eyes < 0.2


@pytest.mark.parametrize("width", [13, 20, 26, 30])
def test_the_gaze_of_a_face_of_13_to_30_px_is_that_of_its_head_and_says_so(width):
    distance = 0.15 * CAMERA.matrix[0, 0] / width
    pose = pose_of(20, 5, 0, (0.0, 0.0, distance))
    gaze = estimator().estimate(mesh_of(pose, towards(-5, 0)), pose, CAMERA, presence=0.9)
    assert gaze.from_eyes == 0.0 and gaze.confidence == pytest.approx(0.9 * HEAD_CONFIDENCE)
    assert gaze.direction == pytest.approx(pose.rotation[:, 0]) and gaze.eyes_closed < OPEN


@pytest.mark.parametrize("opening", [0.3, 0.05])
def test_the_gaze_behind_dark_glasses_is_that_of_the_head_and_the_eyes_are_never_told_shut(opening):
    """The mesh invents irises and lids there: a look was told at 0.9, and eyes were shut."""
    pose, lost = pose_of(20, 5, 0), estimator(opening)
    meshes = [mesh_of(pose, towards(-5, 0), opening)] * 2
    shapes = np.tile(shapes_of(0.9 if opening < 0.1 else 0.2, 0.8), (2, 1))
    (seen, hidden), _ = lost.estimate_all(meshes, [pose] * 2, CAMERA, [0.9, 0.9], shapes, [False, True])
    assert seen.from_eyes > 0.9 and (seen.eyes_closed > 0.8) == (opening < 0.1)
    assert hidden.from_eyes == 0.0 and hidden.confidence == pytest.approx(0.9 * HEAD_CONFIDENCE)
    assert hidden.direction == pytest.approx(pose.rotation[:, 0])
    smooth = GazeSmoother()
    for number in range(20):
        told = smooth(hidden, 0.1 * number)
        assert told.eyes_closed < OPEN and told.confidence == pytest.approx(0.9 * HEAD_CONFIDENCE)


WIDE = CameraModel.from_fov(1280, 720, 2.0)
FISHEYE = CameraModel(1280, 720, np.array([[500.0, 0, 640], [0, 500.0, 360], [0, 0, 1]]), np.zeros(4), "equidistant",
                      Calibration.CALIBRATED)


@pytest.mark.parametrize("camera", [WIDE, FISHEYE], ids=["wide", "fisheye"])
@pytest.mark.parametrize("aside", [0.0, 25.0, -45.0])
def test_irises_tell_the_same_size_of_a_head_wherever_in_the_image_it_is(camera, aside):
    # Who turns to the camera, 25 cm away: the same head and eyes, turned about the camera.
    turn = Rotation.from_euler("y", aside, degrees=True).as_matrix()
    ahead = pose_of(place=(0.0, 0.0, 0.25))
    pose = Pose(turn @ ahead.rotation, turn @ ahead.translation)
    corners = np.array([[CORNERS[33], CORNERS[133]], [CORNERS[263], CORNERS[362]]]).mean(axis=1)
    eyes = pose.compose(head().face_frame().inverse()).apply(corners)
    rims = 0.5 * 0.0117 * np.array([(0.0, 0, 0), (1, 0, 0), (0, -1, 0), (-1, 0, 0), (0, 1, 0)]) @ turn.T
    mesh = np.zeros((478, 3))
    mesh[:468, :2] = camera.project(pose.compose(head().face_frame().inverse()).apply(head().vertices))
    mesh[468:, :2] = camera.project(np.concatenate([eye + rims for eye in eyes]))
    measured = EyeGeometry(head())
    found = measured.measure(mesh[None], pose.rotation[None], pose.translation[None], camera)
    scale = scale_from_iris(found.irises[0], found.iris_angles[0], pose, measured, 1.0)
    assert scale * IRIS_BIAS == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("camera", [replace(WIDE, calibration=Calibration.CALIBRATED), FISHEYE],
                         ids=["wide", "fisheye"])
@pytest.mark.parametrize("aside", [(0.0, 25.0), (0.0, -45.0), (25.0, 30.0)])
def test_lids_are_as_open_wherever_in_the_image_they_are(camera, aside):
    turn = Rotation.from_euler("xy", aside, degrees=True).as_matrix()
    pose, mesh = pose_of(), np.zeros((478, 3))
    places = pose.compose(head().face_frame().inverse()).apply(head().vertices)
    measured = []
    for turned in (np.eye(3), turn):
        mesh[:468, :2] = camera.project(places @ turned.T)
        measured.append(EyeGeometry(head()).measure(
            mesh[None], (turned @ pose.rotation)[None], (turned @ pose.translation)[None], camera).openness)
    assert measured[1] == pytest.approx(measured[0], rel=0.01)


def test_eyes_turn_only_so_far_in_their_head():
    pose = pose_of()
    gaze = estimator().estimate(mesh_of(pose, towards(75, 0)), pose, CAMERA)
    assert degrees(gaze.direction, pose.rotation[:, 0]) < 41.0


def test_several_faces_at_once_are_the_same_as_one_by_one():
    poses = [pose_of(10, 5, 0), pose_of(-30, 0, 20, (0.3, 0.1, 1.2)), pose_of(60, 0, 0)]
    meshes = [mesh_of(pose, towards(5, 3)) for pose in poses]
    together, eyes = estimator().estimate_all(meshes, poses, CAMERA, [1.0, 0.9, 0.8])
    assert eyes.irises.shape == (3, 2)
    for gaze, mesh, pose, presence in zip(together, meshes, poses, [1.0, 0.9, 0.8]):
        alone = estimator().estimate(mesh, pose, CAMERA, presence)
        assert gaze.direction == pytest.approx(alone.direction)
        assert (gaze.confidence, gaze.eyes_closed) == pytest.approx((alone.confidence, alone.eyes_closed))
    assert estimator().estimate_all([], [], CAMERA, [])[0] == []


@pytest.mark.parametrize("turn", [(0, 0, 0), (35, 0, 0), (-35, 0, 0), (0, 25, 0), (0, -25, 0), (20, 10, 40)])
def test_lids_are_judged_alike_however_the_head_is_turned(turn):
    pose = pose_of(*turn)
    opened, closed = (estimator(ratio).estimate(mesh_of(pose, towards(0, 0), ratio), pose, CAMERA).eyes_closed
                      for ratio in (0.25, 0.06))
    assert opened < 0.2 and closed > 0.8


def test_the_far_eye_of_a_profile_does_not_count():
    pose = pose_of(70)
    mesh = mesh_of(pose, towards(60, 0), 0.06)
    other = mesh_of(pose, towards(60, 0), 0.6)
    near = [33, 133, 160, 144, 158, 153] if EyeGeometry(head()).measure(
        mesh[None], pose.rotation[None], pose.translation[None], CAMERA).visibility[0].argmax() == 0 else [
            263, 362, 387, 373, 385, 380]
    other[near] = mesh[near]
    assert estimator(0.06).estimate(other, pose, CAMERA).eyes_closed > 0.8


def shapes_of(blink, down=0.1):
    shapes = np.zeros(52)
    shapes[list(EYE_BLINK)], shapes[list(LOOK_DOWN)] = blink, down
    return shapes


def lids(openness, blink, down=0.1, known=1.0):
    return Eyelids((openness, openness), (blink, blink), (1.0, 1.0), down, known)


@pytest.mark.parametrize("openness,blink,down", [(0.17, 0.41, 0.1), (0.15, 0.53, 0.55), (0.14, 0.47, 0.1)])
def test_narrow_eyes_and_eyes_that_look_down_are_open_while_nothing_is_known_of_them(openness, blink, down):
    assert closedness(lids(openness, blink, down)) < 0.4


@pytest.mark.parametrize("openness,blink,down", [(0.05, 0.69, 0.7), (0.09, 0.61, 0.7), (0.02, 0.75, 0.8)])
def test_eyes_that_are_clearly_shut_are_closed_at_once(openness, blink, down):
    assert closedness(lids(openness, blink, down)) > 0.6


def test_eyes_are_shut_for_their_own_person():
    wide, narrow = OpenEyeBaseline(), OpenEyeBaseline()
    for index in range(100):
        wide.closedness(lids(0.35, 0.10), 0.1 * index)
        narrow.closedness(lids(0.15, 0.43), 0.1 * index)
    between = lids(0.115, 0.53)
    assert wide.closedness(between, 11.0) > 0.7 > 0.3 > narrow.closedness(between, 11.0)
    assert narrow.closedness(lids(0.04, 0.72), 11.1) > 0.8


def test_who_sleeps_from_the_first_image_on_does_not_become_open_eyed():
    eyes = OpenEyeBaseline()
    assert min(eyes.closedness(lids(0.05, 0.70), 0.1 * index) for index in range(300)) > 0.8


def test_blendshapes_are_a_second_opinion_where_the_eyes_disagree():
    pose, shapes = pose_of(), shapes_of(0.1, 0.0)
    shapes[[LOOK_IN[0], LOOK_OUT[1]]] = 0.8      # both eyes to the subject's left
    mesh = mesh_of(pose, towards(-10, 0))
    mesh[473:478] = mesh_of(pose, towards(30, 0))[473:478]
    alone, with_shapes = (estimator().estimate(mesh, pose, CAMERA, 1.0, one).direction for one in (None, shapes))
    assert with_shapes @ pose.rotation[:, 1] > alone @ pose.rotation[:, 1] + 0.1
    agreed = mesh_of(pose, towards(10, 0))
    assert degrees(estimator().estimate(agreed, pose, CAMERA, 1.0, shapes).direction, towards(10, 0)) < 3.0


def test_blendshapes_count_more_where_one_iris_is_seen():
    shapes = shapes_of(0.1, 0.0)
    shapes[[LOOK_IN[0], LOOK_OUT[1]]] = 0.4      # both eyes to the subject's left

    def moved(yaw):
        pose = pose_of(yaw=yaw)
        mesh = mesh_of(pose, towards(0, 0))
        return degrees(*(estimator().estimate(mesh, pose, CAMERA, 1.0, one).direction for one in (None, shapes)))

    assert moved(45) > 2.0 * moved(0)


def test_fresh_blendshapes_are_asked_for_where_the_eyes_may_be_shut():
    pose = pose_of()
    asked = []

    def shapes(needed):
        asked.append(needed.tolist())
        return np.stack([shapes_of(0.1)] * len(needed))

    for opening, need in ((0.27, False), (0.15, True), (0.05, True)):
        estimator(opening).estimate_all([mesh_of(pose, towards(0, 0), opening)], [pose], CAMERA, [1.0], shapes)
        assert asked.pop() == [need]


def test_tiny_faces_tell_nothing_of_the_lids_and_count_as_open():
    pose = pose_of(place=(0.0, 0.0, 12.0))
    assert estimator(0.05).estimate(mesh_of(pose, towards(0, 0), 0.05), pose, CAMERA).eyes_closed < OPEN


def run(closedness, rate=30.0):
    filtered = GazeSmoother()
    return [filtered(GazeEstimate(towards(0, 0), 0.9, value), 10.0 + index / rate)
            for index, value in enumerate(closedness)]


def test_gaze_is_withheld_while_the_eyes_are_closed():
    seen = run([0.0] * 10 + [1.0] * 12 + [0.0] * 12)
    assert seen[9].direction is not None
    assert seen[16].direction is None and seen[16].confidence == 0.0 and seen[16].eyes_closed > 0.8
    assert seen[-1].direction is not None and seen[-1].eyes_closed < 0.1


def test_one_doubtful_image_closes_no_eye():
    seen = run([0.0] * 10 + [0.7] + [0.0] * 5)
    assert all(gaze.direction is not None for gaze in seen)


def test_a_closedness_about_one_half_does_not_flicker():
    random = np.random.RandomState(0)
    states = [gaze.direction is None for gaze in run(np.clip(0.5 + 0.1 * random.normal(size=300), 0, 1))]
    assert np.abs(np.diff(np.array(states, int))).sum() <= 2


def test_filter_is_steady_at_rest_and_follows_a_saccade():
    random = np.random.RandomState(1)
    filtered, rest = GazeSmoother(), []
    for index in range(90):
        noisy = towards(*random.normal(0.0, 3.0, 2))
        rest.append(filtered(GazeEstimate(noisy, 0.9, 0.0), index / 30.0).direction)
    assert np.mean([degrees(direction, towards(0, 0)) for direction in rest[15:]]) < 2.5
    for index in range(90, 99):
        last = filtered(GazeEstimate(towards(25, 0), 0.9, 0.0), index / 30.0).direction
    assert degrees(last, towards(25, 0)) < 3.0, "0.3 s after it"


@pytest.mark.parametrize("turn", [(0, 0, 0), (30, -20, 40), (-60, 10, 0)])
@pytest.mark.parametrize("look", [(0, 0), (20, 10), (-35, -25)])
def test_gaze_frame_is_an_optical_one_at_the_face(turn, look):
    face, direction = pose_of(*turn), towards(*look)
    frame = gaze_frame(face, direction)
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    assert frame.rotation.T @ frame.rotation == pytest.approx(np.eye(3), abs=1e-9)
    assert frame.translation == pytest.approx((0, 0, 0))
    assert face.rotation @ frame.rotation[:, 2] == pytest.approx(direction), "z along the gaze"
    assert frame.rotation[2, 1] < 0.0, "y down"


def test_gaze_frame_of_a_look_straight_up():
    face = pose_of()
    frame = gaze_frame(face, face.rotation[:, 2])
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    assert frame.rotation[:, 2] == pytest.approx((0, 0, 1))
