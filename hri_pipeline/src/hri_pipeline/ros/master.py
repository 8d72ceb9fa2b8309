"""The ROS master: questions to it and to other nodes, and what happens when it is started again.

All questions end after a time: rospy's own wait for a minute, or for ever.
"""

from __future__ import annotations

import itertools
import threading
from enum import Enum
from typing import List, Optional, Sequence, Tuple
from xmlrpc.client import ServerProxy

import rosgraph
import rospy

from hri_pipeline.ros.own_parameters import OwnParameters, Snapshot
from hri_pipeline.ros.rospy_compat import (
    TransportWithTimeout,
    not_registered,
    own_address,
    own_publications,
    own_services,
    own_subscriptions,
    register_without_waiting,
)

ANSWER_S = 5.0
_PERIOD_S = 2.0
_KEEP_EACH = 5      # questions who the master is for one after the parameters, which are some kilobytes
AGGREGATOR = "hri_diagnostics"
"""The diagnostic_aggregator of diagnostics.launch, beside the node or without a namespace."""
IMAGE_TYPES = {"raw": "sensor_msgs/Image", "compressed": "sensor_msgs/CompressedImage"}
"""By transport."""


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


def ask_master(name: str) -> Tuple[int, str]:
    """Return process id and run id of the master, asked in the name of a node; MasterAway without an answer in 5 s."""
    try:
        with node_at(rosgraph.get_master_uri()) as master:
            pid = int(master.getPid(name)[2])
            found, _, run_id = master.getParam(name, "/run_id")
    except Exception as error:      # refused, reset, half an answer, no address: it is away
        raise MasterAway(str(error)) from error
    return pid, str(run_id) if found == 1 else ""     # a bare rosmaster has no run id


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
    """Asks the master every two seconds who it is.

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
        """Stop watching. Idempotent."""
        self._closed.set()
        self._thread.join(timeout=5.0)

    def _watch(self, period: float) -> None:
        self._look()    # may take as long as a machine that cannot be reached
        for count in itertools.count(1):
            if self._closed.wait(period):
                return
            # Before the question who the master is: what one that has just begun does not know must not be forgotten.
            snapshot = self._read() if count % _KEEP_EACH == 0 else None
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
                if count % _KEEP_EACH == 0:
                    self._look()
                self._keep(snapshot)
                if self._away:
                    rospy.loginfo("the ROS master answers again")
            self._identity, self._away = identity, False

    def _look(self) -> None:
        for aggregator in self._aggregators:
            aggregator.look()

    def _ask(self) -> Optional[Tuple[int, str]]:
        try:
            return ask_master(rospy.get_name())
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
                      else "the ROS master did not answer when topics were opened")
        not_registered.clear()      # before the topics are listed: what is opened from now on tells the master itself
        name, uri = rospy.get_name(), own_address()
        try:
            if is_new:
                self._put_back()    # first: who sees the node on the new master finds its parameters, too
            with node_at(rosgraph.get_master_uri()) as master:
                published = own_publications()
                for topic, kind in published:
                    _check(master.registerPublisher(name, topic, kind, uri))
                # Whoever has gone meanwhile has taken these back before the new master knew them.
                there = {topic for topic, _ in own_publications()}
                for topic in {topic for topic, _ in published} - there:
                    _check(master.unregisterPublisher(name, topic, uri))
                for service, service_uri in own_services():
                    _check(master.registerService(name, service, service_uri, uri))
            subscribed = own_subscriptions()
            for topic, kind in subscribed:
                subscribe_again(topic, kind)
            there = {topic for topic, _ in own_subscriptions()}
            with node_at(rosgraph.get_master_uri()) as master:
                for topic in {topic for topic, _ in subscribed} - there:
                    _check(master.unregisterSubscriber(name, topic, uri))
        except Exception as error:      # it has just begun, or has gone again
            not_registered.set()
            rospy.logerr("registration with the ROS master failed: %s; trying again", error)
            return False
        return True


def _check(answer: Tuple[int, str, int]) -> None:
    if answer[0] != 1:
        raise OSError("the master refuses: {}".format(answer[1]))
