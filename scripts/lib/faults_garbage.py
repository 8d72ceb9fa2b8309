"""What a broken camera or microphone, or somebody who means harm, would send: messages that look right and are not."""

from __future__ import annotations

import random
from typing import Callable, Dict, List, Sequence

import genpy
import rospy
from audio_common_msgs.msg import AudioData, AudioInfo
from faults_fuzz import Fuzz
from sensor_msgs.msg import CameraInfo, Image

NAN = float("nan")
_FUTURE_S = 1e9
_HUGE = (6000, 4000)


class Garbage:
    """Makes the messages for one topic: crafted ones where its type has such, and every other one by a Fuzz.

    depth: the images are of a depth camera. width, height: px, of the images that are right. known: as in Fuzz.
    """

    def __init__(self, topic: str, kind: type, depth: bool = False, width: int = 1280, height: int = 720,
                 known: Sequence[str] = ()) -> None:
        self._kind, self._depth, self._size = kind, depth, (width, height)
        self._fuzz, self._chance = Fuzz(len(topic), known), random.Random(len(topic))
        crafted: Dict[type, Callable[[], List[genpy.Message]]] = {Image: self._images, CameraInfo: self._infos,
                                                                  AudioData: _sounds, AudioInfo: _formats}
        self._crafted = crafted[kind]() if kind in crafted else []
        self._number = 0

    def message(self) -> genpy.Message:
        """Return the next message."""
        self._number += 1
        if not self._crafted or self._number % 2:
            return self._fuzz.message(self._kind)
        made = self._crafted[self._number // 2 % len(self._crafted)]
        if hasattr(made, "header"):
            now = rospy.get_time()
            made.header.stamp = rospy.Time.from_sec(self._chance.choice((0.0, now, now, now + _FUTURE_S, max(0.0, now - 60.0))))
        return made

    def _images(self) -> List[Image]:
        width, height = self._size
        right, size = ("32FC1", 4) if self._depth else ("bgr8", 3)
        whole = bytes(width * height * size)
        return [
            _image(0, 0, "", 0, b""), _image(width, height, right, width * size, b""),
            _image(width, height, right, width * size, whole[:-1]), _image(width, height, right, 0, whole),
            _image(width, height, right, 2 ** 32 - 1, whole), _image(2 ** 32 - 1, 2 ** 32 - 1, right, 12, whole[:100]),
            _image(width, height, "no such encoding", width * size, whole), _image(width, height, "mono8", width, whole),
            _image(1, 1, right, size, whole[:size]), _image(*_HUGE, "mono8", _HUGE[0], bytes(_HUGE[0] * _HUGE[1])),
            _image(width, height, right, width * size, self._chance.getrandbits(8 * len(whole)).to_bytes(len(whole), "little")),
            _image(width, height, "32FC1", 4 * width, b"\xff" * (4 * width * height))]

    def _infos(self) -> List[CameraInfo]:
        width, height = self._size
        right = [900.0, 0.0, width / 2.0, 0.0, 900.0, height / 2.0, 0.0, 0.0, 1.0]
        kinds = [dict(K=[NAN] * 9), dict(K=[0.0] * 9), dict(K=[1e300] * 9), dict(K=[-value for value in right]), dict(width=0, height=0),
                 dict(width=1, height=1), dict(width=2 ** 32 - 1), dict(D=[NAN] * 5), dict(D=[1e6] * 5), dict(D=[0.1]),
                 dict(distortion_model="no such model"), dict(binning_x=2 ** 32 - 1, binning_y=7)]
        made = [CameraInfo(**dict(dict(width=width, height=height, K=right, D=[0.0] * 5, distortion_model="plumb_bob"), **kind))
                for kind in kinds]
        made[-1].roi.x_offset = 2 ** 32 - 1
        return made


def _image(width: int, height: int, encoding: str, step: int, data: bytes) -> Image:
    return Image(width=width, height=height, encoding=encoding, step=step, data=data)


def _sounds() -> List[AudioData]:
    return [AudioData(data=data) for data in (b"", b"\0", b"\xff\x7f" * 160, bytes(3201), b"\x80" * 2_000_000)]


def _formats() -> List[AudioInfo]:
    right = dict(channels=1, sample_rate=16000, sample_format="S16LE", coding_format="wave", bitrate=256)
    return [AudioInfo(**dict(right, **wrong)) for wrong in (
        dict(channels=0), dict(channels=255), dict(sample_rate=0), dict(sample_rate=2 ** 32 - 1), dict(sample_format=""),
        dict(sample_format="F64BE"), dict(coding_format="no such coding"), dict(channels=7, sample_rate=44100))]
