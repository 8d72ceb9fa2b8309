"""Writes bags of ROS 1 with the `rosbags` library, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Iterable, List, Mapping, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.geometry import Pose

Place = Union[Sequence[float], np.ndarray]

_OURS = ("IdsList", "IdsMatch", "FacialActionUnits", "FacialLandmarks", "Skeleton2D", "NormalizedPointOfInterest2D",
         "GazeSenderReceiver", "GazesStamped", "Group", "GroupsStamped", "LiveSpeech")
_OTHERS: Mapping[str, str] = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "audio_common_msgs/msg/AudioData": "uint8[] data\n",
    "audio_common_msgs/msg/AudioInfo": "uint8 channels\nuint32 sample_rate\nstring sample_format\nuint32 bitrate\nstring coding_format\n"}
"""Types that the library does not bring with it, as the packages tf2_msgs and audio_common_msgs define them."""


def message_directory() -> Path:
    """Return hri_msgs/msg of the checkout or of the install space. Raises FileNotFoundError when there is none."""
    for parent in Path(__file__).resolve().parents:
        for folder in (parent / "hri_msgs" / "msg", parent / "share" / "hri_msgs" / "msg"):
            if (folder / "IdsList.msg").is_file():
                return folder
    raise FileNotFoundError("there is no hri_msgs/msg above {}; install hri_msgs beside hri_pipeline".format(__file__))


def type_store() -> object:
    """Return the library's types of ROS 1 with those of hri_msgs, tf2_msgs and audio_common_msgs."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    store, types, folder = get_typestore(Stores.ROS1_NOETIC), {}, message_directory()
    for name in _OURS:
        types.update(get_types_from_msg((folder / (name + ".msg")).read_text(encoding="utf-8"), "hri_msgs/msg/" + name))
    for name, text in _OTHERS.items():
        if name not in store.types:
            types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


class BagWriter:
    """A bag that is being written, a context manager. Times are in s, places in m, rotations as in Pose.

    Messages may be written in any order of time; a topic is latched for its whole life.
    """

    def __init__(self, path: Union[str, Path]) -> None:
        """path: of a new file. Raises rosbags' WriterError when it exists, as soon as it is entered."""
        from rosbags.rosbag1 import Writer
        self._store = type_store()
        self._writer = Writer(Path(path))
        self._connections: Dict[str, object] = {}

    def __enter__(self) -> BagWriter:
        self._writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._writer.close()

    def make(self, name: str, *values: object) -> object:
        """Return a message of the type `package/msg/Name` of its fields in their order."""
        return self._store.types[name](*values)

    def header(self, stamp: float, frame: str = "map") -> object:
        """Return a std_msgs/Header."""
        nanoseconds = int(round(stamp * 1e9))
        time = self.make("builtin_interfaces/msg/Time", nanoseconds // 10 ** 9, nanoseconds % 10 ** 9)
        return self.make("std_msgs/msg/Header", 0, time, frame)

    def write(self, topic: str, name: str, message: object, when: float, latched: bool = False) -> None:
        """Write a message of the type `name` at the time `when`."""
        self.write_raw(topic, name, self._store.serialize_ros1(message, name), when, latched)

    def write_raw(self, topic: str, name: str, data: bytes, when: float, latched: bool = False) -> None:
        """Write bytes as they are, right or wrong."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, name, typestore=self._store, latching=int(latched))
        self._writer.write(self._connections[topic], int(round(when * 1e9)), data)

    def ids(self, topic: str, ids: Iterable[str], stamp: float, frame: str = "map") -> None:
        """Write an hri_msgs/IdsList."""
        name = "hri_msgs/msg/IdsList"
        self.write(topic, name, self.make(name, self.header(stamp, frame), list(ids)), stamp)

    def gaze(self, topic: str, pairs: Iterable[Tuple[str, str]], stamp: float) -> None:
        """Write an hri_msgs/GazesStamped of (sender, receiver)."""
        name = "hri_msgs/msg/GazesStamped"
        gazes = [self.make("hri_msgs/msg/GazeSenderReceiver", sender, receiver, 1.0) for sender, receiver in pairs]
        self.write(topic, name, self.make(name, self.header(stamp), gazes), stamp)

    def groups(self, topic: str, groups: Iterable[Iterable[str]], stamp: float) -> None:
        """Write an hri_msgs/GroupsStamped of sets of members."""
        name = "hri_msgs/msg/GroupsStamped"
        made = [self.make("hri_msgs/msg/Group", self.header(stamp), "g%d" % number, sorted(members))
                for number, members in enumerate(groups)]
        self.write(topic, name, self.make(name, self.header(stamp), made, np.ones(len(made), dtype=np.float32)), stamp)

    def poses(self, topic: str, places: Iterable[Place], stamp: float) -> None:
        """Write a geometry_msgs/PoseArray of places (3,) without a turn."""
        name = "geometry_msgs/msg/PoseArray"
        turn = self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        poses = [self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", *map(float, place)), turn) for place in places]
        self.write(topic, name, self.make(name, self.header(stamp), poses), stamp)

    def transforms(self, topic: str, frames: Iterable[Tuple[str, str, Pose]], stamp: float, when: float = -1.0) -> None:
        """Write frames (parent, child, pose of the child in the parent) at `when`, or at their stamp. /tf_static is latched."""
        made: List[object] = []
        for parent, child, pose in frames:
            place = self.make("geometry_msgs/msg/Vector3", *map(float, pose.translation))
            turn = self.make("geometry_msgs/msg/Quaternion", *map(float, pose.quaternion))
            made.append(self.make("geometry_msgs/msg/TransformStamped", self.header(stamp, parent), child,
                                  self.make("geometry_msgs/msg/Transform", place, turn)))
        name = "tf2_msgs/msg/TFMessage"
        self.write(topic, name, self.make(name, made), stamp if when < 0.0 else when, latched=topic == "/tf_static")

    def number(self, topic: str, value: float, stamp: float) -> None:
        """Write a std_msgs/Float32."""
        self.write(topic, "std_msgs/msg/Float32", self.make("std_msgs/msg/Float32", value), stamp)

    def flag(self, topic: str, value: bool, stamp: float) -> None:
        """Write a std_msgs/Bool, latched."""
        self.write(topic, "std_msgs/msg/Bool", self.make("std_msgs/msg/Bool", value), stamp, latched=True)

    def text(self, topic: str, value: str, stamp: float, latched: bool = False) -> None:
        """Write a std_msgs/String."""
        self.write(topic, "std_msgs/msg/String", self.make("std_msgs/msg/String", value), stamp, latched)
