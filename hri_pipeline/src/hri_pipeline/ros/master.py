"""The ROS master: questions to it and to other nodes, and what happens when it is started again.

All questions end after a time: rospy's own wait for a minute, or for ever. A new master has lost the parameters of the
nodes, which roslaunch sets only once: each node remembers its own, and puts them back.
"""

from __future__ import annotations

import contextlib
import copy
import http.client
import itertools
import os
import threading
import time
import uuid
from enum import Enum
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple
from xmlrpc.client import Fault, ProtocolError, ServerProxy

import rosgraph
import rospy

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.ros.rospy_compat import (
    TransportWithTimeout,
    not_registered,
    own_address,
    own_publications,
    own_services,
    own_subscriptions,
    register_without_waiting,
    unregister_closed,
)

ANSWER_S = 5.0
_PERIOD_S = 2.0
_ASK_EACH = 5       # looks at the connection to the master for one question, and one after the parameters
_LOOK_EACH = 15     # looks at the connection for one after the aggregator
AGGREGATOR = "hri_diagnostics"
"""The diagnostic_aggregator of diagnostics.launch, beside the node or without a namespace."""
IMAGE_TYPES = {"raw": "sensor_msgs/Image", "compressed": "sensor_msgs/CompressedImage"}
"""By transport."""
SHARED = "/humans"
# All that a call to the master can raise: refused, reset, half an answer, an answer that says no.
MASTER_ERRORS = (OSError, Fault, ProtocolError, http.client.HTTPException, rosgraph.MasterException)
CALL_S, _SHUTDOWN_S = 2.0, 1.5
"""Times (s) for one call of another node, and until a node that was shut down has left the master."""


class MasterAway(Exception):
    """The master does not answer; the text says why."""


class PublisherAnswer(Enum):
    """What a node says when it is asked whether it publishes a topic."""

    YES = "publishes"
    NO = "does not publish"
    REFUSED = "no process at its address"
    NONE = "no answer"


def node_at(uri: str, patience: float = ANSWER_S) -> ServerProxy:
    """Return the API of a node, or of the master; a call raises OSError where no answer comes for `patience` s."""
    return ServerProxy(uri, transport=TransportWithTimeout(patience))


def patient_master(name: str = "") -> rosgraph.Master:
    """Return the API of the master; a call raises OSError where no answer comes for ANSWER_S.

    name: of the node that asks, this one where it is empty.
    """
    master = rosgraph.Master(name or rospy.get_name())
    master.handle = node_at(rosgraph.get_master_uri())
    return master


def ask_master(name: str) -> Tuple[int, str]:
    """Return process id and run id of the master, asked in the name of a node; MasterAway without an answer in 5 s."""
    with contextlib.closing(MasterConnection()) as connection:
        return connection.ask(name)


class MasterConnection:
    """The connection over which the master is asked who it is. It is kept: that it has not ended says that the master
    is the same, and costs the master nothing. Not thread-safe."""

    def __init__(self) -> None:
        self._transport: Optional[TransportWithTimeout] = None

    def ask(self, name: str) -> Tuple[int, str]:
        """Return process id and run id of the master; raises as `ask_master` does."""
        try:
            self._transport = self._transport or TransportWithTimeout(ANSWER_S)
            master = ServerProxy(rosgraph.get_master_uri(), transport=self._transport)
            pid = int(master.getPid(name)[2])
            found, _, run_id = master.getParam(name, "/run_id")
        except Exception as error:      # refused, reset, half an answer, no address: it is away
            self.close()
            raise MasterAway(str(error)) from error
        return pid, str(run_id) if found == 1 else ""     # a bare rosmaster has no run id

    def is_open(self) -> bool:
        """Tell whether the master that was asked last still holds its end. That of one whose machine was switched off
        counts as open for some 5 s."""
        return self._transport is not None and self._transport.is_open()

    def close(self) -> None:
        """End it. Idempotent."""
        if self._transport is not None:
            self._transport.close()
        self._transport = None


def is_published(topic: str, kind: str, patience: float = ANSWER_S) -> bool:
    """Tell whether a topic of this type has a publisher; False where the master does not answer for `patience` s."""
    return type_of(topic, patience) == kind


def type_of(topic: str, patience: float = ANSWER_S) -> str:
    """Return the type of a topic that is published; empty where it is not, or the master does not answer."""
    try:
        with node_at(rosgraph.get_master_uri(), patience) as master:
            return str(dict(master.getPublishedTopics(rospy.get_name(), "")[2]).get(topic, ""))
    except Exception:   # refused, timed out, half an answer
        return ""


def parameter_of_subscribers(topics: Sequence[str], name: str, patience: float = ANSWER_S) -> List[object]:
    """Return the values of a private parameter of all nodes that subscribe to one of these topics and have it.

    Raises MasterAway without an answer in `patience` s.
    """
    own = rospy.get_name()
    try:
        with node_at(rosgraph.get_master_uri(), patience) as master:
            subscribed = master.getSystemState(own)[2][1]
            nodes = sorted({node for topic, nodes in subscribed if topic in topics for node in nodes})
            answers = [master.getParam(own, "{}/{}".format(node, name)) for node in nodes]
    except Exception as error:
        raise MasterAway(str(error)) from error
    return [value for code, _, value in answers if code == 1]


def is_alive(uri: str, patience: float = ANSWER_S) -> bool:
    """Tell whether a node answers at its address within `patience` s."""
    try:
        with node_at(uri, patience) as node:
            return node.getPid(rospy.get_name())[0] == 1
    except Exception:   # refused, timed out, unknown host, no answer in XML: all mean the same
        return False


def does_publish(uri: str, topic: str, patience: float = ANSWER_S) -> PublisherAnswer:
    """Ask the node at `uri` whether it publishes a topic, for `patience` s at most."""
    try:
        with node_at(uri, patience) as node:
            code, _, publications = node.getPublications(rospy.get_name())
        return PublisherAnswer.YES if code == 1 and topic in {name for name, _ in publications} else PublisherAnswer.NO
    except ConnectionRefusedError:
        return PublisherAnswer.REFUSED
    except Exception:   # timed out, no route, half an answer
        return PublisherAnswer.NONE


def subscribe_again(topic: str, kind: str) -> None:
    """Register a subscription of this node at the master once more, and connect to whoever publishes the topic.

    Connections that are there stay. Raises OSError, or what xmlrpc raises, where the master does not answer.
    """
    uri = own_address()
    if rospy.is_shutdown():     # another node may have taken over the name, which the master would end now
        return
    with node_at(rosgraph.get_master_uri()) as master, node_at(uri) as own:
        code, text, publishers = master.registerSubscriber(rospy.get_name(), topic, kind, uri)
        if code != 1:
            raise OSError("the master refuses to register the subscription to {}: {}".format(topic, text))
        own.publisherUpdate("/master", topic, publishers)


class ForeignNode:
    """A node beside the stack that does not register again when the master is started again, as roscpp's do not: the
    nodes of the stack tell the new master its topics in its place. Its parameters and services are not put back."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._address, self._pid = "", 0

    def look(self) -> None:
        """Remember where it is; nothing is forgotten where the master is away or does not know it."""
        own = rospy.get_name()
        try:
            with node_at(rosgraph.get_master_uri()) as master:
                code, _, address = master.lookupNode(own, self._name)
            if code == 1:
                with node_at(address) as node:
                    self._address, self._pid = address, node.getPid(own)[2]
        except Exception:       # the next time
            return

    def register(self) -> None:
        """Tell a new master its topics, where it still runs and nobody of its name is there."""
        own = rospy.get_name()
        if not self._address:
            return
        try:
            with node_at(rosgraph.get_master_uri()) as master, node_at(self._address) as node:
                if node.getPid(own)[2] != self._pid or master.lookupNode(own, self._name)[0] == 1:
                    return
                for topic, kind in node.getPublications(own)[2]:
                    _check(master.registerPublisher(self._name, topic, kind, self._address))
                for topic, kind in node.getSubscriptions(own)[2]:
                    _, _, publishers = master.registerSubscriber(self._name, topic, kind, self._address)
                    node.publisherUpdate("/master", topic, publishers)
        except Exception as error:      # it has ended, or the master has gone again
            rospy.loginfo("%s is not known to the new ROS master: %s", self._name, error)
            return
        rospy.loginfo("the new ROS master is told the topics of %s, too", self._name)


class MasterWatch:
    """Sees every two seconds whether the master has ended, and asks it who it is: then, and every ten seconds.

    rospy registers a topic once. A master that is started again knows nothing of the node, which then is
    deaf although it runs: its publishers, subscribers and services are registered again here, after its
    `parameters`, if any are given, were put back where nobody has set others. So is what was opened while the master
    did not answer. The aggregator of diagnostics.launch is registered again, too.
    """

    def __init__(self, period: float = _PERIOD_S, parameters: Optional[OwnParameters] = None) -> None:
        self._parameters = parameters
        names = sorted({rospy.resolve_name(AGGREGATOR), "/" + AGGREGATOR})
        self._aggregators = [ForeignNode(name) for name in names]
        register_without_waiting()
        self._connection = MasterConnection()
        snapshot = self._read()
        self._identity = self._ask()
        if self._identity is not None:
            self._keep(snapshot)
        self._away = False
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, args=(period,), name="master watch", daemon=True)
        self._thread.start()

    @property
    def away(self) -> bool:
        """Whether the master did not answer when it was asked last."""
        return self._away

    def close(self) -> None:
        """Stop watching; a master that did not answer is told once more what was closed. Idempotent."""
        self._closed.set()
        self._thread.join(timeout=5.0)
        if not self._thread.is_alive():
            self._connection.close()
        if not_registered.is_set():
            not_registered.clear()
            try:
                _take_back_closed(CALL_S)
            except Exception as error:      # it is still away
                rospy.logdebug("the ROS master may list topics that are closed: %s", error)

    def _watch(self, period: float) -> None:
        # These may take as long as a machine that cannot be reached.
        self._warn_if_unreachable()
        self._look()
        for count in itertools.count(1):
            if self._closed.wait(period):
                return
            is_due = count % _ASK_EACH == 0
            if not is_due and not self._away and not not_registered.is_set() and self._connection.is_open():
                continue
            if is_due:      # the name of its machine may be another one's by now, while this one still runs
                self._connection.close()
            # Before the question who the master is: what one that has just begun does not know must not be forgotten.
            snapshot = self._read() if is_due else None
            identity = self._ask()
            if identity is None:
                if not self._away:
                    rospy.logwarn("the ROS master at %s does not answer; running on without it",
                                  rosgraph.get_master_uri())
                self._away = True
                continue
            is_new = self._identity is not None and identity != self._identity
            if (is_new or not_registered.is_set()) and not self._register_again(is_new):
                continue            # the next time
            if is_new:
                for aggregator in self._aggregators:
                    aggregator.register()
            else:
                if count % _LOOK_EACH == 0:
                    self._look()
                self._keep(snapshot)
                if self._away:
                    rospy.loginfo("the ROS master answers again")
            self._identity, self._away = identity, False

    def _warn_if_unreachable(self) -> None:
        uri = own_address()
        if not uri.startswith("http") or is_alive(uri) or self._closed.is_set() or rospy.is_shutdown():
            return
        given = ", ".join("{} is {!r}".format(name, os.environ[name]) for name in ("ROS_HOSTNAME", "ROS_IP")
                          if name in os.environ)
        rospy.logwarn("this node does not reach itself at %s, the address that it gives to other nodes: mostly they do "
                      "not reach it either, and get nothing from it. %s: set ROS_IP to an address of this machine "
                      "(hostname -I), or neither of them where all nodes run here", uri,
                      given or "ROS_HOSTNAME and ROS_IP are not set")

    def _look(self) -> None:
        for aggregator in self._aggregators:
            aggregator.look()

    def _ask(self) -> Optional[Tuple[int, str]]:
        try:
            return self._connection.ask(rospy.get_name())
        except MasterAway:
            return None

    def _read(self) -> Optional[Snapshot]:
        if self._parameters is None:
            return None
        try:
            with node_at(rosgraph.get_master_uri()) as master:
                return self._parameters.read(master)
        except Exception:           # it is away: whoever asks who it is says so
            return None

    def _keep(self, snapshot: Optional[Snapshot]) -> None:
        if self._parameters is not None and snapshot is not None:
            self._parameters.keep(snapshot)

    def _put_back(self) -> None:
        if self._parameters is None:
            return
        with node_at(rosgraph.get_master_uri()) as master:
            done = self._parameters.put_back(master)
        if done:
            rospy.loginfo("put back on the new ROS master: parameters %s", ", ".join(done))

    def _register_again(self, is_new: bool) -> bool:
        """Tell the master, which may be a new one, all that this node has; False when it does not take it, for whatever
        reason."""
        rospy.logwarn("%s; registering all topics and services anew", "the ROS master has been started again" if is_new
                      else "the ROS master did not answer when topics were opened or closed")
        not_registered.clear()      # before the topics are listed: what is opened from now on tells the master itself
        name, uri = rospy.get_name(), own_address()
        try:
            if is_new:
                self._put_back()    # first: who sees the node on the new master finds its parameters, too
            with node_at(rosgraph.get_master_uri()) as master:
                for topic, kind in own_publications():
                    _check(master.registerPublisher(name, topic, kind, uri))
                for service, service_uri in own_services():
                    _check(master.registerService(name, service, service_uri, uri))
            for topic, kind in own_subscriptions():
                subscribe_again(topic, kind)
            _take_back_closed()
        except Exception as error:      # it has just begun, or has gone again
            not_registered.set()
            rospy.logerr("registration with the ROS master failed: %s; trying again", error)
            return False
        return True


def _take_back_closed(patience: float = ANSWER_S) -> None:
    """Take back what the master lists of this node that is not open: it may not have heard of the end of a topic, or
    only before it was registered anew. Raises as node_at() does."""
    name = rospy.get_name()
    with node_at(rosgraph.get_master_uri(), patience) as master:
        published, subscribed, _ = master.getSystemState(name)[2]
    unregister_closed(*([topic for topic, nodes in listed if name in nodes] for listed in (published, subscribed)))


def _check(answer: Tuple[int, str, int]) -> None:
    if answer[0] != 1:
        raise OSError("the master refuses: {}".format(answer[1]))


class ParametersLost(ParameterError):
    """What roslaunch had set for this node went with an earlier master."""


class Snapshot(NamedTuple):
    """What the master said: values by namespace, and how many changes by this process it may know of."""

    values: Dict[str, object]
    changes: int


class OwnParameters:
    """Remembers the private parameters of this node, and those of the whole stack, for a new master. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: Dict[str, object] = {}
        self._first: Optional[Dict[str, object]] = None     # the private ones with which the node began
        self._changes = 0

    def read(self, master: ServerProxy) -> Snapshot:
        """Ask the master for them. Raises OSError, or what xmlrpc raises, where it does not answer."""
        with self._lock:
            changes = self._changes
        found = {namespace: _asked(master, namespace) for namespace in (rospy.get_name(), SHARED)}
        return Snapshot({namespace: value for namespace, value in found.items() if value is not None}, changes)

    def keep(self, snapshot: Snapshot) -> None:
        """Remember these; only for those of the master that this node is registered at."""
        with self._lock:
            if snapshot.changes == self._changes:
                self._kept = snapshot.values
            own = snapshot.values.get(rospy.get_name(), {})
            if self._first is None and isinstance(own, dict):
                self._first = copy.deepcopy(own)

    def set(self, name: str, value: object) -> None:
        """Set a private parameter, and remember it also where the master is away; rospy then raises one of many."""
        try:
            rospy.set_param("~" + name, value)
        finally:
            with self._lock:
                self._changes += 1
                own = self._kept.setdefault(rospy.get_name(), {})
                if isinstance(own, dict):
                    own[name] = value
                if self._first is not None:
                    self._first[name] = value

    def take_back(self, master: ServerProxy) -> bool:
        """Set the private parameters as this node began with, in place of those of another node of its name that has
        ended; tell whether these were others. Raises as put_back() does.
        """
        name = rospy.get_name()
        with self._lock:
            first = copy.deepcopy(self._first)
        if first is None or (_asked(master, name) or {}) == first:
            return False
        code, text, _ = _answer(master.setParam(name, name, first))
        if code != 1:
            raise OSError("the master refuses the parameters {}: {}".format(name, text))
        return True

    def put_back(self, master: ServerProxy) -> List[str]:
        """Set on a new master what is missing there; return the namespaces, or names, that were set.

        Nothing that somebody has set there is touched. Raises as read() does, and OSError where the master refuses.
        """
        with self._lock:
            kept = copy.deepcopy(self._kept)
        done = []
        for namespace, value in kept.items():
            for name, missing in _missing(namespace, value, _asked(master, namespace)):
                code, text, _ = _answer(master.setParam(rospy.get_name(), name, missing))
                if code != 1:
                    raise OSError("the master refuses the parameter {}: {}".format(name, text))
                done.append(name)
        return done


def launched_for_earlier_master(arguments: Sequence[str]) -> bool:
    """Tell whether roslaunch has started this process, and its master was started again since it began.

    arguments: of this process, among which roslaunch gives the path of a log, in a folder with the run id of the
    master.
    """
    run_id = _launched_for(arguments)
    return bool(run_id) and rospy.get_param("/run_id", "") != run_id


def check_not_lost(arguments: Sequence[str]) -> None:
    """Raise ParametersLost where this process was launched for an earlier master, whose parameters are gone.

    The defaults may show of people what the parameters had forbidden. arguments: of this process.
    """
    name = rospy.get_name()
    if launched_for_earlier_master(arguments) and rospy.get_param(name, {}) == {}:
        raise ParametersLost("{} has no parameters: the ROS master was started again, and what roslaunch had set went "
                             "with it. The node waits: end this launch and start it again, or set its parameters with "
                             "rosparam".format(name))


def _launched_for(arguments: Sequence[str]) -> str:
    """Run id of the master that roslaunch had when it began; empty for a process that it has not started."""
    for argument in arguments:
        if argument.startswith("__log:="):
            folder = os.path.basename(os.path.dirname(argument))
            try:
                uuid.UUID(folder)
            except ValueError:      # a path that somebody else has given
                continue
            return folder
    return ""


def _missing(name: str, kept: object, there: Optional[object]) -> Iterator[Tuple[str, object]]:
    """Names and values of what is not there, whole namespaces as one."""
    if there is None:
        if kept != {}:
            yield name, kept
    elif isinstance(kept, dict) and isinstance(there, dict):
        for key, value in kept.items():
            yield from _missing("{}/{}".format(name, key), value, there.get(key))


def _asked(master: ServerProxy, name: str) -> Optional[object]:
    """Value of a parameter, or dictionary of a namespace; None where there is none."""
    code, _, value = _answer(master.getParam(rospy.get_name(), name))
    return value if code == 1 else None


def _answer(given: Any) -> Tuple[int, str, object]:
    code, text, value = given
    return int(code), str(text), value


def end_node(name: str, why: str) -> None:
    """Shut a node down over its API, which logs why; one that does not answer is taken off the master's lists."""
    uri = address_of_node(name)
    if uri is None:
        return
    try:
        node_at(uri, CALL_S).shutdown(rospy.get_name(), why)
    except MASTER_ERRORS:
        unregister_node(name)
        return
    deadline = time.monotonic() + _SHUTDOWN_S
    while address_of_node(name) == uri:
        if time.monotonic() > deadline:
            unregister_node(name)
            return
        time.sleep(0.02)


def unregister_node(name: str) -> None:
    """Take all registrations of a node back that did not do so itself. Raises one of MASTER_ERRORS."""
    master = patient_master(name)
    uri = address_of_node(name)
    if uri is None:
        return
    published, subscribed, services = master.getSystemState()
    for topic, nodes in published:
        if name in nodes:
            master.unregisterPublisher(topic, uri)
    for topic, nodes in subscribed:
        if name in nodes:
            master.unregisterSubscriber(topic, uri)
    for service, nodes in services:
        if name in nodes:
            master.unregisterService(service, master.lookupService(service))


def address_of_node(name: str) -> Optional[str]:
    """Address of a node's API, None when the master does not know the node. Raises OSError where it does not answer."""
    if not name:
        return None
    try:
        return patient_master().lookupNode(name) or None
    except rosgraph.MasterError:
        return None
