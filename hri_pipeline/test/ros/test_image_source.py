#!/usr/bin/env python3
"""image_source on a video and a picture that this test writes: rate, calibration, compression, end, errors."""

import math
import os
import subprocess
import tempfile
import threading
import time
import unittest

import cv2
import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Bool

LIMIT = 20.0


class Listener:
    """Collects the messages of one topic."""

    def __init__(self, topic, kind):
        self.messages, self.arrivals, self._condition = [], [], threading.Condition()
        self.subscriber = rospy.Subscriber(topic, kind, self._on_message, queue_size=100, buff_size=2**24)

    def _on_message(self, message):
        with self._condition:
            self.messages.append(message)
            self.arrivals.append(time.monotonic())
            self._condition.notify_all()

    def wait(self, condition, limit=LIMIT):
        with self._condition:
            return self._condition.wait_for(lambda: condition(self.messages), limit)

    def close(self):
        self.subscriber.unregister()


class TestImageSource(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.nodes, self.listeners = [], []

    def tearDown(self):
        for node in self.nodes:
            if node.poll() is None:
                node.terminate()
                node.wait(LIMIT)
        for listener in self.listeners:
            listener.close()
        self.folder.cleanup()

    def path(self, name):
        return os.path.join(self.folder.name, name)

    def listen(self, topic, kind):
        self.listeners.append(Listener(topic, kind))
        return self.listeners[-1]

    def start(self, name, **parameters):
        """Start the node in the namespace of its name."""
        words = ["_{}:={}".format(key, value) for key, value in parameters.items()]
        node = subprocess.Popen(["rosrun", "hri_pipeline", "image_source", "__name:=" + name, "__ns:=/" + name] + words,
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self.nodes.append(node)
        return node

    def write_video(self, name, frames):
        writer = cv2.VideoWriter(self.path(name), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
        for number in range(frames):
            writer.write(np.full((48, 64, 3), 10 * number, np.uint8))
        writer.release()
        return self.path(name)

    def write_picture(self):
        cv2.imwrite(self.path("a.png"), np.full((48, 64, 3), 200, np.uint8))
        return self.path("a.png")

    def test_video_comes_complete_in_time_and_its_end_is_told(self):
        images = self.listen("/video/image", Image)
        infos = self.listen("/video/camera_info", CameraInfo)
        finished = self.listen("/video/finished", Bool)
        node = self.start("video", source=self.write_video("a.avi", 21), loop="false", fit="native", at_end="exit",
                          wait_for_subscriber="true", hfov="90.0", frame_id="eye")
        self.assertTrue(finished.wait(lambda seen: seen and seen[-1].data), "the end was not told")
        self.assertEqual(node.wait(LIMIT), 0)
        self.assertEqual([message.data for message in finished.messages], [False, True])
        self.assertEqual(len(images.messages), 21)
        first, last = images.messages[0], images.messages[-1]
        self.assertEqual((first.width, first.height, first.step, first.encoding), (64, 48, 192, "bgr8"))
        self.assertEqual(first.header.frame_id, "eye")
        self.assertLess(first.data[0], 5)
        self.assertGreater(last.data[0], 190)
        # 20 intervals at 20 Hz, by the stamps: an even rhythm without drift.
        self.assertAlmostEqual((last.header.stamp - first.header.stamp).to_sec(), 1.0, delta=0.1)
        info = infos.messages[-1]
        self.assertIn(info.header.stamp, [message.header.stamp for message in images.messages])
        self.assertAlmostEqual(info.K[0], 32.0 / math.tan(math.radians(45.0)), places=6)
        self.assertEqual((info.K[2], info.K[5], info.width, info.height), (32.0, 24.0, 64, 48))

    def test_compressed_is_made_on_demand(self):
        self.start("still", source=self.write_picture(), rate="20.0", width="64", height="48")
        infos = self.listen("/still/camera_info", CameraInfo)
        self.assertTrue(infos.wait(lambda seen: len(seen) > 2))
        status = self.listen("/diagnostics", DiagnosticArray)
        compressed = self.listen("/still/image/compressed", CompressedImage)
        self.assertTrue(compressed.wait(lambda seen: len(seen) > 2))
        picture = cv2.imdecode(np.frombuffer(compressed.messages[-1].data, np.uint8), cv2.IMREAD_COLOR)
        self.assertEqual(picture.shape, (48, 64, 3))
        self.assertTrue(status.wait(lambda seen: any(
            value.key == "subscribers_compressed" and value.value == "1"
            for message in seen for one in message.status for value in one.values)))

    def test_a_missing_file_ends_the_node_with_a_clear_line(self):
        node = self.start("missing", source="/nowhere/clip.mp4")
        output = node.communicate(timeout=LIMIT)[0].decode()
        self.assertEqual(node.returncode, 1)
        self.assertIn("/nowhere/clip.mp4 does not exist; give a video file", output)
        self.assertNotIn("Traceback", output)

    def test_a_missing_camera_is_told_and_tried_again(self):
        status = self.listen("/diagnostics", DiagnosticArray)
        node = self.start("camera", source="/dev/video99", retry_period="0.2")
        self.assertTrue(status.wait(lambda seen: any(
            "no camera /dev/video99" in one.message for message in seen for one in message.status)))
        self.assertIsNone(node.poll())

    def test_a_stream_that_breaks_off_is_opened_again(self):
        images = self.listen("/stream/image", Image)
        self.start("stream", source="file://" + self.write_video("b.avi", 5), retry_period="0.2", fit="native",
                   wait_for_subscriber="true")
        self.assertTrue(images.wait(lambda seen: len(seen) > 7), "it was not opened a second time")


if __name__ == "__main__":
    rospy.init_node("test_image_source")
    rostest.rosrun("hri_pipeline", "image_source", TestImageSource)
