#!/usr/bin/env python3
"""Start and end of a node: no master, master comes, goes and comes again; signals; errors of the set-up."""

import signal
import sys
import tempfile
import time
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from node_process import LAUNCH, NodeTest, free_port

from hri_msgs.msg import IdsList
from hri_pipeline.testing import wait_for

# A master that has just begun, and takes nothing from the node at first.
HASTY_MASTER = """
import sys
from rosgraph.xmlrpc import XmlRpcNode
from rosmaster.master_api import ROSMasterHandler

class Handler(ROSMasterHandler):
    refused = 0

    def registerPublisher(self, caller, *arguments):
        if caller == "/small_node" and self.refused < int(sys.argv[2]):
            self.refused += 1
            print("refused", flush=True)
            raise RuntimeError("not yet")
        return super().registerPublisher(caller, *arguments)

master = XmlRpcNode(int(sys.argv[1]), Handler(num_workers=3))
master.run()
"""


class RunNodeTest(NodeTest):

    def test_without_a_master_it_says_so_and_can_be_stopped(self):
        uri = "http://127.0.0.1:{}".format(free_port())
        for number in (signal.SIGINT, signal.SIGTERM):
            node = self.node(ROS_MASTER_URI=uri)
            node.says("no ROS master at {}".format(uri))
            node.says("start roscore or roslaunch")
            self.assertEqual(node.end(number), 0)
            self.assertNotIn("Traceback", "".join(node.lines))

    def test_help_is_given_without_a_master(self):
        node = self.node("--help", ROS_MASTER_URI="http://127.0.0.1:{}".format(free_port()))
        node.says("_PARAMETER:=VALUE")
        wait_for(lambda: node.process.poll() is not None, 10, "the end")
        self.assertEqual(node.process.returncode, 0)

    def test_an_argument_that_is_ignored_is_told(self):
        node = self.node("image=/camera", "_size:=3", ROS_MASTER_URI="http://127.0.0.1:{}".format(free_port()))
        node.says("image=/camera is ignored")
        node.says("no ROS master")
        self.assertNotIn("_size", "".join(node.lines))
        self.assertEqual(node.end(), 0)

    def test_the_master_comes_goes_and_comes_again(self):
        port = free_port()
        node = self.node(ROS_MASTER_URI="http://127.0.0.1:{}".format(port))
        node.says("no ROS master")
        master, graph = self.master(port)
        node.says("the ROS master is there")
        node.says("spinning")
        first = self.registered(graph)
        master.kill()
        node.says("does not answer; running on without it")
        master, graph = self.master(port)
        node.says("registering all topics and services anew")
        wait_for(lambda: self.registered(graph) == first, 20, "the new master knows {}".format(first))
        self.assertEqual(node.end(), 0)
        self.assertEqual(self.registered(graph), [[], [], []])

    def test_a_new_master_that_refuses_at_first_is_told_again(self):
        port = free_port()
        master, graph = self.master(port)
        node = self.node(ROS_MASTER_URI="http://127.0.0.1:{}".format(port))
        node.says("spinning")
        first = self.registered(graph)
        self.assertIn("/humans/faces/tracked", first[0])
        master.kill()
        node.says("does not answer; running on without it")
        refusals = 2
        hasty = self.start([sys.executable, "-c", HASTY_MASTER, str(port), str(refusals)])
        wait_for(lambda: "".join(hasty.lines).count("refused") == refusals, 30,
                 lambda: "refused twice; said " + str(node.lines))
        wait_for(lambda: self.registered(graph) == first, 20, lambda: "the new master knows {}, not {}".format(
            first, self.registered(graph)))
        self.assertEqual(node.end(), 0)

    def test_signals_close_while_ros_still_works(self):
        heard = []
        subscriber = rospy.Subscriber("/humans/faces/tracked", IdsList, lambda message: heard.append(message.ids))
        self.addCleanup(subscriber.unregister)
        for number in (signal.SIGINT, signal.SIGTERM):
            del heard[:]
            node = self.node()
            wait_for(lambda: ["abcde"] in heard, 20, "the face is tracked")
            self.assertEqual(node.end(number), 0)
            wait_for(lambda: heard[-1] == [], 10, "the empty list at the end")
            self.assertEqual([line for line in node.lines if "closed" in line], ["closed\n"])

    def test_rosnode_kill_ends_it(self):
        node = self.node()
        node.says("spinning")
        uri = rosgraph.Master("/test").lookupNode("/small_node")
        ServerProxy(uri).shutdown("/test", "killed by the test")
        self.assertEqual(node.code(), 0)
        said = "".join(node.lines)
        self.assertIn("closed", said)
        self.assertNotIn("Traceback", said)

    def test_errors_of_the_set_up_are_one_line(self):
        with tempfile.NamedTemporaryFile(suffix=".onnx") as model:
            model.write(b"not a model")
            model.flush()
            for argument, text in (("_size:=11", "/small_node: parameter size is 11 (int); legal: int, 1 to 10 px"),
                                   ("_siez:=3", "no parameter siez (did you mean size?)"),
                                   ("_model:=/nowhere/x.onnx", "/nowhere/x.onnx does not exist"),
                                   ("_model:=" + model.name, "rosrun hri_pipeline fetch_models")):
                node = self.node(argument)
                self.assertEqual(node.code(), 1)
                said = [line for line in node.lines if line.strip()]
                self.assertEqual(len(said), 1, said)
                self.assertIn(text, said[0])
                rospy.delete_param("/small_node")

    def test_roslaunch_does_not_start_it_again_and_again(self):
        self.launch_wrongly("<param name='size' value='11'/>", 1)
        self.launch_wrongly("<param name='model' value='/nowhere/x.onnx'/>", 2)

    def test_nor_does_a_roslaunch_with_a_master_of_its_own(self):
        with tempfile.NamedTemporaryFile("w", suffix=".launch") as launch:
            launch.write(LAUNCH.format("<param name='size' value='11'/>"))
            launch.flush()
            port = str(free_port())
            roslaunch = self.start(["roslaunch", "-p", port, launch.name], ROS_MASTER_URI="http://localhost:" + port)
            roslaunch.says("waits for its parameters to change")
            self.assertEqual("".join(roslaunch.lines).count("process[small_node-"), 1)
            self.assertEqual(roslaunch.end(), 0)

    def test_of_two_launches_the_later_one_has_the_node(self):
        port = free_port()
        self.master(port)
        logs_as_it_ends = "<param name='fail' value='close'/>"
        first = self.launch(logs_as_it_ends, port)
        first.says("spinning")
        second = self.launch(logs_as_it_ends, port)
        first.says("This one waits until that has ended")
        time.sleep(3.0)
        self.assertEqual((self.starts(first), self.starts(second)), (1, 1))
        self.assertEqual(second.end(), 0)
        wait_for(lambda: self.starts(first) == 2, 30, "the first launch starts its node again")
        wait_for(lambda: "".join(first.lines).count("spinning") == 2, 20, "it runs")
        third = self.launch(logs_as_it_ends, port)
        wait_for(lambda: "".join(first.lines).count("This one waits") == 2, 20, "it waits once more")
        self.assertEqual(first.end(), 0)
        self.assertEqual(self.starts(third), 1)

    def launch_wrongly(self, parameter, starts):
        """The error is on /diagnostics, the node is not started much more often than `starts`, and then it is well."""
        with tempfile.NamedTemporaryFile("w", suffix=".launch") as launch:
            launch.write(LAUNCH.format(parameter))
            launch.flush()
            roslaunch, told = self.start(["roslaunch", launch.name]), []
            subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, lambda message: told.extend(
                status for status in message.status if status.name == "small_node: settings"))

            def started():
                return "".join(roslaunch.lines).count("process[small_node-1]")

            wait_for(lambda: told and started() >= starts, 30, lambda: "it says so; said: {}".format(roslaunch.lines))
            self.assertEqual(told[0].level, DiagnosticStatus.ERROR)
            subscriber.unregister()
            time.sleep(2.0)
            self.assertLessEqual(started(), starts + 1)
            rospy.set_param("/small_node/size", 3)
            rospy.set_param("/small_node/model", "")
            roslaunch.says("spinning")
            self.assertEqual(roslaunch.end(), 0)
            rospy.delete_param("/small_node")

    def test_other_errors_close_and_give_a_traceback(self):
        for where, closed in (("build", 0), ("spin", 1), ("close", 1)):
            node = self.node("_fail:=" + where)
            if where == "close":
                node.says("spinning")
                node.end()
            self.assertEqual(node.code(), 1)
            said = "".join(node.lines)
            self.assertIn("RuntimeError: fails in " + where, said)
            self.assertEqual(said.count("closed\n"), closed)
            rospy.delete_param("/small_node")


if __name__ == "__main__":
    rospy.init_node("run_node_test")
    rostest.rosrun("hri_pipeline", "run_node", RunNodeTest)
