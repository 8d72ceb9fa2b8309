"""What the tests of the node voices have in common."""

import unittest

import rospy
from audio_common_msgs.msg import AudioData
from diagnostic_msgs.msg import DiagnosticArray
from microphone import RATE, Microphone
from std_msgs.msg import Bool, String

from hri_msgs.msg import AudioFeatures, IdsList
from hri_pipeline.testing import wait_for

LIMIT = 30.0


class VoicesCase(unittest.TestCase):
    """A microphone on /test/sound, and ears for everything that the node hri_voices gives.

    Nobody is tracked at the begin.
    """

    def setUp(self):
        self.lists, self.states, self.voices = [], [], {}
        self.listen("/humans/voices/tracked", IdsList, self.on_list)
        self.listen("/diagnostics", DiagnosticArray, self.states.append)
        self.microphone = Microphone("/test/sound", info=(1, RATE))
        self.addCleanup(self.microphone.close)
        wait_for(self.microphone.connected, LIMIT, "the node listens")
        wait_for(lambda: self.lists and not self.lists[-1].ids, LIMIT, "nobody is tracked at the begin")

    def listen(self, topic, kind, callback, **options):
        subscriber = rospy.Subscriber(topic, kind, callback, queue_size=500, **options)
        self.addCleanup(subscriber.unregister)

    def on_list(self, message):
        for identity in message.ids:
            if identity not in self.voices:
                heard = self.voices[identity] = {"audio": [], "features": [], "is_speaking": [], "speech": []}
                for name, kind in (("audio", AudioData), ("features", AudioFeatures), ("is_speaking", Bool),
                                   ("speech", String)):
                    self.listen("/humans/voices/{}/{}".format(identity, name), kind, heard[name].append)
        self.lists.append(message)

    def tracked(self):
        return list(self.lists[-1].ids) if self.lists else []

    def hear_somebody(self):
        """Wait for a voice; returns its id."""
        wait_for(self.tracked, LIMIT, "a voice is tracked")
        return self.tracked()[-1]

    def state(self, task):
        found = [status for message in list(self.states) for status in message.status
                 if status.name == "hri_voices: " + task]
        return found[-1] if found else None

    def wait_for_state(self, task, level, words):
        """Wait for a message in the diagnostics; returns its values."""
        del self.states[:]

        def found():
            state = self.state(task)
            return state is not None and state.level == level and words in state.message and state
        try:
            state = wait_for(found, LIMIT, "{}: {}".format(task, words))
        except AssertionError as error:
            raise AssertionError("{}; last: {}".format(error, self.state(task))) from error
        return {value.key: value.value for value in state.values}
