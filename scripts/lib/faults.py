"""What the stack does when something breaks, with three simulated people in view; `scripts/benchmark faults` prints it.

Each node is killed, the source of people stops and comes back, every input is flooded with garbage, the master is restarted. Told are the times (s)
until the same persons are there again, at places of now, with gazes of now; and until nobody else is.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path
from typing import BinaryIO, Dict, List, NamedTuple, Optional, Set, Union
from xmlrpc.client import ServerProxy

import processes
import rosgraph
import rospy

ROOT = Path(__file__).resolve().parents[2]
BAG_TESTS = ROOT / "rosbag_tests"
PEOPLE = ["ann", "bob", "cho"]
NODES = ("/hri_person_manager", "/hri_face_body_matcher", "/hri_voice_matcher", "/hri_interactions")
SOURCE = "/scene_simulator"
SOON_S = 5.0        # what is asked
PATIENCE_S = 60.0
TOPICS_S = 30.0
MEMORY = "/hri_person_manager_memory"   # what the person manager keeps on purpose across its own end
FLOOD_S = 4.0
FLOOD_MESSAGES = 150    # on each topic



class Recovery(NamedTuple):
    """Times (s) after a fault; None: not within PATIENCE_S. there: everybody is there again; alone: and nobody else."""

    there: Optional[float]
    alone: Optional[float]


NEVER = Recovery(None, None)
LAUNCH = """<launch>
  <include file="{tests}/people.launch">
    <arg name="respawn" value="true"/> <arg name="sim_time" value="false"/> <arg name="store" value="{store}"/>
  </include>
  <include file="$(find hri_pipeline)/launch/scene_simulator.launch">
    <arg name="scene" value="{tests}/three_stand.yaml"/> <arg name="respawn" value="true"/>
  </include>
</launch>
"""


def faults() -> Dict[str, object]:
    """Run everything on a master of its own; returns the times by fault (None: not within PATIENCE_S), and what was left behind."""
    folder = Path(tempfile.mkdtemp(prefix="ros4hri-faults-"))
    mark, port = "faults-" + uuid.uuid4().hex, processes.free_port()
    os.environ.update({"ROS_MASTER_URI": "http://127.0.0.1:{}".format(port), "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(folder / "ros"),
                       processes.MARK_NAME: mark})
    os.environ.pop("ROS_HOSTNAME", None)
    launch, store = folder / "faults.launch", folder / "people" / "people.sqlite"
    launch.write_text(LAUNCH.format(tests=BAG_TESTS, store=store), encoding="utf-8")
    try:
        with open(str(folder / "log"), "wb") as log:
            # Not the master of roslaunch, which ends everything with its master.
            _start(["rosmaster", "--core", "-p", str(port)], log)
            if not processes.wait_until(rosgraph.is_master_online, PATIENCE_S):
                raise RuntimeError("no master")
            _start(["roslaunch", str(launch)], log)
            try:
                found = _Faults(mark, store, port).run()
            except RuntimeError as error:
                raise RuntimeError("{}; roslaunch: {}".format(error, _last_lines(folder / "log"))) from error
        text = (folder / "log").read_text(encoding="utf-8", errors="replace")
        found["tracebacks_in_log"] = text.count("Traceback (most recent call last)")
        found["first_traceback"] = text[text.index("Traceback"):][:1500] if found["tracebacks_in_log"] else ""
        return found
    finally:
        processes.end(mark, {os.getpid()})
        shutil.rmtree(str(folder), ignore_errors=True)


class _Faults:
    """The faults one after the other, in a process that is a ROS node itself."""

    def __init__(self, mark: str, store: Path, port: int) -> None:
        sys.path.insert(0, str(BAG_TESTS))
        self._mark, self._store, self._port = mark, store, port
        self._gazes: List[float] = []

    def run(self) -> Dict[str, object]:
        """All faults. Raises RuntimeError when the people do not appear at all."""
        rospy.init_node("faults", disable_signals=True)
        from bag_stage import Ears, orphans

        from hri_msgs.msg import GazesStamped
        self._ears = Ears()
        gaze = rospy.Subscriber("/humans/interactions/gaze", GazesStamped, self._on_gaze)
        if self._until_whole(0.0).alone is None:
            raise RuntimeError("the people do not appear within {:g} s; tracked: {}".format(PATIENCE_S, self._ears.persons()))
        known, parameters, living = self._stored(), self._parameters(), self._processes()
        times: Dict[str, Recovery] = {}
        restarted: List[str] = []
        for name in (*NODES, SOURCE):
            times["kill " + name] = self._kill(name)
        pids = {name: self._pid(name) for name in NODES}
        for topic, kind in self._inputs().items():
            times["flood " + topic] = self._flood(topic, kind)
        restarted += [name for name, pid in pids.items() if self._pid(name) != pid]
        left, new = sorted(self._parameters() ^ parameters), sorted(self._processes() ^ living)

        def topics() -> List[str]:
            living = [*self._known(), *self._ears.persons()]
            return sorted(topic for topic in orphans("persons", living, but=()) if _alias(topic.split("/")[3]) not in living)
        # Topics of somebody who has just gone are closed a moment later.
        processes.wait_until(lambda: not topics(), TOPICS_S)
        open_topics = topics()
        times["restart the master"] = self._restart_master()
        gaze.unregister()
        self._ears.close()
        return {"recovery_s": times, "nodes_ended_by_garbage": restarted, "parameters_left": left, "processes_left": new,
                "topics_left": open_topics, "lost_from_store": sorted(known - self._stored()), "stored": sorted(known)}

    def _kill(self, name: str) -> Recovery:
        """Kill a node, which roslaunch starts again; time until another process has it and all is well."""
        old, began = self._pid(name), time.monotonic()
        if old is None:
            return NEVER
        os.kill(old, signal.SIGKILL)
        if not processes.wait_until(lambda: self._pid(name) not in (None, old), PATIENCE_S):
            return NEVER
        return self._until_whole(began)

    def _flood(self, topic: str, kind: str) -> Recovery:
        """Garbage on one topic; time from its end."""
        import roslib.message
        from faults_fuzz import Fuzz
        fuzz = Fuzz(len(topic), [*PEOPLE, *(name for names in self._ears.tracked.values() for name in names)] if topic == "/tf" else ())
        message_class = roslib.message.get_message_class(kind)
        publisher = rospy.Publisher(topic, message_class, queue_size=FLOOD_MESSAGES)
        processes.wait_until(lambda: publisher.get_num_connections() > 0, 5.0)
        began = time.monotonic()
        for number in range(FLOOD_MESSAGES):
            if time.monotonic() - began > FLOOD_S:
                break
            publisher.publish(fuzz.message(message_class))
            if number % 10 == 9:
                time.sleep(0.02)
        processes.wait_until(lambda: time.monotonic() - began > 0.5, 1.0)     # the last ones are on their way
        publisher.unregister()
        return self._until_whole(time.monotonic())

    def _restart_master(self) -> Recovery:
        from hri_pipeline.ros.master_watch import MasterWatch
        watch, began = MasterWatch(0.5), time.monotonic()
        for pid in processes.marked(self._mark, {os.getpid()}):
            if b"rosmaster" in _command(pid):
                os.kill(pid, signal.SIGKILL)
        processes.wait_until(lambda: not rosgraph.is_master_online(), PATIENCE_S)
        _start(["rosmaster", "--core", "-p", str(self._port)], subprocess.DEVNULL)
        try:
            if not processes.wait_until(lambda: all(self._pid(name) is not None for name in (*NODES, SOURCE)), PATIENCE_S):
                return NEVER
            return self._until_whole(began)
        finally:
            watch.close()

    def _until_whole(self, began: float) -> Recovery:
        """Times (s) from `began` (monotonic) until the persons are there, with frames and gazes of now, and until nobody else is."""
        now = rospy.get_time()
        self._ears.forget()
        self._gazes.clear()

        def whole() -> bool:
            return (set(PEOPLE) <= set(self._ears.persons()) and set(PEOPLE) <= self._ears.placed(now, rospy.get_time() + 0.5)
                    and any(stamp > now for stamp in self._gazes[-20:]))
        if not processes.wait_until(whole, PATIENCE_S):
            return NEVER
        there = round(time.monotonic() - began, 2)
        alone = processes.wait_until(lambda: whole() and self._ears.persons() == PEOPLE, PATIENCE_S)
        return Recovery(there, round(time.monotonic() - began, 2) if alone else None)

    def _on_gaze(self, message: object) -> None:
        if message.gazes:
            self._gazes.append(message.header.stamp.to_sec())

    def _inputs(self) -> Dict[str, str]:
        """Topics that the nodes listen to, one of each kind of id, and their types."""
        master = rosgraph.Master("/faults")
        types, found, seen = dict(master.getTopicTypes()), {}, set()
        for topic, nodes in sorted(master.getSystemState()[1]):
            words = topic.split("/")
            shape = tuple(words[:3] + ["ID"] + words[4:]) if topic.count("/") == 4 and topic.startswith("/humans/") else topic
            if set(nodes) & set(NODES) and shape not in seen and topic in types and not topic.startswith("/humans/persons/"):
                seen.add(shape)
                found[topic] = types[topic]
        return found

    def _pid(self, name: str) -> Optional[int]:
        try:
            code, _, pid = ServerProxy(rosgraph.Master("/faults").lookupNode(name)).getPid("/faults")
            return int(pid) if code == 1 else None
        except (OSError, rosgraph.MasterError, rosgraph.MasterException):
            return None

    def _processes(self) -> Set[str]:
        return {_name(pid) for pid in processes.marked(self._mark, {os.getpid()})}

    @staticmethod
    def _parameters() -> Set[str]:
        return {name for name in rosgraph.Master("/faults").getParamNames() if not name.startswith(("/roslaunch/", MEMORY))}

    @staticmethod
    def _known() -> List[str]:

        from hri_msgs.msg import IdsList
        return list(rospy.wait_for_message("/humans/persons/known", IdsList, PATIENCE_S).ids)

    def _stored(self) -> Set[str]:
        """Ids in the store, as soon as the three are there; a record is written some time after somebody is met."""
        from hri_pipeline.core.recognition.person_store import PersonStore

        def ids() -> Set[str]:
            if not self._store.is_file():
                return set()
            store = PersonStore(self._store)
            try:
                return {record.id for record in store.load_records()}
            finally:
                store.close()
        processes.wait_until(lambda: set(PEOPLE) <= ids(), 15.0)
        return ids()


def _alias(person: str) -> str:
    """Whom somebody was merged into: the topics of an alias stay as long as that person does."""
    from std_msgs.msg import String
    try:
        return str(rospy.wait_for_message("/humans/persons/{}/alias".format(person), String, 2.0).data)
    except rospy.ROSException:
        return ""


def _start(command: List[str], output: Union[int, BinaryIO]) -> None:
    """Start a process that ends with the run, by its mark."""
    subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=output)


def _last_lines(log: Path) -> str:
    return " | ".join(log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-12:])


def _command(pid: int) -> bytes:
    try:
        return Path("/proc/{}/cmdline".format(pid)).read_bytes()
    except OSError:
        return b""


def _name(pid: int) -> str:
    """What tells a process of this run from the others: its node name, or its program."""
    words = _command(pid).decode(errors="replace").split("\0")
    return next((word for word in words if word.startswith("__name:=")), " ".join(words[:3]))


def as_table(found: Dict[str, object]) -> str:
    """Return the figures for a person to read."""
    lines = ["{:48} {:>12} {:>12}  {}".format("fault", "all there, s", "alone, s", "within {:g} s".format(SOON_S))]
    for name, recovery in found["recovery_s"].items():
        lines.append("{:48} {:>12} {:>12}  {}".format(name, *("never" if seconds is None else "{:.2f}".format(seconds) for seconds in recovery),
                                                      "yes" if recovery.there is not None and recovery.there <= SOON_S else "NO"))
    lines += ["{:48} {}".format(name.replace("_", " "), value if value else "none") for name, value in found.items() if name != "recovery_s"]
    return "\n".join(lines)


def went_wrong(found: Dict[str, object]) -> bool:
    """Tell whether something did not come back, or was left behind."""
    return any(recovery.there is None for recovery in found["recovery_s"].values()) or any(found[name] for name in (
        "nodes_ended_by_garbage", "parameters_left", "processes_left", "topics_left", "lost_from_store"))


def as_json(found: Dict[str, object]) -> str:
    """Return the figures as one JSON object."""
    return json.dumps(dict(found, recovery_s={name: recovery._asdict() for name, recovery in found["recovery_s"].items()}))
