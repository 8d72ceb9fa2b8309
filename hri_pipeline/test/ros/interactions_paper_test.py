#!/usr/bin/env python3
"""The paper's types, where nothing is known but faces in the frame of their camera."""

import unittest

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from interaction_stage import ROBOT, Latest, Stage
from rosgraph_msgs.msg import Log

from hri_msgs.msg import GazesStamped, GroupsStamped
from hri_pipeline.testing import wait_for

WAIT_S = 20.0
CAMERA = "camera_optical_frame"


class InteractionsPaperTest(unittest.TestCase):

    def test_the_camera_stands_for_map_and_for_the_robot(self):
        stage, gazes, groups, logs, states = Stage(), [], [], [], {}
        self.addCleanup(stage.close)
        rospy.Subscriber("/humans/interactions/gaze", GazesStamped, gazes.append, queue_size=100)
        rospy.Subscriber("/humans/interactions/groups", GroupsStamped, groups.append, queue_size=100)
        rospy.Subscriber("/rosout", Log, lambda message: logs.append(message.msg), queue_size=100)
        rospy.Subscriber("/diagnostics", DiagnosticArray, lambda message: states.update(
            {status.name: status for status in message.status}), queue_size=10)
        ann, bob = np.array([-0.5, 0.0, 1.5]), np.array([0.5, 0.1, 1.5])
        stage.people = {"ann": (CAMERA, ann, ROBOT), "bob": (CAMERA, bob, ann)}
        wait_for(lambda: gazes and {(gaze.sender, gaze.receiver)
                                    for gaze in gazes[-1].gazes} == {("ann", ""), ("bob", "ann")}, WAIT_S,
                 Latest("ann at the camera, bob at ann", gazes))
        self.assertEqual(gazes[-1].header.frame_id, CAMERA)
        wait_for(lambda: groups and groups[-1].header.frame_id == CAMERA, WAIT_S, "groups, or that there is none")
        self.assertEqual(len(groups[-1].groups), len(groups[-1].confidences))
        for what in ("reference frame map", "robot_frame is not set"):
            wait_for(lambda what=what: [line for line in logs if what in line], WAIT_S, "a warning of the " + what)
        self.assertEqual(len([line for line in logs if "reference frame map" in line]), 1)
        wait_for(lambda: states.get("hri_interactions: location") is not None
                 and states["hri_interactions: location"].level == DiagnosticStatus.WARN, WAIT_S, "the state")
        self.assertEqual([name for name, _ in rospy.get_published_topics("/humans/persons")
                          if name.endswith("/engagement_status")], [])


if __name__ == "__main__":
    rospy.init_node("interactions_paper_test")
    rostest.rosrun("hri_pipeline", "interactions_paper", InteractionsPaperTest)
