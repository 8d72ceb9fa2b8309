#!/usr/bin/env python3
"""Subscribers of ids with honest and with hostile lists of ids."""

import os
import signal
import subprocess
import sys
import threading
import time
import unittest

import rospy
import rostest
from sensor_msgs.msg import Image
from std_msgs.msg import String

from hri_msgs.msg import IdsList
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.testing import held_by, wait_for, without_descriptors

CAMERA = """
import sys, rospy
from hri_msgs.msg import IdsList
rospy.init_node("other_camera", anonymous=True, disable_signals=True)
publisher = rospy.Publisher("/humans/voices/tracked", IdsList, latch=True, queue_size=1)
publisher.publish(IdsList(ids=sys.argv[1:]))
print("published", flush=True)
sys.stdin.readline()
publisher.unregister()
sys.stdin.readline()
"""


class IdSubscribersTest(unittest.TestCase):

    def setUp(self):
        self.heard = []
        self.lists = []
        self.publisher = rospy.Publisher("/humans/voices/tracked", IdsList, queue_size=100)
        self.addCleanup(self.publisher.unregister)

    def feed(self, **arguments):
        feed = IdSubscribers("voices", {"speech": String}, self.on_message, self.lists.append, **arguments)
        self.addCleanup(feed.close)
        wait_for(self.publisher.get_num_connections, 10, "the feed listens")
        return feed

    def on_message(self, identity, name, message):
        if message.data == "raise":
            raise RuntimeError("on purpose")
        self.heard.append((identity, name, message.data))

    def say(self, *ids):
        self.publisher.publish(IdsList(ids=list(ids)))

    def test_messages_of_the_living_only(self):
        feed = self.feed()
        speaker = rospy.Publisher("/humans/voices/aaaaa/speech", String, queue_size=10)
        self.addCleanup(speaker.unregister)
        self.say("aaaaa", "bbbbb")
        wait_for(speaker.get_num_connections, 10, "the feed subscribes to aaaaa")
        speaker.publish("hello")
        wait_for(lambda: self.heard == [("aaaaa", "speech", "hello")], 10, "the message comes with its id and topic")
        self.assertEqual(feed.ids, ["aaaaa", "bbbbb"])
        self.assertEqual(feed.status()[0], OK)
        self.say("bbbbb")
        wait_for(lambda: not speaker.get_num_connections(), 10, "the feed lets go of aaaaa")
        self.assertEqual(feed.ids, ["bbbbb"])
        wait_for(lambda: self.lists[-1] == ["bbbbb"], 10, "the listener is told")

    def test_hostile_ids_are_refused_counted_and_told(self):
        feed = self.feed()
        bad = ["", "1abc", "a b", "../../x", "a/b", "/etc", "~a", "x" * 5000, "a\n", "$(reboot)", "<x/>", "ä"]
        self.say(*(bad + ["aaaaa", "aaaaa"]))
        wait_for(lambda: feed.ids == ["aaaaa"], 10, "the good id is followed")
        level, message, values = feed.status()
        self.assertEqual((level, values["refused"]), (WARN, len(bad)))
        self.assertIn("refused", message)
        self.assertIn(rospy.get_name(), message)
        self.assertLess(len(message), 200)
        topics = [topic for topic, _ in rospy.get_published_topics()]
        self.assertFalse([topic for topic in topics if "reboot" in topic or "etc" in topic])

    def burst(self, kind, messages, heard, **arguments):
        """Follow a topic with a slow callback and send these messages at once; return what was heard after a while."""
        feed = IdSubscribers("voices", {"told": kind}, lambda *told: (time.sleep(0.02), heard.append(told[2])),
                             **arguments)
        self.addCleanup(feed.close)
        speaker = rospy.Publisher("/humans/voices/aaaaa/told", kind, queue_size=100)
        self.addCleanup(speaker.unregister)
        wait_for(self.publisher.get_num_connections, 10, "the feed listens")
        self.say("aaaaa")
        wait_for(speaker.get_num_connections, 10, "the feed subscribes to aaaaa")
        for message in messages:
            speaker.publish(message)
        wait_for(lambda: heard and heard[-1] == messages[-1], 10, "the last message")
        return heard

    def test_who_wants_each_message_of_a_burst_gets_it(self):
        words = [String(str(number)) for number in range(40)]
        self.assertEqual(self.burst(String, words, [], queue_size=50), words)

    def test_of_images_no_backlog_waits(self):
        images = [Image(height=1, width=number + 1) for number in range(40)]
        self.assertLess(len(self.burst(Image, images, [], queue_size=50)), 20)

    def test_a_flood_of_ids_is_cut(self):
        feed = self.feed(max_ids=5)
        self.say(*["flood{}".format(n) for n in range(3000)])
        wait_for(lambda: len(feed.ids) == 5, 10, "five are followed")
        self.assertEqual(feed.ids, ["flood{}".format(n) for n in range(5)])
        self.assertEqual(feed.status()[2]["beyond_limit"], 2995)

    def test_a_callback_that_raises_is_counted(self):
        feed = self.feed()
        speaker = rospy.Publisher("/humans/voices/ccccc/speech", String, queue_size=10)
        self.addCleanup(speaker.unregister)
        self.say("ccccc")
        wait_for(speaker.get_num_connections, 10, "the feed subscribes")
        speaker.publish("raise")
        # the feed keeps the newest message only: one at a time
        wait_for(lambda: feed.status()[2]["errors"] == 1, 10, "the first message has failed")
        speaker.publish("fine")
        wait_for(lambda: self.heard == [("ccccc", "speech", "fine")], 10, "the next message is used")
        self.assertEqual((feed.status()[0], feed.status()[2]["errors"]), (WARN, 1))

    def camera(self, *ids):
        """Start another node that lists these ids once, and then has nothing to say."""
        camera = subprocess.Popen([sys.executable, "-c", CAMERA, *ids], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self.addCleanup(self.end, camera)
        self.assertEqual(camera.stdout.readline(), b"published\n")
        return camera

    @staticmethod
    def end(process):
        process.kill()
        process.communicate()

    def holds(self, feed, ids, seconds):
        """The ids are followed all the time, and nothing else is told."""
        told = len(self.lists)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.assertEqual(feed.ids, ids)
            time.sleep(0.05)
        self.assertEqual([other for other in self.lists[told:] if other != ids], [])

    def test_the_list_of_a_publisher_that_has_nothing_new_to_say_stays(self):
        feed = self.feed()
        self.camera("aaaaa")
        wait_for(lambda: feed.ids == ["aaaaa"], 10, "followed")
        self.holds(feed, ["aaaaa"], 12.0)

    def test_a_list_ends_when_its_publisher_takes_the_topic_back(self):
        feed = self.feed()
        camera = self.camera("aaaaa")
        wait_for(lambda: feed.ids == ["aaaaa"], 10, "followed")
        camera.stdin.write(b"\n")
        camera.stdin.flush()
        wait_for(lambda: feed.ids == [] and self.lists[-1] == [], 5, "let go; the node is still there")
        self.assertIsNone(camera.poll())

    def test_a_list_ends_when_its_publisher_is_killed(self):
        feed = self.feed()
        camera = self.camera("aaaaa")
        wait_for(lambda: feed.ids == ["aaaaa"], 10, "followed")
        camera.kill()
        wait_for(lambda: feed.ids == [] and self.lists[-1] == [], 8, "let go")

    def test_a_publisher_that_does_not_answer_for_long_is_set_aside_until_it_does(self):
        feed = self.feed(unanswered=2.0)
        camera = self.camera("aaaaa")
        wait_for(lambda: feed.ids == ["aaaaa"], 10, "followed")
        camera.send_signal(signal.SIGSTOP)
        wait_for(lambda: feed.ids == [] and self.lists[-1] == [], 20, "set aside: nothing comes, nobody answers")
        camera.send_signal(signal.SIGCONT)
        wait_for(lambda: feed.ids == ["aaaaa"] and self.lists[-1] == ["aaaaa"], 20, "it answers: its list holds again")

    def test_a_connection_that_breaks_is_made_again(self):
        feed = self.feed()
        self.say("aaaaa")
        wait_for(lambda: feed.ids == ["aaaaa"], 10, "followed")
        for _ in range(3):
            broken = self.publisher.impl.connections[0]
            broken.close()
            wait_for(lambda broken=broken: self.publisher.impl.connections not in ([], [broken]), 15, "connected again")
            self.assertEqual(feed.ids, ["aaaaa"])
        self.assertNotIn([], self.lists)
        self.say("bbbbb")
        wait_for(lambda: feed.ids == ["bbbbb"], 10, "what it says is heard")

    def test_a_list_that_is_not_repeated_for_list_timeout_ends(self):
        feed = self.feed(list_timeout=0.5)
        self.say("aaaaa")
        wait_for(lambda: feed.ids == ["aaaaa"], 10, "followed")
        wait_for(lambda: feed.ids == [] and self.lists[-1] == [], 10, "let go after the time-out")

    def test_the_lists_of_two_cameras_are_joined(self):
        feed = self.feed()
        self.say("aaaaa", "bbbbb")
        wait_for(lambda: feed.ids == ["aaaaa", "bbbbb"], 10, "the first camera's are followed")
        self.camera("ccccc", "bbbbb")
        wait_for(lambda: feed.ids == ["aaaaa", "bbbbb", "ccccc"], 20, "the second camera's are followed as well")
        self.say("bbbbb")
        wait_for(lambda: feed.ids == ["bbbbb", "ccccc"], 10, "what the first camera lets go of goes")
        wait_for(lambda: self.lists[-1] == ["bbbbb", "ccccc"], 10, "the listener is told")

    def test_lists_of_two_publishers_are_told_in_the_order_in_which_they_came(self):
        owner, told = threading.Lock(), []

        def take(ids):
            with owner:
                told.append(ids)

        feed = IdSubscribers("voices", {}, self.on_message, take)
        self.addCleanup(feed.close)
        interval = sys.getswitchinterval()
        sys.setswitchinterval(1e-6)
        self.addCleanup(sys.setswitchinterval, interval)
        # As rospy does it: a thread for each connection.
        cameras = [threading.Thread(target=self.count, args=(feed, owner, name)) for name in ("a", "b")]
        for camera in cameras:
            camera.start()
        for camera in cameras:
            camera.join()
        wait_for(lambda: sorted(told[-1]) == ["a3999", "b3999"], 10, lambda: "the end; told " + str(told[-1]))
        for name in ("a", "b"):
            counts = [int(identity[1:]) for ids in told for identity in ids if identity[0] == name]
            stale = [later for earlier, later in zip(counts, counts[1:]) if later < earlier]
            self.assertEqual(stale, [])
            self.assertGreater(len(set(counts)), 5, "told often enough for a stale one to come between")

    @staticmethod
    def count(feed, owner, name):
        for number in range(4000):
            message = IdsList(ids=[name + str(number)])
            message._connection_header = {"callerid": "/camera_" + name}
            feed._on_list(message)
            with owner:
                len(feed.ids)

    def test_without_descriptors_nobody_is_half_followed(self):
        feed = self.feed()
        self.say("aaaaa")
        # It is in `ids` before its topic is open.
        wait_for(lambda: feed._subscribers.get("aaaaa"), 10, "followed")
        with without_descriptors():
            self.say("aaaaa", "bbbbb")
            wait_for(lambda: feed.status()[2]["errors"], 10, "a failure is counted")
            self.assertEqual(feed.ids, ["aaaaa"])
            self.assertIn("descriptor", feed.status()[1])
        wait_for(lambda: feed.ids == ["aaaaa", "bbbbb"], 10, "followed later, without another list")

    def test_churn_leaves_no_descriptors(self):
        feed = self.feed()
        before = held_by(os.getpid())
        for start in range(0, 1000, 20):
            ids = ["churn{}".format(n) for n in range(start, start + 20)]
            self.say(*ids)
            wait_for(lambda ids=ids: feed.ids == ids, 10, "followed")
        self.say()
        wait_for(lambda: feed.ids == [], 10, "all gone")
        wait_for(lambda: held_by(os.getpid()).descriptors <= before.descriptors + 3, 10, "descriptors are back")
        wait_for(lambda: held_by(os.getpid()).threads <= before.threads + 2, 10, "threads are back")

    def test_close_is_final(self):
        feed = self.feed()
        self.say("aaaaa")
        wait_for(lambda: feed.ids, 10, "followed")
        feed.close()
        feed.close()
        self.assertEqual(feed.ids, [])
        self.assertEqual(feed.status()[0], WARN)
        with self.assertRaises(ValueError):
            IdSubscribers("voices", {}, self.on_message, max_ids=0)
        with self.assertRaises(ValueError):
            IdSubscribers("voices", {}, self.on_message, queue_size=0)


if __name__ == "__main__":
    rospy.init_node("id_subscribers_test")
    rostest.rosrun("hri_pipeline", "id_subscribers", IdSubscribersTest)
