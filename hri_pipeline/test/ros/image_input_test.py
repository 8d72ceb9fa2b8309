#!/usr/bin/env python3
"""The image input and the vision worker with images and camera_info of all sorts."""

import os
import subprocess
import threading
import time
import unittest
from unittest import mock

import cv2
import numpy as np
import rospy
import rostest
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from hri_pipeline.core.camera import Calibration
from hri_pipeline.ros import image_input as module
from hri_pipeline.ros import sensor_input
from hri_pipeline.ros.conversions import bgr_to_image, make_header
from hri_pipeline.ros.diagnostics import ERROR, OK, WARN, NodeDiagnostics
from hri_pipeline.ros.image_input import ImageInput
from hri_pipeline.ros.worker import VisionWorker
from hri_pipeline.testing import held_by, wait_for

BGR = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
K = [100.0, 0, 32, 0, 100.0, 24, 0, 0, 1]


def picture(stamp, **changes):
    message = bgr_to_image(BGR, make_header(stamp, "camera_optical"))
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def info(matrix=K, width=64, height=48, distortion=(0,) * 5, model="plumb_bob"):
    return CameraInfo(K=matrix, D=distortion, width=width, height=height, distortion_model=model)


class InputCase(unittest.TestCase):

    def setUp(self):
        self.images = self.advertise("image", Image)
        self.infos = self.advertise("camera_info", CameraInfo, latch=True)

    def advertise(self, name, kind, **arguments):
        publisher = rospy.Publisher(name, kind, queue_size=10, **arguments)
        self.addCleanup(publisher.unregister)
        return publisher

    def image_input(self, **arguments):
        image_input = ImageInput(**arguments)
        self.addCleanup(image_input.close)
        return image_input

    def send(self, image_input, message, publisher=None):
        """Publish and wait until the callback has stored it."""
        publisher = publisher or self.images
        wait_for(publisher.get_num_connections, 10, "the node listens")
        count = image_input.counts["received"]
        publisher.publish(message)
        wait_for(lambda: image_input.counts["received"] > count, 10, "the image is received")

    def calibrate(self, image_input, message):
        self.infos.publish(message)
        wait_for(lambda: image_input._camera.newest == message, 10, "camera_info is received")


class ImageInputTest(InputCase):

    def test_a_raw_image_is_not_copied_on_its_way(self):
        image_input = self.image_input()
        self.send(image_input, picture(1.0))
        self.assertIsInstance(image_input._message.data, memoryview)
        np.testing.assert_array_equal(image_input.next(5.0).bgr, BGR)

    def test_a_camera_that_is_away_is_told_once(self):
        for name, value in (("CALM_S", 0.2), ("LOG_PERIOD_S", 0.3)):
            self.addCleanup(setattr, sensor_input, name, getattr(sensor_input, name))
            setattr(sensor_input, name, value)
        image_input = self.image_input()
        with self.assertLogs("rosout", "WARNING") as log:
            for _ in range(3):
                wait_for(lambda: image_input.next(0.05) is None and image_input.status()[0] == ERROR, 10,
                         "silence is told")
            began = time.monotonic()
            wait_for(lambda: image_input.next(0.05) is None and time.monotonic() > began + 2.0, 10,
                     "time enough for more warnings")
            self.assertEqual(len(log.output), 1, log.output)
            self.assertEqual(image_input.status()[2]["images_arrive"], False)
            for is_first in (True, False):
                with self.assertLogs("rosout", "INFO") as again:
                    self.send(image_input, picture(rospy.get_time()))
                    self.assertIsNotNone(image_input.next(5))
                    rospy.loginfo("end")
                self.assertEqual(sum("comes in, after" in line for line in again.output), is_first, again.output)
                self.assertEqual(image_input.status()[2]["images_arrive"], True)
                wait_for(lambda: time.monotonic() > image_input._heard + 0.25, 5, "calm")
            wait_for(lambda: image_input.next(0.05) is None and len(log.output) == 2, 10, "the camera goes again")

    def other_transport(self, transport, name, kind, wanted):
        """A camera that sends under this name, with images of this kind, to a node that waits for `transport`."""
        mappings = {rospy.resolve_name(topic): rospy.resolve_name(name.partition("/")[0] + "/" + topic)
                    for topic in ("image", "image/compressed")}
        with mock.patch.dict(rospy.names.get_resolved_mappings(), mappings):
            image_input = self.image_input(transport=transport)
        text = "but {} is published; start with image_transport:={}".format(rospy.resolve_name(name), wanted)
        with self.assertLogs("rosout", "WARNING") as log:
            wait_for(lambda: image_input.next(0.05) is None and image_input.status()[0] == ERROR, 10, "silence")
            # The camera begins after it was told that none is there.
            self.advertise(name, kind)
            wait_for(lambda: image_input.next(0.05) is None and any(text in line for line in log.output), 20, text)
            began = time.monotonic()
            wait_for(lambda: image_input.next(0.05) is None and time.monotonic() > began + 2.0, 10, "time for more")
        self.assertEqual(sum(text in line for line in log.output), 1)
        self.assertIn(text, image_input.status()[1])

    def test_raw_images_where_compressed_ones_are_awaited_are_told(self):
        self.other_transport("compressed", "second/image", Image, "raw")

    def test_compressed_images_where_raw_ones_are_awaited_are_told(self):
        self.other_transport("raw", "third/image/compressed", CompressedImage, "compressed")

    def another_type(self, name, kind, mend):
        self.advertise(name, kind)
        mapping = {rospy.resolve_name("image"): rospy.resolve_name(name)}
        with mock.patch.dict(rospy.names.get_resolved_mappings(), mapping), self.assertLogs("rosout", "WARNING") as log:
            image_input = self.image_input()
            wait_for(lambda: image_input.next(0.05) is None and any(mend in line for line in log.output), 20, mend)
        self.assertIn(mend, image_input.status()[1])
        self.assertEqual(image_input.status()[0], ERROR)

    def test_a_topic_of_another_type_is_told(self):
        self.another_type("fourth/compressed", CompressedImage, "carries sensor_msgs/CompressedImage, not sensor_msgs/"
                          "Image: give {} with image_transport:=compressed".format(rospy.resolve_name("fourth")))
        self.another_type("fifth", CameraInfo, "carries sensor_msgs/CameraInfo, not sensor_msgs/Image: give a topic")

    def test_another_node_on_the_topic_is_not_heard_while_the_camera_sends(self):
        image_input = self.image_input()
        stamp, far = rospy.get_time(), 2000000000
        self.send(image_input, picture(stamp))
        self.assertIsNotNone(image_input.next(5))
        timer = rospy.Timer(rospy.Duration(0.1), lambda _: self.images.publish(picture(rospy.get_time())))
        self.addCleanup(timer.shutdown)
        other = subprocess.Popen(["rostopic", "pub", "-r", "20", "image", "sensor_msgs/Image",
                                  "{{header: {{stamp: {{secs: {}}}}}, width: 1, "
                                  "height: 1, step: 3, encoding: bgr8, data: [0, 0, 0]}}".format(far)],
                                 stdout=subprocess.DEVNULL)
        self.addCleanup(other.wait)
        self.addCleanup(other.kill)
        seen = []

        def told():
            frame = image_input.next(1)
            seen.append(None if frame is None else frame.bgr.shape)
            return "sends too, only" in image_input.status()[1]
        with self.assertLogs("rosout", "WARNING") as log:
            wait_for(told, 20, "the other one is told")
            wait_for(lambda: told() and any("sends too, only" in line for line in log.output), 10, "it is logged")
        for _ in range(10):
            told()
        self.assertEqual(set(seen), {BGR.shape})
        self.assertEqual((image_input.status()[0], image_input.counts["time_jumps"]), (WARN, 0))
        timer.shutdown()
        wait_for(lambda: image_input.next(0.5) is not None and image_input.status()[2]["time_jumps"] == 0
                 and image_input._last_stamp == far, 20,
                 "the other one is heard when the camera is silent")

    def test_an_image_with_its_camera(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        seconds = int(rospy.get_time())
        self.send(image_input, picture(seconds + 0.5))
        frame = image_input.next(5)
        np.testing.assert_array_equal(frame.bgr, BGR)
        self.assertEqual((frame.stamp, frame.header.frame_id), (seconds + 0.5, "camera_optical"))
        self.assertEqual(frame.header.stamp, rospy.Time(seconds, 500000000))
        self.assertEqual(frame.camera.calibration, Calibration.CALIBRATED)
        self.assertEqual(image_input.status()[0], OK)
        self.assertIsNone(image_input.next(0.01))

    def test_only_the_newest_is_kept(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        for stamp in (1.0, 2.0, 3.0):
            self.send(image_input, picture(stamp))
        self.assertEqual(image_input.next(5).stamp, 3.0)
        self.assertIsNone(image_input.next(0.01))
        self.assertEqual((image_input.counts["received"], image_input.counts["taken"]), (3, 1))

    def test_bad_images_are_told_and_the_next_good_one_is_taken(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        bad = [picture(1.0, encoding="32FC1"), picture(2.0, encoding=""), picture(3.0, width=0, height=0, step=0),
               picture(4.0, data=b""), picture(5.0, step=7), picture(6.0, height=4000000000)]
        for number, message in enumerate(bad):
            self.send(image_input, message)
            self.assertIsNone(image_input.next(0.01))
            level, text, values = image_input.status()
            self.assertEqual((level, values["unreadable"]), (ERROR, number + 1))
            self.assertIn(rospy.resolve_name("image"), text)
        self.send(image_input, picture(rospy.get_time()))
        self.assertIsNotNone(image_input.next(5))
        self.assertEqual(image_input.status()[0], OK)

    def test_compressed(self):
        compressed = self.advertise("image/compressed", CompressedImage)
        image_input = self.image_input(transport="compressed")
        self.calibrate(image_input, info())
        png = cv2.imencode(".png", BGR)[1].tobytes()

        def message(stamp, data, form="bgr8; png compressed bgr8"):
            return CompressedImage(header=make_header(stamp, "c"), format=form, data=data)

        self.send(image_input, message(1.0, png), compressed)
        np.testing.assert_array_equal(image_input.next(5).bgr, BGR)
        for broken in (message(2.0, png[:50]), message(3.0, b""), message(4.0, png, "16UC1; compressedDepth png")):
            self.send(image_input, broken, compressed)
            self.assertIsNone(image_input.next(0.01))
            self.assertEqual(image_input.status()[0], ERROR)
        self.send(image_input, message(5.0, png), compressed)
        self.assertEqual(image_input.next(5).stamp, 5.0)

    def test_zero_k_falls_back_by_name_and_recovers(self):
        image_input = self.image_input(fallback_hfov=np.pi / 2, fov_parameter="~fallback_fov")
        self.calibrate(image_input, info(matrix=[0.0] * 9))
        self.send(image_input, picture(1.0))
        camera = image_input.next(5).camera
        self.assertEqual(camera.calibration, Calibration.UNCALIBRATED)
        self.assertAlmostEqual(camera.matrix[0, 0], 32.0)
        level, text, _ = image_input.status()
        self.assertEqual(level, WARN)
        self.assertIn("K is all zero", text)
        self.assertIn(rospy.get_name() + "/fallback_fov = 1.571 rad", text)
        self.calibrate(image_input, info())
        self.send(image_input, picture(rospy.get_time()))
        with self.assertLogs("rosout", "INFO") as log:
            self.assertEqual(image_input.next(5).camera.calibration, Calibration.CALIBRATED)
        self.assertIn("calibrated from now on, focal length 100 px", log.output[-1])
        self.assertEqual(image_input.status()[0], OK)

    def test_rectified_images_go_by_the_projection_matrix(self):
        with mock.patch.object(module, "is_rectified", return_value=True) as is_rectified:
            image_input = self.image_input()
        is_rectified.assert_called_once_with(image_input.topic)
        calibration = info(distortion=(-0.3, 0.1, 0, 0, 0))
        for stamp, focal in ((1.0, 90.0), (2.0, 80.0)):
            calibration.P = [focal, 0, 30, 0, 0, focal, 20, 0, 0, 0, 1, 0]
            self.calibrate(image_input, calibration)
            self.send(image_input, picture(stamp))
            camera = image_input.next(5).camera
            np.testing.assert_allclose(camera.matrix, [[focal, 0, 30], [0, focal, 20], [0, 0, 1]])
            self.assertFalse(camera.distortion.any())

    def test_impossible_camera_infos(self):
        image_input = self.image_input()
        bad = [(info(matrix=[float("nan")] * 9), "not finite"), (info(matrix=[-1.0] + K[1:]), "positive"),
               (info(model="barrel"), "unknown distortion model"), (info(distortion=(1.0,)), "coefficients"),
               (info(matrix=[1e300] + K[1:]), "focal length"), (info(matrix=[1e-300] + K[1:]), "focal length"),
               (info(matrix=K[:2] + [1e6] + K[3:]), "principal point"), (info(width=2 ** 32 - 1), "image size"),
               (info(width=64, height=64), "another shape"), (info(matrix=[0.0] * 9, width=0, height=0), "all zero")]
        for number, (message, text) in enumerate(bad):
            self.calibrate_nan_safe(image_input, message)
            self.send(image_input, picture(1.0 + number))
            self.assertEqual(image_input.next(5).camera.calibration, Calibration.UNCALIBRATED)
            self.assertIn(text, image_input.status()[1])
            self.assertIn(rospy.resolve_name("camera_info"), image_input.status()[1])
            self.assertEqual(image_input.status()[0], WARN)
        self.calibrate(image_input, info(matrix=[200.0, 0, 64, 0, 200.0, 48, 0, 0, 1], width=128, height=96))
        self.send(image_input, picture(100.0))
        camera = image_input.next(5).camera
        self.assertEqual((camera.width, camera.height, camera.matrix[0, 0]), (64, 48, 100.0))
        self.assertIn("the calibration is scaled", image_input.status()[1])

    def test_a_calibration_of_another_resolution_than_it_says_is_scaled_and_told(self):
        image_input = self.image_input()
        self.calibrate(image_input, info(matrix=[200.0, 0, 80, 0, 200.0, 60, 0, 0, 1]))
        self.send(image_input, picture(1.0))
        camera = image_input.next(5).camera
        np.testing.assert_allclose(camera.matrix, [[80, 0, 32], [0, 80, 24], [0, 0, 1]])
        level, text, _ = image_input.status()
        self.assertEqual(level, WARN)
        self.assertIn("it is for 160x120 px by the principal point in K, but images are 64x48; the calibration is "
                      "scaled", text)

    def test_an_image_without_stamp_has_the_time_of_its_arrival_however_late_it_is_taken(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        for _ in range(2):
            before = rospy.get_time()
            self.send(image_input, picture(0.0))
            after = rospy.get_time()
            wait_for(lambda after=after: rospy.get_time() > after + 0.2, 5, "a worker that is busy")
            frame = image_input.next(5)
            self.assertTrue(before <= frame.stamp <= after, (before, frame.stamp, after))
            self.assertEqual(frame.header.stamp.to_sec(), frame.stamp)

    def test_the_calibration_of_another_frame_is_told_and_used(self):
        image_input = self.image_input()
        for given, words in (("depth_optical", "it is of the frame 'depth_optical', images are in 'camera_optical'"),
                             ("/camera_optical", ""), ("", "")):
            message = info()
            message.header.frame_id = given
            self.calibrate(image_input, message)
            self.send(image_input, picture(rospy.get_time()))
            self.assertEqual(image_input.next(5).camera.calibration, Calibration.CALIBRATED)
            level, text, _ = image_input.status()
            self.assertEqual(level, WARN if words else OK, text)
            self.assertIn(words, text)

    def test_the_calibration_of_the_images_own_sender_goes_before_that_of_others(self):
        image_input = self.image_input()
        other = subprocess.Popen(["rostopic", "pub", "-r", "50", "camera_info", "sensor_msgs/CameraInfo",
                                  "{width: 64, height: 48, K: [300, 0, 32, 0, 300, 24, 0, 0, 1]}"],
                                 stdout=subprocess.DEVNULL)
        self.addCleanup(other.wait)
        self.addCleanup(other.kill)

        def focal():
            self.send(image_input, picture(rospy.get_time()))
            return image_input.next(5).camera.matrix[0, 0]
        wait_for(lambda: focal() == 300.0, 20, "what another node tells is used where there is nothing else")
        self.infos.publish(info())
        wait_for(lambda: focal() == 100.0, 10, "the camera's own is used")
        heard = []
        self.addCleanup(rospy.Subscriber("camera_info", CameraInfo, heard.append).unregister)
        wait_for(lambda: sum(message.K[0] == 300.0 for message in heard) > 5, 20, "the other one goes on")
        self.assertEqual({focal() for _ in range(5)}, {100.0})

    def test_an_image_has_the_camera_info_of_its_own_time_and_a_new_focal_length_is_told_once(self):
        """The newest one is of a later image where a machine is busy: in a zoom all distances were wrong."""
        image_input, start = self.image_input(), rospy.get_time()
        with self.assertLogs("rosout", "INFO") as log:
            for number, focal in enumerate((100.0, 120.0, 150.0)):
                told = info([focal, 0, 32, 0, focal, 24, 0, 0, 1])
                told.header = make_header(start + 0.1 * number, "camera_optical")
                self.calibrate(image_input, told)
            seen = []
            for number in range(3):
                self.send(image_input, picture(start + 0.1 * number + 0.01))
                seen.append(image_input.next(5).camera.matrix[0, 0])
            self.send(image_input, picture(start + 60.0))
            seen.append(image_input.next(5).camera.matrix[0, 0])
        self.assertEqual(seen, [100.0, 120.0, 150.0, 150.0])
        lines = [line for line in log.output if "focal length" in line]
        self.assertEqual(len(lines), 1, lines)
        self.assertIn("120 px from now on, before 100 px", lines[0])

    def calibrate_nan_safe(self, image_input, message):
        old = image_input._camera.newest
        self.infos.publish(message)
        wait_for(lambda: image_input._camera.newest is not old, 10, "camera_info is received")

    def test_no_camera_info_at_all(self):
        self.infos.unregister()
        image_input = self.image_input()
        self.send(image_input, picture(1.0))
        self.assertEqual(image_input.next(5).camera.calibration, Calibration.MISSING)
        level, text, _ = image_input.status()
        self.assertEqual(level, WARN)
        self.assertIn("no camera_info on " + rospy.resolve_name("camera_info"), text)

    def test_the_first_image_waits_for_its_camera_info(self):
        self.infos.unregister()
        image_input = self.image_input()
        self.send(image_input, picture(1.0))
        frames = []
        worker = threading.Thread(target=lambda: frames.append(image_input.next(5)))
        worker.start()
        late = self.advertise("camera_info", CameraInfo, latch=True)
        late.publish(info())
        worker.join(10)
        self.assertEqual(frames[0].camera.calibration, Calibration.CALIBRATED)

    def test_nobody_publishes(self):
        self.images.unregister()
        image_input = self.image_input()
        wait_for(lambda: image_input.status()[0] == ERROR, 10, "silence is told")
        self.assertIn("no publisher on " + rospy.resolve_name("image"), image_input.status()[1])
        self.assertIn("start the camera or remap `image`", image_input.status()[1])
        self.images = self.advertise("image", Image)
        wait_for(lambda: "although it has a publisher" in image_input.status()[1], 10, "the publisher is seen")
        self.send(image_input, picture(1.0))
        self.assertNotEqual(image_input.status()[0], ERROR)

    def test_time(self):
        jumps = []
        image_input = self.image_input(on_restart=lambda: jumps.append(1))
        self.calibrate(image_input, info())
        taken = []
        for stamp in (100.0, 100.0, 99.5, 101.0, 20.0, 20.1):
            self.send(image_input, picture(stamp))
            frame = image_input.next(0.01)
            taken.append(frame and frame.stamp)
        self.assertEqual(taken, [100.0, None, None, 101.0, 20.0, 20.1])
        self.assertEqual(len(jumps), 1)
        self.assertEqual((image_input.counts["late"], image_input.counts["time_jumps"]), (2, 1))

    def test_tracks_start_anew_with_images_of_another_size(self):
        restarts = []
        image_input = self.image_input(on_restart=lambda: restarts.append(image_input.counts["taken"]))
        self.calibrate(image_input, info())
        small = bgr_to_image(np.ascontiguousarray(BGR[::2, ::2]), make_header(0.0, "camera_optical"))
        with self.assertLogs("rosout", "WARNING") as log:
            for number, message in enumerate((picture(0.0), picture(0.0), small, small, picture(0.0))):
                message.header.stamp = rospy.Time.from_sec(rospy.get_time())
                self.send(image_input, message)
                self.assertEqual(image_input.next(5).bgr.shape[1], message.width)
                self.assertEqual("px now, before" in image_input.status()[1], number > 1, number)
        self.assertEqual(restarts, [2, 4])
        told = [line for line in log.output if "images are 32x24 px now, before 64x48" in line]
        self.assertEqual(len(told), 1, log.output)
        self.assertEqual((image_input.status()[0], image_input.counts["size_changes"]), (WARN, 2))

    def test_an_image_is_overtaken_when_one_of_long_before_has_come_or_the_clock_has_gone_back(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        for newer, overtaken in ((100.1, False), (99.5, False), (20.0, True)):
            image_input._last_stamp = None
            self.send(image_input, picture(100.0))
            frame = image_input.next(5)
            self.assertFalse(frame.overtaken())
            self.send(image_input, picture(newer))
            self.assertEqual(frame.overtaken(), overtaken, newer)
            image_input.next(0.01)
        self.send(image_input, picture(100.0))
        frame = image_input.next(5)
        with mock.patch.object(module.rospy, "get_time", return_value=rospy.get_time() - 10.0):
            self.assertTrue(frame.overtaken())

    def test_stamps_that_run_ahead_of_the_time_are_told(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        self.settle(0.0)
        with self.assertLogs("rosout", "WARNING") as log:
            for stamp in (100.0, 100.5, 110.5):
                self.send(image_input, picture(stamp))
                self.assertEqual(image_input.next(5).stamp, stamp)
        ahead = [line for line in log.output if "have gone forward by" in line]
        self.assertEqual((len(ahead), image_input.counts["forward_jumps"]), (1, 1), log.output)
        self.assertIn(image_input.topic, ahead[0])

    def settle(self, seconds):
        self.addCleanup(setattr, module, "_SETTLED_S", module._SETTLED_S)
        module._SETTLED_S = seconds

    def test_images_that_are_in_time_after_late_ones_are_no_jump(self):
        self.addCleanup(setattr, module, "JUMP_S", module.JUMP_S)
        module.JUMP_S = 0.2
        image_input = self.image_input()
        self.calibrate(image_input, info())
        for settled, lags in ((10.0, (4.0, 0.0)), (0.0, (0.0, 0.5, 0.0))):
            self.settle(settled)
            image_input._last_stamp = None
            for lag in lags:
                time.sleep(0.6)
                self.send(image_input, picture(rospy.get_time() + 100.0 - lag))
                self.assertIsNotNone(image_input.next(5), lag)
        self.assertEqual(image_input.counts["forward_jumps"], 0)

    def test_a_pause_of_the_camera_is_no_jump(self):
        self.addCleanup(setattr, module, "JUMP_S", module.JUMP_S)
        module.JUMP_S = 0.1
        self.settle(0.0)
        image_input = self.image_input()
        self.calibrate(image_input, info())
        for _ in range(2):
            self.send(image_input, picture(rospy.get_time()))
            self.assertIsNotNone(image_input.next(5))
            wait_for(lambda: time.monotonic() > image_input._heard + 0.5, 5, "a pause")
        self.assertEqual(image_input.counts["forward_jumps"], 0)

    def test_an_image_that_waits_for_its_camera_info_is_no_jump(self):
        self.addCleanup(setattr, module, "JUMP_S", module.JUMP_S)
        module.JUMP_S = 0.25
        self.settle(0.0)
        image_input = self.image_input()
        wait_for(self.images.get_num_connections, 10, "the node listens")      # before the first stamp is taken
        for _ in range(2):
            self.send(image_input, picture(rospy.get_time()))
            self.assertIsNotNone(image_input.next(5))
        self.assertEqual(image_input.counts["forward_jumps"], 0)

    def test_frames_of_images(self):
        restarts = []
        image_input = self.image_input(on_restart=lambda: restarts.append(image_input.counts["taken"]))
        self.calibrate(image_input, info())
        for stamp, given, used, words in (
                (1.0, "/eye_optical", "eye_optical", "begins with a slash"), (1.1, "eye_optical", "eye_optical", ""),
                (1.2, "other_optical", "other_optical", "before in 'eye_optical'")):
            with self.assertLogs("rosout", "WARNING") as log:
                self.send(image_input, picture(stamp, header=make_header(stamp, given)))
                self.assertEqual(image_input.next(5).header.frame_id, used)
                rospy.logwarn("the end")
            told = [line for line in log.output if "frame" in line]
            self.assertEqual([words in line and image_input.topic in line for line in told], [True] if words else [])
        self.assertIn("images are in the frame 'other_optical' now", image_input.status()[1])
        self.assertEqual(restarts, [2], "what was seen by another camera is elsewhere")

    def test_a_camera_whose_stamp_stands_still_is_told(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        stamp = rospy.get_time()
        self.send(image_input, picture(stamp))
        self.assertIsNotNone(image_input.next(5))

        def told():
            self.send(image_input, picture(stamp))
            image_input.next(0.05)
            return image_input.status()[0] == ERROR and "newer stamp" in image_input.status()[1]
        wait_for(told, 10, "the stamp is told")
        self.send(image_input, picture(stamp + 1.0))
        self.assertIsNotNone(image_input.next(5))
        self.assertEqual(image_input.status()[0], OK)

    def test_images_that_show_nothing_are_told(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        with mock.patch.object(module, "_BLANK_PERIOD_S", 0.0):
            for value in (0, None, 255, None, 128):
                for number in range(3):
                    bgr = BGR if value is None else np.full_like(BGR, value)
                    self.send(image_input, bgr_to_image(bgr, make_header(rospy.get_time(), "camera_optical")))
                    self.assertIsNotNone(image_input.next(5))
                    level, text, _ = image_input.status()
                    told = value is not None and number > 0     # a flash is nobody's fault
                    self.assertEqual((level, "shows nothing" in text), (WARN, True) if told else (OK, False), text)

    def test_images_without_stamp_get_the_time_of_arrival(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        stamps = []
        for _ in range(3):
            self.send(image_input, picture(0.0))
            stamps.append(image_input.next(5).stamp)
        self.assertTrue(0 < stamps[0] < stamps[1] < stamps[2])
        level, text, _ = image_input.status()
        self.assertEqual(level, WARN)
        self.assertIn(image_input.topic + ": images have no stamp", text)

    def test_stamps_far_from_now_are_told_and_taken_all_the_same(self):
        for ahead, words in ((-60.0, "60.0 s old"), (60.0, "60.0 s in the future"), (-0.5, "")):
            image_input = self.image_input()
            self.calibrate(image_input, info())
            self.send(image_input, picture(rospy.get_time() + ahead))
            self.assertIsNotNone(image_input.next(5))
            level, text, _ = image_input.status()
            self.assertEqual(level, WARN if words else OK, text)
            if words:
                self.assertIn("{}: images are {}".format(image_input.topic, words), text)

    def test_stamps_of_simulated_time_are_told_with_the_remedy(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        self.send(image_input, picture(3.5))
        self.assertIsNotNone(image_input.next(5))
        self.assertIn("stamped by simulated time (3.5 s)", image_input.status()[1])
        self.assertIn("rosparam set /use_sim_time true", image_input.status()[1])

    def test_the_first_image_of_a_bag_that_begins_anew_is_not_told_as_old_before_the_clock_has_followed(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        for ahead, level in ((-0.5, OK), (-60.0, OK), (-59.9, WARN)):
            self.send(image_input, picture(rospy.get_time() + ahead))
            self.assertIsNotNone(image_input.next(5))
            self.assertEqual(image_input.status()[0], level, image_input.status()[1])

    def test_close(self):
        before = held_by(os.getpid()).descriptors
        for _ in range(20):
            image_input = ImageInput()
            image_input.close()
            image_input.close()
            self.assertIsNone(image_input.next(5))
        self.assertLessEqual(held_by(os.getpid()).descriptors, before + 3)
        with self.assertRaises(ValueError):
            ImageInput(transport="theora")
        with self.assertRaises(ValueError):
            ImageInput(fallback_hfov=0.0)


class Recorder:
    """A branch that notes what is asked of it and fails where it is told to."""

    def __init__(self, fail_at=()):
        self.name = "recorder"
        self.fail_at = fail_at
        self.stamps, self.resets, self.closes = [], 0, 0

    def process(self, frame, context):
        self.stamps.append(frame.stamp)
        with context["times"]("inner"):
            context["faces"] = ["a face"]
        if frame.stamp in self.fail_at:
            raise ZeroDivisionError("on purpose")

    def status(self):
        return OK, "recording", {}

    def reset(self):
        self.resets += 1

    def close(self):
        self.closes += 1


class Second(Recorder):
    """Stands behind the recorder and needs its result."""

    def process(self, frame, context):
        self.stamps.append((frame.stamp, context.get("faces")))


class VisionLoopTest(InputCase):

    def test_a_failing_branch_loses_one_image_only(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        first, second = Recorder(fail_at=(2.0, 3.0)), Second()
        second.name = "second"
        diagnostics = NodeDiagnostics("loop")
        loop = VisionWorker(image_input, [first, second], diagnostics)
        thread = threading.Thread(target=loop.spin)
        thread.start()
        for stamp in (1.0, 2.0, 3.0, 4.0):
            self.send(image_input, picture(stamp))
            wait_for(lambda stamp=stamp: second.stamps and second.stamps[-1][0] == stamp, 10, "the image is through")
        self.assertEqual(first.stamps, [1.0, 2.0, 3.0, 4.0])
        self.assertEqual(second.stamps[0], (1.0, ["a face"]))
        level, text, values = loop._pipeline()
        self.assertEqual((level, values["errors_recorder"], text), (
            ERROR, 2, "recorder: ZeroDivisionError: on purpose"))
        self.assertIn("inner_ms_p95", values)
        self.assertEqual(values["dropped_images"], 0)
        loop._ages.clear()
        loop._ages.extend((0.3, 0.1))
        values = loop._pipeline()[2]
        self.assertEqual([round(values["age_ms_" + name]) for name in ("median", "p95")], [200, 290])
        wait_for(lambda: set(diagnostics._tasks) == {"input", "pipeline", "recorder", "second"}, 5,
                 "all tasks are told")
        self.send(image_input, picture(0.5))
        wait_for(lambda: first.resets == second.resets == 1, 10, "time went back")
        loop.close()
        loop.close()
        thread.join(10)
        self.assertFalse(thread.is_alive())
        self.assertEqual((first.closes, second.closes), (1, 1))

    def test_nobody_stays_tracked_when_the_camera_is_gone(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        branch = Recorder()
        loop = VisionWorker(image_input, [branch], NodeDiagnostics("loop"), silence=0.6)
        thread = threading.Thread(target=loop.spin)
        thread.start()
        # Later than what the test before may have left on the way.
        for count, stamp in enumerate((100.0, 200.0), 1):
            self.send(image_input, picture(stamp))
            wait_for(lambda stamp=stamp, count=count: branch.stamps[-1:] == [stamp] and branch.resets == count,
                     10, "the branch is reset, once for each silence")
        loop.close()
        thread.join(10)

    def test_max_rate(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        branch = Recorder()
        loop = VisionWorker(image_input, [branch], NodeDiagnostics("loop"), max_rate=2.0)
        thread = threading.Thread(target=loop.spin)
        thread.start()
        for number in range(40):
            self.send(image_input, picture(1.0 + 0.025 * number))
        count = len(branch.stamps)
        loop.close()
        thread.join(10)
        self.assertTrue(1 <= count <= 4, count)
        self.assertEqual(branch.resets, 0)
        with self.assertRaises(ValueError):
            VisionWorker(image_input, [], NodeDiagnostics("loop"), max_rate=-1.0)

    def test_an_image_that_is_due_is_not_kept_waiting_for_another(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        wanted = [True, False, True]
        came = []

        def is_due(arrival):
            came.append(arrival)
            return wanted[len(came) - 1]

        stamps = []
        thread = threading.Thread(target=lambda: stamps.extend(
            image_input.next(20.0, is_due).stamp for _ in range(2)))
        thread.start()
        for count, stamp in enumerate((300.0, 300.25, 300.5), 1):
            self.send(image_input, picture(stamp))
            wait_for(lambda count=count: len(came) == count, 10, "the image is judged")
        thread.join(10)
        self.assertEqual(stamps, [300.0, 300.5])
        self.assertEqual(came, sorted(came))

    def test_after_an_image_that_cannot_be_read_the_next_one_is_taken_before_it_is_due(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        self.send(image_input, picture(320.0, encoding=""))
        self.assertIsNone(image_input.next(0.0, lambda arrival: True))
        self.send(image_input, picture(320.1))
        self.assertEqual(image_input.next(0.0, lambda arrival: False).stamp, 320.1)
        self.send(image_input, picture(320.2))
        self.assertIsNone(image_input.next(0.0, lambda arrival: False))

    def test_people_stay_between_two_images_of_a_low_rate(self):
        image_input = self.image_input()
        self.calibrate(image_input, info())
        branch = Recorder()
        loop = VisionWorker(image_input, [branch], NodeDiagnostics("loop"), silence=0.3, max_rate=0.8)
        thread = threading.Thread(target=loop.spin)
        thread.start()
        number, began = 0, time.monotonic()
        while len(branch.stamps) < 3:
            self.send(image_input, picture(400.0 + 0.01 * number))
            number += 1
            self.assertLess(time.monotonic(), began + 20.0, "images are not taken")
        self.assertEqual(branch.resets, 0)
        loop.close()
        thread.join(10)


def suite():
    """Both cases; the limits for silence and grace are shorter than on a robot."""
    sensor_input.SILENCE_S, module.INFO_GRACE_S = 0.6, 0.5
    load = unittest.defaultTestLoader.loadTestsFromTestCase
    return unittest.TestSuite([load(ImageInputTest), load(VisionLoopTest)])


if __name__ == "__main__":
    rospy.init_node("image_input_test")
    rostest.rosrun("hri_pipeline", "image_input", "image_input_test.suite")
