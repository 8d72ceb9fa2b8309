"""Breaks a running stack in every way, one after the other, with people in view, and notes how soon all is well again.

Usage: fault_runs.py WORLD FILE [ONLY]    WORLD: simulated, real, vision or disk; ONLY: a part of the names of faults.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Callable, Dict, List, Optional, Set, Tuple

import processes
import rosgraph
import rospy

from benchmarks.fault_disk import FullDisk, small_disk
from benchmarks.fault_people import People
from benchmarks.fault_stack import (
    PATIENCE_S,
    RECOGNISER,
    FaultStack,
    Fixture,
    fault_graph,
    fixture,
    odd_processes,
    unplugged_for,
)
from benchmarks.faults import NEVER, Recovery
from benchmarks.garbage import Garbage

CLEAN_S = 30.0          # topics of somebody who has just gone are closed a moment later
FLOOD_S = 4.0
FLOOD_MESSAGES = 150    # on each topic
FLOOD_BYTES = 1.5e8     # on each topic
UNPLUGGED_S = 3.0
_LOOK_S = 0.5
Condition = Callable[[float], bool]


class FaultRun:
    """A running stack, and the faults. Raises RuntimeError when its people do not appear at all."""

    def __init__(self, stack: FaultStack, scene: Fixture, only: str = "") -> None:
        self._stack, self._scene, self._only = stack, scene, only
        self._store = stack.folder / "people" / "people.sqlite"
        self.times: Dict[str, Recovery] = {}
        self.let_go: Optional[float] = None
        self._left: Dict[str, List[str]] = {}
        self._restarted: Set[str] = set()
        stack.launch("stack", scene.stack.format(store=self._store))
        stack.launch("source", scene.source)
        rospy.init_node("faults", disable_signals=True)
        self.people = People()

    def run(self) -> Dict[str, object]:
        """Break everything; returns the times by fault, and what was left behind."""
        self._settle()
        known = self._stored()
        for name, fault in self._faults():
            if self._only in name:
                self._break(name, fault)
        self.people.close()
        lost = sorted(known - self._stored())
        return {"people": sorted(self.people.wanted), "recovery_s": self.times,
                "let_go_after_unplugging_s": self.let_go,
                "nodes_ended_by_garbage": sorted(self._restarted), "left_after": self._left, "lost_from_store": lost,
                "stored": sorted(known),
                "problems_told": {name: texts for name, texts in sorted(self.people.problems.items()) if texts}}

    def _settle(self) -> None:
        self.people.settle(self._scene.count, self._scene.names)
        if not processes.wait_until(lambda: not fault_graph.silent_nodes(), PATIENCE_S):
            raise RuntimeError("nodes do not answer: {}".format(sorted(fault_graph.silent_nodes())))
        self._parameters, self._running = fault_graph.parameters(), self._stack.running()

    def _break(self, name: str, fault: Callable[[], Recovery]) -> None:
        self.times[name] = fault()
        found = self._what_stays()
        if found:
            self._left[name] = found
        print("{}: {}{}".format(name, self.times[name], "; left: {}".format(found) if found else ""), file=sys.stderr,
              flush=True)

    def _what_stays(self) -> List[str]:
        """What is left over each time that it is looked at, for CLEAN_S: people come and go while one looks."""
        stays, deadline = set(self._leftovers()), time.monotonic() + CLEAN_S
        while stays and time.monotonic() < deadline:
            unplugged_for(_LOOK_S)
            stays &= set(self._leftovers())
        return sorted(stays)

    def _leftovers(self) -> List[str]:
        """Parameters, topics, registrations and processes that should not be there, or are there no more."""
        living = self.people.living()
        found = fault_graph.left(self._parameters, living)
        return [*("parameter " + name for name in found.parameters), *("topic " + name for name in found.topics),
                *("node " + name for name in found.nodes),
                *("process " + name for name in odd_processes(self._stack.running(), self._running,
                                                              living.get("bodies", set())))]

    def _faults(self) -> List[Tuple[str, Callable[[], Recovery]]]:
        found: List[Tuple[str, Callable[[], Recovery]]] = []
        for node in (*self._scene.nodes, *self._scene.sources):
            found.append(("kill " + node, lambda node=node: self._kill(node, self._sign_of_life(node))))
        if self._scene.skeletons:
            found.append(("kill robot_state_publishers", self._kill_skeletons))
        if self._scene.hears:
            found.append(("kill the recogniser of speech", self._kill_recogniser))
        found.append(("unplug", self._unplug))
        found += [("flood " + topic, lambda topic=topic, kind=kind: self._flood(topic, kind)) for topic,
                  kind in self._inputs().items()]
        return found + [("restart the master", self._restart_master)]

    def _sign_of_life(self, node: str) -> Condition:
        """What a node has to have done since it came back, beside what all is well means."""
        people = self.people
        if node == "/hri_person_manager":
            return people.told_anew
        if node == "/hri_face_body_matcher":
            return people.matched_by(node)
        if node in ("/hri_voices", "/sound_source"):
            return people.voices_come
        if node == "/hri_voice_matcher":
            # The recorded speech is of nobody in the photograph.
            return people.reported_by(node) if self._scene.hears else people.voice_found
        return lambda since: True   # the others show in the persons

    def _kill(self, node: str, also: Condition) -> Recovery:
        """Kill a node, which roslaunch starts again; time until another process has it and all is well."""
        began = time.monotonic()
        old = self._stack.kill_node(node)
        if old is None or not processes.wait_until(lambda: fault_graph.pid_of(node) not in (None, old), PATIENCE_S):
            return NEVER
        return self.people.until_whole(began, also)

    def _kill_skeletons(self) -> Recovery:
        """Kill all robot_state_publishers; time until there are others."""
        nodes, began = {name for name in fault_graph.nodes() if name.startswith("/rsp_")}, time.monotonic()
        old = {self._stack.kill_node(node) for node in nodes}
        if not old:
            return NEVER

        def again(since: float) -> bool:
            wanted = {"/rsp_" + body for body in self.people.tracked.get("bodies", ())}
            pids = {fault_graph.pid_of(node) for node in wanted}
            return None not in pids and not pids & old
        return self.people.until_whole(began, again)

    def _kill_recogniser(self) -> Recovery:
        began, old = time.monotonic(), self._stack.pids_of(RECOGNISER)
        for pid in old:
            os.kill(pid, signal.SIGKILL)
        return (
            self.people.until_whole(began, lambda since: bool(set(self._stack.pids_of(RECOGNISER)) - set(old)))
            if old
            else NEVER
        )

    def _unplug(self) -> Recovery:
        """The sources stop; once everybody has been let go they come back; the time counts from when they are there."""
        self._stack.end("source")
        stopped = time.monotonic()
        if processes.wait_until(self.people.all_gone, PATIENCE_S):
            self.let_go = round(time.monotonic() - stopped, 2)
        unplugged_for(UNPLUGGED_S)
        self._stack.launch("source", self._scene.source)
        if not processes.wait_until(lambda: all(fault_graph.pid_of(node) is not None for node in self._scene.sources),
                                    PATIENCE_S):
            return NEVER
        return self.people.until_whole(time.monotonic())

    def _flood(self, topic: str, kind: str) -> Recovery:
        """Garbage on one topic; time from its end."""
        import roslib.message
        before = {node: fault_graph.pid_of(node) for node in self._scene.nodes}
        message_class = roslib.message.get_message_class(kind)
        garbage = Garbage(topic, message_class, "depth" in topic, known=self._known_frames() if topic == "/tf" else ())
        publisher = rospy.Publisher(topic, message_class, queue_size=10)
        processes.wait_until(lambda: publisher.get_num_connections() > 0, 5.0)
        began, sent = time.monotonic(), 0
        for number in range(FLOOD_MESSAGES):
            message = garbage.message()
            data = getattr(message, "data", b"")
            sent += len(data) if isinstance(data, (bytes, str)) else 0
            if time.monotonic() - began > FLOOD_S or sent > FLOOD_BYTES:
                break
            publisher.publish(message)
            if number % 10 == 9:
                time.sleep(0.02)
        unplugged_for(0.5)      # the last ones are on their way
        publisher.unregister()
        recovery = self.people.until_whole(time.monotonic(),
                                           self.people.voices_come if "audio" in topic else lambda since: True)
        # Who is busy with the last of it does not answer at once.
        processes.wait_until(lambda: all(fault_graph.pid_of(node) is not None for node in before), 5.0)
        self._restarted |= {node for node, pid in before.items() if fault_graph.pid_of(node) != pid}
        return recovery

    def _known_frames(self) -> List[str]:
        """Frames of those who are there."""
        tracked = self.people.tracked
        return [prefix + name for prefix,
                kind in (("face_", "faces"), ("gaze_", "faces"), ("body_", "bodies"), ("head_", "bodies"),
                         ("person_", "persons")) for name in tracked.get(kind, ())]

    def _restart_master(self) -> Recovery:
        from hri_pipeline.ros.master import MasterWatch
        watch, began = MasterWatch(0.5), time.monotonic()
        self._stack.restart_master()
        try:
            everybody = (*self._scene.nodes, *self._scene.sources)
            if not processes.wait_until(lambda: all(fault_graph.pid_of(node) is not None for node in everybody),
                                        PATIENCE_S):
                return NEVER
            # A new master has no parameters but those that nodes set themselves; their own have to be among them.
            own = (*(node + "/" for node in everybody), "/humans/")
            self._parameters = fault_graph.parameters() | {name for name in self._parameters if name.startswith(own)}
            return self.people.until_whole(began)
        finally:
            watch.close()

    def _inputs(self) -> Dict[str, str]:
        """Topics that the nodes listen to, one of each kind of id, and their types; only those of sensors where the
        scene says so."""
        master = rosgraph.Master("/faults")
        types, found, seen = dict(master.getTopicTypes()), {}, set()
        for topic, nodes in sorted(master.getSystemState()[1]):
            words = topic.split("/")
            shape = (
                tuple(words[:3] + ["ID"] + words[4:])
                if topic.count("/") == 4 and topic.startswith("/humans/")
                else topic
            )
            if set(nodes) & set(self._scene.nodes) and shape not in seen and types.get(topic, "*") != "*" \
                    and not topic.startswith(self._scene.not_flooded):
                seen.add(shape)
                found[topic] = types[topic]
        return found

    def _stored(self) -> Set[str]:
        """Ids in the store, as soon as those who are there are; a record is written some time after somebody is met."""
        from hri_pipeline.core.recognition.store import PersonStore

        def ids() -> Set[str]:
            if not self._store.is_file():
                return set()
            store = PersonStore(self._store)
            try:
                return {record.id for record in store.load_records()}
            finally:
                store.close()
        processes.wait_until(lambda: set(self.people.wanted) <= ids(), 15.0)
        return ids()


def main(arguments: List[str]) -> int:
    """Run a world and write what was found, or the error, as JSON."""
    name, path, only = arguments[0], Path(arguments[1]), (arguments[2:] + [""])[0]
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(143))
    disk = small_disk() if name == "disk" else None
    stack = FaultStack(disk.path if disk is not None else None)
    found: Dict[str, object] = {}
    try:
        scene = fixture(name, stack.folder)
        try:
            found = FaultRun(stack, scene, only).run() if disk is None else FullDisk(stack, scene, disk).run()
        except RuntimeError as error:
            found = {"error": "{}; roslaunch: {}".format(error, stack.last_lines())}
        text = stack.said()
        found["tracebacks_in_log"] = text.count("Traceback (most recent call last)")
        found["first_traceback"] = text[text.index("Traceback"):][:1500] if found["tracebacks_in_log"] else ""
    finally:
        stack.close()
        if disk is not None:
            disk.close()
    path.write_text(json.dumps(found), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
