#!/usr/bin/env python3
"""Nodes that are killed: the same people again, and nothing left of the dead."""

import os
import signal
import unittest

import fault_graph
import rospy
import rostest
from bag_stage import PATIENCE_S, Ears, wait_for
from std_msgs.msg import String

from hri_msgs.msg import GazesStamped, IdsList, IdsMatch
from hri_pipeline.ros.subscriptions import IdSubscribers

PEOPLE = ["ann", "bob", "cho", "dan", "eve"]
MANAGER, MATCHER, VOICES, INTERACTIONS, SOURCE = (
    "/hri_person_manager", "/hri_face_body_matcher", "/hri_voice_matcher", "/hri_interactions", "/scene_simulator")


class FaultsTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.ears, cls.matched, cls.gazed = Ears(), {}, []
        cls.voices, cls.speaking = {}, []
        cls.subscribers = [rospy.Subscriber("/humans/candidate_matches", IdsMatch, cls.on_match, queue_size=100),
                           rospy.Subscriber("/scene/truth/speaking", IdsList, cls.on_speaking, queue_size=10),
                           rospy.Subscriber("/humans/interactions/gaze", GazesStamped,
                                            lambda message: cls.gazed.extend(message.gazes))]
        cls.feed = IdSubscribers("persons", {"voice_id": String}, cls.on_voice)
        cls.all_there("the beginning")
        cls.parameters = fault_graph.parameters()

    @classmethod
    def tearDownClass(cls):
        for subscriber in cls.subscribers:
            subscriber.unregister()
        cls.feed.close()
        cls.ears.close()

    @classmethod
    def on_match(cls, message):
        if message.confidence > 0.0:
            cls.matched.setdefault(message._connection_header["callerid"], set()).add(message.id1)

    @classmethod
    def on_voice(cls, person, name, message):
        cls.voices[person] = message.data

    @classmethod
    def on_speaking(cls, message):
        cls.speaking[:] = message.ids

    @classmethod
    def all_there(cls, what):
        """Wait until these people, and nobody else, have places of now, and somebody looks at somebody."""
        now = rospy.get_time()
        cls.ears.forget()
        cls.gazed.clear()
        wait_for(lambda: cls.ears.persons() == PEOPLE and set(PEOPLE) <= cls.ears.placed(now) and cls.gazed, what)

    def kill(self, node):
        old = fault_graph.pid_of(node)
        self.assertIsNotNone(old, node)
        os.kill(old, signal.SIGKILL)
        wait_for(lambda: fault_graph.pid_of(node) not in (None, old), "another process of " + node)
        self.matched.clear()
        self.all_there("everybody, after {} was killed".format(node))

    def tearDown(self):
        def living():
            known = rospy.wait_for_message("/humans/persons/known", IdsList, PATIENCE_S).ids
            found = {kind: set(ids) for kind, ids in self.ears.tracked.items()}
            return dict(found, persons=found.get("persons", set()) | set(known))
        try:
            wait_for(lambda: not fault_graph.left(self.parameters, living()), "nothing left")
        except AssertionError as error:
            raise AssertionError(fault_graph.left(self.parameters, living())) from error

    def test_person_manager(self):
        self.kill(MANAGER)

    def test_face_body_matcher(self):
        self.kill(MATCHER)
        wait_for(lambda: MATCHER in self.matched, "the matcher says who belongs together")

    def test_voice_matcher(self):
        self.kill(VOICES)
        # Said by the new matcher, believed by the person manager, and true.
        wait_for(lambda: any(self.voices.get(person) in self.matched.get(VOICES, ()) for person in list(self.speaking)),
                 "a voice is matched to the person who speaks")

    def test_interactions(self):
        self.kill(INTERACTIONS)

    def test_source(self):
        self.kill(SOURCE)


if __name__ == "__main__":
    rospy.init_node("faults_test")
    rostest.rosrun("ros4hri", "faults", FaultsTest)
