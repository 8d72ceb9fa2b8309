#!/usr/bin/env python3
"""Live parameters: what a client of dynamic_reconfigure sets is what the nodes do, at once, and what is wrong is
refused."""

import subprocess
import threading
import unittest

import rosgraph
import rosnode
import rospy
import rostest
from dynamic_reconfigure import DynamicReconfigureCallbackException, DynamicReconfigureParameterException
from dynamic_reconfigure.client import Client

from hri_msgs.msg import GazesStamped, IdsList
from hri_pipeline.core import parameter_docs
from hri_pipeline.testing import wait_for

NODES = {"hri_person_manager": "person_manager", "hri_interactions": "interactions",
         "hri_face_body_matcher": "face_body_matcher",
         "hri_voice_matcher": "voice_matcher", "hri_overlay": "overlay"}
WAIT_S = 30.0


class TestReconfigure(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        rospy.init_node("reconfigure_test")
        cls.lock = threading.Lock()
        cls.gazes, cls.persons = [], []
        rospy.Subscriber("/humans/interactions/gaze", GazesStamped, cls.hear, queue_size=100)
        rospy.Subscriber("/humans/persons/tracked", IdsList, lambda message: cls.persons.append(sorted(message.ids)))
        cls.clients = {node: Client(node, timeout=WAIT_S) for node in NODES}

    @classmethod
    def hear(cls, message):
        with cls.lock:
            cls.gazes.append((message.header.stamp.to_sec(), len(message.gazes)))

    def set(self, node, **changes):
        before = {name: self.clients[node].get_configuration(WAIT_S)[name] for name in changes}
        self.addCleanup(self.clients[node].update_configuration, before)
        return self.clients[node].update_configuration(changes)

    def next_gazes(self, count):
        """The (stamp, number of gazes) of so many messages from now on."""
        with self.lock:
            begin = len(self.gazes)
        wait_for(lambda: len(self.gazes) >= begin + count, WAIT_S, "{} messages of gazes".format(count))
        with self.lock:
            return self.gazes[begin:begin + count]

    def rate(self):
        """Messages of gazes per second of the sensors' time."""
        stamps = [stamp for stamp, _ in self.next_gazes(6)][1:]
        return 4.0 / (stamps[-1] - stamps[0])

    def wait_for_gazes(self, there):
        wait_for(lambda: all(bool(count) == there for _, count in self.next_gazes(5)), WAIT_S,
                 "gazes" if there else "no gazes")

    def test_1_every_node_describes_its_live_parameters(self):
        tables = {table.node: table for _, table in parameter_docs.registered()}
        for node, name in NODES.items():
            rows = self.clients[node].get_parameter_descriptions(WAIT_S)
            self.assertEqual([row["name"] for row in rows], [parameter.name for parameter in tables[name].live], node)
            config = self.clients[node].get_configuration(WAIT_S)
            for row in rows:
                default = rospy.get_param("/humans/" + row["name"], row["default"])
                self.assertEqual(config[row["name"]], rospy.get_param("/{}/{}".format(node, row["name"]), default))

    def test_2_a_rate_falls_and_rises_again(self):
        self.wait_for_gazes(True)
        wait_for(lambda: self.rate() > 4.0, WAIT_S, "more than four results per second")
        answer = self.set("hri_interactions", rate=2.0)
        self.assertEqual(answer["rate"], 2.0)
        wait_for(lambda: self.rate() < 2.5, WAIT_S, "two results per second")
        self.assertEqual(rospy.get_param("/hri_interactions/rate"), 2.0)
        self.doCleanups()
        wait_for(lambda: self.rate() > 4.0, WAIT_S, "the old rate")

    def test_3_a_threshold_ends_gazes(self):
        self.wait_for_gazes(True)
        self.set("hri_interactions", max_distance=0.5)
        self.wait_for_gazes(False)
        self.doCleanups()
        self.wait_for_gazes(True)

    def test_4_a_threshold_parts_persons_who_are_joined_again_afterwards(self):
        wait_for(lambda: self.persons and self.persons[-1] == ["ann", "bob", "cho"], WAIT_S,
                 "three persons by their names")
        self.set("hri_person_manager", match_threshold=1.0)
        wait_for(lambda: len(self.persons[-1]) > 3, WAIT_S, "faces and bodies are nobody's")
        # The parameter of the whole stack, which counted so far, is left as it is: others read it, too.
        self.assertEqual(rospy.get_param("/hri_person_manager/match_threshold"), 1.0)
        self.assertEqual(rospy.get_param("/humans/match_threshold"), 0.6)
        self.doCleanups()
        wait_for(lambda: self.persons[-1] == ["ann", "bob", "cho"], WAIT_S, "three persons again")
        self.assertEqual(rospy.get_param("/hri_person_manager/match_threshold"), 0.6)

    def refused(self, node, **changes):
        before = dict(self.clients[node].get_configuration(WAIT_S))
        given = {name: rospy.get_param("/{}/{}".format(node, name), None) for name in changes}
        with self.assertRaises((DynamicReconfigureCallbackException, DynamicReconfigureParameterException)) as caught:
            self.clients[node].update_configuration(dict(changes))
        self.assertEqual(self.clients[node].get_configuration(WAIT_S), before)
        for name, value in given.items():
            self.assertEqual(rospy.get_param("/{}/{}".format(node, name), None), value)
        return str(caught.exception.__context__)

    def test_5_what_is_wrong_is_refused_with_a_word(self):
        self.assertIn("legal: float, 1 to 60 Hz", self.refused("hri_interactions", rate=1000.0))
        self.assertIn("parameter rate is nan", self.refused("hri_interactions", rate=float("nan")))
        # Not even the good half of it.
        self.assertIn("parameter stay_bonus is 9.0",
                      self.refused("hri_face_body_matcher", stay_bonus=9.0, hold_time=3.0))
        self.refused("hri_interactions", reference_frame="odom")
        self.refused("hri_person_manager", store="/nowhere")

    def test_6_values_that_contradict_each_other_change_nothing(self):
        for node, name, value in (("hri_interactions", "engaging_level", 0.9),
                                  ("hri_person_manager", "personal_distance", 9.0)):
            before = self.clients[node].get_configuration(WAIT_S)[name]
            self.assertEqual(self.clients[node].update_configuration({name: value})[name], before)
            self.assertNotEqual(rospy.get_param("/{}/{}".format(node, name), None), value)

    def test_7_dynparam(self):
        def dynparam(*arguments):
            return subprocess.run(["rosrun", "dynamic_reconfigure", "dynparam"] + list(arguments),
                                  stdout=subprocess.PIPE,
                                  stderr=subprocess.PIPE, universal_newlines=True, timeout=2.0 * WAIT_S)

        self.addCleanup(self.clients["hri_voice_matcher"].update_configuration, {"period": 0.25})
        self.assertEqual(dynparam("set", "/hri_voice_matcher", "period", "0.5").returncode, 0)
        wait_for(lambda: self.clients["hri_voice_matcher"].config["period"] == 0.5, WAIT_S, "every client is told")
        self.assertEqual(rospy.get_param("/hri_voice_matcher/period"), 0.5)
        wrong = dynparam("set", "/hri_voice_matcher", "period", "7")
        self.assertNotEqual(wrong.returncode, 0)
        self.assertIn("legal: float, 0.05 to 1 s", wrong.stderr)

    def test_8_a_node_that_ends_leaves_nothing(self):
        def left():
            return [name for kind in rosgraph.Master("/reconfigure_test").getSystemState() for name, owners in kind
                    if name.startswith("/hri_face_body_matcher/") and "/hri_face_body_matcher" in owners]
        self.assertTrue(left(), "otherwise this test looks for names that nobody uses")
        rosnode.kill_nodes(["/hri_face_body_matcher"])
        wait_for(lambda: not left(), WAIT_S, "no topic and no service of the node that has ended")


if __name__ == "__main__":
    rostest.rosrun("hri_person_manager", "reconfigure", TestReconfigure)
