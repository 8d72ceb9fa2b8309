#!/usr/bin/env python3
"""The person manager from outside: lists, matches and transforms in; lists, latched topics and frames out."""

import os
import sys
import threading
import time
import unittest
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool, Float32, String
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage
from trackers import Trackers

from hri_msgs.msg import IdsList, IdsMatch
from hri_pipeline.testing import Latest, transform, wait_for

CAMERA = "camera_optical_frame"
WAIT_S = 10.0


def placed(parent, child, x):
    return transform(parent, child, rospy.Time.now(), x)


class TestPersonManager(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.reference = rospy.get_param("/humans/reference_frame", "map")
        cls.connected = rospy.get_param("~connected", True)
        cls.trackers = Trackers()
        cls.matches = rospy.Publisher("/humans/candidate_matches", IdsMatch, queue_size=5000)
        cls.tf = rospy.Publisher("/tf", TFMessage, queue_size=1000)
        cls.static = rospy.Publisher("/tf_static", TFMessage, latch=True, queue_size=10)
        if cls.connected:
            cls.static.publish(TFMessage([placed(cls.reference, "base_link", 10.0),
                                          placed("base_link", CAMERA, 1.0)]))
        cls.frames = {}
        cls.arrivals = {}
        cls.lock = threading.Lock()
        rospy.Subscriber("/tf", TFMessage, cls._on_tf, tcp_nodelay=True)
        cls.tracked = Latest("/humans/persons/tracked", IdsList)
        cls.known = Latest("/humans/persons/known", IdsList)

    @classmethod
    def _on_tf(cls, message):
        now = time.monotonic()
        with cls.lock:
            for item in message.transforms:
                if item.child_frame_id.startswith("person_"):
                    cls.frames.setdefault(item.child_frame_id[7:], []).append(item)
                    cls.arrivals.setdefault((item.child_frame_id[7:], item.header.stamp.to_nsec()), now)

    def setUp(self):
        self.opened = []
        self.wait_for(lambda: self.matches.get_num_connections() and self.tf.get_num_connections() > 1
                      and self.trackers.are_heard(), "the person manager")
        self.announce()
        # Features that are tracked survive a reset: first everybody leaves.
        self.wait_for(lambda: self.tracked.value is not None and not self.tracked.value.ids, "an empty list")
        rospy.wait_for_service("/hri_person_manager/reset", WAIT_S)
        rospy.ServiceProxy("/hri_person_manager/reset", Empty)()
        self.wait_for(lambda: self.known.value is not None and not self.known.value.ids, "nobody known")
        with self.lock:
            self.frames.clear()

    def tearDown(self):
        for latest in self.opened:
            latest.close()

    # -- helpers

    def wait_for(self, condition, what, seconds=WAIT_S, act=None):
        """Wait until the condition holds and return its value; `act` is done again and again meanwhile."""
        return wait_for(condition, seconds, what, act, 0.03)

    @classmethod
    def announce(cls, faces=(), bodies=(), voices=()):
        cls.trackers.show(faces=faces, bodies=bodies, voices=voices)

    def match(self, id1, type1, id2, type2, confidence):
        self.matches.publish(IdsMatch(id1, type1, id2, type2, confidence))

    def latest(self, person, name, kind):
        return self.keep(Latest("/humans/persons/%s/%s" % (person, name), kind))

    def keep(self, latest):
        """Close it at the end of the test."""
        self.opened.append(latest)
        return latest

    def show(self, *frames):
        """Publish transforms in the camera's frame: pairs of frame and x; return their stamp."""
        stamp = rospy.Time.now()
        self.tf.publish(TFMessage([transform(CAMERA, frame, stamp, x) for frame, x in frames]))
        return stamp

    def last_frame(self, person):
        with self.lock:
            return self.frames.get(person, [None])[-1]

    def one_person(self):
        return self.wait_for(lambda: len(self.tracked.value.ids) == 1 and self.tracked.value.ids[0],
                             "one person")

    def expected_x(self, x):
        return (self.reference, x + 11.0) if self.connected else (CAMERA, x)

    # -- tests

    def test_a_face_becomes_a_person_with_a_frame_of_the_same_stamp(self):
        self.announce(faces=["faaaa"])
        person = self.one_person()
        self.assertTrue(person.startswith("anonymous_person_"))
        self.assertEqual(self.wait_for(lambda: self.known.value.ids, "known persons"), [person])
        stamp = self.show(("face_faaaa", 2.0))
        published = self.wait_for(lambda: self.last_frame(person), "its frame")
        self.assertEqual(published.header.stamp, stamp)
        frame, x = self.expected_x(2.0)
        self.assertEqual(published.header.frame_id, frame)
        self.assertAlmostEqual(published.transform.translation.x, x)
        for name, kind, value in (("face_id", String, "faaaa"), ("body_id", String, ""), ("voice_id", String, ""),
                                  ("anonymous", Bool, True), ("alias", String, ""),
                                  ("location_confidence", Float32, 1.0)):
            latest = self.latest(person, name, kind)    # a late subscriber: all of them are latched
            self.wait_for(lambda wanted=value, got=latest: got.value is not None and got.value.data == wanted, name)

    def test_the_face_places_the_person_before_the_body_and_frames_follow_at_once(self):
        self.announce(faces=["fbbbb"], bodies=["bbbbb"])
        self.match("fbbbb", IdsMatch.FACE, "bbbbb", IdsMatch.BODY, 0.9)
        person = self.one_person()
        body_id = self.latest(person, "body_id", String)
        self.wait_for(lambda: body_id.value and body_id.value.data == "bbbbb", "body_id")
        delays = []
        for _ in range(40):
            sent = time.monotonic()
            stamp = self.show(("face_fbbbb", 2.0), ("body_bbbbb", 3.0))
            delays.append(self.wait_for(lambda s=stamp: self.arrivals.get((person, s.to_nsec())), "a frame") - sent)
        with self.lock:
            received = list(self.frames[person])
        self.assertAlmostEqual(received[-1].transform.translation.x, self.expected_x(2.0)[1])
        stamps = [item.header.stamp for item in received]
        self.assertEqual(len(stamps), len(set(stamps)), "a stamp was published twice")
        delays.sort()
        print("face TF -> person TF, there and back: median %.1f ms, max %.1f ms"
              % (1e3 * delays[len(delays) // 2], 1e3 * delays[-1]))
        self.assertLess(delays[len(delays) // 2], 0.05)
        self.announce(bodies=["bbbbb"])
        self.wait_for(lambda: abs(self.last_frame(person).transform.translation.x - self.expected_x(3.0)[1]) < 0.1,
                      "the place of the body, by and by", act=lambda: self.show(("body_bbbbb", 3.0)))

    def test_images_of_the_body_that_come_after_those_of_the_face_send_no_stamp_again(self):
        self.announce(faces=["fanna"], bodies=["banna"])
        self.match("fanna", IdsMatch.FACE, "banna", IdsMatch.BODY, 0.9)
        person = self.one_person()
        images = []
        for _ in range(10):
            images.append(self.show(("face_fanna", 2.0)))
            time.sleep(0.1)
        self.wait_for(lambda: self.last_frame(person) is not None, "the frame by the face")
        for stamp in images:
            # The body is a second behind, and by now alone.
            self.tf.publish(TFMessage([transform(CAMERA, "body_banna", stamp, 2.0)]))
            time.sleep(0.1)
        last = self.show(("body_banna", 2.5))
        self.wait_for(lambda: self.last_frame(person).header.stamp >= last, "the frame goes on")
        with self.lock:
            stamps = [frame.header.stamp for frame in self.frames[person]]
        self.assertEqual(stamps, sorted(set(stamps)))

    def test_the_frame_follows_a_body_that_lags_after_a_silence(self):
        self.announce(bodies=["bolga"])
        person = self.one_person()

        def see(x):
            stamp = rospy.Time.now() - rospy.Duration(1.6)
            self.tf.publish(TFMessage([transform("slow_optical_frame", "body_bolga", stamp, x)]))

        self.wait_for(lambda: self.last_frame(person), "a frame", act=lambda: see(2.0))
        silence = rospy.Time.now()
        self.wait_for(lambda: self.last_frame(person).header.stamp > silence, "the last place is sent again")
        began, moved = self.last_frame(person), []
        for number in range(12):
            see(2.0 + 0.1 * number)
            time.sleep(0.1)
            moved.append(self.last_frame(person))
        self.assertGreater(moved[-1].transform.translation.x, began.transform.translation.x + 0.5)
        stamps = [frame.header.stamp for frame in moved]
        self.assertEqual(stamps, sorted(stamps))

    def test_without_a_face_the_person_stands_at_the_head_of_its_skeleton(self):
        # As robot_state_publisher sends it: fixed links once, before or after the body is told of, the others together.
        self.static.publish(TFMessage([placed("y_head_bhhhh", "head_bhhhh", 0.05),
                                       placed("waist_bhhhh", "torso_bhhhh", 0.5)]))
        self.announce(bodies=["bhhhh"])
        person = self.one_person()

        def move():
            stamp = rospy.Time.now()
            self.tf.publish(TFMessage([transform(CAMERA, "body_bhhhh", stamp, 3.0)]))
            self.tf.publish(TFMessage([transform(parent, child + "_bhhhh", stamp, x) for parent, child, x in (
                ("body_bhhhh", "waist", 0.0), ("torso_bhhhh", "l_y_shoulder", 9.0), ("torso_bhhhh", "y_head", 0.1),
                ("l_y_shoulder_bhhhh", "l_elbow", 9.0))]))

        self.wait_for(lambda: self.last_frame(person)
                      and abs(self.last_frame(person).transform.translation.x - self.expected_x(3.65)[1]) < 1e-9,
                      "the place of the head", act=move)

    def test_the_confidence_decays_and_the_frame_ends(self):
        self.announce(faces=["fcccc"])
        person = self.one_person()
        confidence = self.latest(person, "location_confidence", Float32)
        self.wait_for(lambda: confidence.value and confidence.value.data == 1.0, "confidence 1",
                      act=lambda: self.show(("face_fcccc", 2.0)))
        del confidence.messages[:-1]
        self.announce()
        self.wait_for(lambda: person not in self.tracked.value.ids, "the end of tracking")
        self.wait_for(lambda: confidence.value.data == 0.0 or person not in self.known.value.ids, "confidence 0")
        values = [message.data for message in confidence.messages]
        self.assertEqual(values, sorted(values, reverse=True))
        self.assertTrue(any(0.0 < value < 1.0 for value in values), values)
        with self.lock:
            frames = list(self.frames[person])
        self.assertGreater(len(frames), 3)
        self.assertAlmostEqual(frames[-1].transform.translation.x, self.expected_x(2.0)[1])
        self.assertEqual(len({item.header.stamp for item in frames}), len(frames))

    def test_the_confidence_decays_and_the_frame_ends_when_the_transforms_of_a_listed_face_stop(self):
        self.announce(faces=["fiiii"])
        person = self.one_person()
        confidence = self.latest(person, "location_confidence", Float32)
        self.wait_for(lambda: confidence.value and confidence.value.data == 1.0, "confidence 1",
                      act=lambda: self.show(("face_fiiii", 2.0)))
        del confidence.messages[:-1]
        self.wait_for(lambda: confidence.value.data == 0.0, "confidence 0")
        values = [message.data for message in confidence.messages]
        self.assertEqual(values, sorted(values, reverse=True))
        self.assertTrue(any(0.0 < value < 1.0 for value in values), values)
        self.assertEqual(list(self.tracked.value.ids), [person])
        with self.lock:
            frames = list(self.frames[person])
        self.assertAlmostEqual(frames[-1].transform.translation.x, self.expected_x(2.0)[1])
        self.wait_for(lambda: confidence.value.data == 1.0, "confidence 1 again",
                      act=lambda: self.show(("face_fiiii", 3.0)))

    def test_a_place_told_before_the_person_exists_places_it(self):
        self.announce(voices=["vjjjj"])
        begin, stamps = time.monotonic(), []
        # Its person is made voice_person_delay (2 s) after the list.
        self.wait_for(lambda: time.monotonic() > begin + 1.0, "a second",
                      act=lambda: stamps.append(self.show(("voice_vjjjj", 2.0))))
        self.assertEqual(self.tracked.value.ids, [])
        person = self.one_person()
        frame = self.wait_for(lambda: self.frames.get(person, [None])[0], "its frame")
        self.assertAlmostEqual(frame.transform.translation.x, self.expected_x(2.0)[1])
        self.assertGreaterEqual(frame.header.stamp, stamps[-1])

    def test_a_head_without_a_body_frame_places_its_person(self):
        self.announce(bodies=["bkkkk"])
        person = self.one_person()
        self.wait_for(lambda: self.last_frame(person), "its frame", act=lambda: self.show(("head_bkkkk", 2.0)))
        self.assertAlmostEqual(self.last_frame(person).transform.translation.x, self.expected_x(2.0)[1])

    def test_a_fixed_frame_that_came_before_its_list_places_the_person(self):
        self.static.publish(TFMessage([placed(CAMERA, "face_fllll", 2.0)]))
        self.announce(faces=["fllll"])
        person = self.one_person()
        self.wait_for(lambda: self.last_frame(person), "its frame")

    def test_a_standing_adult_before_the_robot_is_in_personal_space(self):
        """robot_frame is base_link, on the floor; without a map it tells what is horizontal."""
        if not self.connected:
            self.static.publish(TFMessage([placed("base_link", CAMERA, 1.0)]))
        spaces = {name: self.keep(Latest("/humans/persons/in_%s_space" % name, IdsList))
                  for name in ("personal", "social")}
        self.announce(faces=["fmmmm", "fnnnn"])
        self.wait_for(lambda: len(self.tracked.value.ids) == 2, "two persons")

        def move():
            near, far = placed(CAMERA, "face_fmmmm", -0.4), placed(CAMERA, "face_fnnnn", 1.0)
            near.transform.translation.z = far.transform.translation.z = 1.6
            self.tf.publish(TFMessage([near, far]))

        self.wait_for(lambda: all(space.value and len(space.value.ids) == 1 for space in spaces.values()),
                      "one person at 0.6 m and one at 2 m", act=move)

    def test_a_recognised_person_and_its_alias(self):
        self.announce(faces=["fdddd"])
        anonymous = self.one_person()
        alias = self.latest(anonymous, "alias", String)
        self.match("fdddd", IdsMatch.FACE, "ann", IdsMatch.PERSON, 0.9)
        self.wait_for(lambda: list(self.tracked.value.ids) == ["ann"], "the recognised person")
        self.wait_for(lambda: alias.value and alias.value.data == "ann", "the alias")
        known = self.latest("ann", "anonymous", Bool)
        self.wait_for(lambda: known.value is not None and known.value.data is False, "anonymous to be false")
        self.announce()
        self.wait_for(lambda: not self.tracked.value.ids, "the end of tracking")
        self.assertIn("ann", self.known.value.ids)

    def test_a_withdrawn_match_parts_face_and_body(self):
        self.announce(faces=["feeee"], bodies=["beeee"])
        self.match("feeee", IdsMatch.FACE, "beeee", IdsMatch.BODY, 0.9)
        self.one_person()
        self.match("feeee", IdsMatch.FACE, "beeee", IdsMatch.BODY, 0.0)
        self.wait_for(lambda: len(self.tracked.value.ids) == 2, "two persons")

    def test_two_who_are_told_to_be_two_part_within_two_seconds(self):
        self.announce(faces=["fnnnn"], bodies=["bnnnn"])
        self.match("fnnnn", IdsMatch.FACE, "ann", IdsMatch.PERSON, 0.9)
        self.match("bnnnn", IdsMatch.BODY, "ann", IdsMatch.PERSON, 0.6)
        body_id = self.latest("ann", "body_id", String)
        self.wait_for(lambda: body_id.value and body_id.value.data == "bnnnn", "ann with the body")
        said = time.monotonic()
        self.match("fnnnn", IdsMatch.FACE, "bnnnn", IdsMatch.BODY, 0.0)
        self.wait_for(lambda: body_id.value.data == "" and len(self.tracked.value.ids) == 2, "two persons")
        self.assertLess(time.monotonic() - said, 2.5)       # and what the topics of a new person take

    def test_a_recogniser_that_doubts_takes_the_name_from_the_body_as_well(self):
        self.announce(faces=["fdddd"], bodies=["bdddd"])
        self.match("fdddd", IdsMatch.FACE, "bdddd", IdsMatch.BODY, 0.9)
        self.match("fdddd", IdsMatch.FACE, "ann", IdsMatch.PERSON, 0.9)
        self.match("bdddd", IdsMatch.BODY, "ann", IdsMatch.PERSON, 0.7)
        self.wait_for(lambda: self.tracked.value.ids == ["ann"], "ann")
        said = time.monotonic()
        self.match("fdddd", IdsMatch.FACE, "ann", IdsMatch.PERSON, 0.2)
        self.wait_for(lambda: self.tracked.value.ids and "ann" not in self.tracked.value.ids, "somebody unknown")
        self.assertLess(time.monotonic() - said, 2.5)

    def test_hostile_matches_and_ids_do_no_harm(self):
        for value in (float("nan"), float("inf"), -1.0, 1.2, 5.0):
            self.match("fffff", IdsMatch.FACE, "bffff", IdsMatch.BODY, value)
        for text in ("", " ", "a/b", "a b", "a'b", "1a", "x" * 100, "\u00e9"):
            self.match(text, IdsMatch.FACE, text, IdsMatch.PERSON, 0.9)
        self.match("fffff", 77, "bffff", IdsMatch.BODY, 0.9)
        self.match("fffff", IdsMatch.FACE, "fffff", IdsMatch.FACE, 0.9)
        bad = placed("", "", float("nan"))
        self.tf.publish(TFMessage([bad, placed(CAMERA, "face_fffff", float("nan"))]))
        self.announce(faces=["fffff", "a b", "", "a/b"])
        person = self.one_person()
        self.wait_for(lambda: self.last_frame(person), "its frame", act=lambda: self.show(("face_fffff", 1.0)))

    def test_a_flood_of_frames_leaves_no_trace(self):
        self.check_that_frames_of_nobody_are_not_kept()     # here: after the flood as many frames are kept as may be
        self.announce(faces=["fgggg"])
        person = self.one_person()

        def flood(start, count):
            for number in range(start, start + count):
                name = "x%05d" % number
                # Each lives for 40 rounds, long enough to become a person.
                living = ["x%05d" % other for other in range(max(start, number - 40), number + 1)]
                self.announce(faces=["fgggg"] + living, bodies=living)
                self.show(("face_" + name, 1.0), ("body_" + name, 1.0), ("head_" + name, 1.0), ("l_arm_" + name, 1.0))
                threading.Event().wait(0.008)
            self.announce(faces=["fgggg"])
            self.wait_for(lambda: list(self.tracked.value.ids) == [person], "the flood to end")
            seen = self.show(("face_fgggg", 2.0))
            self.wait_for(lambda: self.arrivals.get((person, seen.to_nsec())), "a frame")

        flood(0, 150)
        self.wait_for(lambda: list(self.known.value.ids) == [person], "the flood to be forgotten", 30.0)
        before = self.resources()
        flood(1000, 500)
        self.wait_for(lambda: list(self.known.value.ids) == [person], "the flood to be forgotten", 30.0)
        self.wait_for(lambda: self.resources()[0] <= before[0] + 5, "closed topics", 30.0)
        after = self.resources()
        print("descriptors, threads, RSS in MB: before %s, after %s" % (before, after))
        self.assertLessEqual(after[0], before[0] + 5)
        self.assertLessEqual(after[1], before[1] + 3)
        self.assertLess(after[2], before[2] + 8.0)

    def check_that_frames_of_nobody_are_not_kept(self):
        reports = self.keep(Latest("/diagnostics", DiagnosticArray))

        def kept():
            return next((int(item.value) for message in reversed(reports.messages) for status in message.status
                         if status.name == "hri_person_manager: location" for item in status.values
                         if item.key == "robot frames"), None)

        # A report tells what was the case up to a second before it: the first one may be older than this test.
        self.wait_for(lambda: kept() is not None and len(reports.messages) > 1, "the diagnostics")
        before = kept()
        self.tf.publish(TFMessage([placed(CAMERA, "face_z%04d" % number, 1.0) for number in range(200)]
                                  + [placed("base_link", "tray_link", 1.0)]))
        self.wait_for(lambda: kept() > before, "the frame of the robot")
        self.assertEqual(kept(), before + 1)

    def test_another_manager_is_told(self):
        reports = self.keep(Latest("/diagnostics", DiagnosticArray))

        def told():
            return next((status.message for message in reversed(reports.messages) for status in message.status
                         if status.name == "hri_person_manager: persons"), "")

        self.wait_for(told, "the diagnostics")
        self.assertNotIn("publishes persons, too", told())
        other = rospy.Publisher("/humans/persons/tracked", IdsList, queue_size=1, latch=True)
        try:
            self.wait_for(lambda: rospy.get_name() + " publishes persons, too" in told(), "a warning",
                          act=lambda: other.publish(IdsList()))
        finally:
            other.unregister()
        self.wait_for(lambda: told().endswith("tracked"), "no warning any more")

    @staticmethod
    def resources():
        """Return open descriptors, threads and resident memory (MB) of the node."""
        uri = rosgraph.Master("/test").lookupNode("/hri_person_manager")
        process = ServerProxy(uri).getPid("/test")[2]
        with open("/proc/%d/status" % process) as status:
            lines = dict(line.split(":", 1) for line in status)
        return (len(os.listdir("/proc/%d/fd" % process)), int(lines["Threads"]),
                int(lines["VmRSS"].split()[0]) / 1024.0)


if __name__ == "__main__":
    rospy.init_node("test_person_manager")
    rostest.rosrun("hri_person_manager", "test_person_manager", TestPersonManager, sys.argv)
