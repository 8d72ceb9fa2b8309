"""One stock robot_state_publisher per body, started, watched and ended in a thread of its own."""

from __future__ import annotations

import signal
import threading
import time
import traceback
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Set

import roslib.packages
import rospkg
import rospy

from hri_pipeline.core.ids import ID_PATTERN, is_valid_id
from hri_pipeline.core.process import ChildProcess, RestartPolicy, identity_of, is_alive
from hri_pipeline.ros.diagnostics import OK, WARN, Status
from hri_pipeline.ros.master import (
    CALL_S,
    MASTER_ERRORS,
    address_of_node,
    end_node,
    node_at,
    patient_master,
    unregister_node,
)

PACKAGE = "robot_state_publisher"
MISSING = ("robot_state_publisher is not installed, so bodies have joint states but no skeleton frames; install it: "
           "`apt install ros-robot-state-publisher` on Debian, `apt install ros-noetic-robot-state-publisher` on "
           "Ubuntu")
NODE_PREFIX = "/rsp_"
DESCRIPTION_PREFIX = "/human_description_"
_OWNER = "/owner/pid"
COUNTS = ("started", "restarted", "replaced", "urdf_refused", "descriptions_restored", "beyond_limit",
          "left_by_dead_nodes")

_POLL_S = 0.1
_WATCH_S = 1.0
# Starting ten at once makes more connections than rospy and the master queue (5 each); what overflows comes 1 s later.
_START_GAP_S = 0.02
_RETRY_S = 1.0
_BINARY_RETRY_S = 30.0
_LOG_PERIOD_S = 10.0
_CLOSE_S = 8.0
# An interrupted process that has not ended after this time is killed.
_PATIENCE_S = 2.0
# How long a problem keeps the status at WARN; the counts stay.
_REMEMBERED_S = 30.0
# A process that ends with an error this soon did so because of its URDF; the second such failure in a row counts: the
# parameter may have been deleted in the moment of the first.
_START_S, _STRIKES = 5.0, 2
# robot_state_publisher drops joint states that follow each other faster than this.
_LEAST_FREQUENCY_HZ = 50.0


class _Wanted(NamedTuple):
    urdf: str
    revision: int


@dataclass
class _Publisher:
    """The robot_state_publisher of one body: its URDF, its process, and when it is to be started (monotonic s)."""

    id: str
    urdf: str = ""
    revision: int = 0
    child: Optional[ChildProcess] = None
    due: float = 0.0
    policy: RestartPolicy = field(default_factory=RestartPolicy)
    strikes: int = 0


@dataclass
class _Ending:
    """A process that shall end: interrupted at `due` (monotonic s), killed when that does not help.

    SIGTERM would leave roscpp nodes registered at the master; SIGINT does not.
    """

    id: str
    child: ChildProcess
    due: float
    number: signal.Signals = signal.SIGINT


class StatePublishers:
    """Keeps a robot_state_publisher running for each body that has been set.

        publishers = StatePublishers(limit=10, rate=15.0)
        publishers.set("abcde", urdf, revision)     # again when the revision has grown
        publishers.keep(["abcde"])                  # all others are ended
        publishers.close()

    limit: most of them at a time; a body beyond it has none and is counted. rate: Hz of joint states that must come
    through. package: holds the binary of the same name. `set` and `keep` only note what is wanted: one thread of this
    object starts, watches, restarts and ends the processes and talks to the master. A process gets its URDF from
    /human_description_ID, is the node /rsp_ID, and reads /humans/bodies/ID/joint_states. It dies with this process,
    whatever kills it; the parameters that are left then are deleted by the next StatePublishers of any node.
    """

    def __init__(self, limit: int, rate: float = 0.0, package: str = PACKAGE) -> None:
        self._limit, self._package = limit, package
        self._binary: Optional[str] = None
        self._binary_due, self._binary_missing = 0.0, False
        self._server = DescriptionServer(max(_LEAST_FREQUENCY_HZ, 2.0 * rate))
        self._lock = threading.Lock()
        self._wanted: Dict[str, _Wanted] = {}
        self._counts = dict.fromkeys(COUNTS, 0)
        self._problem, self._problem_at = "", float("-inf")
        # All below belongs to the thread.
        self._publishers: Dict[str, _Publisher] = {}
        self._ending: List[_Ending] = []
        self._undeleted: Dict[str, None] = {}
        self._swept = self._closing = False
        self._next_watch = self._next_sweep = self._next_start = self._next_delete = 0.0
        self._wake = threading.Event()
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
                self._counts["beyond_limit"] += 1
                return False
            if known is None or revision > known.revision:
                self._wanted[body_id] = _Wanted(urdf, revision)
                self._wake.set()
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
            self._wake.set()

    def status(self) -> Status:
        """Return level, message and values for diagnostics."""
        alive = sum(publisher.child is not None for publisher in list(self._publishers.values()))
        with self._lock:
            values: Dict[str, object] = {"wanted": len(self._wanted), "alive": alive, **self._counts}
            recent = time.monotonic() - self._problem_at < _REMEMBERED_S
            problem = MISSING if self._binary_missing else self._problem if recent else ""
        return (WARN, problem, values) if problem else (OK, "{} robot_state_publishers".format(alive), values)

    def close(self) -> None:
        """End all processes and delete their parameters. Idempotent."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
            self._wanted.clear()
        self._wake.set()
        self._thread.join(_CLOSE_S)
        if self._thread.is_alive():
            rospy.logwarn("the master hangs; parameters of bodies may be left until the next start")

    # -- the thread

    def _run(self) -> None:
        while True:
            try:
                self._wake.wait(self._pause())
                self._wake.clear()
                with self._lock:
                    wanted, closing = dict(self._wanted), self._closing
                self._step(wanted, closing, time.monotonic())
                if closing and not self._publishers and not self._ending:
                    return
            except Exception:  # whatever happens to one process, the others must be cared for
                rospy.logerr_throttle(_LOG_PERIOD_S, "robot_state_publishers: %s", traceback.format_exc())
                time.sleep(_POLL_S)

    def _pause(self) -> Optional[float]:
        """Time (s) until something is to be done; None: not before somebody sets or keeps."""
        if any(publisher.child is None and publisher.due <= self._next_start
               for publisher in self._publishers.values()):
            return _START_GAP_S
        return _POLL_S if self._publishers or self._ending or self._undeleted or not self._swept else None

    def _step(self, wanted: Dict[str, _Wanted], closing: bool, now: float) -> None:
        for body_id in [body_id for body_id in self._publishers if body_id not in wanted]:
            self._end(self._publishers.pop(body_id), now)
            self._undeleted[body_id] = None
        for body_id, (urdf, revision) in wanted.items():
            publisher = self._publishers.get(body_id)
            if publisher is None or publisher.revision != revision:
                if publisher is not None and self._end(publisher, now):
                    self._count("replaced")
                self._publishers[body_id] = _Publisher(body_id, urdf, revision, due=now)
        for publisher in self._publishers.values():
            self._reap(publisher, now)
        self._press(now)
        if not closing:
            self._sweep(now)
            self._start_one(now)
            self._watch(now)
        self._delete(now)

    def _start_one(self, now: float) -> None:
        """Start one of those that are due, the one that waits longest, unless another was started just now."""
        due = [publisher for publisher in self._publishers.values() if publisher.child is None and now >= publisher.due]
        if due and now >= self._next_start:
            self._next_start = now + _START_GAP_S
            self._start(min(due, key=lambda publisher: publisher.due), now)

    def _start(self, publisher: _Publisher, now: float) -> None:
        # Two processes of one name end each other: the master tells the elder to go, which on its way registers once
        # more (roscpp subscribes to a parameter before it logs), and so the younger is told to go too.
        for ending in self._ending:
            if ending.id == publisher.id:
                ending.child.send(signal.SIGKILL)
        publisher.due = now + _RETRY_S
        with self._noted("body {}: its URDF is not on the parameter server".format(publisher.id)):
            self._server.put(publisher.id, publisher.urdf)
            path = self._find_binary(now)
            publisher.due = self._binary_due
            if path is not None:
                self._spawn(publisher, path, now)

    def _spawn(self, publisher: _Publisher, path: str, now: float) -> None:
        try:
            publisher.child = ChildProcess([
                path, "__ns:=/", "__name:=" + node_name(publisher.id).strip("/"),
                "robot_description:=" + description_name(publisher.id),
                "joint_states:=/humans/bodies/{}/joint_states".format(publisher.id),
                # It searches tf_prefix for each joint state, and reads what it finds only where that exists.
                "~tf_prefix:=" + node_name(publisher.id) + "/no_tf_prefix"])
        except OSError as error:
            self._binary, self._binary_due = None, now + _BINARY_RETRY_S
            publisher.due = self._binary_due
            self._note("{} does not start: {}".format(path, error))
            return
        publisher.due = float("inf")
        self._count("started")

    def _find_binary(self, now: float) -> Optional[str]:
        """Path of the binary, looked for once, and again every half minute while it is missing."""
        if self._binary is None and now >= self._binary_due:
            self._binary_due = now + _BINARY_RETRY_S
            try:
                found = roslib.packages.find_node(self._package, self._package)
            except rospkg.ResourceNotFound:
                found = []
            self._binary = found[0] if found else None
            if self._binary is None and not self._binary_missing:
                rospy.logerr("%s", MISSING)
            self._binary_missing = self._binary is None
        return self._binary

    def _end(self, publisher: _Publisher, now: float) -> bool:
        """Let the process of a body end; returns whether there was one."""
        child, publisher.child = publisher.child, None
        if child is not None:
            self._ending.append(_Ending(publisher.id, child, now))
        return child is not None

    def _reap(self, publisher: _Publisher, now: float) -> None:
        """Notice that a process has ended; decide when it is started again."""
        child = publisher.child
        if child is None:
            return
        child.drain()
        code = child.poll()
        if code is None:
            return
        child.close()
        publisher.child = None
        uptime, said = now - child.started, ": " + child.last_line if child.last_line else ""
        if code == 1 and self._was_described(publisher):
            publisher.strikes = publisher.strikes + 1 if uptime < _START_S else 0
            if publisher.strikes >= _STRIKES:
                publisher.due = float("inf")
                self._count("urdf_refused")
                self._note("robot_state_publisher refuses the URDF of body {}{}; it is not tried again".format(
                    publisher.id, said))
                return
        publisher.due = now + publisher.policy.ended(uptime)
        self._count("restarted")
        self._note("the robot_state_publisher of body {} has ended ({}){}; starting it again{}".format(
            publisher.id, "signal {}".format(-code) if code < 0 else "code {}".format(code), said,
            " in {:.1f} s".format(publisher.due - now) if publisher.due > now else ""))

    def _was_described(self, publisher: _Publisher) -> bool:
        try:
            return self._server.has(publisher.id, publisher.urdf)
        except MASTER_ERRORS:
            return False

    def _press(self, now: float) -> None:
        """Interrupt, then kill, the processes that shall end."""
        for ending in list(self._ending):
            ending.child.drain()
            if ending.child.poll() is not None:
                ending.child.close()
                self._ending.remove(ending)
            elif now >= ending.due:
                ending.child.send(ending.number)
                ending.due, ending.number = now + _PATIENCE_S, signal.SIGKILL

    def _delete(self, now: float) -> None:
        """Delete the parameters of bodies that have gone, once their processes have ended."""
        ending = {ending.id for ending in self._ending}
        for body_id in self._undeleted.keys() & self._publishers.keys():
            del self._undeleted[body_id]
        if now < self._next_delete:
            return
        for body_id in [body_id for body_id in self._undeleted if body_id not in ending]:
            with self._noted("parameters of body {} are left".format(body_id)):
                self._server.delete(body_id)
                del self._undeleted[body_id]
                continue
            # While the master is away bodies leave all the time: one of them asks for all, each in its turn.
            self._undeleted[body_id] = self._undeleted.pop(body_id)
            self._next_delete = now + _RETRY_S
            return

    def _watch(self, now: float) -> None:
        """Set a URDF again that somebody has deleted; start those anew that a new master does not know."""
        running = [publisher for publisher in self._publishers.values() if publisher.child is not None]
        if now < self._next_watch or not running:
            return
        self._next_watch = now + _WATCH_S
        with self._noted("the parameters of the bodies cannot be read"):
            names = self._server.names()
            for publisher in running:
                node, description = node_name(publisher.id), description_name(publisher.id)
                if node + "/owner/pid" not in names:
                    self._note("the master does not know {} any more; starting it anew".format(node))
                    self._end(publisher, now)
                    publisher.due = now
                    self._count("restarted")
                elif description not in names:
                    self._server.put_description(publisher.id, publisher.urdf)
                    self._note("{} had been deleted; it is set again".format(description))
                    self._count("descriptions_restored")

    def _sweep(self, now: float) -> None:
        """Clean up once after nodes that were killed."""
        if self._swept or now < self._next_sweep:
            return
        self._next_sweep = now + _RETRY_S
        with self._noted("what dead nodes have left is still there"):
            cleaned = self._server.sweep()
            self._swept = True
            self._count("left_by_dead_nodes", len(cleaned))

    @contextmanager
    def _noted(self, what: str) -> Iterator[None]:
        """Note an error of the master in the body of a `with` statement as a problem: `what`, and the error."""
        try:
            yield
        except MASTER_ERRORS as error:
            self._note("{}: {}".format(what, error), _LOG_PERIOD_S)

    def _count(self, name: str, number: int = 1) -> None:
        with self._lock:
            self._counts[name] += number

    def _note(self, text: str, period: float = 0.0) -> None:
        """Log a problem, once in `period` s at most, and remember it for the status."""
        with self._lock:
            self._problem, self._problem_at = text, time.monotonic()
        rospy.logwarn_throttle(period, "%s", text) if period else rospy.logwarn("%s", text)


class DescriptionServer:
    """Sets and deletes `/human_description_ID` and the private parameters of `/rsp_ID`.

    `/rsp_ID/owner` names the process that they belong to, so that another one can clean up after it. All methods raise
    one of MASTER_ERRORS when the master does not answer. Not thread-safe: one thread owns it.
    """

    def __init__(self, publish_frequency: float) -> None:
        self._master = patient_master()
        # Frames of people are no part of a robot: without an own tf_prefix, that of the robot counts.
        self._private = {"publish_frequency": float(publish_frequency), "tf_prefix": "",
                         "owner": dict(identity_of(), node=rospy.get_name())}

    def put(self, body_id: str, urdf: str) -> None:
        """Set the parameters of a body; the owner first, so that nothing can be left without one."""
        self._master.setParam(node_name(body_id), self._private)
        self.put_description(body_id, urdf)

    def put_description(self, body_id: str, urdf: str) -> None:
        """Set the URDF alone."""
        self._master.setParam(description_name(body_id), urdf)

    def has(self, body_id: str, urdf: str) -> bool:
        """Tell whether the URDF is on the parameter server as it was set."""
        name = description_name(body_id)
        return bool(self._master.hasParam(name)) and self._master.getParam(name) == urdf

    def delete(self, body_id: str) -> None:
        """Delete the parameters of a body and the registrations of its node that it has not taken back itself."""
        unregister_node(node_name(body_id))
        for name in (description_name(body_id), node_name(body_id)):
            if self._master.hasParam(name):
                self._master.deleteParam(name)

    def names(self) -> Set[str]:
        """Names of all parameters."""
        return set(self._master.getParamNames())

    def sweep(self) -> List[str]:
        """Clean up after processes that died; return the ids of the bodies they have left.

        Their robot_state_publishers are shut down where they still run, registrations that nobody answers for are taken
        back, parameters deleted. What belongs to a process that lives, or may live, is not touched.
        """
        cleaned: List[str] = []
        lives: Dict[str, bool] = {}
        for name in sorted(self.names()):
            body_id = name[len(NODE_PREFIX):-len(_OWNER)]
            if not (name.startswith(NODE_PREFIX) and name.endswith(_OWNER) and is_valid_id(body_id)):
                continue
            owner = self._master.getParam(node_name(body_id) + "/owner")
            if not isinstance(owner, Mapping):
                continue
            key = repr(sorted(owner.items()))
            if key not in lives:
                lives[key] = _owner_lives(owner)
                if not lives[key]:
                    rospy.logwarn("%s (process %s on %s) has died; cleaning up after it",
                                  *(owner.get(part, "?") for part in ("node", "pid", "host")))
            if not lives[key]:
                end_node(node_name(body_id), "its body has gone")
                self.delete(body_id)
                cleaned.append(body_id)
        return cleaned


def description_name(body_id: str) -> str:
    """Name of the parameter that holds the URDF of a body."""
    return DESCRIPTION_PREFIX + body_id


def node_name(body_id: str) -> str:
    """Name of the robot_state_publisher of a body."""
    return NODE_PREFIX + body_id


def _owner_lives(owner: Mapping[str, object]) -> bool:
    """Tell whether an owner lives; on another host its node is asked, and one that does not answer may live."""
    alive = is_alive(owner)
    if alive is not None:
        return alive
    uri = address_of_node(str(owner.get("node", "")))
    if uri is None:
        return False
    try:
        return str(node_at(uri, CALL_S).getPid(rospy.get_name())[2]) == str(owner.get("pid"))
    except MASTER_ERRORS:
        return True
