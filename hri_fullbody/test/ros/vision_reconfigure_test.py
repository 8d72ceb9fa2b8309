#!/usr/bin/env python3
"""Live parameters of the node vision: the rate of the images that are worked on, and who is followed for how long."""

import unittest

import numpy as np
import rospy
import rostest
from dynamic_reconfigure.client import Client

from hri_msgs.msg import FacialLandmarks, IdsList
from hri_pipeline.testing import Camera, Latest, photograph, wait_for

START_S = WAIT_S = 60.0


class VisionReconfigureTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.photograph = photograph(3)
        cls.camera = Camera(cls.photograph)
        cls.faces = Latest("/humans/faces/tracked", IdsList)
        cls.bodies = Latest("/humans/bodies/tracked", IdsList)
        cls.client = Client("hri_vision", timeout=START_S)

    @classmethod
    def tearDownClass(cls):
        cls.camera.close()

    def setUp(self):
        wait_for(lambda: self.count(self.faces) == 3, START_S, "three faces")

    @staticmethod
    def count(newest):
        return len(newest.value.ids) if newest.value else 0

    def rate(self, images):
        """Images per second that were worked on, over the newest so many images, by their stamps; 0 before there are as
        many."""
        stamps = sorted({message.header.stamp.to_sec() for face in self.landmarks
                         for message in face.messages})[-images:]
        return (images - 1) / (stamps[-1] - stamps[0]) if len(stamps) == images else 0.0

    def test_1_rate(self):
        # Faces that are not seen for seconds have to live on.
        self.client.update_configuration({"face_death_time": 60.0})
        self.landmarks = [Latest("/humans/faces/{}/landmarks".format(face), FacialLandmarks)
                          for face in self.faces.value.ids]
        self.addCleanup(lambda: [face.close() for face in self.landmarks])
        # Far from what a busy machine does.
        wait_for(lambda: self.rate(3) > 0.3, WAIT_S, "images are worked on")
        self.client.update_configuration({"max_rate": 0.2})
        wait_for(lambda: 0.0 < self.rate(3) < 0.22, WAIT_S, "an image every five seconds")
        self.client.update_configuration({"max_rate": 30.0})
        wait_for(lambda: self.rate(3) > 0.3, WAIT_S, "the old rate")
        self.client.update_configuration({"face_death_time": 1.0})

    def test_2_fewer_faces_and_all_again(self):
        self.client.update_configuration({"max_faces": 1})
        self.camera.show(np.zeros_like(self.photograph))
        wait_for(lambda: self.count(self.faces) == 0, WAIT_S, "no face in the dark")
        self.camera.show(self.photograph)
        wait_for(lambda: self.count(self.faces) == 1, WAIT_S, "one face")
        self.client.update_configuration({"max_faces": 10})
        wait_for(lambda: self.count(self.faces) == 3, WAIT_S, "three faces again")

    def test_3_bodies_are_let_go_after_their_death_time(self):
        wait_for(lambda: self.count(self.bodies) > 0, WAIT_S, "bodies")
        self.client.update_configuration({"body_death_time": 60.0, "face_death_time": 0.5})
        self.camera.show(np.zeros_like(self.photograph))
        wait_for(lambda: self.count(self.faces) == 0, WAIT_S, "no face in the dark")
        self.assertGreater(self.count(self.bodies), 0)
        self.client.update_configuration({"body_death_time": 0.5})
        wait_for(lambda: self.count(self.bodies) == 0, WAIT_S, "no body in the dark")


if __name__ == "__main__":
    rospy.init_node("vision_reconfigure_test")
    rostest.rosrun("hri_fullbody", "vision_reconfigure", VisionReconfigureTest)
