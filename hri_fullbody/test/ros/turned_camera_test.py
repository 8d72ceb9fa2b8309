#!/usr/bin/env python3
"""Nodes with a camera that is rolled clockwise by ~quarters: people are found, where they are in the images as they
come, and in the room. ~by: what tells the nodes."""

import unittest

import cv2
import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image, RegionOfInterest
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import FacialLandmarks, IdsList, Skeleton2D
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import image_to_bgr, pose_from_transform, transform_to_msg
from hri_pipeline.testing import FRAME, Camera, Latest, photograph, wait_for

START_S, WAIT_S = 60.0, 30.0
HEIGHT_M = 1.5
# Up in the images, by quarter turns.
UP = np.array([[0, -1], [-1, 0], [0, 1], [1, 0]])
SELLION, CHIN, EYES = 27, 8, slice(36, 48)      # of the 70 landmarks


def rolled(quarters):
    """Pose in the map of the optical frame of a camera that looks along x."""
    up, right = UP[quarters], UP[(quarters - 1) % 4]
    return Pose(np.array([[0.0, 0.0, 1.0], [-right[0], -right[1], 0.0], [up[0], up[1], 0.0]]),
                np.array([0.0, 0.0, HEIGHT_M]))


class TurnedCameraTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.quarters = rospy.get_param("~quarters")
        cls.place = rolled(cls.quarters)
        cls.picture = np.ascontiguousarray(np.rot90(photograph(3), cls.quarters))
        cls.size = np.array(cls.picture.shape[1::-1])
        cls.static = rospy.Publisher("/tf_static", TFMessage, queue_size=1, latch=True)
        cls.static.publish(TFMessage([transform_to_msg(cls.place, rospy.Time.now(), "map", FRAME)]))
        cls.camera = Camera(cls.picture)
        cls.model = CameraModel.from_fov(*cls.size.tolist(), 1.05)
        cls.lists = {kind: Latest("/humans/{}/tracked".format(kind), IdsList) for kind in ("faces", "bodies")}
        cls.poses = {}
        cls.tf = rospy.Subscriber("/tf", TFMessage, cls.take)

    @classmethod
    def tearDownClass(cls):
        cls.camera.close()

    @classmethod
    def take(cls, message):
        for one in message.transforms:
            if one.header.frame_id == FRAME:
                cls.poses[one.child_frame_id] = pose_from_transform(one)

    def setUp(self):
        for kind in ("faces", "bodies"):
            wait_for(lambda kind=kind: self.lists[kind].value and len(self.lists[kind].value.ids) >= 3, START_S,
                     "three " + kind)

    def newest(self, kind, name, message):
        """What was last published of all who are tracked."""
        topics = {identity: Latest("/humans/{}/{}/{}".format(kind, identity, name), message)
                  for identity in self.lists[kind].value.ids}
        for topic in topics.values():
            self.addCleanup(topic.close)
        wait_for(lambda: all(topic.value or identity not in self.lists[kind].value.ids
                             for identity, topic in topics.items()), WAIT_S, "{} of all {}".format(name, kind))
        return {identity: topic.value for identity, topic in topics.items() if topic.value}

    def landmarks(self):
        return {identity: np.array([(point.x, point.y) for point in message.landmarks]) * self.size
                for identity, message in self.newest("faces", "landmarks", FacialLandmarks).items()}

    def test_faces_are_where_the_images_show_them(self):
        for identity, points in self.landmarks().items():
            self.assertGreater((points[EYES].mean(axis=0) - points[CHIN]) @ UP[self.quarters], 0.0, "heads are turned")
            pose = wait_for(lambda identity=identity: self.poses.get("face_" + identity), WAIT_S, "frame of a face")
            seen = self.model.project(pose.translation[None])[0]
            self.assertLess(np.linalg.norm(seen - points[SELLION]), 15.0)
        for identity, roi in self.newest("faces", "roi", RegionOfInterest).items():
            low, high = np.array([roi.x_offset, roi.y_offset]), np.array([roi.width, roi.height])
            middle = self.landmarks()[identity].mean(axis=0)
            self.assertTrue(np.all(middle > low) and np.all(middle < low + high))

    def test_people_stand_in_the_room(self):
        for identity in self.lists["faces"].value.ids:
            face = self.place.compose(wait_for(lambda identity=identity: self.poses.get("face_" + identity), WAIT_S,
                                           "frame of a face"))
            self.assertGreater(face.rotation[2, 2], 0.8, "heads are upright")
            self.assertTrue(0.3 < face.translation[0] < 6.0 and abs(face.translation[2] - HEIGHT_M) < 1.0)
        for identity in self.lists["bodies"].value.ids:
            body = self.place.compose(wait_for(lambda identity=identity: self.poses.get("body_" + identity), WAIT_S,
                                           "frame of a body"))
            self.assertGreater(body.rotation[2, 2], 0.7, "bodies are upright")

    def test_bodies_and_faces_are_those_of_the_same_people(self):
        def noses_per_face():
            outlines = self.landmarks().values()
            noses = np.array([(message.skeleton[0].x, message.skeleton[0].y) for message in self.newest(
                "bodies", "skeleton2d", Skeleton2D).values()]).reshape(-1, 2) * self.size
            return [np.all((noses > points.min(axis=0)) & (noses < points.max(axis=0)), axis=1).sum()
                    for points in outlines]

        wait_for(lambda: noses_per_face() == [1, 1, 1], WAIT_S, "one nose in each of three faces", period=0.3)

    def test_pictures_of_faces_are_upright(self):
        aligned = self.newest("faces", "aligned", Image)
        for identity, message in self.newest("faces", "cropped", Image).items():
            if identity in aligned:
                one, other = (cv2.GaussianBlur(image_to_bgr(picture), (0, 0), 3.0).astype(float)[20:-20, 20:-20].ravel()
                              for picture in (message, aligned[identity]))
                upright = np.corrcoef(one, other)[0, 1]
                self.assertGreater(upright, np.corrcoef(one.reshape(-1, 3)[::-1].ravel(), other)[0, 1] + 0.1)

    def test_diagnostics_tell_the_rotation(self):
        told = Latest("/diagnostics", DiagnosticArray)
        self.addCleanup(told.close)

        def values():
            return {item.key: item.value for message in told.messages for status in message.status
                    for item in status.values if item.key.startswith("image_rotation")}

        wait_for(lambda: len(values()) == 2, WAIT_S, "the rotation")
        self.assertEqual(values(), {"image_rotation_deg": str(90 * self.quarters),
                                    "image_rotation_by": rospy.get_param("~by")})


if __name__ == "__main__":
    rospy.init_node("turned_camera_test")
    rostest.rosrun("hri_fullbody", "turned_camera", TurnedCameraTest)
