"""What a bag tells of people, and of the truth where it holds that; read with the `rosbags` library, without ROS."""

from __future__ import annotations

import bisect
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Dict, List, Optional, Tuple, Union

import numpy as np

from hri_pipeline.core.frame_tree import is_of_human
from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.tf_scan import read, scan

HUMANS = "/humans/"
KINDS = ("faces", "bodies", "voices")
PERSONS = HUMANS + "persons/"
INTERACTIONS = "/humans/interactions/"
_PERSON_FRAME = b"person_"
_MAX_CHAIN = 16


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
    """Places of one person frame. stamps: s, ascending; places: (x, y, z) m in the truth's frame; ages: s from stamp to bag."""

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

    listed: tracked ids by kind (faces, bodies, voices); counted: the same of the truth, where it counts (recordings of pictures).
    said: texts by voice: the last one (String), or all that are finished (LiveSpeech). true_words: the sentences of the truth.
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
    messages: Counter = field(default_factory=Counter)
    foreign_frames: int = 0
    damaged: int = 0


def read_bag(path: Union[str, Path], truth: str = "/scene/truth") -> Record:
    """Read a bag. truth: namespace of the truth. Raises RecordError when the file is no bag of ROS 1 or holds nothing."""
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.rosbag1 import ReaderError

    file = Path(path).expanduser()
    if not file.is_file():
        raise RecordError("{}: there is no such bag".format(file))
    if file.suffix != ".bag":
        raise RecordError("{}: the name of a ROS 1 bag ends in .bag".format(file))
    try:
        with AnyReader([file]) as reader:
            return _Reading(reader, truth.rstrip("/")).record()
    except (AnyReaderError, ReaderError) as error:
        raise RecordError("{}: {}".format(file, error)) from error


class _Reading:
    """One pass over a bag; transforms of robots are kept to bring persons into the truth's frame."""

    def __init__(self, reader: object, truth: str) -> None:
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
        for kind in KINDS:
            topics[HUMANS + kind + "/tracked"] = self._ids_of(self._record.listed.setdefault(kind, []))
            topics["{}/{}".format(self._namespace, kind)] = self._ids_of(self._record.counted.setdefault(kind, []))
        for connection, nanoseconds, data in self._reader.messages():
            self._record.messages[connection.topic] += 1
            take = topics.get(connection.topic)
            if take is None and connection.topic.endswith("/location_confidence"):
                take = self._confidence
            elif take is None and connection.topic.startswith(HUMANS + "voices/") and connection.topic.endswith("/speech"):
                take = self._speech
            if take is None:
                continue
            try:
                take(connection, nanoseconds * 1e-9, bytes(data))
            except (ValueError, AssertionError, IndexError, UnicodeDecodeError):
                self._record.damaged += 1
        return self._finish()

    def _message(self, connection: object, data: bytes) -> object:
        return self._reader.deserialize(data, connection.msgtype)

    def _tf(self, connection: object, when: float, data: bytes) -> None:
        for child, offset in scan(data):
            name = child.lstrip(b"/")
            if name.startswith(_PERSON_FRAME):
                self._place(when, read(data, offset))
            elif not is_of_human(child, connection.topic == "/tf_static"):
                found = read(data, offset)
                self._robot[found.child] = (found.parent, Pose.from_quaternion(found.rotation, found.translation))

    def _place(self, when: float, found: object) -> None:
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

    def _tracked(self, connection: object, when: float, data: bytes) -> None:
        self._record.tracked.append((when, frozenset(self._message(connection, data).ids)))

    def _gaze(self, connection: object, when: float, data: bytes) -> None:
        message = self._message(connection, data)
        pairs = frozenset((gaze.sender, gaze.receiver) for gaze in message.gazes)
        self._record.gaze.append((_stamp(message.header), pairs))

    def _groups(self, connection: object, when: float, data: bytes) -> None:
        message = self._message(connection, data)
        if not hasattr(message, "groups"):
            # REP-155: one message for each group; those of one stamp belong together.
            stamp, members = _stamp(message.header), frozenset(message.members)
            if self._record.groups and self._record.groups[-1][0] == stamp:
                self._record.groups[-1] = (stamp, (*self._record.groups[-1][1], members))
                return
            self._record.groups.append((stamp, (members,)))
            return
        self._record.groups.append((_stamp(message.header), tuple(frozenset(group.members) for group in message.groups)))

    def _confidence(self, connection: object, when: float, data: bytes) -> None:
        person = connection.topic[len(PERSONS):].split("/")[0]
        self._record.confidence.setdefault(person, []).append((when, float(self._message(connection, data).data)))

    def _ids_of(self, series: List[Tuple[float, frozenset]]):
        def take(connection: object, when: float, data: bytes) -> None:
            series.append((when, frozenset(self._message(connection, data).ids)))
        return take

    def _true_words(self, connection: object, when: float, data: bytes) -> None:
        self._record.true_words.append(self._message(connection, data).data)

    def _speech(self, connection: object, when: float, data: bytes) -> None:
        message = self._message(connection, data)
        voice = connection.topic[len(HUMANS + "voices/"):].split("/")[0]
        # Paper: each text replaces the one before it. REP-155: only what is finished.
        if not hasattr(message, "final"):
            self._record.said[voice] = [(when, message.data)]
        elif message.final:
            self._record.said.setdefault(voice, []).append((when, message.final))

    def _true(self, name: str):
        def take(connection: object, when: float, data: bytes) -> None:
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


def _stamp(header: object) -> float:
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)
