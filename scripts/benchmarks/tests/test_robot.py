"""The covariances on a few people, and where the figures of the robot come from."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from benchmarks import covariance, moving_robot, robot
from hri_person_manager.core.location import Place
from hri_pipeline.core.geometry import Pose


def test_a_truth_within_the_ellipse_counts() -> None:
    place = Place("map", Pose(np.eye(3), np.array([2.0, 0.0, 1.6])), 0.0, covariance=np.diag([0.04, 0.01, 9.0]))
    assert covariance.inside(place, np.array([2.48, 0.0, 0.0]))     # 2.45 standard deviations
    assert not covariance.inside(place, np.array([2.5, 0.0, 1.6]))
    assert not covariance.inside(place, np.array([2.0, 0.25, 1.6]))
    assert not covariance.inside(Place("map", place.pose, 0.0), np.array([2.0, 0.0, 1.6]))


@pytest.mark.slow
def test_the_truth_is_mostly_within() -> None:
    assert 0.88 <= covariance.share(covariance.camera_hits(range(4))) <= 1.0
    # Between two images, or when somebody has just been lost, people walk on.
    assert 0.85 <= covariance.share(covariance.aged_hits(range(8), 0.3)) <= 1.0
    assert 0.88 <= covariance.share(covariance.with_depth(
        lambda: covariance.camera_hits(range(4), covariance.DEPTH_ERROR))) <= 1.0


def test_the_direction_of_a_voice_places_its_speaker() -> None:
    hits = [hit for error in covariance.VOICE_ERRORS for hit in covariance.voice_hits(range(200), error)]
    assert 0.90 <= covariance.share(hits) <= 0.99


def test_every_part_has_its_module():
    assert set(robot.SOURCES) == set(robot.PARTS)
    with_ros = ["web"] if importlib.util.find_spec("rospy") else []
    assert all(robot.source_of(part) for part in ["covariance", "people", "presets", "bridge"] + with_ros)


@pytest.mark.parametrize("name", sorted(moving_robot.MOTIONS))
def test_picture_and_pose_of_the_camera_agree_while_the_robot_moves(name):
    motion = moving_robot.MOTIONS[name]
    view = moving_robot.View(np.zeros((720, 1280, 3), np.uint8))
    start = moving_robot.camera_in_odom(motion.state(0.0))
    pixel = np.array([500.0, 300.0, 1.0])
    place = start.apply((np.linalg.inv(view.camera.matrix) @ pixel * moving_robot.PLANE_M)[None])
    for now in np.arange(0.0, motion.seconds, 0.37):
        state = motion.state(now)
        seen = moving_robot.camera_in_odom(state).inverse().apply(place)[0]
        told = view.homography(state) @ pixel
        if seen[2] > 0.1:
            np.testing.assert_allclose(told[:2] / told[2], view.camera.project(seen[None])[0], atol=1e-6)


def test_who_is_found_only_later_lowers_the_share_and_who_is_aside_the_place() -> None:
    motion = moving_robot.MOTIONS["still"]
    times = np.arange(0.0, motion.seconds, 1.0 / moving_robot.RATE_HZ)
    place = np.array([2.0, 0.0, 1.5])
    late = [moving_robot.Sight(now, "f1", place + (0.0, 0.1 * (now > 9.0), 0.0), now > 10.8) for now in times
            if now < moving_robot.REST_S or now > 7.0]
    figures = moving_robot.judged(late, motion)
    assert figures["people"] == 1 and figures["seen"] == pytest.approx(0.5, abs=0.02)
    assert figures["aside_m"] == pytest.approx(0.1, abs=0.01) and figures["nods"] == 2


def told_of(motion: moving_robot.Motion, jump: float, gone: float) -> dict:
    """What a stack tells of one person who jumps aside by `jump` (m) and is lost from `gone` (s) on."""
    times = [float(at) for at in np.arange(-5.0, motion.seconds, 0.1)]
    return {"places": [(at, "p1", [2.0, jump * (at > 5.0), 1.5]) for at in times if at < gone],
            "tracked": [(at, ["p1"] if at < gone else ["p2"]) for at in times]}


def test_a_stack_that_keeps_people_where_they_are_is_right() -> None:
    motion = moving_robot.MOTIONS["still"]
    assert moving_robot.judged_stack(told_of(motion, 0.0, 99.0), "still") == {
        "people": 1, "kept": 1.0, "others": 0, "error_m": 0.0}


def test_a_stack_that_moves_people_and_calls_them_somebody_else_is_wrong() -> None:
    motion = moving_robot.MOTIONS["still"]
    found = moving_robot.judged_stack(told_of(motion, 0.3, 7.0), "still")
    assert (found["people"], found["others"], found["error_m"]) == (1, 1, 0.3)
    assert found["kept"] == pytest.approx(0.5, abs=0.03)


def test_a_stack_that_saw_nobody_before_keeps_nobody() -> None:
    motion = moving_robot.MOTIONS["still"]
    assert moving_robot.judged_stack(told_of(motion, 0.0, -1.0), "still")["kept"] == 0.0
