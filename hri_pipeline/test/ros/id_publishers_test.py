#!/usr/bin/env python3
"""Topics of 800 ids are opened and closed; descriptors, threads and memory stay where they were."""

import os
import socket
import threading
import unittest

import rosgraph
import rospy
import rostest
from rospy.impl.tcpros_base import TCPROSTransport
from rospy.impl.tcpros_pubsub import QueuedConnection, TCPROSPub
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import String

from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.ros import rospy_compat
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec, TrackedList
from hri_pipeline.ros.rospy_compat import reconnect_to_returning_publishers
from hri_pipeline.ros.tcpros import send_at_once
from hri_pipeline.testing import held_by, pid_of, wait_for, without_descriptors

IDS, WARMING = 800, 200
TOGETHER = 20
TOPICS = {"roi": TopicSpec(RegionOfInterest), "name": TopicSpec(String, latch=True)}


class IdPublishersTest(unittest.TestCase):

    def setUp(self):
        self.publishers = IdPublishers("/humans/faces", TOPICS)

    def tearDown(self):
        self.publishers.close_all()

    def test_800_ids_leave_nothing_behind(self):
        received = set()
        answers = rospy.Subscriber("/id_listener/received", String, lambda message: received.add(message.data))
        listener = wait_for(lambda: self.listener_pid(), 20, "the listener is there")
        wait_for(lambda: answers.get_num_connections(), 20, "the listener's answers are connected: none is latched")
        tracked = TrackedList("/humans/faces/tracked")
        generator = IdGenerator()
        self.churn(generator, tracked, received, WARMING)      # rospy and malloc find their working size
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
            self.assertLess(now.rss_mb - old.rss_mb, 4.0)
        self.assertEqual(len([name for name in received if name.endswith("/name")]), IDS + WARMING)

    def test_who_comes_late_is_greeted_once(self):
        publishers = IdPublishers("/humans/bodies", {"name": TopicSpec(String, greet=True)})
        self.addCleanup(publishers.close_all)
        publishers.open("abcde")
        publishers.publish("abcde", "name", String("early"))
        heard = []

        def listen():
            subscriber = rospy.Subscriber("/humans/bodies/abcde/name", String, lambda message: heard.append(
                (message.data, message._connection_header.get("latching"))))
            wait_for(lambda: publishers.has_subscribers("abcde", "name"), 20, "a subscriber")
            return subscriber

        first = listen()
        wait_for(lambda: heard == [("early", "0")], 20, "the greeting")
        first.unregister()
        wait_for(lambda: not publishers.has_subscribers("abcde", "name"), 20, "nobody")
        again = listen()
        publishers.publish("abcde", "name", String("new"))
        wait_for(lambda: heard[1:], 20, "the next message")
        self.assertEqual(heard[1:], [("new", "0")])
        again.unregister()

    def test_changes_of_a_state_in_quick_succession_all_arrive(self):
        send_at_once()      # as all nodes do
        heard = []
        subscriber = rospy.Subscriber("/humans/faces/abcde/name", String, lambda message: heard.append(message.data))
        self.addCleanup(subscriber.unregister)
        self.publishers.open("abcde")
        wait_for(lambda: self.publishers.has_subscribers("abcde", "name"), 20, "a subscriber")
        changes = [str(number) for number in range(10)]
        for change in changes:
            self.publishers.publish("abcde", "name", String(change))
        wait_for(lambda: heard and heard[-1] == changes[-1], 20, "the last change")
        self.assertEqual(heard, changes)

    def connection(self, topic, node):
        """A connection as rospy's server makes one, and its other end."""
        ours, theirs = socket.socketpair()
        transport = TCPROSTransport(TCPROSPub(topic.resolved_name, RegionOfInterest), topic.resolved_name)
        transport.set_socket(ours, node)
        return transport, theirs

    def senders(self):
        """Threads of connections; those in which rospy answers the master come and go as the master likes."""
        return {thread for thread in threading.enumerate()
                if isinstance(getattr(getattr(thread, "_target", None), "__self__", None), QueuedConnection)}

    def assert_left_alone(self, before, ends):
        """No thread of theirs is left, and their other ends are told."""
        wait_for(lambda: not self.senders() - before, 20,
                 lambda: "these threads end: {}".format(self.senders() - before))
        for end in ends:
            self.assertEqual(end.recv(1), b"")
            end.close()

    def test_who_connects_to_a_topic_that_is_just_closed_leaves_no_thread(self):
        """As rospy's server does: it looks the topic up, shakes hands, and adds the connection, whatever has
        happened."""
        self.publishers.open("abcde")
        topic = self.publishers._open["abcde"]["roi"].impl
        add = topic.add_connection
        before = self.senders()
        ends = []

        def connect(how):
            transport, end = self.connection(topic, "/late")
            ends.append(end)
            how(transport)

        connect(add)
        self.assertEqual(len(self.senders() - before), 1)
        self.publishers.close("abcde")
        for _ in range(5):
            connect(add)
            connect(topic.add_connection)
        self.assert_left_alone(before, ends)

    def test_connections_while_topics_are_closed_leave_no_thread(self):
        before = self.senders()
        ends = []

        def connect(topic):
            transport, end = self.connection(topic, "/racer{}".format(threading.get_ident()))
            ends.append(end)
            topic.add_connection(transport)

        for number in range(100):
            identity = "race{}".format(number)
            self.publishers.open(identity)
            topic = self.publishers._open[identity]["roi"].impl
            racers = [threading.Thread(target=connect, args=(topic,)) for _ in range(4)]
            for racer in racers:
                racer.start()
            self.publishers.close(identity)
            for racer in racers:
                racer.join()
        self.publishers.close_all()     # 200 questions to the master: on a busy machine they take their time
        self.assert_left_alone(before, ends)

    def churn(self, generator, tracked, received, count):
        """Open, publish, be heard, and close `count` ids, TOGETHER at a time."""
        peak = 0
        for start in range(0, count, TOGETHER):
            ids = [generator.new() for _ in range(TOGETHER)]
            for identity in ids:
                self.publishers.open(identity)
                self.assertTrue(self.publishers.publish(identity, "name", String("x")))
            tracked.set(ids, float(start + 1))
            wait_for(lambda ids=ids: all(identity + "/name" in received for identity in ids), 20,
                     "latched names are heard")
            wait_for(lambda ids=ids: all(self.publishers.has_subscribers(identity, "roi") for identity in ids), 20,
                     "roi connects")
            peak = max(peak, held_by(os.getpid()).descriptors)
            for identity in ids:
                self.assertTrue(self.publishers.publish(identity, "roi", RegionOfInterest()))
                self.publishers.close(identity)
        tracked.set([], float(count + 1))
        print("{} ids, at most {} descriptors".format(count, peak))
        self.assertLess(peak, 400)

    def held(self, listener):
        """What both processes hold once the listener has let go of all faces."""
        graph = rosgraph.Master("/id_publishers_test")
        wait_for(lambda: not [topic for topic, nodes in graph.getSystemState()[1]
                              if "/id_listener" in nodes and topic.startswith("/humans/faces/")
                              and topic != "/humans/faces/tracked"], 20, "the listener lets go")
        return held_by(os.getpid()), held_by(listener)

    def listener_pid(self):
        try:
            return pid_of("/id_listener")
        except Exception:
            return None

    def test_a_closed_id_takes_no_message_and_can_be_opened_again(self):
        self.publishers.open("abcde")
        self.publishers.open("abcde")
        self.assertEqual(self.publishers.ids, ["abcde"])
        self.publishers.close("abcde")
        self.publishers.close("abcde")
        self.assertFalse(self.publishers.publish("abcde", "roi", RegionOfInterest()))
        self.assertFalse(self.publishers.has_subscribers("abcde", "roi"))
        self.publishers.open("abcde")
        self.assertTrue(self.publishers.publish("abcde", "roi", RegionOfInterest()))
        with self.assertRaises(KeyError):
            self.publishers.publish("abcde", "rio", RegionOfInterest())

    def test_an_id_that_comes_again_at_once_keeps_its_topics(self):
        heard = []
        subscriber = rospy.Subscriber("/humans/faces/again/name", String, lambda message: heard.append(message.data))
        for number in range(50):
            self.publishers.open("again")
            self.publishers.publish("again", "name", String(str(number)))       # latched: who connects later hears it
            if number < 49:
                self.publishers.close("again")
        wait_for(lambda: "49" in heard, 20, lambda: "the last one; heard {}".format(heard))
        subscriber.unregister()

    def test_who_comes_back_is_heard_by_a_subscriber_whose_connection_had_ended_before_it_began(self):
        """rospy finds nobody at the topic, and keeps that connection in its list for ever."""
        begun, heard = [], []

        def connect(connection, *others):
            begun.append(connection)
            if len(begun) == 1:
                connection.done = True      # as rospy does
            else:
                real(connection, *others)
        real, rospy_compat._robust_connect = rospy_compat._robust_connect, connect
        self.addCleanup(setattr, rospy_compat, "_robust_connect", real)
        self.publishers.open("back")
        self.publishers.publish("back", "name", String("here"))
        subscriber = rospy.Subscriber("/humans/faces/back/name", String, lambda message: heard.append(message.data))
        wait_for(lambda: heard == ["here"], 20, lambda: "the name; connections {}".format(len(begun)))
        subscriber.unregister()

    def test_when_all_are_closed_the_master_knows(self):
        for number in range(20):
            self.publishers.open("one{}".format(number))
        self.publishers.close_all()
        published = rosgraph.Master("/id_publishers_test").getSystemState()[0]
        self.assertEqual([topic for topic, _ in published if topic.startswith("/humans/faces/one")], [])

    def test_without_descriptors_no_topic_is_open_and_later_all_are(self):
        for left in (0, 1):
            with without_descriptors(left), self.assertRaises(OSError):
                self.publishers.open("late")
            self.assertEqual(self.publishers.ids, [])
            self.assertFalse(self.publishers.publish("late", "name", String("nobody")))
        self.publishers.open("late")
        heard = []
        subscriber = rospy.Subscriber("/humans/faces/late/name", String, lambda message: heard.append(message.data))
        self.publishers.publish("late", "name", String("here"))
        wait_for(lambda: heard == ["here"], 20, "the name")
        subscriber.unregister()

    def test_what_is_not_an_id_is_refused(self):
        for text in ("", "1abc", "../x", "a b", "x" * 33, None):
            with self.assertRaises(ValueError):
                self.publishers.open(text)
        self.assertEqual(self.publishers.ids, [])

    def test_two_owners_of_one_topic_do_not_disturb_each_other(self):
        other = IdPublishers("/humans/faces", TOPICS)
        other.open("twice")
        self.publishers.open("twice")
        heard = []
        subscriber = rospy.Subscriber("/humans/faces/twice/name", String, heard.append)
        self.publishers.close("twice")
        other.publish("twice", "name", String("still here"))
        wait_for(lambda: heard, 10, "the other owner is heard")
        subscriber.unregister()
        other.close_all()


if __name__ == "__main__":
    reconnect_to_returning_publishers()       # as all nodes do
    rospy.init_node("id_publishers_test")
    rostest.rosrun("hri_pipeline", "id_publishers", IdPublishersTest)
