#!/usr/bin/env python3
"""sound_source on sounds that this test writes and on ALSA's own devices: pace, format, end, errors, a device that
goes."""

import os
import signal
import subprocess
import tempfile
import threading
import time
import unittest

import numpy as np
import rospy
import rostest
import soundfile
from audio_common_msgs.msg import AudioData, AudioInfo
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rosgraph_msgs.msg import Log
from std_msgs.msg import Bool

from hri_pipeline.testing import wait_for

LIMIT = 30.0
RATE = 16000


class Listener:
    """Collects the messages of one topic."""

    def __init__(self, topic, kind):
        self.messages, self.arrivals, self._lock = [], [], threading.Lock()
        self.subscriber = rospy.Subscriber(topic, kind, self._on_message, queue_size=1000, tcp_nodelay=True)

    def _on_message(self, message):
        with self._lock:
            self.messages.append(message)
            self.arrivals.append(time.monotonic())

    def sound(self):
        with self._lock:
            return np.frombuffer(b"".join(message.data for message in self.messages), "<i2")


def status_of(messages, node):
    """Return the last status that a node has told of its source, None before the first."""
    found = [status for message in messages for status in message.status if status.name == node.strip("/") + ": source"]
    return found[-1] if found else None


class SoundSourceTest(unittest.TestCase):

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def write(self, name, seconds=1.0, rate=RATE, channels=1):
        times = np.arange(int(seconds * rate)) / rate
        path = os.path.join(self.folder, name)
        soundfile.write(path, np.repeat(0.5 * np.sin(2000.0 * times)[:, None], channels, axis=1), rate)
        return path

    def listen(self, topic, kind):
        listener = Listener(topic, kind)
        self.addCleanup(listener.subscriber.unregister)
        return listener

    def start(self, name, environment=None, **parameters):
        """Start the node in the namespace of its name."""
        words = ["_{}:={}".format(key, value) for key, value in parameters.items()]
        node = subprocess.Popen(["rosrun", "hri_pipeline", "sound_source", "__name:=" + name, "__ns:=/" + name] + words,
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True,
                                env=dict(os.environ, **(environment or {})))
        self.addCleanup(self.end, node)
        return node

    @staticmethod
    def end(node):
        if node.poll() is None:
            node.terminate()
            node.wait(LIMIT)
        node.stdout.close()

    def test_a_file_comes_complete_in_its_time_and_its_end_is_told(self):
        audio, infos = self.listen("/file/audio", AudioData), self.listen("/file/audio_info", AudioInfo)
        finished = self.listen("/file/finished", Bool)
        path = self.write("a.wav", 1.5, 44100, 2)
        node = self.start("file", source=path, loop="false", pause="0.5", at_end="exit", wait_for_subscriber="true",
                          chunk="0.01")
        wait_for(lambda: finished.messages and finished.messages[-1].data, LIMIT, "the end is told")
        self.assertEqual(node.wait(LIMIT), 0)
        self.assertEqual([message.data for message in finished.messages], [False, True])
        info = infos.messages[-1]
        self.assertEqual((info.channels, info.sample_rate, info.sample_format, info.coding_format),
                         (2, 44100, "S16LE", "wave"))
        wait_for(lambda: len(audio.sound()) >= 2 * 2 * 44100, LIMIT, "all of the sound")
        said, _ = soundfile.read(path, dtype="int16")
        sound = audio.sound().reshape(-1, 2)
        np.testing.assert_allclose(sound[:len(said)], said, atol=1)
        self.assertFalse(sound[len(said):].any(), "silence behind it")
        self.assertEqual({len(message.data) for message in audio.messages}, {441 * 4})
        # At its own pace, by the arrival: 2 s of sound take 2 s, and it comes evenly.
        self.assertAlmostEqual(audio.arrivals[-1] - audio.arrivals[0], 2.0, delta=0.3)

    def test_a_directory_loops_at_another_pace_and_sigterm_ends_it(self):
        self.write("s2.wav", 0.4), self.write("s10.wav", 0.4, 8000)
        audio = self.listen("/folder/audio", AudioData)
        node = self.start("folder", source=self.folder, rate="4.0", pause="0.1", channels="3")
        wait_for(lambda: len(audio.sound()) > 3 * 2 * RATE, LIMIT, "2 s of sound")
        lasted = audio.arrivals[-1] - audio.arrivals[0]
        self.assertLess(lasted, 1.2, "four times as fast as it sounds")
        sound = audio.sound().reshape(-1, 3)
        np.testing.assert_array_equal(sound[:, 0], sound[:, 2])
        begin = np.flatnonzero(sound[:, 0])[0]
        np.testing.assert_array_equal(sound[begin:begin + RATE // 4, 0],
                                      sound[begin + RATE:begin + RATE + RATE // 4, 0])
        node.send_signal(signal.SIGTERM)
        self.assertEqual(node.wait(LIMIT), 0)
        self.assertNotIn("Traceback", node.stdout.read())

    def test_topics_can_be_given_other_names(self):
        audio = self.listen("/elsewhere/sound", AudioData)
        infos = self.listen("/elsewhere/format", AudioInfo)
        node = subprocess.Popen(["rosrun", "hri_pipeline", "sound_source", "__name:=renamed", "audio:=/elsewhere/sound",
                                 "audio_info:=/elsewhere/format", "_source:=" + self.write("a.wav")],
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True)
        self.addCleanup(self.end, node)
        wait_for(lambda: audio.messages and infos.messages, LIMIT, "sound on other topics")

    def test_what_cannot_be_played_ends_the_node_with_one_line(self):
        with open(os.path.join(self.folder, "x.wav"), "wb") as file:
            file.write(b"no sound at all")
        for number, (source, words) in enumerate((
                ("/nowhere/a.wav", "/nowhere/a.wav does not exist; give a sound file"),
                (os.path.join(self.folder, "x.wav"), "x.wav: "), ("", "the parameter ~source is empty"))):
            node = self.start("bad{}".format(number), source=source or "''")
            self.assertEqual(node.wait(LIMIT), 1)
            said = [line for line in node.stdout.read().splitlines() if line.strip()]
            self.assertEqual(len(said), 1, said)
            self.assertIn(words, said[0])

    def test_a_microphone_that_is_not_there_or_goes_is_told_and_tried_again(self):
        states, log = self.listen("/diagnostics", DiagnosticArray), self.listen("/rosout", Log)
        self.start("absent", source="alsa:no_such_microphone", retry_period="0.3")

        def tries(node, least):
            state = status_of(list(states.messages), node)
            return state is not None and state.level == DiagnosticStatus.ERROR and any(
                value.key == "tries" and int(value.value) >= least for value in state.values) and state
        state = wait_for(lambda: tries("/absent/absent", 4), LIMIT, "a fourth try")
        told = [line.msg for line in list(log.messages) if line.name == "/absent/absent"
                and "no_such_microphone" in line.msg]
        self.assertLessEqual(len(told), 2, "once that it records, once that there is nothing: {}".format(told))
        self.assertIn("microphone no_such_microphone has ended", state.message)
        audio = self.listen("/mic/audio", AudioData)
        node = self.start("mic", environment=self.microphone(), source="alsa:speaking", retry_period="0.3",
                          channels="1")
        wait_for(lambda: len(audio.sound()) > RATE // 2 and audio.sound().any(), LIMIT, "sound of the microphone")
        child = wait_for(lambda: self.recording_of(node), LIMIT, "the process that records")
        os.kill(child, signal.SIGKILL)
        wait_for(lambda: tries("/mic/mic", 1), LIMIT, "the end of the microphone is told")
        heard = len(audio.messages)
        wait_for(lambda: len(audio.messages) > heard + 20, LIMIT, "it is there again")
        self.assertNotEqual(wait_for(lambda: self.recording_of(node), LIMIT, "another process"), child)

    def microphone(self):
        """An ALSA device that gives the sound of a file; returns the environment in which it exists."""
        raw = os.path.join(self.folder, "speech.raw")
        (8000.0 * np.sin(0.1 * np.arange(RATE))).astype("<i2").tofile(raw)
        path = os.path.join(self.folder, "asound.conf")
        with open(path, "w") as file:
            file.write('</usr/share/alsa/alsa.conf>\npcm.speaking {{ type file; slave.pcm null; file /dev/null; '
                       'infile "{}"; format raw }}\n'.format(raw))
        return {"ALSA_CONFIG_PATH": path}

    @staticmethod
    def recording_of(node):
        """Process id of the arecord below a node, None while there is none."""
        waiting = [node.pid]
        while waiting:
            pid = waiting.pop()
            try:
                with open("/proc/{0}/task/{0}/children".format(pid)) as file:
                    children = [int(child) for child in file.read().split()]
                for task in os.listdir("/proc/{}/task".format(pid)):
                    with open("/proc/{}/task/{}/children".format(pid, task)) as file:
                        children += [int(child) for child in file.read().split()]
                with open("/proc/{}/comm".format(pid)) as file:
                    if file.read().strip() == "arecord":
                        return pid
            except FileNotFoundError:
                continue
            waiting += children
        return None


if __name__ == "__main__":
    rospy.init_node("sound_source_test")
    rostest.rosrun("hri_pipeline", "sound_source", SoundSourceTest)
