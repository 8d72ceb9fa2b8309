"""Garbage of cameras and microphones for the fault tests: every message can be sent, and our own readers refuse or survive it."""

import io
import sys
from pathlib import Path

import pytest

roslib_message = pytest.importorskip("roslib.message")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import rospy  # noqa: E402
from faults_garbage import Garbage  # noqa: E402

from hri_pipeline.core.camera import CameraError  # noqa: E402
from hri_pipeline.core.images import ImageError  # noqa: E402
from hri_pipeline.ros.conversions import camera_from_info, image_to_bgr  # noqa: E402

TYPES = ("sensor_msgs/Image", "sensor_msgs/CameraInfo", "audio_common_msgs/AudioData", "audio_common_msgs/AudioInfo", "std_msgs/Bool")


@pytest.fixture(autouse=True)
def clock():
    rospy.rostime.set_rostime_initialized(True)


def messages(name, count=30, **options):
    garbage = Garbage("/topic", roslib_message.get_message_class(name), width=32, height=24, **options)
    return [garbage.message() for _ in range(count)]


@pytest.mark.parametrize("name", TYPES)
def test_every_message_can_be_sent_and_read(name):
    for message in messages(name):
        buffer = io.BytesIO()
        message.serialize(buffer)
        type(message)().deserialize(buffer.getvalue())


@pytest.mark.parametrize("depth", [False, True])
def test_images_are_refused_or_have_the_size_that_they_say(depth):
    refused = 0
    for message in messages("sensor_msgs/Image", depth=depth):
        try:
            bgr = image_to_bgr(message)
            assert bgr.shape == (message.height, message.width, 3)
        except ImageError:
            refused += 1
    assert refused > 10


def test_calibrations_are_refused_or_can_be_used():
    refused = 0
    for message in messages("sensor_msgs/CameraInfo"):
        try:
            camera_from_info(message, 1.0, 32, 24)
        except CameraError:
            refused += 1
    assert refused > 5
