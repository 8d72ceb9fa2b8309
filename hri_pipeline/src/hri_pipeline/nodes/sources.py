"""The image_source and sound_source nodes: files and devices as a ROS camera and as audio_common_msgs.

What both have in common: a device is tried again, a file that cannot be read ends the node, and the end of a file is
told.
"""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from typing import Generic, Optional, Sequence, Type, TypeVar, Union

import cv2
import numpy as np
import rospy
from audio_common_msgs.msg import AudioData, AudioInfo
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Bool, Header

from hri_pipeline.core.audio.level import SoundLevel
from hri_pipeline.core.audio.stream import encode_s16
from hri_pipeline.core.error_log import Outage
from hri_pipeline.core.sources import image_sources, sound_sources
from hri_pipeline.core.sources.image_sources import ImageSource, SourceError, open_source
from hri_pipeline.core.sources.parameters import EXIT, ImageSourceSettings, SoundSourceSettings
from hri_pipeline.core.sources.sound_sources import SoundSource, SoundSourceError, open_sound_source
from hri_pipeline.core.timing import EARLY, Pacer, StampPacer
from hri_pipeline.ros.conversions import bgr_to_image, camera_info
from hri_pipeline.ros.diagnostics import ERROR, OK, NodeDiagnostics
from hri_pipeline.ros.rospy_compat import release

LOOK_FOR_SUBSCRIBERS_S = 0.05
# A device that has played for so long is told again when it goes.
_CALM_S = 10.0
# A device that fails sooner was not there, although it could be opened.
_AT_ONCE_S = 1.0
# What subscribers need to read the last messages before the connection is closed.
_FAREWELL_S = 0.5

Source = TypeVar("Source")


class SourceNode(ABC, Generic[Source]):
    """Publishes `finished` (latched); a subclass says how its source is opened and played.

    A device that is not there, or goes away, is tried again every `retry_period`; a file that cannot be read ends the
    node. A source has close() and a `description`, and raises FAULT. All is read and sent in one thread, the caller of
    spin().
    """

    FAULT: Type[Exception] = Exception
    DOES = "playing"

    def __init__(self, settings: Union[ImageSourceSettings, SoundSourceSettings], live: bool,
                 publishers: Sequence[rospy.Publisher]) -> None:
        """live: the source is a device. Takes over the publishers. Raises FAULT for a file that cannot be read."""
        self._settings, self._live = settings, live
        self._stop = threading.Event()
        self._source: Optional[Source] = None
        self._finished = rospy.Publisher("finished", Bool, queue_size=1, latch=True)
        self._publishers = (*publishers, self._finished)
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._tries = 0
        self._outage, self._told = Outage(_CALM_S), ""
        self._began, self._failed_at_once = 0.0, False
        rospy.on_shutdown(self._stop.set)
        self._finished.publish(Bool(False))
        if not live:
            # A file that cannot be read is reported at once, and ends the node.
            self._source = self._opened()

    def spin(self) -> None:
        """Play until the end of the source or of ROS. Raises FAULT for a file that cannot be read."""
        while not self._ended():
            try:
                if self._source is None:
                    self._source = self._opened()
                self._began = time.monotonic()
                self._outage.there(self._began)
                if not self._failed_at_once:
                    rospy.loginfo("%s: %s %s", rospy.get_name(), self.DOES, self._source.description)
                self._play(self._source)
                break
            except self.FAULT as error:
                now = time.monotonic()
                if self._source is not None:
                    self._outage.there(now)
                self._failed_at_once = self._source is not None and now - self._began < _AT_ONCE_S
                self._drop_source()
                if not self._live:
                    raise
                self._tries += 1
                self._tell(str(error))
                self._diagnostics.set("source", ERROR, str(error), {"tries": self._tries})
                self._stop.wait(self._settings.retry_period)
        if not self._ended():
            self._tell_the_end()

    def close(self) -> None:
        """Stop and let go of the source. May be called again."""
        self._stop.set()
        self._drop_source()
        self._diagnostics.close()
        for publisher in self._publishers:
            release(publisher)

    @abstractmethod
    def _open(self) -> Source:
        """Open the source that the settings name. Raises FAULT in one sentence that names it and the mend."""

    @abstractmethod
    def _play(self, source: Source) -> None:
        """Publish one source until its end, or until _ended()."""

    @abstractmethod
    def _wanted(self) -> bool:
        """Tell whether somebody listens."""

    def _await_subscriber(self) -> None:
        """Wait for somebody who listens, where the settings ask for that."""
        while self._settings.wait_for_subscriber and not self._wanted() and not self._ended():
            self._stop.wait(LOOK_FOR_SUBSCRIBERS_S)

    def _ended(self) -> bool:
        return self._stop.is_set() or rospy.is_shutdown()

    def _notify(self, text: str) -> None:
        rospy.logwarn("%s: %s", rospy.get_name(), text)

    def _tell(self, fault: str) -> None:
        """Log why the device does not play: once while it stays away, and where the reason is another one."""
        if self._outage.is_to_tell() or fault != self._told:
            self._told = fault
            rospy.logwarn("%s; trying again every %g s", fault, self._settings.retry_period)

    def _opened(self) -> Source:
        try:
            return self._open()
        except self.FAULT as error:
            raise self.FAULT("{}: {}".format(rospy.get_name(), error)) from error

    def _drop_source(self) -> None:
        if self._source is not None:
            self._source.close()
            self._source = None

    def _tell_the_end(self) -> None:
        """Say that the source has ended and stay, or leave, as the parameters say."""
        text = "{} has ended".format(self._source.description if self._source else self._settings.source)
        rospy.loginfo("%s: %s", rospy.get_name(), text)
        self._finished.publish(Bool(True))
        self._diagnostics.set("source", OK, text)
        if self._settings.at_end == EXIT:
            self._stop.wait(_FAREWELL_S)
            return
        while not self._ended():
            self._stop.wait(1.0)


class ImageSourceNode(SourceNode[ImageSource]):
    """Publishes `image`, `camera_info`, `image/compressed` (while somebody listens) and `finished` (latched)."""

    FAULT = SourceError
    DOES = "showing"

    def __init__(self, settings: ImageSourceSettings) -> None:
        self._image = rospy.Publisher("image", Image, queue_size=1)
        self._compressed = rospy.Publisher("image/compressed", CompressedImage, queue_size=1)
        # Small, and whoever pairs it with its image must not miss one while a processor is busy.
        self._info = rospy.Publisher("camera_info", CameraInfo, queue_size=10)
        self._published = 0
        self._sizes = (0, 0)
        self._since = time.monotonic()
        super().__init__(settings, image_sources.is_live(settings.source), (self._image, self._compressed, self._info))

    def _open(self) -> ImageSource:
        return open_source(self._settings, self._notify)

    def _play(self, source: ImageSource) -> None:
        """Publish one source until its end."""
        self._await_subscriber()
        pacer = Pacer(self._settings.rate if self._settings.rate > 0.0 else source.rate)
        wanted = StampPacer(self._settings.rate if source.live else 0.0, EARLY)
        self._published, self._since = 0, time.monotonic()
        start = time.monotonic()
        while not self._ended():
            if not source.live:
                self._stop.wait(pacer.wait(time.monotonic()))
            if self._ended() or not source.advance(time.monotonic() - start):
                return
            stamp = rospy.Time.now()
            now = time.monotonic()
            if not wanted.is_due(now):      # a camera that is faster than wanted
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


_QUEUE = 100


class SoundSourceNode(SourceNode[SoundSource]):
    """Publishes `audio`, `audio_info` (latched) and `finished` (latched)."""

    FAULT = SoundSourceError

    def __init__(self, settings: SoundSourceSettings) -> None:
        self._audio = rospy.Publisher("audio", AudioData, queue_size=_QUEUE)
        self._info = rospy.Publisher("audio_info", AudioInfo, queue_size=1, latch=True)
        self._sent = 0
        self._level: Optional[SoundLevel] = None
        super().__init__(settings, sound_sources.is_live(settings.source), (self._audio, self._info))

    def _open(self) -> SoundSource:
        return open_sound_source(self._settings, self._notify)

    def _play(self, source: SoundSource) -> None:
        """Publish one source until its end, one message per chunk."""
        info = AudioInfo(channels=source.channels, sample_rate=source.rate, sample_format="S16LE",
                         bitrate=16 * source.rate * source.channels, coding_format="wave")
        self._info.publish(info)
        self._await_subscriber()
        count = max(1, int(round(self._settings.chunk * source.rate)))
        pacer = Pacer(self._settings.rate * source.rate / count)
        self._level, self._sent = SoundLevel(source.rate, source.channels), 0
        reported = time.monotonic()
        while not self._ended():
            samples = source.read(count)
            if samples is None:
                return
            if not source.live:
                # A chunk is sent when its last sample has been heard, as a microphone does.
                self._stop.wait(pacer.wait(time.monotonic()))
                pacer.done(time.monotonic())
            self._audio.publish(AudioData(data=encode_s16(samples)))
            self._level.add(samples)
            self._sent += len(samples)
            if time.monotonic() - reported >= 1.0:
                reported = time.monotonic()
                self._report(source)

    def _report(self, source: SoundSource) -> None:
        """Tell the diagnostics how it goes."""
        values = {"seconds": self._sent / source.rate, "sample_rate": source.rate, "channels": source.channels,
                  "subscribers": self._audio.get_num_connections(), "tries": self._tries}
        values.update(self._level.values() if self._level is not None else {})
        self._diagnostics.set("source", OK, source.description, values)

    def _wanted(self) -> bool:
        return self._audio.get_num_connections() > 0
