#!/usr/bin/env python3
"""The people of one photograph, seen by two cameras: each human is one person, and stays it with one camera."""

import threading
import time
import unittest

import cv2
import numpy as np
import rospy
import rostest
from geometry_msgs.msg import TransformStamped
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.core.sources.image_sources import fit_image
from hri_pipeline.ros.conversions import bgr_to_image
from hri_pipeline.ros.subscriptions import IdSubscribers

PEOPLE = 3
PHOTOGRAPH = "demo/sample1.jpg"
RATE = 6.0
PATIENCE = 60.0         # s for each change
HELD = 2.0              # s for which a state has to stay
WIDTH, HEIGHT = 1280, 720
TURN = {"left": 0.0, "right": 0.15}     # rad about the vertical: the right camera looks to the right


class Cameras:
    """Two cameras at one place. A camera that only turns sees the same picture through a homography."""

    def __init__(self, picture):
        self._model = CameraModel.from_fov(WIDTH, HEIGHT, 1.0472)
        self._pictures = {}
        transforms = []
        for name, angle in TURN.items():
            turn = Rotation.from_euler("y", angle)
            matrix = self._model.matrix
            self._pictures[name] = cv2.warpPerspective(
                picture, matrix @ turn.as_matrix().T @ np.linalg.inv(matrix), (WIDTH, HEIGHT))
            # x right, y down, z forward as seen by the camera; x forward, y left, z up in map.
            link = TransformStamped(child_frame_id=name + "_optical_frame")
            link.header.frame_id = "map"
            link.transform.translation.z = 1.5
            turned = (Rotation.from_quat((-0.5, 0.5, -0.5, 0.5)) * turn).as_quat()
            rotation = link.transform.rotation
            rotation.x, rotation.y, rotation.z, rotation.w = (float(value) for value in turned)
            transforms.append(link)
        self._static = rospy.Publisher("/tf_static", TFMessage, latch=True, queue_size=1)
        self._static.publish(TFMessage(transforms))
        self.covered = set()
        self._publishers = {name: (rospy.Publisher("/%s/image_raw" % name, Image, queue_size=1),
                                   rospy.Publisher("/%s/camera_info" % name, CameraInfo, queue_size=1))
                            for name in TURN}
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self):
        """Stop."""
        self._closed.set()
        self._thread.join()

    def _run(self):
        dark = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        while not self._closed.wait(1.0 / RATE):
            for name, (images, infos) in self._publishers.items():
                header = Header(stamp=rospy.Time.now(), frame_id=name + "_optical_frame")
                info = CameraInfo(header=header, width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", D=[0.0] * 5)
                info.K = self._model.matrix.ravel().tolist()
                infos.publish(info)
                images.publish(bgr_to_image(dark if name in self.covered else self._pictures[name], header))


class TwoCamerasTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        picture = cv2.imread(str(models_directory() / PHOTOGRAPH))
        cls.cameras = Cameras(fit_image(picture, WIDTH, HEIGHT, "letterbox"))
        cls.faces = IdSubscribers("faces", {}, lambda *_: None)
        cls.persons = ()
        cls.listener = rospy.Subscriber("/humans/persons/tracked", IdsList, cls.keep_persons)

    @classmethod
    def keep_persons(cls, message):
        cls.persons = tuple(sorted(message.ids))

    @classmethod
    def tearDownClass(cls):
        cls.listener.unregister()
        cls.faces.close()
        cls.cameras.close()

    def wait_for(self, faces, persons=None):
        """Wait until so many faces are tracked, of PEOPLE persons who have been recognised (of these persons); returns
        them."""
        deadline, held, before = time.monotonic() + PATIENCE, None, None
        while time.monotonic() < deadline:
            now = (len(self.faces.ids), self.persons)
            known = not any(person.startswith("anonymous_person_") for person in now[1])
            good = now[0] == faces and len(now[1]) == PEOPLE and known and persons in (None, now[1])
            held = (held if now == before else None) or time.monotonic() if good else None
            before = now
            if held is not None and time.monotonic() - held > HELD:
                return now[1]
            time.sleep(0.05)
        self.fail("not within %g s: %d faces of %s; last: %d faces, %s" % (
            PATIENCE, faces, persons or "%d persons" % PEOPLE, *before))

    def test_each_human_is_one_person(self):
        persons = self.wait_for(2 * PEOPLE)
        self.cameras.covered = {"left"}
        self.wait_for(PEOPLE, persons)
        self.cameras.covered = set()
        self.wait_for(2 * PEOPLE, persons)
        self.cameras.covered = {"right"}
        self.wait_for(PEOPLE, persons)


if __name__ == "__main__":
    rospy.init_node("two_cameras_test")
    rostest.rosrun("ros4hri", "two_cameras", TwoCamerasTest)
