#!/usr/bin/env python3
"""Faces of another process: boxes from their landmarks, poses from /tf among everything else that is there."""

import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from hri_fullbody.ros.bodies import FaceInput
from hri_msgs.msg import FacialLandmarks, IdsList
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import landmarks_to_msg, transform_to_msg
from hri_pipeline.testing import wait_for

CAMERA = "camera_optical"


def landmarks(x):
    points = np.column_stack([np.linspace(x, x + 60.0, 70), np.linspace(100.0, 170.0, 70), np.ones(70)])
    return points


class FaceInputTest(unittest.TestCase):

    def setUp(self):
        self.tracked = self.advertise("/humans/faces/tracked", IdsList, latch=True)
        self.transforms = self.advertise("/tf", TFMessage)
        self.feed = FaceInput(list_timeout=0.0)
        self.addCleanup(self.feed.close)
        wait_for(self.transforms.get_num_connections, 10, "the feed listens to /tf")

    def advertise(self, topic, kind, **arguments):
        publisher = rospy.Publisher(topic, kind, queue_size=10, **arguments)
        self.addCleanup(publisher.unregister)
        return publisher

    def track(self, *ids):
        self.tracked.publish(IdsList(ids=list(ids)))
        wait_for(lambda: self.feed._ids == list(ids), 10, "the list is followed")

    def show(self, identity, stamp):
        """Publish landmarks until they have arrived."""
        publisher = self.advertise("/humans/faces/{}/landmarks".format(identity), FacialLandmarks)
        wait_for(publisher.get_num_connections, 10, "the feed listens to the face")
        publisher.publish(landmarks_to_msg(
            landmarks(300.0), Header(stamp=rospy.Time.from_sec(stamp), frame_id=CAMERA), 1280, 720))
        wait_for(lambda: self.feed.boxes(stamp, 1280, 720), 10, "the face has arrived")

    def box(self, stamp, frame=CAMERA):
        found = self.feed.boxes(stamp, 1280, 720, frame)
        return found[0] if found else None

    def test_a_face_gets_the_pose_of_its_time_and_frame(self):
        self.track("abcde")
        self.show("abcde", 10.0)
        self.assertIsNone(self.box(10.0).pose)
        for index in range(4):
            stamp = 9.8 + 0.1 * index
            face = transform_to_msg(Pose(np.eye(3), np.array([0.0, 0.0, 1.0 + index])), stamp, CAMERA, "face_abcde")
            gaze = transform_to_msg(Pose.identity(), stamp, "face_abcde", "gaze_abcde")
            other = transform_to_msg(Pose(np.eye(3), np.ones(3)), stamp, CAMERA, "face_zzzzz")
            self.transforms.publish(TFMessage([face, gaze, other]))
        pose = wait_for(lambda: self.box(10.01).pose and len(self.feed._poses["abcde"]) == 4 and self.box(10.01).pose,
                        10, "the poses have arrived")
        self.assertAlmostEqual(pose.translation[2], 3.0)
        self.assertIsNone(self.box(10.01, "another_camera"), "the face of another camera")
        self.assertIsNone(self.box(10.45).pose)
        self.assertEqual(self.box(10.45).id, "abcde")
        self.assertEqual(set(self.feed._poses), {"abcde"})

    def test_frames_of_the_robot_and_impossible_ones_change_nothing(self):
        self.track("abcde")
        self.show("abcde", 10.0)
        bad = TransformStamped(child_frame_id="face_abcde")
        bad.header.stamp = rospy.Time.from_sec(10.0)
        bad.header.frame_id = CAMERA
        robot = transform_to_msg(Pose.identity(), 10.0, "odom", "base_link")
        good = transform_to_msg(Pose(np.eye(3), np.array([0.0, 0.0, 2.0])), 10.0, CAMERA, "face_abcde")
        for message in (robot, bad, good):
            self.transforms.publish(TFMessage([message]))
        pose = wait_for(lambda: self.box(10.0).pose, 10, "the good pose has arrived")
        self.assertAlmostEqual(pose.translation[2], 2.0)
        self.assertEqual(len(self.feed._poses["abcde"]), 1)

    def test_faces_of_the_images_before_a_change_are_no_faces_of_those_after_it(self):
        """Their landmarks are shares of another image; what is still on its way comes after the change."""
        self.track("abcde", "fghij")
        self.show("abcde", 10.0)
        self.feed.reset()
        self.assertEqual(self.feed.boxes(10.125, 640, 480, CAMERA), [])
        publisher = self.advertise("/humans/faces/fghij/landmarks", FacialLandmarks)
        wait_for(publisher.get_num_connections, 10, "the feed listens to the face")
        for stamp in (10.0625, 10.125):
            publisher.publish(landmarks_to_msg(
                landmarks(300.0), Header(stamp=rospy.Time.from_sec(stamp), frame_id=CAMERA), 1280, 720))
            wait_for(lambda stamp=stamp: self.feed._landmarks.get("fghij", [[0.0]])[-1][0] == stamp, 10, "it has come")
            found = self.feed.boxes(10.25, 640, 480, CAMERA)
            self.assertEqual([face.id for face in found], ["fghij"] if stamp == 10.125 else [])
        self.feed.reset()       # time jumps back
        self.assertEqual(self.feed.boxes(1.0, 640, 480, CAMERA), [])
        self.show("fghij", 1.01)

    def test_whether_faces_are_looked_for_ends_with_their_node(self):
        self.assertFalse(self.feed.is_published)
        self.track("abcde")
        self.track()
        self.assertTrue(self.feed.is_published, "nobody is there, but would be seen")
        self.tracked.unregister()
        wait_for(lambda: not self.feed.is_published, 20, "the node of the faces has ended")

    def test_a_face_that_has_gone_is_forgotten(self):
        self.track("abcde")
        self.show("abcde", 10.0)
        self.transforms.publish(TFMessage([transform_to_msg(Pose.identity(), 10.0, CAMERA, "face_abcde")]))
        wait_for(lambda: self.feed._poses, 10, "the pose has arrived")
        self.track()
        self.assertEqual(self.feed.boxes(10.0, 1280, 720, CAMERA), [])
        self.assertEqual(self.feed._poses, {})
        self.feed.close()
        self.feed.close()


if __name__ == "__main__":
    rospy.init_node("face_input_test")
    rostest.rosrun("hri_fullbody", "face_input", FaceInputTest)
