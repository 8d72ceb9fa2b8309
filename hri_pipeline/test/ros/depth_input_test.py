#!/usr/bin/env python3
"""Depth images through real topics: pairs, late ones, others that do not fit, and none at all."""

import unittest

import numpy as np
import rospy
import rostest
from sensor_msgs.msg import CompressedImage, Image

from hri_pipeline.ros import depth_input
from hri_pipeline.ros.conversions import bgr_to_image, make_header
from hri_pipeline.ros.depth_input import DepthInput
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.ros.image_input import ImageInput
from hri_pipeline.testing import wait_for

BGR = np.zeros((48, 64, 3), np.uint8)


def depth_message(stamp, millimetres, **changes):
    values = np.full((48, 64), millimetres, np.uint16)
    message = Image(header=make_header(stamp, "camera_optical"), width=64, height=48, step=128, encoding="16UC1",
                    data=values.tobytes())
    for name, value in changes.items():
        setattr(message, name, value)
    return message


class DepthInputTest(unittest.TestCase):

    def setUp(self):
        self.images = rospy.Publisher("image", Image, queue_size=10)
        self.depths = rospy.Publisher("depth", Image, queue_size=20)
        self.addCleanup(self.images.unregister)
        self.addCleanup(self.depths.unregister)
        silence = depth_input.DEPTH_SILENCE_S
        self.addCleanup(setattr, depth_input, "DEPTH_SILENCE_S", silence)

    def depth_input(self, slop=0.03):
        depth = DepthInput(slop)
        self.addCleanup(depth.close)
        wait_for(self.depths.get_num_connections, 10, "the node listens to depth")
        return depth

    def send(self, depth_input, *messages):
        count = depth_input.counts["depth_received"]
        for message in messages:
            self.depths.publish(message)
        wait_for(lambda: depth_input.counts["depth_received"] == count + len(messages), 10, "depth is received")

    def test_a_frame_has_the_depth_of_its_time(self):
        depth = DepthInput(0.03)
        image_input = ImageInput(depth=depth)
        self.addCleanup(image_input.close)
        wait_for(lambda: self.images.get_num_connections() and self.depths.get_num_connections(), 10, "both listen")
        self.send(depth, *(depth_message(10.0 + 0.1 * index, 1000 + 100 * index) for index in range(4)))
        self.images.publish(bgr_to_image(BGR, make_header(10.21, "camera_optical")))
        frame = image_input.next(5)
        self.assertEqual(frame.depth.shape, (48, 64))
        self.assertAlmostEqual(float(frame.depth[5, 5]), 1.2, places=5)
        self.assertEqual(depth.status()[0], OK)
        self.assertEqual(image_input.status()[2]["depth_used"], 1)

    def test_a_depth_image_that_comes_a_little_later_is_waited_for(self):
        depth = self.depth_input()
        self.send(depth, depth_message(1.0, 1000))
        timer = rospy.Timer(rospy.Duration(0.03), lambda event: self.depths.publish(depth_message(1.1, 2000)),
                            oneshot=True)
        self.addCleanup(timer.shutdown)
        self.assertAlmostEqual(float(depth.match(1.1, 64, 48, "camera_optical")[0, 0]), 2.0, places=5)

    def test_slower_depth_is_not_waited_for_before_its_next_image(self):
        depth = self.depth_input()
        self.send(depth, *(depth_message(1.0 + 0.1 * index, 1000) for index in range(5)))
        waited = []

        def match(stamp):
            waited.clear()
            depth._condition.wait = waited.append
            return depth.match(stamp, 64, 48, "camera_optical")

        self.assertIsNotNone(match(1.4))
        self.assertIsNone(match(1.433))
        self.assertEqual(waited, [], "the next one will be of 1.5")
        self.assertIsNone(match(1.5))
        self.assertTrue(waited, "it may be on its way")
        self.send(depth, depth_message(1.52, 1000), depth_message(1.54, 1000))
        self.assertIsNone(match(1.575))
        self.assertTrue(waited, "now they come every 20 ms")

    def test_a_depth_image_without_stamp_has_the_time_of_its_arrival_as_images_do(self):
        depth = self.depth_input(slop=0.5)
        self.send(depth, depth_message(0.0, 1000))
        found = depth.match(rospy.get_time(), 64, 48, "camera_optical")
        self.assertIsNotNone(found)
        self.assertAlmostEqual(float(found[0, 0]), 1.0, places=5)

    def test_out_of_the_slop_there_is_none_and_the_topics_are_named(self):
        depth = self.depth_input(slop=0.01)
        depth_input.DEPTH_SILENCE_S = 0.2

        def match():
            depth._store(depth_message(5.05, 1000))
            self.assertIsNone(depth.match(5.0, 64, 48, "camera_optical"))
            return depth.problem()

        problem = wait_for(match, 10, "a problem is told")
        for part in ("/image", depth.topic, "depth_slop", "0.050 s off", "do not synchronise"):
            self.assertIn(part, problem)
        self.assertEqual(depth.status()[0], WARN)
        self.send(depth, depth_message(6.0, 1000))
        self.assertIsNotNone(depth.match(6.0, 64, 48, "camera_optical"))
        self.assertEqual(depth.status()[:2], (OK, ""))

    def test_depth_in_another_frame_is_used_and_told(self):
        depth = self.depth_input()
        text = "depth is in the frame 'depth_optical', images are in 'camera_optical'"
        with self.assertLogs("rosout", "WARNING") as log:
            for stamp in (1.0, 1.1):
                self.send(depth, depth_message(stamp, 1500, header=make_header(stamp, "/depth_optical")))
                self.assertIsNotNone(depth.match(stamp, 64, 48, "camera_optical"))
        self.assertEqual(len([line for line in log.output if text in line]), 1, log.output)
        self.assertEqual(depth.status()[0], WARN)
        self.assertIn(text, depth.status()[1])
        self.send(depth, depth_message(1.2, 1500, header=make_header(1.2, "/camera_optical")))
        self.assertIsNotNone(depth.match(1.2, 64, 48, "camera_optical"))
        self.assertEqual(depth.status()[:2], (OK, ""))

    def test_without_a_publisher_the_mend_is_told(self):
        self.depths.unregister()
        depth_input.DEPTH_SILENCE_S = 0.1
        depth = DepthInput(0.03)
        self.addCleanup(depth.close)
        problem = wait_for(depth.problem, 10, "the silence is told")
        self.assertIn("no publisher on {}".format(depth.topic), problem)
        self.assertIn("use_depth", problem)
        self.depths = rospy.Publisher("depth", Image, queue_size=20)

    def test_a_topic_of_another_type_is_told(self):
        self.depths.unregister()
        depth_input.DEPTH_SILENCE_S = 0.1
        other = rospy.Publisher("depth", CompressedImage, queue_size=20)
        self.addCleanup(other.unregister)
        depth = DepthInput(0.03)
        self.addCleanup(depth.close)
        wait_for(lambda: "carries sensor_msgs/CompressedImage, not sensor_msgs/Image" in depth.problem(), 20,
                 depth.problem)

    def test_depth_that_cannot_be_read_is_told_and_the_next_is_used(self):
        depth = self.depth_input()
        for stamp, changes, text in ((1.0, {"encoding": "rgb8"}, "rgb8"), (1.1, {"step": 3}, "step is 3"),
                                     (1.2, {"width": 24, "step": 128}, "another shape"),
                                     (1.25, {"data": bytes(6144)}, "no pixel"), (1.3, {"data": b""}, "too short")):
            self.send(depth, depth_message(stamp, 1000, **changes))
            self.assertIsNone(depth.match(stamp, 64, 48, "camera_optical"))
            self.assertIn(text, depth.status()[1])
        self.send(depth, depth_message(1.4, 1500))
        self.assertAlmostEqual(float(depth.match(1.4, 64, 48, "camera_optical")[3, 3]), 1.5, places=5)
        self.assertEqual(depth.status()[0], OK)
        self.assertEqual(depth.counts["depth_unreadable"], 5)

    def test_the_queue_is_bounded_and_close_is_idempotent(self):
        depth = self.depth_input()
        for index in range(15):
            self.send(depth, depth_message(float(index + 1), 1000))
        self.assertLessEqual(len(depth._messages), 8)
        depth.close()
        depth.close()
        self.assertIsNone(depth.match(15.0, 64, 48, "camera_optical"))

    def test_an_illegal_slop_is_refused(self):
        with self.assertRaisesRegex(ValueError, "depth_slop"):
            DepthInput(-1.0)


if __name__ == "__main__":
    rospy.init_node("depth_input_test")
    rostest.rosrun("hri_pipeline", "depth_input", DepthInputTest)
