#!/usr/bin/env python3
"""The node bodies on a photograph of three people: topics, types, frames, stamps, and nobody in black images."""

import unittest

import numpy as np
import rosgraph
import rospy
import rostest
from demo_camera import FRAME, DemoCamera, Newest, photograph, wait_for
from sensor_msgs.msg import RegionOfInterest
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from hri_msgs.msg import IdsList, Skeleton2D

START_S, WAIT_S = 60.0, 30.0
MARKERS = "visualization/skeletons"


class BodiesTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.picture = photograph(1)
        cls.camera = DemoCamera(cls.picture)
        cls.tracked = Newest("/humans/bodies/tracked", IdsList)
        cls.transforms = Newest("/tf", TFMessage)

    @classmethod
    def tearDownClass(cls):
        cls.camera.close()

    def setUp(self):
        self.camera.show(self.picture)
        wait_for(lambda: self.tracked.last and len(self.tracked.last.ids) >= 3, START_S, "three bodies in tracked")

    def listen(self, topic, kind):
        newest = Newest(topic, kind)
        self.addCleanup(newest.close)
        return newest

    def first(self, topic, kind):
        newest = self.listen(topic, kind)
        return wait_for(lambda: newest.last, WAIT_S, "a message on " + topic)

    def test_each_body_has_roi_and_skeleton_of_its_image(self):
        height, width = self.picture.shape[:2]
        for identity in self.tracked.last.ids:
            roi = self.first("/humans/bodies/{}/roi".format(identity), RegionOfInterest)
            skeleton = self.first("/humans/bodies/{}/skeleton2d".format(identity), Skeleton2D)
            self.assertGreater(roi.width, 50)
            self.assertLessEqual(roi.x_offset + roi.width, width)
            self.assertLessEqual(roi.y_offset + roi.height, height)
            points = np.array([(point.x, point.y, point.c) for point in skeleton.skeleton])
            self.assertEqual(points.shape, (18, 3))
            self.assertTrue(np.all((points >= 0.0) & (points <= 1.0)))
            self.assertGreater(points[Skeleton2D.NOSE, 2], 0.5)
            self.assertIn(skeleton.header.stamp, self.camera.stamps)
            self.assertEqual(skeleton.header.frame_id, FRAME)

    def test_tracked_is_latched(self):
        late = self.listen("/humans/bodies/tracked", IdsList)
        wait_for(lambda: late.last, 0.8, "the latched list, before the next one is due")

    def test_frames_stand_in_front_of_the_camera_with_the_stamp_of_an_image(self):
        frames = {}

        def all_there():
            for message in list(self.transforms.messages):
                frames.update((transform.child_frame_id, transform) for transform in message.transforms)
            return all("body_" + identity in frames and "head_" + identity in frames
                       for identity in self.tracked.last.ids)

        wait_for(all_there, WAIT_S, "body_ID and head_ID of all")
        for identity in self.tracked.last.ids:
            body, head = frames["body_" + identity], frames["head_" + identity]
            self.assertEqual(body.header.frame_id, FRAME)
            self.assertEqual(head.header.frame_id, "body_" + identity)
            self.assertIn(body.header.stamp, self.camera.stamps)
            self.assertTrue(0.5 < body.transform.translation.z < 4.0)
            # The head is above the hips, in the body's own frame.
            self.assertTrue(0.2 < head.transform.translation.z < 1.0)

    def test_one_tf_message_for_all_bodies_of_an_image(self):
        self.transforms.messages.clear()
        wait_for(lambda: len(self.transforms.messages) >= 3, WAIT_S, "transforms")
        stamps = [message.transforms[0].header.stamp for message in list(self.transforms.messages)]
        self.assertEqual(len(set(stamps)), len(stamps))

    def test_markers_come_only_while_somebody_listens(self):
        def tracked_by_node():
            state = rosgraph.Master("/test").getSystemState()
            return any(topic == rospy.resolve_name(MARKERS) and "/hri_bodies" in nodes for topic, nodes in state[0])

        self.assertTrue(tracked_by_node())
        markers = Newest(MARKERS, MarkerArray)
        wait_for(lambda: markers.last and len(markers.last.markers) >= 6, WAIT_S, "markers of three bodies")
        for marker in markers.last.markers:
            self.assertEqual(marker.header.frame_id, FRAME)
            self.assertIn(marker.header.stamp, self.camera.stamps)
            self.assertIn(marker.type, (Marker.LINE_LIST, Marker.SPHERE_LIST))
            self.assertTrue(0.0 < marker.lifetime.to_sec() <= 1.0)
        self.assertEqual({marker.ns for marker in markers.last.markers}, set(self.tracked.last.ids))
        markers.close()
        # Whoever comes later gets no old markers: nothing is made or kept while nobody listens.
        heard = len(self.camera.stamps)
        wait_for(lambda: len(self.camera.stamps) > heard + 6, WAIT_S, "more images")
        newest = max(self.camera.stamps)
        late = self.listen(MARKERS, MarkerArray)
        wait_for(lambda: late.messages, WAIT_S, "markers again")
        self.assertGreaterEqual(late.messages[0].markers[0].header.stamp, newest - rospy.Duration(1.0))

    def test_black_images_empty_the_list_and_free_the_topics(self):
        gone = list(self.tracked.last.ids)
        self.camera.show_black()
        wait_for(lambda: self.tracked.last.ids == [], WAIT_S, "an empty list")

        def freed():
            published = rosgraph.Master("/test").getSystemState()[0]
            return not any("/" + identity + "/" in topic for topic, _ in published for identity in gone)

        wait_for(freed, WAIT_S, "the topics of those who have gone to be taken back")
        self.camera.show(self.picture)
        wait_for(lambda: len(self.tracked.last.ids) >= 3, WAIT_S, "the bodies again")
        self.assertFalse(set(gone) & set(self.tracked.last.ids))


if __name__ == "__main__":
    rospy.init_node("bodies_test")
    rostest.rosrun("hri_fullbody", "bodies", BodiesTest)
