#!/usr/bin/env python3
"""A frame of the robot is looked up narrowly, whatever else is on /tf."""

import struct
import unittest

import numpy as np
import rospy
import rostest
from tf2_msgs.msg import TFMessage

from hri_pipeline.ros.tf import RobotTfListener, TfSubscriber
from hri_pipeline.testing import transform, wait_for

WAIT_S = 15.0


class Forger(rospy.Message):
    """Bytes that claim to be a TFMessage and are none."""

    __slots__ = ["data"]
    _type, _md5sum, _has_header = TFMessage._type, TFMessage._md5sum, False
    _full_text, _slot_types = TFMessage._full_text, []

    def serialize(self, buffer):
        buffer.write(self.data)


class RobotFramesTest(unittest.TestCase):

    def setUp(self):
        # Of each test alone: what is latched would reach the listener of the next one.
        self.static = rospy.Publisher("/tf_static", TFMessage, latch=True, queue_size=10)
        self.addCleanup(self.static.unregister)
        self.moving = rospy.Publisher("/tf", TFMessage, queue_size=100)
        self.addCleanup(self.moving.unregister)

    def feed(self):
        frames = RobotTfListener("map", own=True)
        self.addCleanup(frames.close)
        wait_for(lambda: self.moving.get_num_connections() and self.static.get_num_connections(), WAIT_S, "listeners")
        return frames

    def test_fixed_and_moving_frames_make_the_way_and_skeletons_are_not_kept(self):
        frames = self.feed()
        self.static.publish(TFMessage([transform("map", "base", rospy.Time.now(), z=1.0)]))

        def seen():
            stamp = rospy.Time.now()
            self.moving.publish(TFMessage(
                [transform("base", "camera", stamp, z=0.5), transform("camera", "face_abcde", stamp, z=3.0),
                 transform("camera", "person_abcde", stamp, z=3.0)]))
            return frames.lookup("camera", stamp)

        pose = wait_for(seen, WAIT_S, "the camera in map")
        self.assertTrue(np.allclose(pose.translation, (0.0, 0.0, 1.5)))
        self.assertEqual(frames.relevant, {"map", "base", "camera"})
        self.assertEqual(frames.known, 2)
        self.assertIsNone(frames.lookup("nowhere", rospy.Time()))
        # The last message may still be on its way.
        wait_for(lambda: frames.reset() or frames.lookup("camera", rospy.Time()) is None, WAIT_S,
                 "no camera without moving frames")
        wait_for(seen, WAIT_S, "the camera again; the fixed frame has been kept")

    def test_a_robot_may_have_a_head_and_a_body(self):
        frames = self.feed()

        def seen():
            stamp = rospy.Time.now()
            self.moving.publish(TFMessage(
                [transform("map", "body_link", stamp, z=1.0), transform("body_link", "head_pan_link", stamp, z=0.5),
                 transform("head_pan_link", "camera", stamp, z=0.1)]))
            return frames.lookup("camera", stamp)

        pose = wait_for(seen, WAIT_S, "the camera in map")
        self.assertTrue(np.allclose(pose.translation, (0.0, 0.0, 1.6)))

    def test_a_camera_on_a_fixed_face_plate(self):
        frames = self.feed()
        self.static.publish(TFMessage([transform("map", "face_plate_link", rospy.Time.now(), z=1.0),
                                       transform("face_plate_link", "camera", rospy.Time.now(), z=0.2)]))
        pose = wait_for(lambda: frames.lookup("camera", rospy.Time()), WAIT_S, "the camera in map")
        self.assertTrue(np.allclose(pose.translation, (0.0, 0.0, 1.2)))

    def test_garbage_is_counted_and_the_next_message_is_read(self):
        heard = []
        feed = TfSubscriber(lambda data, frames, fixed: heard.append([name for name, _ in frames]))
        feed._name = "/nobody"
        self.addCleanup(feed.close)
        early = TFMessage([transform("map", "early", rospy.Time.now(), z=1.0)])
        wait_for(lambda: self.moving.publish(early) or [b"early"] in heard, WAIT_S, "a listener")
        for data in (b"", b"\x00", struct.pack("<I", 2 ** 31), b"\xff" * 50):
            forged = Forger()
            forged.data = data
            self.moving.impl.acquire()
            self.moving.impl.publish(forged)
            self.moving.impl.release()
        self.moving.publish(TFMessage([transform("map", "late", rospy.Time.now(), z=1.0)]))
        wait_for(lambda: [b"late"] in heard, WAIT_S, "the good one")
        self.assertEqual(feed.refused, 4)

    def test_one_bad_transform_costs_only_itself(self):
        frames = self.feed()
        bad = transform("map", "bad", rospy.Time.now(), z=1.0)
        bad.header.stamp.secs = 2 ** 32 - 1     # tf2 ends the process that takes it
        nan = transform("map", "nan", rospy.Time.now(), z=float("nan"))

        def seen():
            stamp = rospy.Time.now()
            self.moving.publish(TFMessage([bad, nan, transform("map", "camera", stamp, z=0.5)]))
            return frames.lookup("camera", stamp) and frames.lookup("camera", bad.header.stamp)

        wait_for(seen, WAIT_S, "the camera beside a bad transform")
        self.assertIsNone(frames.lookup("bad", rospy.Time()))
        self.assertIsNone(frames.lookup("nan", rospy.Time()))
        self.assertGreaterEqual(frames._subscriber.refused, 2)

    def test_messages_of_skeletons_are_not_even_looked_at(self):
        heard = []
        feed = TfSubscriber(lambda data, frames, fixed: heard.append(frames), skip=rospy.get_name())
        feed._name = "/nobody"
        other = TfSubscriber(lambda data, frames, fixed: heard.append(frames))
        self.addCleanup(feed.close)
        self.addCleanup(other.close)
        wait_for(lambda: self.moving.get_num_connections(), WAIT_S, "a listener")
        self.moving.publish(TFMessage([transform("map", "base", rospy.Time.now(), z=1.0)]))
        marker = TfSubscriber(lambda data, frames, fixed: heard.append("marker"))
        marker._name = "/nobody"
        self.addCleanup(marker.close)
        wait_for(lambda: self.moving.publish(TFMessage()) or "marker" in heard, WAIT_S, "a message that is looked at")
        self.assertEqual([item for item in heard if item != "marker"], [])


if __name__ == "__main__":
    rospy.init_node("robot_frames_test")
    rostest.rosrun("hri_pipeline", "robot_frames", RobotFramesTest)
