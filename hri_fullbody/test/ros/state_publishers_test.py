#!/usr/bin/env python3
"""Real robot_state_publishers: their frames, their end, and what happens when somebody interferes."""

import os
import signal
import subprocess
import sys
import threading
import unittest
from collections import Counter

import rosgraph
import rospy
import rostest
from skeleton_graph import Movers, TfTree, farthest, left_of, processes, wait_until_gone

from hri_fullbody.ros.state_publishers import StatePublishers
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.ros.diagnostics import OK, WARN
from hri_pipeline.testing import wait_for

OWNER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "publisher_owner.py")
WAIT_S = 20.0
EXACT_M = 1e-5


class Owner:
    """Another node with robot_state_publishers, and what it has said."""

    def __init__(self, name, *ids):
        self.lines = []
        self.process = subprocess.Popen(
            [sys.executable, OWNER, "__name:=" + name] + list(ids), stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, env=dict(os.environ, PYTHONUNBUFFERED="1"))
        self.reader = threading.Thread(target=lambda: self.lines.extend(self.process.stdout), daemon=True)
        self.reader.start()

    def says(self, text):
        wait_for(lambda: any(text in line for line in list(self.lines)), WAIT_S, repr(text))

    def end(self, number):
        self.process.send_signal(number)
        self.process.wait(WAIT_S)

    def close(self):
        if self.process.poll() is None:
            self.end(signal.SIGINT)
        self.reader.join(WAIT_S)
        self.process.stdout.close()


class StatePublishersTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.new_id = IdGenerator().new
        cls.tree = TfTree()
        cls.movers = Movers()

    @classmethod
    def tearDownClass(cls):
        cls.movers.close()
        cls.tree.close()

    def setUp(self):
        self.publishers = StatePublishers(limit=3, rate=15.0)
        self.addCleanup(self.publishers.close)

    def bodies(self, count, stature=1.7):
        """Let bodies come; returns their ids."""
        ids = [type(self).new_id() for _ in range(count)]
        for identity, urdf in self.movers.set({identity: stature for identity in ids}).items():
            self.assertTrue(self.publishers.set(identity, urdf, 1))
        for identity in ids:
            wait_for(lambda wanted=identity: self.tree.complete(wanted), WAIT_S, "the frames of " + identity)
        return ids

    def owner(self, name, *ids):
        owner = Owner(name, *ids)
        self.addCleanup(owner.close)
        return owner

    def anew(self, identity):
        """Wait for frames of a body that come from now on."""
        self.tree.forget(identity)
        since = rospy.Time.now()
        wait_for(lambda: any(stamp > since for stamp in self.tree.complete(identity)), WAIT_S, "new frames")

    def test_the_frames_are_those_of_forward_kinematics_and_never_repeated(self):
        ids = self.bodies(3)
        errors = []
        for identity in ids:
            for _ in range(5):
                stamp = wait_for(lambda wanted=identity: self.tree.complete(wanted), WAIT_S, "frames")[-1]
                errors.append(farthest(self.tree, self.movers, identity, stamp))
        print("largest distance from forward kinematics: {:.2g} m".format(max(errors)))
        self.assertLess(max(errors), EXACT_M)
        self.assertEqual(Counter(self.tree.repeated), Counter())

    def test_the_tf_prefix_of_a_robot_is_not_that_of_people(self):
        rospy.set_param("/tf_prefix", "robot1")
        self.addCleanup(rospy.delete_param, "/tf_prefix")
        identity, = self.bodies(1)
        self.assertEqual([name for name in list(self.tree.moving) + list(self.tree.fixed) if "/" in name], [])
        rospy.set_param("/rsp_" + identity + "/tf_prefix", "robot1")
        self.anew(identity)     # the prefix is not read with each joint state: ten people were 1,000 calls in 10 s
        self.assertEqual([name for name in list(self.tree.moving) if "/" in name], [])
        self.assertLess(farthest(self.tree, self.movers, identity, self.tree.complete(identity)[-1]), EXACT_M)

    def test_a_body_that_leaves_leaves_nothing(self):
        first, second = self.bodies(2)
        self.publishers.keep([second])
        self.movers.set({second: 1.7})
        wait_until_gone(first, WAIT_S)
        self.assertTrue(processes(second))
        self.publishers.close()
        self.movers.set({})
        wait_until_gone(second, WAIT_S)

    def test_a_killed_process_comes_again(self):
        identity, = self.bodies(1)
        old, = processes(identity)
        os.kill(old, signal.SIGKILL)
        wait_for(lambda: processes(identity) not in ([], [old]), WAIT_S, "another process")
        self.anew(identity)
        level, text, values = self.publishers.status()
        self.assertEqual((level, values["restarted"], values["alive"]), (WARN, 1, 1))
        self.assertIn(identity, text)
        self.assertIn("signal 9", text)

    def test_a_urdf_that_somebody_deletes_is_set_again(self):
        identity, = self.bodies(1)
        name = "/human_description_" + identity
        urdf = rospy.get_param(name)
        rospy.delete_param(name)
        wait_for(lambda: rospy.has_param(name), WAIT_S, name)
        self.assertEqual(rospy.get_param(name), urdf)
        wait_for(lambda: self.publishers.status()[2]["descriptions_restored"] == 1, WAIT_S, "the count")
        self.assertEqual(self.publishers.status()[2]["started"], 1)

    def test_a_process_that_the_master_does_not_know_any_more_is_started_anew(self):
        # A master that was started again has no parameters, and robot_state_publisher does not register again.
        identity, = self.bodies(1)
        old, = processes(identity)
        for name in ("/rsp_", "/human_description_"):
            rospy.delete_param(name + identity)
        wait_for(lambda: processes(identity) not in ([], [old]) and len(processes(identity)) == 1, WAIT_S, "another")
        self.anew(identity)
        self.assertTrue(rospy.has_param("/human_description_" + identity))
        self.assertEqual(self.publishers.status()[2]["alive"], 1)

    def test_a_new_revision_replaces_the_urdf_and_the_frames_go_on(self):
        identity, = self.bodies(1)
        urdf = self.movers.set({identity: 1.9})[identity]
        self.publishers.set(identity, urdf, 1)
        self.assertEqual(self.publishers.status()[2]["replaced"], 0, "the same revision again changes nothing")
        self.publishers.set(identity, urdf, 2)
        wait_for(lambda: self.publishers.status()[2]["replaced"], WAIT_S, "a new process")
        self.anew(identity)
        self.assertLess(farthest(self.tree, self.movers, identity, self.tree.complete(identity)[-1]), EXACT_M)
        self.assertEqual(rospy.get_param("/human_description_" + identity), urdf)
        self.assertEqual(len(processes(identity)), 1)
        self.assertEqual(self.publishers.status()[2]["restarted"], 0)

    def test_a_refused_urdf_is_told_and_the_others_go_on(self):
        good, = self.bodies(1)
        bad = type(self).new_id()
        self.publishers.set(bad, "<robot name='x'><link name='a'/><link name='b'/></robot>", 1)
        wait_for(lambda: self.publishers.status()[2]["urdf_refused"], WAIT_S, "the refusal")
        level, text, values = self.publishers.status()
        self.assertEqual((level, values["alive"]), (WARN, 1))
        self.assertIn(bad, text)
        self.assertIn("Two root links", text)
        started = values["started"]
        self.anew(good)
        self.assertEqual(self.publishers.status()[2]["started"], started, "it is not tried again and again")
        self.publishers.keep([good])
        wait_until_gone(bad, WAIT_S)

    def test_ids_and_numbers_are_checked(self):
        for hostile in ("", "a;b", "a<b", "a b", "../x", "a/b", "x" * 40, "1a"):
            with self.assertRaises(ValueError):
                self.publishers.set(hostile, "<robot/>", 1)
        self.bodies(3)
        self.assertFalse(self.publishers.set(type(self).new_id(), "<robot/>", 1))
        self.assertEqual(self.publishers.status()[2]["beyond_limit"], 1)

    def test_an_owner_that_is_told_to_stop_leaves_nothing(self):
        for number in (signal.SIGTERM, signal.SIGINT):
            identity = type(self).new_id()
            owner = self.owner("owner_that_stops", identity)
            owner.says("alive 1")
            owner.end(number)
            wait_until_gone(identity, WAIT_S)

    def test_what_a_killed_owner_leaves_is_cleaned_up_and_nothing_of_a_living_one(self):
        living, dead = type(self).new_id(), type(self).new_id()
        self.owner("owner_that_lives", living).says("alive 1")
        killed = self.owner("owner_that_dies", dead)
        killed.says("alive 1")
        killed.end(signal.SIGKILL)
        wait_for(lambda: not processes(dead), WAIT_S, "the orphan's end")
        self.assertIn("/human_description_" + dead, left_of(dead))
        # A node that was killed itself before it could unregister.
        rosgraph.Master("/rsp_" + dead).registerPublisher("/tf", "tf2_msgs/TFMessage", "http://127.0.0.1:1/")
        successor = self.owner("owner_that_dies", type(self).new_id())
        successor.says("swept 1")
        wait_until_gone(dead, WAIT_S)
        self.assertEqual(len(processes(living)), 1)
        self.assertTrue(rospy.has_param("/human_description_" + living))

    def test_without_the_binary_one_message_says_what_to_install(self):
        identity = type(self).new_id()
        owner = self.owner("owner_without_binary", identity, "_package:=package_that_is_not_installed")
        owner.says("{} robot_state_publisher is not installed".format(WARN))
        wait_for(lambda: rospy.has_param("/human_description_" + identity), WAIT_S, "the URDF nevertheless")
        self.assertEqual(sum("apt install ros-robot-state-publisher" in line and "[ERROR]" in line
                             for line in list(owner.lines)), 1, owner.lines)
        owner.end(signal.SIGINT)
        wait_until_gone(identity, WAIT_S)
        rospy.delete_param("/owner_without_binary")

    def test_all_is_well(self):
        self.bodies(2)
        self.assertEqual(self.publishers.status()[:2], (OK, "2 robot_state_publishers"))


if __name__ == "__main__":
    rospy.init_node("state_publishers_test")
    rostest.rosrun("hri_fullbody", "state_publishers", StatePublishersTest)
