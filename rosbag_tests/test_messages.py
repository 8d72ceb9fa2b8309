#!/usr/bin/env python3
"""Messages played from a bag arrive complete, in order, with the stamps of the recording."""
from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path
from typing import Callable, Dict, List, Optional, Tuple

import rosbag
import rospy
import rostest
from audio_common_msgs.msg import AudioData
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from hri_msgs.msg import IdsList, IdsMatch

START = 1_600_000_000.0  # s, time of the first message
PERIOD = 0.1  # s between two instants of the recording
INSTANTS = 16  # a power of two: every confidence below is exact in 32 bits
TIME_LIMIT = 30.0  # s of wall time; a stopped bag stops the simulated clock too
CLOCK_TOLERANCE = 0.1  # s between the stamp and the simulated time of arrival

TRACKED = "/humans/faces/tracked"
MATCHES = "/humans/candidate_matches"
AUDIO = "/humans/voices/voice/audio"
TYPES = {TRACKED: IdsList, MATCHES: IdsMatch, AUDIO: AudioData}


def recording() -> List[Tuple[str, object, rospy.Time]]:
    """Topic, message and time of everything in the bag: faces that come and go, and their bodies."""
    entries = []
    for instant in range(INSTANTS):
        stamp = rospy.Time.from_sec(START + instant * PERIOD)
        present = ["face%d" % number for number in range(instant % 4)]
        tracked = IdsList(ids=present)
        tracked.header.stamp = stamp
        tracked.header.frame_id = "camera"
        entries.append((TRACKED, tracked, stamp))
        match = IdsMatch("face%d" % instant, IdsMatch.FACE, "body%d" % instant, IdsMatch.BODY,
                         instant / INSTANTS)
        entries.append((MATCHES, match, stamp))
        entries.append((AUDIO, AudioData(data=bytes([instant, 0, 255])), stamp))
    return entries


def write_bag(path: Path, entries: List[Tuple[str, object, rospy.Time]]) -> None:
    """Write a bag of (topic, message, time)."""
    with rosbag.Bag(str(path), "w") as bag:
        for topic, message, stamp in entries:
            bag.write(topic, message, stamp)


class Recorder:
    """Keeps every message of some topics together with the simulated time of its arrival."""

    def __init__(self, types: Dict[str, type]) -> None:
        self._condition = threading.Condition()
        self._arrived = {topic: [] for topic in types}  # type: Dict[str, list]
        self._subscribers = [rospy.Subscriber(topic, kind, self._keep, topic, queue_size=100)
                             for topic, kind in types.items()]

    def _keep(self, message: object, topic: str) -> None:
        with self._condition:
            self._arrived[topic].append((message, rospy.Time.now()))
            self._condition.notify_all()

    def wait(self, done: Callable[[Dict[str, list]], bool], limit: float) -> Dict[str, list]:
        """What has arrived when `done` holds, or after `limit` seconds of wall time."""
        with self._condition:
            self._condition.wait_for(lambda: done(self._arrived), limit)
            return {topic: list(items) for topic, items in self._arrived.items()}

    def close(self) -> None:
        """Stop listening; may be called again."""
        while self._subscribers:
            self._subscribers.pop().unregister()


class PlayedMessages(unittest.TestCase):
    """One bag, written and played once for all tests."""

    @classmethod
    def setUpClass(cls) -> None:
        cls.entries = recording()
        recorder = Recorder(TYPES)
        player = None
        try:
            with tempfile.TemporaryDirectory() as directory:
                bag = Path(directory) / "messages.bag"
                write_bag(bag, cls.entries)
                player = play(bag)
                cls.arrived = recorder.wait(
                    lambda arrived: all(len(items) >= INSTANTS for items in arrived.values()),
                    TIME_LIMIT)
        finally:
            recorder.close()
            end(player)

    def played(self, topic: str) -> list:
        """Messages that went into the bag on a topic."""
        return [message for name, message, _ in self.entries if name == topic]

    def test_nothing_is_lost_or_changed(self) -> None:
        for topic in TYPES:
            with self.subTest(topic=topic):
                arrived = [without_sequence(message) for message, _ in self.arrived[topic]]
                self.assertEqual(arrived, [without_sequence(m) for m in self.played(topic)])

    def test_header_stamps_are_those_of_the_recording(self) -> None:
        stamps = [message.header.stamp for message, _ in self.arrived[TRACKED]]
        self.assertEqual(stamps, [message.header.stamp for message in self.played(TRACKED)])

    def test_simulated_clock_follows_the_recording(self) -> None:
        for topic in TYPES:
            times = [stamp for name, _, stamp in self.entries if name == topic]
            self.assertEqual(len(self.arrived[topic]), len(times))
            for expected, (_, seen) in zip(times, self.arrived[topic]):
                self.assertLess(abs((seen - expected).to_sec()), CLOCK_TOLERANCE)


def without_sequence(message: object) -> object:
    """The message with its header's sequence number, which every publisher counts anew, set to 0."""
    if hasattr(message, "header"):
        message.header.seq = 0
    return message


def play(bag: Path) -> subprocess.Popen:
    """Start to play a bag on the simulated clock, as soon as that clock runs in this process."""
    clock = Recorder({"/clock": Clock})
    player = subprocess.Popen(["rosrun", "rosbag", "play", "__name:=player", "--clock", "--hz", "100",
                               "--quiet", "--pause", "--wait-for-subscribers", str(bag)])
    try:
        rospy.wait_for_service("player/pause_playback", TIME_LIMIT)
        if not clock.wait(lambda arrived: bool(arrived["/clock"]), TIME_LIMIT)["/clock"]:
            raise RuntimeError("rosbag play sent no /clock within %.0f s" % TIME_LIMIT)
        rospy.ServiceProxy("player/pause_playback", SetBool)(False)
    except BaseException:
        end(player)
        raise
    finally:
        clock.close()
    return player


def end(process: Optional[subprocess.Popen]) -> None:
    """End a child process: ask it, then kill one that does not obey within 5 s."""
    if process is None or process.poll() is not None:
        return
    process.send_signal(signal.SIGINT)
    try:
        process.wait(5.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


if __name__ == "__main__":
    rospy.init_node("test_messages")
    rostest.rosrun("ros4hri", "messages", PlayedMessages, sys.argv)
