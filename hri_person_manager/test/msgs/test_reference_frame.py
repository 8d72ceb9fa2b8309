"""Which sensors are told to lack a transform to the reference frame, and for how long."""

import logging
from unittest.mock import MagicMock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hri_person_manager.core.features import FeaturePose, PlaceSource
from hri_person_manager.core.location import Place
from hri_person_manager.core.parameters import PERSON_MANAGER_PARAMETERS
from hri_person_manager.ros import inputs, topics
from hri_person_manager.ros.inputs import ReferenceFrame
from hri_pipeline.core.geometry import Pose

HERE = Pose.identity()
UPRIGHT = Pose(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]), np.array([0.0, 0.5, 2.0]))
"""A face before a camera in its optical frame, which looks into it."""
LEVEL = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
"""The optical frame of a camera in a level one."""


class Clock:
    """A clock that stands still until it is set."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now


class Sensors:
    """Leads from the frames that are connected to the reference frame."""

    def __init__(self, *connected):
        self.connected = connected

    def moves_until(self, sensor):
        """Tell that none is."""
        return None

    def lookup(self, sensor, stamp):
        return HERE if sensor in self.connected else None


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(inputs, "time", clock)
    return clock


def place(reference, sensor, secs):
    return reference.place(FeaturePose(PlaceSource.FACE, "f1", sensor, HERE, secs, 0)).frame


def test_each_sensor_is_told_once_and_only_while_something_comes_of_it(clock, caplog):
    reference = ReferenceFrame("map", Sensors("good"))
    with caplog.at_level(logging.WARNING, "rosout"):
        for second in range(8):
            clock.now += 1.0
            assert place(reference, "good", second) == "map"
            assert place(reference, "left", second) == "left"
            if second > 3:
                assert place(reference, "right", second) == "right"
    assert reference.unconnected == {"left", "right"}
    told = [record.getMessage() for record in caplog.records]
    assert ["leads from left" in text for text in told] == [True, False]
    assert "leads from right" in told[1] and "/humans/reference_frame" in told[1]
    clock.now += 11.0
    assert place(reference, "good", 100) == "map"
    assert reference.unconnected == set()


def see(reference, pose, source=PlaceSource.FACE, sensor="usb_cam", images=10):
    """The last of the places of a face in so many images."""
    return [reference.place(FeaturePose(source, "f1", sensor, pose, image, 0)) for image in range(images)][-1]


def test_a_reference_frame_that_is_a_cameras_is_told_and_distances_are_right_all_the_same(caplog):
    with caplog.at_level(logging.WARNING, "rosout"):
        reference = ReferenceFrame("usb_cam", Sensors("usb_cam"))
        assert not see(reference, UPRIGHT, PlaceSource.VOICE).is_optical, "a voice tells nothing of it"
        assert not see(reference, UPRIGHT, images=1).is_optical
        place = see(reference, UPRIGHT)
        assert place.is_optical and place.horizontal == (0.0, 2.0)
        see(reference, UPRIGHT)
    assert reference.problem and "map, odom or base_link" in reference.problem
    assert [record.getMessage() for record in caplog.records] == [reference.problem], "once"
    reference = ReferenceFrame("camera_optical_frame", Sensors("camera_optical_frame"))
    assert see(reference, UPRIGHT, sensor="camera_optical_frame").is_optical and not reference.problem, "it says so"


def test_the_remedy_where_the_turn_to_the_optical_frame_was_forgotten_is_the_turn():
    """To set the reference frame to map would be none: it is."""
    reference = ReferenceFrame("map", Sensors("usb_cam"))
    see(reference, UPRIGHT)
    assert "the transform to usb_cam" in reference.problem
    yaw, pitch, roll = (float(word) for word in reference.problem.split("X Y Z ")[1].split(";")[0].split())
    assert Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix() == pytest.approx(LEVEL.rotation, abs=1e-4)
    reference = ReferenceFrame("usb_cam", Sensors("usb_cam"))
    see(reference, UPRIGHT)
    assert "X Y Z" not in reference.problem and ": set /humans/reference_frame to a level frame" in reference.problem


def test_a_level_reference_frame_is_none_of_a_camera():
    reference = ReferenceFrame("map", MagicMock(lookup=lambda sensor, stamp: LEVEL, moves_until=lambda sensor: None))
    assert not see(reference, UPRIGHT).is_optical and not reference.problem
    lying = Pose(np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.0, 0.0, 2.0]))
    assert LEVEL.compose(lying).rotation[1, 2] == -1.0
    assert not see(reference, lying).is_optical and not reference.problem, "somebody who lies along -y"
    # Another package tells faces in the map itself, z up.
    reference = ReferenceFrame("map", Sensors("map"))
    assert not see(reference, LEVEL.compose(UPRIGHT), sensor="map").is_optical and not reference.problem


@pytest.mark.parametrize("elevation", [50.0, 60.0, 65.0])
def test_a_small_robot_that_looks_up_to_who_bends_over_it_keeps_its_level_reference_frame(elevation):
    """Along y of the map, it has nearly the axes of the map, and heads before it point along -y."""
    sine, cosine = np.sin(np.radians(elevation)), np.cos(np.radians(elevation))
    up = Pose(np.array([[1.0, 0.0, 0.0], [0.0, sine, cosine], [0.0, -cosine, sine]]), np.array([3.0, 1.0, 0.2]))
    assert up.rotation[2, 2] == pytest.approx(sine)
    reference = ReferenceFrame("map", MagicMock(lookup=lambda sensor, stamp: up, moves_until=lambda sensor: None))
    assert not see(reference, UPRIGHT, sensor="camera_optical").is_optical and not reference.problem


def test_without_a_way_to_the_reference_frame_that_of_a_camera_is_optical_whatever_its_name():
    reference = ReferenceFrame("map", Sensors())
    assert see(reference, UPRIGHT, images=1).horizontal == (0.0, 2.0)
    assert not see(reference, UPRIGHT, PlaceSource.VOICE, "microphone").is_optical


@pytest.mark.parametrize("of_camera, turn, up", [
    (True, HERE, 1),        # nowhere on the way to the camera is the turn to its optical frame
    (True, LEVEL, 2),
    (False, HERE, 2),
])
def test_how_near_people_are_is_taken_on_the_floor_though_the_robot_has_the_axes_of_its_camera(
        monkeypatch, of_camera, turn, up):
    monkeypatch.setattr(topics, "TrackedList", MagicMock())
    settings = PERSON_MANAGER_PARAMETERS.resolve({"reference_frame": "map", "robot_frame": "base_link"})
    spaces = topics.PersonSpaces(settings, MagicMock(between=lambda target, frame, stamp: (
        turn if (target, frame) == ("base_link", "map") else HERE)))
    there = Pose(np.eye(3), np.array([3.0, 4.0, 5.0]))
    moved = turn.compose(there).translation if turn is not HERE else there.translation
    expected = np.hypot(*np.delete(moved, up))
    assert spaces._distance("ann", Place("map", there, 1.0, of_camera=of_camera)) == pytest.approx(expected)
