"""Bags of ROS 1, read and written with the `rosbags` library, without ROS.

`read_bag` returns what a bag tells of people, and of the truth where it holds that; `BagWriter` writes messages of the
stack.
"""

from __future__ import annotations

import bisect
import struct
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from hri_pipeline.core.frames import is_of_human, read, scan
from hri_pipeline.core.geometry import Pose

HUMANS = "/humans/"
KINDS = ("faces", "bodies", "voices")
PERSONS = HUMANS + "persons/"
INTERACTIONS = "/humans/interactions/"
_PERSON_FRAME = b"person_"
_MAX_CHAIN = 16
_IDS_LIST = "hri_msgs/msg/IdsList"
_UNREADABLE = (ValueError, AssertionError, IndexError, AttributeError, TypeError, struct.error)
"""Of bytes that are damaged, and of messages of another type than that of their topic."""


class RecordError(ValueError):
    """A bag that cannot be scored; the text says what is missing."""


@dataclass
class TruthFrame:
    """The truth at one stamp. heads: m, by id. visible: who could be seen; None: the bag does not tell."""

    stamp: float
    heads: Dict[str, Tuple[float, float, float]] = field(default_factory=dict)
    visible: Optional[frozenset] = None
    gaze: frozenset = frozenset()
    groups: Tuple[frozenset, ...] = ()


@dataclass
class Track:
    """Places of one person frame.

    stamps: s, ascending; places: (x, y, z) m in the truth's frame; ages: s from stamp to bag.
    """

    stamps: List[float] = field(default_factory=list)
    places: List[Tuple[float, float, float]] = field(default_factory=list)
    ages: List[float] = field(default_factory=list)

    def at(self, stamp: float, slack: float) -> Optional[Tuple[float, float, float]]:
        """Return the last place not after `stamp` and not older than `slack` (s)."""
        index = bisect.bisect_right(self.stamps, stamp + 1e-6) - 1
        return self.places[index] if index >= 0 and stamp - self.stamps[index] <= slack else None


@dataclass
class Record:
    """Everything that the scores need. Series are (time s, value), ascending; tracked goes by the time of the bag.

    listed: tracked ids by kind (faces, bodies, voices); counted: the same of the truth, where it counts (recordings of
    pictures). said: texts by voice: the last one (String), or all that are finished (LiveSpeech). true_words: the
    sentences of the truth. speaking: whether each voice speaks. texts: (time, voice, text) of all texts. names:
    the last one by person; speakers: the last person by voice.
    """

    begin: float
    end: float
    truth: List[TruthFrame] = field(default_factory=list)
    tracked: List[Tuple[float, frozenset]] = field(default_factory=list)
    tracks: Dict[str, Track] = field(default_factory=dict)
    gaze: List[Tuple[float, frozenset]] = field(default_factory=list)
    groups: List[Tuple[float, Tuple[frozenset, ...]]] = field(default_factory=list)
    confidence: Dict[str, List[Tuple[float, float]]] = field(default_factory=dict)
    listed: Dict[str, List[Tuple[float, frozenset]]] = field(default_factory=dict)
    counted: Dict[str, List[Tuple[float, frozenset]]] = field(default_factory=dict)
    said: Dict[str, List[Tuple[float, str]]] = field(default_factory=dict)
    true_words: List[str] = field(default_factory=list)
    speaking: Dict[str, List[Tuple[float, bool]]] = field(default_factory=dict)
    texts: List[Tuple[float, str, str]] = field(default_factory=list)
    names: Dict[str, str] = field(default_factory=dict)
    speakers: Dict[str, str] = field(default_factory=dict)
    messages: Counter = field(default_factory=Counter)
    foreign_frames: int = 0
    damaged: int = 0


_MAGIC = b"#ROSBAG V2.0"
_LONGEST_HEADER = 4096


def is_recording(path: Union[str, Path]) -> bool:
    """Tell whether a file begins as every recording of rosbag does. Raises OSError when it cannot be read."""
    with open(path, "rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


def is_closed(path: Union[str, Path]) -> bool:
    """Tell whether a recording was brought to its end: its header tells where in the file its index is.

    The header stands behind the first line: its length, and of each field the length, the name, = and the value (wiki:
    Bags/Format/2.0). Raises OSError when the file cannot be read.
    """
    with open(path, "rb") as file:
        begin = file.read(len(_MAGIC) + 1 + 4 + _LONGEST_HEADER)
    at = len(_MAGIC) + 1
    end = min(len(begin), at + 4 + int.from_bytes(begin[at:at + 4], "little"))
    at += 4
    while at + 4 <= end:
        size = int.from_bytes(begin[at:at + 4], "little")
        name, _, value = begin[at + 4:at + 4 + size].partition(b"=")
        if name == b"index_pos":
            return 0 < int.from_bytes(value, "little") <= Path(path).stat().st_size     # without messages it is empty
        at += 4 + size
    return False


def not_closed(path: Union[str, Path]) -> str:
    """Return what to say of a recording that is not closed."""
    return "{0} was not closed: it runs still, or was cut off; end it, or: rosbag reindex {0}".format(path)


def read_bag(path: Union[str, Path], truth: str = "/scene/truth") -> Record:
    """Read a bag. truth: namespace of the truth.

    Raises RecordError when the file is no bag of ROS 1 or holds nothing.
    """
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.rosbag1 import ReaderError

    file = Path(path).expanduser()
    if not file.is_file():
        raise RecordError("{}: there is no such bag".format(file))
    try:
        was_cut = is_recording(file) and not is_closed(file)
    except OSError as error:
        raise RecordError("{} cannot be read: {}".format(file, error.strerror)) from error
    if was_cut:
        raise RecordError(not_closed(file))
    if file.suffix != ".bag":
        raise RecordError("{}: the name of a ROS 1 bag ends in .bag".format(file))
    try:
        with AnyReader([file]) as reader:
            if not reader.message_count:
                raise RecordError("{}: nothing was recorded".format(file))
            return _Reading(reader, truth.rstrip("/")).record()
    except (AnyReaderError, ReaderError) as error:
        raise RecordError("{}: {}".format(file, error)) from error


class _Reading:
    """One pass over a bag; transforms of robots are kept to bring persons into the truth's frame."""

    def __init__(self, reader: Any, truth: str) -> None:
        self._reader, self._namespace = reader, truth
        self._record = Record(reader.start_time * 1e-9, reader.end_time * 1e-9)
        self._truth: Dict[int, TruthFrame] = {}
        self._order: Dict[int, List[str]] = {}
        self._heads: Dict[int, list] = {}
        self._frame: Optional[str] = None
        self._robot: Dict[str, Tuple[str, Pose]] = {}
        self._persons: List[Tuple[float, bytes, int]] = []

    def record(self) -> Record:
        topics = {"/tf": self._tf, "/tf_static": self._tf, PERSONS + "tracked": self._tracked,
                  INTERACTIONS + "gaze": self._gaze, INTERACTIONS + "groups": self._groups}
        topics.update({"{}/{}".format(self._namespace, name): self._true(name)
                       for name in ("persons", "visible", "heads", "gaze", "groups")})
        topics[self._namespace + "/words"] = self._true_words
        # Recordings of pictures count there who can be seen; the scene simulator tells the poses of the bodies.
        counts = {"{}/{}".format(self._namespace, kind): kind for kind in KINDS}
        for kind in KINDS:
            topics[HUMANS + kind + "/tracked"] = self._ids_of(self._record.listed.setdefault(kind, []))
        for topic, kind in counts.items():
            topics[topic] = self._ids_of(self._record.counted.setdefault(kind, []))
        for connection, nanoseconds, data in self._reader.messages():
            self._record.messages[connection.topic] += 1
            take = topics.get(connection.topic)
            if take is None and connection.topic.startswith(PERSONS):
                take = {"location_confidence": self._confidence, "name": self._name,
                        "voice_id": self._voice_id}.get(connection.topic.split("/")[-1])
            elif take is None and connection.topic.startswith(HUMANS + "voices/"):
                take = {"speech": self._speech, "is_speaking": self._speaking}.get(connection.topic.split("/")[-1])
            if take is None or (connection.topic in counts and connection.msgtype != _IDS_LIST):
                continue
            try:
                take(connection, nanoseconds * 1e-9, bytes(data))
            except _UNREADABLE:
                self._record.damaged += 1
        return self._finish()

    def _message(self, connection: Any, data: bytes) -> Any:
        return self._reader.deserialize(data, connection.msgtype)

    def _tf(self, connection: Any, when: float, data: bytes) -> None:
        for child, offset in scan(data):
            name = child.lstrip(b"/")
            if name.startswith(_PERSON_FRAME):
                self._place(when, read(data, offset))
            elif not is_of_human(child, connection.topic == "/tf_static"):
                found = read(data, offset)
                self._robot[found.child] = (found.parent, Pose.from_quaternion(found.rotation, found.translation))

    def _place(self, when: float, found: Any) -> None:
        place = self._in_truth_frame(found.parent, np.array(found.translation))
        if place is None or not np.isfinite(place).all():
            self._record.foreign_frames += 1
            return
        track = self._record.tracks.setdefault(found.child[len(_PERSON_FRAME):], Track())
        if track.stamps and found.stamp <= track.stamps[-1]:
            return      # said again, or time has gone back
        track.stamps.append(found.stamp)
        track.places.append((float(place[0]), float(place[1]), float(place[2])))
        track.ages.append(when - found.stamp)

    def _in_truth_frame(self, parent: str, place: np.ndarray) -> Optional[np.ndarray]:
        """A place in the frame of the truth; without a truth, as it is."""
        for _ in range(_MAX_CHAIN):
            if self._frame is None or parent == self._frame:
                return place
            if parent not in self._robot:
                return None
            parent, pose = self._robot[parent]
            place = pose.apply(place[None])[0]
        return None

    def _tracked(self, connection: Any, when: float, data: bytes) -> None:
        self._record.tracked.append((when, frozenset(self._message(connection, data).ids)))

    def _gaze(self, connection: Any, when: float, data: bytes) -> None:
        message = self._message(connection, data)
        pairs = frozenset((gaze.sender, gaze.receiver) for gaze in message.gazes)
        self._record.gaze.append((_stamp(message.header), pairs))

    def _groups(self, connection: Any, when: float, data: bytes) -> None:
        message = self._message(connection, data)
        if not hasattr(message, "groups"):
            # REP-155: one message for each group; those of one stamp belong together.
            stamp, members = _stamp(message.header), frozenset(message.members)
            if self._record.groups and self._record.groups[-1][0] == stamp:
                self._record.groups[-1] = (stamp, (*self._record.groups[-1][1], members))
                return
            self._record.groups.append((stamp, (members,)))
            return
        self._record.groups.append((_stamp(message.header),
                                    tuple(frozenset(group.members) for group in message.groups)))

    def _confidence(self, connection: Any, when: float, data: bytes) -> None:
        person = connection.topic[len(PERSONS):].split("/")[0]
        self._record.confidence.setdefault(person, []).append((when, float(self._message(connection, data).data)))

    def _name(self, connection: Any, when: float, data: bytes) -> None:
        name = self._message(connection, data).data
        if name:
            self._record.names[connection.topic[len(PERSONS):].split("/")[0]] = name

    def _voice_id(self, connection: Any, when: float, data: bytes) -> None:
        voice = self._message(connection, data).data
        if voice:
            self._record.speakers[voice] = connection.topic[len(PERSONS):].split("/")[0]

    def _ids_of(self, series: List[Tuple[float, frozenset]]):
        def take(connection: Any, when: float, data: bytes) -> None:
            series.append((when, frozenset(self._message(connection, data).ids)))
        return take

    def _true_words(self, connection: Any, when: float, data: bytes) -> None:
        self._record.true_words.append(self._message(connection, data).data)

    def _speech(self, connection: Any, when: float, data: bytes) -> None:
        message = self._message(connection, data)
        voice = connection.topic[len(HUMANS + "voices/"):].split("/")[0]
        # Paper: each text replaces the one before it. REP-155: only what is finished.
        text = message.data if not hasattr(message, "final") else message.final
        if text:
            self._record.texts.append((when, voice, text))
        if not hasattr(message, "final"):
            self._record.said[voice] = [(when, message.data)]
        elif message.final:
            self._record.said.setdefault(voice, []).append((when, message.final))

    def _speaking(self, connection: Any, when: float, data: bytes) -> None:
        voice = connection.topic[len(HUMANS + "voices/"):].split("/")[0]
        self._record.speaking.setdefault(voice, []).append((when, bool(self._message(connection, data).data)))

    def _true(self, name: str):
        def take(connection: Any, when: float, data: bytes) -> None:
            message = self._message(connection, data)
            key = message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec
            frame = self._truth.setdefault(key, TruthFrame(_stamp(message.header)))
            if name == "persons":
                self._frame = message.header.frame_id or self._frame
                self._order[key] = list(message.ids)
            elif name == "visible":
                frame.visible = frozenset(message.ids)
            elif name == "heads":
                self._heads[key] = [(pose.position.x, pose.position.y, pose.position.z) for pose in message.poses]
            elif name == "gaze":
                frame.gaze = frozenset((gaze.sender, gaze.receiver) for gaze in message.gazes)
            else:
                frame.groups = tuple(frozenset(group.members) for group in message.groups)
        return take

    def _finish(self) -> Record:
        for key, frame in sorted(self._truth.items()):
            ids, heads = self._order.get(key), self._heads.get(key)
            if ids is None or heads is None or len(ids) != len(heads):
                continue        # a cycle that the bag holds in part
            frame.heads = dict(zip(ids, heads))
            self._record.truth.append(frame)
        for series in (self._record.gaze, self._record.groups):
            series.sort(key=lambda item: item[0])
        return self._record


def _stamp(header: Any) -> float:
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)


Place = Union[Sequence[float], np.ndarray]

_OURS = ("IdsList", "IdsMatch", "FacialActionUnits", "FacialLandmarks", "Skeleton2D", "NormalizedPointOfInterest2D",
         "GazeSenderReceiver", "GazesStamped", "Group", "GroupsStamped", "LiveSpeech")
_OTHERS: Mapping[str, str] = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "audio_common_msgs/msg/AudioData": "uint8[] data\n",
    "audio_common_msgs/msg/AudioInfo": "uint8 channels\nuint32 sample_rate\nstring sample_format\nuint32 "
                                       "bitrate\nstring coding_format\n"}
"""Types that the library does not bring with it, as the packages tf2_msgs and audio_common_msgs define them."""


def message_directory() -> Path:
    """Return hri_msgs/msg of the checkout or of the install space. Raises FileNotFoundError when there is none."""
    for parent in Path(__file__).resolve().parents:
        for folder in (parent / "hri_msgs" / "msg", parent / "share" / "hri_msgs" / "msg"):
            if (folder / "IdsList.msg").is_file():
                return folder
    raise FileNotFoundError("there is no hri_msgs/msg above {}; install hri_msgs beside hri_pipeline".format(__file__))


def type_store() -> Any:
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
        self._connections: Dict[str, Any] = {}

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
            self._connections[topic] = self._writer.add_connection(topic, name, typestore=self._store,
                                                                   latching=int(latched))
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

    def poses(self, topic: str, poses: Iterable[Pose], stamp: float) -> None:
        """Write a geometry_msgs/PoseArray."""
        name = "geometry_msgs/msg/PoseArray"
        made = [self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", *map(float, pose.translation)),
                          self.make("geometry_msgs/msg/Quaternion", *map(float, pose.quaternion))) for pose in poses]
        self.write(topic, name, self.make(name, self.header(stamp), made), stamp)

    def transforms(self, topic: str, frames: Iterable[Tuple[str, str, Pose]], stamp: float, when: float = -1.0) -> None:
        """Write frames (parent, child, pose of the child in the parent) at `when`, or at their stamp.

        /tf_static is latched.
        """
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
