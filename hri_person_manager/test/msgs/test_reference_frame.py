"""Which sensors are told to lack a transform to the reference frame, and for how long."""

import logging

import pytest

from hri_person_manager.core.features import FeaturePose, PlaceSource
from hri_person_manager.ros import inputs
from hri_person_manager.ros.inputs import ReferenceFrame
from hri_pipeline.core.geometry import Pose

HERE = Pose.identity()


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
