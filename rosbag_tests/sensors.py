"""A camera and four microphones for tests of the whole stack: the real source nodes, on a packaged photograph and a
packaged sentence."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import List

import numpy as np
import soundfile

from hri_pipeline.core.onnx import models_directory

PHOTOGRAPH = "sample1.jpg"
SENTENCE = Path("/usr/share/pocketsphinx/test/data/goforward.raw")      # "go forward ten meters", 16 kHz
MICROPHONES = np.array([(0.04, 0.04), (-0.04, 0.04), (-0.04, -0.04), (0.04, -0.04)])    # m, as in conformance.launch
RATE = 16000
SOUND_SPEED = 343.0     # m/s
_END_S = 10.0


def heard_from(samples: np.ndarray, azimuth: float) -> np.ndarray:
    """What the microphones hear of a far sound (N,) from `azimuth` rad, (N, 4), with a little noise of their own."""
    delays = -MICROPHONES @ (np.cos(azimuth), np.sin(azimuth)) / SOUND_SPEED
    turns = np.exp(-2j * np.pi * np.outer(np.fft.rfftfreq(len(samples), 1.0 / RATE), delays))
    heard = np.fft.irfft(np.fft.rfft(samples)[:, None] * turns, len(samples), axis=0)
    return heard + np.random.default_rng(3).normal(0.0, 2e-4, heard.shape)


class Sensors:
    """Starts image_source and sound_source; close() ends them."""

    def __init__(self, rate: float = 6.0) -> None:
        """rate: images per second."""
        self._folder = tempfile.TemporaryDirectory()
        said = np.fromfile(str(SENTENCE), "<i2") / 32768.0
        quiet = np.zeros(RATE)
        sound = str(Path(self._folder.name) / "sentence.wav")
        soundfile.write(sound, heard_from(np.concatenate([quiet, said, quiet]), 0.2), RATE, subtype="PCM_16")
        picture = str(models_directory() / "demo" / PHOTOGRAPH)
        self._processes = [
            _start("image_source", ["_source:=" + picture, "_rate:={}".format(rate), "_zoom:=0.0",
                                    "_dark_between_pictures:=0.0",
                                    "image:=/camera/image_raw", "image/compressed:=/camera/image_raw/compressed",
                                    "camera_info:=/camera/camera_info"]),
            _start("sound_source", ["_source:=" + sound, "audio:=/microphone/audio",
                                    "audio_info:=/microphone/audio_info"])]

    def close(self) -> None:
        """End both nodes. Idempotent."""
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._processes = []
        self._folder.cleanup()


def _start(node: str, arguments: List[str]) -> subprocess.Popen:
    return subprocess.Popen(["rosrun", "hri_pipeline", node, "__name:=" + node] + arguments)
