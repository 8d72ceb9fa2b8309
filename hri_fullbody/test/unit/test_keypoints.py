import numpy as np
import pytest

from hri_fullbody.core import keypoints as skeleton

# BlazePose's own numbers, left and right being the subject's.
BLAZE = {
    "nose": 0, "left_eye": 2, "right_eye": 5, "left_ear": 7, "right_ear": 8,
    "left_shoulder": 11, "right_shoulder": 12, "left_elbow": 13, "right_elbow": 14, "left_wrist": 15,
    "right_wrist": 16, "left_hip": 23, "right_hip": 24, "left_knee": 25, "right_knee": 26,
    "left_ankle": 27, "right_ankle": 28,
}
# Constants of hri_msgs/Skeleton2D.
ORDER = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle",
    "left_eye", "right_eye", "left_ear", "right_ear")


def test_order_is_that_of_the_message():
    assert [getattr(skeleton, name.upper()) for name in ORDER] == list(range(18))


@pytest.mark.parametrize("name", [name for name in ORDER if name != "neck"])
def test_each_point_has_its_own_landmark(name):
    landmarks = np.arange(39.0)[:, None] * np.ones(3)
    assert skeleton.to_18_points(landmarks)[ORDER.index(name)] == pytest.approx([BLAZE[name]] * 3)


def test_neck_is_between_the_shoulders_and_as_sure_as_the_less_sure():
    landmarks = np.zeros((33, 2))
    landmarks[11], landmarks[12] = (4.0, 0.0), (0.0, 2.0)
    confidence = np.ones(33)
    confidence[12] = 0.2
    assert skeleton.to_18_points(landmarks)[1] == pytest.approx([2.0, 1.0])
    assert skeleton.confidence_18(confidence)[1] == pytest.approx(0.2)


def test_too_few_landmarks_are_refused():
    with pytest.raises(ValueError, match="33"):
        skeleton.to_18_points(np.zeros((17, 2)))


def test_edges_join_known_points_and_never_left_with_right_limbs():
    for a, b in skeleton.EDGES:
        sides = {ORDER[a].split("_")[0], ORDER[b].split("_")[0]} & {"left", "right"}
        assert len(sides) < 2 or {ORDER[a], ORDER[b]} == {"left_hip", "right_hip"}


def test_the_trunk_in_the_image_has_the_scale_of_head_and_shoulders():
    world = np.random.default_rng(1).normal(0.0, 0.1, (33, 3))
    world[[11, 12]], world[[23, 24]] = ((0.2, -0.5, 0.0), (-0.2, -0.5, 0.0)), ((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0))
    landmarks = np.column_stack([300.0 * world[:, :2] + (640.0, 360.0), 300.0 * world[:, 2]])
    assert skeleton.trunk_in_image(landmarks, world) == pytest.approx(0.5)
    landmarks[[23, 24], 1] += 30.0
    assert skeleton.trunk_in_image(landmarks, world) == pytest.approx(0.6)
    world[[11, 12], 2] += 0.45 + world[[23, 24], 2].mean() - world[[11, 12], 2].mean()
    assert skeleton.trunk_in_image(landmarks, world) == pytest.approx(0.75)


@pytest.mark.parametrize("pixels", [np.zeros((33, 2)), np.full((33, 2), 7.0)])
def test_head_and_shoulders_in_one_point_give_the_trunk_no_length(pixels):
    assert np.isnan(skeleton.trunk_in_image(pixels, np.random.default_rng(1).normal(0.0, 0.1, (33, 3))))


def with_knees(right, left):
    """Landmarks px at 300 px a metre, hips at y = 360, trunks of 150 px, and world m, of knees below each hip (m)."""
    world = np.zeros((33, 3))
    world[[11, 12]], world[[23, 24]] = ((0.2, -0.5, 0.0), (-0.2, -0.5, 0.0)), ((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0))
    world[25], world[26] = world[23] + left, world[24] + right
    return np.column_stack([300.0 * world[:, :2] + (640.0, 360.0), 300.0 * world[:, 2]]), world


@pytest.mark.parametrize("right, left, height, leave", [
    ((0.0, 0.4, 0.1), (0.0, 0.4, 0.0), 430, True), ((0.0, 0.4, 0.1), (0.0, 0.4, 0.0), 475, True),
    ((0.0, 0.4, 0.1), (0.0, 0.4, 0.0), 400, False), ((0.0, 0.4, 0.1), (0.0, 0.4, 0.0), 600, False),
    ((0.0, 0.8, 0.1), (0.0, 0.8, 0.0), 430, False), ((0.0, 0.4, -0.4), (0.0, 0.4, 0.0), 430, False),
    ((0.0, 0.4, 0.0), (0.4, 0.3, 0.0), 430, False)],
    ids=["seen for half", "nearly whole", "little is seen", "whole", "a third", "one towards the camera", "one aside"])
def test_thighs_that_hang_out_of_the_image(right, left, height, leave):
    assert skeleton.thighs_leave_image(*with_knees(right, left), height) == leave


def test_thighs_of_who_is_bent_forward_do_not_hang():
    landmarks, world = with_knees((0.0, 0.4, 0.0), (0.0, 0.4, 0.0))
    world[[11, 12]] = (0.2, 0.0, -0.5), (-0.2, 0.0, -0.5)
    assert not skeleton.thighs_leave_image(landmarks, world, 430)
