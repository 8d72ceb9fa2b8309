"""The sound_source node: files or a microphone as audio_common_msgs."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Optional

import rospy
from audio_common_msgs.msg import AudioData, AudioInfo
from std_msgs.msg import Bool

from hri_pipeline.core.pacing import Pacer
from hri_pipeline.core.sound.sound_format import encode_s16
from hri_pipeline.core.sound.sound_level import SoundLevel
from hri_pipeline.core.sound.sound_source_parameters import EXIT
from hri_pipeline.core.sound.sound_sources import SoundSource, SoundSourceError, is_live, open_sound_source
from hri_pipeline.ros.diagnostics import ERROR, OK, NodeDiagnostics
from hri_pipeline.ros.topic_release import release

_LOOK_FOR_SUBSCRIBERS_S = 0.05
# What subscribers need to read the last messages before the connection is closed.
_FAREWELL_S = 0.5
_QUEUE = 100


class SoundSourceNode:
    """Publishes `audio`, `audio_info` (latched) and `finished` (latched).

    A microphone that is not there, or goes away, is tried again every `retry_period`; a file that cannot be read ends
    the node. Sound is read and sent in one thread, the caller of spin().
    """

    def __init__(self, settings: SimpleNamespace) -> None:
        self._settings = settings
        self._stop = threading.Event()
        self._source: Optional[SoundSource] = None
        self._audio = rospy.Publisher("audio", AudioData, queue_size=_QUEUE)
        self._info = rospy.Publisher("audio_info", AudioInfo, queue_size=1, latch=True)
        self._finished = rospy.Publisher("finished", Bool, queue_size=1, latch=True)
        self._diagnostics = NodeDiagnostics(rospy.get_name())
        self._tries = 0
        self._sent = 0
        self._level: Optional[SoundLevel] = None
        rospy.on_shutdown(self._stop.set)
        self._finished.publish(Bool(False))
        if not is_live(settings.source):
            # A file that cannot be read is reported at once, and ends the node.
            self._source = self._open()

    def spin(self) -> None:
        """Play until the end of the source or of ROS. Raises SoundSourceError for a file that cannot be read."""
        while not self._ended():
            try:
                if self._source is None:
                    self._source = self._open()
                rospy.loginfo("%s: playing %s", rospy.get_name(), self._source.description)
                self._play(self._source)
                break
            except SoundSourceError as error:
                self._drop_source()
                if not is_live(self._settings.source):
                    raise
                self._tries += 1
                rospy.logwarn("%s; next try in %g s", error, self._settings.retry_period)
                self._diagnostics.set("source", ERROR, str(error), {"tries": self._tries})
                self._stop.wait(self._settings.retry_period)
        if not self._ended():
            self._tell_the_end()

    def close(self) -> None:
        """Stop playing and let go of the source. May be called again."""
        self._stop.set()
        self._drop_source()
        self._diagnostics.close()
        for publisher in (self._audio, self._info, self._finished):
            release(publisher)

    def _open(self) -> SoundSource:
        try:
            return open_sound_source(self._settings, self._notify)
        except SoundSourceError as error:
            raise SoundSourceError("{}: {}".format(rospy.get_name(), error)) from error

    def _drop_source(self) -> None:
        if self._source is not None:
            self._source.close()
            self._source = None

    def _play(self, source: SoundSource) -> None:
        """Publish one source until its end, one message per chunk."""
        info = AudioInfo(channels=source.channels, sample_rate=source.rate, sample_format="S16LE",
                         bitrate=16 * source.rate * source.channels, coding_format="wave")
        self._info.publish(info)
        if self._settings.wait_for_subscriber:
            while not self._audio.get_num_connections() and not self._ended():
                self._stop.wait(_LOOK_FOR_SUBSCRIBERS_S)
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

    def _ended(self) -> bool:
        return self._stop.is_set() or rospy.is_shutdown()

    def _notify(self, text: str) -> None:
        rospy.logwarn("%s: %s", rospy.get_name(), text)
