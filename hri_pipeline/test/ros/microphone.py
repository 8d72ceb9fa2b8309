"""A microphone for tests: publishes sound in its own time, and remembers when each sample was heard."""

import math
import threading
import time

import numpy as np
import rospy
from audio_common_msgs.msg import AudioData, AudioInfo

RATE = 16000
DATA = "/usr/share/pocketsphinx/test/data/"
CHUNK_S = 0.02
SOUND_SPEED = 343.0


def speech():
    """"go forward ten meters", said once, with half a second of faint noise before it and two behind; (N,) of -1 to
    1."""
    said = np.fromfile(DATA + "goforward.raw", "<i2") / 32768.0
    random = np.random.default_rng(0)
    return np.concatenate([np.zeros(RATE // 2), said, np.zeros(2 * RATE)]) + random.normal(
        0.0, 3e-4, len(said) + 5 * RATE // 2)


def noise(seconds, level=1e-3):
    """White noise."""
    return np.random.default_rng(1).normal(0.0, level, int(seconds * RATE))


def from_direction(positions, samples, azimuth):
    """What microphones at positions (C, 3), m, hear of a far sound (N,) at `azimuth` rad, (N, C), with some noise of
    their own."""
    towards = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    frequencies = np.fft.rfftfreq(len(samples), 1.0 / RATE)
    spectrum = np.fft.rfft(samples)
    heard = [np.fft.irfft(spectrum * np.exp(2j * math.pi * frequencies * position.dot(towards) / SOUND_SPEED),
                          len(samples))
             for position in positions]
    return np.array(heard).T + np.random.default_rng(3).normal(0.0, 2e-4, (len(samples), len(positions)))


def to_bytes(samples):
    """S16LE of (N,) or (N, C) samples of -1 to 1."""
    return np.clip(np.rint(np.asarray(samples) * 32768.0), -32768, 32767).astype("<i2").tobytes()


class Microphone:
    """Sends what it is given on `audio`, chunk by chunk. info: (channels, rate, format, coding) for `audio_info`."""

    def __init__(self, topic="audio", info=None):
        self._publisher = rospy.Publisher(topic, AudioData, queue_size=200)
        self._info = rospy.Publisher(topic + "_info", AudioInfo, queue_size=1, latch=True) if info is not None else None
        if info is not None:
            self.say_format(*info)
        self._stop = threading.Event()
        self._thread = None
        self.begin = 0.0

    def say_format(self, channels, rate, sample_format="S16LE", coding="wave"):
        self._info.publish(AudioInfo(channels=channels, sample_rate=rate, sample_format=sample_format,
                                     coding_format=coding))

    def connected(self):
        return self._publisher.get_num_connections() > 0

    def play(self, samples, rate=RATE, chunk=CHUNK_S, loop=False):
        """Send samples (N,) or (N, C), in their time, in the background; `begin` is when the first was heard (s)."""
        size = int(chunk * rate)
        self.play_chunks([to_bytes(samples[start:start + size]) for start in range(0, len(samples), size)], chunk, loop)

    def play_chunks(self, chunks, period, loop=False):
        """Send these bytes, one message each `period` s."""
        self.stop()
        self._stop.clear()
        self._thread = threading.Thread(target=self._play, args=(chunks, period, loop), daemon=True)
        self._thread.start()

    def _play(self, chunks, period, loop):
        begin, number = time.monotonic(), 0
        self.begin = rospy.get_time()
        while loop or number < len(chunks):
            number += 1
            if self._stop.wait(max(0.0, begin + number * period - time.monotonic())):
                return
            self._publisher.publish(AudioData(data=chunks[(number - 1) % len(chunks)]))

    def is_playing(self):
        return self._thread is not None and self._thread.is_alive()

    def stop(self):
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def close(self):
        self.stop()
        self._publisher.unregister()
        if self._info is not None:
            self._info.unregister()
