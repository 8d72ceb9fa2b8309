"""Processes of small_node.py, and masters of their own for them."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import unittest
from xmlrpc.client import ServerProxy

import rosgraph

from hri_pipeline.testing import HeardProcess, wait_for

NODE = os.path.join(os.path.dirname(os.path.abspath(__file__)), "small_node.py")
LAUNCH = """<launch>
  <node name="small_node" pkg="hri_pipeline" type="small_node.py" respawn="true" respawn_delay="0.1" output="screen">
    {}
  </node>
</launch>"""


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Process(HeardProcess):
    """A child process and what it has said so far."""

    def __init__(self, command, **environment):
        self.lines = []
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                   env=dict(os.environ, PYTHONUNBUFFERED="1", **environment))
        super().__init__(process, lambda: self.lines.extend(process.stdout))

    def says(self, text, timeout=20):
        wait_for(lambda: any(text in line for line in list(self.lines)), timeout,
                 "{!r}; said: {}".format(text, self.lines))

    def end(self, number=signal.SIGINT):
        self.process.send_signal(number)
        return self.code()

    def kill(self):
        super().kill()
        self.process.stdout.close()


class NodeTest(unittest.TestCase):
    """Starts nodes and masters, and ends what is left of them."""

    def start(self, command, **environment):
        process = Process(command, **environment)
        self.addCleanup(process.kill)
        return process

    def node(self, *arguments, **environment):
        return self.start([sys.executable, NODE] + list(arguments), **environment)

    def master(self, port):
        process = self.start(["rosmaster", "--core", "-p", str(port)])
        graph = rosgraph.Master("/test", master_uri="http://127.0.0.1:{}".format(port))
        wait_for(graph.is_online, 20, "the master is online")
        return process, graph

    def launch(self, parameter, port):
        launch = tempfile.NamedTemporaryFile("w", suffix=".launch")
        self.addCleanup(launch.close)
        launch.write(LAUNCH.format(parameter))
        launch.flush()
        roslaunch = self.start(["roslaunch", launch.name], ROS_MASTER_URI="http://127.0.0.1:{}".format(port))
        # Killed, it would leave its node.
        self.addCleanup(lambda: roslaunch.process.poll() is None and roslaunch.end())
        return roslaunch

    def starts(self, roslaunch):
        return "".join(roslaunch.lines).count("process[small_node-1]")

    def pid_of_node(self, graph):
        return ServerProxy(graph.lookupNode("/small_node")).getPid("/test")[2]

    def kill_node(self, graph):
        os.kill(self.pid_of_node(graph), signal.SIGKILL)

    def registered(self, graph):
        state = graph.getSystemState()
        return [sorted(name for name, nodes in part if "/small_node" in nodes and not name.startswith("/rosout"))
                for part in state]
