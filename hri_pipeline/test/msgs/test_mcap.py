"""The line of docs/ros2.md that makes an MCAP file of a bag: every message is there, with its values."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List

import genpy
import pytest
import rosbag
from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import String

from hri_msgs.msg import EngagementLevel, FacialLandmarks, Group, GroupsStamped, IdsList, NormalizedPointOfInterest2D

PAGE = Path(__file__).resolve().parents[3] / "docs" / "ros2.md"
MESSAGES: Dict[str, Any] = {
    "/humans/persons/tracked": IdsList(ids=["ada12", "bob34"]),
    "/humans/persons/ada12/name": String("Ada Ø"),
    "/humans/persons/ada12/engagement_status": EngagementLevel(level=EngagementLevel.ENGAGED),
    "/humans/faces/fabcd/landmarks": FacialLandmarks(
        landmarks=[NormalizedPointOfInterest2D(x=0.25, y=0.5, c=1.0)] * 70),
    "/humans/persons/ada12/position": PoseWithCovarianceStamped(),
    "/humans/interactions/groups": GroupsStamped(groups=[Group(group_id="g1", members=["ada12", ""])],
                                                 confidences=[0.75])}
TIMES = 5


@pytest.mark.skipif(sys.version_info < (3, 10), reason="the rosbags of Python 3.8 writes no MCAP")
def test_a_bag_becomes_an_mcap_file_by_the_line_of_the_page(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader
    with rosbag.Bag(str(tmp_path / "evening.bag"), "w") as bag:
        for number in range(TIMES):
            for topic, message in MESSAGES.items():
                stamp = genpy.Time(100 + number, 5)
                if hasattr(message, "header"):
                    message.header.stamp, message.header.frame_id = stamp, "map"
                bag.write(topic, message, stamp)
    lines = re.findall(r"`(rosbags-convert [^`]+)`", PAGE.read_text(encoding="utf-8"))
    assert len(lines) == 1
    program, *arguments = shlex.split(lines[0])
    subprocess.run([str(Path(sys.executable).parent / program), *arguments], check=True, cwd=str(tmp_path),
                   stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    files = list((tmp_path / "evening").glob("*.mcap"))
    assert len(files) == 1 and files[0].read_bytes()[:8] == b"\x89MCAP0\r\n"
    found: Dict[str, List[Any]] = {}
    with AnyReader([tmp_path / "evening"]) as reader:
        for connection, stamp, data in reader.messages():
            found.setdefault(connection.topic, []).append((stamp, reader.deserialize(data, connection.msgtype)))
    assert {topic: len(messages) for topic, messages in found.items()} == dict.fromkeys(MESSAGES, TIMES)
    last = {topic: messages[-1][1] for topic, messages in found.items()}
    assert found["/humans/persons/tracked"][-1][0] == (100 + TIMES - 1) * 10 ** 9 + 5
    assert last["/humans/persons/tracked"].ids == ["ada12", "bob34"]
    assert last["/humans/persons/ada12/name"].data == "Ada Ø"
    assert last["/humans/persons/ada12/engagement_status"].level == EngagementLevel.ENGAGED
    assert last["/humans/faces/fabcd/landmarks"].landmarks[69].x == 0.25
    groups = last["/humans/interactions/groups"]
    assert (groups.header.frame_id, groups.groups[0].members) == ("map", ["ada12", ""])
    assert list(groups.confidences) == [0.75]
