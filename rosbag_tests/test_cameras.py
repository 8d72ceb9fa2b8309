#!/usr/bin/env python3
"""cameras and calibrate_cameras: the nodes that a file starts, and the places that a simulated walker tells."""

import itertools
import math
import subprocess
import tempfile
import unittest
from pathlib import Path

import cv2
import numpy as np
import rospy
import rostest
import yaml
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from hri_msgs.msg import IdsList, Skeleton2D
from hri_person_manager.ros.cameras import CameraFileError, launch_arguments, read_cameras
from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.geometry import Pose
from hri_pipeline.ros.conversions import bgr_to_image, camera_info, skeleton_to_msg

JOINTS = {"left_eye": (0.03, 0.05, 0.936), "right_eye": (-0.03, 0.05, 0.936), "neck": (0.0, 0.0, 0.818),
          "left_hip": (0.08, 0.0, 0.53), "right_hip": (-0.08, 0.0, 0.53), "left_ankle": (0.08, 0.0, 0.039),
          "right_ankle": (-0.08, 0.0, 0.039), "left_wrist": (0.2, 0.1, 0.485), "right_wrist": (-0.2, 0.1, 0.485)}
STATURE, NOISE_M = 1.75, 0.01
BOARD = (7, 5, 0.12, 0.09)      # columns, rows, side of the squares and of the markers, m
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
        self.write({"front": {"place": place_of(CAMERAS[0])}, "rear": {"image": "/r/rgb", "camera_info": "/r/info",
                                                                        "image_rotation": 0},
                    "side": None, "door": {"image": "/d/rgb", "camera_info": "/d/info", "frame": "lens",
                                           "image_rotation": 270, "place": place_of(CAMERAS[1])}})
        given = ["roslaunch", "--dump-params", "ros4hri", "two_cameras.launch", *launch_arguments(
            *read_cameras(self.file)), "voices:=false"]
        told = yaml.safe_load(subprocess.run(given, stdout=subprocess.PIPE, check=True).stdout)
        self.assertEqual(told["/hri_person_manager/reference_frame"], "odom")
        for node in ("hri_faces", "hri_bodies"):
            self.assertEqual([told["/{}/{}/image_rotation".format(name, node)] for name in ("front", "rear", "door")],
                             ["auto", "0", "270"])
            self.assertEqual(told["/door/{}/up_frame".format(node)], "odom")
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
                               ({"a b": None, "c": None}, "no ROS name"),
                               ({"a": None, "b": {"image_rotation": 45}}, "image_rotation 45, wanted one of auto, 0")):
            self.write(cameras)
            with self.assertRaisesRegex(CameraFileError, words):
                read_cameras(self.file)
        self.file.write_text("cameras:\n  a: {}\n  b: {}\n  a: {image: /x}\n", encoding="utf-8")
        with self.assertRaisesRegex(CameraFileError, "the name a stands twice"):
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
        self.check_right(process, said, errors, CAMERAS[1])

    def test_4_a_board_tells_where_two_cameras_are(self):
        cameras = [looking((0.0, 0.0, 1.6), (1.3, 2.2, 1.2)), looking((2.6, 0.2, 1.9), (1.3, 2.2, 1.2))]
        self.write({"left": {"place": place_of(cameras[0])}, "right": None})
        process = subprocess.Popen(["rosrun", "ros4hri", "calibrate_cameras", str(self.file), "--seconds", "16",
                                    "--board", "{}x{},{},{}".format(*BOARD)],
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            self.show_board_until_over(process, cameras)
            said, errors = (text.decode() for text in process.communicate(timeout=40))
        finally:
            if process.poll() is None:
                process.kill()
        self.check_right(process, said, errors, cameras[1])

    def check_right(self, process, said, errors, true):
        """The command has ended well, and has written the place of the right camera."""
        self.assertEqual(process.returncode, 0, errors)
        self.assertRegex(said, r"residual \d+\.\d+ px of \d+ points")
        found = yaml.safe_load(self.file.read_text(encoding="utf-8"))["cameras"]["right"]["place"]
        pose = Pose.from_quaternion(found[3:], found[:3])
        self.assertLessEqual(np.linalg.norm(pose.translation - true.translation), 0.05, said)
        turn = np.linalg.norm(pose.inverse().compose(true).quaternion[:3])
        self.assertLessEqual(2.0 * math.asin(turn), math.radians(1.0), said)

    def show_board_until_over(self, process, cameras):
        """Publish pictures of a board that somebody moves about between two cameras, with noise of the sensor."""
        model, rng = CameraModel.from_fov(960, 720, 1.2), np.random.default_rng(4)
        noise = rng.normal(0.0, 4.0, (800, 1040)).astype(np.int16)
        columns, rows, square, marker = BOARD
        board = cv2.aruco.CharucoBoard((columns, rows), square, marker,
                                       cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
        drawn = cv2.copyMakeBorder(board.generateImage((100 * columns, 100 * rows)), 40, 40, 40, 40,
                                   cv2.BORDER_CONSTANT, value=255)
        scale = square / 100.0
        drawn_to_board = np.array([[scale, 0.0, -40.0 * scale], [0.0, scale, -40.0 * scale], [0.0, 0.0, 1.0]])
        infos = [rospy.Publisher("/{}/camera_info".format(name), CameraInfo, queue_size=1)
                 for name in ("left", "right")]
        images = [rospy.Publisher("/{}/image_raw".format(name), Image, queue_size=1) for name in ("left", "right")]
        rate, begin = rospy.Rate(6.0), rospy.get_time()
        for number in itertools.count():
            if process.poll() is not None or rospy.get_time() - begin > 60.0:
                break
            # Stamps run at a third of the time: a slow machine drops images, and that must not tear gaps.
            now = rospy.Time.from_sec(begin + number / 18.0)
            angle = 1.5 * number / 18.0
            middle = np.array([1.3 + 0.45 * math.cos(angle), 2.2 + 0.5 * math.sin(1.7 * angle),
                               1.2 + 0.3 * math.sin(1.3 * angle)])
            # Somebody behind the board holds it towards a point between the cameras that moves, too.
            held = looking((1.3 + 0.8 * math.sin(0.9 * angle), 0.0, 1.7 + 0.5 * math.cos(1.1 * angle)), middle)
            corner = middle - held.rotation @ np.array([columns * square / 2.0, rows * square / 2.0, 0.0])
            for camera, name, info, image in zip(cameras, ("left", "right"), infos, images):
                pose = camera.inverse().compose(Pose(held.rotation, corner))
                plane = np.column_stack([pose.rotation[:, :2], pose.translation])
                picture = cv2.warpPerspective(drawn, model.matrix @ plane @ drawn_to_board, (960, 720),
                                              flags=cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
                down, right = rng.integers(0, 80, 2)
                picture = cv2.add(picture, noise[down:down + 720, right:right + 960], dtype=cv2.CV_8U)
                header = Header(stamp=now, frame_id=name + "_optical_frame")
                info.publish(camera_info(960, 720, 1.2, header))
                image.publish(bgr_to_image(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), header))
            rate.sleep()

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
