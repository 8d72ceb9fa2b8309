#!/usr/bin/env python3
"""The input of sound with stamped sound, with a format that comes late, and with a worker that is too slow."""

import subprocess
import time
import unittest
from unittest import mock

import genpy.dynamic
import numpy as np
import rospy
import rostest
from audio_common_msgs.msg import AudioData, AudioInfo
from std_msgs.msg import Header

from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.ros import sensor_input, sound_input
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN
from hri_pipeline.ros.sound_input import SoundInput
from hri_pipeline.testing import wait_for

LIMIT = 20.0
RATE = 16000
CHUNK = 320
# As the released package defines it; ours, which stands in for it, has not got it.
STAMPED = """std_msgs/Header header
audio_common_msgs/AudioData audio
{0}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
{0}
MSG: audio_common_msgs/AudioData
uint8[] data
""".format("=" * 80)


def chunk(number=0):
    return (1000.0 * np.sin(0.1 * np.arange(number * CHUNK, (number + 1) * CHUNK))).astype("<i2").tobytes()


class SoundInputTest(unittest.TestCase):

    def open(self, **settings):
        self.restarts = []
        sound = SoundInput(VOICES.resolve(settings), lambda: self.restarts.append(time.monotonic()))
        self.addCleanup(sound.close)
        return sound

    def advertise(self, name, kind, **options):
        publisher = rospy.Publisher(name, kind, queue_size=1000, **options)
        self.addCleanup(publisher.unregister)
        return publisher

    def connect(self, publisher):
        wait_for(publisher.get_num_connections, LIMIT, "the input listens")
        return publisher

    def blocks(self, sound, count):
        found = []
        wait_for(lambda: found.extend(sound.next(0.1)) or len(found) >= count, LIMIT, "{} blocks".format(count))
        return found

    def test_who_is_not_heard_is_not_remembered_for_ever(self):
        sound = self.open()
        sound._on_audio(self.from_node("/microphone"))
        for number in range(2000):
            sound._on_audio(self.from_node("/other_{}".format(number)))
        self.assertLess(len(sound._senders._others), 100)
        self.assertIn("/other_1999 sends too", sound._other_sender().replace(", ", " sends too "))

    @staticmethod
    def from_node(name):
        message = AudioData(data=chunk())
        message._connection_header = {"callerid": name}
        return message

    def test_stamped_sound_goes_before_the_other(self):
        kind = genpy.dynamic.generate_dynamic("audio_common_msgs/AudioDataStamped", STAMPED)
        stamped, plain = kind["audio_common_msgs/AudioDataStamped"], kind["audio_common_msgs/AudioData"]
        with mock.patch.object(sound_input, "AudioDataStamped", stamped):
            sound = self.open(use_audio_info=False)
        with_stamp = self.connect(self.advertise("audio_stamped", stamped))
        without = self.connect(self.advertise("audio", AudioData))
        begin = 1000.0
        for number in range(50):
            header = Header(stamp=rospy.Time.from_sec(begin + (number + 1) * 0.02))
            with_stamp.publish(stamped(header=header, audio=plain(data=chunk(number))))
        found = self.blocks(sound, 50)
        without.publish(AudioData(data=chunk()))
        self.assertEqual(sound.next(0.3), [], "the same sound without stamps is not heard twice")
        for number, block in enumerate(found):
            self.assertAlmostEqual(block.stamp, begin + number * 0.02, places=3)
        self.assertEqual(sound.counts["messages"], 50)

    def test_stamps_of_another_clock_are_told_when_they_stay(self):
        self.addCleanup(setattr, sound_input, "_SETTLED_S", sound_input._SETTLED_S)
        sound_input._SETTLED_S = 0.2
        kind = genpy.dynamic.generate_dynamic("audio_common_msgs/AudioDataStamped", STAMPED)
        stamped, plain = kind["audio_common_msgs/AudioDataStamped"], kind["audio_common_msgs/AudioData"]
        with mock.patch.object(sound_input, "AudioDataStamped", stamped):
            sound = self.open(use_audio_info=False)
        publisher = self.connect(self.advertise("audio_stamped", stamped))
        for lag, words in ((0.0, ""), (30.0, "30.0 s old when it arrives"), (0.0, ""), (-30.0, "30.0 s in the future")):
            with self.assertLogs("rosout", "WARNING") as log:
                def told(lag=lag, words=words, log=log):
                    header = Header(stamp=rospy.Time.from_sec(rospy.get_time() - lag))
                    publisher.publish(stamped(header=header, audio=plain(data=chunk())))
                    sound.next(0.02)
                    text = sound.status()[1]
                    # The log has it with the next sound, diagnostics at once.
                    logged = not words.endswith("arrives") or any("NTP" in line for line in log.output)
                    return words in text and logged if words else "arrives" not in text and "future" not in text
                wait_for(told, LIMIT, words)
                rospy.logwarn("the end")
            self.assertEqual(any("NTP" in line for line in log.output), words.endswith("arrives"), log.output)

    def test_the_clock_is_that_of_the_sender_who_is_heard(self):
        self.addCleanup(setattr, sound_input, "_SETTLED_S", sound_input._SETTLED_S)
        sound_input._SETTLED_S = 0.0

        def send(name, stamp):
            message = mock.Mock(header=Header(stamp=rospy.Time.from_sec(stamp)), audio=AudioData(data=chunk()))
            message._connection_header = {"callerid": name}
            sound._on_stamped(message)
        for wrong, words in ((rospy.get_time() - 30.0, " s old when it arrives"),
                             (3.5, "sound is stamped by simulated time (3.5 s), and /use_sim_time is not true")):
            sound = self.open(use_audio_info=False)
            send("/heard", wrong)
            send("/other", rospy.get_time())
            self.assertIn(words, sound._clock_problem())
            sound = self.open(use_audio_info=False)
            send("/heard", rospy.get_time())
            send("/other", wrong)
            self.assertEqual(sound._clock_problem(), "")

    def test_without_the_type_there_is_one_input(self):
        with mock.patch.object(sound_input, "AudioDataStamped", None):
            sound = self.open(use_audio_info=False)
        self.connect(self.advertise("audio", AudioData)).publish(AudioData(data=chunk()))
        self.assertEqual(len(self.blocks(sound, 1)[0].samples), CHUNK)
        self.assertEqual(sound.status()[0], OK)

    def test_sound_waits_for_its_format(self):
        sound = self.open(channels=1)
        audio = self.connect(self.advertise("audio", AudioData))
        before = rospy.get_time()
        audio.publish(AudioData(data=chunk()))
        self.assertEqual(sound.next(0.1), [])
        self.advertise("audio_info", AudioInfo, latch=True).publish(
            AudioInfo(channels=2, sample_rate=RATE, sample_format="S16LE", coding_format="wave"))
        block = self.blocks(sound, 1)[0]
        self.assertEqual(block.samples.shape, (CHUNK // 2, 2))
        self.assertAlmostEqual(block.stamp, before, delta=0.1)
        self.assertEqual(sound.status()[2]["format"], "16000 Hz, 2 channels, S16LE")

    def test_the_format_that_another_node_tells_does_not_count(self):
        sound = self.open()
        audio = self.connect(self.advertise("audio", AudioData))
        self.advertise("audio_info", AudioInfo, latch=True).publish(
            AudioInfo(channels=2, sample_rate=RATE, sample_format="S16LE", coding_format="wave"))
        infos = []
        self.addCleanup(rospy.Subscriber("audio_info", AudioInfo, infos.append).unregister)
        other = subprocess.Popen(["rostopic", "pub", "-r", "20", "audio_info", "audio_common_msgs/AudioInfo",
                                  "{channels: 7, sample_rate: 44100, sample_format: S16LE, coding_format: wave}"],
                                 stdout=subprocess.DEVNULL)
        self.addCleanup(other.wait)
        self.addCleanup(other.kill)
        wait_for(lambda: sum(info.channels == 7 for info in infos) > 3, LIMIT, "the other node tells its format")
        audio.publish(AudioData(data=chunk()))
        self.assertEqual(self.blocks(sound, 1)[0].samples.shape, (CHUNK // 2, 2))
        self.assertEqual(sound.status()[2]["format"], "16000 Hz, 2 channels, S16LE")

    def test_a_worker_that_is_too_slow_loses_the_oldest_sound_and_is_told(self):
        sound = self.open(use_audio_info=False)
        audio = self.connect(self.advertise("audio", AudioData))
        audio.publish(AudioData(data=chunk()))
        first = self.blocks(sound, 1)[0]
        sent = 500                                              # 10 s, twice of what may wait
        for number in range(sent):
            audio.publish(AudioData(data=chunk(number)))
        wait_for(lambda: sound.counts["messages"] == sent + 1, LIMIT, "all of it")
        dropped = sound.counts["dropped_messages"]
        self.assertAlmostEqual(dropped, sent - 250, delta=1)
        found = self.blocks(sound, sent - dropped)
        self.assertAlmostEqual(found[0].gap, dropped * 0.02, places=6)
        self.assertEqual([block.gap for block in found[1:]], [0.0] * (len(found) - 1))
        np.testing.assert_array_equal(found[-1].samples[:, 0],
                                      np.frombuffer(chunk(sent - 1), "<i2") / np.float32(32768))
        self.assertEqual(len(found[-1].samples), len(first.samples))
        level, text, _ = sound.status()
        self.assertEqual(level, WARN)
        self.assertIn("were dropped: the processor is too slow", text)

    def test_nobody_sends(self):
        sound = self.open()
        with mock.patch.object(sensor_input, "LOG_PERIOD_S", 0.3), self.assertLogs("rosout", "WARNING") as log:
            wait_for(lambda: not sound.next(0.05) and log.output, LIMIT, "a warning")
            told = time.monotonic()
            wait_for(lambda: not sound.next(0.05) and time.monotonic() > told + 2.0, LIMIT,
                     "time enough for more warnings")
        self.assertEqual(len(log.output), 1, log.output)
        wait_for(lambda: sound.status()[0] == ERROR, LIMIT, "it is told")
        self.assertIn("no publisher on /audio for ", sound.status()[1])
        self.assertIn("s; start the microphone's node or remap `audio`", sound.status()[1])
        sound.close()
        sound.close()
        self.assertEqual(sound.next(5.0), [])


if __name__ == "__main__":
    rospy.init_node("sound_input_test")
    rostest.rosrun("hri_pipeline", "sound_input", SoundInputTest)
