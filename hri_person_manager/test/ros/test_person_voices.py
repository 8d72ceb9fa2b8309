#!/usr/bin/env python3
"""Whose voice it is, on the graph: the real matcher and person manager; mouths, speech and places of the test."""

import math
import sys
import threading
import time
import unittest

import rospy
import rostest
from std_msgs.msg import Bool, Float32, Header, String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import FacialActionUnits, IdsList, IdsMatch
from hri_pipeline.testing import Latest, transform, wait_for

WAIT_S = 15.0
PERIOD_S = 1.0 / 15.0


class TestPersonVoices(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.lists = {kind: rospy.Publisher("/humans/%s/tracked" % kind, IdsList, latch=True, queue_size=10)
                     for kind in ("faces", "bodies", "voices")}
        cls.matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=10)
        cls.tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
        cls.static = rospy.Publisher("/tf_static", TFMessage, latch=True, queue_size=1)
        cls.static.publish(TFMessage([transform("map", name, rospy.Time.now())
                                      for name in ("camera", "microphone")]))
        cls.publishers, cls.frames = {}, {}
        cls.persons = []
        cls.lock = threading.Lock()
        cls.world()
        rospy.Subscriber("/humans/persons/tracked", IdsList, cls.keep_persons)
        rospy.Subscriber("/tf", TFMessage, cls.keep_frames)
        threading.Thread(target=cls.live, daemon=True).start()

    @classmethod
    def keep_persons(cls, message):
        cls.persons = list(message.ids)

    @classmethod
    def keep_frames(cls, message):
        for item in message.transforms:
            if item.child_frame_id.startswith("person_"):
                cls.frames[item.child_frame_id[7:]] = (item.transform.translation.x, item.transform.translation.y)

    @classmethod
    def world(cls, mouths=(), bodies=(), voices=(), places=()):
        """mouths: {face: moves}; voices: {voice: speaks}; places: {frame: (parent, x, y)}."""
        with cls.lock:
            cls.mouths, cls.bodies, cls.voices, cls.places = dict(mouths), list(bodies), dict(voices), dict(places)
            cls.tell_places(rospy.Time.now())    # first: who is not matched for 0.3 s is somebody else
            for kind, ids in (("faces", cls.mouths), ("bodies", cls.bodies), ("voices", cls.voices)):
                cls.lists[kind].publish(IdsList(ids=sorted(ids)))
            for voice, speaks in cls.voices.items():
                cls.topic("voices/%s/is_speaking" % voice, Bool, True).publish(Bool(speaks))

    @classmethod
    def topic(cls, name, kind, latch=False):
        if name not in cls.publishers:
            cls.publishers[name] = rospy.Publisher("/humans/" + name, kind, latch=latch, queue_size=10)
        return cls.publishers[name]

    @classmethod
    def live(cls):
        """Publish the world as it is now, at 15 Hz."""
        number = 0
        while not rospy.is_shutdown():
            stamp, number = rospy.Time.now(), number + 1
            with cls.lock:
                if number % 8 == 0:
                    for kind, ids in (("faces", cls.mouths), ("bodies", cls.bodies), ("voices", cls.voices)):
                        cls.lists[kind].publish(IdsList(ids=sorted(ids)))
                for face, moves in cls.mouths.items():
                    values, certain = [0.0] * 99, [0.0] * 99
                    values[25] = values[26] = 0.25 + 0.25 * math.sin(27.0 * time.monotonic()) if moves else 0.05
                    certain[25] = certain[26] = 0.9
                    cls.topic("faces/%s/facs" % face, FacialActionUnits).publish(
                        FacialActionUnits(Header(stamp=stamp), values, certain))
                cls.tell_places(stamp)
            time.sleep(PERIOD_S)

    @classmethod
    def tell_places(cls, stamp):
        if cls.places:
            cls.tf.publish(TFMessage([transform(parent, child, stamp, x, y)
                                      for child, (parent, x, y) in cls.places.items()]))

    def setUp(self):
        self.world()
        self.wait_for(lambda: self.lists["voices"].get_num_connections() > 1 and self.matches.get_num_connections()
                      and self.tf.get_num_connections() > 1 and not self.persons, "nobody to be there")
        self.frames.clear()

    def wait_for(self, condition, what):
        wait_for(condition, WAIT_S, lambda: "%s; persons: %s" % (what, self.persons))

    def one(self):
        self.wait_for(lambda: len(self.persons) == 1, "one person")
        return self.persons[0]

    def expect(self, person, confidence=None, **wanted):
        """Wait until the person has exactly these features (face, body, voice)."""
        topics = {name: Latest("/humans/persons/%s/%s_id" % (person, name), String)
                  for name in ("face", "body", "voice")}
        certain = Latest("/humans/persons/%s/location_confidence" % person, Float32)
        features = {name: wanted.get(name, "") for name in topics}
        try:
            self.wait_for(lambda: {name: topic.data for name, topic in topics.items()} == features
                          and (confidence is None or certain.data == confidence), "%s with %s" % (person, features))
        finally:
            for topic in (*topics.values(), certain):
                topic.close()

    def test_turns_with_an_id_each_are_the_voice_of_the_face_that_moves(self):
        self.world({"fa1": False, "fb1": False})
        self.wait_for(lambda: len(self.persons) == 2, "two persons")
        persons = list(self.persons)
        self.world({"fa1": True, "fb1": False}, voices={"va1": True})
        topics = {person: Latest("/humans/persons/%s/voice_id" % person, String) for person in persons}
        faces = {person: Latest("/humans/persons/%s/face_id" % person, String) for person in persons}
        self.wait_for(lambda: any(topic.data == "va1" for topic in topics.values())
                      and {topic.data for topic in faces.values()} == {"fa1", "fb1"}, "the first turn")
        found = {faces[person].data: person for person in persons}
        self.assertEqual(topics[found["fa1"]].data, "va1")
        self.world({"fa1": False, "fb1": False}, voices={"va1": False})
        self.world({"fa1": False, "fb1": True}, voices={"va1": False, "vb1": True})
        self.wait_for(lambda: topics[found["fb1"]].data == "vb1", "the second turn")
        self.world({"fa1": True, "fb1": False}, voices={"va1": False, "vb1": False, "vc1": True})
        self.wait_for(lambda: topics[found["fa1"]].data == "vc1", "the third turn")
        self.world({"fa1": False, "fb1": False})
        self.wait_for(lambda: {topic.data for topic in topics.values()} == {""}, "both voices to end")
        self.assertEqual(sorted(self.persons), sorted(persons))

    def test_a_voice_that_nobody_can_be_seen_for_is_a_person_without_a_place(self):
        self.world({"fd1": False})
        seen = self.one()
        self.world({"fd1": False}, voices={"vd1": True})
        self.wait_for(lambda: len(self.persons) == 2, "a person of the voice")
        heard = next(person for person in self.persons if person != seen)
        self.assertTrue(heard.startswith("anonymous_person_"))
        self.expect(heard, 0.0, voice="vd1")
        self.assertNotIn(heard, self.frames)
        self.world({"fd1": False})
        self.wait_for(lambda: self.persons == [seen], "the person of the voice to go with it")

    def test_a_voice_with_a_direction_is_a_person_at_that_place(self):
        self.world(voices={"ve1": True}, places={"voice_ve1": ("microphone", 0.6, 0.8)})
        heard = self.one()
        self.expect(heard, 1.0, voice="ve1")
        self.wait_for(lambda: self.frames.get(heard) == (0.6, 0.8), "the frame at the voice")
        self.world(voices={"vf1": True}, places={"voice_vf1": ("microphone", 0.62, 0.78)})
        self.expect(heard, voice="vf1")      # another voice from there, before the place is forgotten
        self.assertEqual(self.persons, [heard])

    def test_a_voice_from_the_place_of_a_body_is_that_of_the_body(self):
        places = {"body_bg1": ("camera", 2.0, 1.0)}
        self.world(bodies=["bg1"], places=places)
        person = self.one()
        places["voice_vg1"] = ("microphone", 0.9, 0.45)
        self.world(bodies=["bg1"], voices={"vg1": True}, places=places)
        self.expect(person, 1.0, body="bg1", voice="vg1")
        self.assertEqual(self.persons, [person])

    def test_a_recognised_face_and_its_voice_are_the_permanent_person(self):
        self.world({"fh1": True}, bodies=["bh1"], voices={"vh1": True})
        for first, kind, second, other in (("fh1", IdsMatch.FACE, "ann", IdsMatch.PERSON),
                                           ("fh1", IdsMatch.FACE, "bh1", IdsMatch.BODY)):
            self.matches.publish(IdsMatch(first, kind, second, other, 0.9))
        self.expect("ann", face="fh1", body="bh1", voice="vh1")
        self.world({"fh1": False}, bodies=["bh1"])
        self.expect("ann", face="fh1", body="bh1")


if __name__ == "__main__":
    rospy.init_node("test_person_voices")
    rostest.rosrun("hri_person_manager", "test_person_voices", TestPersonVoices, sys.argv)
