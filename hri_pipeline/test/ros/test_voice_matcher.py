#!/usr/bin/env python3
"""The voice matcher from outside: mouths, speech and transforms in, candidate matches out."""

import math
import sys
import threading
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Bool, Header, String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import FacialActionUnits, FacialLandmarks, IdsList, IdsMatch, NormalizedPointOfInterest2D
from hri_pipeline.testing import transform, wait_for

WAIT_S = 12.0
PERIOD_S = 1.0 / 15.0


def units(opening, stamp):
    intensity, confidence = [0.0] * 99, [0.0] * 99
    intensity[25] = intensity[26] = opening
    confidence[25] = confidence[26] = 0.9
    return FacialActionUnits(Header(stamp=stamp), intensity, confidence)


def landmarks(opening, stamp):
    """Landmarks of a face with the lips apart, as far as AU25 says."""
    points = [[0.5, 0.5, 1.0] for _ in range(70)]
    for index in range(36, 48):
        points[index][1] = 0.4
    points[33][1] = 0.477
    gap = 0.1 * (0.02 + 0.18 * opening)
    for upper, lower in ((61, 67), (62, 66), (63, 65)):
        points[upper][1], points[lower][1] = 0.5 - 0.5 * gap, 0.5 + 0.5 * gap
    return FacialLandmarks(header=Header(stamp=stamp), width=720, height=720,
                           landmarks=[NormalizedPointOfInterest2D(*point) for point in points])


def towards(parent, child, azimuth, stamp, distance=2.0):
    return transform(parent, child, stamp, distance * math.cos(azimuth), distance * math.sin(azimuth))


class TestVoiceMatcher(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.lists = {kind: rospy.Publisher("/humans/%s/tracked" % kind, IdsList, latch=True, queue_size=10)
                     for kind in ("faces", "voices", "persons")}
        cls.tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
        cls.static = rospy.Publisher("/tf_static", TFMessage, latch=True, queue_size=1)
        cls.static.publish(TFMessage([towards("base", "camera", 0.0, rospy.Time.now(), 0.1),
                                      towards("base", "microphone", 0.0, rospy.Time.now(), 0.05)]))
        cls.publishers, cls.received, cls.diagnostics = {}, [], {}
        rospy.Subscriber("/humans/candidate_matches", IdsMatch, cls.received.append, queue_size=100)
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.keep, queue_size=10)
        cls.lock = threading.Lock()
        cls.clear()
        threading.Thread(target=cls.live, daemon=True).start()

    @classmethod
    def keep(cls, message):
        cls.diagnostics.update({status.name.rpartition(": ")[2]: status for status in message.status
                                if "hri_voice_matcher" in status.name})

    @classmethod
    def clear(cls):
        """An empty world. mouths: face: (moves, what tells it, if anything); places: (frame, child): azimuth."""
        with cls.lock:
            cls.mouths, cls.places, cls.voices, cls.persons = {}, {}, {}, {}

    @classmethod
    def topic(cls, name, kind, latch=False):
        if name not in cls.publishers:
            cls.publishers[name] = rospy.Publisher("/humans/" + name, kind, latch=latch, queue_size=10)
        return cls.publishers[name]

    @classmethod
    def live(cls):
        """Publish the world as it is now, at 15 Hz."""
        listed = 0.0
        while not rospy.is_shutdown():
            stamp, now = rospy.Time.now(), time.monotonic()
            with cls.lock:
                if now - listed > 0.5:
                    listed = now
                    for kind, ids in (("faces", cls.mouths), ("voices", cls.voices), ("persons", cls.persons)):
                        cls.lists[kind].publish(IdsList(ids=sorted(ids)))
                for face, (moves, make) in cls.mouths.items():
                    if make is None:
                        continue
                    opening = 0.25 + 0.25 * math.sin(2.0 * math.pi * 4.3 * now) if moves else 0.05
                    kind = "facs" if make is units else "landmarks"
                    cls.topic("faces/%s/%s" % (face, kind),
                              FacialActionUnits if make is units else FacialLandmarks).publish(
                        make(opening, stamp))
                cls.tf.publish(TFMessage([towards(parent, child, azimuth, stamp)
                                          for (parent, child), azimuth in cls.places.items()]))
            time.sleep(PERIOD_S)

    def say(self, voice, speaking):
        with self.lock:
            self.voices[voice] = speaking
            self.lists["voices"].publish(IdsList(ids=sorted(self.voices)))
            self.topic("voices/%s/is_speaking" % voice, Bool, True).publish(Bool(speaking))

    def world(self, mouths, places=(), persons=()):
        with self.lock:
            type(self).mouths, type(self).places = dict(mouths), dict(places)
            type(self).persons = {id: None for id in persons}
            for id in persons:
                self.topic("persons/%s/face_id" % id, String, True).publish("")
                self.topic("persons/%s/voice_id" % id, String, True).publish("")

    def setUp(self):
        self.clear()
        del self.received[:]

    def current(self):
        """Return the last likelihood said of each pair."""
        return {(item.id1, item.id2): item.confidence for item in list(self.received)}

    def wait_for(self, condition, what):
        wait_for(condition, WAIT_S, lambda: "%s; matches: %s, diagnostics: %s" % (
            what, self.current(), {name: status.message for name, status in self.diagnostics.items()}))

    def listening(self):
        status = self.diagnostics.get("matches")
        return status is not None and {item.key: item.value for item in status.values}["listening"] == "True"

    def matched(self):
        status = self.diagnostics.get("matches")
        return status and {item.key: item.value for item in status.values}["matched"]

    def test_the_mouth_that_moves_and_its_withdrawal(self):
        self.world({"fa1": (False, units), "fb1": (True, units)})
        self.say("va1", True)
        self.wait_for(lambda: self.current().get(("va1", "fb1"), 0.0) > 0.7, "the mouth that moves")
        self.assertEqual({(item.id1_type, item.id2_type) for item in self.received}, {(IdsMatch.VOICE, IdsMatch.FACE)})
        self.world({"fa1": (True, units), "fb1": (False, units)})
        self.wait_for(lambda: self.current().get(("va1", "fb1")) == 0.0
                      and self.current().get(("va1", "fa1"), 0.0) > 0.7,
                      "the other mouth")
        self.say("va1", False)
        self.clear()
        self.wait_for(lambda: self.matched() == "0", "nobody to be matched")
        self.assertGreater(self.current()["va1", "fa1"], 0.7, "withdrawn, although they have only left")

    def test_a_voice_without_a_moving_mouth_is_nobodys(self):
        self.world({"fc1": (False, units)})
        self.say("vc1", True)
        self.wait_for(self.listening, "the node to listen")
        since = time.monotonic()
        self.wait_for(lambda: time.monotonic() - since > 4.0, "four seconds of it")
        self.assertNotIn(("vc1", "fc1"), self.current())

    def test_landmarks_where_there_are_no_action_units(self):
        self.world({"fd1": (True, landmarks), "fe1": (False, landmarks)})
        self.say("vd1", True)
        self.wait_for(lambda: self.current().get(("vd1", "fd1"), 0.0) > 0.7, "the mouth that moves")
        self.assertNotIn(("vd1", "fe1"), self.current())

    def test_directions_tell_still_faces_apart_and_find_a_person_without_a_face(self):
        places = {("camera", "face_ff1"): 0.4, ("camera", "face_fg1"): -0.4, ("microphone", "voice_vf1"): -0.42,
                  ("base", "person_ann"): 1.5}
        self.world({"ff1": (False, None), "fg1": (False, None)}, places, ["ann"])
        self.say("vf1", True)
        self.wait_for(lambda: self.current().get(("vf1", "fg1"), 0.0) > 0.7, "the face in the direction of the voice")
        with self.lock:
            self.places["microphone", "voice_vf1"] = 1.5
        self.wait_for(lambda: self.current().get(("vf1", "ann"), 0.0) > 0.7, "the person whom nobody sees")
        self.assertIn((IdsMatch.VOICE, IdsMatch.PERSON), {(item.id1_type, item.id2_type) for item in self.received})

    def test_it_listens_only_while_there_is_a_voice_and_garbage_does_not_end_it(self):
        self.wait_for(lambda: not self.listening() and self.diagnostics, "the node to listen to nobody")
        self.world({"fh1": (True, units)})
        self.say("vh1", True)
        self.wait_for(self.listening, "the node to listen")
        broken = self.topic("faces/fh1/facs", FacialActionUnits)
        self.wait_for(broken.get_num_connections, "a listener of the mouth")
        # A queue holds one message: on a busy machine the next good one may take the place of a bad one.
        bad = FacialActionUnits(Header(stamp=rospy.Time.now()), [0.5] * 7, [float("nan")] * 99)
        self.wait_for(lambda: broken.publish(bad) or "FacialActionUnits needs 99" in self.diagnostics["faces"].message,
                      "the reason")
        self.tf.publish(TFMessage([towards("microphone", "voice_vh1", float("nan"), rospy.Time.now())]))
        self.wait_for(lambda: self.current().get(("vh1", "fh1"), 0.0) > 0.7, "the mouth that moves")
        self.clear()
        self.wait_for(lambda: not self.listening(), "the node to listen to nobody")
        self.assertEqual(broken.get_num_connections(), 0)


if __name__ == "__main__":
    rospy.init_node("test_voice_matcher")
    rostest.rosrun("hri_pipeline", "test_voice_matcher", TestVoiceMatcher, sys.argv)
