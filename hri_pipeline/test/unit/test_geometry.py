"""Rigid transforms, overlap of boxes, rotated crops."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_pipeline.core.geometry import Pose, crop_rotated, iou_matrix, lowest_highest


def random_pose(seed):
    generator = np.random.default_rng(seed)
    return Pose(Rotation.random(random_state=seed).as_matrix(), generator.normal(size=3))


def test_compose_is_first_other_then_self():
    a, b = random_pose(1), random_pose(2)
    points = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(a.compose(b).apply(points), a.apply(b.apply(points)), atol=1e-12)


def test_inverse():
    a = random_pose(3)
    unit = a.compose(a.inverse())
    np.testing.assert_allclose(unit.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(unit.translation, 0.0, atol=1e-12)


def test_moved():
    a, way = random_pose(3), np.array([1.0, -2.0, 3.0])
    points = np.random.default_rng(0).normal(size=(5, 3))
    before = a.translation.copy()
    np.testing.assert_allclose(a.moved(way).apply(points), a.apply(points) + way, atol=1e-12)
    assert (a.translation == before).all()


def test_quaternion_round_trip_and_normalisation():
    a = random_pose(4)
    b = Pose.from_quaternion(3.0 * np.array(a.quaternion), a.translation)
    np.testing.assert_allclose(b.rotation, a.rotation, atol=1e-12)
    assert Pose.identity().quaternion == (0.0, 0.0, 0.0, 1.0)


def test_quaternions_are_those_of_scipy_also_at_half_turns():
    turns = list(Rotation.random(200, random_state=3)) + [
        Rotation.from_rotvec(np.pi * np.array(axis)) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.6, 0.8))]
    for turn in turns:
        pose = Pose.from_quaternion(turn.as_quat(), (0.0, 0.0, 0.0))
        np.testing.assert_allclose(pose.rotation, turn.as_matrix(), atol=1e-12)
        assert abs(np.dot(pose.quaternion, turn.as_quat())) == pytest.approx(1.0)


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (np.nan, 0, 0, 1), (np.inf, 0, 0, 1), (0, 0, 1)])
def test_bad_quaternion(quaternion):
    with pytest.raises(ValueError, match="quaternion"):
        Pose.from_quaternion(quaternion, (0, 0, 0))


@pytest.mark.parametrize("rotation, translation", [(np.eye(4), np.zeros(3)), (np.eye(3), np.zeros(2))])
def test_bad_shape(rotation, translation):
    with pytest.raises(ValueError, match="pose"):
        Pose(rotation, translation)


def test_iou():
    a = np.array([[0, 0, 10, 10], [20, 20, 20, 30]])
    b = np.array([[0, 0, 10, 10], [5, 0, 15, 10], [30, 30, 40, 40], [20, 20, 20, 30]])
    np.testing.assert_allclose(iou_matrix(a, b), [[1, 1 / 3, 0, 0], [0, 0, 0, 0]])
    assert iou_matrix(np.zeros((0, 4)), b).shape == (0, 4)


def test_crop_without_turn_is_a_slice():
    image = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    patch, affine = crop_rotated(image, (40, 30), 20, 0.0, 20)
    np.testing.assert_array_equal(patch, image[20:40, 30:50])
    np.testing.assert_allclose(affine, [[1, 0, 30], [0, 1, 20]])


def test_crop_turned_by_a_right_angle():
    image = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    patch, affine = crop_rotated(image, (40, 30), 20, np.pi / 2, 20)
    # The patch's x axis goes down in the image.
    np.testing.assert_array_equal(patch, np.rot90(image[20:40, 30:50], 1))
    np.testing.assert_allclose(affine @ [0, 0, 1], [50, 20], atol=1e-9)
    np.testing.assert_allclose(affine @ [20, 0, 1], [50, 40], atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 0.4, -2.0])
def test_crop_maps_its_centre_to_the_centre(angle):
    image = np.zeros((50, 50, 3), np.uint8)
    _, affine = crop_rotated(image, (12.5, 33.0), 17.0, angle, 64)
    np.testing.assert_allclose(affine @ [32, 32, 1], [12.5, 33.0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(affine[:, 0]), 17.0 / 64)


def test_crop_outside_repeats_the_border():
    image = np.full((20, 20, 3), 7, np.uint8)
    patch, _ = crop_rotated(image, (0, 0), 40, 0.3, 32)
    assert (patch == 7).all()


@pytest.mark.parametrize("centre, size, angle, output", [
    ((np.nan, 0), 10, 0, 8), ((0, 0), 0, 0, 8), ((0, 0), -1, 0, 8), ((0, 0), 10, np.inf, 8), ((0, 0), 10, 0, 0)])
def test_bad_crop(centre, size, angle, output):
    with pytest.raises(ValueError, match="cannot crop"):
        crop_rotated(np.zeros((5, 5, 3), np.uint8), centre, size, angle, output)


def test_lowest_and_highest_of_each_axis():
    points = np.array([[3.0, -1.0], [2.0, 5.0], [7.0, 0.0]])
    np.testing.assert_array_equal(lowest_highest(points), [[2.0, -1.0], [7.0, 5.0]])
    points[1, 0] = np.nan
    low, high = lowest_highest(points)
    assert np.isnan([low[0], high[0]]).all() and (low[1], high[1]) == (-1.0, 5.0)
    np.testing.assert_array_equal(points[:, 1], [-1.0, 5.0, 0.0])
