#!/usr/bin/env python3
"""The overlay node: draws on the image that the features belong to, and only while somebody looks."""

import unittest

import numpy as np
import rospy
import rostest
from sensor_msgs.msg import Image
from std_msgs.msg import Float32, Header, String

from hri_msgs.msg import FacialLandmarks, IdsList, Skeleton2D
from hri_pipeline.core.overlay import colour_of
from hri_pipeline.ros.conversions import bgr_to_image, image_to_bgr, landmarks_to_msg, skeleton_to_msg
from hri_pipeline.testing import wait_for

LIMIT = 20.0
WIDTH, HEIGHT = 320, 240


class TestOverlay(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.image = rospy.Publisher("image", Image, queue_size=1)
        cls.landmarks = rospy.Publisher("/humans/faces/faaaa/landmarks", FacialLandmarks, queue_size=1)
        cls.skeleton = rospy.Publisher("/humans/bodies/baaaa/skeleton2d", Skeleton2D, queue_size=1)
        cls.latched = []
        for topic, kind, value in (
                ("faces/tracked", IdsList, IdsList(ids=["faaaa"])),
                ("bodies/tracked", IdsList, IdsList(ids=["baaaa"])),
                ("persons/tracked", IdsList, IdsList(ids=["paaaa"])),
                ("persons/paaaa/face_id", String, String("faaaa")),
                ("persons/paaaa/body_id", String, String("baaaa")),
                ("persons/paaaa/location_confidence", Float32, Float32(1.0))):
            publisher = rospy.Publisher("/humans/" + topic, kind, queue_size=1, latch=True)
            publisher.publish(value)
            cls.latched.append((publisher, value))

    def publish_scene(self, stamp):
        header = Header(stamp=stamp, frame_id="eye")
        self.image.publish(bgr_to_image(np.full((HEIGHT, WIDTH, 3), 90, np.uint8), header))
        angle = np.linspace(0.0, 6.0, 70)
        face = np.stack([160 + 20 * np.cos(angle), 60 + 20 * np.sin(angle), np.ones(70)], axis=1)
        body = np.stack([np.linspace(120, 200, 18), np.linspace(100, 220, 18), np.ones(18)], axis=1)
        self.landmarks.publish(landmarks_to_msg(face, header, WIDTH, HEIGHT))
        self.skeleton.publish(skeleton_to_msg(body, header, WIDTH, HEIGHT))

    def test_draws_while_somebody_looks(self):
        self.assertEqual(self.image.get_num_connections(), 0, "it listens although nobody looks")
        pictures, stamps = [], set()
        looking = rospy.Subscriber("visualization/overlay", Image, pictures.append, queue_size=10)
        colour = np.array(colour_of("paaaa"), np.uint8)

        def publish():
            stamp = rospy.Time.now()
            stamps.add(stamp)
            for publisher, value in self.latched[:3]:
                publisher.publish(value)
            self.publish_scene(stamp)

        def drawn():
            return any((image_to_bgr(picture) == colour).all(axis=2).sum() > 500 for picture in pictures[-3:])

        wait_for(drawn, LIMIT, "a person that is drawn", publish, 0.05)
        self.assertTrue((image_to_bgr(pictures[-1])[10:40, 10:60] == 90).all())
        # Of a node that takes the same images: this one listens to them from now on.
        rospy.set_param("~ignored_regions", ["0 0 0.25 0.25"])
        listens = rospy.Subscriber("image", Image, queue_size=1)
        wait_for(lambda: (image_to_bgr(pictures[-1])[10:40, 10:60] != 90).any(), LIMIT, "the ignored region", publish,
                 0.05)
        listens.unregister()
        self.assertEqual((pictures[-1].width, pictures[-1].height), (WIDTH, HEIGHT))
        self.assertEqual(pictures[-1].header.frame_id, "eye")
        self.assertLessEqual({picture.header.stamp for picture in pictures}, stamps)
        # An image without size does not end the node.
        self.image.publish(Image(header=Header(stamp=rospy.Time.now()), encoding="bgr8"))
        seen = len(pictures)
        wait_for(lambda: len(pictures) > seen, LIMIT, "an image after a bad one", publish, 0.05)
        looking.unregister()
        wait_for(lambda: self.image.get_num_connections() == 0, LIMIT, "that it listens no more")


if __name__ == "__main__":
    rospy.init_node("test_overlay")
    rostest.rosrun("hri_pipeline", "overlay", TestOverlay)
