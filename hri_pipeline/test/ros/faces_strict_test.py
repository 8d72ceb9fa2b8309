#!/usr/bin/env python3
"""The node faces with privacy:=strict."""

import unittest

import cv2
import rospy
import rosservice
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image

from hri_msgs.msg import FacialLandmarks, IdsList
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.ros.conversions import bgr_to_image, make_header
from hri_pipeline.testing import wait_for

PHOTOGRAPH, FACES, SIZE = "sample1.jpg", 3, (960, 640)


class StrictFacesTest(unittest.TestCase):

    def test_faces_are_placed_and_nothing_is_inferred(self):
        stages, lists = [], []
        self.addCleanup(rospy.Subscriber("/diagnostics", DiagnosticArray, lambda message: stages.extend(
            value.value for status in message.status for value in status.values if value.key == "stages")).unregister)
        self.addCleanup(rospy.Subscriber("/humans/faces/tracked", IdsList, lists.append).unregister)
        photograph = cv2.resize(cv2.imread(str(models_directory() / "demo" / PHOTOGRAPH)), SIZE,
                                interpolation=cv2.INTER_AREA)
        images = rospy.Publisher("image", Image, queue_size=1)
        self.addCleanup(images.unregister)
        timer = rospy.Timer(rospy.Duration(0.1), lambda event: images.publish(
            bgr_to_image(photograph, make_header(rospy.Time.now(), "camera"))))
        self.addCleanup(timer.shutdown)
        wait_for(lambda: lists and len(lists[-1].ids) == FACES, 30, "three faces are tracked")
        identity = lists[-1].ids[0]
        rospy.wait_for_message("/humans/faces/{}/landmarks".format(identity), FacialLandmarks, 10)
        names = {name.rsplit("/", 1)[1] for name, _ in rospy.get_published_topics("/humans/faces/" + identity)}
        self.assertEqual(names, {"roi", "landmarks", "cropped", "aligned"})
        published = [name for name, _ in rospy.get_published_topics()]
        self.assertNotIn("/humans/candidate_matches", published)
        self.assertFalse([name for name in rosservice.get_service_list() if name.endswith("/gallery")])
        wait_for(lambda: "none" in stages, 10, "the diagnostics say so")
        self.assertEqual(set(stages), {"none"})


if __name__ == "__main__":
    rospy.init_node("faces_strict_test")
    rostest.rosrun("hri_pipeline", "faces_strict", StrictFacesTest)
