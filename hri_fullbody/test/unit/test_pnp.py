import cv2
import numpy as np
import pytest
from synthetic_people import STANDING

from hri_fullbody.core.localization.pnp import body_pose, place, rotation_to_ray, translation_only
from hri_pipeline.core.camera import Calibration, CameraModel

CAMERA = CameraModel.from_fov(1280, 720, 1.05)
BENT = CameraModel(1280, 720, CAMERA.matrix, np.array([-0.25, 0.08, 0.001, -0.001, 0.0]), "plumb_bob",
                   Calibration.CALIBRATED)
ALL = np.ones(33, bool)


def truth(position, turn_deg):
    turn = cv2.Rodrigues(np.array([0.0, np.radians(turn_deg), 0.0]))[0]
    return STANDING @ turn.T + np.asarray(position), STANDING @ turn.T


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["ideal", "distorted"])
@pytest.mark.parametrize("position", [(0.0, 0.1, 2.0), (0.7, 0.0, 3.0), (-1.5, 0.2, 6.0)])
@pytest.mark.parametrize("turn_deg", [0.0, 70.0, 180.0])
def test_exact_landmarks_are_placed_exactly(camera, position, turn_deg):
    points, world = truth(position, turn_deg)
    placed = place(camera.normalise(camera.project(points)), world, ALL)
    assert np.abs(placed - points).max() < 0.02


def test_landmarks_in_the_axes_of_the_ray_are_turned():
    points, world = truth((1.2, 0.0, 2.5), 20.0)
    ray = points[:, :2].mean(axis=0) / points[:, 2].mean()
    placed = place(CAMERA.normalise(CAMERA.project(points)), world @ rotation_to_ray(ray), ALL)
    assert np.linalg.norm(placed.mean(axis=0) - points.mean(axis=0)) < 0.03


def test_noise_and_wrong_points_move_the_body_little():
    random = np.random.default_rng(3)
    for _ in range(20):
        points, world = truth((0.4, 0.0, 3.0), random.uniform(-60.0, 60.0))
        pixels = CAMERA.project(points) + random.normal(size=(33, 2)) * 2.0
        pixels[[15, 17, 19]] += (150.0, -90.0)
        placed = place(CAMERA.normalise(pixels), world + random.normal(size=(33, 3)) * 0.03, ALL)
        hips, true_hips = placed[23:25].mean(axis=0), points[23:25].mean(axis=0)
        assert np.linalg.norm(hips - true_hips) < 0.45
        assert np.linalg.norm((hips - true_hips)[:2]) < 0.12


def test_too_few_points_and_impossible_depths_give_nothing():
    points, world = truth((0.0, 0.0, 3.0), 0.0)
    rays = CAMERA.normalise(CAMERA.project(points))
    few = np.zeros(33, bool)
    few[:5] = True
    assert place(rays, world, few) is None
    assert place(rays * 1e-3, world, ALL) is None
    assert place(np.full((33, 2), np.nan), world, ALL) is None


def test_translation_only_finds_the_translation():
    points, world = truth((0.3, -0.2, 4.0), 30.0)
    assert translation_only(points[:, :2] / points[:, 2:], world) == pytest.approx([0.3, -0.2, 4.0], abs=1e-6)


def test_body_frame_looks_forward_with_z_to_the_head():
    points, _ = truth((0.5, 0.3, 3.0), 0.0)
    pose = body_pose(points)
    assert pose.translation == pytest.approx([0.5, 0.3, 3.0])
    # In the optical frame a person who faces the camera looks along -z, has the head at -y and the left at +x.
    assert pose.rotation == pytest.approx(np.array([[0, 1, 0], [0, 0, -1], [-1, 0, 0]]), abs=0.02)
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    assert body_pose(np.zeros((33, 3))) is None
