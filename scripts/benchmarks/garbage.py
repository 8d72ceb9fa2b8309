"""Messages that nobody should send: of any type with values not finite, extreme, of wrong sizes, with ids that are
none; and what a broken camera or microphone, or somebody who means harm, would send: messages that look right and are
not."""

from __future__ import annotations

import random
from typing import Callable, Dict, List, Sequence

import genpy
import rospy
from audio_common_msgs.msg import AudioData, AudioInfo
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
            made.header.stamp = rospy.Time.from_sec(self._chance.choice((0.0, now, now, now + _FUTURE_S,
                                                                         max(0.0, now - 60.0))))
        return made

    def _images(self) -> List[Image]:
        width, height = self._size
        right, size = ("32FC1", 4) if self._depth else ("bgr8", 3)
        whole = bytes(width * height * size)
        return [
            _image(0, 0, "", 0, b""), _image(width, height, right, width * size, b""),
            _image(width, height, right, width * size, whole[:-1]), _image(width, height, right, 0, whole),
            _image(width, height, right, 2 ** 32 - 1, whole), _image(2 ** 32 - 1, 2 ** 32 - 1, right, 12, whole[:100]),
            _image(width, height, "no such encoding", width * size, whole),
            _image(width, height, "mono8", width, whole),
            _image(1, 1, right, size, whole[:size]), _image(*_HUGE, "mono8", _HUGE[0], bytes(_HUGE[0] * _HUGE[1])),
            _image(width, height, right, width * size,
                   self._chance.getrandbits(8 * len(whole)).to_bytes(len(whole), "little")),
            _image(width, height, "32FC1", 4 * width, b"\xff" * (4 * width * height))]

    def _infos(self) -> List[CameraInfo]:
        width, height = self._size
        right = [900.0, 0.0, width / 2.0, 0.0, 900.0, height / 2.0, 0.0, 0.0, 1.0]
        kinds = [dict(K=[NAN] * 9), dict(K=[0.0] * 9), dict(K=[1e300] * 9), dict(K=[-value for value in right]),
                 dict(width=0, height=0),
                 dict(width=1, height=1), dict(width=2 ** 32 - 1), dict(D=[NAN] * 5), dict(D=[1e6] * 5), dict(D=[0.1]),
                 dict(distortion_model="no such model"), dict(binning_x=2 ** 32 - 1, binning_y=7)]
        made = [CameraInfo(**dict(dict(width=width, height=height, K=right, D=[0.0] * 5, distortion_model="plumb_bob"),
                                  **kind))
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
        dict(channels=0), dict(channels=255), dict(sample_rate=0), dict(sample_rate=2 ** 32 - 1),
        dict(sample_format=""),
        dict(sample_format="F64BE"), dict(coding_format="no such coding"), dict(channels=7, sample_rate=44100))]


IDS = ("", " ", "a b", "../../etc", "-", "\u00e4\u00f6", "x" * 5000, "line\nline", "face_/", "/humans", "%s%n", "\x00")
"""None of these is an id."""
_SIZES = (0, 0, 1, 2, 17, 70, 99, 2000)
_FLOATS = (float("nan"), float("inf"), float("-inf"), 0.0, -0.0, 1e-310, 1e38, -1e38, -1.0, 2.0)
_WHOLE = {"int8": (8, True), "uint8": (8, False), "byte": (8, True), "char": (8, False), "int16": (16, True),
          "uint16": (16, False),
          "int32": (32, True), "uint32": (32, False), "int64": (64, True), "uint64": (64, False)}


class Fuzz:
    """Makes messages. seed: the same seed makes the same ones. known: names that are there, now and then in the place
    of an id."""

    def __init__(self, seed: int = 0, known: Sequence[str] = ()) -> None:
        self._chance = random.Random(seed)
        self._known = list(known)
        self._makers: Dict[str, Callable[[], object]] = {"string": self._text,
                                                         "bool": lambda: self._chance.random() < 0.5,
                                                         "float32": self._number, "float64": self._number,
                                                         "time": self._time, "duration": self._duration}

    def message(self, kind: type) -> genpy.Message:
        """Return a message of a class; it can be serialised."""
        made = kind()
        for slot, type_name in zip(made.__slots__, made._slot_types):
            setattr(made, slot, self._field(type_name))
        return made

    def _field(self, type_name: str) -> object:
        base, is_array, length = _parse(type_name)
        if not is_array:
            return self._one(base)
        count = self._chance.choice(_SIZES) if length is None else length
        if base in ("uint8", "char"):
            return bytes(self._chance.randrange(256) for _ in range(count))
        # One value many times: a large message need not take long to make.
        few: List[object] = [self._one(base) for _ in range(min(count, 5))]
        return [few[number % len(few)] for number in range(count)]

    def _one(self, base: str) -> object:
        if base in self._makers:
            return self._makers[base]()
        if base in _WHOLE:
            bits, signed = _WHOLE[base]
            low, high = (-2 ** (bits - 1), 2 ** (bits - 1) - 1) if signed else (0, 2 ** bits - 1)
            return self._chance.choice((low, high, 0, 1, self._chance.randint(low, high)))
        import roslib.message
        return self.message(roslib.message.get_message_class("std_msgs/Header" if base == "Header" else base))

    def _text(self) -> str:
        if self._known and self._chance.random() < 0.2:
            return self._chance.choice(self._known)
        return self._chance.choice(IDS)

    def _number(self) -> float:
        return self._chance.choice(_FLOATS) if self._chance.random() < 0.7 else self._chance.uniform(-10.0, 10.0)

    def _time(self) -> genpy.Time:
        return genpy.Time(self._chance.choice((0, 1, 2 ** 31 - 1, 2 ** 32 - 1, 1_600_000_000)),
                          self._chance.choice((0, 999_999_999)))

    def _duration(self) -> genpy.Duration:
        return genpy.Duration(self._chance.choice((-2 ** 31, -1, 0, 2 ** 31 - 1)), 0)


def _parse(type_name: str) -> tuple:
    """(base type, is it an array, its length or None)."""
    if not type_name.endswith("]"):
        return type_name, False, None
    base, length = type_name[:-1].split("[")
    return base, True, int(length) if length else None
