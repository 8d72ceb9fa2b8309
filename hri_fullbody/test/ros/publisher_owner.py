#!/usr/bin/env python3
"""A node that only owns robot_state_publishers, for state_publishers_test.py.."""

import sys

import rospy

from hri_fullbody.core.model.anthropometry import SegmentTable
from hri_fullbody.core.model.human import Dimensions
from hri_fullbody.core.model.urdf import make_urdf
from hri_fullbody.ros.state_publishers import StatePublishers
from hri_pipeline.ros.node import run_node


class Owner:
    """Sets the bodies of the command line and prints its status when that changes."""

    def __init__(self):
        self.publishers = StatePublishers(
            limit=10, rate=15.0, package=rospy.get_param("~package", "robot_state_publisher"))
        dimensions = Dimensions.from_stature(1.7, SegmentTable.load())
        for identity in rospy.myargv()[1:]:
            self.publishers.set(identity, make_urdf(dimensions, identity), 1)
        self.told = None

    def spin(self):
        while not rospy.is_shutdown():
            level, text, values = self.publishers.status()
            state = "{} {} alive {} swept {}".format(level, text, values["alive"], values["left_by_dead_nodes"])
            if state != self.told:
                print(state, flush=True)
                self.told = state
            rospy.rostime.wallsleep(0.05)

    def close(self):
        self.publishers.close()


if __name__ == "__main__":
    sys.exit(run_node("publisher_owner", Owner))
