"""One stock robot_state_publisher per body, started and ended away from the thread of the images."""

from __future__ import annotations

import signal
import threading
import time
import traceback
from typing import Dict, Iterable, List, NamedTuple, Optional, Tuple

import rospy

from hri_fullbody.core.processes.child_process import ChildProcess
from hri_fullbody.core.processes.child_watch import ChildWatch
from hri_fullbody.ros.description_server import MASTER_ERRORS, DescriptionServer, description_name, node_name
from hri_fullbody.ros.publisher_binary import PublisherBinary
from hri_fullbody.ros.publisher_slot import Ending, Slot, Tally
from hri_pipeline.core.ids import ID_PATTERN, is_valid_id
from hri_pipeline.ros.diagnostics import OK, WARN

WATCH_S = 1.0
# Starting ten at once makes more connections than rospy and the master queue (5 each); what overflows comes 1 s later.
START_GAP_S = 0.02
_RETRY_S = 1.0
_LOG_PERIOD_S = 10.0
_CLOSE_S = 8.0
_IDLE_S = 60.0
# robot_state_publisher drops joint states that follow each other faster than this.
_LEAST_FREQUENCY_HZ = 50.0


class _Wanted(NamedTuple):
    urdf: str
    revision: int


class StatePublishers:
    """Keeps a robot_state_publisher running for each body that has been set.

        publishers = StatePublishers(limit=10, rate=15.0)
        publishers.set("abcde", urdf, revision)     # again when the revision has grown
        publishers.keep(["abcde"])                  # those who are not in the list lose theirs
        publishers.close()

    limit: most of them at a time; a body beyond it has none and is counted. rate: Hz of joint states that must come
    through. `set` and `keep` only note what is wanted: one thread of this object starts, watches, restarts and ends the
    processes and talks to the master. A process gets its URDF from /human_description_ID, is the node /rsp_ID, and reads
    /humans/bodies/ID/joint_states. It dies with this process, whatever kills it; the parameters that are left then are
    deleted by the next StatePublishers of any node.
    """

    def __init__(self, limit: int, rate: float = 0.0, binary: Optional[PublisherBinary] = None) -> None:
        self._limit = limit
        self._binary = binary or PublisherBinary()
        self._server = DescriptionServer(max(_LEAST_FREQUENCY_HZ, 2.0 * rate))
        self._lock = threading.Lock()
        self._wanted: Dict[str, _Wanted] = {}
        self._slots: Dict[str, Slot] = {}
        self._ending: List[Ending] = []
        self._undeleted: Dict[str, float] = {}
        self._tally = Tally()
        self._swept = False
        self._next_watch = self._next_sweep = self._next_start = 0.0
        self._closing = False
        self._children = ChildWatch()
        self._thread = threading.Thread(target=self._run, name="state publishers", daemon=True)
        self._thread.start()

    def set(self, body_id: str, urdf: str, revision: int) -> bool:
        """Give a body this URDF; one with an older or equal revision than the present one changes nothing.

        Returns False for a body beyond the limit. Raises ValueError for what is not an id.
        """
        if not is_valid_id(body_id):
            raise ValueError("{!r} is not an id ({}): no robot_state_publisher for it".format(body_id, ID_PATTERN))
        with self._lock:
            known = self._wanted.get(body_id)
            if known is None and len(self._wanted) >= self._limit:
                self._tally.count("beyond_limit")
                return False
            if known is None or revision > known.revision:
                self._wanted[body_id] = _Wanted(urdf, revision)
                self._children.wake()
        return True

    def revision(self, body_id: str) -> int:
        """Return the revision of the URDF that was set for a body, 0 when none was."""
        with self._lock:
            known = self._wanted.get(body_id)
            return 0 if known is None else known.revision

    def keep(self, ids: Iterable[str]) -> None:
        """End the robot_state_publishers of all others."""
        ids = set(ids)
        with self._lock:
            gone = [body_id for body_id in self._wanted if body_id not in ids]
            for body_id in gone:
                del self._wanted[body_id]
            if gone:
                self._children.wake()

    def status(self) -> Tuple[int, str, Dict[str, object]]:
        """Return level, message and values for diagnostics."""
        with self._lock:
            values: Dict[str, object] = {"wanted": len(self._wanted)}
        values["alive"] = sum(slot.child is not None for slot in list(self._slots.values()))
        values.update(self._tally.counts)
        problem = self._binary.problem or self._tally.problem
        if problem:
            return WARN, problem, values
        return OK, "{} robot_state_publishers".format(values["alive"]), values

    def close(self) -> None:
        """End all processes and delete their parameters. Idempotent."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
            self._wanted.clear()
            self._children.wake()
        self._thread.join(_CLOSE_S)
        if self._thread.is_alive():
            rospy.logwarn("the master hangs; parameters of bodies may be left until the next start")
            return
        self._children.close()

    # -- the thread

    def _run(self) -> None:
        while True:
            try:
                self._listen()
                with self._lock:
                    wanted, closing = dict(self._wanted), self._closing
                self._step(wanted, closing, time.monotonic())
                if closing and not self._slots and not self._ending:
                    return
            except Exception:  # whatever happens to one process, the others must be cared for
                rospy.logerr_throttle(_LOG_PERIOD_S, "robot_state_publishers: %s", traceback.format_exc())
                time.sleep(0.1)

    def _step(self, wanted: Dict[str, _Wanted], closing: bool, now: float) -> None:
        for body_id in [body_id for body_id in self._slots if body_id not in wanted]:
            self._end(self._slots.pop(body_id), now)
        for body_id, (urdf, revision) in wanted.items():
            slot = self._slots.setdefault(body_id, Slot(body_id))
            if slot.revision != revision:
                self._replace(slot, urdf, revision, now)
        for slot in self._slots.values():
            self._reap(slot, now)
        self._press(now)
        if not closing:
            self._sweep(now)
            self._start_one(now)
            self._watch(now)
        self._delete(now, closing)

    def _start_one(self, now: float) -> None:
        """Start one of those that are due, the one that waits longest, unless another was started just now."""
        due = [slot for slot in self._slots.values() if slot.child is None and now >= slot.due]
        if due and now >= self._next_start:
            self._next_start = now + START_GAP_S
            self._start(min(due, key=lambda slot: slot.due), now)

    def _start(self, slot: Slot, now: float) -> None:
        # Two processes of one name end each other: the master tells the elder to go, which on its way registers once
        # more (roscpp subscribes to a parameter before it logs), and so the younger is told to go too.
        for ending in self._ending:
            if ending.id == slot.id:
                ending.child.send(signal.SIGKILL)
        try:
            self._server.put(slot.id, slot.urdf)
        except MASTER_ERRORS as error:
            slot.due = now + _RETRY_S
            self._tally.note("body {}: its URDF is not on the parameter server: {}".format(slot.id, error))
            return
        path = self._binary.get()
        if path is None:
            slot.due = self._binary.next_try
            return
        try:
            slot.child = ChildProcess([
                path, "__ns:=/", "__name:=" + node_name(slot.id).strip("/"),
                "robot_description:=" + description_name(slot.id),
                "joint_states:=/humans/bodies/{}/joint_states".format(slot.id)])
        except OSError as error:
            self._binary.forget()
            slot.due = self._binary.next_try
            self._tally.note("{} does not start: {}".format(path, error))
            return
        slot.due = float("inf")
        self._children.add(slot.child)
        self._tally.count("started")

    def _replace(self, slot: Slot, urdf: str, revision: int, now: float) -> None:
        if slot.child is not None:
            self._ending.append(Ending(slot.id, slot.child, now))
            self._tally.count("replaced")
        slot.describe(urdf, revision, now)

    def _end(self, slot: Slot, now: float) -> None:
        if slot.child is not None:
            self._ending.append(Ending(slot.id, slot.child, now))
        self._undeleted[slot.id] = now

    def _reap(self, slot: Slot, now: float) -> None:
        child = slot.child
        code = None if child is None else child.poll()
        if child is None or code is None:
            return
        self._children.remove(child)
        said = ": " + child.last_words if child.last_words else ""
        slot.child = None
        if code == 1 and self._was_described(slot) and slot.failed_start(now - child.started):
            slot.due = float("inf")
            self._tally.count("urdf_refused")
            self._tally.note("robot_state_publisher refuses the URDF of body {}{}; it is not tried again".format(slot.id, said))
            return
        slot.due = now + slot.policy.ended(now - child.started)
        self._tally.count("restarted")
        self._tally.note("the robot_state_publisher of body {} has ended ({}){}; starting it again{}".format(
            slot.id, "signal {}".format(-code) if code < 0 else "code {}".format(code), said,
            " in {:.1f} s".format(slot.due - now) if slot.due > now else ""))

    def _was_described(self, slot: Slot) -> bool:
        try:
            return self._server.has(slot.id, slot.urdf)
        except MASTER_ERRORS:
            return False

    def _press(self, now: float) -> None:
        """Interrupt, then kill, those who shall end."""
        for ending in list(self._ending):
            if ending.child.poll() is None:
                ending.press(now)
                continue
            self._ending.remove(ending)
            self._children.remove(ending.child)

    def _delete(self, now: float, last_chance: bool) -> None:
        """Delete the parameters of bodies that have gone, once their processes have ended."""
        busy = {ending.id for ending in self._ending} | set(self._slots)
        for body_id, due in list(self._undeleted.items()):
            if body_id in self._slots:
                del self._undeleted[body_id]
            elif body_id not in busy and now >= due:
                try:
                    self._server.delete(body_id)
                    del self._undeleted[body_id]
                except MASTER_ERRORS as error:
                    self._undeleted[body_id] = now + _RETRY_S
                    self._tally.note("parameters of body {} are left: {}".format(body_id, error))

    def _watch(self, now: float) -> None:
        """Set a URDF again that somebody has deleted; start those anew that a new master does not know."""
        if now < self._next_watch:
            return
        self._next_watch = now + WATCH_S
        described = [slot for slot in self._slots.values() if slot.child is not None]
        if not described:
            return
        try:
            names = self._server.names()
            for slot in described:
                if node_name(slot.id) + "/owner/pid" not in names:
                    self._tally.note("the master does not know {} any more; starting it anew".format(node_name(slot.id)))
                    self._ending.append(Ending(slot.id, slot.child, now))
                    slot.child, slot.due = None, now
                    self._tally.count("restarted")
                elif description_name(slot.id) not in names:
                    self._server.put_description(slot.id, slot.urdf)
                    self._tally.note("{} had been deleted; it is set again".format(description_name(slot.id)))
                    self._tally.count("descriptions_restored")
        except MASTER_ERRORS as error:
            self._tally.note("the parameters of the bodies cannot be looked at: {}".format(error))

    def _sweep(self, now: float) -> None:
        """Clean up once after nodes that were killed."""
        if self._swept or now < self._next_sweep:
            return
        self._next_sweep = now + _RETRY_S
        try:
            cleaned = self._server.sweep(lambda text: rospy.logwarn("%s", text))
        except MASTER_ERRORS as error:
            self._tally.note("what dead nodes have left is still there: {}".format(error))
            return
        self._swept = True
        if cleaned:
            self._tally.count("left_by_dead_nodes", len(cleaned))

    def _listen(self) -> None:
        """Wait until something is wanted, a process says something or ends, or a time has come."""
        now = time.monotonic()
        times = [self._next_watch if self._slots else now + _IDLE_S]
        times += [max(slot.due, self._next_start) for slot in self._slots.values()] + [ending.next_press for ending in self._ending]
        times += [] if self._swept else [self._next_sweep]
        times += [] if self._ending else list(self._undeleted.values())
        self._children.wait(min(times) - now)
