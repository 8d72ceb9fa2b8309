#!/usr/bin/env python3
"""show_human.launch: the parameter, and TF that is the forward kinematics of the pose."""

import unittest

import numpy as np
import rospy
import rostest
import tf2_ros
from sensor_msgs.msg import JointState

from hri_fullbody.core import keypoints as skeleton
from hri_fullbody.core.kinematics.forward import forward
from hri_fullbody.core.model.anthropometry import SegmentTable
from hri_fullbody.core.model.human import PAPER, REP155, Dimensions, sample_pose
from hri_fullbody.core.model.urdf import make_urdf

WAIT_S = 20.0
POINTS = {"l_wrist": skeleton.LEFT_WRIST, "r_knee": skeleton.RIGHT_KNEE, "r_ankle": skeleton.RIGHT_ANKLE,
          "torso": skeleton.NECK}


class ShowHumanTest(unittest.TestCase):

    def setUp(self):
        self.buffer = tf2_ros.Buffer()
        self.listener = tf2_ros.TransformListener(self.buffer)
        self.addCleanup(self.listener.unregister)
        self.body = Dimensions.from_stature(1.9, SegmentTable.load())

    def place(self, frame, parent="body_tall"):
        move = self.buffer.lookup_transform(parent, frame, rospy.Time(0), rospy.Duration(WAIT_S)).transform.translation
        return np.array([move.x, move.y, move.z])

    def test_the_parameter_is_the_urdf_of_the_command(self):
        self.assertEqual(rospy.get_param("/human_description_tall").strip(),
                         make_urdf(self.body, "tall", REP155).strip())

    def test_tf_is_the_forward_kinematics_of_the_pose(self):
        points, _, head = forward(np.eye(3)[None], np.zeros((1, 3)), sample_pose("sitting", REP155)[None],
                                  [self.body], REP155)
        for frame, point in POINTS.items():
            np.testing.assert_allclose(self.place(frame + "_tall"), points[0, point], atol=1e-5, err_msg=frame)
        np.testing.assert_allclose(self.place("head_tall"), head[0], atol=1e-5)

    def test_without_a_pose_there_are_joint_states_too(self):
        message = rospy.wait_for_message("/humans/bodies/free/joint_states", JointState, WAIT_S)
        self.assertEqual(set(message.name), {name + "_free" for name in PAPER.joint_names})
        self.place("l_wrist_free", "body_free")

    def test_it_is_upright_over_the_floor(self):
        self.assertAlmostEqual(self.place("head_tall", "map")[2], 0.934 * 1.9, delta=0.03)


if __name__ == "__main__":
    rospy.init_node("show_human_test")
    rostest.rosrun("hri_fullbody", "show_human", ShowHumanTest)
