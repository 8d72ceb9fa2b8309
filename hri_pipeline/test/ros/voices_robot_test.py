#!/usr/bin/env python3
"""The node voices with a ReSpeaker v2, beside a robot that speaks."""

import math
import unittest

import numpy as np
import rospy
import rostest
from audio_common_msgs.msg import AudioData
from diagnostic_msgs.msg import DiagnosticArray
from microphone import RATE, Microphone, from_direction, speech, to_bytes
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList
from hri_pipeline.testing import wait_for

LIMIT = 30.0
POSITIONS = np.array([(-0.032, 0.0, 0.0), (0.0, -0.032, 0.0), (0.032, 0.0, 0.0), (0.0, 0.032, 0.0)])
ROBOT, SOMEBODY = 0.0, math.radians(120.0)


def six_channels(*sources):
    """What the device sends of (samples, azimuth), (N, 6): processed sound, four microphones, what is played."""
    heard = sum(from_direction(POSITIONS, samples, azimuth) for samples, azimuth in sources)
    return np.hstack([heard.mean(axis=1, keepdims=True), heard, np.zeros((len(heard), 1))])


class VoicesRobotTest(unittest.TestCase):

    def setUp(self):
        self.lists, self.states, self.directions = [], [], {}
        for topic, kind, callback in (("/humans/voices/tracked", IdsList, self.lists.append),
                                      ("/tf", TFMessage, self.on_tf),
                                      ("/diagnostics", DiagnosticArray, self.states.append)):
            self.addCleanup(rospy.Subscriber(topic, kind, callback, queue_size=500).unregister)
        self.robot = rospy.Publisher("/test/robot_speaking", Bool, queue_size=10)
        self.addCleanup(self.robot.unregister)
        self.microphone = Microphone("audio", info=(6, RATE))
        self.addCleanup(self.microphone.close)
        wait_for(lambda: self.microphone.connected() and self.robot.get_num_connections(), LIMIT, "the node listens")
        wait_for(lambda: self.lists and not self.lists[-1].ids, LIMIT, "nobody is tracked at the begin")

    def on_tf(self, message):
        for one in message.transforms:
            place = one.transform.translation
            self.directions.setdefault(one.child_frame_id, []).append(math.degrees(math.atan2(place.y, place.x)))

    def say(self, speaks):
        """Let the robot say whether it speaks, and wait until the node knows."""
        self.robot.publish(speaks)
        self.wait_for_state("the robot speaks" if speaks else "the robot is silent")

    def wait_for_state(self, words):
        del self.states[:]
        wait_for(lambda: any(words in status.message for message in list(self.states) for status in message.status
                             if status.name == "hri_voices: own voice"), LIMIT, words)

    def play(self, *sources):
        """Play sound to its end; returns the directions (degrees) of the voices that were told meanwhile."""
        wait_for(lambda: not self.lists[-1].ids, LIMIT, "nobody is tracked")
        del self.lists[:]
        self.directions.clear()
        self.microphone.play(six_channels(*sources))
        wait_for(lambda: not self.microphone.is_playing(), LIMIT, "the sound has ended")
        wait_for(lambda: self.lists and self.lists[-1].header.stamp.to_sec() > self.microphone.begin + 1.0, LIMIT,
                 "a list from behind the sound")
        ids = {identity for message in list(self.lists) for identity in message.ids}
        return sorted(round(float(np.median(self.directions["voice_" + identity]))) for identity in ids)

    def test_six_channels_have_directions(self):
        found = self.play((speech(), SOMEBODY))
        self.assertEqual(len(found), 1, found)
        self.assertLessEqual(abs(found[0] - 120), 3)
        values = [status for message in self.states for status in message.status if status.name == "hri_voices: input"]
        self.assertIn("sound comes in", {status.message for status in values}, "the silent sixth channel is no problem")

    def test_the_robot_is_nobody_and_who_is_louder_and_elsewhere_is_heard(self):
        self.say(True)
        self.assertEqual(self.play((speech(), ROBOT)), [])
        twice = np.concatenate([speech(), speech()])
        later = np.concatenate([np.zeros(len(twice) - len(speech())), 3.0 * speech()])
        found = self.play((twice, ROBOT), (np.clip(later, -0.9, 0.9), SOMEBODY))
        self.assertEqual(len(found), 1, found)
        self.assertLessEqual(abs(found[0] - 120), 10)
        self.say(False)
        self.assertEqual(len(self.play((speech(), ROBOT))), 1, "it is silent: somebody stands there")

    def test_a_publisher_that_dies_does_not_mute_for_ever(self):
        self.say(True)
        self.robot.unregister()
        self.microphone.play(six_channels((speech(), SOMEBODY)), loop=True)
        self.wait_for_state("is no longer believed: its publisher has gone")
        wait_for(lambda: self.lists[-1].ids, LIMIT, "somebody is heard")

    def test_what_the_robot_plays_is_enough(self):
        player = rospy.Publisher("/test/robot_audio", AudioData, queue_size=100)
        self.addCleanup(player.unregister)
        wait_for(player.get_num_connections, LIMIT, "the node hears what is played")
        said = speech()
        chunks = [to_bytes(said[first:first + 320]) for first in range(0, len(said), 320)]
        del self.lists[:]
        self.microphone.play(six_channels((said, ROBOT)))
        wait_for(lambda: self.microphone.begin, LIMIT, "it plays")
        for number, chunk in enumerate(chunks):
            wait_for(lambda number=number: rospy.get_time() >= self.microphone.begin + 0.02 * number, LIMIT, "its time")
            player.publish(AudioData(data=chunk))
        wait_for(lambda: not self.microphone.is_playing(), LIMIT, "the sound has ended")
        self.assertFalse([message for message in list(self.lists) if message.ids])


if __name__ == "__main__":
    rospy.init_node("voices_robot_test")
    rostest.rosrun("hri_pipeline", "voices_robot", VoicesRobotTest)
