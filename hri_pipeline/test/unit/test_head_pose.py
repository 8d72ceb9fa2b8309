"""Head pose on projections of a known head; the face frame; the smoother; the size of the head from several sources."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_pipeline.core.camera import Calibration, CameraModel
from hri_pipeline.core.faces.face_geometry import FaceGeometry, TrackedFace
from hri_pipeline.core.faces.head_pose import (
    PRIOR_SD,
    HeadPoseEstimator,
    HeadScale,
    PoseSmoother,
    scale_from_depth,
    yaw_pitch_roll,
)
from hri_pipeline.core.faces.mesh import PITCH_BIAS, SELLION, CanonicalFace, load_canonical_face
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.onnx import ModelError

PLAIN = CameraModel.from_fov(1280, 720, 1.0)
WIDE = CameraModel.from_fov(1280, 720, 2.0)
LENS = CameraModel(1280, 720, np.array([[900.0, 0, 630], [0, 910.0, 350], [0, 0, 1]]),
                   np.array([-0.28, 0.09, 0.001, -0.0005, -0.01]), "plumb_bob", Calibration.CALIBRATED)
FISHEYE = CameraModel(1280, 720, np.array([[500.0, 0, 640], [0, 500.0, 360], [0, 0, 1]]),
                      np.array([-0.02, 0.004, -0.001, 0.0002]), "equidistant", Calibration.CALIBRATED)


def made_up_face():
    """A front half of an ellipsoid in place of the model file; the frame and the solver do not mind."""
    random = np.random.RandomState(7)
    azimuth, height = random.uniform(-1.4, 1.4, 468), random.uniform(-0.09, 0.09, 468)
    radius = 0.075 * np.sqrt(1.0 - (height / 0.13) ** 2)
    vertices = np.stack([radius * np.sin(azimuth), height, -radius * np.cos(azimuth)], axis=1)
    return CanonicalFace(vertices, np.arange(0, 330, 10))


FACE = made_up_face()


def looking(yaw, pitch, roll, place):
    """Pose of a face frame, angles in degrees as `yaw_pitch_roll` gives them, for a face near the optical axis."""
    upright = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    turn = Rotation.from_euler("zyx", [roll, -yaw, -pitch], degrees=True).as_matrix()
    return Pose(turn @ upright, np.array(place))


def seen(pose, camera):
    """Mesh (478, 3) px of a head whose face frame has this pose."""
    model = pose.compose(FACE.face_frame().inverse())
    mesh = np.zeros((478, 3))
    mesh[:468, :2] = camera.project(model.apply(FACE.vertices))
    return mesh


def degrees_between(a, b):
    return np.degrees(Rotation.from_matrix(a.rotation.T @ b.rotation).magnitude())


@pytest.mark.parametrize("camera", [PLAIN, LENS, FISHEYE], ids=["plain", "lens", "fisheye"])
@pytest.mark.parametrize("angles", [(0, 0, 0), (30, 0, 0), (-45, 10, 0), (0, -25, 20), (10, 20, -40)])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.6), (0.5, -0.25, 1.5), (-1.5, 0.6, 4.0)])
def test_pose_of_a_known_head(camera, angles, place):
    truth = looking(*angles, place)
    found = HeadPoseEstimator(FACE).estimate(seen(truth, camera), camera)
    assert degrees_between(found, truth) < 0.5
    assert np.linalg.norm(found.translation - truth.translation) < 0.005 * np.linalg.norm(place)


@pytest.mark.parametrize("camera", [replace(WIDE, calibration=Calibration.CALIBRATED), FISHEYE],
                         ids=["wide", "fisheye"])
@pytest.mark.parametrize("aside", [(0, 40), (25, -30)])
def test_another_face_than_the_mean_one_has_the_same_pose_wherever_in_the_image_it_is(camera, aside):
    turn = Rotation.from_euler("xy", aside, degrees=True).as_matrix()
    ahead = looking(15, -5, 10, (0.0, 0.0, 0.6))
    own = FACE.vertices + np.random.RandomState(1).normal(0.0, 0.004, FACE.vertices.shape)
    places, mesh = ahead.compose(FACE.face_frame().inverse()).apply(own), np.zeros((478, 3))
    mesh[:468, :2] = camera.project(places)
    wanted = HeadPoseEstimator(FACE).estimate(mesh, camera)
    wanted = Pose(turn @ wanted.rotation, turn @ wanted.translation)
    mesh[:468, :2] = camera.project(places @ turn.T)
    estimator = HeadPoseEstimator(FACE)
    for found in estimator.estimate(mesh, camera), estimator.estimate_all([mesh], camera, [wanted])[0]:
        assert degrees_between(found, wanted) < 0.1
        assert found.translation == pytest.approx(wanted.translation, abs=0.001)


def test_angles_of_a_face_that_looks_into_the_camera_are_zero():
    assert yaw_pitch_roll(looking(0, 0, 0, (0, 0, 1))) == pytest.approx((0, 0, 0))


@pytest.mark.parametrize("angles", [(20, 0, 0), (0, 15, 0), (0, 0, 30)])
def test_angles_come_back(angles):
    assert np.degrees(yaw_pitch_roll(looking(*angles, (0, 0, 1)))) == pytest.approx(angles, abs=1e-6)


def test_axes_of_a_face_that_looks_into_the_camera():
    pose = looking(0, 0, 0, (0, 0, 1))
    assert pose.rotation[:, 0] == pytest.approx((0, 0, -1)), "x out of the face, towards the camera"
    assert pose.rotation[:, 1] == pytest.approx((1, 0, 0)), "y to the subject's left, the right of the image"
    assert pose.rotation[:, 2] == pytest.approx((0, -1, 0)), "z to the scalp"


def test_face_frame_is_right_handed_at_the_sellion_and_raised_by_the_bias():
    frame = FACE.face_frame()
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    assert frame.translation == pytest.approx(FACE.vertices[SELLION])
    forward = frame.rotation[:, 0]
    assert np.arctan2(-forward[1], -forward[2]) == pytest.approx(PITCH_BIAS)


def test_scattered_points_are_no_head():
    mesh = np.random.RandomState(1).uniform(0, 700, (478, 3))
    assert HeadPoseEstimator(FACE).estimate(mesh, PLAIN) is None


def test_points_that_are_not_finite_or_all_the_same_are_no_head():
    estimator = HeadPoseEstimator(FACE)
    assert estimator.estimate(np.full((478, 3), np.nan), PLAIN) is None
    assert estimator.estimate(np.full((478, 3), 300.0), PLAIN) is None


@pytest.mark.parametrize("distance", [0.02, 60.0])
def test_a_head_out_of_range_is_refused(distance):
    mesh = seen(looking(0, 0, 0, (0, 0, 1.0)), PLAIN)
    mesh[:, :2] = (mesh[:, :2] - (640, 360)) / distance + (640, 360)
    assert HeadPoseEstimator(FACE).estimate(mesh, PLAIN) is None


def test_far_side_of_a_turned_head_is_less_visible():
    estimator = HeadPoseEstimator(FACE)
    # The landmarks' normals come from real vertices: here only their range and the unknown pose can be told.
    visibility = estimator.visibility(looking(60, 0, 0, (0, 0, 1)))
    assert visibility.shape == (70,)
    assert 0.1 <= visibility.min() < 0.5 < visibility.max() <= 1.0
    assert (estimator.visibility(None) == 1.0).all()


def test_smoother_is_steady_at_rest_and_quick_in_motion():
    random = np.random.RandomState(0)
    smoother, rest = PoseSmoother(), []
    for index in range(100):
        noisy = looking(*random.normal(0, 1.0, 3), random.normal(0, 0.005, 3) + (0, 0, 1))
        rest.append(smoother(noisy, index / 15.0).translation[2])
    assert np.std(rest[10:]) < 0.004
    moving = PoseSmoother()
    for index in range(30):
        truth = looking(3.0 * index - 45, 0, 0, (0.04 * index, 0, 1))
        found = moving(truth, index / 15.0)
    assert abs(found.translation[0] - truth.translation[0]) < 0.012, "20 ms at 0.6 m/s"
    assert degrees_between(found, truth) < 2.0, "45 ms at 45 degrees/s"


def test_smoother_takes_both_signs_of_a_quaternion():
    smoother = PoseSmoother()
    for index, yaw in enumerate(np.linspace(-179, 179, 200)):
        truth = looking(yaw, 0, 0, (0, 0, 1))
        found = smoother(truth, index / 15.0)
        assert degrees_between(found, truth) < 5.0
        assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def save(path, **arrays):
    np.savez(str(path), **arrays)
    return path


def test_model_file_is_read_into_optical_axes(tmp_path):
    vertices = FACE.vertices * (1, -1, -1)
    path = save(tmp_path / "face.npz", vertices=vertices, procrustes_index=FACE.rigid)
    assert load_canonical_face(path).vertices == pytest.approx(FACE.vertices)


@pytest.mark.parametrize("arrays", [
    {},
    {"vertices": FACE.vertices},
    {"vertices": FACE.vertices[:400], "procrustes_index": FACE.rigid},
    {"vertices": FACE.vertices * 100.0, "procrustes_index": FACE.rigid},
    {"vertices": FACE.vertices * np.nan, "procrustes_index": FACE.rigid},
    {"vertices": FACE.vertices, "procrustes_index": FACE.rigid + 400},
])
def test_another_model_file_is_refused_by_name(tmp_path, arrays):
    path = save(tmp_path / "odd_face.npz", **arrays)
    with pytest.raises(ModelError, match="odd_face.npz"):
        load_canonical_face(path)


def test_a_text_file_is_no_model(tmp_path):
    path = tmp_path / "text.npz"
    path.write_text("no model")
    with pytest.raises(ModelError, match="text.npz"):
        load_canonical_face(path)


def settled(scale, stamp=100.0):
    scale.estimate(stamp)
    for step in range(1, 40):
        found = scale.estimate(stamp + 0.5 * step)
    return found


def test_nothing_known_is_the_prior():
    assert settled(HeadScale()) == pytest.approx((1.0, PRIOR_SD))


def test_a_depth_image_decides_and_an_iris_helps():
    iris, depth = HeadScale(), HeadScale()
    for _ in range(50):
        iris.add("iris", 0.9)
        depth.add("depth", 0.9)
    by_iris, by_depth = settled(iris), settled(depth)
    assert 0.92 < by_iris[0] < 0.97 and 0.03 < by_iris[1] < PRIOR_SD
    assert by_depth[0] == pytest.approx(0.9, abs=0.01) and by_depth[1] < 0.02


def test_an_error_that_stays_with_the_person_does_not_average_out():
    scale = HeadScale()
    for _ in range(100000):
        scale.add("iris", 1.1)
    assert settled(scale)[1] > 0.03


def test_over_many_people_the_stated_error_is_the_true_one():
    random = np.random.RandomState(4)
    errors = []
    for _ in range(300):
        truth = np.exp(random.normal(0.0, PRIOR_SD))
        person = np.exp(random.normal(0.0, 0.05))
        scale = HeadScale()
        for _ in range(30):
            scale.add("iris", truth * person * np.exp(random.normal(0.0, 0.05)))
        found, sd = settled(scale)
        errors.append((found - truth) / sd)
    assert 0.85 < np.std(errors) < 1.15
    assert abs(np.mean(errors)) < 0.15


def test_a_size_does_not_jump():
    scale = HeadScale()
    scale.estimate(0.0)
    for _ in range(50):
        scale.add("depth", 0.85)
    assert scale.estimate(0.05)[0] > 0.98
    assert scale.estimate(5.0)[0] < 0.87


def test_a_person_that_was_taken_for_another_is_corrected_in_time():
    scale = HeadScale()
    for _ in range(500):
        scale.add("depth", 0.9)
    for _ in range(300):
        scale.add("depth", 1.1)
    assert settled(scale)[0] == pytest.approx(1.1, abs=0.02)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, -1.0, 0.3, 3.0])
def test_nonsense_is_ignored(value):
    scale = HeadScale()
    scale.add("depth", value)
    assert settled(scale) == pytest.approx((1.0, PRIOR_SD))


def test_an_unknown_source_is_an_error_of_the_program():
    with pytest.raises(KeyError):
        HeadScale().add("horoscope", 1.0)


def depth_case(depth, size=(100, 80)):
    mesh = np.zeros((478, 3))
    mesh[:20, 0], mesh[:20, 1] = np.arange(20) * 3 + 10, 40
    return scale_from_depth(mesh, np.full(20, 2.0), np.arange(20), depth, size)


def test_depth_image_is_read_robustly():
    depth = np.full((80, 100), 1.8, np.float32)
    assert depth_case(depth) == pytest.approx(0.9)
    depth[40, 10:30] = 6.0
    assert depth_case(depth) == pytest.approx(0.9), "a third of the points on the background"
    depth[40] = np.nan
    assert depth_case(depth) is None
    assert depth_case(np.zeros((80, 100), np.float32)) is None
    assert depth_case(np.full((20, 12), 1.8, np.float32), (12, 20)) is None, "the face lies outside the depth image"
    small = np.full((20, 25), 6.0, np.float32)
    small[10, 2:17] = 1.8
    assert depth_case(small) == pytest.approx(0.9), "a quarter of the size of the colour image"


class NoBlendshapes:
    """In place of the network."""

    def run(self, meshes, camera=None):
        return np.zeros((len(meshes), 52))


@pytest.mark.parametrize("camera", [PLAIN, LENS, FISHEYE], ids=["plain", "lens", "fisheye"])
def test_a_face_that_was_not_measured_moves_as_far_as_its_picture_tells(camera):
    aside = np.array([0.45 if camera is PLAIN else 0.6 if camera is LENS else 1.0, 0.1, 1.0])
    geometry = FaceGeometry(FACE, NoBlendshapes())
    before, after = (seen(looking(0, 0, 0, place), camera) for place in (aside, aside + (0.06, 0.0, 0.0)))
    found = [TrackedFace("a", before, np.zeros(4), 1.0, True, True)]
    pose = geometry.observe(found, camera, 0.0)[0].pose
    moved = before + (after - before)[0]
    last = geometry.observe([TrackedFace("a", moved, np.zeros(4), 1.0, False, True)], camera, 0.1)[0].pose
    assert last.translation - pose.translation == pytest.approx([0.06, 0.0, 0.0], abs=0.004)


@pytest.mark.parametrize("measured", [False, True])
def test_faces_whose_places_are_forgotten_are_where_they_are_measured_next(measured):
    geometry, place = FaceGeometry(FACE, NoBlendshapes()), np.array([0.1, 0.1, 1.0])
    for index in range(20):
        geometry.observe([TrackedFace("a", seen(looking(0, 0, 0, place), PLAIN), np.zeros(4), 1.0, True, True)], PLAIN,
                         0.1 * index)
    geometry.forget_places()
    mesh = seen(looking(0, 0, 0, place if not measured else 2.0 * place), PLAIN)
    pose = geometry.observe([TrackedFace("a", mesh, np.zeros(4), 1.0, measured, True)], PLAIN, 2.0)[0].pose
    assert np.linalg.norm(pose.translation) == pytest.approx((2.0 if measured else 1.0) * np.linalg.norm(place),
                                                             rel=0.03)
