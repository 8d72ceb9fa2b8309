#!/usr/bin/env python3
"""The node voices with sound that is none, and what its diagnostics tell."""

import subprocess

import numpy as np
import rosnode
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from microphone import RATE, noise, speech, to_bytes
from voices_case import LIMIT, VoicesCase

from hri_pipeline.testing import wait_for


class VoicesInputTest(VoicesCase):

    def test_bad_input_is_named_and_survived(self):
        mp3 = b"\xff\xfb\x90\x64" + bytes(413)
        good = [to_bytes(noise(0.02))]
        loud = np.sign(np.sin(np.arange(RATE) / 20.0))
        cases = (
            ("silence", (1, RATE), [bytes(640)], 0.02, DiagnosticStatus.WARN, "dead silence"),
            ("clipping", (1, RATE), [to_bytes(loud[:320])], 0.02, DiagnosticStatus.WARN, "the sound is clipped: "),
            ("wrong rate", (1, 44100), good, 0.02, DiagnosticStatus.WARN, "set ~sample_rate (or the AudioInfo) to "
                                                                          "16000"),
            ("odd bytes", (1, RATE), [bytes(641)], 0.02, DiagnosticStatus.ERROR, "641 bytes are no whole number"),
            ("no channel", (0, RATE), good, 0.02, DiagnosticStatus.ERROR, "the sound has 0 channels"),
            ("no rate", (1, 0), good, 0.02, DiagnosticStatus.ERROR, "0 samples a second"),
            ("mp3 announced", (1, RATE, "", "mp3"), [mp3], 0.02, DiagnosticStatus.ERROR, "coded as 'mp3'"),
            ("mp3 bytes", (1, RATE), [mp3], 0.02, DiagnosticStatus.ERROR, "the bytes are mp3"),
            ("unknown samples", (1, RATE, "ULAW"), good, 0.02, DiagnosticStatus.ERROR, "format 'ULAW'"),
        )
        for name, form, chunks, period, level, words in cases:
            self.microphone.say_format(*form)
            self.microphone.play_chunks(chunks, period, loop=True)
            self.wait_for_state("input", level, words)
            self.microphone.stop()
            print(name, "is named")
        self.assertEqual(self.tracked(), [])
        self.microphone.say_format(1, RATE)
        self.microphone.play(speech())
        self.hear_somebody()
        values = self.wait_for_state("input", DiagnosticStatus.OK, "sound comes in")
        self.assertGreater(int(values["unreadable"]), 10)
        self.assertTrue(rosnode.rosnode_ping("/hri_voices", max_count=1, verbose=False))

    def test_a_second_microphone_on_the_topic_is_told(self):
        self.microphone.play(noise(20.0), loop=True)
        self.wait_for_state("input", DiagnosticStatus.OK, "sound comes in")
        other = subprocess.Popen(["rosrun", "hri_pipeline", "sound_source", "__name:=other_microphone",
                                  "audio:=/test/sound",
                                  "audio_info:=/nowhere", "_source:=/usr/share/pocketsphinx/test/data/goforward.raw"],
                                 stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self.addCleanup(other.wait)
        self.addCleanup(other.terminate)
        self.wait_for_state("input", DiagnosticStatus.WARN, "/other_microphone sends too, only /voices_input")
        self.assertEqual(self.tracked(), [])

    def test_what_the_diagnostics_tell(self):
        self.microphone.play(noise(20.0, 0.01), loop=True)
        self.wait_for_state("input", DiagnosticStatus.OK, "sound comes in")

        def value(name):
            return float({value.key: value.value for value in self.state("input").values}.get(name, "nan"))
        # The window is 10 s long: it may still hold sound of the test before.
        wait_for(lambda: abs(value("level_dbfs") + 40.0) < 1.0, LIMIT, "the level")
        wait_for(lambda: abs(value("noise_floor_dbfs") + 40.0) < 1.0, LIMIT, "the noise floor")
        wait_for(lambda: value("clipped_percent") == 0.0, LIMIT, "no clipping")
        values = self.wait_for_state("pipeline", DiagnosticStatus.OK, "s of work per second of sound")
        self.assertLess(float(values["real_time_factor"]), 1.0)
        self.assertLess(float(values["age_ms_median"]), 500.0)
        self.wait_for_state("voices", DiagnosticStatus.OK, "0 voices")
        self.wait_for_state("speech", DiagnosticStatus.OK, "pocketsphinx")


if __name__ == "__main__":
    rospy.init_node("voices_input_test")
    rostest.rosrun("hri_pipeline", "voices_input", VoicesInputTest)
