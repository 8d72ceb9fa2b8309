#!/usr/bin/env python3
"""The people of the six demonstration photographs, as faces, bodies and persons of the running stack."""

import time
import unittest

import numpy as np
import rospy
import rostest
from std_msgs.msg import String

from hri_msgs.msg import FacialLandmarks, Skeleton2D
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.core.sources.image_sources import open_source
from hri_pipeline.core.sources.parameters import SOURCE_PARAMETERS
from hri_pipeline.ros.conversions import landmarks_from_msg, skeleton_from_msg
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.testing import Camera

# People counted by eye: faces that are seen, and bodies of which enough is seen to be found at least.
FACES = (3, 3, 3, 4, 5, 4)
BODIES = (3, 3, 3, 3, 4, 4)
RATE = 8.0              # Hz; slow, so that a busy machine still sees most images
PATIENCE = 50.0         # s for each photograph
SAME_IMAGE = 0.3        # s between the landmarks and the skeleton that are compared
NOSE = 0


def panned(number):
    """Return what makes the images of sample<number>.jpg under a panning camera."""
    path = models_directory() / "demo" / "sample{}.jpg".format(number)
    source, began = open_source(SOURCE_PARAMETERS.resolve({"source": str(path)}), rospy.logwarn), time.monotonic()

    def image():
        source.advance(time.monotonic() - began)
        return source.image()

    return image


class Newest:
    """Follows all features of one kind and keeps the newest message of each topic."""

    def __init__(self, kind, topics):
        self.messages = {}
        self.ids = []
        self._feed = IdSubscribers(kind, topics, self._keep, self._list)

    def get(self, identity, name):
        """Newest message of a topic, None when there is none."""
        return self.messages.get((identity, name))

    def close(self):
        """Stop listening."""
        self._feed.close()

    def _keep(self, identity, name, message):
        self.messages[identity, name] = message

    def _list(self, ids):
        self.ids = list(ids)


class PhotographsTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.camera = Camera(None, "/camera/image_raw", "/camera/camera_info", RATE, "camera_optical", 1.0472)
        cls.faces = Newest("faces", {"landmarks": FacialLandmarks})
        cls.bodies = Newest("bodies", {"skeleton2d": Skeleton2D})
        cls.persons = Newest("persons", {"face_id": String, "body_id": String})

    @classmethod
    def tearDownClass(cls):
        for owner in (cls.camera, cls.faces, cls.bodies, cls.persons):
            owner.close()

    def pairs(self):
        """Face and body of every tracked person that has both."""
        found = []
        for person in self.persons.ids:
            face, body = (self.persons.get(person, name) for name in ("face_id", "body_id"))
            if face is not None and body is not None and face.data and body.data:
                found.append((face.data, body.data))
        return found

    def belongs(self, face, body):
        """Tell whether the nose of a body lies in the box of its face's landmarks, in (nearly) the same image."""
        landmarks, skeleton = self.faces.get(face, "landmarks"), self.bodies.get(body, "skeleton2d")
        if landmarks is None or skeleton is None:
            return False
        if abs((landmarks.header.stamp - skeleton.header.stamp).to_sec()) > SAME_IMAGE:
            return False
        points = landmarks_from_msg(landmarks)[:, :2]
        nose = skeleton_from_msg(skeleton)[NOSE, :2]
        low, high = points.min(axis=0), points.max(axis=0)
        return bool(np.all(nose > low) and np.all(nose < high))

    def state(self, faces, bodies):
        """(True, words) when everybody is there and every face has its own body, as far as both are there."""
        pairs = self.pairs()
        right = [pair for pair in pairs if self.belongs(*pair)]
        wanted = min(len(self.faces.ids), len(self.bodies.ids))
        words = "{} faces of {}, {} bodies of {} at least, {} persons with both, {} of them right".format(
            len(self.faces.ids), faces, len(self.bodies.ids), bodies, len(pairs), len(right))
        good = len(self.faces.ids) == faces and len(self.bodies.ids) >= bodies \
            and len(pairs) == len(right) == wanted and len(self.persons.ids) == max(faces, len(self.bodies.ids))
        return good, words

    def check(self, number):
        faces, bodies = FACES[number - 1], BODIES[number - 1]
        self.camera.show(panned(number))
        began = time.monotonic()
        held = None
        while time.monotonic() - began < PATIENCE:
            good, words = self.state(faces, bodies)
            held = (held or time.monotonic()) if good else None
            if held is not None and time.monotonic() - held > 1.0:
                print("sample{}: {} after {:.1f} s".format(number, words, held - began))
                break
            time.sleep(0.05)
        else:
            self.fail("sample{}: not within {:g} s; last: {}".format(number, PATIENCE, words))
        self.camera.show(np.zeros((720, 1280, 3), np.uint8))
        deadline = time.monotonic() + PATIENCE
        while self.faces.ids or self.bodies.ids or self.persons.ids:
            self.assertLess(time.monotonic(), deadline, "people stay tracked in black images")
            time.sleep(0.05)

    def test_each_photograph(self):
        for number in range(1, 7):
            with self.subTest(sample=number):
                self.check(number)


if __name__ == "__main__":
    rospy.init_node("photographs_test")
    rostest.rosrun("ros4hri", "photographs", PhotographsTest)
