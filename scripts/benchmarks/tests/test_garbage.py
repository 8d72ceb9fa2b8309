"""Garbage for the fault tests: every message can be sent, it holds nothing that anybody should send, and our own
readers refuse or survive it."""

import io
import math

import pytest

roslib_message = pytest.importorskip("roslib.message")
pytest.importorskip("audio_common_msgs")

import rospy  # noqa: E402

from benchmarks.garbage import IDS, Fuzz, Garbage  # noqa: E402
from hri_pipeline.core.camera import CameraError  # noqa: E402
from hri_pipeline.core.ids import is_valid_id  # noqa: E402
from hri_pipeline.core.images import ImageError  # noqa: E402
from hri_pipeline.ros.conversions import camera_from_info, image_to_bgr  # noqa: E402

TYPES = ("sensor_msgs/Image", "sensor_msgs/CameraInfo", "audio_common_msgs/AudioData", "audio_common_msgs/AudioInfo",
         "std_msgs/Bool")


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


FUZZED = ("tf2_msgs/TFMessage", "hri_msgs/IdsList", "hri_msgs/IdsMatch", "hri_msgs/FacialLandmarks",
          "hri_msgs/Skeleton2D",
          "hri_msgs/FacialActionUnits", "audio_common_msgs/AudioData", "sensor_msgs/Image", "std_msgs/Bool")


@pytest.mark.parametrize("kind", FUZZED)
def test_every_message_of_any_type_can_be_sent_and_read(kind):
    message_class = roslib_message.get_message_class(kind)
    fuzz, sizes = Fuzz(3), set()
    for _ in range(30):
        buffer = io.BytesIO()
        fuzz.message(message_class).serialize(buffer)
        message_class().deserialize(buffer.getvalue())
        sizes.add(len(buffer.getvalue()))
    assert len(sizes) > 1 or kind in ("std_msgs/Bool",)


def test_ids_are_none_and_numbers_are_often_not_finite():
    assert not any(is_valid_id(text) for text in IDS)
    match = roslib_message.get_message_class("hri_msgs/IdsMatch")
    values = [Fuzz(seed).message(match).confidence for seed in range(60)]
    assert sum(not math.isfinite(value) for value in values) > 5
    assert sum(math.isfinite(value) for value in values) > 5


def test_known_names_come_now_and_then_and_the_same_seed_makes_the_same():
    ids = roslib_message.get_message_class("hri_msgs/IdsList")
    said = [[Fuzz(seed, ["ann"]).message(ids).ids for seed in range(60)] for _ in range(2)]
    assert said[0] == said[1]
    assert any("ann" in names for names in said[0])
