"""A camera for the tests that shows a demonstration photograph or black images."""

import threading

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.ros.conversions import bgr_to_image

FRAME = "test_camera_optical"
_WIDTH = 960
_RATE = 6.0


def photograph(number):
    """Return sample<number>.jpg of the demonstration pictures, 960 px wide."""
    path = models_directory() / "demo" / "sample{}.jpg".format(number)
    image = cv2.imread(str(path))
    if image is None:
        raise AssertionError("{} is missing: run `rosrun hri_pipeline fetch_models`".format(path))
    return cv2.resize(image, (_WIDTH, _WIDTH * image.shape[0] // image.shape[1]), interpolation=cv2.INTER_AREA)


class DemoCamera:
    """Publishes one picture as image and camera_info again and again until close()."""

    def __init__(self, picture):
        self.stamps = set()
        self._picture = picture
        self._image = rospy.Publisher("image", Image, queue_size=1)
        self._info = rospy.Publisher("camera_info", CameraInfo, queue_size=1)
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def show(self, picture):
        """Show another picture; None: send nothing."""
        self._picture = picture

    def show_black(self):
        """Show black images."""
        self.show(np.zeros_like(self._picture))

    def close(self):
        """Stop."""
        self._closed.set()
        self._thread.join()

    def _run(self):
        while not self._closed.wait(1.0 / _RATE):
            picture = self._picture
            if picture is None:
                continue
            header = Header(stamp=rospy.Time.now(), frame_id=FRAME)
            height, width = picture.shape[:2]
            matrix = CameraModel.from_fov(width, height, 1.05).matrix
            info = CameraInfo(header=header, width=width, height=height, distortion_model="plumb_bob", D=[0.0] * 5)
            info.K = matrix.ravel().tolist()
            self.stamps.add(header.stamp)
            self._info.publish(info)
            self._image.publish(bgr_to_image(picture, header))
