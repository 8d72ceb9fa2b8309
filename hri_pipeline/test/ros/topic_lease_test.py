#!/usr/bin/env python3
"""Topics of 2,000 ids are opened and closed; descriptors, threads and memory stay where they were."""

import os
import unittest

import rosgraph
import rospy
import rostest
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import String
from waiting import held_by, pid_of, wait_for

from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.ros.topic_lease import TopicLeases, TopicSpec
from hri_pipeline.ros.tracked_list import TrackedList

IDS = 2000
TOGETHER = 20
TOPICS = {"roi": TopicSpec(RegionOfInterest), "name": TopicSpec(String, latch=True)}


class TopicLeaseTest(unittest.TestCase):

    def setUp(self):
        self.leases = TopicLeases("/humans/faces", TOPICS)

    def tearDown(self):
        self.leases.close_all()

    def test_2000_ids_leave_nothing_behind(self):
        received = set()
        rospy.Subscriber("/lease_listener/received", String, lambda message: received.add(message.data))
        listener = wait_for(lambda: self.listener_pid(), 20, "the listener is there")
        tracked = TrackedList("/humans/faces/tracked")
        generator = IdGenerator()
        self.churn(generator, tracked, received, 400)      # rospy and malloc find their working size
        before = self.held(listener)
        self.churn(generator, tracked, received, IDS)
        wait_for(lambda: all(now.descriptors <= old.descriptors + 4 and now.threads <= old.threads + 2
                             for now, old in zip(self.held(listener), before)), 20,
                 "descriptors and threads are back at {}; now {}".format(before, self.held(listener)))
        after = self.held(listener)
        tracked.close()
        tracked.close()
        print("\npublisher {} -> {}\nlistener {} -> {}".format(before[0], after[0], before[1], after[1]))
        for now, old in zip(after, before):
            self.assertLess(now.rss_mb - old.rss_mb, 8.0)
        self.assertEqual(len([name for name in received if name.endswith("/name")]), IDS + 400)

    def test_who_comes_late_is_greeted_once(self):
        leases = TopicLeases("/humans/bodies", {"name": TopicSpec(String, greet=True)})
        self.addCleanup(leases.close_all)
        leases.open("abcde")
        leases.publish("abcde", "name", String("early"))
        heard = []

        def listen():
            subscriber = rospy.Subscriber("/humans/bodies/abcde/name", String, lambda message: heard.append(
                (message.data, message._connection_header.get("latching"))))
            wait_for(lambda: leases.has_subscribers("abcde", "name"), 20, "a subscriber")
            return subscriber

        first = listen()
        wait_for(lambda: heard == [("early", "0")], 20, "the greeting")
        first.unregister()
        wait_for(lambda: not leases.has_subscribers("abcde", "name"), 20, "nobody")
        again = listen()
        leases.publish("abcde", "name", String("new"))
        wait_for(lambda: heard[1:], 20, "the next message")
        self.assertEqual(heard[1:], [("new", "0")])
        again.unregister()

    def churn(self, generator, tracked, received, count):
        """Open, publish, be heard, and close `count` ids, TOGETHER at a time."""
        peak = 0
        for start in range(0, count, TOGETHER):
            ids = [generator.new() for _ in range(TOGETHER)]
            for identity in ids:
                self.leases.open(identity)
                self.assertTrue(self.leases.publish(identity, "name", String("x")))
            tracked.set(ids, float(start + 1))
            wait_for(lambda ids=ids: all(identity + "/name" in received for identity in ids), 20,
                     "latched names are heard")
            wait_for(lambda ids=ids: all(self.leases.has_subscribers(identity, "roi") for identity in ids), 20,
                     "roi connects")
            peak = max(peak, held_by(os.getpid()).descriptors)
            for identity in ids:
                self.assertTrue(self.leases.publish(identity, "roi", RegionOfInterest()))
                self.leases.close(identity)
        tracked.set([], float(count + 1))
        print("{} ids, at most {} descriptors".format(count, peak))
        self.assertLess(peak, 400)

    def held(self, listener):
        """What both processes hold once the listener has let go of all faces."""
        graph = rosgraph.Master("/topic_lease_test")
        wait_for(lambda: not [topic for topic, nodes in graph.getSystemState()[1]
                              if "/lease_listener" in nodes and topic.startswith("/humans/faces/")
                              and topic != "/humans/faces/tracked"], 20, "the listener lets go")
        return held_by(os.getpid()), held_by(listener)

    def listener_pid(self):
        try:
            return pid_of("/lease_listener")
        except Exception:
            return None

    def test_a_closed_id_takes_no_message_and_can_be_opened_again(self):
        self.leases.open("abcde")
        self.leases.open("abcde")
        self.assertEqual(self.leases.ids, ["abcde"])
        self.leases.close("abcde")
        self.leases.close("abcde")
        self.assertFalse(self.leases.publish("abcde", "roi", RegionOfInterest()))
        self.assertFalse(self.leases.has_subscribers("abcde", "roi"))
        self.leases.open("abcde")
        self.assertTrue(self.leases.publish("abcde", "roi", RegionOfInterest()))
        with self.assertRaises(KeyError):
            self.leases.publish("abcde", "rio", RegionOfInterest())

    def test_what_is_not_an_id_is_refused(self):
        for text in ("", "1abc", "../x", "a b", "x" * 33, None):
            with self.assertRaises(ValueError):
                self.leases.open(text)
        self.assertEqual(self.leases.ids, [])

    def test_two_owners_of_one_topic_do_not_disturb_each_other(self):
        other = TopicLeases("/humans/faces", TOPICS)
        other.open("twice")
        self.leases.open("twice")
        heard = []
        subscriber = rospy.Subscriber("/humans/faces/twice/name", String, heard.append)
        self.leases.close("twice")
        other.publish("twice", "name", String("still here"))
        wait_for(lambda: heard, 10, "the other owner is heard")
        subscriber.unregister()
        other.close_all()


if __name__ == "__main__":
    rospy.init_node("topic_lease_test")
    rostest.rosrun("hri_pipeline", "topic_lease", TopicLeaseTest)
