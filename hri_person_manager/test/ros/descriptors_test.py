#!/usr/bin/env python3
"""Many persons, and a node that may not have many descriptors."""

import signal
import subprocess
import unittest
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_msgs.msg import Bool, Float32, String

from hri_msgs.msg import IdsList
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.testing import held_by, wait_for

NODE = "hri_person_manager"
TOPICS = {"face_id": String, "body_id": String, "voice_id": String, "location_confidence": Float32, "anonymous": Bool,
          "alias": String}
ADVERTISED = {*TOPICS, "position"}      # which tells nothing of persons without a place
MOST = 200      # features of a kind that the node takes


class DescriptorsTest(unittest.TestCase):

    def setUp(self):
        self.persons, self.statuses, self.heard = [], {}, set()
        for topic, kind, take in (("/humans/persons/tracked", IdsList, self.take_list),
                                  ("/diagnostics", DiagnosticArray, self.take_diagnostics)):
            subscriber = rospy.Subscriber(topic, kind, take, queue_size=100)
            self.addCleanup(subscriber.unregister)
        self.faces = rospy.Publisher("/humans/faces/tracked", IdsList, latch=True, queue_size=10)
        self.addCleanup(self.faces.unregister)

    def take_list(self, message):
        self.persons = list(message.ids)

    def take_diagnostics(self, message):
        self.statuses.update((status.name.split(": ")[1], status) for status in message.status)

    def start(self, soft, hard):
        node = subprocess.Popen(["prlimit", "--nofile={}:{}".format(soft, hard), "rosrun", "hri_person_manager",
                                 "person_manager", "__name:=" + NODE, "_new_person_delay:=0.1"])
        self.addCleanup(self.end, node)
        wait_for(lambda: "persons" in self.statuses, 60, "the node is there")
        return node

    def end(self, node):
        node.send_signal(signal.SIGINT)
        try:
            self.assertEqual(node.wait(30), 0)
        finally:
            node.kill()

    def listen(self):
        feed = IdSubscribers("persons", TOPICS, lambda person, name, message: self.heard.add((person, name)),
                             max_ids=MOST)
        self.addCleanup(feed.close)
        return feed

    def advertised(self):
        """{person: names of its topics}, as the master knows them."""
        found = {}
        for topic, nodes in rosgraph.Master("/descriptors_test").getSystemState()[0]:
            person, _, name = topic[len("/humans/persons/"):].partition("/")
            if "/" + NODE in nodes and topic.startswith("/humans/persons/") and name:
                found.setdefault(person, set()).add(name)
        return found

    def show(self, count):
        self.faces.publish(IdsList(ids=["face{}".format(number) for number in range(count)]))

    def test_two_hundred_persons_with_the_usual_limit(self):
        node = self.start(256, 1024)
        self.show(MOST)
        wait_for(lambda: len(self.persons) == MOST, 60, lambda: "{} persons, not {}".format(len(self.persons), MOST))
        self.assertEqual(self.advertised(), dict.fromkeys(self.persons, ADVERTISED))
        self.assertEqual(self.statuses["persons"].level, DiagnosticStatus.OK)
        # No descriptor for a topic that nobody listens to.
        self.assertLess(held_by(node.pid).descriptors, MOST)

    def test_without_descriptors_persons_wait_and_the_node_still_hears(self):
        limit, count = 160, 60
        node = self.start(limit, limit)
        feed = self.listen()
        self.show(count // 2)
        wait_for(lambda: "file descriptors" in self.statuses, 60, "whoever listens has taken all that there are")
        self.assertEqual(self.statuses["file descriptors"].level, DiagnosticStatus.WARN)
        self.show(count)
        wait_for(lambda: self.statuses["persons"].level == DiagnosticStatus.ERROR, 60, "those who come have to wait")
        text = self.statuses["persons"].message
        for word in ("persons are not published", str(limit), "ulimit -Hn"):
            self.assertIn(word, text)
        listed, advertised = list(self.persons), self.advertised()
        self.assertTrue(0 < len(listed) < count, len(listed))
        self.assertEqual([person for person in listed if not advertised.get(person, set()) >= ADVERTISED], [])
        self.assertLess(held_by(node.pid).descriptors, limit)
        uri = rosgraph.Master("/descriptors_test").lookupNode("/" + NODE)
        self.assertEqual(ServerProxy(uri).getPid("/descriptors_test")[0], 1)
        # Those who wait have their turn when others leave.
        feed.close()
        wait_for(lambda: len(self.persons) == count, 60, lambda: "{} persons, not {}".format(len(self.persons), count))
        wait_for(lambda: self.statuses["persons"].level == DiagnosticStatus.OK, 10, "all is well")
        self.assertEqual(self.advertised(), dict.fromkeys(self.persons, ADVERTISED))
        self.show(3)
        wait_for(lambda: len(self.persons) == 3, 60, "three stay: " + str(len(self.persons)))
        self.heard.clear()
        self.listen()
        wait_for(lambda: self.heard == {(person, name) for person in self.persons for name in TOPICS}, 30,
                 lambda: "connections are taken again; heard {}".format(sorted(self.heard)))


if __name__ == "__main__":
    rospy.init_node("descriptors_test")
    rostest.rosrun("hri_person_manager", "descriptors", DescriptorsTest)
