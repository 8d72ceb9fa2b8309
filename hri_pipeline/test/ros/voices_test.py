#!/usr/bin/env python3
"""The node voices from sound to topics, through a real master."""

import numpy as np
import rospy
import rostest
import rostopic
from diagnostic_msgs.msg import DiagnosticStatus
from microphone import RATE, noise, speech
from voices_case import LIMIT, VoicesCase

from hri_msgs.msg import IdsList
from hri_pipeline.testing import wait_for


class VoicesTest(VoicesCase):

    def test_a_sentence_becomes_a_voice_with_all_its_topics(self):
        sound = speech()
        self.microphone.play(sound)
        identity = self.hear_somebody()
        heard = self.voices[identity]
        first = next(message for message in self.lists if message.ids)
        self.assertTrue(self.microphone.begin < first.header.stamp.to_sec() < self.microphone.begin + 2.0,
                        "the stamp is that of the sound")
        wait_for(lambda: [message.data for message in heard["is_speaking"]][:1] == [True], LIMIT, "it speaks")
        wait_for(lambda: heard["is_speaking"][-1].data is False, LIMIT, "it has ended")
        wait_for(lambda: heard["speech"] and heard["speech"][-1].data == "go forward ten meters", LIMIT, "what it said")
        self.check_audio(heard["audio"], sound)
        self.check_features(heard["features"])
        self.assertEqual(rostopic.get_topic_type("/humans/voices/{}/speech".format(identity))[0], "std_msgs/String")
        wait_for(lambda: not self.tracked(), LIMIT, "it is let go")
        wait_for(lambda: not [name for name, _ in rospy.get_published_topics("/humans/voices") if identity in name],
                 LIMIT, "its topics have gone")

    def check_audio(self, messages, sound):
        """The audio is a piece of what was played, most of the sentence long."""
        audio = np.frombuffer(b"".join(message.data for message in messages), "<i2") / 32768.0
        self.assertGreater(len(audio), 1.2 * RATE)
        size = 1 << int(np.ceil(np.log2(len(audio) + len(sound))))
        alike = np.fft.irfft(np.fft.rfft(sound, size) * np.conj(np.fft.rfft(audio, size)), size)
        shift = int(np.argmax(alike))
        np.testing.assert_allclose(audio, sound[shift:shift + len(audio)], atol=2.0 / 32768.0)

    def check_features(self, messages):
        self.assertGreater(len(messages), 15, "most of a second of speech, 25 frames each")
        for message in messages:
            self.assertEqual(len(message.MFCC), 12)
            self.assertTrue(0.0 <= message.ZCR <= 1.0 and 0.0 <= message.RMS <= 1.0 and 0.0 <= message.pitch <= 1.0,
                            message)
        pitches = [500.0 * message.pitch for message in messages if message.pitch > 0.0]
        self.assertTrue(60.0 < np.median(pitches) < 350.0, "a human voice, {} Hz".format(np.median(pitches)))

    def test_the_list_is_latched_and_silence_lets_everybody_go(self):
        self.microphone.play(speech())
        identity = self.hear_somebody()
        self.assertEqual(rospy.wait_for_message("/humans/voices/tracked", IdsList, LIMIT).ids, [identity])
        speaking = self.voices[identity]["is_speaking"]
        wait_for(lambda: speaking and speaking[-1].data, LIMIT, "it speaks")
        self.microphone.stop()                                   # in the middle of the sentence
        wait_for(lambda: not speaking[-1].data, LIMIT, "nobody speaks without a microphone")
        wait_for(lambda: not self.tracked(), 10.0, "nobody is tracked without a microphone")
        self.wait_for_state("input", DiagnosticStatus.ERROR, "no sound on /test/sound for ")
        self.microphone.play(speech())
        self.assertNotEqual(self.hear_somebody(), identity)

    def test_long_messages_are_no_silence_between_them(self):
        self.microphone.play(speech(), chunk=1.2)
        identity = self.hear_somebody()
        wait_for(lambda: self.voices[identity]["speech"]
                 and self.voices[identity]["speech"][-1].data == "go forward ten meters", LIMIT, "the whole sentence")
        wait_for(lambda: not self.tracked(), LIMIT, "it is let go")
        self.assertEqual(list(self.voices), [identity], "one sentence is one voice")

    def test_another_format_begins_anew(self):
        self.microphone.say_format(2, 48000)
        sound = np.repeat(np.repeat(speech(), 3)[:, None], 2, axis=1)      # as good as 48 kHz for this
        self.microphone.play(sound, 48000)
        self.hear_somebody()
        values = self.wait_for_state("input", DiagnosticStatus.OK, "sound comes in")
        self.assertEqual(values["format"], "48000 Hz, 2 channels, S16LE")
        self.microphone.say_format(1, RATE)
        self.microphone.play(noise(20.0))
        wait_for(lambda: not self.tracked(), LIMIT, "noise is nobody")
        values = self.wait_for_state("input", DiagnosticStatus.OK, "sound comes in")
        self.assertEqual(values["format"], "16000 Hz, 1 channel, S16LE")


if __name__ == "__main__":
    rospy.init_node("voices_test")
    rostest.rosrun("hri_pipeline", "voices", VoicesTest)
