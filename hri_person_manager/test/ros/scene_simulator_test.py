#!/usr/bin/env python3
"""The scene simulator and the real person manager: people of the scene become persons at their true places."""

import threading
import unittest

import numpy as np
import rosgraph
import rospy
import rostest
from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import FacialActionUnits, FacialLandmarks, IdsList, Skeleton2D
from hri_pipeline.core.ids import is_valid_id
from hri_pipeline.core.simulation.scene_file import load_scene
from hri_pipeline.ros.conversions import matrix_from_image
from hri_pipeline.testing import wait_for

PEOPLE = ["ann", "bob", "cho"]
WHERE = 0.35    # m; depth noise is 3 % of 3 m, and a frame may be 0.1 s older than the truth beside it


class Ears:
    """Hears the last list of each kind, the places of persons, the truth, and every frame by name."""

    def __init__(self):
        self.lock = threading.Lock()
        self.lists, self.heads, self.order, self.places, self.frames, self.ids = {}, {}, {}, {}, {}, set()
        for kind in ("faces", "bodies", "voices", "persons"):
            rospy.Subscriber("/humans/{}/tracked".format(kind), IdsList, self._list, callback_args=kind)
        rospy.Subscriber("/scene/truth/persons", IdsList, self._order)
        rospy.Subscriber("/scene/truth/heads", PoseArray, self._heads)
        rospy.Subscriber("/tf", TFMessage, self._tf, queue_size=100)

    def _list(self, message, kind):
        with self.lock:
            self.lists[kind] = list(message.ids)
            if kind in ("faces", "bodies"):
                self.ids.update(message.ids)

    def _order(self, message):
        with self.lock:
            self.order[message.header.stamp] = list(message.ids)

    def _heads(self, message):
        with self.lock:
            self.heads[message.header.stamp] = [(p.position.x, p.position.y, p.position.z) for p in message.poses]

    def _tf(self, message):
        with self.lock:
            for item in message.transforms:
                place = item.transform.translation
                self.frames[item.child_frame_id] = item
                if item.child_frame_id.startswith("person_"):
                    self.places[item.child_frame_id[7:], item.header.stamp] = (item.header.frame_id, place.x, place.y,
                                                                               place.z)

    def errors(self):
        """(person, error in m) wherever a place and the truth have the same stamp."""
        with self.lock:
            found = []
            for (person, stamp), (frame, *place) in self.places.items():
                ids, heads = self.order.get(stamp), self.heads.get(stamp)
                if frame == "map" and ids and heads and len(ids) == len(heads) and person in ids:
                    found.append((person, float(np.linalg.norm(np.subtract(place, heads[ids.index(person)])))))
            return found


class TestSceneSimulator(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        rospy.init_node("scene_simulator_test")
        cls.ears = Ears()

    def test_people_become_persons_where_they_are(self):
        wait_for(lambda: sorted(self.ears.lists.get("persons", [])) == PEOPLE, 20.0, "three persons, by their names")
        wait_for(lambda: {person for person, _ in self.ears.errors()} == set(PEOPLE) and len(self.ears.errors()) > 60,
                 10.0,
                 "places and truth of one stamp for everybody")
        errors = [error for _, error in self.ears.errors()]
        self.assertLess(float(np.median(errors)), 0.15)
        self.assertLess(float(np.percentile(errors, 95)), WHERE)

    def test_features_are_as_those_of_detectors(self):
        face = wait_for(lambda: next(iter(self.ears.lists.get("faces", [])), None), 20.0, "a face")
        body = wait_for(lambda: next(iter(self.ears.lists.get("bodies", [])), None), 20.0, "a body")
        self.assertTrue(all(is_valid_id(identity) for identity in self.ears.ids))
        points = rospy.wait_for_message("/humans/faces/{}/landmarks".format(face), FacialLandmarks, 10.0)
        self.assertEqual((len(points.landmarks), points.width, points.header.frame_id),
                         (70, 1280, "camera_color_optical_frame"))
        units = rospy.wait_for_message("/humans/faces/{}/facs".format(face), FacialActionUnits, 10.0)
        self.assertEqual(len(units.intensity), 99)
        skeleton = rospy.wait_for_message("/humans/bodies/{}/skeleton2d".format(body), Skeleton2D, 10.0)
        self.assertGreater(sum(point.c > 0.5 for point in skeleton.skeleton), 8)
        colours = matrix_from_image(rospy.wait_for_message("/humans/bodies/{}/appearance".format(body), Image, 10.0))
        self.assertTrue(colours.shape == (5, 21) and np.allclose(colours.sum(axis=1), 1.0))
        self.assertEqual(rospy.wait_for_message("camera_info", CameraInfo, 10.0).width, 1280)
        for frame in ("face_" + face, "gaze_" + face, "body_" + body, "head_" + body):
            wait_for(lambda frame=frame: frame in self.ears.frames, 10.0, "the frame " + frame)
        self.assertEqual(self.ears.frames["head_" + body].header.frame_id, "body_" + body)

    def test_the_script_is_there_for_whoever_comes_late(self):
        text = rospy.wait_for_message("/scene/truth/script", String, 10.0).data
        path = rospy.get_param("/scene_simulator/scene")
        self.assertEqual(text, load_scene(path).text)

    def test_z_at_the_end_everybody_leaves_and_comes_again(self):
        before = set(wait_for(lambda: set(self.ears.lists.get("bodies", [])), 20.0, "bodies"))
        wait_for(lambda: self.ears.lists["bodies"] == [] and self.ears.lists["faces"] == [], 25.0, "nobody")
        wait_for(lambda: not topics_of(before), 5.0, "the topics of who has gone are closed")
        after = set(wait_for(lambda: len(self.ears.lists["bodies"]) == 3 and self.ears.lists["bodies"], 10.0,
                             "three again"))
        self.assertFalse(before & after, "ids are given once")
        wait_for(lambda: sorted(self.ears.lists["persons"]) == PEOPLE, 10.0, "the same three persons")


def topics_of(ids):
    """Topics of these ids that somebody publishes."""
    published, _, _ = rosgraph.Master("/scene_simulator_test").getSystemState()
    return [topic for topic, _ in published if any("/{}/".format(identity) in topic for identity in ids)]


if __name__ == "__main__":
    rostest.rosrun("hri_person_manager", "scene_people", TestSceneSimulator)
