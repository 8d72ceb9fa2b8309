#!/usr/bin/env python3
"""Nodes that are killed: the same people again, and nothing left of the dead."""

import os
import signal
import unittest

import fault_graph
import rospy
import rostest
from bag_stage import PATIENCE_S, Ears, wait_for
from diagnostic_msgs.msg import DiagnosticArray

from hri_msgs.msg import GazesStamped, IdsList, IdsMatch

PEOPLE = ["ann", "bob", "cho", "dan", "eve"]
MANAGER, MATCHER, VOICES, INTERACTIONS, SOURCE = (
    "/hri_person_manager", "/hri_face_body_matcher", "/hri_voice_matcher", "/hri_interactions", "/scene_simulator")


class FaultsTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.ears, cls.matched, cls.reported, cls.gazed = Ears(), set(), set(), []
        cls.subscribers = [rospy.Subscriber("/humans/candidate_matches", IdsMatch, cls.on_match, queue_size=100),
                           rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics, queue_size=100),
                           rospy.Subscriber("/humans/interactions/gaze", GazesStamped, lambda message: cls.gazed.extend(message.gazes))]
        cls.all_there("the beginning")
        cls.parameters = fault_graph.parameters()

    @classmethod
    def tearDownClass(cls):
        for subscriber in cls.subscribers:
            subscriber.unregister()
        cls.ears.close()

    @classmethod
    def on_match(cls, message):
        cls.matched.add(message._connection_header["callerid"])

    @classmethod
    def on_diagnostics(cls, message):
        cls.reported.update(status.hardware_id for status in message.status)

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
        self.reported.clear()
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
        wait_for(lambda: VOICES in self.reported, "the matcher says how it is")

    def test_interactions(self):
        self.kill(INTERACTIONS)

    def test_source(self):
        self.kill(SOURCE)


if __name__ == "__main__":
    rospy.init_node("faults_test")
    rostest.rosrun("ros4hri", "faults", FaultsTest)
