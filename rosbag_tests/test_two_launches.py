#!/usr/bin/env python3
"""Two launches on one master: frames, time and expectations of the first one do not reach the second. A launch in a
namespace has its tree of diagnostics."""

import os
import subprocess
import threading
import time
import unittest

import rosgraph
import rospy
import rostest
from bag_stage import wait_for
from diagnostic_msgs.msg import DiagnosticArray

from hri_msgs.msg import GazesStamped

END_S = 60.0
OF_ROS = ("/rosdistro", "/rosversion", "/run_id", "/roslaunch/", "/rosout/")


class Launch:
    """A launch file of ros4hri, with what it says."""

    def __init__(self, *words, **variables):
        self.lines = []
        self.process = subprocess.Popen(["roslaunch", "ros4hri", *words], stdin=subprocess.DEVNULL,
                                        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                        env=dict(os.environ, **variables))
        threading.Thread(target=lambda: self.lines.extend(self.process.stdout), daemon=True).start()

    def end(self):
        """End it as Ctrl-C does."""
        if self.process.poll() is None:
            self.process.terminate()
        self.process.wait(END_S)


class TwoLaunchesTest(unittest.TestCase):

    def setUp(self):
        self.gazes = []
        self.hear()

    def hear(self):
        self.listener = rospy.Subscriber("/humans/interactions/gaze", GazesStamped,
                                         lambda message: self.gazes.append(message.header))
        self.addCleanup(self.listener.unregister)

    def launch(self, *words, **variables):
        launch = Launch(*words, **variables)
        self.addCleanup(launch.end)
        return launch

    def gaze(self, launch):
        """The header of a new list of gazes."""
        del self.gazes[:]
        try:
            wait_for(lambda: self.gazes, "a list of gazes", 90.0)
        except AssertionError as error:
            self.fail("{}\n{}\n{}".format(error, self.connections(), "".join(launch.lines[-30:])))
        return self.gazes[-1]

    def connections(self):
        """Who publishes and subscribes what, and how many of the publishers of gazes are connected here."""
        publishers, subscribers, _ = rosgraph.Master("/two_launches").getSystemState()
        return "connected to {} publishers of gazes\npublishers: {}\nsubscribers: {}".format(
            self.listener.get_num_connections(),
            *([(topic, nodes) for topic, nodes in topics if topic.startswith(("/humans/persons/tracked",
                                                                             "/humans/interactions", "/tf"))]
              for topics in (publishers, subscribers)))

    def left(self):
        """Parameters outside of the namespaces of nodes, apart from those of ROS itself."""
        nodes = {"/" + name for name in ("scene_simulator", "hri_person_manager", "hri_person_manager_memory",
                                         "hri_interactions",
                                         "hri_diagnostics", "two_launches")}
        return {name for name in rosgraph.Master("/two_launches").getParamNames()
                if not name.startswith(OF_ROS) and "/" + name.split("/")[1] not in nodes}

    def test_frames_time_and_expectations(self):
        before = self.left()
        first = self.launch("scene.launch", "rviz:=false", "sim_time:=true", "speed:=2.0", "reference_frame:=base_link",
                            "robot_frame:=microphone", "diagnostics:=true")
        self.assertEqual(self.gaze(first).frame_id, "base_link")
        self.assertEqual(rospy.get_param("/hri_interactions/robot_frame"), "microphone")
        self.assertTrue(rospy.get_param("/hri_diagnostics/analyzers/persons/analyzers/manager/expected", []))
        first.end()
        self.assertEqual(self.left(), before)
        second = self.launch("scene.launch", "rviz:=false", "voices:=false")
        header = self.gaze(second)
        self.assertEqual(header.frame_id, "map")
        self.assertAlmostEqual(header.stamp.to_sec(), time.time(), delta=30.0)
        self.assertEqual(rospy.get_param("/hri_interactions/robot_frame"), "camera_color_optical_frame")
        self.assertFalse(rospy.get_param("/scene_simulator/sense_voices"))
        second.end()
        third = self.launch("diagnostics.launch")
        wait_for(lambda: "/hri_diagnostics" in dict(rosgraph.Master("/two_launches").getSystemState()[2]).get(
            "/hri_diagnostics/get_loggers", []), "the aggregator")
        self.assertFalse(rospy.has_param("/hri_diagnostics/analyzers/persons/analyzers/manager/expected"))
        third.end()
        self.assertEqual(self.left(), before)

    def test_the_frame_of_the_whole_stack_counts_where_the_launch_says_nothing(self):
        rospy.set_param("/humans/reference_frame", "base_link")
        self.addCleanup(rospy.delete_param, "/humans/reference_frame")
        launch = self.launch("scene.launch", "rviz:=false")
        self.assertEqual(self.gaze(launch).frame_id, "base_link")
        launch.end()
        launch = self.launch("scene.launch", "rviz:=false", "reference_frame:=map")
        self.assertEqual(self.gaze(launch).frame_id, "map")

    def test_a_robot_in_a_namespace_has_its_tree_of_diagnostics(self):
        levels = {}
        listener = rospy.Subscriber("/diagnostics_agg", DiagnosticArray, lambda message: levels.update(
            {status.name: (status.level, status.message) for status in message.status}))
        self.addCleanup(listener.unregister)
        launch = self.launch("scene.launch", "rviz:=false", "diagnostics:=true", ROS_NAMESPACE="robot1")
        branch = "/humans/Persons/Person manager"
        wait_for(lambda: levels.get(branch, (3,))[0] == 0 and branch + "/robot1 hri_person_manager: persons" in levels,
                 lambda: "{}\n{}".format(levels, "".join(launch.lines[-30:])), 60.0)
        self.assertNotIn(branch + "/hri_person_manager: persons", levels)
        launch.end()
        self.assertNotIn("/hri_diagnostics/base_path", rosgraph.Master("/two_launches").getParamNames())


if __name__ == "__main__":
    rospy.init_node("two_launches")
    rostest.rosrun("ros4hri", "two_launches", TwoLaunchesTest)
