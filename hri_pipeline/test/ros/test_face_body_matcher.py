#!/usr/bin/env python3
"""The face-body matcher from outside: landmarks and skeletons in, candidate matches out."""

import sys
import unittest
from pathlib import Path

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Header

from hri_msgs.msg import FacialLandmarks, IdsList, IdsMatch, NormalizedPointOfInterest2D, Skeleton2D
from hri_pipeline.testing import wait_for

sys.path.append(str(Path(__file__).resolve().parents[1] / "msgs"))

from wire_layouts import serialise  # noqa: E402

WAIT_S = 10.0


def point(x, y, c=1.0):
    return NormalizedPointOfInterest2D(x=x, y=y, c=c)


def face(x):
    """Landmarks of a face with the nose at x, in the upper third of the image."""
    points = [point(x + 0.03 * (k / 69.0 - 0.5), 0.3 + 0.03 * ((k % 5) / 4.0 - 0.5)) for k in range(70)]
    points[30] = point(x, 0.3)
    for index in range(36, 48):
        points[index] = point(x + (-0.006 if index < 42 else 0.006), 0.29)
    return points


def skeleton(x):
    """Key points of a skeleton of which only nose and eyes are seen."""
    points = [point(0.0, 0.0, 0.0)] * 18
    points[0], points[14], points[15] = point(x, 0.3), point(x + 0.006, 0.29), point(x - 0.006, 0.29)
    return points


class OlderSkeleton(Skeleton2D):
    """The message of a definition with 18 points instead of any number: same md5, other bytes."""

    def serialize(self, buff):
        buff.write(serialise("Header (float32 float32 float32)[18]", 0)[0])


class TestFaceBodyMatcher(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.faces = {name: rospy.Publisher("/humans/faces/%s/landmarks" % name, FacialLandmarks, queue_size=1)
                     for name in ("fa", "fb")}
        cls.bodies = {name: rospy.Publisher("/humans/bodies/%s/skeleton2d" % name, Skeleton2D, queue_size=1)
                      for name in ("ba", "bb")}
        cls.lists = {kind: rospy.Publisher("/humans/%s/tracked" % kind, IdsList, latch=True, queue_size=10)
                     for kind in ("faces", "bodies")}
        cls.received = []
        rospy.Subscriber("/humans/candidate_matches", IdsMatch, cls.received.append, queue_size=100)
        cls.told = set()
        rospy.Subscriber("/diagnostics", DiagnosticArray,
                         lambda array: cls.told.update(status.message for status in array.status), queue_size=10)

    def current(self):
        """Return the last confidence said of each pair."""
        return {(item.id1, item.id2): item.confidence for item in list(self.received)}

    def show(self, places):
        """Publish one image of {id: x}."""
        header = Header(stamp=rospy.Time.now(), frame_id="camera")
        for name, x in places.items():
            if name in self.faces:
                self.faces[name].publish(FacialLandmarks(header=header, landmarks=face(x), height=720, width=1280))
            else:
                self.bodies[name].publish(Skeleton2D(header=header, skeleton=skeleton(x)))

    def wait_for(self, condition, what, places):
        wait_for(condition, WAIT_S, lambda: "%s; matches: %s" % (what, self.current()), lambda: self.show(places), 0.05)

    def test_matches_follow_people_and_are_withdrawn(self):
        self.lists["faces"].publish(IdsList(ids=["fa", "fb"]))
        self.lists["bodies"].publish(IdsList(ids=["ba", "bb"]))
        places = {"fa": 0.3, "fb": 0.7, "ba": 0.301, "bb": 0.699}
        self.wait_for(lambda: self.current().get(("fa", "ba"), 0.0) > 0.8
                      and self.current().get(("fb", "bb"), 0.0) > 0.8, "two matches", places)
        self.assertEqual({(item.id1_type, item.id2_type) for item in self.received},
                         {(IdsMatch.FACE, IdsMatch.BODY)})
        self.assertNotIn(("fa", "bb"), self.current())

        del self.received[:]
        self.wait_for(lambda: len(self.current()) == 2, "the matches to be said again", places)

        swapped = dict(places, fa=0.7, fb=0.3)
        self.wait_for(lambda: self.current().get(("fa", "bb"), 0.0) > 0.5
                      and self.current().get(("fa", "ba")) == 0.0, "the new pairs", swapped)

        self.lists["bodies"].publish(IdsList(ids=["ba"]))
        del self.received[:]
        self.wait_for(lambda: sum((item.id1, item.id2) == ("fb", "ba") for item in self.received) >= 3,
                      "who has stayed", swapped)
        self.assertNotIn(("fa", "bb"), self.current(), "withdrawn, although the body has only left")

    def test_points_that_are_not_those_of_the_message_are_refused_by_the_name_of_their_topic(self):
        self.lists["faces"].publish(IdsList(ids=["fc"]))
        self.lists["bodies"].publish(IdsList(ids=["bc"]))
        few = rospy.Publisher("/humans/faces/fc/landmarks", FacialLandmarks, queue_size=1)
        older = rospy.Publisher("/humans/bodies/bc/skeleton2d", OlderSkeleton, queue_size=1)
        self.addCleanup(few.unregister)
        self.addCleanup(older.unregister)

        def told(*words):
            few.publish(FacialLandmarks(landmarks=[point(0.5, 0.5)] * 68, height=720, width=1280))
            older.publish(OlderSkeleton())
            return any(all(word in message for word in words) for message in self.told.copy())

        self.wait_for(lambda: told("/humans/faces/fc/landmarks", "70 points, not 68"), "the fault of the landmarks", {})
        self.wait_for(lambda: told("/humans/bodies/bc/skeleton2d", "definition of 18 points"),
                      "the fault of the skeleton", {})


if __name__ == "__main__":
    rospy.init_node("test_face_body_matcher")
    rostest.rosrun("hri_pipeline", "test_face_body_matcher", TestFaceBodyMatcher, sys.argv)
