#!/usr/bin/env python3
"""A bag of pictures or of sound (the argument), played on its own clock: what the stack finds in it may only
improve."""

import os
import shutil
import sys
import tempfile
import unittest
from pathlib import Path

import rospy
import rostest
from bag_stage import Ears, Player, Recorder, listeners, wait_for
from golden_case import check_bag
from make_bags import BAGS
from rosbags.rosbag1 import Reader

NEEDED = {
    "pictures": (("/camera/image_raw/compressed", "/hri_faces"), ("/camera/image_raw/compressed", "/hri_bodies"),
                 ("/camera/camera_info", "/hri_faces"), ("/scene/truth/faces", "/recorder"),
                 ("/scene/truth/bodies", "/recorder")),
    "sound": (("/microphone/audio", "/hri_voices"), ("/microphone/audio_info", "/hri_voices"),
              ("/scene/truth/words", "/recorder"))}
RECORDED = {"pictures": ("/humans/faces/tracked", "/humans/bodies/tracked"), "sound": ("/humans/voices/tracked",)}
AFTER_S = {"pictures": 0.0, "sound": 5.0}
KIND = "pictures"


class MediaBagTest(unittest.TestCase):

    def test_what_is_found(self):
        folder = Path(tempfile.mkdtemp(prefix="ros4hri-bag-"))
        self.addCleanup(shutil.rmtree, str(folder), True)
        BAGS[KIND](folder / "media.bag")
        ears = Ears()
        self.addCleanup(ears.close)
        # Nodes announce their lists once their models are loaded.
        wait_for(lambda: set(RECORDED[KIND]) <= {"/humans/{}/tracked".format(kind) for kind in ears.tracked},
                 "the nodes", 90.0)
        with Reader(folder / "media.bag") as reader:
            end = 1e-9 * reader.end_time
        # Time goes on after the end of the bag, so that the last sentence is recognised.
        player = Player(folder / "media.bag", "--keep-alive")
        self.addCleanup(player.close)
        recorder = Recorder(folder / "record.bag")
        self.addCleanup(recorder.close)
        wait_for(lambda: all("/recorder" in listeners().get(topic, ()) for topic in RECORDED[KIND]),
                 "the recorder listens")
        player.go(NEEDED[KIND])
        wait_for(lambda: rospy.get_time() > end + AFTER_S[KIND], "the end of the bag", 120.0)
        recorder.close()
        if os.environ.get("ROS4HRI_KEEP_BAGS"):
            shutil.copy(str(folder / "record.bag"), os.path.join(os.environ["ROS4HRI_KEEP_BAGS"], KIND + "_record.bag"))
        self.assertEqual(ears.errors, [])
        check_bag(folder / "record.bag", KIND)


if __name__ == "__main__":
    KIND = next((argument for argument in sys.argv[1:] if argument in NEEDED), KIND)
    rospy.init_node("media_bag_test")
    rostest.rosrun("ros4hri", KIND + "_bag", MediaBagTest)
