"""Garbage for the fault tests: every message can be sent, and what it holds is nothing that anybody should send."""

import io
import math
import sys
from pathlib import Path

import pytest

roslib_message = pytest.importorskip("roslib.message")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from faults_fuzz import IDS, Fuzz  # noqa: E402

from hri_pipeline.core.ids import is_valid_id  # noqa: E402

TYPES = ("tf2_msgs/TFMessage", "hri_msgs/IdsList", "hri_msgs/IdsMatch", "hri_msgs/FacialLandmarks", "hri_msgs/Skeleton2D",
         "hri_msgs/FacialActionUnits", "audio_common_msgs/AudioData", "sensor_msgs/Image", "std_msgs/Bool")


@pytest.mark.parametrize("kind", TYPES)
def test_every_message_can_be_sent_and_read(kind):
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
