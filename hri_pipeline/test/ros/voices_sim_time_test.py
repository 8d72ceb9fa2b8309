#!/usr/bin/env python3
"""The node voices in simulated time, as of a bag that is paused, and loops."""

import threading
import unittest

import rospy
import rostest
from audio_common_msgs.msg import AudioData
from diagnostic_msgs.msg import DiagnosticArray
from microphone import CHUNK_S, RATE, speech, to_bytes
from rosgraph_msgs.msg import Clock

from hri_msgs.msg import IdsList
from hri_pipeline.testing import wait_for

LIMIT = 30.0
BEGIN_S = 1000.0


class Bag:
    """Plays a sentence again and again, with the clock of its recording: it begins at BEGIN_S each time."""

    def __init__(self):
        self._clock = rospy.Publisher("/clock", Clock, queue_size=1)
        self._audio = rospy.Publisher("audio", AudioData, queue_size=100)
        sound, size = speech(), int(CHUNK_S * RATE)
        self._chunks = [to_bytes(sound[start:start + size]) for start in range(0, len(sound), size)]
        self._end, self._paused = threading.Event(), threading.Event()
        self.passes, self.now = 0, BEGIN_S
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def _play(self):
        number = 0
        while not self._end.wait(CHUNK_S):
            if self._paused.is_set():
                continue
            self.now = BEGIN_S + number * CHUNK_S
            self._clock.publish(Clock(clock=rospy.Time.from_sec(self.now)))
            self._audio.publish(AudioData(data=self._chunks[number]))
            number = (number + 1) % len(self._chunks)
            self.passes += number == 0

    def pause(self, is_paused):
        (self._paused.set if is_paused else self._paused.clear)()

    def close(self):
        self._end.set()
        self._thread.join()
        self._clock.unregister()
        self._audio.unregister()


class VoicesSimTimeTest(unittest.TestCase):

    def test_stamps_are_of_the_bag_and_a_loop_begins_anew(self):
        lists, states = [], []
        for topic, kind, callback in (("/humans/voices/tracked", IdsList, lists.append),
                                      ("/diagnostics", DiagnosticArray, states.append)):
            self.addCleanup(rospy.Subscriber(topic, kind, callback, queue_size=500).unregister)
        bag = Bag()
        self.addCleanup(bag.close)
        wait_for(lambda: lists and lists[-1].ids, LIMIT, "a voice is tracked")
        first = lists[-1].ids[0]
        self.assertTrue(BEGIN_S < lists[-1].header.stamp.to_sec() <= bag.now)
        bag.pause(True)
        seen = len(lists)
        wait_for(lambda: len(lists) > seen + 3, LIMIT, "three more seconds of lists")
        self.assertEqual([list(message.ids) for message in lists[seen:]], [[first]] * len(lists[seen:]),
                         "time stands still, and nobody goes")
        bag.pause(False)
        wait_for(lambda: bag.passes, LIMIT, "the second pass")
        wait_for(lambda: lists[-1].ids and first not in lists[-1].ids, LIMIT, "a voice of the second pass")
        self.assertTrue(BEGIN_S < lists[-1].header.stamp.to_sec() <= bag.now, "its stamp is of the second pass")
        wait_for(lambda: any(value.key == "time_jumps" and int(value.value) >= 1 for message in states
                             for status in message.status for value in status.values), LIMIT, "the jump is counted")
        names = [name.rsplit("/", 1)[1] for name, _ in rospy.get_published_topics("/humans/voices/" + lists[-1].ids[0])]
        self.assertEqual(sorted(names), ["audio", "features", "is_speaking"], "speech is switched off")


if __name__ == "__main__":
    rospy.init_node("voices_sim_time_test")
    rostest.rosrun("hri_pipeline", "voices_sim_time", VoicesSimTimeTest)
