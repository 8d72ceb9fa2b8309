#!/usr/bin/env python3
"""The sound intake with stamped sound, with a format that comes late, and with a worker that is too slow."""

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

from hri_pipeline.core.voices.voice_parameters import VOICES
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN
from hri_pipeline.ros.sound import sound_intake
from hri_pipeline.ros.sound.sound_intake import SoundIntake
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


class SoundIntakeTest(unittest.TestCase):

    def open(self, **settings):
        self.restarts = []
        intake = SoundIntake(VOICES.resolve(settings), lambda: self.restarts.append(time.monotonic()))
        self.addCleanup(intake.close)
        return intake

    def advertise(self, name, kind, **options):
        publisher = rospy.Publisher(name, kind, queue_size=1000, **options)
        self.addCleanup(publisher.unregister)
        return publisher

    def connect(self, publisher):
        wait_for(publisher.get_num_connections, LIMIT, "the intake listens")
        return publisher

    def blocks(self, intake, count):
        found = []
        wait_for(lambda: found.extend(intake.next(0.1)) or len(found) >= count, LIMIT, "{} blocks".format(count))
        return found

    def test_stamped_sound_goes_before_the_other(self):
        kind = genpy.dynamic.generate_dynamic("audio_common_msgs/AudioDataStamped", STAMPED)
        stamped, plain = kind["audio_common_msgs/AudioDataStamped"], kind["audio_common_msgs/AudioData"]
        with mock.patch.object(sound_intake, "AudioDataStamped", stamped):
            intake = self.open(use_audio_info=False)
        with_stamp = self.connect(self.advertise("audio_stamped", stamped))
        without = self.connect(self.advertise("audio", AudioData))
        begin = 1000.0
        for number in range(50):
            header = Header(stamp=rospy.Time.from_sec(begin + (number + 1) * 0.02))
            with_stamp.publish(stamped(header=header, audio=plain(data=chunk(number))))
        found = self.blocks(intake, 50)
        without.publish(AudioData(data=chunk()))
        self.assertEqual(intake.next(0.3), [], "the same sound without stamps is not heard twice")
        for number, block in enumerate(found):
            self.assertAlmostEqual(block.stamp, begin + number * 0.02, places=3)
        self.assertEqual(intake.counts["messages"], 50)

    def test_without_the_type_there_is_one_input(self):
        with mock.patch.object(sound_intake, "AudioDataStamped", None):
            intake = self.open(use_audio_info=False)
        self.connect(self.advertise("audio", AudioData)).publish(AudioData(data=chunk()))
        self.assertEqual(len(self.blocks(intake, 1)[0].samples), CHUNK)
        self.assertEqual(intake.status()[0], OK)

    def test_sound_waits_for_its_format(self):
        intake = self.open(channels=1)
        audio = self.connect(self.advertise("audio", AudioData))
        before = rospy.get_time()
        audio.publish(AudioData(data=chunk()))
        self.assertEqual(intake.next(0.1), [])
        self.advertise("audio_info", AudioInfo, latch=True).publish(
            AudioInfo(channels=2, sample_rate=RATE, sample_format="S16LE", coding_format="wave"))
        block = self.blocks(intake, 1)[0]
        self.assertEqual(block.samples.shape, (CHUNK // 2, 2))
        self.assertAlmostEqual(block.stamp, before, delta=0.1)
        self.assertEqual(intake.status()[2]["format"], "16000 Hz, 2 channels, S16LE")

    def test_the_format_that_another_node_tells_does_not_count(self):
        intake = self.open()
        audio = self.connect(self.advertise("audio", AudioData))
        self.advertise("audio_info", AudioInfo, latch=True).publish(
            AudioInfo(channels=2, sample_rate=RATE, sample_format="S16LE", coding_format="wave"))
        infos = []
        self.addCleanup(rospy.Subscriber("audio_info", AudioInfo, infos.append).unregister)
        other = subprocess.Popen(["rostopic", "pub", "-r", "20", "audio_info", "audio_common_msgs/AudioInfo",
                                  "{channels: 7, sample_rate: 44100, sample_format: S16LE, coding_format: wave}"], stdout=subprocess.DEVNULL)
        self.addCleanup(other.wait)
        self.addCleanup(other.kill)
        wait_for(lambda: sum(info.channels == 7 for info in infos) > 3, LIMIT, "the other node tells its format")
        audio.publish(AudioData(data=chunk()))
        self.assertEqual(self.blocks(intake, 1)[0].samples.shape, (CHUNK // 2, 2))
        self.assertEqual(intake.status()[2]["format"], "16000 Hz, 2 channels, S16LE")

    def test_a_worker_that_is_too_slow_loses_the_oldest_sound_and_is_told(self):
        intake = self.open(use_audio_info=False)
        audio = self.connect(self.advertise("audio", AudioData))
        audio.publish(AudioData(data=chunk()))
        first = self.blocks(intake, 1)[0]
        sent = 500                                              # 10 s, twice of what may wait
        for number in range(sent):
            audio.publish(AudioData(data=chunk(number)))
        wait_for(lambda: intake.counts["messages"] == sent + 1, LIMIT, "all of it")
        dropped = intake.counts["dropped_messages"]
        self.assertAlmostEqual(dropped, sent - 250, delta=1)
        found = self.blocks(intake, sent - dropped)
        self.assertAlmostEqual(found[0].gap, dropped * 0.02, places=6)
        self.assertEqual([block.gap for block in found[1:]], [0.0] * (len(found) - 1))
        np.testing.assert_array_equal(found[-1].samples[:, 0], np.frombuffer(chunk(sent - 1), "<i2") / np.float32(32768))
        self.assertEqual(len(found[-1].samples), len(first.samples))
        level, text, _ = intake.status()
        self.assertEqual(level, WARN)
        self.assertIn("were dropped: the processor is too slow", text)

    def test_nobody_sends(self):
        intake = self.open()
        wait_for(lambda: intake.status()[0] == ERROR, LIMIT, "it is told")
        self.assertIn("no publisher on /audio for 3 s; start the microphone's node or remap `audio`", intake.status()[1])
        intake.close()
        intake.close()
        self.assertEqual(intake.next(5.0), [])


if __name__ == "__main__":
    rospy.init_node("sound_intake_test")
    rostest.rosrun("hri_pipeline", "sound_intake", SoundIntakeTest)
