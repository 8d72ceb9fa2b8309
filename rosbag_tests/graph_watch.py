"""Hears everything under /humans, and all transforms, and keeps what a table of topics and frames can be compared
with."""

from __future__ import annotations

import io
import re
import socket
import threading
import time
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple
from urllib.parse import urlparse
from xmlrpc.client import ServerProxy

import numpy as np
import rosgraph
import roslib.message
import rospy
from audio_common_msgs.msg import AudioData
from interface_table import Topic, pattern_of
from rosgraph.network import read_ros_handshake_header, write_ros_handshake_header
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo
from tf2_msgs.msg import TFMessage

_PATIENCE_S = 5.0
_MOST_IDS = 9       # of each row; persons who turned out to be others stay for a while, as aliases
_KEPT = 200
URDF = "/human_description_"
OF_BODIES = "/rsp_"     # nodes whose parameters another node sets
_OF_ROS = ("/roslaunch/", "/rosdistro", "/rosversion", "/run_id", "/use_sim_time")


class Connection(NamedTuple):
    """What a publisher says of a topic before its first message."""

    type: str
    md5: str
    latched: bool


class Heard(NamedTuple):
    """One message: arrival (s), and the stamp (s) and frame of its header, None where its type has none."""

    arrival: float
    stamp: Optional[float]
    frame: Optional[str]
    message: Any


class GraphWatch:
    """look() finds new topics of the rows and listens to them; the rest comes by itself until close()."""

    def __init__(self, rows: List[Topic], parameters: Sequence[str] = ()) -> None:
        """parameters: names of a table, in which {body} and others stand for ids."""
        self.connections: Dict[str, List[Connection]] = {}
        self.messages: Dict[str, List[Heard]] = {}
        self.unknown: Set[str] = set()
        self.images: Set[float] = set()
        self.sounds: Set[float] = set()
        self.persons: Set[float] = set()
        self.first_sound: Optional[float] = None
        self.parents: Dict[str, Set[str]] = {}
        self.urdfs: Dict[str, str] = {}
        self.transforms: Dict[str, List[Tuple[float, bool, np.ndarray, np.ndarray]]] = {}
        self.values: Dict[str, Any] = {}
        self._others: Set[str] = set()
        self._nodes: Set[str] = set()
        self._rows = rows
        # A parameter that holds several values is told as so many names below it.
        self._parameters = [re.compile(pattern_of(name).pattern[:-1] + "(?=/|$)") for name in parameters]
        self._master = rosgraph.Master("/graph_watch")
        self._lock = threading.Lock()
        self._subscribers = [
            rospy.Subscriber("/camera/camera_info", CameraInfo,
                             lambda message: self.images.add(message.header.stamp.to_sec())),
            rospy.Subscriber("/microphone/audio", AudioData, self._on_sound),
            rospy.Subscriber("/tf", TFMessage, self._on_tf, callback_args=False, queue_size=500),
            rospy.Subscriber("/tf_static", TFMessage, self._on_tf, callback_args=True, queue_size=100)]

    def topics_of(self, row: Topic) -> List[str]:
        """Names of the topics of a row that were there."""
        return [name for name in self.connections if row.pattern.match(name)]

    def look(self) -> None:
        """Find what is new in the graph."""
        published = self._master.getSystemState()[0]
        there = {name for name, _ in published}
        for name, nodes in published:
            if not name.startswith("/humans/") or name in self.connections:
                continue
            row = next((row for row in self._rows if row.pattern.match(name)), None)
            if row is None or row.type is None:
                self.unknown.add(name)
            elif sum(topic in there for topic in self.topics_of(row)) < _MOST_IDS:
                self._meet(name, nodes, row)
        self._nodes |= {node + "/" for part in self._master.getSystemState() for _, nodes in part for node in nodes}
        for parameter in rospy.get_param_names():
            if parameter.startswith(URDF) and parameter not in self.urdfs:
                self.urdfs[parameter] = rospy.get_param(parameter, "")
            self._note_parameter(parameter)

    def close(self) -> None:
        """Listen no more."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    @property
    def unknown_parameters(self) -> Set[str]:
        """Parameters that are neither of the table nor private ones of a node, of which its own file is the table."""
        private = tuple(node for node in self._nodes if not node.startswith(OF_BODIES))
        return {name for name in self._others if not name.startswith(private + _OF_ROS)}

    def _note_parameter(self, parameter: str) -> None:
        """Keep its value where it is one of the table."""
        found = next(filter(None, (pattern.match(parameter) for pattern in self._parameters)), None)
        if found is not None:
            if found.group() not in self.values:
                value = rospy.get_param(found.group(), None)
                if value is not None:
                    self.values[found.group()] = value
        else:
            self._others.add(parameter)

    def _meet(self, name: str, nodes: List[str], row: Topic) -> None:
        try:
            found = [handshake(self._master.lookupNode(node), name) for node in nodes]
        except (OSError, rosgraph.MasterError, rosgraph.network.ROSHandshakeException, ValueError):
            return      # it has just gone, or is on its way
        self.messages[name] = []
        self.connections[name] = found
        self._subscribers.append(rospy.Subscriber(name, roslib.message.get_message_class(row.type), self._on_message,
                                                  callback_args=(name, row.source), queue_size=50))

    def _on_message(self, message: Any, which: Tuple[str, str]) -> None:
        name, source = which
        header = getattr(message, "header", None)
        heard = Heard(rospy.get_time(), header.stamp.to_sec() if header else None, header.frame_id if header else None,
                      message)
        with self._lock:
            if len(self.messages[name]) < _KEPT:
                self.messages[name].append(heard)
            if source == "sound" and heard.stamp:
                self.sounds.add(heard.stamp)

    def _on_sound(self, _: AudioData) -> None:
        if self.first_sound is None:
            self.first_sound = rospy.get_time()

    def _on_tf(self, message: TFMessage, fixed: bool) -> None:
        for item in message.transforms:
            turn, place = item.transform.rotation, item.transform.translation
            stamp, name = item.header.stamp.to_sec(), item.child_frame_id
            with self._lock:
                self.parents.setdefault(name, set()).add(item.header.frame_id)
                kept = self.transforms.setdefault(name, [])
                if name.startswith("voice_"):
                    self.sounds.add(stamp)
                elif name.startswith("person_"):
                    self.persons.add(stamp)
                if len(kept) == _KEPT:
                    del kept[0]
                kept.append((stamp, fixed, Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).as_matrix(),
                             np.array((place.x, place.y, place.z))))


def handshake(node: str, topic: str) -> Connection:
    """Ask the node at this address about a topic, as a subscriber does.

    Raises OSError or ValueError when it has no answer.
    """
    code, text, protocol = ServerProxy(node).requestTopic("/graph_watch", topic, [["TCPROS"]])
    if code != 1 or not protocol:
        raise ValueError(text)
    with socket.create_connection((protocol[1] or urlparse(node).hostname, protocol[2]), _PATIENCE_S) as connection:
        write_ros_handshake_header(connection, {"topic": topic, "type": "*", "md5sum": "*", "callerid": "/graph_watch"})
        header = read_ros_handshake_header(connection, io.BytesIO(), 65536)
    return Connection(header["type"], header["md5sum"], header.get("latching") == "1")


def wait_for(condition: Any, seconds: float, step: float = 0.2) -> bool:
    """Return whether the condition came true within the time."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(step)
    return True
