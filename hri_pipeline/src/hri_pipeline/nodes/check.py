"""The command `check`: says in words why nobody appears."""

from __future__ import annotations

import os
import sys
import threading
import time
from concurrent.futures import Future, wait
from dataclasses import replace
from typing import Counter, Dict, List, Optional, TextIO, Tuple

import genpy
import numpy as np
import rosgraph
import roslib.message
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph.names import ns_join
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo

from hri_msgs.msg import IdsList
from hri_pipeline.core.camera import Calibration, CameraError
from hri_pipeline.core.images import ImageError, other_transport
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.setup_check import (
    CHECK_PARAMETERS,
    CalibrationFacts,
    CheckSettings,
    Facts,
    Picture,
    Stream,
    as_text,
    check,
    is_well,
    own_cameras,
    stand_ins,
)
from hri_pipeline.models.catalogue import select
from hri_pipeline.ros.conversions import camera_from_info, compressed_to_bgr, image_to_bgr
from hri_pipeline.ros.master import IMAGE_TYPES, MasterAway, ask_master, is_alive, is_published
from hri_pipeline.ros.node import read_parameters
from hri_pipeline.ros.rospy_compat import release
from hri_pipeline.ros.tf import RobotTfListener

KINDS = ("persons", "faces", "bodies", "voices")
_ANSWER_S = 2.0
_ANY_FOV = 1.0
_PLACERS = ("hri_person_manager", "hri_interactions")
"""Nodes that have a reference frame."""
_MASTER = ("FAULT  no ROS master answers at {}: nothing runs there\n"
           "       -> roslaunch ros4hri ros4hri.launch, or set ROS_MASTER_URI to where it runs")

_MASTER_S = 1.0
_HELP = """Usage: rosrun hri_pipeline check [image:=TOPIC] [camera_info:=TOPIC] [_PARAMETER:=VALUE ...]
       rosrun hri_pipeline check --master      only see whether a master is there, and print its address

{} The exit code is 0 when people can appear.

Parameters:
{}"""


def main() -> int:
    """Look, print, and return the exit code: 0 when people can appear, 1 with a fault, 2 for wrong parameters."""
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(_HELP.format(CHECK_PARAMETERS.summary, "\n".join(
            "  _{}:={}  {}".format(one.name, one.default, one.doc) for one in CHECK_PARAMETERS.parameters)))
        return 0
    if "--master" in sys.argv[1:]:
        return _tell_master()
    if not _master_answers():
        return 1
    rospy.init_node("hri_check", anonymous=True, disable_signals=True)
    try:
        settings = read_parameters(CHECK_PARAMETERS)
    except ParameterError as error:
        print(error, file=sys.stderr)
        return 2
    print("looking at the graph for some {:.0f} s ...".format(1.3 * settings.watch_time), flush=True)
    try:
        findings = check(_look(settings), settings)
    except KeyboardInterrupt:
        return 130
    finally:
        rospy.signal_shutdown("done")
    print(as_text(findings), flush=True)
    return 0 if is_well(findings) else 1


def _look(settings: CheckSettings) -> Facts:
    """Look in another thread, and end this process when the master goes: rospy would wait for it for ever."""
    looking: "Future[Facts]" = Future()

    def look() -> None:
        try:
            probe = GraphProbe(settings)
            try:
                facts = probe.look()
            finally:
                probe.close()
            looking.set_result(facts)
        except Exception as error:
            looking.set_exception(error)
    threading.Thread(target=look, name="look", daemon=True).start()
    while not looking.done():
        wait([looking], timeout=_MASTER_S)
        if not _master_answers():
            os._exit(1)
    if looking.exception() is not None and not _master_answers():
        os._exit(1)
    return looking.result()


def _tell_master() -> int:
    """Print the address of the master; the exit code. For check.launch: roslaunch would start a master of its own."""
    if not _master_answers(sys.stderr):
        return 1
    print(rosgraph.get_master_uri())
    return 0


def _master_answers(out: Optional[TextIO] = None) -> bool:
    """Tell whether the master answers within some seconds, and print it to `out` (standard output) if not."""
    try:
        ask_master("/hri_check")
    except MasterAway:
        print(_MASTER.format(rosgraph.get_master_uri()), file=out, flush=True)
        return False
    return True


class GraphProbe:
    """Listens for a while and tells what it has seen. close() lets go of all topics.

    settings: the values of CHECK_PARAMETERS. The topics are `image` and `camera_info`, to be remapped; without a
    remapping, those that the nodes of the stack say in /diagnostics that they listen to.
    """

    def __init__(self, settings: CheckSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._master = rosgraph.Master(rospy.get_name())
        self._counters: Dict[str, _Counter] = {}
        self._statuses: Dict[str, Tuple[int, str]] = {}
        self._inputs: Dict[str, str] = {}
        self._tracked = {kind: -1 for kind in KINDS}
        self._stand_ins: Dict[str, List[str]] = {}
        self._stand_ins = self._find_stand_ins()
        self._clock: Counter[str] = Counter()       # messages by sender
        self._subscribers = [
            rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=100),
            rospy.Subscriber("/clock", Clock, self._on_clock, queue_size=10)]
        self._subscribers += [rospy.Subscriber("/humans/{}/tracked".format(kind), IdsList, self._on_tracked,
                                               callback_args=kind, queue_size=1) for kind in KINDS]
        self._frames: Optional[RobotTfListener] = None

    def look(self) -> Facts:
        """Listen for the time that the settings say, and return what was seen."""
        reference = self._reference_frame()
        self._frames = RobotTfListener(reference)
        self._wait(min(2.0, 0.5 * self._settings.watch_time))       # the nodes tell their topics once a second
        image, info = self._topic("image"), self._topic("camera_info")
        self._count(image, info)
        self._wait(self._settings.watch_time)
        picture = self._picture(image)
        camera = self._settings.camera_frame or self._counters[image].frame
        publishing = self._publishing()
        with self._lock:
            return Facts(
                nodes={_shown(name): self._node(name) for name in self._wanted_nodes()},
                stand_ins={_shown(name): tuple(map(_shown, others)) for name, others in self._stand_ins.items()},
                own_cameras=tuple(map(_shown, own_cameras(dict(self._master.getSystemState()[0])))),
                publishing=tuple(sorted({name for names in publishing.values() for name in names})),
                managers=tuple(sorted(publishing.get("/humans/persons/tracked", ()))),
                image=self._image_stream(image), info=self._stream(info, "sensor_msgs/CameraInfo"),
                picture=picture, calibration=self._calibration(info),
                sim_time=bool(rospy.get_param("/use_sim_time", False)), clock_messages=sum(self._clock.values()),
                clocks=tuple(sorted(self._clock)),
                time=rospy.get_time(), wall_time=time.time(),
                camera_frame=camera, reference_frame=reference,
                tf_reaches=bool(camera) and self._frames.lookup(camera, genpy.Time()) is not None,
                models_missing=tuple(product.output for product in select(["default"])
                                     if not (models_directory() / product.output).is_file()),
                models_directory=str(models_directory()), statuses=dict(self._statuses), tracked=dict(self._tracked))

    def close(self) -> None:
        """Let go of everything. Idempotent."""
        for subscriber in self._subscribers:
            release(subscriber)
        for counter in self._counters.values():
            counter.close()
        if self._frames is not None:
            self._frames.close()

    def _reference_frame(self) -> str:
        """Return the reference frame of the nodes that run: their own parameter, else that of the whole stack."""
        placers = [other for name in map(rospy.resolve_name, _PLACERS) for other in self._stand_ins.get(name, [name])]
        for name in placers:
            own = rospy.get_param(name + "/reference_frame", "") if self._node(name) == "running" else ""
            if own:
                return str(own).lstrip("/")
        return str(rospy.get_param("/humans/reference_frame", "") or "map").lstrip("/")

    def _wait(self, seconds: float) -> None:
        """Wait in wall time: the clock of the graph may stand still."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not rospy.is_shutdown():
            time.sleep(0.05)

    def _topic(self, name: str) -> str:
        resolved = rospy.resolve_name(name)
        is_remapped = resolved not in ("/" + name, ns_join(rospy.get_namespace(), name))
        with self._lock:
            return resolved if is_remapped else self._inputs.get(name, resolved)

    def _count(self, *topics: str) -> None:
        for topic in topics:
            self._counters[topic] = _Counter(topic)

    def _wanted_nodes(self) -> List[str]:
        vision, *parts = map(rospy.resolve_name, ("hri_vision", "hri_faces", "hri_bodies"))
        names = [rospy.resolve_name(name) for name in self._settings.nodes]
        if self._node(vision) == "running":
            names = [vision] + [name for name in names if name not in parts]
        return list(dict.fromkeys(other for name in names for other in self._stand_ins.get(name, [name])))

    def _find_stand_ins(self) -> Dict[str, List[str]]:
        """Return the nodes of other names that do the work of wanted nodes that do not run, all names resolved.

        In a namespace those of this namespace: another robot's do not count.
        """
        published, subscribed, _ = map(dict, self._master.getSystemState())
        found = {name: stand_ins(name.rpartition("/")[2], published, subscribed)
                 for name in self._wanted_nodes() if self._node(name) == "absent"}
        own = {name: [other for other in others if other.startswith(rospy.get_namespace())]
               for name, others in found.items()}
        # Those that have crashed are told where no other one does the work.
        return {name: [other for other in others if self._node(other) == "running"] or others
                for name, others in own.items() if others}

    def _publishing(self) -> Dict[str, List[str]]:
        """Return who publishes what below /humans, under whatever name."""
        return {topic: names for topic, names in self._master.getSystemState()[0] if topic.startswith("/humans/")}

    def _node(self, name: str) -> str:
        """State of the node of this resolved name: running, dead or absent."""
        try:
            address = self._master.lookupNode(name)
        except rosgraph.MasterException:
            return "absent"
        if is_alive(address, _ANSWER_S):
            return "running"
        # The master keeps the address of a node that has asked for a parameter, after it has ended, too.
        registered = {node for kind in self._master.getSystemState() for _, nodes in kind for node in nodes}
        return "dead" if name in registered else "absent"

    def _image_stream(self, topic: str) -> Stream:
        other, transport = other_transport(topic)
        kind = next(kind for name, kind in IMAGE_TYPES.items() if name != transport)
        is_there = is_published(other, IMAGE_TYPES[transport], _ANSWER_S)
        return replace(self._stream(topic, kind), other=other if is_there else "")

    def _stream(self, topic: str, wanted: str) -> Stream:
        counter = self._counters[topic]
        publishers, _, _ = self._master.getSystemState()
        names = [name for found, nodes in publishers if found == topic for name in nodes]
        types = [kind for found, kind in self._master.getTopicTypes() if found == topic and names]
        unreachable = [name for name in names if self._node(name) != "running"]
        return Stream(topic, wanted, tuple(types), tuple(sorted(names)), tuple(unreachable), counter.messages,
                      counter.rate, counter.age, counter.frame)

    def _picture(self, topic: str) -> Optional[Picture]:
        message = self._counters[topic].message()
        if message is None or not hasattr(message, "data"):
            return None
        raw = hasattr(message, "encoding")
        name = message.encoding if raw else getattr(message, "format", "")
        try:
            image = image_to_bgr(message) if raw else compressed_to_bgr(message)
        except (ImageError, AttributeError) as error:
            return Picture(encoding=name, problem=str(error))
        grey = image[::4, ::4].mean(axis=2)
        return Picture(image.shape[1], image.shape[0], name, "", float(np.mean(grey)), float(np.std(grey)))

    def _calibration(self, topic: str) -> Optional[CalibrationFacts]:
        message = self._counters[topic].message()
        return calibration_facts(message) if isinstance(message, CameraInfo) else None

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        ours = {rospy.resolve_name(name).strip("/") for name in [*self._settings.nodes, "hri_vision"]}
        ours.update(other.strip("/") for others in self._stand_ins.values() for other in others)
        with self._lock:
            for status in message.status:
                if status.name.split(":")[0] in ours:
                    self._statuses[status.name] = (status.level, status.message)
                    for value in status.values:
                        if status.name.endswith(": input") and value.key in ("topic", "camera_info"):
                            self._inputs["image" if value.key == "topic" else "camera_info"] = value.value

    def _on_clock(self, message: Clock) -> None:
        with self._lock:
            self._clock[message._connection_header["callerid"]] += 1

    def _on_tracked(self, message: IdsList, kind: str) -> None:
        self._tracked[kind] = len(message.ids)


def calibration_facts(message: CameraInfo) -> CalibrationFacts:
    """Return what a camera_info says of the images that belong to it."""
    try:
        camera = camera_from_info(message, _ANY_FOV)
    except CameraError as error:
        return CalibrationFacts(message.width, message.height, message.K[0], str(error) if any(message.K) else "")
    focal = camera.matrix[0, 0] if camera.calibration is Calibration.CALIBRATED else 0.0
    return CalibrationFacts(camera.width, camera.height, float(focal))


def _shown(name: str) -> str:
    """Return a resolved name as the parameter `nodes` takes it, without a slash where it needs none."""
    return name if "/" in name[1:] else name[1:]


class _Counter:
    """Counts the messages of a topic of any type and keeps the last one."""

    def __init__(self, topic: str) -> None:
        self.messages = 0
        self.age: Optional[float] = None
        self.frame = ""
        self._first = self._last = 0.0
        self._raw: Optional[rospy.AnyMsg] = None
        self._subscriber = rospy.Subscriber(topic, rospy.AnyMsg, self._take, queue_size=1, buff_size=2 ** 24)

    @property
    def rate(self) -> float:
        """Messages per second between the first and the last one."""
        return (self.messages - 1) / (self._last - self._first) if self._last > self._first else 0.0

    def message(self) -> Optional[genpy.Message]:
        """Return the last message, None without one or when its type is not known here."""
        if self._raw is None:
            return None
        kind = roslib.message.get_message_class(self._raw._connection_header.get("type", ""))
        return None if kind is None else kind().deserialize(self._raw._buff)

    def close(self) -> None:
        release(self._subscriber)

    def _take(self, message: rospy.AnyMsg) -> None:
        now = time.monotonic()
        self._first = self._first or now
        self._last, self._raw, self.messages = now, message, self.messages + 1
        if self.messages == 1 or self.messages % 10 == 0:
            header = getattr(self.message(), "header", None)
            if header is not None:
                self.frame = header.frame_id.lstrip("/")
                stamp, here = header.stamp.to_sec(), rospy.get_time()
                self.age = here - stamp if stamp > 0.0 and here > 0.0 else None
