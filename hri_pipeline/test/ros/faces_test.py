#!/usr/bin/env python3
"""The node faces from images to topics and frames, through a real master."""

import json
import math
import threading
import unittest

import cv2
import numpy as np
import rosnode
import rospy
import rostest
import rostopic
from sensor_msgs.msg import Image, RegionOfInterest
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import Expression, FacialActionUnits, FacialLandmarks, IdsList, IdsMatch, SoftBiometrics
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.ros.conversions import bgr_to_image, make_header, pose_from_transform
from hri_pipeline.srv import Gallery, GalleryRequest
from hri_pipeline.testing import FRAME, Camera, Latest, wait_for

PHOTOGRAPH, FACES = "sample1.jpg", 3
SIZE = (960, 640)
RATE_HZ = 10.0


class FacesTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        picture = cv2.imread(str(models_directory() / "demo" / PHOTOGRAPH))
        assert picture is not None, "no {} in {}/demo".format(PHOTOGRAPH, models_directory())
        cls.photograph = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)

    def setUp(self):
        self.lists = []
        self.transforms = {}
        self.lock = threading.Lock()
        for topic, kind, callback in (("/humans/faces/tracked", IdsList, self.lists.append),
                                      ("/tf", TFMessage, self.on_transforms)):
            self.addCleanup(rospy.Subscriber(topic, kind, callback, queue_size=100).unregister)
        self.camera = Camera(rate=RATE_HZ, fov=2.0 * math.atan(0.5))
        self.addCleanup(self.camera.close)

    def on_transforms(self, message):
        with self.lock:
            for transform in message.transforms:
                self.transforms[transform.child_frame_id] = transform

    def tracked(self):
        return self.lists[-1].ids if self.lists else []

    def first(self, kind, *topics):
        """The first message on any of these topics."""
        heard = [Latest(topic, kind) for topic in topics]
        try:
            return wait_for(lambda: next((one.value for one in heard if one.value), None), 30,
                            lambda: "{}; tracked: {}".format(topics, self.tracked()))
        finally:
            for one in heard:
                one.close()

    def see_everybody(self):
        self.camera.show(self.photograph)
        wait_for(lambda: len(self.tracked()) == FACES and self.lists[-1].header.stamp in self.camera.stamps,
                 30, "three faces of this camera are tracked")
        return list(self.tracked())

    def test_topics_and_frames_of_three_faces_then_nobody(self):
        ids = self.see_everybody()
        for identity in ids:
            self.check_topics(identity)
            self.check_frame(identity)
        self.assertEqual(list(self.tracked()), ids)
        self.check_list_is_latched(ids)
        wait_for(lambda: any("gaze_" + identity in self.transforms for identity in ids), 15, "somebody's eyes are open")
        self.check_gaze([identity for identity in ids if "gaze_" + identity in self.transforms][0])
        self.camera.show(np.zeros_like(self.photograph))
        wait_for(lambda: not self.tracked(), 15, "the list is empty in the dark")
        wait_for(lambda: not self.topics_of(ids), 15, "the topics of the faces are gone")

    def check_topics(self, identity):
        name = "/humans/faces/" + identity
        roi = self.first(RegionOfInterest, name + "/roi")
        self.assertLessEqual(roi.x_offset + roi.width, SIZE[0])
        self.assertLessEqual(roi.y_offset + roi.height, SIZE[1])
        self.assertTrue(60 < roi.width < 200 and 60 < roi.height < 200, roi)
        landmarks = self.first(FacialLandmarks, name + "/landmarks")
        self.assertEqual((landmarks.width, landmarks.height), SIZE)
        self.assertEqual(landmarks.header.frame_id, FRAME)
        self.assertIn(landmarks.header.stamp, self.camera.stamps)
        right, left = landmarks.landmarks[68], landmarks.landmarks[69]
        inside = roi.x_offset < right.x * SIZE[0] < left.x * SIZE[0] < roi.x_offset + roi.width
        self.assertTrue(inside, "the pupils lie in the box, the right one on the left of the image")

    def check_frame(self, identity):
        child = "face_" + identity
        wait_for(lambda: child in self.transforms, 15, "{} is on /tf".format(child))
        with self.lock:
            transform = self.transforms[child]
        self.assertEqual(transform.header.frame_id, FRAME)
        self.assertIn(transform.header.stamp, self.camera.stamps)
        self.assertTrue(0.3 < transform.transform.translation.z < 6.0, transform)

    def check_list_is_latched(self, ids):
        latched = rospy.wait_for_message("/humans/faces/tracked", IdsList, 5)
        self.assertEqual(list(latched.ids), ids)
        self.assertEqual(rostopic.get_topic_type("/humans/faces/tracked")[0], "hri_msgs/IdsList")

    def test_what_is_known_of_a_face_and_whose_it_is(self):
        matches = []
        self.addCleanup(rospy.Subscriber("/humans/candidate_matches", IdsMatch, matches.append,
                                         queue_size=100).unregister)
        ids = self.see_everybody()
        name = "/humans/faces/" + ids[0]
        facs = self.first(FacialActionUnits, name + "/facs")
        self.assertEqual((len(facs.intensity), len(facs.confidence)), (99, 99))
        self.assertGreater(max(facs.confidence), 0.1)
        self.assertTrue(all(0.0 <= value <= 1.0 for value in list(facs.intensity) + list(facs.confidence)))
        # Not everybody's is sure enough to be told.
        expression = self.first(Expression, *("/humans/faces/{}/expression".format(identity) for identity in ids))
        self.assertIn(expression.expression, ("neutral", "angry", "sad", "happy", "surprised", "disgusted", "scared"))
        self.assertTrue(0.0 < expression.confidence <= 1.0)
        self.check_biometrics(ids)
        for message in (facs, expression):
            self.assertEqual(message.header.frame_id, FRAME)
            self.assertIn(message.header.stamp, self.camera.stamps)
        wait_for(lambda: {match.id1 for match in matches if match.confidence > 0.5} >= set(ids), 30,
                 "everybody has a person id")
        said = {match.id1: match.id2 for match in matches if match.confidence > 0.5}
        self.assertEqual(len(set(said.values())), FACES, "three people are three persons")
        self.check_forgetting(said, matches)

    def check_biometrics(self, ids):
        kinds = {}
        subscribers = [rospy.Subscriber("/humans/faces/{}/softbiometrics".format(identity), SoftBiometrics,
                                        lambda message, identity=identity: kinds.update({identity: message}))
                       for identity in ids]
        wait_for(lambda: len(kinds) == FACES, 30, "apparent age and gender of everybody")
        for subscriber in subscribers:
            subscriber.unregister()
        for message in kinds.values():
            self.assertTrue(10 <= message.age <= 60, "three young women, {} years".format(message.age))
            self.assertIn(message.gender, (SoftBiometrics.FEMALE, SoftBiometrics.UNDEFINED))

    def check_forgetting(self, said, matches):
        rospy.wait_for_service("/hri_faces/gallery", 10)
        gallery = rospy.ServiceProxy("/hri_faces/gallery", Gallery)
        known = gallery(GalleryRequest(command=GalleryRequest.LIST))
        self.assertTrue(known.success, known)
        self.assertLessEqual(set(said.values()), set(json.loads(known.data)))
        face, person = sorted(said.items())[0]
        self.assertTrue(gallery(GalleryRequest(command=GalleryRequest.FORGET, id=person)).success)
        wait_for(lambda: any(match.id1 == face and match.id2 == person and match.confidence == 0.0
                             for match in matches),
                 10, "the match of the forgotten person is withdrawn")
        self.assertFalse(gallery(GalleryRequest(command=GalleryRequest.FORGET, id=person)).success)
        for request in (GalleryRequest(command="no such command"), GalleryRequest(command="forget", id="/etc/passwd"),
                        GalleryRequest(command="merge", id="aaaaa", other="bbbbb")):
            answer = gallery(request)
            self.assertFalse(answer.success)
            self.assertTrue(answer.message)

    def test_pictures_come_on_demand_in_the_size_of_the_parameters(self):
        ids = self.see_everybody()
        for parameter, value in (("width", 96), ("height", "tall")):
            rospy.set_param("/humans/faces/" + parameter, value)
            self.addCleanup(rospy.delete_param, "/humans/faces/" + parameter)
        for name in ("cropped", "aligned"):
            picture = rospy.wait_for_message("/humans/faces/{}/{}".format(ids[0], name), Image, 15)
            self.assertEqual((picture.width, picture.height, picture.encoding), (96, 128, "bgr8"))
            self.assertIn(picture.header.stamp, self.camera.stamps)
            self.assertGreater(np.frombuffer(picture.data, np.uint8).std(), 10.0)

    def check_gaze(self, identity):
        child = "gaze_" + identity
        wait_for(lambda: child in self.transforms, 15, "{} is on /tf".format(child))
        with self.lock:
            transform = self.transforms[child]
        self.assertEqual(transform.header.frame_id, "face_" + identity)
        self.assertIn(transform.header.stamp, self.camera.stamps)
        pose = pose_from_transform(transform)
        self.assertEqual(list(pose.translation), [0.0, 0.0, 0.0])
        self.assertGreater(pose.rotation[0, 2], 0.5, "the gaze goes out of the face")
        self.assertLess(pose.rotation[2, 1], -0.5, "y of the gaze frame points down")

    @staticmethod
    def topics_of(ids):
        published = [name for name, _ in rospy.get_published_topics("/humans/faces")]
        return [name for name in published if any("/{}/".format(identity) in name for identity in ids)]

    def test_garbage_is_survived(self):
        before = self.see_everybody()
        garbage = bgr_to_image(self.photograph, make_header(rospy.Time.now(), FRAME))
        garbage.encoding = "no such encoding"
        empty = Image(encoding="bgr8")
        short = bgr_to_image(self.photograph, make_header(rospy.Time.now(), FRAME))
        short.data = short.data[:1000]
        for message in (garbage, empty, short):
            shown = len(self.camera.stamps)
            self.camera.show(message)
            wait_for(lambda least=shown + 5: len(self.camera.stamps) >= least, 10, "the garbage is published")
        after = self.see_everybody()
        self.assertTrue(rosnode.rosnode_ping("/hri_faces", max_count=1, verbose=False))
        # Either it went on with the same faces, or it dropped them: but ids never come again for others.
        self.assertTrue(after == before or not set(after) & set(before), (before, after))


if __name__ == "__main__":
    rospy.init_node("faces_test")
    rostest.rosrun("hri_pipeline", "faces", FacesTest)
