#!/usr/bin/env python3
"""The tracked list: latched, on every change, once a second, empty at the end; diagnostics and TF beside it."""

import time
import unittest

import genpy
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import transform_to_msg
from hri_pipeline.ros.diagnostics import ERROR, MAX_TEXT, OK, NodeDiagnostics
from hri_pipeline.ros.publishers import TrackedList
from hri_pipeline.ros.tf import TfPublisher
from hri_pipeline.testing import wait_for

TOPIC = "/humans/bodies/tracked"


class TrackedListTest(unittest.TestCase):

    def listen(self, topic, kind):
        heard = []
        subscriber = rospy.Subscriber(topic, kind, lambda message: heard.append((time.monotonic(), message)))
        self.addCleanup(subscriber.unregister)
        return heard

    def test_life_of_a_list(self):
        tracked = TrackedList(TOPIC)
        tracked.set(["abcde"], genpy.Time(12, 34))
        heard = self.listen(TOPIC, IdsList)
        wait_for(lambda: heard, 10, "the latched list reaches a late subscriber")
        self.assertEqual(heard[-1][1].ids, ["abcde"])
        self.assertEqual(heard[-1][1].header.stamp, genpy.Time(12, 34))

        count = len(heard)
        wait_for(lambda: len(heard) >= count + 3, 10, "the list comes again and again while the clock stands still")
        gaps = [later[0] - earlier[0] for earlier, later in zip(heard[count:], heard[count + 1:])]
        self.assertTrue(all(0.5 < gap < 1.5 for gap in gaps), gaps)

        tracked.clear()
        wait_for(lambda: heard[-1][1].ids == [], 10, "nobody")
        self.assertEqual(heard[-1][1].header.stamp, genpy.Time(12, 34))

        start = time.monotonic()
        tracked.set(["abcde", "fghij"], 13.0)
        wait_for(lambda: heard[-1][1].ids == ["abcde", "fghij"], 10, "a change is published")
        self.assertLess(time.monotonic() - start, 0.5)
        for bad in ("a/b", "", "9lives"):
            with self.assertRaises(ValueError):
                tracked.set(["abcde", bad], 14.0)
        tracked.close()
        wait_for(lambda: heard[-1][1].ids == [], 10, "the empty list at the end")
        tracked.close()
        tracked.set(["abcde"], 15.0)
        self.assertEqual(heard[-1][1].ids, [])

    def test_diagnostics(self):
        diagnostics = NodeDiagnostics("some_node", period=0.1)
        heard = self.listen("/diagnostics", DiagnosticArray)
        diagnostics.set("input", OK, "fine", {"rate": 14.98765, "n": 3})
        frame = "f" * 50000
        diagnostics.set("output", ERROR, "no transform to {}, see elsewhere".format(frame), {"frame": frame, frame: 1})

        def both():
            return [m for _, m in heard if len(m.status) == 2]

        status = wait_for(both, 10, "a message with both tasks")[-1].status
        self.assertEqual([s.name for s in status], ["some_node: input", "some_node: output"])
        self.assertEqual([s.level for s in status], [0, 2])
        self.assertEqual([(v.key, v.value) for v in status[0].values], [("rate", "14.99"), ("n", "3")])
        self.assertEqual(status[0].hardware_id, rospy.get_name())
        self.assertTrue(status[1].message.startswith("no transform to fff"))
        self.assertTrue(status[1].message.endswith("fff, see elsewhere"))
        texts = [status[1].message] + [text for value in status[1].values for text in (value.key, value.value)]
        self.assertTrue(all(len(text) <= MAX_TEXT for text in texts))
        diagnostics.close()
        diagnostics.close()

    def test_tf(self):
        publisher = TfPublisher()
        heard = self.listen("/tf", TFMessage)
        wait_for(lambda: publisher._publisher.get_num_connections(), 10, "a listener on /tf")

        def transform(child, stamp, x=0.0):
            return transform_to_msg(Pose.from_quaternion((0, 0, 0, 1), (x, 0, 0)), stamp, "camera", child)

        publisher.send([transform("face_a", 1.0), transform("face_b", 1.0)])
        publisher.send([transform("face_a", 1.0), transform("face_c", 1.0, float("nan"))])
        publisher.send([])
        publisher.send([transform("face_a", 2.0), transform("face_b", 1.0)])
        wait_for(lambda: len(heard) >= 2, 10, "two messages")
        self.assertEqual([[t.child_frame_id for t in m.transforms] for _, m in heard],
                         [["face_a", "face_b"], ["face_a"]])
        self.assertEqual(publisher.dropped, 3)
        publisher.close()
        publisher.close()


if __name__ == "__main__":
    rospy.init_node("tracked_list_test")
    rostest.rosrun("hri_pipeline", "tracked_list", TrackedListTest)
