#!/usr/bin/env python3
"""cameras and calibrate_cameras: the nodes that a file starts, and the places that a simulated walker tells."""

import math
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
import yaml
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from hri_msgs.msg import IdsList, Skeleton2D
from hri_person_manager.ros.cameras import CameraFileError, launch_arguments, read_cameras
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import camera_info, skeleton_to_msg

JOINTS = {"left_eye": (0.03, 0.05, 0.936), "right_eye": (-0.03, 0.05, 0.936), "neck": (0.0, 0.0, 0.818),
          "left_hip": (0.08, 0.0, 0.53), "right_hip": (-0.08, 0.0, 0.53), "left_ankle": (0.08, 0.0, 0.039),
          "right_ankle": (-0.08, 0.0, 0.039), "left_wrist": (0.2, 0.1, 0.485), "right_wrist": (-0.2, 0.1, 0.485)}
STATURE, NOISE_M = 1.75, 0.01
NAMES = ["nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
         "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "left_eye", "right_eye",
         "left_ear", "right_ear"]
WIDTH, HEIGHT, HFOV = 1280, 960, 1.5


def looking(position, target):
    """Pose in the room of the optical frame of a camera that looks at a point."""
    z = (np.array(target) - position) / np.linalg.norm(np.array(target) - position)
    x = np.cross(z, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(z, (0.0, 0.0, 1.0)))
    return Pose(np.column_stack([x, np.cross(z, x), z]), np.array(position))


CAMERAS = [looking((0.0, 0.0, 1.6), (2.5, 2.5, 0.9)), looking((5.0, 0.0, 2.0), (2.5, 2.5, 0.9))]


def place_of(pose):
    return [float(value) for value in (*pose.translation, *pose.quaternion)]


class CamerasTest(unittest.TestCase):
    def setUp(self):
        self.directory = tempfile.TemporaryDirectory()
        self.file = Path(self.directory.name) / "cameras.yaml"

    def tearDown(self):
        self.directory.cleanup()

    def write(self, cameras):
        self.file.write_text(yaml.safe_dump({"reference_frame": "odom", "cameras": cameras}), encoding="utf-8")

    def test_1_the_nodes_of_four_cameras(self):
        self.write({"front": {"place": place_of(CAMERAS[0])}, "rear": {"image": "/r/rgb", "camera_info": "/r/info"},
                    "side": None, "door": {"image": "/d/rgb", "camera_info": "/d/info", "frame": "lens",
                                           "place": place_of(CAMERAS[1])}})
        given = ["roslaunch", "--dump-params", "ros4hri", "two_cameras.launch", *launch_arguments(
            *read_cameras(self.file)), "voices:=false"]
        told = yaml.safe_load(subprocess.run(given, stdout=subprocess.PIPE, check=True).stdout)
        self.assertEqual(told["/hri_person_manager/reference_frame"], "odom")
        nodes = subprocess.run([given[0], "--nodes", *given[2:]], stdout=subprocess.PIPE, check=True).stdout.decode()
        for name in ("front", "rear", "side", "door"):
            self.assertIn("/{}/hri_faces".format(name), nodes.split())
        self.assertEqual({name for name in nodes.split() if name.endswith("/place")}, {"/front/place", "/door/place"})
        line = subprocess.run([given[0], "--args", "/door/place", *given[2:]], stdout=subprocess.PIPE,
                              check=True).stdout.decode().split()
        line = line[[word.endswith("static_transform_publisher") for word in line].index(True) + 1:]
        self.assertTrue(np.allclose([float(value) for value in line[:7]], place_of(CAMERAS[1]), atol=1e-4), line)
        self.assertEqual(line[7:9], ["odom", "lens"])

    def test_2_a_file_that_is_none_says_what_is_wrong(self):
        for cameras, words in (({"one": None}, "two names or more"), ({"a": None, "b": {"topic": "/x"}}, "has topic"),
                               ({"a": None, "b": {"place": [1, 2, 3]}}, "place of camera b"),
                               ({"a b": None, "c": None}, "no ROS name")):
            self.write(cameras)
            with self.assertRaisesRegex(CameraFileError, words):
                read_cameras(self.file)

    def test_3_a_person_who_walks_tells_where_two_cameras_are(self):
        self.write({"left": {"place": place_of(CAMERAS[0])}, "right": None})
        process = subprocess.Popen(["rosrun", "ros4hri", "calibrate_cameras", str(self.file), "--seconds", "14",
                                    "--stature", str(STATURE)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            self.walk_until_over(process)
            said, errors = (text.decode() for text in process.communicate(timeout=40))
        finally:
            if process.poll() is None:
                process.kill()
        self.assertEqual(process.returncode, 0, errors)
        self.assertRegex(said, r"residual \d+\.\d+ px of \d+ points")
        found = yaml.safe_load(self.file.read_text(encoding="utf-8"))["cameras"]["right"]["place"]
        pose = Pose.from_quaternion(found[3:], found[:3])
        self.assertLessEqual(np.linalg.norm(pose.translation - CAMERAS[1].translation), 0.05)
        turn = np.linalg.norm(pose.inverse().compose(CAMERAS[1]).quaternion[:3])
        self.assertLessEqual(2.0 * math.asin(turn), math.radians(1.0))

    def walk_until_over(self, process):
        """Publish what two cameras see of somebody on an eight, until the process has written its result."""
        model, rng = CameraModel.from_fov(WIDTH, HEIGHT, HFOV), np.random.default_rng(3)
        ids = rospy.Publisher("/humans/bodies/tracked", IdsList, queue_size=1, latch=True)
        infos = [rospy.Publisher("/{}/camera_info".format(name), CameraInfo, queue_size=1)
                 for name in ("left", "right")]
        bodies = [rospy.Publisher("/humans/bodies/b{}/skeleton2d".format(name), Skeleton2D, queue_size=10)
                  for name in ("left", "right")]
        ids.publish(IdsList(ids=["bleft", "bright"]))
        rate, begin = rospy.Rate(12.0), rospy.get_time()
        while process.poll() is None and rospy.get_time() - begin < 60.0:
            now = rospy.Time.now()
            angle = 0.8 * (now.to_sec() - begin)
            middle = np.array([2.5 + math.cos(angle), 2.5 + 0.8 * math.sin(2.0 * angle), 0.0])
            for camera, name, info, body in zip(CAMERAS, ("left", "right"), infos, bodies):
                points = np.zeros((18, 3))
                for joint, place in JOINTS.items():
                    point = middle + STATURE * np.array(place) + rng.normal(0.0, NOISE_M, 3)
                    points[NAMES.index(joint)] = (*model.project(camera.inverse().apply(point[None]))[0], 0.9)
                header = Header(stamp=now, frame_id=name + "_optical_frame")
                info.publish(camera_info(WIDTH, HEIGHT, HFOV, header))
                body.publish(skeleton_to_msg(points, header, WIDTH, HEIGHT))
            rate.sleep()


if __name__ == "__main__":
    rospy.init_node("cameras_test")
    rostest.rosrun("ros4hri", "cameras", CamerasTest)
