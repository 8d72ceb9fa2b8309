#!/usr/bin/env python3
"""The node bodies on a photograph of three people: topics, types, frames, stamps, and nothing left in black images."""

import os
import unittest

import numpy as np
import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, TwistStamped
from sensor_msgs.msg import Image, JointState, RegionOfInterest
from skeleton_graph import TfTree, processes, wait_until_gone
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from hri_fullbody.core.model.human import PAPER
from hri_msgs.msg import BodyAttitude, BodyPosture, Gesture, IdsList, PointingStamped, Skeleton2D
from hri_pipeline.ros.conversions import matrix_from_image
from hri_pipeline.testing import FRAME, Camera, Latest, photograph, pid_of, wait_for

START_S, WAIT_S = 60.0, 30.0
MARKERS = "visualization/skeletons"


class BodiesTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.picture = photograph(1)
        cls.camera = Camera(cls.picture)
        cls.tracked = Latest("/humans/bodies/tracked", IdsList)
        cls.tree = TfTree()

    @classmethod
    def tearDownClass(cls):
        cls.camera.close()
        cls.tree.close()

    def setUp(self):
        self.camera.show(self.picture)
        wait_for(lambda: self.tracked.value and len(self.tracked.value.ids) >= 3, START_S, "three bodies in tracked")

    def listen(self, topic, kind):
        newest = Latest(topic, kind)
        self.addCleanup(newest.close)
        return newest

    def first(self, topic, kind):
        newest = self.listen(topic, kind)
        return wait_for(lambda: newest.value, WAIT_S, "a message on " + topic)

    def test_each_body_has_roi_and_skeleton_of_its_image(self):
        height, width = self.picture.shape[:2]
        for identity in self.tracked.value.ids:
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

    def test_the_node_stands_back_behind_the_others(self):
        pid, nice = pid_of("/hri_bodies"), rospy.get_param("/hri_bodies/nice")
        self.assertGreater(nice, 0)
        # Not in its first seconds.
        wait_for(lambda: os.getpriority(os.PRIO_PROCESS, pid) >= nice, WAIT_S, "bodies stands back")

    def test_pointing_comes_with_each_image_also_when_nobody_points(self):
        message = self.first("/humans/interactions/pointing", PointingStamped)
        self.assertIn(message.header.stamp, self.camera.stamps)
        self.assertEqual(message.header.frame_id, FRAME)
        self.assertTrue(all(one.sender in self.tracked.value.ids for one in message.pointings))

    def test_tracked_is_latched(self):
        late = self.listen("/humans/bodies/tracked", IdsList)
        wait_for(lambda: late.value, 0.8, "the latched list, before the next one is due")

    def test_whole_skeletons_stand_in_front_of_the_camera_with_the_stamp_of_an_image(self):
        for identity in self.tracked.value.ids:
            stamp = wait_for(lambda wanted=identity: self.tree.complete(wanted), WAIT_S,
                             "all frames of " + identity)[-1]
            self.assertIn(stamp, self.camera.stamps)
            body, head = (self.tree.pose(link, identity, stamp, FRAME) for link in ("body", "head"))
            self.assertTrue(0.5 < body.translation[2] < 4.0)
            # The head is above the hips, in the body's own frame, and some way below the top of a tall person.
            above = body.inverse().compose(head).translation[2]
            self.assertTrue(0.4 < above < 0.9, above)
            # Nobody hangs upside down: z of the body points against y of the camera.
            self.assertLess(body.rotation[1, 2], -0.5)
            self.assertEqual(len(processes(identity)), 1)
            self.assertTrue(rospy.get_param("/human_description_" + identity).startswith("<?xml"))
        self.assertEqual(self.tree.repeated, [])

    def test_joints_and_roots_go_out_together(self):
        identity = self.tracked.value.ids[0]
        joints = self.listen("/humans/bodies/{}/joint_states".format(identity), JointState)
        transforms = self.listen("/tf", TFMessage)
        wait_for(lambda: len(joints.messages) >= 6, WAIT_S, "joint states")
        stamps = [message.header.stamp for message in list(joints.messages)]
        self.assertEqual(len(set(stamps)), len(stamps))
        for message in list(joints.messages):
            self.assertEqual(message.name, ["{}_{}".format(name, identity) for name in PAPER.joint_names])
            self.assertTrue(np.all(np.array(message.position) >= PAPER.lower - 1e-6))
            self.assertTrue(np.all(np.array(message.position) <= PAPER.upper + 1e-6))
            self.assertIn(message.header.stamp, self.camera.stamps)

        def roots():
            return [message for message in list(transforms.messages)
                    if message._connection_header["callerid"] == "/hri_bodies"]

        wait_for(lambda: {message.transforms[0].header.stamp for message in roots()} >= set(stamps[2:5]), WAIT_S,
                 "roots")
        # One message for all bodies of an image, and nothing in it but the roots.
        sent = [message.transforms[0].header.stamp for message in roots()]
        self.assertEqual(len(set(sent)), len(sent))
        self.assertTrue(all(item.child_frame_id.startswith("body_") and item.header.frame_id == FRAME
                            for message in roots() for item in message.transforms))

    def test_place_and_expression_of_a_body(self):
        identity = self.tracked.value.ids[0]
        place = "/humans/bodies/{}/".format(identity)
        expected = {"position": PointStamped, "velocity": TwistStamped, "attitude": BodyAttitude,
                    "posture": BodyPosture, "gesture": Gesture}
        for name, kind in expected.items():
            message = self.first(place + name, kind)
            self.assertIn(message.header.stamp, self.camera.stamps)
            self.assertEqual(message.header.frame_id, FRAME)
        point = self.first(place + "position", PointStamped).point
        stamp = wait_for(lambda: self.tree.complete(identity), WAIT_S, "frames")[-1]
        body = self.tree.pose("body", identity, stamp, FRAME)
        self.assertLess(np.abs(body.translation - (point.x, point.y, point.z)).max(), 0.3)

    def test_a_crop_is_sent_to_whom_it_may_concern(self):
        identity = self.tracked.value.ids[0]
        cropped = self.first("/humans/bodies/{}/cropped".format(identity), Image)
        self.assertIn(cropped.header.stamp, self.camera.stamps)
        self.assertEqual((cropped.encoding, len(cropped.data)), ("bgr8", cropped.height * cropped.step))
        self.assertTrue(50 < cropped.width <= self.picture.shape[1])
        self.assertGreater(np.frombuffer(cropped.data, np.uint8).std(), 10.0)

    def test_colours_of_clothes_are_histograms(self):
        identity = self.tracked.value.ids[0]
        message = self.first("/humans/bodies/{}/appearance".format(identity), Image)
        self.assertIn(message.header.stamp, self.camera.stamps)
        rows = matrix_from_image(message)
        self.assertEqual(rows.shape, (5, 21))
        for total in rows.sum(axis=1):
            self.assertAlmostEqual(total, round(total), places=5)
        self.assertAlmostEqual(rows[0].sum(), 1.0, places=5)

    def test_diagnostics_tell_of_models_and_processes(self):
        diagnostics = self.listen("/diagnostics", DiagnosticArray)

        def values():
            for message in list(diagnostics.messages):
                for status in message.status:
                    found = {item.key: item.value for item in status.values}
                    if status.name == "hri_bodies: bodies" and found.get("robot_state_publishers_alive", "0") >= "3":
                        return found
            return None

        found = wait_for(values, WAIT_S, "diagnostics")
        self.assertIn("models_ms_median", found)
        self.assertEqual(found["robot_state_publishers_restarted"], "0")
        self.assertEqual(found["errors"], "0")
        told = found["statures_m"].split(", ")
        self.assertEqual(sorted(one.split()[0] for one in told), sorted(self.tracked.value.ids))
        for one in told:
            self.assertRegex(one, r"^\w+ (unknown|\d\.\d\d \+- 0\.\d\d)$")

    def test_markers_come_only_while_somebody_listens(self):
        def tracked_by_node():
            state = rosgraph.Master("/test").getSystemState()
            return any(topic == rospy.resolve_name(MARKERS) and "/hri_bodies" in nodes for topic, nodes in state[0])

        self.assertTrue(tracked_by_node())
        markers = Latest(MARKERS, MarkerArray)
        wait_for(lambda: markers.value and len(markers.value.markers) >= 6, WAIT_S, "markers of three bodies")
        for marker in markers.value.markers:
            self.assertEqual(marker.header.frame_id, FRAME)
            self.assertIn(marker.header.stamp, self.camera.stamps)
            self.assertIn(marker.action, (Marker.ADD, Marker.DELETE))
            self.assertTrue(marker.action == Marker.DELETE or 0.0 < marker.lifetime.to_sec() <= 1.0)
        self.assertEqual({marker.ns for marker in markers.value.markers if marker.action == Marker.ADD},
                         set(self.tracked.value.ids))
        markers.close()
        # Whoever comes later gets no old markers: nothing is made or kept while nobody listens.
        heard = len(self.camera.stamps)
        wait_for(lambda: len(self.camera.stamps) > heard + 6, WAIT_S, "more images")
        newest = max(marker.header.stamp for marker in markers.value.markers)
        late = self.listen(MARKERS, MarkerArray)
        wait_for(lambda: late.messages, WAIT_S, "markers again")
        self.assertGreater(late.messages[0].markers[0].header.stamp, newest)

    def test_a_silent_camera_empties_the_list_with_the_stamp_of_its_last_image(self):
        before = self.tracked.value
        self.camera.show(None)
        wait_for(lambda: self.tracked.value.ids == [], WAIT_S, "an empty list")
        self.assertIn(self.tracked.value.header.stamp, self.camera.stamps)
        self.assertGreaterEqual(self.tracked.value.header.stamp, before.header.stamp)

    def test_black_images_empty_the_list_and_leave_nothing(self):
        gone = list(self.tracked.value.ids)
        self.camera.show(np.zeros_like(self.picture))
        wait_for(lambda: self.tracked.value.ids == [], WAIT_S, "an empty list")

        for identity in gone:
            wait_until_gone(identity, WAIT_S)
        self.camera.show(self.picture)
        wait_for(lambda: len(self.tracked.value.ids) >= 3, WAIT_S, "the bodies again")
        self.assertFalse(set(gone) & set(self.tracked.value.ids))


if __name__ == "__main__":
    rospy.init_node("bodies_test")
    rostest.rosrun("hri_fullbody", "bodies", BodiesTest)
