#!/usr/bin/env python3
"""A scene as a bag, played on its own clock: what the stack makes of it may only improve."""

import os
import shutil
import tempfile
import unittest
from pathlib import Path

import rospy
import rostest
from bag_stage import Ears, Player, Recorder, listeners, wait_for
from golden_case import check_bag
from make_bags import scene_bag

NEEDED = (("/humans/candidate_matches", "/hri_person_manager"), ("/humans/faces/tracked", "/hri_face_body_matcher"),
          ("/humans/voices/tracked", "/hri_voice_matcher"), ("/humans/bodies/tracked", "/hri_person_manager"),
          ("/tf", "/hri_interactions"), ("/scene/truth/heads", "/recorder"), ("/scene/truth/gaze", "/recorder"))
RECORDED = ("/humans/persons/tracked", "/humans/interactions/gaze", "/humans/interactions/groups", "/tf")


class SceneBagTest(unittest.TestCase):

    def test_what_the_stack_makes_of_a_scene(self):
        folder = Path(tempfile.mkdtemp(prefix="ros4hri-bag-"))
        self.addCleanup(shutil.rmtree, str(folder), True)
        scene_bag(folder / "scene.bag")
        ears = Ears()
        self.addCleanup(ears.close)
        wait_for(lambda: all(node in listeners().get("/clock", ())
                             for node in ("/hri_person_manager", "/hri_interactions")), "the stack")
        player = Player(folder / "scene.bag")
        self.addCleanup(player.close)
        recorder = Recorder(folder / "record.bag")
        self.addCleanup(recorder.close)
        wait_for(lambda: all("/recorder" in listeners().get(topic, ()) for topic in RECORDED), "the recorder listens")
        player.go(NEEDED)
        wait_for(lambda: not player.running(), "the end of the bag", 120.0)
        recorder.close()
        if os.environ.get("ROS4HRI_KEEP_BAGS"):
            shutil.copy(str(folder / "record.bag"), os.environ["ROS4HRI_KEEP_BAGS"])
        self.assertEqual(ears.errors, [])
        check_bag(folder / "record.bag", "scene")


if __name__ == "__main__":
    rospy.init_node("scene_bag_test")
    rostest.rosrun("ros4hri", "scene_bag", SceneBagTest)
