#!/usr/bin/env python3
"""rep155_client.py, which knows nothing of this stack but the messages, learns everything from it with
interface:=rep155."""

import re
import sys
from pathlib import Path

import rospy
import rostest
from client_case import ClientCase

CLIENT = Path(__file__).resolve().with_name("rep155_client.py")


class Rep155ClientTest(ClientCase):

    @classmethod
    def command(cls):
        return [sys.executable, str(CLIENT)]

    def test_the_client_imports_messages_only(self):
        modules = re.findall(r"^(?:import|from) ([\w.]+)", CLIENT.read_text(encoding="utf-8"), re.MULTILINE)
        self.assertEqual(sorted(modules), ["hri_msgs.msg", "json", "rospy", "std_msgs.msg", "threading"])


if __name__ == "__main__":
    rospy.init_node("rep155_client_test")
    rostest.rosrun("ros4hri", "rep155_client", Rep155ClientTest)
