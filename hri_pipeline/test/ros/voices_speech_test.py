#!/usr/bin/env python3
"""What is said in a recording stands on /humans/voices/ID/speech, in the real model's words; a language without a
model is told."""

import os
import shutil
import subprocess
import tempfile
import unittest

import numpy as np
import rospy
import rostest
import soundfile
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from microphone import DATA, RATE
from std_msgs.msg import Bool

from hri_msgs.msg import IdsList, LiveSpeech
from hri_pipeline.core.asr.engines import model_files
from hri_pipeline.core.onnx import ModelError
from hri_pipeline.score.metrics import word_errors
from hri_pipeline.testing import wait_for

LIMIT = 60.0
SENTENCE = DATA + "librivox/sense_and_sensibility_01_austen_64kb-0930.wav"
WORDS = "he might even have been made amiable himself"
NOISE_S = 3.0


class VoicesSpeechTest(unittest.TestCase):

    def setUp(self):
        try:
            model_files("")
        except ModelError as error:
            self.skipTest(str(error))
        self.states, self.lists, self.said, self.finished = [], [], [], []
        self.subscribers = {}
        for topic, kind, callback in (("/humans/voices/tracked", IdsList, self.on_list),
                                      ("/diagnostics", DiagnosticArray, self.states.append),
                                      ("/finished", Bool, self.finished.append)):
            self.addCleanup(rospy.Subscriber(topic, kind, callback, queue_size=500).unregister)

    def on_list(self, message):
        for identity in message.ids:
            if identity not in self.subscribers:
                self.subscribers[identity] = rospy.Subscriber("/humans/voices/{}/speech".format(identity), LiveSpeech,
                                                              self.said.append, queue_size=100)
                self.addCleanup(self.subscribers[identity].unregister)
        self.lists.append(message)

    def start(self, node, *words):
        process = subprocess.Popen(["rosrun", "hri_pipeline", node] + list(words), stdout=subprocess.DEVNULL,
                                   stderr=subprocess.STDOUT, env=dict(os.environ, PYTHONUNBUFFERED="1"))
        self.addCleanup(process.wait, LIMIT)
        self.addCleanup(process.kill)
        return process

    def recording(self):
        """A file with noise, the sentence, and noise again."""
        directory = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, directory)
        sound, rate = soundfile.read(SENTENCE)
        self.assertEqual(rate, RATE)
        sound = np.concatenate([np.zeros(int(NOISE_S * RATE)), sound * (0.5 / np.abs(sound).max()),
                                np.zeros(int(NOISE_S * RATE))])
        sound += 3e-3 * np.random.default_rng(2).standard_normal(len(sound))
        soundfile.write(directory + "/said.wav", sound, RATE, subtype="PCM_16")
        return directory + "/said.wav"

    def state(self, node, task):
        found = [status for message in list(self.states) for status in message.status
                 if status.name == "{}: {}".format(node, task)]
        return found[-1] if found else None

    def test_somebody_reads_and_is_understood_and_noise_says_nothing(self):
        wait_for(lambda: (self.state("hri_voices", "speech") or DiagnosticStatus()).message ==
                 "speech is recognised by moonshine", LIMIT, "the engine")
        wait_for(lambda: {value.key: value.value for value in self.state("hri_voices", "speech").values}[
            "speech_ready"] == "1", LIMIT, "its process")
        self.start("sound_source", "_source:=" + self.recording(), "_loop:=false", "_chunk:=0.1")
        wait_for(lambda: any(message.final for message in self.said), LIMIT, "the sentence")
        wait_for(lambda: self.finished and self.finished[-1].data, LIMIT, "the end of the recording")
        wait_for(lambda: not self.lists[-1].ids, LIMIT, "nobody is tracked")
        final = [message.final for message in self.said if message.final]
        self.assertEqual(len(final), 1, "noise says nothing: {}".format(final))
        self.assertLessEqual(word_errors(WORDS.split(), final[0].split()) / len(WORDS.split()), 0.13, final)
        first = next(message for message in self.said if message.incremental)
        self.assertLess(self.said.index(first), len(self.said) - 1, "text so far comes before the sentence")
        self.assertEqual({message.language for message in self.said}, {"en-US"})
        confidence = next(message.confidence for message in self.said if message.final)
        self.assertTrue(0.5 < confidence <= 1.0, confidence)

    def test_a_language_without_a_model_is_told_and_voices_go_on(self):
        node = self.start("voices", "__name:=german", "_language:=de", "/humans/voices/tracked:=/elsewhere/tracked")
        state = wait_for(lambda: self.state("german", "speech"), LIMIT, "the state of speech")
        self.assertEqual(state.level, DiagnosticStatus.ERROR)
        for words in ("nobody is understood", "'de'", "moonshine_de", "speech_model"):
            self.assertIn(words, state.message)
        rospy.wait_for_message("/elsewhere/tracked", IdsList, LIMIT)
        self.assertIsNone(node.poll())


if __name__ == "__main__":
    rospy.init_node("voices_speech_test")
    rostest.rosrun("hri_pipeline", "voices_speech", VoicesSpeechTest)
