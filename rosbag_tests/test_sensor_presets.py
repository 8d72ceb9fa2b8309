#!/usr/bin/env python3
"""`sensor:=NAME` on bags with the topics, types and encodings of a driver: raw and compressed, depth in mm and in m.
The others are played by `scripts/benchmark robot --only presets`."""

import sys
import unittest
from pathlib import Path

import rostest

sys.path += [str(Path(__file__).resolve().parents[1] / "scripts" / part) for part in ("", "lib")]

from benchmarks.sensor_presets import FARTHER, play, problem_of  # noqa: E402


class SensorPresetsTest(unittest.TestCase):

    def test_faces_stand_where_the_depth_images_say(self):
        plain, frame = play("usb", 1.0)
        self.assertEqual(frame, "head_camera")
        for name in ("azure_kinect", "tiago"):
            self.assertEqual(problem_of(name, FARTHER * plain, plain), "", name)


if __name__ == "__main__":
    rostest.rosrun("ros4hri", "sensor_presets", SensorPresetsTest, sys.argv)
