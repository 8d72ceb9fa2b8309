#!/usr/bin/env python3
"""A frame of the robot is looked up narrowly, whatever else is on /tf."""

import struct
import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from hri_pipeline.ros.tf import RobotTfListener, TfSubscriber
from hri_pipeline.testing import wait_for

WAIT_S = 15.0


def transform(parent, child, z, stamp):
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    message.transform.translation.z = z
    message.transform.rotation.w = 1.0
    return message


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
        self.static.publish(TFMessage([transform("map", "base", 1.0, rospy.Time.now())]))

        def seen():
            stamp = rospy.Time.now()
            self.moving.publish(TFMessage(
                [transform("base", "camera", 0.5, stamp), transform("camera", "face_abcde", 3.0, stamp),
                 transform("camera", "person_abcde", 3.0, stamp)]))
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
                [transform("map", "body_link", 1.0, stamp), transform("body_link", "head_pan_link", 0.5, stamp),
                 transform("head_pan_link", "camera", 0.1, stamp)]))
            return frames.lookup("camera", stamp)

        pose = wait_for(seen, WAIT_S, "the camera in map")
        self.assertTrue(np.allclose(pose.translation, (0.0, 0.0, 1.6)))

    def test_a_camera_on_a_fixed_face_plate(self):
        frames = self.feed()
        self.static.publish(TFMessage([transform("map", "face_plate_link", 1.0, rospy.Time.now()),
                                       transform("face_plate_link", "camera", 0.2, rospy.Time.now())]))
        pose = wait_for(lambda: frames.lookup("camera", rospy.Time()), WAIT_S, "the camera in map")
        self.assertTrue(np.allclose(pose.translation, (0.0, 0.0, 1.2)))

    def test_garbage_is_counted_and_the_next_message_is_read(self):
        heard = []
        feed = TfSubscriber(lambda data, frames, fixed: heard.append([name for name, _ in frames]))
        feed._name = "/nobody"
        self.addCleanup(feed.close)
        early = TFMessage([transform("map", "early", 1.0, rospy.Time.now())])
        wait_for(lambda: self.moving.publish(early) or [b"early"] in heard, WAIT_S, "a listener")
        for data in (b"", b"\x00", struct.pack("<I", 2 ** 31), b"\xff" * 50):
            forged = Forger()
            forged.data = data
            self.moving.impl.acquire()
            self.moving.impl.publish(forged)
            self.moving.impl.release()
        self.moving.publish(TFMessage([transform("map", "late", 1.0, rospy.Time.now())]))
        wait_for(lambda: [b"late"] in heard, WAIT_S, "the good one")
        self.assertEqual(feed.refused, 4)

    def test_one_bad_transform_costs_only_itself(self):
        frames = self.feed()
        bad = transform("map", "bad", 1.0, rospy.Time.now())
        bad.header.stamp.secs = 2 ** 32 - 1     # tf2 ends the process that takes it
        nan = transform("map", "nan", float("nan"), rospy.Time.now())

        def seen():
            stamp = rospy.Time.now()
            self.moving.publish(TFMessage([bad, nan, transform("map", "camera", 0.5, stamp)]))
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
        self.moving.publish(TFMessage([transform("map", "base", 1.0, rospy.Time.now())]))
        marker = TfSubscriber(lambda data, frames, fixed: heard.append("marker"))
        marker._name = "/nobody"
        self.addCleanup(marker.close)
        wait_for(lambda: self.moving.publish(TFMessage()) or "marker" in heard, WAIT_S, "a message that is looked at")
        self.assertEqual([item for item in heard if item != "marker"], [])


if __name__ == "__main__":
    rospy.init_node("robot_frames_test")
    rostest.rosrun("hri_pipeline", "robot_frames", RobotFramesTest)
