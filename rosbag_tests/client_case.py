"""Tests of a program that knows hri_msgs 0.9.0 only: it learns everything from the stack with interface:=rep155."""

from __future__ import annotations

import json
import subprocess
import threading
import unittest
from typing import Dict, List

from graph_watch import wait_for
from sensors import Sensors

LIMIT_S = 90.0          # for all; a machine with two free cores needs 30 s
END_S = 15.0
ROBOT = ""
LEVELS = range(5)


class ClientCase(unittest.TestCase):
    """Starts the program of command(), which prints a line of JSON for each thing learnt, and a camera and
    microphones."""

    @classmethod
    def command(cls) -> List[str]:
        """Return the command line of the program."""
        raise NotImplementedError

    @classmethod
    def learnt(cls) -> Dict[str, bool]:
        """Return what there is to learn, in words, and whether the program has learnt it."""
        return {"boxes of three persons' faces": len({line["person"] for line in cls.told("box")}) >= 3,
                "the sentence, while it is said": any("forward" in line["said"] and not line["final"]
                                                      for line in cls.told("said")),
                "the finished sentence": any("forward" in line["said"] and line["final"] for line in cls.told("said")),
                "a gaze at the robot": any(line["gaze"][1] == ROBOT for line in cls.told("gaze")),
                "a group": any(len(line["members"]) >= 2 for line in cls.told("members")),
                "an engagement": bool(cls.told("engagement")),
                "somebody's distance": any(line["ids"] for line in cls.told("space"))}

    @classmethod
    def setUpClass(cls):
        cls.lines, cls.noise = [], []
        cls.client = subprocess.Popen(cls.command(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
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
    def told(cls, *names: str) -> List[dict]:
        """The lines that have these keys."""
        found = [json.loads(line) for line in list(cls.lines)]
        return [line for line in found if set(names) <= set(line)]

    @classmethod
    def missing(cls) -> List[str]:
        """What the program has not learnt yet."""
        return [name for name, is_learnt in cls.learnt().items() if not is_learnt]

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
        self.assertEqual([line for line in self.noise if "md5" in line or "Traceback" in line
                          or "type mismatch" in line], [])
