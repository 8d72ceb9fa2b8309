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


STANDING = np.zeros((18, 2))
STANDING[[skeleton.LEFT_HIP, skeleton.RIGHT_HIP], 1] = 100.0
STANDING[[skeleton.LEFT_KNEE, skeleton.RIGHT_KNEE], 1] = 180.0


def reliability_of(looks, times):
    """Reliability after looks (N, 18, 2) px, of a body whose trunk is 100 px long, at `times` (N,) s."""
    jitter = skeleton.Jitter()
    for points, stamp in zip(looks, times):
        jitter.update(points, 400.0, stamp)
    return jitter.reliability


def trembling(deviation, rate, count=40):
    """Looks of somebody who stands still, with independent errors of `deviation` px along each axis."""
    errors = np.random.default_rng(1).normal(0.0, deviation, (count, 18, 2))
    return reliability_of(STANDING + errors, 100.0 + np.arange(count) / rate)


def test_the_more_a_body_trembles_the_seldomer_its_key_points_are_right():
    shares = [trembling(deviation, 10.0) for deviation in (0.0, 1.0, 5.0, 15.0, 40.0)]
    assert shares[0].min() > 0.98 and shares[1].min() > 0.97
    assert (np.diff(shares, axis=0) < 0.0).all()
    assert shares[3][skeleton.NOSE] > shares[3][skeleton.LEFT_KNEE] > shares[3][skeleton.LEFT_WRIST]
    assert shares[4].max() < 0.4


def test_jitter_does_not_hang_on_the_size_in_the_image_nor_on_the_rate():
    times = 100.0 + np.arange(60) / 10.0
    errors = np.random.default_rng(2).normal(0.0, 10.0, (60, 18, 2))
    uneven = times + np.where(np.arange(60) % 2, 0.03, 0.0)
    usual = reliability_of(STANDING + errors, times)
    assert reliability_of(3.0 * (STANDING + errors), times) == pytest.approx(usual, abs=0.01)
    assert reliability_of(STANDING + errors, uneven) == pytest.approx(usual, abs=0.05)


@pytest.mark.parametrize("rate", [4.0, 10.0, 30.0])
def test_who_walks_or_nods_is_as_reliable_as_who_stands(rate):
    times = 100.0 + np.arange(60) / rate
    uneven = times + np.where(np.arange(60) % 3, 0.0, 0.3 / rate)
    for stamps in (times, uneven):
        walking = STANDING + np.stack([280.0 * stamps, 15.0 * np.sin(5.0 * stamps)], axis=1)[:, None]
        assert reliability_of(walking, stamps).min() > 0.98
    waving = np.tile(STANDING, (60, 1, 1))
    waving[:, skeleton.LEFT_WRIST, 0] += 60.0 * np.sin(10.0 * times)
    assert reliability_of(waving, times).min() > 0.98


@pytest.mark.parametrize("deviation, least, most", [(0.0, 0.98, 1.0), (30.0, 0.05, 0.6)])
def test_while_the_camera_shakes_only_what_key_points_do_against_each_other_counts(deviation, least, most):
    random, jitter = np.random.default_rng(6), skeleton.Jitter()
    for index in range(40):
        points = STANDING + random.normal(0.0, 40.0, 2) + random.normal(0.0, deviation, (18, 2))
        jitter.update(points, 400.0, 0.1 * index, index > 0)
    assert least <= jitter.reliability.min() <= jitter.reliability[skeleton.NOSE] <= most


def test_looks_far_apart_and_stamps_that_go_back_are_not_compared():
    away = STANDING + 300.0
    assert reliability_of([STANDING, away, STANDING, away], [0.0, 0.6, 1.2, 1.8]).min() == 1.0
    assert reliability_of([STANDING, away, STANDING, away], [5.0, 5.0, 4.0, 4.0]).min() == 1.0
    jitter = skeleton.Jitter()
    assert jitter.reliability == pytest.approx(np.ones(18))
    for index in range(4):
        jitter.update(STANDING + 300.0 * (index % 2), 400.0, 0.1 * index)
        jitter.reset()
    assert jitter.reliability == pytest.approx(np.ones(18))


def test_a_trunk_without_length_in_the_image_gives_no_endless_jitter():
    bent = np.zeros((18, 2))
    assert 0.0 < reliability_of([bent, bent + 1.0, bent, bent + 1.0], [0.0, 0.1, 0.2, 0.3]).min() < 1.0
    assert np.isfinite(reliability_of([bent, bent + 1e5, bent], [0.0, 1e-9, 0.3])).all()
