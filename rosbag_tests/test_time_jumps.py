#!/usr/bin/env python3
"""A bag in a loop, paused, started again, slower and faster: the same people again within seconds, no complaint,
nothing left behind."""

import shutil
import tempfile
import time
import unittest
from pathlib import Path

import rosgraph
import rospy
import rostest
from bag_stage import Ears, Player, listeners, orphans, wait_for
from make_bags import BASE, jumps_bag

from hri_msgs.msg import IdsList

PEOPLE = ["ann", "bob", "cho"]
SOON_S = 8.0        # s of the bag until everybody is there again, of which a recogniser takes 2
PAUSED_S = 3.0      # wall time
NEEDED = (("/humans/candidate_matches", "/hri_person_manager"), ("/humans/bodies/tracked", "/hri_person_manager"),
          ("/tf", "/hri_person_manager"), ("/humans/faces/tracked", "/hri_face_body_matcher"))
NODES = ("/hri_person_manager", "/hri_face_body_matcher", "/hri_voice_matcher", "/hri_interactions")


class TimeJumpsTest(unittest.TestCase):

    @classmethod
    def setUpClass(cls):
        cls.folder = Path(tempfile.mkdtemp(prefix="ros4hri-bag-"))
        cls.bag = cls.folder / "jumps.bag"
        jumps_bag(cls.bag)
        cls.ears, cls.player = Ears(), None
        cls.pids = {}

    @classmethod
    def tearDownClass(cls):
        if cls.player is not None:
            cls.player.close()
        cls.ears.close()
        shutil.rmtree(str(cls.folder), True)

    def start(self, *options):
        """Play from the beginning; the clock goes back where it ran before."""
        if self.player is not None:
            self.player.close()
        type(self).player = Player(self.bag, *options)
        self.player.go(NEEDED)

    def all_again(self, what, rate=1.0):
        """Wait until everybody is a person with a place of the time now; prints how long that took, in the bag's
        time."""
        began, back = time.monotonic(), 0.5 * SOON_S
        limit = max(30.0, 4.0 * SOON_S / rate)      # wall time; a busy machine lags behind the bag
        wait_for(lambda: self.ears.persons() == PEOPLE and self.there(rospy.get_time(), back), what, limit)
        print("{}: all there after {:.1f} s of the wall, at {:.1f} s of the bag".format(
            what, time.monotonic() - began, rospy.get_time() - BASE), flush=True)

    def there(self, now, slack):
        """Whether everybody has a place that is neither of the future nor older than `slack` s."""
        return set(PEOPLE) <= self.ears.placed(now - slack, now + 0.5)

    def wait_for_loop(self):
        """Wait until the bag has started again."""
        last = [rospy.get_time()]

        def back():
            now, before = rospy.get_time(), last[0]
            last[0] = now
            return now < before - 1.0
        wait_for(back, "the bag starts again", 60.0)
        self.ears.forget()

    def test_1_loop(self):
        wait_for(lambda: all(node in listeners().get("/clock", ()) for node in NODES), "the stack")
        type(self).pids = self.processes()
        self.start("--loop")
        self.all_again("from the beginning")
        self.wait_for_loop()
        self.all_again("the bag in a loop")

    def test_2_pause(self):
        self.all_again("before the pause")
        self.player.pause(True)
        still, end = self.ears.persons(), time.monotonic() + PAUSED_S
        # A message that was on its way may still come; then nothing changes.
        wait_for(lambda: time.monotonic() > end or self.ears.persons() != still, "the end of the pause")
        self.assertEqual(self.ears.persons(), still, "who is there while time stands still")
        self.ears.forget()
        self.player.pause(False)
        self.all_again("after the pause")

    def test_3_from_the_beginning(self):
        self.all_again("before time goes back")
        self.ears.forget()
        self.start()
        self.all_again("time set back")

    def test_4_half_speed(self):
        self.ears.forget()
        self.start("--rate", "0.5", "--loop")
        self.all_again("half speed", 0.5)

    def test_5_double_speed(self):
        self.ears.forget()
        self.start("--rate", "2", "--loop")
        self.all_again("double speed", 2.0)
        self.wait_for_loop()
        self.all_again("double speed in a loop", 2.0)

    def test_6_nothing_is_left_behind(self):
        self.player.close()
        known = rospy.wait_for_message("/humans/persons/known", IdsList, 20.0).ids
        wait_for(lambda: not orphans("persons", [*known, *self.ears.tracked.get("persons", ())]),
                 "no topic of persons who are nowhere", 20.0)
        self.assertEqual(self.ears.errors, [])
        self.assertEqual(self.processes(), self.pids, "no node has ended or been started again")

    def processes(self):
        """Address of each node: another process would have another."""
        master = rosgraph.Master("/time_jumps")
        return {node: master.lookupNode(node) for node in NODES}


if __name__ == "__main__":
    rospy.init_node("time_jumps_test")
    rostest.rosrun("ros4hri", "time_jumps", TimeJumpsTest)
