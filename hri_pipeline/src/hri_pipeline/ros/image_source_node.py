"""The image_source node: any source of images as a ROS camera."""

from __future__ import annotations

import math
import threading
import time
from types import SimpleNamespace
from typing import Optional

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Bool, Header

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.pacing import Pacer
from hri_pipeline.core.pictures.image_sources import ImageSource, SourceError, is_live, open_source
from hri_pipeline.core.pictures.source_parameters import EXIT
from hri_pipeline.ros.conversions import bgr_to_image
from hri_pipeline.ros.diagnostics import NodeDiagnostics
from hri_pipeline.ros.topic_release import release

LOOK_FOR_SUBSCRIBERS = 0.05


def camera_info(width: int, height: int, hfov: float, header: Header) -> CameraInfo:
    """Return the CameraInfo of an ideal camera with a horizontal field of view of `hfov` rad."""
    matrix = CameraModel.from_fov(width, height, hfov).matrix
    info = CameraInfo(header=header, width=width, height=height, distortion_model="plumb_bob", D=[0.0] * 5)
    info.K = matrix.ravel().tolist()
    info.R = np.eye(3).ravel().tolist()
    info.P = np.hstack([matrix, np.zeros((3, 1))]).ravel().tolist()
    return info


class ImageSourceNode:
    """Publishes `image`, `camera_info`, `image/compressed` (while somebody listens) and `finished` (latched).

    A camera or stream that is not there, or goes away, is tried again every `retry_period`; a file that
    cannot be read ends the node. Images and time stamps are made in one thread, the caller of spin().
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        self._settings = settings
        self._stop = threading.Event()
        self._source: Optional[ImageSource] = None
        self._image = rospy.Publisher("image", Image, queue_size=1)
        self._compressed = rospy.Publisher("image/compressed", CompressedImage, queue_size=1)
        self._info = rospy.Publisher("camera_info", CameraInfo, queue_size=1)
        self._finished = rospy.Publisher("finished", Bool, queue_size=1, latch=True)
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._published = 0
        self._sizes = (0, 0)
        self._since = time.monotonic()
        rospy.on_shutdown(self._stop.set)
        self._finished.publish(Bool(False))
        if not is_live(settings.source):
            # A file that cannot be read is reported at once, and ends the node.
            self._source = self._open()

    def spin(self) -> None:
        """Publish until the end of the source or of ROS. Raises SourceError for a file that cannot be read."""
        while not self._ended():
            try:
                if self._source is None:
                    self._source = self._open()
                rospy.loginfo("%s: showing %s", rospy.get_name(), self._source.description)
                self._play(self._source)
                break
            except SourceError as error:
                if self._source is not None:
                    self._source.close()
                    self._source = None
                if not is_live(self._settings.source):
                    raise
                rospy.logwarn("%s; next try in %g s", error, self._settings.retry_period)
                self._diagnostics.set("source", DiagnosticStatus.ERROR, str(error))
                self._stop.wait(self._settings.retry_period)
        if not self._ended():
            self._tell_the_end()

    def _open(self) -> ImageSource:
        try:
            return open_source(self._settings, self._notify)
        except SourceError as error:
            raise SourceError("{}: {}".format(rospy.get_name(), error)) from error

    def _play(self, source: ImageSource) -> None:
        """Publish one source until its end."""
        if self._settings.wait_for_subscriber:
            while not self._wanted() and not self._ended():
                self._stop.wait(LOOK_FOR_SUBSCRIBERS)
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
            self._diagnostics.set("source", DiagnosticStatus.OK, source.description, {
                "rate_hz": round(self._published / passed, 2), "width": self._sizes[0], "height": self._sizes[1],
                "subscribers": self._image.get_num_connections(),
                "subscribers_compressed": self._compressed.get_num_connections()})
            self._published, self._since = 0, time.monotonic()

    def _tell_the_end(self) -> None:
        """Say that the source has ended and stay, or leave, as the parameters say."""
        text = "{} has ended".format(self._source.description if self._source else self._settings.source)
        rospy.loginfo("%s: %s", rospy.get_name(), text)
        self._finished.publish(Bool(True))
        self._diagnostics.set("source", DiagnosticStatus.OK, text)
        if self._settings.at_end == EXIT:
            # The last messages are still on their way to the subscribers.
            self._stop.wait(0.5)
            return
        while not self._ended():
            self._stop.wait(1.0)

    def _wanted(self) -> bool:
        return self._image.get_num_connections() + self._compressed.get_num_connections() > 0

    def _ended(self) -> bool:
        return self._stop.is_set() or rospy.is_shutdown()

    def _notify(self, text: str) -> None:
        rospy.logwarn("%s: %s", rospy.get_name(), text)

    def close(self) -> None:
        """Stop publishing and let go of the source. May be called again."""
        self._stop.set()
        if self._source is not None:
            self._source.close()
            self._source = None
        self._diagnostics.close()
        for publisher in (self._image, self._compressed, self._info, self._finished):
            release(publisher)
