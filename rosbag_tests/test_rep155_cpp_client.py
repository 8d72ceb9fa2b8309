#!/usr/bin/env python3
"""The same in C++: rep155_client.cpp, compiled against the headers of the messages, learns everything, and more of
faces and bodies."""

import re
import unittest
from pathlib import Path

import roslib.packages
import rospy
import rostest
from client_case import ClientCase
from interface_table import released_sums

SOURCE = Path(__file__).resolve().with_name("rep155_client.cpp")
NAME = "rep155_client"


class Rep155CppClientTest(ClientCase):

    @classmethod
    def command(cls):
        found = roslib.packages.find_node("ros4hri", NAME)
        if not found:
            raise unittest.SkipTest("{} was not built: it needs roscpp and `catkin_make tests`".format(NAME))
        return [found[0]]

    @classmethod
    def learnt(cls):
        return dict(super().learnt(), **{
            "landmarks of a face": any(line["points"] >= 68 for line in cls.told("face", "points")),
            "action units": any(line["units"] for line in cls.told("units")),
            "an expression": bool(cls.told("expression")),
            "an apparent age": any(line["age"] > 0 for line in cls.told("age")),
            "a skeleton": any(line["points"] >= 8 for line in cls.told("body", "points")),
            "a posture": bool(cls.told("posture")), "a gesture": bool(cls.told("gesture"))})

    def test_faces_and_bodies_are_those_of_the_standard(self):
        for line in self.told("face", "points"):
            self.assertEqual((line["size"], line["of"]), ([1280, 720], 70))
        self.assertEqual({line["of"] for line in self.told("body", "points")}, {18})
        # Points are parts of the image's width and height; those of people at its edge may lie beyond it.
        self.assertTrue(any(0.0 < value < 1.0 for line in self.told("nose") for value in line["nose"]))
        for line in self.told("units"):
            self.assertTrue(all(0 < int(unit) < 99 and 0.0 <= value <= 1.0 for unit, value in line["units"].items()),
                            line)
        for line in self.told("expression"):
            self.assertTrue(-1.0 <= line["valence"] <= 1.0 and -1.0 <= line["arousal"] <= 1.0, line)
        self.assertTrue(all(line["gender"] in range(4) for line in self.told("gender")))
        self.assertTrue(all(line["posture"] in range(5) for line in self.told("posture")))
        self.assertTrue(all(line["gesture"] in range(7) for line in self.told("gesture")))

    def test_the_client_includes_released_messages_only(self):
        headers = re.findall(r"#include <(hri_msgs/\w+)\.h>", SOURCE.read_text(encoding="utf-8"))
        released = set(released_sums())
        self.assertTrue(len(headers) >= 10 and set(headers) <= released, sorted(set(headers) - released))


if __name__ == "__main__":
    rospy.init_node("rep155_cpp_client_test")
    rostest.rosrun("ros4hri", "rep155_cpp_client", Rep155CppClientTest)
