#!/usr/bin/env python3
"""The paper's Table I on the graph, the hand-over between two cameras, and a flood of candidate matches."""

import sys
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from trackers import Trackers

from hri_msgs.msg import IdsList, IdsMatch
from hri_pipeline.testing import Latest, transform, wait_for

PERSON, FACE, BODY, VOICE = IdsMatch.PERSON, IdsMatch.FACE, IdsMatch.BODY, IdsMatch.VOICE
WAIT_S = 15.0
FLOOD = 10000


class TestPersonTable(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.trackers = Trackers()
        cls.matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=FLOOD)
        cls.tf = rospy.Publisher("/tf", TFMessage, queue_size=100)
        cls.static = rospy.Publisher("/tf_static", TFMessage, latch=True, queue_size=1)
        cls.static.publish(TFMessage([transform("map", name, rospy.Time.now())
                                      for name in ("left_cam", "right_cam")]))
        cls.tracked = Latest("/humans/persons/tracked", IdsList)
        cls.diagnostics = {}
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.keep_diagnostics, queue_size=50)

    @classmethod
    def keep_diagnostics(cls, message):
        cls.diagnostics.update({status.name.rpartition(": ")[2]: status for status in message.status
                                if "hri_person_manager" in status.name})

    def setUp(self):
        self.wait_for(lambda: self.matches.get_num_connections() and self.tf.get_num_connections() > 0
                      and self.trackers.are_heard(), "the person manager")
        self.show()
        self.wait_for(lambda: self.tracked.value is not None and not self.tracked.value.ids, "nobody to be there")

    def wait_for(self, condition, what, act=None):
        wait_for(condition, WAIT_S, what, act, 0.03)

    def show(self, faces=(), bodies=(), voices=()):
        self.trackers.show(faces=faces, bodies=bodies, voices=voices)

    def match(self, first, first_type, second, second_type, likelihood=0.9):
        self.matches.publish(IdsMatch(first, first_type, second, second_type, likelihood))

    def persons(self, count):
        self.wait_for(lambda: len(self.tracked.value.ids) == count, "%d persons" % count)
        return list(self.tracked.value.ids)

    def expect(self, person, face="", body="", voice=""):
        """Wait until the person has exactly these features."""
        topics = {name: Latest("/humans/persons/%s/%s" % (person, name), String)
                  for name in ("face_id", "body_id", "voice_id")}
        wanted = {"face_id": face, "body_id": body, "voice_id": voice}
        try:
            self.wait_for(lambda: {name: topic.value and topic.value.data for name, topic in topics.items()} == wanted,
                          "%s with %s" % (person, wanted))
        finally:
            for topic in topics.values():
                topic.close()

    # -- Table I

    def test_rows_1_and_2_a_face_and_a_redetected_face(self):
        self.show(faces=["f24ac"])
        (first,) = self.persons(1)
        self.expect(first, face="f24ac")
        self.show(faces=["d73b"])
        self.wait_for(lambda: len(self.tracked.value.ids) == 1 and first not in self.tracked.value.ids,
                      "another person")

    def test_rows_3_and_4_a_body_and_its_face(self):
        self.show(bodies=["b37ef"])
        (person,) = self.persons(1)
        self.expect(person, body="b37ef")
        self.show(faces=["d73b"], bodies=["b37ef"])
        self.match("d73b", FACE, "b37ef", BODY)
        self.expect(person, face="d73b", body="b37ef")

    def test_rows_5_to_8_a_person_with_a_face_then_another_and_a_body(self):
        self.show(faces=["d73b"])
        self.match("d73b", FACE, "p9d8a", PERSON)
        self.expect("p9d8a", face="d73b")
        self.show(faces=["f96f1"])
        self.match("f96f1", FACE, "p9d8a", PERSON)
        self.expect("p9d8a", face="f96f1")
        self.show(faces=["f96f1"], bodies=["b37ef"])
        self.match("f96f1", FACE, "b37ef", BODY)
        self.expect("p9d8a", face="f96f1", body="b37ef")
        self.assertEqual(self.persons(1), ["p9d8a"])

    def test_row_9_a_voice_of_a_person(self):
        self.show(voices=["ab7f"])
        self.match("ab7f", VOICE, "baf0", PERSON)
        self.expect("baf0", voice="ab7f")

    # -- two cameras

    def test_who_walks_from_one_camera_to_the_other_stays_who_it_is(self):
        began = rospy.Time.now()

        def walk(camera, face):
            stamp = rospy.Time.now()
            x = 1.0 + 0.5 * (stamp - began).to_sec()
            self.tf.publish(TFMessage([transform(camera, "face_" + face, stamp, x)]))

        self.show(faces=["left1"])
        self.wait_for(lambda: len(self.tracked.value.ids) == 1, "a person", act=lambda: walk("left_cam", "left1"))
        person = self.tracked.value.ids[0]
        # an anonymous person is named by its own id: nothing happens
        self.match("left1", FACE, person, PERSON, 0.9)
        confidence = time.monotonic() + 1.0
        self.wait_for(lambda: time.monotonic() > confidence, "a second of walking",
                      act=lambda: walk("left_cam", "left1"))
        self.show()
        self.wait_for(lambda: not self.tracked.value.ids, "nobody to be seen")
        self.show(faces=["right1"])
        self.wait_for(lambda: list(self.tracked.value.ids) == [person], "the same person before the other camera",
                      act=lambda: walk("right_cam", "right1"))
        self.expect(person, face="right1")

    # -- hostile input

    def test_a_flood_of_matches_is_dropped_and_counted_and_the_node_goes_on(self):
        self.show(faces=["fgood"])
        self.match("fgood", FACE, "ann", PERSON)
        self.expect("ann", face="fgood")
        names = ["a b", "a/b", "a'b", 'a"b', "", "1a", "x" * 200]
        for number in range(FLOOD):
            name = names[number % len(names)] if number % 10 == 0 else "x%d" % number
            self.match(name, FACE, "y%d" % (number % 997), BODY, (0.9, float("nan"), -1.0, 1.2)[number % 4])

        def counted():
            values = {item.key: item.value for item in self.diagnostics["candidate matches"].values} \
                if "candidate matches" in self.diagnostics else {}
            return int(values.get("refused, too many per second", 0)) > 0 \
                and int(values.get("refused, malformed id", 0)) > 0 \
                and int(values.get("refused, likelihood outside 0..1", 0)) > 0

        self.wait_for(counted, "refused matches in %s" % sorted(self.diagnostics))
        self.match("fgood", FACE, "ann", PERSON, 0.0)
        self.wait_for(lambda: "ann" not in self.tracked.value.ids, "the withdrawal", act=lambda: self.match(
            "fgood", FACE, "ann", PERSON, 0.0))
        # Said again and again, as by a matcher: of a flood that is still on its way each match may be the one too many.
        self.wait_for(lambda: "bob" in self.tracked.value.ids, "bob", act=lambda: self.match(
            "fgood", FACE, "bob", PERSON))
        self.expect("bob", face="fgood")


if __name__ == "__main__":
    rospy.init_node("test_person_table")
    rostest.rosrun("hri_person_manager", "test_person_table", TestPersonTable, sys.argv)
