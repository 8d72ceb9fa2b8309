#!/usr/bin/env python3
"""The node voices with four microphones: frames of voices; LiveSpeech; a branch that is switched off; channels that do
not fit."""

import math
import unittest

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from microphone import RATE, Microphone, from_direction, noise, speech
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList, LiveSpeech
from hri_pipeline.testing import wait_for

LIMIT = 30.0
POSITIONS = np.array([(0.04, 0.04, 0.0), (-0.04, 0.04, 0.0), (-0.04, -0.04, 0.0), (0.04, -0.04, 0.0)])


class VoicesArrayTest(unittest.TestCase):

    def setUp(self):
        self.lists, self.transforms, self.said, self.states = [], [], {}, []
        for topic, kind, callback in (("/humans/voices/tracked", IdsList, self.on_list), ("/tf", TFMessage, self.on_tf),
                                      ("/diagnostics", DiagnosticArray, self.states.append)):
            self.addCleanup(rospy.Subscriber(topic, kind, callback, queue_size=500).unregister)
        self.microphone = Microphone("audio", info=(4, RATE))
        self.addCleanup(self.microphone.close)
        wait_for(self.microphone.connected, LIMIT, "the node listens")
        wait_for(lambda: self.lists and not self.lists[-1].ids, LIMIT, "nobody is tracked at the begin")

    def on_list(self, message):
        for identity in message.ids:
            if identity not in self.said:
                heard = self.said[identity] = []
                self.addCleanup(rospy.Subscriber("/humans/voices/{}/speech".format(identity), LiveSpeech, heard.append,
                                                 queue_size=100).unregister)
        self.lists.append(message)

    def on_tf(self, message):
        self.transforms += [one for one in message.transforms if one.child_frame_id.startswith("voice_")]

    def test_a_voice_has_a_frame_in_its_direction_and_says_live_what_it_says(self):
        azimuth = math.radians(60.0)
        self.microphone.play(from_direction(POSITIONS, speech(), azimuth))
        wait_for(lambda: self.lists[-1].ids, LIMIT, "a voice is tracked")
        identity = self.lists[-1].ids[0]
        wait_for(lambda: len([one for one in self.transforms if one.child_frame_id == "voice_" + identity]) > 20, LIMIT,
                 "its frame")
        places = []
        for one in self.transforms:
            self.assertEqual(one.header.frame_id, "test_array")
            self.assertTrue(self.microphone.begin - 0.5 < one.header.stamp.to_sec() < rospy.get_time())
            place = one.transform.translation
            places.append((place.x, place.y, place.z))
            self.assertAlmostEqual(float(np.linalg.norm(places[-1])), 1.0, places=5)
        x, y, _ = np.median(places, axis=0)
        self.assertLess(abs(math.degrees(math.atan2(y, x) - azimuth)), 10.0)
        stamps = [one.header.stamp.to_sec() for one in self.transforms if one.child_frame_id == "voice_" + identity]
        self.assertEqual(stamps, sorted(set(stamps)), "no stamp comes twice")
        self.check_speech(identity)
        wait_for(lambda: not self.lists[-1].ids, LIMIT, "it is let go")

    def check_speech(self, identity):
        wait_for(lambda: any(message.final for message in self.said[identity]), LIMIT, "the sentence")
        final = [message for message in self.said[identity] if message.final][0]
        self.assertIn("forward", final.final)
        self.assertEqual(final.incremental, "")
        self.assertTrue(0.0 < final.confidence <= 1.0, final.confidence)
        self.assertEqual((final.language, final.header.frame_id), ("en-US", "test_array"))
        self.assertTrue(self.microphone.begin < final.header.stamp.to_sec() < rospy.get_time())
        names = [name for name, _ in rospy.get_published_topics("/humans/voices/" + identity)]
        self.assertEqual(sorted(name.rsplit("/", 1)[1] for name in names), ["audio", "is_speaking", "speech"],
                         "features are switched off")

    def test_channels_that_do_not_fit_are_named_and_heard_as_one(self):
        self.microphone.say_format(2, RATE)
        self.microphone.play(np.stack([speech()] * 2, axis=1) + noise(1.0)[:1, None])
        wait_for(lambda: self.lists[-1].ids, LIMIT, "a voice is tracked")
        wait_for(lambda: any("has 4 microphones and the sound 2 channels" in status.message
                             for message in list(self.states)
                             for status in message.status), LIMIT, "the mend")
        self.assertEqual(self.transforms, [])

    def test_channels_in_another_order_are_told_with_one_that_fits(self):
        talk = np.tile(speech()[RATE // 2:-2 * RATE], 4)
        sound = np.concatenate([from_direction(POSITIONS, talk, azimuth) for azimuth in (0.3, -1.0, 2.4)])
        self.microphone.play(sound[:, [1, 0, 2, 3]])
        wait_for(lambda: any("does not fit ~microphone_positions" in status.message for message in list(self.states)
                             for status in message.status), LIMIT, "the mend")
        self.microphone.stop()
        wait_for(lambda: not self.lists[-1].ids, LIMIT, "they are let go")

    def test_with_a_silent_microphone_the_others_tell_the_direction(self):
        """Its own noise was somebody at 150 degrees on the other side."""
        azimuth = math.radians(60.0)
        sound = from_direction(POSITIONS, np.concatenate([noise(4.0, 0.01), speech()]), azimuth)
        sound[:, 2] = np.random.default_rng(4).normal(0.0, 1e-4, len(sound))
        self.microphone.play(sound)
        wait_for(lambda: any("channel 2 of 4 is silent" in status.message for message in list(self.states)
                             for status in message.status), LIMIT, "the warning")
        wait_for(lambda: len(self.transforms) > 20, LIMIT, "frames of the voice")
        wait_for(lambda: not self.lists[-1].ids, LIMIT, "it is let go")
        places = np.array([(one.transform.translation.x, one.transform.translation.y) for one in self.transforms])
        azimuths = np.degrees(np.arctan2(places[:, 1], places[:, 0]))
        self.assertLess(np.abs(azimuths - 60.0).max(), 10.0, azimuths)

    def test_a_microphone_that_works_again_interrupts_nobody(self):
        """It counts again 10 s later, in the middle of a voice, which began anew."""
        talk = np.tile(speech()[RATE // 2:-2 * RATE], 8)
        sound = from_direction(POSITIONS, np.concatenate([noise(4.0, 0.01), talk, noise(8.0, 0.01)]), 1.0)
        sound[:5 * RATE, 2] = np.random.default_rng(4).normal(0.0, 1e-4, 5 * RATE)
        self.assertGreater(len(talk), 13 * RATE)
        self.microphone.play(sound)
        wait_for(lambda: self.broken() == "1", LIMIT, "it is left out")
        wait_for(lambda: self.lists[-1].ids, LIMIT, "a voice is tracked")
        wait_for(lambda: self.broken() == "0", LIMIT, "it is taken up")
        self.assertEqual(len(self.said), 1, "one person speaks without a pause")
        self.assertEqual(self.lists[-1].ids, [])

    def broken(self):
        """Return how many microphones are left out, by the newest diagnostics that tell it."""
        values = [pair.value for message in list(self.states) for status in message.status for pair in status.values
                  if pair.key == "broken_microphones"]
        return values[-1] if values else ""


if __name__ == "__main__":
    rospy.init_node("voices_array_test")
    rostest.rosrun("hri_pipeline", "voices_array", VoicesArrayTest)
