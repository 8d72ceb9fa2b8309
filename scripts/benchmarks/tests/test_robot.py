"""The covariances on a few people, and where the figures of the robot come from."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from benchmarks import covariance, robot
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
    assert 0.88 <= covariance.share(covariance.with_depth(
        lambda: covariance.camera_hits(range(4), covariance.DEPTH_ERROR))) <= 1.0


def test_the_direction_of_a_voice_places_its_speaker() -> None:
    hits = [hit for error in covariance.VOICE_ERRORS for hit in covariance.voice_hits(range(200), error)]
    assert 0.90 <= covariance.share(hits) <= 0.99


def test_every_part_has_its_module():
    assert set(robot.SOURCES) == set(robot.PARTS)
    with_ros = ["web"] if importlib.util.find_spec("rospy") else []
    assert all(robot.source_of(part) for part in ["covariance", "people", "presets", "bridge"] + with_ros)
