#!/usr/bin/env python3
"""Camera and perception on two machines: compressed images go over the network, raw ones do not, and people appear on
both.

The machines are two network namespaces with a cable (veth) between them; making them needs root and iproute2, else the
test is skipped. The halves are started by hand, as launch/two_machines.launch describes; ssh is no part of this test.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import rostest
from bag_stage import wait_for

from hri_pipeline.core.onnx import models_directory

ROBOT, COMPUTER = "10.211.7.1", "10.211.7.2"
PORT = 11311
SECONDS = 90.0
PROBE = Path(__file__).resolve().with_name("two_machines_probe.py")


def run(*command):
    """Run a command; raises CalledProcessError."""
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)


class Machine:
    """A network namespace of which every process is ended by close()."""

    def __init__(self, name, address, folder):
        self.name, self._address, self._folder = "{}-{}".format(name, os.getpid()), address, folder
        self._children = []
        run("ip", "netns", "add", self.name)

    def plug(self, cable):
        """Give one end of a cable the address of this machine."""
        inside = ("ip", "-n", self.name)
        run("ip", "link", "set", cable, "netns", self.name)
        run(*inside, "addr", "add", self._address + "/24", "dev", cable)
        for device in ("lo", cable):
            run(*inside, "link", "set", device, "up")

    def start(self, name, *command):
        """Start a command there, with the ROS environment of that machine."""
        environment = dict(os.environ, ROS_IP=self._address, ROS_MASTER_URI="http://{}:{}".format(ROBOT, PORT))
        environment.pop("ROS_HOSTNAME", None)
        with open(str(self.log(name)), "wb") as log:
            process = subprocess.Popen(("ip", "netns", "exec", self.name) + command, env=environment,
                                       stdin=subprocess.DEVNULL,
                                       stdout=log, stderr=subprocess.STDOUT)
        self._children.append(process)
        return process

    def log(self, name):
        """File of what a command prints."""
        return self._folder / (name + ".log")

    def received(self):
        """Bytes that have come over its cables."""
        counted = subprocess.run(["ip", "-n", self.name, "-s", "-j", "link"], check=True, stdout=subprocess.PIPE).stdout
        return sum(link["stats64"]["rx"]["bytes"] for link in json.loads(counted.decode()) if link["ifname"] != "lo")

    def close(self):
        """End everything that runs there, and take the namespace away. Idempotent."""
        for process in reversed(self._children):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self._children:
            try:
                process.wait(15.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._children = []
        if self.name in os.listdir("/var/run/netns"):
            left = subprocess.run(["ip", "netns", "pids", self.name], stdout=subprocess.PIPE,
                                  check=False).stdout.split()
            for pid in left:
                os.kill(int(pid), signal.SIGKILL)
            run("ip", "netns", "del", self.name)


class TwoMachinesTest(unittest.TestCase):

    def setUp(self):
        if shutil.which("ip") is None:
            self.skipTest("no command `ip`; install iproute2")
        self.folder = Path(tempfile.mkdtemp(prefix="ros4hri-machines-"))
        self.addCleanup(shutil.rmtree, str(self.folder), True)
        try:
            self.robot = Machine("r4h-robot", ROBOT, self.folder)
            self.addCleanup(self.robot.close)
            self.computer = Machine("r4h-computer", COMPUTER, self.folder)
            self.addCleanup(self.computer.close)
            ends = "r4hr%d" % (os.getpid() % 10 ** 6), "r4hc%d" % (os.getpid() % 10 ** 6)
            run("ip", "link", "add", ends[0], "type", "veth", "peer", "name", ends[1])
            self.robot.plug(ends[0])
            self.computer.plug(ends[1])
        except (OSError, subprocess.CalledProcessError) as error:
            self.skipTest(
                "no network namespaces can be made here: {} {}".format(error, getattr(error, "output", b"") or "")
            )

    def said(self, *names):
        """The end of some logs, for messages."""
        return "".join("\n--- {}\n{}".format(name, self.robot.log(name).read_text(errors="replace")[-2000:])
                       for name in names)

    def test_people_appear_on_both(self):
        picture = models_directory() / "demo" / "sample1.jpg"
        self.robot.start("camera", "roslaunch", "-p", str(PORT), "hri_pipeline", "image_source.launch",
                         "source:=%s" % picture,
                         "image:=/camera/image_raw", "camera_info:=/camera/camera_info", "rate:=10.0")
        self.computer.start("perception", "roslaunch", "--wait", "ros4hri", "ros4hri.launch",
                            "image_transport:=compressed", "voices:=false")
        probes = {}
        for machine, name in ((self.robot, "robot"), (self.computer, "computer")):
            probes[name] = (machine.start("probe_" + name, sys.executable, str(PROBE),
                                          str(self.folder / (name + ".json")), str(SECONDS)),
                            self.folder / (name + ".json"))
        for name, (process, result) in probes.items():
            wait_for(lambda process=process: process.poll() is not None, "the probe of the " + name, SECONDS + 30.0)
            self.assertEqual(process.returncode, 0, name + self.said("camera", "perception", "probe_" + name))
            seen = json.loads(result.read_text())
            print("{}: {}".format(name, seen), flush=True)
            self.assertGreaterEqual(seen["persons"], 1, name)
            self.assertEqual(seen["raw"], 0, "raw images go over the network")
            self.assertGreaterEqual(seen["compressed"], 2, "faces and bodies each take the compressed images")
            self.assertLess(seen["age_s"], 2.0)
        self.assertGreater(self.computer.received(), 10 ** 6, "the images did not come over the cable")


if __name__ == "__main__":
    rostest.rosrun("ros4hri", "two_machines", TwoMachinesTest)
