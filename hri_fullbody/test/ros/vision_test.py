#!/usr/bin/env python3
"""The node vision: faces and bodies out of one process, each body with the nose in its own face."""

import unittest

import numpy as np
import rospy
import rostest

from hri_msgs.msg import FacialLandmarks, IdsList, NormalizedRegionOfInterest2D, Skeleton2D
from hri_pipeline.testing import Camera, Latest, photograph, wait_for

START_S, WAIT_S = 60.0, 30.0


class VisionTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.camera = Camera(photograph(3))
        cls.faces = Latest("/humans/faces/tracked", IdsList)
        cls.bodies = Latest("/humans/bodies/tracked", IdsList)

    @classmethod
    def tearDownClass(cls):
        cls.camera.close()

    def setUp(self):
        wait_for(lambda: self.faces.value and len(self.faces.value.ids) == 3, START_S, "three faces")
        wait_for(lambda: self.bodies.value and len(self.bodies.value.ids) >= 3, START_S, "three bodies")

    def listen(self, kind, ids, name, message):
        topics = {identity: Latest("/humans/{}/{}/{}".format(kind, identity, name), message) for identity in ids}
        for newest in topics.values():
            self.addCleanup(newest.close)
        tracked = {"faces": self.faces, "bodies": self.bodies}[kind]
        # A body that was there for a moment only has left again.
        wait_for(lambda: all(newest.value or identity not in tracked.value.ids for identity, newest in topics.items()),
                 WAIT_S, "{} of all {}".format(name, kind))
        return {identity: newest for identity, newest in topics.items() if newest.value}

    def test_every_face_has_one_nose(self):
        landmarks = self.listen("faces", self.faces.value.ids, "landmarks", FacialLandmarks)

        def noses_per_face():
            # The body of a face may come after three others.
            skeletons = self.listen("bodies", self.bodies.value.ids, "skeleton2d", Skeleton2D)
            noses = np.array([(newest.value.skeleton[0].x, newest.value.skeleton[0].y)
                              for newest in skeletons.values()]).reshape(-1, 2)
            outlines = [np.array([(point.x, point.y) for point in newest.value.landmarks])
                        for newest in landmarks.values()]
            return [np.all((noses > points.min(axis=0)) & (noses < points.max(axis=0)), axis=1).sum()
                    for points in outlines]

        wait_for(lambda: noses_per_face() == [1, 1, 1], WAIT_S, "one nose in each of three faces", period=0.3)

    def test_interface_rep155_changes_the_type_of_roi(self):
        rois = self.listen("bodies", self.bodies.value.ids, "roi", NormalizedRegionOfInterest2D)
        for newest in rois.values():
            self.assertTrue(0.0 <= newest.value.xmin < newest.value.xmax <= 1.0)
            self.assertIn(newest.value.header.stamp, self.camera.stamps)

    def test_faces_and_bodies_have_the_same_process(self):
        connections = [rospy.Subscriber("/humans/{}/tracked".format(kind), IdsList) for kind in ("faces", "bodies")]
        self.addCleanup(lambda: [subscriber.unregister() for subscriber in connections])
        wait_for(lambda: all(subscriber.get_num_connections() for subscriber in connections), WAIT_S, "connections")
        publishers = {connection[1] for subscriber in connections for connection in subscriber.impl.get_stats_info()}
        self.assertEqual(len(publishers), 1)


if __name__ == "__main__":
    rospy.init_node("vision_test")
    rostest.rosrun("hri_fullbody", "vision", VisionTest)
