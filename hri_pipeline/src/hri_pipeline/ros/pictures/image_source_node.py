"""The image_source node: any source of images as a ROS camera."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.pacing import Pacer
from hri_pipeline.core.pictures.image_sources import ImageSource, SourceError, is_live, open_source
from hri_pipeline.ros.conversions import bgr_to_image
from hri_pipeline.ros.diagnostics import OK
from hri_pipeline.ros.source_node import SourceNode


def camera_info(width: int, height: int, hfov: float, header: Header) -> CameraInfo:
    """Return the CameraInfo of an ideal camera with a horizontal field of view of `hfov` rad."""
    matrix = CameraModel.from_fov(width, height, hfov).matrix
    info = CameraInfo(header=header, width=width, height=height, distortion_model="plumb_bob", D=[0.0] * 5)
    info.K = matrix.ravel().tolist()
    info.R = np.eye(3).ravel().tolist()
    info.P = np.hstack([matrix, np.zeros((3, 1))]).ravel().tolist()
    return info


class ImageSourceNode(SourceNode[ImageSource]):
    """Publishes `image`, `camera_info`, `image/compressed` (while somebody listens) and `finished` (latched)."""

    FAULT = SourceError
    DOES = "showing"

    def __init__(self, settings: SimpleNamespace) -> None:
        self._image = rospy.Publisher("image", Image, queue_size=1)
        self._compressed = rospy.Publisher("image/compressed", CompressedImage, queue_size=1)
        # Small, and whoever pairs it with its image must not miss one while a processor is busy.
        self._info = rospy.Publisher("camera_info", CameraInfo, queue_size=10)
        self._published = 0
        self._sizes = (0, 0)
        self._since = time.monotonic()
        super().__init__(settings, is_live(settings.source), (self._image, self._compressed, self._info))

    def _open(self) -> ImageSource:
        return open_source(self._settings, self._notify)

    def _play(self, source: ImageSource) -> None:
        """Publish one source until its end."""
        self._await_subscriber()
        own_rate = source.live and self._settings.rate == 0.0
        pacer = Pacer(self._settings.rate if self._settings.rate > 0.0 else source.rate)
        self._published, self._since = 0, time.monotonic()
        start = time.monotonic()
        while not self._ended():
            if not source.live:
                self._stop.wait(pacer.wait(time.monotonic()))
            if self._ended() or not source.advance(time.monotonic() - start):
                return
            stamp = rospy.Time.now()
            now = time.monotonic()
            # A camera that is faster than wanted: leave images out; half a millisecond for its jitter.
            if source.live and not own_rate and pacer.wait(now) > 0.0005:
                continue
            pacer.done(now)
            self._publish(source, Header(stamp=stamp, frame_id=self._settings.frame_id))
            self._report(source)

    def _publish(self, source: ImageSource, header: Header) -> None:
        """Make the present image and publish it to whoever listens; each message is serialised once."""
        self._published += 1
        raw, compressed = self._image.get_num_connections() > 0, self._compressed.get_num_connections() > 0
        if raw or compressed or self._sizes == (0, 0):
            picture = source.image()
            if picture is None:
                self._notify("a damaged image of {} is left out".format(source.description))
                return
            self._sizes = (picture.shape[1], picture.shape[0])
            if raw:
                self._image.publish(bgr_to_image(picture, header))
            if compressed:
                self._publish_compressed(picture, header)
        self._info.publish(camera_info(self._sizes[0], self._sizes[1], math.radians(self._settings.hfov), header))

    def _publish_compressed(self, picture: np.ndarray, header: Header) -> None:
        good, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self._settings.jpeg_quality])
        if good:
            self._compressed.publish(CompressedImage(header=header, format="bgr8; jpeg compressed bgr8",
                                                     data=data.tobytes()))

    def _report(self, source: ImageSource) -> None:
        """Tell the diagnostics once a second how it goes."""
        passed = time.monotonic() - self._since
        if passed >= 1.0:
            self._diagnostics.set("source", OK, source.description, {
                "rate_hz": round(self._published / passed, 2), "width": self._sizes[0], "height": self._sizes[1],
                "subscribers": self._image.get_num_connections(),
                "subscribers_compressed": self._compressed.get_num_connections()})
            self._published, self._since = 0, time.monotonic()

    def _wanted(self) -> bool:
        return self._image.get_num_connections() + self._compressed.get_num_connections() > 0
