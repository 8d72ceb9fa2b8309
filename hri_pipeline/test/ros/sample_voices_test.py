#!/usr/bin/env python3
"""The sample of the node voices; nodes of its own: a parameter that is wrong, a microphone that is not there,
SIGTERM."""

import os
import signal
import subprocess
import unittest

import rospy
import rostest
from std_msgs.msg import String

from hri_msgs.msg import IdsList
from hri_pipeline.testing import wait_for

LIMIT = 40.0


class SampleVoicesTest(unittest.TestCase):

    def start(self, *words):
        node = subprocess.Popen(["rosrun", "hri_pipeline", "voices"] + list(words), stdout=subprocess.PIPE,
                                stderr=subprocess.STDOUT, universal_newlines=True,
                                env=dict(os.environ, PYTHONUNBUFFERED="1"))
        self.addCleanup(self.end, node)
        return node

    @staticmethod
    def end(node):
        if node.poll() is None:
            node.kill()
            node.wait(LIMIT)
        node.stdout.close()

    def test_somebody_reads_and_is_understood(self):
        voices, said = {}, []

        def on_list(message):
            for identity in set(message.ids) - set(voices):
                voices[identity] = rospy.Subscriber("/humans/voices/{}/speech".format(identity), String, said.append)
        tracked = rospy.Subscriber("/humans/voices/tracked", IdsList, on_list)
        self.addCleanup(tracked.unregister)
        wait_for(lambda: any(len(message.data.split()) >= 3 for message in list(said)), LIMIT, "a sentence")
        for subscriber in list(voices.values()):      # another voice may begin
            subscriber.unregister()

    def test_sigterm_ends_it_and_its_list_is_empty_at_the_end(self):
        lists = []
        subscriber = rospy.Subscriber("/elsewhere/tracked", IdsList, lists.append)
        self.addCleanup(subscriber.unregister)
        node = self.start("__name:=ending", "audio:=/audio", "audio_info:=/audio_info", "_speech:=false",
                          "/humans/voices/tracked:=/elsewhere/tracked")
        wait_for(lambda: lists and lists[-1].ids, LIMIT, "a voice on the other name of the topic")
        node.send_signal(signal.SIGTERM)
        self.assertEqual(node.wait(LIMIT), 0)
        wait_for(lambda: not lists[-1].ids, LIMIT, "nobody is tracked any more")
        said = node.stdout.read()
        self.assertNotIn("Traceback", said)
        self.assertIn("switched off: speech, voice_identity; sound is never stored", said)

    def test_errors_of_the_set_up_are_one_line(self):
        for argument, words in (("_channels:=0", "parameter channels is 0 (int); legal: int, 1 to 32"),
                                ("_vad_model:=/nowhere/x.onnx", "/nowhere/x.onnx does not exist"),
                                ("_microphone_positions:=['here']", "microphone_positions"),
                                ("_speech_grammar:=/nowhere/x.gram", "/nowhere/x.gram")):
            node = self.start("__name:=wrong", argument)
            self.assertEqual(node.wait(LIMIT), 1, argument)
            said = [line for line in node.stdout.read().splitlines() if "FATAL" in line]
            self.assertEqual(len(said), 1, said)
            self.assertIn(words, said[0])
            rospy.delete_param("/wrong")


if __name__ == "__main__":
    rospy.init_node("sample_voices_test")
    rostest.rosrun("hri_pipeline", "sample_voices", SampleVoicesTest)
