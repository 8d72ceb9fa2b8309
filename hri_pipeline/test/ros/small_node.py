#!/usr/bin/env python3
"""The smallest node there can be, for run_node_test.py: a list of ids, a parameter, a model."""

import signal
import sys
import threading
from dataclasses import dataclass

import rospy
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse

from hri_pipeline.core.onnx import OnnxModel
from hri_pipeline.core.parameters import ParameterTable, Settings, parameter
from hri_pipeline.ros.node import read_parameters, run_node
from hri_pipeline.ros.publishers import TrackedList
from hri_pipeline.ros.subscriptions import IdSubscribers


@dataclass(frozen=True)
class SmallSettings(Settings):
    """A node for tests."""

    size: int = parameter(5, "Any number.", "px", 1, 10)
    model: str = parameter("", "Path of a model.")
    fail: str = parameter("", "Where to raise an error.", choices=("", "build", "spin", "close"))


TABLE = ParameterTable("small_node", SmallSettings)


class SmallNode:
    """Tracks one face for ever. SIGUSR1: somebody new comes, with a topic and a subscription."""

    def __init__(self):
        self.parameters = read_parameters(TABLE)
        if self.parameters.model:
            OnnxModel(self.parameters.model)
        self.fail("build")
        self.service = rospy.Service("~ask", Trigger, lambda request: TriggerResponse(True, "here"))
        self.feed = IdSubscribers("bodies", {}, lambda *_: None)
        self.tracked = TrackedList("/humans/faces/tracked")
        self.tracked.set(["abcde"], 1.0)
        signal.signal(signal.SIGUSR1, lambda *_: threading.Thread(target=self.come, daemon=True).start())

    def come(self):
        self.late = (rospy.Publisher("/humans/faces/fghij/roi", String, queue_size=1),
                     rospy.Subscriber("/humans/bodies/fghij/roi", String, lambda message: None))
        print("somebody new is there", flush=True)

    def fail(self, where):
        if self.parameters.fail == where:
            raise RuntimeError("fails in " + where)

    def spin(self):
        print("spinning, size", self.parameters.size, flush=True)
        self.fail("spin")
        rospy.spin()

    def close(self):
        self.tracked.close()
        self.feed.close()
        self.service.shutdown()
        print("closed", flush=True)
        self.fail("close")


if __name__ == "__main__":
    sys.exit(run_node("small_node", SmallNode))
