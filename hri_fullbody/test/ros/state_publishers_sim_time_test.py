#!/usr/bin/env python3
"""robot_state_publishers on a simulated clock that runs four times as fast as the wall's, stands still, and jumps
back."""

import threading
import time
import unittest

import rospy
import rostest
from rosgraph_msgs.msg import Clock
from skeleton_graph import Movers, TfTree, farthest, wait_until_gone

from hri_fullbody.ros.state_publishers import StatePublishers
from hri_pipeline.testing import wait_for

WAIT_S = 20.0
SPEED = 4.0


class Clockwork:
    """Publishes /clock a hundred times a second."""

    def __init__(self):
        self.now, self.running = 1000.0, True
        self._publisher = rospy.Publisher("/clock", Clock, queue_size=10)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self):
        """Stop."""
        self._stop.set()
        self._thread.join()

    def _run(self):
        last = time.monotonic()
        while not self._stop.wait(0.01):
            now = time.monotonic()
            if self.running:
                self.now += SPEED * (now - last)
            last = now
            self._publisher.publish(Clock(clock=rospy.Time.from_sec(self.now)))


class SimTimeTest(unittest.TestCase):

    def test_frames_follow_the_simulated_clock(self):
        clock = Clockwork()
        self.addCleanup(clock.close)
        tree, movers = TfTree(), Movers()
        self.addCleanup(tree.close)
        self.addCleanup(movers.close)
        publishers = StatePublishers(limit=3, rate=15.0)
        self.addCleanup(publishers.close)
        publishers.set("abcde", movers.set({"abcde": 1.7})["abcde"], 1)
        stamp = wait_for(lambda: tree.complete("abcde"), WAIT_S, "frames")[-1]
        self.assertTrue(1000.0 <= stamp.to_sec() <= clock.now)
        self.assertLess(farthest(tree, movers, "abcde", stamp), 1e-5)
        # While the clock stands, nothing is repeated.
        clock.running = False
        stopped = wait_for(lambda: abs(rospy.get_time() - clock.now) < 1e-6 and clock.now, WAIT_S,
                           "the clock's standstill")
        before = time.monotonic()
        wait_for(lambda: time.monotonic() - before > 0.5, WAIT_S, "half a second")
        self.assertEqual(tree.repeated, [])
        self.assertTrue(all(stamp.to_sec() <= stopped + 1e-6 for stamp in tree.complete("abcde")))
        # A bag that loops.
        tree.forget("abcde")
        clock.now, clock.running = 500.0, True
        wait_for(lambda: any(500.0 <= stamp.to_sec() < 900.0 for stamp in tree.complete("abcde")), WAIT_S,
                 "frames after the jump")
        publishers.close()
        movers.set({})
        wait_until_gone("abcde", WAIT_S)


if __name__ == "__main__":
    rospy.init_node("state_publishers_sim_time_test")
    rostest.rosrun("hri_fullbody", "state_publishers_sim_time", SimTimeTest)
