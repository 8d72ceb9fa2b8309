#!/usr/bin/env python3
"""The feature feed with honest and with hostile lists of ids."""

import os
import subprocess
import unittest

import rospy
import rostest
from std_msgs.msg import String

from hri_msgs.msg import IdsList
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.feature_feed import FeatureFeed
from hri_pipeline.testing import held_by, wait_for


class FeatureFeedTest(unittest.TestCase):

    def setUp(self):
        self.heard = []
        self.lists = []
        self.publisher = rospy.Publisher("/humans/voices/tracked", IdsList, queue_size=100)
        self.addCleanup(self.publisher.unregister)

    def feed(self, **arguments):
        feed = FeatureFeed("voices", {"speech": String}, self.on_message, self.lists.append, **arguments)
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
        self.assertLess(len(message), 200)
        topics = [topic for topic, _ in rospy.get_published_topics()]
        self.assertFalse([topic for topic in topics if "reboot" in topic or "etc" in topic])

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

    def test_a_list_that_falls_silent_is_taken_as_empty(self):
        feed = self.feed(silence=0.5)
        self.say("aaaaa")
        wait_for(lambda: feed.ids == ["aaaaa"], 10, "followed")
        wait_for(lambda: feed.ids == [] and self.lists[-1] == [], 10, "let go after the silence")

    def test_the_lists_of_two_cameras_are_joined(self):
        feed = self.feed()
        self.say("aaaaa", "bbbbb")
        wait_for(lambda: feed.ids == ["aaaaa", "bbbbb"], 10, "the first camera's are followed")
        other = subprocess.Popen(["rostopic", "pub", "--once", "/humans/voices/tracked", "hri_msgs/IdsList",
                                  "{ids: [ccccc, bbbbb]}"])
        self.addCleanup(other.wait)
        wait_for(lambda: feed.ids == ["aaaaa", "bbbbb", "ccccc"], 20, "the second camera's are followed as well")
        self.say("bbbbb")
        wait_for(lambda: feed.ids == ["bbbbb", "ccccc"], 10, "what the first camera lets go of goes")
        wait_for(lambda: self.lists[-1] == ["bbbbb", "ccccc"], 10, "the listener is told")

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
            FeatureFeed("voices", {}, self.on_message, max_ids=0)


if __name__ == "__main__":
    rospy.init_node("feature_feed_test")
    rostest.rosrun("hri_pipeline", "feature_feed", FeatureFeedTest)
