#!/usr/bin/env python3
"""The scene simulator in accelerated time, with persons of its own, and how it ends."""

import signal
import subprocess
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float32, String
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList
from hri_pipeline.testing import wait_for

PEOPLE = ["ann", "bob", "cho"]


class TestSceneSimulator(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        rospy.init_node("scene_persons")
        cls.lists, cls.clock, cls.frames, cls.fixed = {}, [], {}, {}
        cls.ears = [rospy.Subscriber("/humans/{}/tracked".format(kind), IdsList, cls.hear, callback_args=kind)
                    for kind in ("faces", "bodies", "persons")]
        cls.ears.append(rospy.Subscriber("/clock", Clock,
                                         lambda message: cls.clock.append((time.monotonic(), message.clock.to_sec()))))
        cls.ears.append(rospy.Subscriber("/tf", TFMessage, cls.see, callback_args=cls.frames, queue_size=100))
        cls.ears.append(rospy.Subscriber("/tf_static", TFMessage, cls.see, callback_args=cls.fixed))

    @classmethod
    def hear(cls, message, kind):
        cls.lists[kind] = list(message.ids)

    @classmethod
    def see(cls, message, frames):
        frames.update((item.child_frame_id, item) for item in message.transforms)

    def test_time_goes_as_fast_as_asked(self):
        wait_for(lambda: len(self.clock) > 60, 20.0, "sixty cycles of the clock")
        (began, first), (ended, last) = self.clock[20], self.clock[-1]
        steps = [b - a for (_, a), (_, b) in zip(self.clock, self.clock[1:])]
        self.assertGreater(min(steps), 0.0)
        # Never faster than asked; slower where the machine is busy.
        self.assertLess((last - first) / (ended - began), 5.5)

    def test_persons_have_features_places_and_confidence(self):
        wait_for(lambda: sorted(self.lists.get("persons", [])) == PEOPLE, 20.0, "three persons")
        body = rospy.wait_for_message("/humans/persons/ann/body_id", String, 10.0).data
        wait_for(lambda: body in self.lists["bodies"] or rospy.wait_for_message(
            "/humans/persons/ann/body_id", String, 5.0).data in self.lists["bodies"], 10.0,
            "the body of ann is tracked")
        self.assertEqual(rospy.wait_for_message("/humans/persons/ann/location_confidence", Float32, 10.0).data, 1.0)
        frame = wait_for(lambda: self.frames.get("person_ann"), 10.0, "the frame of ann")
        self.assertEqual(frame.header.frame_id, "map")
        self.assertTrue(1.0 < frame.transform.translation.x < 7.0)

    def test_it_tells_how_many_are_in_the_scene_and_how_many_in_view(self):
        def scene():
            message = rospy.wait_for_message("/diagnostics", DiagnosticArray, 10.0)
            return next((status for status in message.status if status.name.endswith("scene_simulator: scene")), None)
        told = wait_for(scene, 20.0, "the scene's diagnostics")
        values = {pair.key: int(pair.value) for pair in told.values if pair.key in ("people", "in_view")}
        self.assertTrue(0 <= values["in_view"] <= values["people"] == len(PEOPLE), told)
        self.assertIn("{} in view".format(values["in_view"]), told.message)

    def test_the_camera_hangs_on_the_map(self):
        wait_for(lambda: {"base_link", "camera_color_optical_frame", "microphone"} <= set(self.fixed), 10.0,
                 "the fixed frames")
        self.assertEqual(self.fixed["base_link"].header.frame_id, "map")
        self.assertAlmostEqual(self.fixed["camera_color_optical_frame"].transform.translation.z, 1.3)

    def test_illegal_parameters_end_the_node_with_a_word(self):
        for given, words in (({"scene": "nowhere"}, "three_talk"),
                             ({"speed": 3.0, "publish_clock": False}, "publish_clock"),
                             ({"sense_dropout": 2.0}, "sense_dropout")):
            code, text = self.run_node("bad_scene", given)
            self.assertNotEqual(code, 0)
            self.assertIn(words, text)
            self.assertNotIn("Traceback", text)

    def test_sigterm_lets_everybody_go(self):
        rospy.set_param("/other_scene", {"scene": "six_gaze", "publish_robot": False, "truth": False})
        process = subprocess.Popen(self.command("other_scene"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        heard = []
        ear = rospy.Subscriber("/humans/bodies/tracked", IdsList, lambda message: heard.append(
            (message._connection_header["callerid"], list(message.ids))))
        try:
            wait_for(lambda: any(who == "/other_scene" and ids for who, ids in heard), 20.0,
                     "bodies of the other scene")
            process.send_signal(signal.SIGTERM)
            self.assertEqual(process.wait(20.0), 0)
            wait_for(lambda: [ids for who, ids in heard if who == "/other_scene"][-1] == [], 5.0,
                     "the empty list at the end")
        finally:
            ear.unregister()
            if process.poll() is None:
                process.kill()
            rospy.delete_param("/other_scene")

    def run_node(self, name, parameters):
        rospy.set_param("/" + name, parameters)
        try:
            done = subprocess.run(self.command(name), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=30.0,
                                  check=False)
        finally:
            rospy.delete_param("/" + name)
        return done.returncode, done.stdout.decode()

    @staticmethod
    def command(name):
        return ["rosrun", "hri_pipeline", "scene_simulator", "__name:=" + name]


if __name__ == "__main__":
    rostest.rosrun("hri_pipeline", "scene_persons", TestSceneSimulator)
