#!/usr/bin/env python3
"""Parameters of a node when the ROS master is started again, which loses them all."""

import os
import signal
import subprocess
import time
import uuid

import rosgraph
import rostest
from node_process import NodeTest, free_port

from hri_pipeline.testing import wait_for


def of(graph, name):
    """Topics that a node publishes, and subscribes to, by the master."""
    published, subscribed, _ = graph.getSystemState()
    return tuple(sorted(topic for topic, nodes in kind if name in nodes and topic != "/rosout")
                 for kind in (published, subscribed))


class MasterRestartTest(NodeTest):

    def test_a_new_master_gets_the_parameters_back_where_nobody_has_set_them(self):
        port = free_port()
        master, graph = self.master(port)
        graph.setParam("/small_node", {"size": 3, "fail": ""})
        graph.setParam("/humans", {"reference_frame": "odom", "match_threshold": 0.4})
        node = self.node(ROS_MASTER_URI="http://127.0.0.1:{}".format(port))
        node.says("spinning")
        master.kill()
        node.says("does not answer; running on without it")
        node.process.send_signal(signal.SIGSTOP)
        master, graph = self.master(port)
        graph.setParam("/small_node/size", 7)
        graph.setParam("/humans/reference_frame", "map")
        node.process.send_signal(signal.SIGCONT)
        wait_for(lambda: self.registered(graph)[0], 20, "the new master knows the node")
        self.assertEqual(graph.getParam("/small_node"), {"size": 7, "fail": ""})
        self.assertEqual(graph.getParam("/humans"), {"reference_frame": "map", "match_threshold": 0.4})
        self.assertEqual(node.end(), 0)

    def running(self):
        """A master, its port, and a node that it knows."""
        port = free_port()
        master, graph = self.master(port)
        node = self.node(ROS_MASTER_URI="http://127.0.0.1:{}".format(port))
        node.says("spinning")
        return master, port, node

    def comes_late(self, node, graph):
        """What was opened without the master, it knows by now."""
        wait_for(lambda: "/humans/faces/fghij/roi" in self.registered(graph)[0]
                 and "/humans/bodies/fghij/roi" in self.registered(graph)[1], 20, "the master knows the new topics")
        self.assertEqual(node.end(), 0)

    def test_who_comes_while_the_master_is_away_holds_nothing_up(self):
        master, port, node = self.running()
        master.kill()
        node.says("does not answer; running on without it")
        node.process.send_signal(signal.SIGUSR1)
        node.says("somebody new is there")
        self.comes_late(node, self.master(port)[1])

    def test_who_comes_while_the_network_to_the_master_fails_is_told_to_it_later(self):
        master, port, node = self.running()
        master.process.send_signal(signal.SIGSTOP)
        try:
            node.process.send_signal(signal.SIGUSR1)
            node.says("somebody new is there", 40)
        finally:
            master.process.send_signal(signal.SIGCONT)
        self.comes_late(node, rosgraph.Master("/test", master_uri="http://127.0.0.1:{}".format(port)))

    def aggregator_is_known_again(self, namespace=""):
        port = free_port()
        master, graph = self.master(port)
        variables = {"ROS_MASTER_URI": "http://127.0.0.1:{}".format(port), "ROS_NAMESPACE": namespace}
        aggregator = subprocess.Popen(["rosrun", "diagnostic_aggregator", "aggregator_node", "__name:=hri_diagnostics"],
                                      env=dict(os.environ, **variables))
        name = namespace + "/hri_diagnostics"
        try:
            wait_for(lambda: "/diagnostics_agg" in of(graph, name)[0], 20, "the aggregator is there")
            node = self.node(**variables)
            node.says("spinning")
            before = of(graph, name)
            master.kill()
            node.says("does not answer; running on without it")
            master, graph = self.master(port)
            wait_for(lambda: of(graph, name) == before, 20, "the new master knows the aggregator")
            self.assertIn("/diagnostics", before[1])
            self.assertEqual(node.end(), 0)
        finally:
            aggregator.terminate()
            aggregator.wait()

    def test_a_new_master_knows_the_aggregator_of_diagnostics_again(self):
        self.aggregator_is_known_again()

    def test_a_new_master_knows_the_aggregator_of_a_namespace_again(self):
        self.aggregator_is_known_again("/robot1")

    def launched(self):
        """A master, its graph, its port, and roslaunch with the node of size 3."""
        port = free_port()
        master, graph = self.master(port)
        roslaunch = self.launch("<param name='size' value='3'/>", port)
        roslaunch.says("spinning, size 3")
        return master, graph, port, roslaunch

    def test_a_node_that_ends_after_the_restart_of_the_master_has_its_parameters_again(self):
        master, graph, port, roslaunch = self.launched()
        master.kill()
        roslaunch.says("does not answer; running on without it")
        master, graph = self.master(port)
        graph.setParam("/run_id", str(uuid.uuid4()))
        wait_for(lambda: self.registered(graph)[0], 20, "the new master knows the node")
        del roslaunch.lines[:]
        self.kill_node(graph)
        roslaunch.says("spinning, size")
        self.assertIn("spinning, size 3\n", roslaunch.lines)
        self.assertEqual(roslaunch.end(), 0)

    def test_a_node_that_ends_with_the_master_does_not_run_without_its_parameters(self):
        master, graph, port, roslaunch = self.launched()
        pid = self.pid_of_node(graph)
        master.kill()
        os.kill(pid, signal.SIGKILL)
        roslaunch.says("no ROS master at")
        master, graph = self.master(port)
        graph.setParam("/run_id", str(uuid.uuid4()))
        roslaunch.says("went with it")
        time.sleep(3.0)
        self.assertEqual("".join(roslaunch.lines).count("spinning"), 1)
        self.assertEqual(self.starts(roslaunch), 2, "roslaunch has started it again once")
        graph.setParam("/small_node/size", 11)
        roslaunch.says("waits for its parameters to change")
        time.sleep(3.0)
        self.assertEqual(self.starts(roslaunch), 3, "nor is it started again and again with a wrong one")
        graph.setParam("/small_node/size", 4)
        roslaunch.says("spinning, size 4")
        self.assertEqual(roslaunch.end(), 0)


if __name__ == "__main__":
    rostest.rosrun("hri_pipeline", "master_restart", MasterRestartTest)
