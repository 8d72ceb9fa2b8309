#!/usr/bin/env python3
"""launch/bag.launch as a user runs it: the people of a recording appear, from its beginning on, and it ends with the
recording."""

import os
import shutil
import subprocess
import tempfile
import threading
import unittest
from pathlib import Path

import rospy
import rostest
from bag_stage import Ears, listeners, wait_for
from make_bags import PICTURE_S, pictures_bag
from rosbags.rosbag1 import Reader

RATE = 0.5          # of the recording's time, so that a busy machine sees enough of its images
END_S = 90.0


class BagLaunchTest(unittest.TestCase):

    def setUp(self):
        self.folder = Path(tempfile.mkdtemp(prefix="ros4hri-bag-"))
        self.addCleanup(shutil.rmtree, str(self.folder), True)
        self.bag = self.folder / "pictures.bag"
        pictures_bag(self.bag)
        with Reader(self.bag) as reader:
            self.begin = 1e-9 * reader.start_time
        self.ears = Ears()
        self.addCleanup(self.ears.close)
        self.lines = []

    def launch(self, *arguments):
        """Start bag.launch on the recording, from the directory in which that lies."""
        process = subprocess.Popen(["roslaunch", "ros4hri", "bag.launch", "bag:=%s" % self.bag.name, "rviz:=false",
                                    *arguments],
                                   stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                   text=True,
                                   cwd=str(self.folder), env=dict(os.environ, PWD=str(self.folder)))
        threading.Thread(target=lambda: self.lines.extend(process.stdout), daemon=True).start()

        def end():
            if process.poll() is None:
                process.terminate()
            process.wait(END_S)
        self.addCleanup(end)
        return process

    def said(self):
        """What the launch has printed, for messages."""
        return "".join(self.lines[-30:])

    def test_people_from_the_beginning(self):
        process = self.launch("image_transport:=compressed", "bag_rate:={}".format(RATE), "reference_frame:=room",
                              "camera_tilt:=5",
                              "voices:=false")
        try:
            wait_for(self.ears.persons, "a person", 120.0)
            first = wait_for(lambda: self.ears.placed(self.begin) and rospy.get_time(),
                             "the frame of a person") - self.begin
            print("the first person stands {:.1f} s after the recording's beginning".format(first), flush=True)
            self.assertLess(first, PICTURE_S, "nobody in the first photograph")
            wait_for(lambda: len(self.ears.placed(self.begin + PICTURE_S + 1.0)) >= 3,
                     "three people in the second photograph")
            self.assertNotIn("/hri_voices", {node for nodes in listeners().values() for node in nodes})
            wait_for(lambda: process.poll() is not None, "the end of the launch with the recording", END_S)
        except AssertionError as error:
            self.fail("{}\n{}".format(error, self.said()))
        self.assertEqual(process.returncode, 0, self.said())
        self.assertNotIn("started without", "".join(self.lines), "the recording began before everybody was connected")
        self.assertEqual(self.ears.errors, [])
        # The recording has no transforms: people stand in a room all the same.
        self.assertLessEqual({"room"}, self.ears.parents, self.said())
        self.assertIn("the recording has ended", self.said())
        self.assertNotIn("REQUIRED process", self.said())
        self.assertFalse(rospy.has_param("/use_sim_time"), "the next launch on this master would wait for a clock")
        rospy.set_param("/use_sim_time", True)      # for the other tests of this process

    def test_no_recording(self):
        self.bag.unlink()
        process = self.launch()
        wait_for(lambda: process.poll() is not None, "the end", END_S)
        self.assertNotEqual(process.returncode, 0)
        wait_for(lambda: "there is no recording %s" % self.bag in "".join(self.lines), "the word")

    def test_a_wrong_choice_is_named_with_the_legal_ones(self):
        for file, wrong, legal in (("ros4hri.launch", "quality:=good", "fast, balanced, best"),
                                   ("ros4hri.launch", "microphones:=kinect", "respeaker_v2, respeaker_core"),
                                   ("ros4hri.launch", "sensor:=kinect", "realsense_d400, azure_kinect"),
                                   ("bag.launch", "sensor:=kinect", "realsense_d400, azure_kinect")):
            done = subprocess.run(["roslaunch", "--nodes", "ros4hri", file, wrong], stdout=subprocess.PIPE,
                                  stderr=subprocess.STDOUT, universal_newlines=True, timeout=30, check=False)
            self.assertEqual(done.returncode, 1)
            self.assertIn("{}; legal: {}".format(wrong, legal), done.stdout)

    def test_a_wrong_transport_is_named(self):
        self.launch()
        wait_for(lambda: any("image_transport:=compressed" in line for line in list(self.lines)), "the warning", 60.0)


if __name__ == "__main__":
    # The clock of the recording; the launch file sets the same, but this node is here before it.
    rospy.set_param("/use_sim_time", True)
    rospy.init_node("bag_launch_test")
    rostest.rosrun("ros4hri", "bag_launch", BagLaunchTest)
