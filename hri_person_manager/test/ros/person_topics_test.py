#!/usr/bin/env python3
"""Topics of persons that cannot be opened at first."""

import time
import unittest

import genpy
import rospy
import rostest
from std_msgs.msg import String

from hri_msgs.msg import IdsList
from hri_person_manager.core.persons import PersonState, Snapshot
from hri_person_manager.core.register import PersonRegister
from hri_person_manager.ros.topics import PersonTopics
from hri_pipeline.ros.rospy_compat import prepare_rospy
from hri_pipeline.testing import wait_for, without_descriptors


class PersonTopicsTest(unittest.TestCase):

    def setUp(self):
        self.register = PersonRegister()
        self.topics = PersonTopics(self.register)
        self.addCleanup(self.topics.close)
        self.listed, self.known, self.heard = [], [], []
        for topic, kind, take in (
                ("/humans/persons/tracked", IdsList, lambda message: self.listed.append(list(message.ids))),
                ("/humans/persons/known", IdsList, lambda message: self.known.append(list(message.ids))),
                ("/humans/persons/ann/face_id", String, lambda message: self.heard.append(message.data)),
                ("/humans/persons/ann/name", String, lambda message: self.heard.append(message.data))):
            subscriber = rospy.Subscriber(topic, kind, take, queue_size=10)
            self.addCleanup(subscriber.unregister)
        self.snapshot = Snapshot((), (), ())
        # Everybody is connected: rospy takes no connection any more after one that it had no descriptor for.
        wait_for(lambda: self.update() and self.listed and self.known, 20, "the empty lists")
        self.snapshot = Snapshot((PersonState("ann", "f1", "", "", False, 1.0),), ("ann",), ("ann",))

    def update(self):
        self.topics.update(self.snapshot, genpy.Time.from_sec(time.time()))
        return True

    def fails(self):
        """The topics that are to be opened now are not."""
        with without_descriptors():
            self.update()
            person = self.topics._persons["ann"]
            wait_for(lambda: person.failed_at is not None, 10, "a failure")

    def test_they_are_opened_later_and_the_person_is_listed(self):
        self.fails()
        wait_for(lambda: self.update() and self.listed[-1:] == [["ann"]] and "f1" in self.heard, 20,
                 lambda: "the person; heard {} {}".format(self.listed[-2:], self.heard))

    def test_who_becomes_somebody_else_is_listed_without_a_gap(self):
        wait_for(lambda: self.update() and self.listed[-1:] == [["ann"]] and "f1" in self.heard, 20, "the person")
        wait_for(lambda: self.known[-1:] == [["ann"]], 20, "who is known")
        del self.listed[:], self.known[:], self.heard[:]
        self.snapshot = Snapshot((PersonState("ann", "", "", "", True, 1.0, "bob"),
                                  PersonState("bob", "f1", "", "", False, 1.0)), ("bob",), ("bob",))
        wait_for(lambda: self.update() and self.listed[-1:] == [["bob"]] and self.heard, 20, "the other person")
        self.assertNotIn([], self.listed, "somebody is there all the time")
        wait_for(lambda: self.known[-1:] == [["bob"]], 20, "who is known now")
        self.assertNotIn([], self.known, "somebody is known all the time")
        self.assertEqual(self.heard, [""], "who keeps the face until then")

    def test_who_is_known_before_being_seen_stays_known_while_the_topics_are_opened(self):
        seen, self.snapshot = self.snapshot, Snapshot((), (), ("ann",))
        wait_for(lambda: self.update() and self.known[-1:] == [["ann"]], 20, "who is in the store")
        del self.known[:]
        self.snapshot = seen
        wait_for(lambda: self.update() and self.listed[-1:] == [["ann"]] and self.known, 20, "the person is seen")
        self.assertNotIn([], self.known)

    def test_a_name_that_has_no_topic_yet_is_said_later(self):
        wait_for(lambda: self.update() and self.listed[-1:] == [["ann"]] and "f1" in self.heard, 20, "the person")
        self.register.seen(["ann"], time.time())
        self.register.set_name("ann", "Ann")
        self.fails()
        wait_for(lambda: self.update() and "Ann" in self.heard, 20, lambda: "the name; heard {}".format(self.heard))


if __name__ == "__main__":
    prepare_rospy()     # as all nodes do: a connection that found no descriptor would end rospy's server for good
    rospy.init_node("person_topics_test")
    rostest.rosrun("hri_person_manager", "person_topics", PersonTopicsTest)
