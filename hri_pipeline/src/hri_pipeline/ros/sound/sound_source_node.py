"""The sound_source node: files or a microphone as audio_common_msgs."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Optional

import rospy
from audio_common_msgs.msg import AudioData, AudioInfo

from hri_pipeline.core.pacing import Pacer
from hri_pipeline.core.sound.sound_format import encode_s16
from hri_pipeline.core.sound.sound_level import SoundLevel
from hri_pipeline.core.sound.sound_sources import SoundSource, SoundSourceError, is_live, open_sound_source
from hri_pipeline.ros.diagnostics import OK
from hri_pipeline.ros.source_node import SourceNode

_QUEUE = 100


class SoundSourceNode(SourceNode[SoundSource]):
    """Publishes `audio`, `audio_info` (latched) and `finished` (latched)."""

    FAULT = SoundSourceError

    def __init__(self, settings: SimpleNamespace) -> None:
        self._audio = rospy.Publisher("audio", AudioData, queue_size=_QUEUE)
        self._info = rospy.Publisher("audio_info", AudioInfo, queue_size=1, latch=True)
        self._sent = 0
        self._level: Optional[SoundLevel] = None
        super().__init__(settings, is_live(settings.source), (self._audio, self._info))

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
