#!/usr/bin/env python3
"""The program of docs/tutorial.md, run as a reader runs it: who looks at the robot is greeted, once, and not before."""

import os
import re
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path

import rospy
import rostest
from graph_watch import wait_for

from hri_msgs.msg import GazesStamped

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tutorial.md"
GREETING = "Hello "
PERSON = "ann"
LIMIT_S = 120.0
END_S = 15.0
LEFT_S = 44.0           # of the scene: she looks away from 34 s on, and leaves at 42 s


class TutorialTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        code = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
        cls.programs = [text for text in code if "__main__" in text or "init_node" in text]
        cls.folder = tempfile.TemporaryDirectory()
        cls.program = Path(cls.folder.name) / "greet.py"
        cls.program.write_text("".join(cls.programs[:1]), encoding="utf-8")

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def setUp(self):
        self.assertEqual(len(self.programs), 1, "one program is in the page")
        self.lines, self.looks = [], []
        self.began = None
        rospy.Subscriber("/scene/truth/gaze", GazesStamped, self.on_gaze, queue_size=100)
        # The last message of a program that is ended would stay in the pipe's buffer otherwise.
        self.process = subprocess.Popen([sys.executable, str(self.program)], stdout=subprocess.PIPE,
                                        stderr=subprocess.STDOUT, text=True,
                                        env=dict(os.environ, PYTHONUNBUFFERED="1"))
        self.addCleanup(self.end)
        threading.Thread(target=self.read, daemon=True).start()

    def end(self):
        if self.process.poll() is None:
            self.process.terminate()
            self.process.wait(END_S)

    def read(self):
        for line in self.process.stdout:
            self.lines.append((rospy.get_time(), line.rstrip()))

    def on_gaze(self, message):
        now = message.header.stamp.to_sec()
        self.began = self.began or now
        if any(gaze.sender == PERSON and gaze.receiver == "" for gaze in message.gazes):
            self.looks.append(now)

    def greetings(self):
        return [(at, line) for at, line in list(self.lines) if GREETING in line]

    def test_who_looks_at_the_robot_is_greeted_once(self):
        said = "".join("\n" + line for _, line in self.lines)
        self.assertTrue(wait_for(lambda: self.looks, LIMIT_S), "she never looks at the robot")
        self.assertTrue(wait_for(self.greetings, LIMIT_S), "no greeting" + said)
        self.assertTrue(wait_for(lambda: rospy.get_time() > self.looks[0] + LEFT_S - 10.0, LIMIT_S),
                        "the scene has stopped")
        self.assertEqual(len(self.greetings()), 1, "{}; she looks at {}".format(self.greetings(), self.looks[0]))
        at, line = self.greetings()[0]
        print("she looks at the robot {:.1f} s after the begin, and is greeted {:.1f} s later: {}".format(
            self.looks[0] - self.began, at - self.looks[0], line), flush=True)
        self.assertGreater(at, self.looks[0] + 0.5, "greeted before she has looked for a second")
        self.assertLess(at, self.looks[0] + 10.0)
        distance = re.search(r"Hello \w+ at (\d+\.\d) m!", line)
        self.assertTrue(distance, line)
        self.assertTrue(0.5 < float(distance.group(1)) < 6.0, line)
        self.assertIsNone(self.process.poll(), "the program has ended")
        self.assertEqual([text for _, text in self.lines if "Traceback" in text or "failed" in text], [])


if __name__ == "__main__":
    rospy.init_node("tutorial_test")
    rostest.rosrun("ros4hri", "tutorial", TutorialTest)
