#!/usr/bin/env python3
"""The node faces with a depth image: a face stands where it is seen, and without one where its size puts it."""

import unittest

import cv2
import numpy as np
import rospy
import rostest
from sensor_msgs.msg import Image
from tf2_msgs.msg import TFMessage

from hri_pipeline.core.onnx import models_directory
from hri_pipeline.ros.conversions import bgr_to_image, make_header
from hri_pipeline.testing import wait_for

PHOTOGRAPH, SIZE = "sample2.jpg", (960, 640)
FARTHER = 1.12      # within what heads differ by


def depth_message(header, metres):
    millimetres = np.full(SIZE[::-1], 1000.0 * metres, np.uint16)
    return Image(header=header, height=SIZE[1], width=SIZE[0], encoding="16UC1", step=2 * SIZE[0],
                 data=millimetres.tobytes())


class FacesDepthTest(unittest.TestCase):

    def setUp(self):
        self.photograph = cv2.resize(cv2.imread(str(models_directory() / "demo" / PHOTOGRAPH)), SIZE,
                                     interpolation=cv2.INTER_AREA)
        self.images = rospy.Publisher("image", Image, queue_size=1)
        self.depths = rospy.Publisher("camera/depth", Image, queue_size=1)
        self.distance = {}
        self.metres = None
        transforms = rospy.Subscriber("/tf", TFMessage, self.on_tf, queue_size=100)
        timer = rospy.Timer(rospy.Duration(0.1), self.show)
        for opened in (timer, transforms, self.images, self.depths):
            self.addCleanup(opened.shutdown if opened is timer else opened.unregister)

    def on_tf(self, message):
        for transform in message.transforms:
            if transform.child_frame_id.startswith("face_"):
                self.distance[transform.child_frame_id] = transform.transform.translation.z

    def show(self, event):
        header = make_header(rospy.Time.now(), "camera")
        if self.metres is not None:
            self.depths.publish(depth_message(header, self.metres))
        self.images.publish(bgr_to_image(self.photograph, header))

    def test_a_face_goes_where_the_depth_image_sees_it(self):
        wait_for(self.depths.get_num_connections, 30, "faces listens to the depth image")
        wait_for(lambda: self.distance, 30, "a face is placed without a depth image, too")
        guessed = next(iter(self.distance.values()))
        self.metres = FARTHER * guessed
        face = next(iter(self.distance))
        wait_for(lambda: abs(self.distance[face] - self.metres) < 0.03 * self.metres, 20,
                 lambda: "from {:.2f} to {:.2f} m, is at {:.2f}".format(guessed, self.metres, self.distance[face]))


if __name__ == "__main__":
    rospy.init_node("faces_depth_test")
    rostest.rosrun("hri_pipeline", "faces_depth", FacesDepthTest)
