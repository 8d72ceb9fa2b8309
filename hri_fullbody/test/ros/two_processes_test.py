#!/usr/bin/env python3
"""The nodes faces and bodies apart: the bodies find by the published faces whom they would miss without."""

import unittest

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray

from hri_msgs.msg import FacialLandmarks, IdsList, Skeleton2D
from hri_pipeline.testing import Camera, Latest, photograph, wait_for

START_S = 60.0


class TwoProcessesTest(unittest.TestCase):

    def setUp(self):
        self.camera = Camera(photograph(6))
        self.addCleanup(self.camera.close)
        self.lists = {kind: Latest("/humans/{}/tracked".format(kind), IdsList) for kind in ("faces", "bodies")}
        self.topics = {}
        self.threads = {}
        subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, self.on_diagnostics)
        self.addCleanup(subscriber.unregister)

    def on_diagnostics(self, message):
        self.threads.update({status.name: value.value for status in message.status for value in status.values
                             if value.key == "threads"})

    def newest(self, kind, name, message):
        """Follow the tracked ids of a kind and return what they last published."""
        ids = self.lists[kind].value.ids if self.lists[kind].value else []
        for identity in ids:
            if identity not in self.topics:
                self.topics[identity] = Latest("/humans/{}/{}/{}".format(kind, identity, name), message)
        return [self.topics[identity].value for identity in ids if self.topics[identity].value]

    def noses_per_face(self):
        """Number of noses inside each face."""
        faces = self.newest("faces", "landmarks", FacialLandmarks)
        bodies = self.newest("bodies", "skeleton2d", Skeleton2D)
        noses = np.array([(body.skeleton[0].x, body.skeleton[0].y) for body in bodies]).reshape(-1, 2)
        counts = []
        for face in faces:
            points = np.array([(point.x, point.y) for point in face.landmarks])
            counts.append(int(np.all((noses > points.min(axis=0)) & (noses < points.max(axis=0)), axis=1).sum()))
        return counts

    def test_every_face_gets_its_own_body(self):
        # One body that is made of two who stand side by side may be the first, and goes when both are found.
        wait_for(lambda: self.noses_per_face() == [1, 1, 1, 1] and len(self.lists["bodies"].value.ids) == 4, START_S,
                 "one nose in each of four faces, and no other body")
        ids = list(self.lists["bodies"].value.ids)
        seen = len(self.camera.stamps)
        wait_for(lambda: len(self.camera.stamps) > seen + 12, START_S, "two more seconds of images")
        self.assertEqual(self.lists["bodies"].value.ids, ids)
        self.assertEqual(self.noses_per_face(), [1, 1, 1, 1])
        wait_for(lambda: sorted(self.threads.values()) == ["3", "3"], START_S, "the threads of both")


if __name__ == "__main__":
    rospy.init_node("two_processes_test")
    rostest.rosrun("hri_fullbody", "two_processes", TwoProcessesTest)
