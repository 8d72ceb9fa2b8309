"""Plays and records bags around the running stack, and looks at what it leaves in the graph."""

from __future__ import annotations

import signal
import subprocess
import threading
from pathlib import Path
from typing import Callable, Dict, List, Sequence, Set, Tuple, Union
from xmlrpc.client import Fault, ServerProxy

import rosgraph
import rospy
from rosgraph_msgs.msg import Log
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList
from hri_pipeline import testing

PATIENCE_S = 60.0   # a busy machine takes long to start a process
_END_S = 20.0
_LOOK_S = 0.05
SCENE_TOPICS = "|".join(("/tf", "/tf_static", "/scene/truth/.*", "/humans/[^/]*/tracked", "/humans/interactions/.*",
                         "/humans/persons/.*", "/humans/voices/.*/speech"))


def wait_for(condition: Callable[[], object], what: Union[str, Callable[[], str]],
             seconds: float = PATIENCE_S) -> object:
    """Return the first value of the condition that is true.

    Raises AssertionError, with `what`, after `seconds` of wall time.
    """
    return testing.wait_for(condition, seconds, what)


class _Process:
    """A child that close() ends: with SIGINT, so that a bag is closed, then without mercy."""

    def __init__(self, command: Sequence[str], name: str) -> None:
        self.name = "/" + name
        self._master = rosgraph.Master("/bag_stage")
        self._process = subprocess.Popen(list(command), stdin=subprocess.DEVNULL)

    def running(self) -> bool:
        """Tell whether it has not ended yet."""
        return self._process.poll() is None

    def close(self) -> None:
        """End it. Idempotent."""
        if self.running():
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def connections(self) -> Set[Tuple[str, str]]:
        """(topic, node at the other end) of every connection that the process has, by its own account."""
        try:
            uri = self._master.lookupNode(self.name)
            _, _, rows = ServerProxy(uri).getBusInfo("/bag_stage")
        except (OSError, rosgraph.MasterError, Fault):
            return set()
        return {(row[4], str(row[1])) for row in rows}


class Player(_Process):
    """`rosbag play --clock`, paused until go(). options: more for its command line, such as --loop and --rate 2."""

    def __init__(self, bag: Path, *options: str) -> None:
        super().__init__(["rosrun", "rosbag", "play", "--clock", "--hz", "100", "--quiet", "--pause", *options,
                          str(bag),
                          "__name:=player"], "player")

    def go(self, wanted: Sequence[Tuple[str, str]] = ()) -> None:
        """Play, as soon as each of these (topic, node) is connected."""
        rospy.wait_for_service("player/pause_playback", PATIENCE_S)
        missing: List[Tuple[str, str]] = []

        def connected() -> bool:
            listening = listeners()
            missing[:] = [pair for pair in wanted if pair[1] not in listening.get(pair[0], set())]
            there = {topic for topic, _ in self.connections()}
            missing.extend(pair for pair in wanted if pair[0] not in there and pair not in missing)
            return not missing
        try:
            wait_for(connected, "everybody listens")
        except AssertionError as error:
            raise AssertionError("{}; missing: {}".format(error, missing)) from error
        self.pause(False)

    def pause(self, still: bool) -> None:
        """Stop, or go on."""
        rospy.ServiceProxy("player/pause_playback", SetBool)(still)


class Recorder(_Process):
    """`rosbag record` of the topics that match."""

    def __init__(self, bag: Path, topics: str = SCENE_TOPICS) -> None:
        # Not the command rosbag: it ends on SIGINT before its child, the recorder, has closed the bag.
        super().__init__(["rosrun", "rosbag", "record", "--quiet", "-b", "0", "-O", str(bag), "-e", topics,
                          "__name:=recorder"],
                         "recorder")


class Ears:
    """Hears who is tracked, where persons are (parents: of their frames), and what nodes complain of."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.tracked: Dict[str, Tuple[str, ...]] = {}
        self.errors: List[str] = []
        self._stamps: Dict[str, float] = {}
        self.parents: Set[str] = set()
        self._subscribers = [rospy.Subscriber("/humans/{}/tracked".format(kind), IdsList, self._list, kind)
                             for kind in ("faces", "bodies", "voices", "persons")]
        self._subscribers += [rospy.Subscriber("/tf", TFMessage, self._tf, queue_size=200),
                              rospy.Subscriber("/rosout", Log, self._log, queue_size=200)]

    def persons(self) -> List[str]:
        """Return the persons tracked now, sorted."""
        return sorted(self.tracked.get("persons", ()))

    def placed(self, after: float, before: float = float("inf")) -> Set[str]:
        """Return the persons whose last frame has a stamp (s) between two times."""
        with self._lock:
            return {person for person, stamp in self._stamps.items() if after < stamp < before}

    def forget(self) -> None:
        """Forget the frames."""
        with self._lock:
            self._stamps.clear()

    def close(self) -> None:
        """Listen no more."""
        for subscriber in self._subscribers:
            subscriber.unregister()

    def _list(self, message: IdsList, kind: str) -> None:
        self.tracked[kind] = tuple(message.ids)

    def _tf(self, message: TFMessage) -> None:
        with self._lock:
            for item in message.transforms:
                if item.child_frame_id.startswith("person_"):
                    self._stamps[item.child_frame_id[len("person_"):]] = item.header.stamp.to_sec()
                    self.parents.add(item.header.frame_id)

    def _log(self, message: Log) -> None:
        if message.level >= Log.ERROR or "Traceback" in message.msg:
            self.errors.append("{}: {}".format(message.name, message.msg))


def listeners() -> Dict[str, Set[str]]:
    """Nodes that subscribe to each topic, as the master says."""
    _, subscribed, _ = rosgraph.Master("/bag_stage").getSystemState()
    return {topic: set(nodes) for topic, nodes in subscribed}


def orphans(kind: str, living: Sequence[str], but: Sequence[str] = ("/player",)) -> Set[str]:
    """Topics of ids of a kind that are not among the living, published by somebody else than the nodes `but`."""
    published, _, _ = rosgraph.Master("/bag_stage").getSystemState()
    prefix = "/humans/{}/".format(kind)
    return {topic for topic, nodes in published if topic.startswith(prefix) and topic.count("/") == 4
            and topic.split("/")[3] not in living and set(nodes) - set(but)}
