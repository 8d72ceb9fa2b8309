#!/usr/bin/env python3
"""What navigation gets: /people with velocities and tags, and the place of each person with its covariance."""

import sys
import threading
import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import PoseWithCovarianceStamped
from people_msgs.msg import People
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from hri_msgs.msg import BodyPosture, EngagementLevel, Group, GroupsStamped, IdsList, IdsMatch
from hri_pipeline.testing import Latest, transform, wait_for

CAMERA = "camera_optical_frame"
WAIT_S = 15.0
SPEED = 0.5     # m/s, of the one who walks


class TestNavigation(unittest.TestCase):
    """Face and body of the walker, and the face of somebody who stands, 2 m ahead."""

    @classmethod
    def setUpClass(cls):
        cls.lists = {kind: rospy.Publisher("/humans/%s/tracked" % kind, IdsList, latch=True, queue_size=1)
                     for kind in ("faces", "bodies")}
        cls.tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
        cls.static = rospy.Publisher("/tf_static", TFMessage, latch=True, queue_size=1)
        # The optical frame, level, looks along x of map.
        fixed = transform("map", CAMERA, rospy.Time.now())
        rotation = fixed.transform.rotation
        rotation.x, rotation.y, rotation.z, rotation.w = -0.5, 0.5, -0.5, 0.5
        cls.static.publish(TFMessage([fixed]))
        cls.matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=10, latch=True)
        cls.seen = {"faces": ["wface", "sface"], "bodies": ["wbody"]}
        cls.stop = threading.Event()
        cls.show()
        cls.matches.publish(IdsMatch(id1="wface", id1_type=IdsMatch.FACE, id2="wbody", id2_type=IdsMatch.BODY,
                                     confidence=0.9))
        cls.start = rospy.Time.now()
        threading.Thread(target=cls.walk, daemon=True).start()

    @classmethod
    def tearDownClass(cls):
        cls.stop.set()

    @classmethod
    def show(cls):
        for kind, publisher in cls.lists.items():
            publisher.publish(IdsList(ids=cls.seen[kind]))

    @classmethod
    def walk(cls):
        """x of the camera is to the right, which is -y of map."""
        while not cls.stop.wait(1.0 / 30.0):
            now = rospy.Time.now()
            side = SPEED * (now - cls.start).to_sec()
            sent = [transform(CAMERA, "face_sface", now, 0.5, 0.0, 2.0)] if "sface" in cls.seen["faces"] else []
            sent.append(transform(CAMERA, "face_wface", now, -1.0 + side, 0.0, 4.0))
            sent.append(transform(CAMERA, "body_wbody", now, -1.0 + side, 0.6, 4.0))
            cls.tf.publish(TFMessage(sent))

    def person(self, people, near):
        """The person in the list who is so far ahead."""
        if people.value is None:
            return None
        return next((item for item in people.value.people if abs(item.position.x - near) < 0.2), None)

    def test_people_have_velocities_and_tags(self):
        people = Latest("/people", People)
        walker = wait_for(lambda: self.person(people, 4.0), WAIT_S, "the walker on /people")
        engagement = rospy.Publisher("/humans/persons/%s/engagement_status" % walker.name, EngagementLevel, latch=True,
                                     queue_size=1)
        engagement.publish(EngagementLevel(level=EngagementLevel.ENGAGED))
        posture = rospy.Publisher("/humans/bodies/wbody/posture", BodyPosture, latch=True, queue_size=1)
        posture.publish(BodyPosture(posture=BodyPosture.STANDING))
        groups = rospy.Publisher("/humans/interactions/groups", GroupsStamped, latch=True, queue_size=1)
        groups.publish(GroupsStamped(groups=[Group(group_id="gabcd", members=[walker.name, "other"])],
                                     confidences=[1.0]))
        wanted = {"group": "gabcd", "engagement": "engaged", "posture": "standing"}
        told = wait_for(lambda: next((
            item for item in [self.person(people, 4.0)]
            if item is not None and dict(zip(item.tagnames, item.tags)) == wanted
            and abs(item.velocity.y + SPEED) < 0.1), None), WAIT_S,
            lambda: "velocity and tags; the last was {}".format(self.person(people, 4.0)))
        self.assertEqual(told.reliability, 1.0)
        self.assertEqual(people.value.header.frame_id, "map")
        self.assertLess(abs(told.velocity.x), 0.05)
        standing = self.person(people, 2.0)
        self.assertLess(abs(standing.velocity.x) + abs(standing.velocity.y), 0.02)
        self.assertEqual(list(standing.tagnames), [])
        people.close()

    def test_positions_have_covariances_that_grow_when_nobody_is_seen(self):
        people = Latest("/people", People)
        name = wait_for(lambda: self.person(people, 2.0), WAIT_S, "the one who stands on /people").name
        position = Latest("/humans/persons/%s/position" % name, PoseWithCovarianceStamped)
        wait_for(lambda: position.value, WAIT_S, "a position")
        self.assertEqual(position.value.header.frame_id, "map")
        self.assertAlmostEqual(position.value.pose.pose.position.x, 2.0, delta=0.01)
        seen = np.array(position.value.pose.covariance).reshape(6, 6)
        # 12 % along the ray (mostly x of map), 2 % and 5 cm across.
        self.assertAlmostEqual(seen[0, 0] ** 0.5, 0.24, delta=0.03)
        self.assertAlmostEqual(seen[2, 2] ** 0.5, 0.07, delta=0.03)
        markers = Latest("/visualization/persons", MarkerArray)
        deleted = []
        watch = rospy.Subscriber("/visualization/persons", MarkerArray, lambda array: deleted.extend(
            marker.ns for marker in array.markers if marker.action == Marker.DELETE))
        wait_for(lambda: markers.value is not None and any(
            marker.ns == "uncertainty" and marker.type == Marker.CYLINDER and marker.scale.x > 2.0 * marker.scale.y
            for marker in markers.value.markers), WAIT_S, "an ellipse")
        type(self).seen = {"faces": ["wface"], "bodies": ["wbody"]}
        self.show()
        wait_for(lambda: position.value.pose.covariance[0] > 4.0 * seen[0, 0], WAIT_S, "a covariance that grows")
        gone = wait_for(lambda: next((item for item in people.value.people if item.name == name
                                      and item.reliability < 0.9), None), WAIT_S, "less reliability")
        self.assertEqual((gone.velocity.x, gone.velocity.y), (0.0, 0.0))
        wait_for(lambda: {"persons", "uncertainty"} <= set(deleted), 2.0 * WAIT_S, "markers that are taken back")
        watch.unregister()
        for topic in (people, position, markers):
            topic.close()


if __name__ == "__main__":
    rospy.init_node("navigation_test")
    rostest.rosrun("hri_person_manager", "navigation", TestNavigation, sys.argv)
