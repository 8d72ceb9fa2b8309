#!/usr/bin/env python3
"""The check of a running set-up, with real faults: it names each, ends with 1, and finds none where there is none."""

import os
import socket
import subprocess
import unittest

import numpy as np
import rosgraph
import roslib.packages
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import CompressedImage

from hri_msgs.msg import IdsList
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.testing import Camera, wait_for

CHECK = roslib.packages.find_node("hri_pipeline", "check")[0]       # rosrun seeks it anew each time
PICTURE = np.random.default_rng(0).integers(60, 200, (120, 160, 3)).astype(np.uint8)


class CheckTest(unittest.TestCase):

    def check(self, *topics, nodes="[face_body_matcher]", code=1, **environment):
        """Run the check and return what it prints."""
        command = [CHECK, "_watch_time:=1.0", "_nodes:=" + nodes] + list(topics)
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, universal_newlines=True,
                              timeout=60,
                              env=dict(os.environ, **environment))
        self.assertEqual(done.returncode, code, done.stdout)
        return done.stdout

    def camera(self, name, picture=PICTURE, fov=0.98, frame="optical_check", **others):
        image, info = "/{}/image".format(name), "/{}/camera_info".format(name)
        self.addCleanup(Camera(picture, image, info, 20.0, frame, fov, **others).close)
        return ["image:=" + image, "camera_info:=" + info]

    def faults(self, text):
        return [line for line in text.splitlines() if line.startswith("FAULT")]

    def names(self, words, *topics, **arguments):
        """The check finds one fault, in these words."""
        text = self.check(*topics, **arguments)
        self.assertEqual(len(self.faults(text)), 1, text)
        self.assertIn(words, self.faults(text)[0])

    def test_nothing_is_wrong(self):
        text = self.check(*self.camera("well"), code=0)
        self.assertIn("no faults found", text)
        self.assertIn("transforms lead from optical_check to map", text)

    def test_nobody_publishes(self):
        self.names("nobody publishes /none/image", "image:=/none/image")

    def test_wrong_type(self):
        self.names("is a sensor_msgs/CompressedImage", *self.camera("packed", kind=CompressedImage))

    def test_not_calibrated(self):
        self.names("K on /blind/camera_info is all zero", *self.camera("blind", fov=0.0))

    def test_no_transform(self):
        self.names("no transform leads from the camera (nowhere)", *self.camera("lost", frame="nowhere"))

    def test_no_frame(self):
        self.names("no frame_id", *self.camera("nameless", frame=""))

    def test_dark(self):
        self.names("too dark", *self.camera("night", picture=PICTURE // 30))

    def test_covered(self):
        self.names("shows nothing", *self.camera("covered", picture=np.full_like(PICTURE, 90)))

    def test_old_images(self):
        self.names("s old when they arrive", *self.camera("late", behind=30.0))

    def test_no_models(self):
        self.names("models are missing in /nonexistent", *self.camera("untaught"), ROS4HRI_MODELS="/nonexistent")

    def test_a_node_that_does_not_run(self):
        self.names("the node hri_faces does not run", *self.camera("alone"), nodes="[face_body_matcher, hri_faces]")

    def test_a_node_that_was_killed(self):
        victim = subprocess.Popen(["rosrun", "hri_pipeline", "face_body_matcher", "__name:=victim"])
        self.addCleanup(victim.wait)
        master = rospy.get_master()
        wait_for(lambda: master.lookupNode("/victim")[0] == 1, 20, "the node is there")
        wait_for(lambda: any("/victim" in nodes for _, nodes in master.getSystemState()[2][0]), 20, "it publishes")
        victim.kill()
        victim.wait(10)
        self.names("victim is registered, but does not answer", *self.camera("mourning"), nodes="[victim]")

    def test_a_node_that_has_ended(self):
        """Who asks for a parameter and its changes stays known to the master."""
        subprocess.run(["python3", "-c", "import rospy; rospy.init_node('leaver'); "
                        "rospy.get_param_cached('/rosdistro', ''); rospy.signal_shutdown('')"], check=True, timeout=30)
        self.assertEqual(rospy.get_master().lookupNode("/leaver")[0], 1)
        self.names("the node leaver does not run", *self.camera("left"), nodes="[leaver]")

    def test_help(self):
        done = subprocess.run(["rosrun", "hri_pipeline", "check", "--help"], stdout=subprocess.PIPE,
                              universal_newlines=True, timeout=30)
        self.assertEqual(done.returncode, 0)
        for words in ("_watch_time:=", "_nodes:=", "image:="):
            self.assertIn(words, done.stdout)

    def test_time_that_stands_still(self):
        rospy.set_param("/use_sim_time", True)
        self.addCleanup(rospy.delete_param, "/use_sim_time")
        self.assertIn("nobody publishes /clock", self.faults(self.check(*self.camera("timeless")))[0])

    def test_two_clocks(self):
        rospy.set_param("/use_sim_time", True)
        self.addCleanup(rospy.delete_param, "/use_sim_time")
        for name in ("clock_one", "clock_two"):
            clock = subprocess.Popen(["rostopic", "pub", "-r", "10", "/clock", "rosgraph_msgs/Clock",
                                      "clock: {secs: 9}", "__name:=" + name], stdout=subprocess.DEVNULL)
            self.addCleanup(clock.wait)
            self.addCleanup(clock.terminate)
        wait_for(lambda: len(dict(rospy.get_master().getSystemState()[2][0]).get("/clock", ())) == 2, 20, "two clocks")
        self.assertIn("2 nodes publish /clock", self.faults(self.check(*self.camera("twice")))[0])

    def test_no_master(self):
        text = self.check("image:=/none/image", ROS_MASTER_URI="http://127.0.0.1:1")
        self.assertIn("no ROS master answers at http://127.0.0.1:1", text)

    def test_the_launch_file_starts_no_master(self):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        uri = "http://127.0.0.1:{}".format(port)
        done = subprocess.run(["roslaunch", "ros4hri", "check.launch"], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT,
                              universal_newlines=True, timeout=60, env=dict(os.environ, ROS_MASTER_URI=uri))
        self.assertEqual(done.returncode, 1, done.stdout)
        self.assertIn("no ROS master answers at " + uri, done.stdout)
        self.assertIn("roslaunch ros4hri ros4hri.launch", done.stdout)
        self.assertNotIn("started with pid", done.stdout)

    def master(self):
        """Another master, and where it is."""
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        master = subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL)
        self.addCleanup(master.wait)
        self.addCleanup(master.kill)
        uri = "http://127.0.0.1:{}".format(port)
        wait_for(rosgraph.Master("/test", master_uri=uri).is_online, 20, "the master is online")
        return master, uri

    def test_the_master_goes_while_it_looks(self):
        master, uri = self.master()
        check = subprocess.Popen(["rosrun", "hri_pipeline", "check", "_watch_time:=4.0"], stdout=subprocess.PIPE,
                                 stderr=subprocess.STDOUT,
                                 universal_newlines=True, env=dict(os.environ, ROS_MASTER_URI=uri))
        self.addCleanup(check.kill)
        self.assertIn("looking at the graph", check.stdout.readline())
        master.kill()
        text, _ = check.communicate(timeout=60)
        self.assertEqual((check.returncode, text.count("no ROS master answers at " + uri)), (1, 1), text)
        self.assertNotIn("Traceback", text)

    def test_nothing_of_the_stack_runs(self):
        _, uri = self.master()
        text = self.check(nodes="[hri_faces, hri_bodies]", ROS_MASTER_URI=uri)
        self.assertEqual(self.faults(text), ["FAULT  nothing of ros4hri runs on this master"], text)
        done = subprocess.run(["roslaunch", "ros4hri", "check.launch"], stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT,
                              universal_newlines=True, timeout=60, env=dict(os.environ, ROS_MASTER_URI=uri))
        self.assertIn("nothing of ros4hri runs on this master", done.stdout)
        self.assertNotIn("REQUIRED process", done.stdout)

    def test_what_the_nodes_tell_of_the_same_topic_stands_below_the_fault(self):
        told = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1, latch=True)
        self.addCleanup(release, told)
        told.publish(DiagnosticArray(status=[DiagnosticStatus(
            level=DiagnosticStatus.ERROR, name="hri_faces: input", message="no publisher on /none/image for 9 s; start "
                                                                           "the camera",
            values=[KeyValue("topic", "/none/image")])]))
        camera = self.camera("beside")[1]
        text = self.check(camera, nodes="[face_body_matcher, hri_faces]")
        self.assertEqual([line for line in self.faults(text) if "image" in line],
                         ["FAULT  nobody publishes /none/image"], text)
        self.assertIn("hence  hri_faces: input: no publisher on /none/image for 9 s", text)

    def test_compressed_images_only(self):
        packed = rospy.Publisher("/packed/image/compressed", CompressedImage, queue_size=1)
        self.addCleanup(release, packed)
        self.names("nobody publishes /packed/image, but /packed/image/compressed is published", "image:=/packed/image",
                   self.camera("packing")[1])

    def test_a_robot_in_a_namespace(self):
        told = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1, latch=True)
        self.addCleanup(release, told)
        told.publish(DiagnosticArray(status=[DiagnosticStatus(
            level=DiagnosticStatus.WARN, name="robot1/matcher: input", message="slow",
            values=[KeyValue("topic", "/theirs/image"), KeyValue("camera_info", "/theirs/camera_info")])]))
        topics = self.camera("theirs")
        matcher = subprocess.Popen(["rosrun", "hri_pipeline", "face_body_matcher", "__name:=matcher"],
                                   env=dict(os.environ, ROS_NAMESPACE="robot1"))
        self.addCleanup(matcher.wait)
        self.addCleanup(matcher.kill)
        wait_for(lambda: any("/robot1/matcher" in nodes for _, nodes in rospy.get_master().getSystemState()[2][0]), 20,
                 "it publishes")
        text = self.check(nodes="[matcher]", code=0, ROS_NAMESPACE="robot1")
        self.assertIn("robot1/matcher: input: slow", text)
        self.assertIn("ok     /theirs/image: 160x120", text)
        self.names("matcher does not run here, but /robot1/matcher", *topics, nodes="[matcher]")
        self.names("nobody publishes /mine/image", "image:=/mine/image", topics[1], nodes="[matcher]",
                   ROS_NAMESPACE="robot1")

    def lists(self, name, kind):
        """Another node publishes the list of a kind."""
        node = subprocess.Popen(["python3", "-c", "import rospy; from hri_msgs.msg import IdsList; "
                                 "rospy.init_node('{}'); rospy.Publisher('/humans/{}/tracked', IdsList, "
                                 "queue_size=1); rospy.spin()".format(name, kind)])
        self.addCleanup(node.wait)
        self.addCleanup(node.kill)
        wait_for(lambda: any("/" + name in nodes for topic, nodes in rospy.get_master().getSystemState()[2][0]
                             if topic.startswith("/humans/")), 20, name + " publishes")
        return node

    def test_nodes_of_other_names(self):
        told = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1, latch=True)
        self.addCleanup(release, told)
        told.publish(DiagnosticArray(status=[DiagnosticStatus(
            level=DiagnosticStatus.WARN, name="finder: input", message="slow",
            values=[KeyValue("topic", "/own/image"), KeyValue("camera_info", "/own/camera_info")])]))
        self.camera("own")
        finder = self.lists("finder", "faces")
        text = self.check(nodes="[hri_faces, hri_face_body_matcher]", code=0)
        for words in ("finder stands for hri_faces", "face_body_matcher stands for hri_face_body_matcher",
                      "/own/image: 160x120", "finder: input: slow"):
            self.assertIn(words, text)
        finder.kill()
        finder.wait()
        self.assertIn("finder is registered, but does not answer", self.check(nodes="[hri_faces]"))

    def test_two_person_managers(self):
        listing = rospy.Publisher("/humans/persons/tracked", IdsList, queue_size=1)
        self.addCleanup(release, listing)
        self.lists("second", "persons")
        self.names("2 person managers share /humans", *self.camera("doubled"))

    def test_wrong_parameter(self):
        self.assertIn("watch_time", self.check("_watch_time:=fast", code=2))


if __name__ == "__main__":
    rospy.init_node("check_test")
    rostest.rosrun("hri_pipeline", "check", CheckTest)
