#!/usr/bin/env python3
"""rep155_client.py, which knows nothing of this stack but the messages, learns everything from it with interface:=rep155."""

import json
import re
import subprocess
import sys
import threading
import unittest
from pathlib import Path

import rospy
import rostest
from graph_watch import wait_for
from sensors import Sensors

CLIENT = Path(__file__).resolve().with_name("rep155_client.py")
LIMIT_S = 90.0          # for all; a machine with two free cores needs 30 s
END_S = 15.0
ROBOT = ""
LEVELS = range(5)


class Rep155ClientTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.lines, cls.noise = [], []
        cls.client = subprocess.Popen([sys.executable, str(CLIENT)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for stream, kept in ((cls.client.stdout, cls.lines), (cls.client.stderr, cls.noise)):
            threading.Thread(target=cls.read, args=(stream, kept), daemon=True).start()
        cls.sensors = Sensors()
        wait_for(lambda: not cls.missing(), LIMIT_S)

    @classmethod
    def tearDownClass(cls):
        cls.client.terminate()
        cls.client.wait(END_S)
        cls.sensors.close()

    @staticmethod
    def read(stream, kept):
        for line in stream:
            kept.append(line)

    @classmethod
    def told(cls, *names):
        """The lines that have these keys."""
        found = [json.loads(line) for line in list(cls.lines)]
        return [line for line in found if set(names) <= set(line)]

    @classmethod
    def missing(cls):
        """What the client has not learnt yet."""
        learnt = {"boxes of three persons' faces": len({line["person"] for line in cls.told("box")}) >= 3,
                  "the sentence, while it is said": any("forward" in line["said"] and not line["final"] for line in cls.told("said")),
                  "the finished sentence": any("forward" in line["said"] and line["final"] for line in cls.told("said")),
                  "a gaze at the robot": any(line["gaze"][1] == ROBOT for line in cls.told("gaze")),
                  "a group": any(len(line["members"]) >= 2 for line in cls.told("members")),
                  "an engagement": bool(cls.told("engagement")),
                  "somebody's distance": any(ids for line in cls.told("spaces") for ids in line["spaces"].values())}
        return [name for name, is_learnt in learnt.items() if not is_learnt]

    def test_the_client_learns_everything(self):
        self.assertEqual(self.missing(), [], "".join(self.noise[-20:]))
        self.assertIsNone(self.client.poll(), "the client has ended")

    def test_values_are_those_of_the_standard(self):
        for line in self.told("box"):
            x0, y0, x1, y1 = line["box"]
            self.assertTrue(0.0 <= x0 < x1 <= 1.0 and 0.0 <= y0 < y1 <= 1.0, line)
        persons = {line["person"] for line in self.told("person")}
        for line in self.told("gaze"):
            self.assertNotEqual(line["gaze"][0], line["gaze"][1])
        self.assertTrue(any(sender in persons for line in self.told("gaze") for sender in line["gaze"]))
        for line in self.told("members"):
            self.assertEqual(len(line["members"]), len(set(line["members"])), line)
        self.assertTrue(all(line["engagement"] in LEVELS for line in self.told("engagement")))

    def test_nothing_was_refused_or_warned_of(self):
        self.assertEqual([line for line in self.noise if "md5" in line or "Traceback" in line or "type mismatch" in line], [])

    def test_the_client_imports_messages_only(self):
        modules = re.findall(r"^(?:import|from) ([\w.]+)", CLIENT.read_text(encoding="utf-8"), re.MULTILINE)
        self.assertEqual(sorted(modules), ["hri_msgs.msg", "json", "rospy", "std_msgs.msg", "threading"])


if __name__ == "__main__":
    rospy.init_node("rep155_client_test")
    rostest.rosrun("ros4hri", "rep155_client", Rep155ClientTest)
